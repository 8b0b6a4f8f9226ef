//! Writing of PLY splats as 3DGS has them, with covariances and ids as further properties.

use crate::error::InFile;
use crate::format::Format;
use crate::ply_header::ply_comment;
use crate::{Followed, Problem, SplatError};
use ffgs_core::{Gaussians, write_atomically};
use glam::DMat3;
use std::io::Write;
use std::path::Path;

pub(crate) const FORMAT: Format = Format {
    name: "ply-seq",
    summary: "SuperSplat (as a sequence), Brush and every viewer; exact, 248 bytes per Gaussian of SH degree 3",
    extension: ".ply",
    write: |file, splats| write_ply(file, splats.gaussians, splats.followed),
    read: Some(|file| crate::read_ply(file).map(|ply| ply.gaussians)),
};

/// Writes a binary little-endian 3DGS PLY that other viewers open: `x y z nx ny nz f_dc_* f_rest_*` (channel-major)
/// `opacity scale_* rot_*` (w, x, y, z), all f32. What is `tracked` becomes the extra properties
/// `cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz` (f32) and `id` (u32). A header comment names the filter of what ordinary
/// viewers draw wrongly.
///
/// # Errors
/// When the columns do not match, or the file cannot be written.
pub fn write_ply(path: &Path, gaussians: &Gaussians, tracked: Option<Followed>) -> Result<(), SplatError> {
    check(gaussians, tracked).in_file(path)?;
    write_atomically(path, |out| -> Result<(), Problem> {
        out.write_all(header(gaussians, tracked.is_some()).as_bytes())?;
        let mut row = Vec::new();
        for i in 0..gaussians.len() {
            row.clear();
            push_row(&mut row, gaussians, i, tracked.map(|t| t.covariances[i]));
            for value in &row {
                out.write_all(&value.to_le_bytes())?;
            }
            if let Some(tracked) = tracked {
                out.write_all(&tracked.ids[i].to_le_bytes())?;
            }
        }
        Ok(())
    })
    .in_file(path)
}

fn check(gaussians: &Gaussians, tracked: Option<Followed>) -> Result<(), Problem> {
    gaussians.validate().map_err(|e| Problem::Shape(e.to_string()))?;
    let n = gaussians.len();
    match tracked {
        Some(t) if t.covariances.len() != n || t.ids.len() != n => {
            let (covariances, ids) = (t.covariances.len(), t.ids.len());
            Err(Problem::Shape(format!("{covariances} covariances and {ids} ids for {n} Gaussians")))
        }
        _ => Ok(()),
    }
}

fn header(gaussians: &Gaussians, with_tracked: bool) -> String {
    let rest = 3 * (gaussians.sh_stride() - 1);
    let numbered = |name: &'static str, n: usize| (0..n).map(move |i| format!("{name}_{i}"));
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(str::to_owned).into();
    names.extend(numbered("f_dc", 3).chain(numbered("f_rest", rest)));
    names.push("opacity".to_owned());
    names.extend(numbered("scale", 3).chain(numbered("rot", 4)));
    if with_tracked {
        names.extend(["xx", "xy", "xz", "yy", "yz", "zz"].map(|n| format!("cov_{n}")));
    }
    let mut properties: Vec<String> = names.iter().map(|n| format!("property float {n}\n")).collect();
    if with_tracked {
        properties.push("property uint id\n".to_owned());
    }
    let vertices = gaussians.len();
    let properties = properties.concat();
    let comment = ply_comment(gaussians.filter);
    let element = format!("element vertex {vertices}");
    format!("ply\nformat binary_little_endian 1.0\n{comment}{element}\n{properties}end_header\n")
}

fn push_row(row: &mut Vec<f32>, gaussians: &Gaussians, i: usize, covariance: Option<DMat3>) {
    let sh = gaussians.sh_of(i);
    row.extend(gaussians.means[i]);
    row.extend([0.0; 3]);
    row.extend(sh[0]);
    for channel in 0..3 {
        row.extend(sh[1..].iter().map(|rgb| rgb[channel]));
    }
    row.push(gaussians.opacity_logits[i]);
    row.extend(gaussians.log_scales[i]);
    row.extend(gaussians.quats[i]);
    if let Some(m) = covariance {
        let upper = [m.x_axis.x, m.y_axis.x, m.z_axis.x, m.y_axis.y, m.z_axis.y, m.z_axis.z];
        row.extend(upper.map(|v| v as f32));
    }
}
