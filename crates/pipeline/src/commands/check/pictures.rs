//! `ffgs check --pictures`: a picture per training camera, with what the program believes of its first frame.

use crate::job::frame::load_view;
use crate::outputs::camera_pictures::Believed;
use crate::plugins::registry::open_capture;
use anyhow::{Context, Result};
use ffgs_dataset::write_image;
use ffgs_method::{Split, ViewAt};
use rayon::prelude::*;
use std::path::Path;

/// Width of a picture, at least (px).
const WIDTH: usize = 960;

/// Writes `CAMERA.png` for every training camera, drawn as [`Believed::draw`] says. Returns their number.
///
/// # Errors
/// When the capture cannot be read or the folder not be written.
pub(crate) fn write(root: &Path, folder: &Path) -> Result<usize> {
    let capture = open_capture(root)?;
    let believed = Believed::of(&*capture)?;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let views = capture.views(Split::Train);
    let one = |view: usize| -> Result<()> {
        let at = ViewAt { split: Split::Train, view, frame: 0 };
        let picture = believed.draw(at, &load_view(&*capture, at)?, WIDTH);
        Ok(write_image(&folder.join(format!("{}.png", views[view])), &picture)?)
    };
    (0..views.len()).into_par_iter().try_for_each(one)?;
    Ok(views.len())
}
