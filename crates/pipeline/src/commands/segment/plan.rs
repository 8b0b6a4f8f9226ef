//! Which frames each part has.

use super::PlanArgs;
use crate::commands::check::check_capture;
use crate::job::frame::select_views;
use crate::outputs::folder::RunFolder;
use crate::outputs::json::{read_json, write_json};
use crate::plugins::registry::open_capture;
use crate::settings::config::Config;
use anyhow::{Context, Result, bail, ensure};
use ffgs_dataset::ImageCheck;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// `segments.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Plan {
    /// Where the plan lies; not in the file, which may be moved.
    #[serde(skip)]
    pub(super) folder: PathBuf,
    /// Where the capture lies.
    pub(super) capture: PathBuf,
    pub(super) frames: Range<usize>,
    /// Frames from one key frame to the next.
    pub(super) length: usize,
    pub(super) scout_iterations: usize,
    pub(super) key_iterations: usize,
    pub(super) train_views: Option<Vec<String>>,
    pub(super) config: Config,
}

impl Plan {
    /// Decides the parts of a capture that can be used.
    ///
    /// # Errors
    /// When the capture or an option cannot be used.
    pub(crate) fn new(args: &PlanArgs) -> Result<Self> {
        let check = check_capture(&args.capture, ImageCheck::Probe, true)?;
        ensure!(check.is_usable(), "the capture cannot be used:\n{check}");
        let capture = open_capture(&args.capture)?;
        select_views(&*capture, args.train_views.as_deref())?;
        let count = capture.frames();
        let frames = args.frames.map_or(0..count, |f| f.start..f.end.unwrap_or(count));
        ensure!(
            frames.start == 0,
            "--frames {}..: the initial points are of frame 0; begin there",
            frames.start
        );
        ensure!(frames.end <= count, "--frames ..{}: the capture has frames 0..{count}", frames.end);
        let config = args.configuration()?;
        Ok(Self {
            folder: PathBuf::new(),
            capture: std::fs::canonicalize(&args.capture)?,
            frames,
            length: args.length as usize,
            scout_iterations: args.scout_iterations.unwrap_or(config.dynamic.iterations / 2),
            key_iterations: args.key_iterations.unwrap_or(3 * config.dynamic.iterations),
            train_views: args.train_views.clone(),
            config,
        })
    }

    /// Writes the plan into a folder that has none, or the same.
    ///
    /// # Errors
    /// When the folder has another plan, or cannot be written.
    pub(crate) fn write(&self, folder: &Path) -> Result<()> {
        let file = folder.join(FILE);
        if file.exists() {
            let other = Self { folder: PathBuf::new(), ..Self::read(folder)? };
            ensure!(
                other == *self,
                "{} holds another plan; choose another --out or remove it",
                folder.display()
            );
        }
        write_json(&file, self)
    }

    /// Reads the plan of a folder.
    ///
    /// # Errors
    /// When there is none, or it cannot be read.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let file = folder.join(FILE);
        if !file.exists() {
            bail!(
                "{} has no plan; make one with ffgs segment plan CAPTURE --out {0} --length N",
                folder.display()
            );
        }
        let folder = std::fs::canonicalize(folder).with_context(|| folder.display().to_string())?;
        let plan = Self { folder, ..read_json(&file)? };
        plan.config.validate()?;
        ensure!(plan.length > 1 && plan.frames.start < plan.frames.end, "{}: no parts", file.display());
        Ok(plan)
    }

    /// Frames of each part. A part ends with the frame with which the next begins.
    pub(crate) fn parts(&self) -> Vec<Range<usize>> {
        let Range { start, end } = self.frames;
        let keys = (start..(end - 1).max(start + 1)).step_by(self.length);
        keys.map(|key| key..(key + self.length + 1).min(end)).collect()
    }

    /// Frames of the scout: up to the last key frame. Empty when there is one part.
    pub(super) fn scouted(&self) -> Range<usize> {
        let last = self.parts().last().map_or(self.frames.start, |part| part.start);
        self.frames.start..if last > self.frames.start { last + 1 } else { last }
    }

    pub(super) fn first(&self) -> RunFolder {
        RunFolder(self.folder.join("first"))
    }

    pub(super) fn scout(&self) -> RunFolder {
        RunFolder(self.folder.join("scout"))
    }

    pub(super) fn part(&self, number: usize) -> RunFolder {
        RunFolder(self.folder.join(format!("part{number:03}")))
    }

    pub(super) fn joined(&self) -> RunFolder {
        RunFolder(self.folder.join("joined"))
    }

    /// The run that a part starts from, and the name of the job that makes it.
    pub(super) fn starts_from(&self, part: usize) -> (RunFolder, String) {
        if part == 0 { (self.first(), "first".to_owned()) } else { (self.scout(), format!("scout{part}")) }
    }

    /// The jobs, for the command line.
    pub(super) fn table(&self) -> String {
        let mut text = format!("{:>8}  {:>11}  starts from\n", "job", "frames");
        let mut row = |job: &str, frames: &Range<usize>, from: &str| {
            let _ = writeln!(text, "{job:>8}  {:>11}  {from}", format!("{}..{}", frames.start, frames.end));
        };
        row("first", &(self.frames.start..self.frames.start + 1), "the initial points");
        let parts = self.parts();
        for number in 1..parts.len() {
            let reached = self.frames.start..parts[number].start + 1;
            row(&format!("scout{number}"), &reached, &self.starts_from(number - 1).1);
        }
        for (number, part) in parts.iter().enumerate() {
            row(&number.to_string(), part, &self.starts_from(number).1);
        }
        text
    }
}

/// Name of the plan's file.
const FILE: &str = "segments.json";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_overlap_by_one_frame_and_cover_all() {
        let parts = |frames: Range<usize>, length| {
            let plan = Plan {
                folder: PathBuf::new(),
                capture: PathBuf::new(),
                frames,
                length,
                scout_iterations: 1,
                key_iterations: 1,
                train_views: None,
                config: Config::default(),
            };
            let ends: Vec<_> = plan.parts().iter().map(|part| (part.start, part.end)).collect();
            (ends, plan.scouted())
        };
        assert_eq!(parts(0..10, 4), (vec![(0, 5), (4, 9), (8, 10)], 0..9));
        assert_eq!(parts(0..9, 4), (vec![(0, 5), (4, 9)], 0..5), "no part of a key frame alone");
        assert_eq!(parts(0..5, 4), (vec![(0, 5)], 0..0));
        assert_eq!(parts(0..1, 4), (vec![(0, 1)], 0..0));
    }
}
