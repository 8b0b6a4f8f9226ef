//! Binary glTF 2.0 with the extension `KHR_gaussian_splatting`, uncompressed. The layout is that of splat-transform's writer.

use crate::error::InFile;
use crate::format::Format;
use crate::quantise::to_byte;
use crate::{Problem, SplatError};
use ffgs_core::{Gaussians, SH_C0, sigmoid, write_atomically};
use serde_json::{Map, Value, json};
use std::io::Write;
use std::path::Path;

pub(crate) const FORMAT: Format = Format {
    name: "glb",
    summary: "viewers of glTF with KHR_gaussian_splatting",
    extension: ".glb",
    write: |file, splats| write_glb(file, splats.gaussians),
    read: None,
};

const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const ARRAY_BUFFER: u32 = 34962;
const MAGIC: u32 = 0x4654_6c67;
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BINARY_CHUNK: u32 = 0x004e_4942;
/// Coefficients of each degree.
const OF_DEGREE: [usize; 4] = [1, 3, 5, 7];

/// Writes a GLB file. The extension knows no opacity compensation: hand over Gaussians of the plain filter.
///
/// # Errors
/// When the columns do not match, or the file cannot be written or would be larger than the format allows (4 GiB).
fn write_glb(path: &Path, gaussians: &Gaussians) -> Result<(), SplatError> {
    gaussians.validate().map_err(|e| Problem::Shape(e.to_string())).in_file(path)?;
    let attributes = attributes(gaussians);
    let mut text = document(gaussians, &attributes).to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary: usize = attributes.iter().map(|a| a.bytes.len()).sum();
    let total = 28 + text.len() + binary;
    let word = |size: usize| -> Result<u32, Problem> {
        u32::try_from(size).map_err(|_| Problem::Shape("more than 4 GiB do not fit in a GLB".into()))
    };
    write_atomically(path, |out| -> Result<(), Problem> {
        for part in [MAGIC, 2, word(total)?, word(text.len())?, JSON_CHUNK] {
            out.write_all(&part.to_le_bytes())?;
        }
        out.write_all(&text)?;
        out.write_all(&word(binary)?.to_le_bytes())?;
        out.write_all(&BINARY_CHUNK.to_le_bytes())?;
        attributes.iter().try_for_each(|a| out.write_all(&a.bytes))?;
        Ok(())
    })
    .in_file(path)
}

/// A column of the file.
struct Attribute {
    name: String,
    component: u32,
    shape: &'static str,
    bytes: Vec<u8>,
}

impl Attribute {
    fn floats(name: &str, shape: &'static str, values: impl Iterator<Item = f32>) -> Self {
        let bytes = values.flat_map(f32::to_le_bytes).collect();
        Self { name: name.to_owned(), component: FLOAT, shape, bytes }
    }
}

fn attributes(g: &Gaussians) -> Vec<Attribute> {
    let own = |name: &str| format!("KHR_gaussian_splatting:{name}");
    let fallback = (0..g.len()).flat_map(|i| {
        let [r, gr, b] = g.sh_of(i)[0].map(|v| to_byte((SH_C0 * v + 0.5) * 255.0));
        [r, gr, b, to_byte(sigmoid(g.opacity_logits[i]) * 255.0)]
    });
    let mut out = vec![
        Attribute::floats("POSITION", "VEC3", g.means.as_flattened().iter().copied()),
        Attribute {
            name: "COLOR_0".into(),
            component: UNSIGNED_BYTE,
            shape: "VEC4",
            bytes: fallback.collect(),
        },
        Attribute::floats(&own("ROTATION"), "VEC4", g.quats.iter().flat_map(|&q| unit_xyzw(q))),
        Attribute::floats(&own("SCALE"), "VEC3", g.log_scales.as_flattened().iter().map(|s| s.exp())),
        Attribute::floats(&own("OPACITY"), "SCALAR", g.opacity_logits.iter().map(|&o| sigmoid(o))),
    ];
    for degree in 0..=g.sh_degree() {
        for k in 0..OF_DEGREE[degree] {
            let values = (0..g.len()).flat_map(|i| g.sh_of(i)[degree * degree + k]);
            out.push(Attribute::floats(&own(&format!("SH_DEGREE_{degree}_COEF_{k}")), "VEC3", values));
        }
    }
    out
}

fn unit_xyzw([w, x, y, z]: [f32; 4]) -> [f32; 4] {
    let length = (w * w + x * x + y * y + z * z).sqrt();
    if length > 0.0 { [x, y, z, w].map(|v| v / length) } else { [0.0, 0.0, 0.0, 1.0] }
}

fn document(g: &Gaussians, attributes: &[Attribute]) -> Value {
    let (mut views, mut accessors, mut names) = (Vec::new(), Vec::new(), Map::new());
    let mut offset = 0;
    for (i, a) in attributes.iter().enumerate() {
        let length = a.bytes.len();
        views
            .push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": ARRAY_BUFFER }));
        let mut accessor = json!({ "bufferView": i, "byteOffset": 0, "componentType": a.component,
            "count": g.len(), "type": a.shape });
        if a.component == UNSIGNED_BYTE {
            accessor["normalized"] = true.into();
        }
        if a.name == "POSITION" {
            let [low, high] = bounds(g);
            (accessor["min"], accessor["max"]) = (json!(low), json!(high));
        }
        accessors.push(accessor);
        names.insert(a.name.clone(), i.into());
        offset += length;
    }
    let splatting = json!({ "kernel": "ellipse", "colorSpace": "srgb_rec709_display",
        "sortingMethod": "cameraDistance", "projection": "perspective" });
    json!({
        "asset": { "version": "2.0", "generator": concat!("ffgs ", env!("CARGO_PKG_VERSION")) },
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "buffers": [{ "byteLength": offset }], "bufferViews": views, "accessors": accessors,
        "meshes": [{ "primitives": [{ "attributes": names, "mode": 0,
            "extensions": { "KHR_gaussian_splatting": splatting } }] }],
    })
}

/// Smallest and largest coordinates; zero for an empty set.
fn bounds(g: &Gaussians) -> [[f32; 3]; 2] {
    let mut points = g.means.iter();
    let Some(&first) = points.next() else { return [[0.0; 3]; 2] };
    points.fold([first; 2], |[low, high], p| {
        [[0, 1, 2].map(|a| low[a].min(p[a])), [0, 1, 2].map(|a| high[a].max(p[a]))]
    })
}
