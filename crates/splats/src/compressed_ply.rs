//! The compressed PLY of PlayCanvas and SuperSplat: chunks of 256 Gaussians with bounds, 16 bytes per Gaussian, and a byte
//! per coefficient of the spherical harmonics above degree 0. Source: playcanvas/splat-transform, `compressed-chunk.ts`.

use crate::error::InFile;
use crate::format::Format;
use crate::ply_header::ply_comment;
use crate::quantise::{smallest_three, unorm};
use crate::{Problem, SplatError};
use ffgs_core::{Gaussians, SH_C0, sigmoid, write_atomically};
use std::io::Write;
use std::ops::Range;
use std::path::Path;

pub(crate) const FORMAT: Format = Format {
    name: "compressed-ply-seq",
    summary: "SuperSplat (as a sequence) and the PlayCanvas engine",
    extension: ".compressed.ply",
    write: |file, splats| write_compressed_ply(file, splats.gaussians),
    read: None,
};

/// Gaussians that share bounds.
const CHUNK: usize = 256;
/// Log scales beyond this are not meant; they would cost the others of their chunk all precision.
const MAX_LOG_SCALE: f32 = 20.0;
/// Coefficients above degree 0 are kept from minus to plus this.
const MAX_SH: f32 = 4.0;

const BOUNDS: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];

/// Writes a compressed PLY, which every PlayCanvas player opens. The order is kept: Gaussians that are neighbours in memory
/// should be neighbours in space, or the bounds of a chunk are wide and positions coarse.
///
/// # Errors
/// When the columns do not match, or the file cannot be written.
pub(crate) fn write_compressed_ply(path: &Path, gaussians: &Gaussians) -> Result<(), SplatError> {
    gaussians.validate().map_err(|e| Problem::Shape(e.to_string())).in_file(path)?;
    let chunks: Vec<Range<usize>> = (0..gaussians.len())
        .step_by(CHUNK)
        .map(|start| start..(start + CHUNK).min(gaussians.len()))
        .collect();
    let bounds: Vec<Bounds> = chunks.iter().map(|rows| Bounds::of(gaussians, rows.clone())).collect();
    write_atomically(path, |out| -> Result<(), Problem> {
        out.write_all(header(gaussians, chunks.len()).as_bytes())?;
        for value in bounds.iter().flat_map(Bounds::values) {
            out.write_all(&value.to_le_bytes())?;
        }
        for (rows, bounds) in chunks.iter().zip(&bounds) {
            for word in rows.clone().flat_map(|i| bounds.pack(gaussians, i)) {
                out.write_all(&word.to_le_bytes())?;
            }
        }
        for i in 0..gaussians.len() {
            out.write_all(&harmonics(gaussians.sh_of(i)))?;
        }
        Ok(())
    })
    .in_file(path)
}

fn header(gaussians: &Gaussians, chunks: usize) -> String {
    let (n, rest) = (gaussians.len(), 3 * (gaussians.sh_stride() - 1));
    let properties = |kind: &str, names: &mut dyn Iterator<Item = String>| {
        let lines: Vec<String> = names.map(|name| format!("property {kind} {name}\n")).collect();
        lines.concat()
    };
    let bounds = properties("float", &mut BOUNDS.iter().map(|&name| name.to_owned()));
    let packed = ["position", "rotation", "scale", "color"].iter().map(|name| format!("packed_{name}"));
    let packed = properties("uint", &mut packed.into_iter());
    let harmonics = if rest == 0 {
        String::new()
    } else {
        let names = properties("uchar", &mut (0..rest).map(|i| format!("f_rest_{i}")));
        format!("element sh {n}\n{names}")
    };
    let mode = ply_comment(gaussians.filter);
    format!(
        "ply\nformat binary_little_endian 1.0\n{mode}element chunk {chunks}\n{bounds}element vertex {n}\n{packed}\
         {harmonics}end_header\n"
    )
}

/// Smallest and largest position, log scale and colour of a chunk.
struct Bounds {
    position: [[f32; 3]; 2],
    scale: [[f32; 3]; 2],
    colour: [[f32; 3]; 2],
}

impl Bounds {
    fn of(gaussians: &Gaussians, rows: Range<usize>) -> Self {
        let scale = |i: usize| gaussians.log_scales[i].map(|s| s.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE));
        Self {
            position: extremes(rows.clone().map(|i| gaussians.means[i])),
            scale: extremes(rows.clone().map(scale)),
            colour: extremes(rows.map(|i| colour(gaussians, i))),
        }
    }

    fn values(&self) -> impl Iterator<Item = f32> {
        [self.position, self.scale, self.colour].into_iter().flatten().flatten()
    }

    /// Position, rotation, scale and colour of a Gaussian.
    fn pack(&self, gaussians: &Gaussians, i: usize) -> [u32; 4] {
        let [r, g, b] = shares(colour(gaussians, i), &self.colour).map(|v| unorm(v, 8));
        let alpha = unorm(sigmoid(gaussians.opacity_logits[i]), 8);
        [
            pack_11_10_11(shares(gaussians.means[i], &self.position)),
            pack_rotation(gaussians.quats[i]),
            pack_11_10_11(shares(gaussians.log_scales[i], &self.scale)),
            r << 24 | g << 16 | b << 8 | alpha,
        ]
    }
}

fn extremes(values: impl Iterator<Item = [f32; 3]>) -> [[f32; 3]; 2] {
    let start = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    values.fold(start, |[low, high], v| {
        [[0, 1, 2].map(|a| low[a].min(v[a])), [0, 1, 2].map(|a| high[a].max(v[a]))]
    })
}

/// Where `value` lies between the bounds, 0..=1.
fn shares(value: [f32; 3], [low, high]: &[[f32; 3]; 2]) -> [f32; 3] {
    [0, 1, 2].map(|a| if high[a] > low[a] { (value[a] - low[a]) / (high[a] - low[a]) } else { 0.0 })
}

fn colour(gaussians: &Gaussians, i: usize) -> [f32; 3] {
    gaussians.sh_of(i)[0].map(|v| SH_C0 * v + 0.5)
}

fn pack_11_10_11([x, y, z]: [f32; 3]) -> u32 {
    unorm(x, 11) << 21 | unorm(y, 10) << 11 | unorm(z, 11)
}

fn pack_rotation(quat: [f32; 4]) -> u32 {
    let (largest, rest) = smallest_three(quat);
    let share = |v: f32| unorm(v * std::f32::consts::FRAC_1_SQRT_2 + 0.5, 10);
    rest.iter().fold(largest as u32, |word, &v| word << 10 | share(v))
}

/// Coefficients above degree 0, channel by channel, a byte each.
fn harmonics(sh: &[[f32; 3]]) -> Vec<u8> {
    let byte = |v: f32| ((v / (2.0 * MAX_SH) + 0.5) * 256.0).clamp(0.0, 255.0) as u8;
    (0..3).flat_map(|channel| sh[1..].iter().map(move |rgb| byte(rgb[channel]))).collect()
}
