//! What the check of a capture found: its inventory, its faults, and notes on what the method can go on without.

use ffgs_core::{ImageSize, counted};
use ffgs_method::{Fault, Split};
use std::fmt;
use std::path::PathBuf;

/// Something worth knowing that the method can go on with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// The file or folder concerned.
    pub file: PathBuf,
    /// What was found.
    pub text: String,
}

/// What one view holds.
#[derive(Clone, Debug)]
pub struct ViewSummary {
    /// Split of the view.
    pub split: Split,
    /// Camera folder.
    pub name: String,
    /// Frames that the meta file lists.
    pub frames: usize,
    /// Image size (px); `None` without a valid camera.
    pub size: Option<ImageSize>,
    /// Images that were read.
    pub images: usize,
    /// Masks that were read.
    pub masks: usize,
    /// Masks that were decoded, all or those of some frames: the counts and shares below are of these.
    pub decoded_masks: usize,
    /// Frames whose image has no mask.
    pub missing_masks: Vec<usize>,
    /// Masks without a foreground pixel.
    pub empty_masks: usize,
    /// Mean foreground fraction of the masks, 0..=1.
    pub coverage: f64,
    /// Mean foreground fraction of the masks' borders, 0..=1.
    pub border_coverage: f64,
    /// Mean value of the images, 0..=255; 0 when they were not decoded.
    pub brightness: f64,
    /// Initial points inside the image at frame 0.
    pub points_seen: usize,
}

/// What one split holds.
#[derive(Clone, Debug)]
pub struct SplitSummary {
    /// The split.
    pub split: Split,
    /// Its views.
    pub views: usize,
    /// Frames per view.
    pub frames: usize,
}

/// Inventory and faults of a capture; prints as a table.
#[derive(Clone, Debug, Default)]
pub struct CheckReport {
    /// The capture's folder.
    pub root: PathBuf,
    /// One entry per split that has views.
    pub splits: Vec<SplitSummary>,
    /// One entry per view.
    pub views: Vec<ViewSummary>,
    /// Finite initial points.
    pub points: usize,
    /// Those on the foreground.
    pub foreground_points: usize,
    /// What must be mended; empty for a usable capture.
    pub faults: Vec<Fault>,
    /// What is worth knowing.
    pub notes: Vec<Note>,
}

impl CheckReport {
    /// Whether the capture has no fault.
    pub fn is_usable(&self) -> bool {
        self.faults.is_empty()
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Capture {}", self.root.display())?;
        for SplitSummary { split, views, frames } in &self.splits {
            writeln!(f, "  {split:5} {}, {}", counted(*views, "view"), counted(*frames, "frame"))?;
        }
        writeln!(f, "  points {}, foreground {}", self.points, self.foreground_points)?;
        self.fmt_views(f)?;
        self.notes
            .iter()
            .try_for_each(|Note { file, text }| writeln!(f, "note: {}: {text}", file.display()))?;
        for Fault { file, problem, fix } in &self.faults {
            writeln!(f, "fault: {}: {problem}\n  fix: {fix}", file.display())?;
        }
        match self.faults.len() {
            0 => writeln!(f, "no faults"),
            n => writeln!(f, "{}", counted(n, "fault")),
        }
    }
}

impl CheckReport {
    fn fmt_views(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.views.iter().map(|v| v.name.len()).max().unwrap_or(0).max(4);
        let heading = "      size  images  masks  empty  foreground  points seen";
        writeln!(f, "  split {:width$} {heading}", "view")?;
        for v in &self.views {
            let size = v.size.map_or("?".to_owned(), |s| format!("{}x{}", s.width, s.height));
            let images = format!("{}/{}", v.images, v.frames);
            let coverage = format!("{:.2} %", v.coverage * 100.0);
            let ViewSummary { split, name, masks, empty_masks, points_seen, .. } = v;
            write!(f, "  {split:5} {name:width$} {size:>10} {images:>7} {masks:>6} {empty_masks:>6}")?;
            writeln!(f, " {coverage:>11} {points_seen:>12}")?;
        }
        Ok(())
    }
}
