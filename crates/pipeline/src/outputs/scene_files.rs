//! The splat files of a frame.

use crate::plugins::registry;
use anyhow::Result;
use ffgs_core::{Dynamic, Scene};
use ffgs_method::{Followed, Splats};
use std::path::{Path, PathBuf};

/// Writes both layers and the sky; the files.
///
/// # Errors
/// When one of them cannot be written.
pub(crate) fn write_splats(folder: &Path, scene: &Scene) -> Result<[PathBuf; 3]> {
    let format = registry::run_format();
    let file = folder.join(format!("static{}", format.extension()));
    format.write(&file, &Splats::from(&*scene.static_layer))?;
    let texels = scene.sky.texels.as_flattened();
    ffgs_splats::write_sky_cross(&folder.join("sky.png"), scene.sky.face_size(), texels)?;
    Ok([file, write_dynamic(folder, &scene.dynamic)?, folder.join("sky.png")])
}

/// Writes the dynamic layer; the file.
///
/// # Errors
/// When it cannot be written.
pub(crate) fn write_dynamic(folder: &Path, dynamic: &Dynamic) -> Result<PathBuf> {
    let format = registry::run_format();
    let file = folder.join(format!("dynamic{}", format.extension()));
    let Dynamic { gaussians, covariances, ids, .. } = dynamic;
    let splats = Splats { gaussians, followed: Some(Followed { covariances, ids }) };
    format.write(&file, &splats)?;
    Ok(file)
}
