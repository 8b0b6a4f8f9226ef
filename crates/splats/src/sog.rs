//! SOG version 2 of PlayCanvas: lossless WebP textures and their description in one stored zip. Source:
//! playcanvas/splat-transform, `write-sog.ts`.

use crate::codebook::{codebook, nearest, palette};
use crate::error::InFile;
use crate::format::Format;
use crate::quantise::{smallest_three, to_byte};
use crate::{Problem, SplatError};
use ffgs_core::{Gaussians, PixelFilter, sigmoid, write_atomically};
use image_webp::{ColorType, WebPEncoder};
use serde_json::{Value, json};
use std::f32::consts::SQRT_2;
use std::io::{Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

pub(crate) const FORMAT: Format = Format {
    name: "sog",
    summary: "the PlayCanvas engine, also as a flipbook, and SuperSplat",
    extension: ".sog",
    write: |file, splats| write_sog(file, splats.gaussians),
    read: None,
};

/// Entries of a codebook: a byte.
const CODES: usize = 256;
/// Harmonics of a file: so many different ones, of 65 536 that the format could name.
const PALETTE: usize = 4096;
/// Palette entries in a row of their texture.
const PALETTE_COLUMNS: usize = 64;
/// Largest edge of a WebP image (px).
const MAX_EDGE: usize = 16_383;

/// Writes a bundled SOG file (`.sog`). The order is kept.
///
/// # Errors
/// When the columns do not match, there are more Gaussians than a texture holds, or the file cannot be written.
pub(crate) fn write_sog(path: &Path, gaussians: &Gaussians) -> Result<(), SplatError> {
    gaussians.validate().map_err(|e| Problem::Shape(e.to_string())).in_file(path)?;
    let bytes = bundle(gaussians).in_file(path)?;
    write_atomically(path, |out| out.write_all(&bytes)).in_file(path)
}

fn bundle(g: &Gaussians) -> Result<Vec<u8>, Problem> {
    let size = texture_size(g.len())?;
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: &str, texture: &Texture| store(&mut zip, name, &texture.encode()?);
    let (means, low, high) = mean_textures(g, size);
    add("means_l.webp", &means[0])?;
    add("means_u.webp", &means[1])?;
    add("quats.webp", &Texture::filled(size, (0..g.len()).map(|i| rotation(g.quats[i]))))?;
    let scales = codebook(g.log_scales.as_flattened().iter().copied(), CODES);
    let code = |book: &[f32], rgb: [f32; 3]| rgb.map(|v| nearest(book, v) as u8);
    let scale = |i: usize| with_alpha(code(&scales, g.log_scales[i]), 255);
    add("scales.webp", &Texture::filled(size, (0..g.len()).map(scale)))?;
    let colours = codebook((0..g.len()).flat_map(|i| g.sh_of(i)[0]), CODES);
    let colour =
        |i: usize| with_alpha(code(&colours, g.sh_of(i)[0]), to_byte(sigmoid(g.opacity_logits[i]) * 255.0));
    add("sh0.webp", &Texture::filled(size, (0..g.len()).map(colour)))?;
    let mut meta = json!({
        "version": 2,
        "asset": { "generator": concat!("ffgs ", env!("CARGO_PKG_VERSION")) },
        "count": g.len(),
        "means": { "mins": low, "maxs": high, "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": filled_codebook(scales), "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": filled_codebook(colours), "files": ["sh0.webp"] },
    });
    if g.filter == PixelFilter::Compensated {
        meta["model"] = "antialiased".into();
    }
    if g.sh_degree() > 0 && !g.is_empty() {
        let harmonics = Harmonics::of(g, size);
        add("shN_centroids.webp", &harmonics.centroids)?;
        add("shN_labels.webp", &harmonics.labels)?;
        meta["shN"] = harmonics.meta;
    }
    store(&mut zip, "meta.json", meta.to_string().as_bytes())?;
    Ok(zip.finish()?.into_inner())
}

fn store(zip: &mut ZipWriter<Cursor<Vec<u8>>>, name: &str, bytes: &[u8]) -> Result<(), Problem> {
    zip.start_file(name, SimpleFileOptions::default().compression_method(CompressionMethod::Stored))?;
    Ok(zip.write_all(bytes)?)
}

/// Edges that hold `count` texels, multiples of four.
fn texture_size(count: usize) -> Result<[usize; 2], Problem> {
    let width = ((count as f64).sqrt().ceil() as usize).max(1).next_multiple_of(4);
    let height = count.div_ceil(width).max(1).next_multiple_of(4);
    if width > MAX_EDGE || height > MAX_EDGE {
        return Err(Problem::Shape(format!("{count} Gaussians do not fit in one SOG file")));
    }
    Ok([width, height])
}

/// An RGBA image.
struct Texture {
    size: [usize; 2],
    texels: Vec<[u8; 4]>,
}

impl Texture {
    fn filled(size: [usize; 2], texels: impl Iterator<Item = [u8; 4]>) -> Self {
        let mut texels: Vec<[u8; 4]> = texels.collect();
        texels.resize(size[0] * size[1], [0; 4]);
        Self { size, texels }
    }

    fn encode(&self) -> Result<Vec<u8>, Problem> {
        let mut out = Vec::new();
        let [width, height] = self.size.map(|edge| edge as u32);
        let encoder = WebPEncoder::new(&mut out);
        encoder.encode(self.texels.as_flattened(), width, height, ColorType::Rgba8)?;
        Ok(out)
    }
}

fn with_alpha([r, g, b]: [u8; 3], alpha: u8) -> [u8; 4] {
    [r, g, b, alpha]
}

/// All 256 entries, the last one repeated.
fn filled_codebook(mut book: Vec<f32>) -> Vec<f32> {
    book.resize(CODES, book[book.len() - 1]);
    book
}

/// `sign(x) ln(1 + |x|)`: far positions may be coarser.
fn squeezed(x: f32) -> f32 {
    x.signum() * x.abs().ln_1p()
}

/// Low and high bytes of 16-bit positions between the bounds that follow.
fn mean_textures(g: &Gaussians, size: [usize; 2]) -> ([Texture; 2], [f32; 3], [f32; 3]) {
    let points = || g.means.iter().map(|p| p.map(squeezed));
    let first = points().next().unwrap_or_default();
    let low = points().fold(first, |m, p| [0, 1, 2].map(|a| m[a].min(p[a])));
    let high = points().fold(first, |m, p| [0, 1, 2].map(|a| m[a].max(p[a])));
    let step = [0, 1, 2].map(|a| if high[a] > low[a] { 65_535.0 / (high[a] - low[a]) } else { 0.0 });
    let word = |p: [f32; 3]| [0, 1, 2].map(|a| ((p[a] - low[a]) * step[a]).round() as u16);
    let part = |byte: usize| {
        Texture::filled(size, points().map(|p| with_alpha(word(p).map(|w| w.to_le_bytes()[byte]), 255)))
    };
    ([part(0), part(1)], low, high)
}

fn rotation(quat: [f32; 4]) -> [u8; 4] {
    let (largest, rest) = smallest_three(quat);
    with_alpha(rest.map(|v| to_byte(255.0 * (v * SQRT_2 * 0.5 + 0.5))), 252 + largest as u8)
}

/// Harmonics above degree 0: a palette of them, and a label per Gaussian.
struct Harmonics {
    centroids: Texture,
    labels: Texture,
    meta: Value,
}

impl Harmonics {
    fn of(g: &Gaussians, size: [usize; 2]) -> Self {
        let rows: Vec<Vec<f32>> = (0..g.len()).map(|i| g.sh_of(i)[1..].as_flattened().to_vec()).collect();
        let palette = palette(&rows, PALETTE);
        let book = codebook(palette.centroids.iter().flatten().copied(), CODES);
        let above = g.sh_stride() - 1;
        let count = palette.centroids.len();
        let texels = palette.centroids.iter().flat_map(|row| {
            row.as_chunks::<3>().0.iter().map(|rgb| with_alpha(rgb.map(|v| nearest(&book, v) as u8), 255))
        });
        let label = |&label: &usize| with_alpha([(label & 255) as u8, (label >> 8) as u8, 0], 255);
        Self {
            centroids: Texture::filled([PALETTE_COLUMNS * above, count.div_ceil(PALETTE_COLUMNS)], texels),
            labels: Texture::filled(size, palette.labels.iter().map(label)),
            meta: json!({ "count": count, "bands": g.sh_degree(), "codebook": filled_codebook(book.clone()),
                "files": ["shN_centroids.webp", "shN_labels.webp"] }),
        }
    }
}
