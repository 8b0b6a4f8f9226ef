//! The camera lists.

use crate::error::DatasetError;
use ffgs_core::{Camera, CameraError, ImageSize, Intrinsics, counted, is_present, nan_to_null, read_text};
use glam::{DMat4, DVec4};
use serde::Deserialize;
use std::path::Path;

/// A list of 500 cameras over 1000 frames takes a fifth of it.
const MAX_META_BYTES: u64 = 1 << 29;

type Matrix<const N: usize> = [[Option<f64>; N]; N];

/// A side of the images: one for all cameras, or one for each camera of frame 0.
#[derive(Deserialize)]
#[serde(untagged)]
enum Side {
    All(usize),
    Each(Vec<usize>),
}

impl Side {
    fn of(&self, view: usize) -> Option<usize> {
        match self {
            Self::All(side) => Some(*side),
            Self::Each(sides) => sides.get(view).copied(),
        }
    }
}

/// A `*_meta.json`, entries `[frame][camera]`. Non-finite numbers (NaN is not JSON, but Python writes it) are null.
#[derive(Deserialize)]
struct MetaFile {
    w: Side,
    h: Side,
    k: Vec<Vec<Matrix<3>>>,
    w2c: Vec<Vec<Matrix<4>>>,
    #[serde(rename = "fn")]
    file_names: Vec<Vec<String>>,
    cam_id: Vec<Vec<u32>>,
}

/// A physical camera of a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct View {
    /// Folder of its images below `ims/`.
    pub name: String,
    /// `cam_id` of the meta file.
    pub id: u32,
}

/// One split: its views and, per frame and view, camera and image.
#[derive(Debug, Default)]
pub(crate) struct Meta {
    pub views: Vec<View>,
    /// `[frame][view]`
    pub entries: Vec<Vec<Entry>>,
}

/// A view at a frame. The camera is validated when asked for, so that `check` reports all that are none.
#[derive(Debug)]
pub(crate) struct Entry {
    intrinsics: Intrinsics,
    camera_from_world: DMat4,
    size: ImageSize,
    pub file_name: String,
}

impl Entry {
    pub(crate) fn camera(&self) -> Result<Camera, CameraError> {
        let camera = Camera::new(self.intrinsics, self.camera_from_world, self.size)?;
        camera.check_plausible().map(|()| camera)
    }
}

impl Meta {
    /// Reads the file; views are those of its first frame, matched in later frames by camera id and folder.
    pub(crate) fn read(file: &Path) -> Result<Self, DatasetError> {
        let text = read_text(file, MAX_META_BYTES).map_err(|source| DatasetError::io(file, source))?;
        let meta = |reason: String| DatasetError::Meta { file: file.to_owned(), reason };
        let parsed: MetaFile = serde_json::from_str(&nan_to_null(&text)).map_err(|e| meta(e.to_string()))?;
        parsed.into_meta().map_err(meta)
    }

    /// As [`Meta::read`]; no views when there is no such file.
    pub(crate) fn read_optional(file: &Path) -> Result<Self, DatasetError> {
        if is_present(file) { Self::read(file) } else { Ok(Self::default()) }
    }
}

impl MetaFile {
    fn into_meta(self) -> Result<Meta, String> {
        self.check_lengths()?;
        let views = self.views(0);
        if let Some((_, View { name, .. })) =
            views.iter().enumerate().find(|(i, v)| views[..*i].iter().any(|other| other.name == v.name))
        {
            return Err(format!("two cameras have the folder '{name}' in frame 0; each needs its own"));
        }
        let entries = (0..self.k.len()).map(|t| self.frame(t, &views)).collect::<Result<_, _>>()?;
        Ok(Meta { views, entries })
    }

    fn check_lengths(&self) -> Result<(), String> {
        let frames = [self.k.len(), self.w2c.len(), self.file_names.len(), self.cam_id.len()];
        if frames.iter().any(|&n| n != frames[0]) {
            return Err(format!("k, w2c, fn, cam_id have {frames:?} frames"));
        }
        if frames[0] == 0 || self.k[0].is_empty() {
            return Err("no frame or no camera".to_owned());
        }
        for t in 0..frames[0] {
            let cameras =
                [self.k[t].len(), self.w2c[t].len(), self.file_names[t].len(), self.cam_id[t].len()];
            if cameras.iter().any(|&n| n != cameras[0]) {
                return Err(format!("k, w2c, fn, cam_id have {cameras:?} cameras in frame {t}"));
            }
        }
        Ok(())
    }

    fn views(&self, frame: usize) -> Vec<View> {
        let named = self.file_names[frame].iter().zip(&self.cam_id[frame]);
        named.map(|(name, &id)| View { name: folder(name).to_owned(), id }).collect()
    }

    fn frame(&self, t: usize, views: &[View]) -> Result<Vec<Entry>, String> {
        let here = self.views(t);
        if here.len() != views.len() {
            return Err(format!(
                "frame {t} has {}, frame 0 has {}",
                counted(here.len(), "camera"),
                views.len()
            ));
        }
        (0..views.len()).map(|view| self.entry(t, views, view, &here)).collect()
    }

    fn entry(&self, t: usize, views: &[View], index: usize, here: &[View]) -> Result<Entry, String> {
        let view = &views[index];
        let missing = || format!("camera '{}' (id {}) is missing in frame {t}", view.name, view.id);
        let c = here.iter().position(|v| v == view).ok_or_else(missing)?;
        let sides = self.w.of(index).zip(self.h.of(index));
        let (width, height) =
            sides.ok_or_else(|| format!("w or h has no entry for camera '{}'", view.name))?;
        if width.checked_mul(height).is_none_or(|pixels| pixels > ImageSize::MAX_PIXELS) {
            let most = ImageSize::MAX_PIXELS;
            return Err(format!("images of {width} x {height} pixels are larger than {most} pixels"));
        }
        let size = ImageSize { width, height };
        let file_name = self.file_names[t][c].clone();
        if !is_inside(&file_name) {
            return Err(format!("file name {file_name:?} must be CAMERA/FRAME.png, in one folder"));
        }
        let skew = number(self.k[t][c][0][1]);
        // A thousandth of the focal length moves no pixel of the image by as much as one.
        if skew.abs() > 1e-3 * number(self.k[t][c][0][0]).abs() {
            return Err(format!(
                "camera '{}' has a skew of {skew} in frame {t}: undistort its images",
                view.name
            ));
        }
        let (intrinsics, camera_from_world) = (intrinsics(&self.k[t][c]), transform(&self.w2c[t][c]));
        Ok(Entry { intrinsics, camera_from_world, size, file_name })
    }
}

fn number(entry: Option<f64>) -> f64 {
    entry.unwrap_or(f64::NAN)
}

fn intrinsics(k: &Matrix<3>) -> Intrinsics {
    Intrinsics { fx: number(k[0][0]), fy: number(k[1][1]), cx: number(k[0][2]), cy: number(k[1][2]) }
}

fn transform(rows: &Matrix<4>) -> DMat4 {
    let [x, y, z, w] = rows.map(|row| DVec4::from_array(row.map(number)));
    DMat4::from_cols(x, y, z, w).transpose()
}

/// `CAMERA` of `CAMERA/FRAME.png`.
fn folder(file_name: &str) -> &str {
    file_name.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// A file in one folder that does not leave the capture. Folders in folders are refused: a run writes pictures below the
/// names of its views, and looks for links in the first folder only.
fn is_inside(file_name: &str) -> bool {
    let parts: Vec<&str> = file_name.split('/').collect();
    parts.len() == 2
        && !file_name.contains('\\')
        && parts.iter().all(|p| !p.is_empty() && *p != "." && *p != "..")
}
