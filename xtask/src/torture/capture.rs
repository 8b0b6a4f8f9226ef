//! A capture so small that a run takes seconds, cut from the sample.

use crate::ffgs::SAMPLE;
use anyhow::{Context, Result};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// Frames kept.
pub(crate) const FRAMES: usize = 3;
/// Camera lists, and which of their cameras are kept.
const METAS: [(&str, &[usize]); 3] =
    [("train_meta.json", &[0, 4, 8]), ("test_meta.json", &[0]), ("init_meta.json", &[0])];

/// Writes the cut into `to`, which must not exist.
pub(crate) fn cut(root: &Path, to: &Path) -> Result<()> {
    let sample = root.join(SAMPLE);
    let mut cameras = Vec::new();
    for (file, kept) in METAS {
        let text = fs::read_to_string(sample.join(file)).with_context(|| format!("cannot read {file}"))?;
        let mut meta: Value = serde_json::from_str(&text)?;
        for key in ["k", "w2c", "fn", "cam_id"] {
            let rows = meta[key].as_array().context("no list")?.clone();
            let frames = rows.iter().take(FRAMES);
            meta[key] = frames.map(|row| kept.iter().map(|&c| row[c].clone()).collect::<Value>()).collect();
        }
        for name in meta["fn"].as_array().into_iter().flatten().filter_map(|row| row.as_array()).flatten() {
            let name = name.as_str().context("no file name")?;
            copy(&sample.join("ims").join(name), &to.join("ims").join(name))?;
            copy(&sample.join("seg").join(name), &to.join("seg").join(name))?;
            cameras.push(name.split('/').next().unwrap_or_default().to_owned());
        }
        fs::write(to.join(file), meta.to_string())?;
    }
    copy(&sample.join("init_pt_cld.npz"), &to.join("init_pt_cld.npz"))?;
    copy_tracks(&sample, to, &cameras)
}

fn copy_tracks(sample: &Path, to: &Path, cameras: &[String]) -> Result<()> {
    for file in files(&sample.join("tracks"))? {
        let kept =
            file.components().any(|part| cameras.iter().any(|camera| part.as_os_str() == camera.as_str()));
        if kept || file.extension().is_some_and(|extension| extension == "json") {
            copy(&file, &to.join(file.strip_prefix(sample)?))?;
        }
    }
    Ok(())
}

/// Every file below a folder, in order.
pub(crate) fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))? {
        let path = entry?.path();
        if path.is_dir() && !path.is_symlink() {
            found.extend(files(&path)?);
        } else {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Copies a folder with all that it holds.
pub(crate) fn copy_folder(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to)?;
    files(from)?.iter().try_for_each(|file| copy(file, &to.join(file.strip_prefix(from)?)))
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to.parent().context("no folder")?)?;
    fs::copy(from, to).with_context(|| format!("cannot copy {}", from.display()))?;
    Ok(())
}
