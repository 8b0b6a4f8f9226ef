//! Writes a capture folder: what `synthetic` and `enlarge` share.

use anyhow::{Context, Result};
use exr::prelude::{SpecificChannels, Text, WritableImage, f16};
use ffgs_arrays::NpzWriter;
use ffgs_core::{Camera, DenseMotion, ImageRgb8, Mask, TrackSet, ViewMotion};
use ffgs_dataset::{write_image, write_mask};
use ffgs_method::{Points, Split};
use ffgs_pipeline::outputs::json::write_json;
use glam::DVec2;
use serde_json::{Value, json};
use std::path::PathBuf;

/// A capture folder that is being written.
pub(crate) struct CaptureWriter(pub(crate) PathBuf);

impl CaptureWriter {
    /// An empty place for a capture.
    ///
    /// # Errors
    /// When something is there already.
    pub(crate) fn new(folder: PathBuf) -> Result<Self> {
        let empty = std::fs::read_dir(&folder).map_or(true, |mut entries| entries.next().is_none());
        anyhow::ensure!(empty, "{} is not empty; choose another --out or remove it", folder.display());
        Ok(Self(folder))
    }

    /// Image and mask of a view.
    pub(crate) fn view(&self, camera: &str, frame: usize, image: &ImageRgb8, mask: &Mask) -> Result<()> {
        write_image(&self.0.join(format!("ims/{camera}/{frame:06}.png")), image)?;
        Ok(write_mask(&self.0.join(format!("seg/{camera}/{frame:06}.png")), mask)?)
    }

    /// The camera list of a split; `cameras` are (frames, views).
    pub(crate) fn cameras(&self, split: Split, names: &[String], cameras: &[Vec<Camera>]) -> Result<()> {
        let Some(first) = cameras.first().filter(|frame| !frame.is_empty()) else { return Ok(()) };
        let of = |entry: &dyn Fn(usize, usize, &Camera) -> Value| -> Value {
            let frame = |(t, views): (usize, &Vec<Camera>)| -> Value {
                views.iter().enumerate().map(|(v, camera)| entry(t, v, camera)).collect()
            };
            cameras.iter().enumerate().map(frame).collect()
        };
        let rows = |_: usize, _: usize, camera: &Camera| {
            let pose = camera.camera_from_world().transpose().to_cols_array_2d();
            json!(pose)
        };
        let meta = json!({
            "w": first.iter().map(|c| c.size().width).collect::<Vec<_>>(),
            "h": first.iter().map(|c| c.size().height).collect::<Vec<_>>(),
            "k": of(&|_, _, camera| {
                let i = camera.intrinsics();
                json!([[i.fx, 0.0, i.cx], [0.0, i.fy, i.cy], [0.0, 0.0, 1.0]])
            }),
            "w2c": of(&rows),
            "fn": of(&|t, v, _| json!(format!("{}/{t:06}.png", names[v]))),
            "cam_id": of(&|_, v, _| json!(v)),
        });
        write_json(&self.0.join(format!("{}_meta.json", name_of(split))), &meta)
    }

    /// The initial points.
    pub(crate) fn points(&self, points: &Points) -> Result<()> {
        let row = |i: usize| {
            let moving = f32::from(u8::from(points.foreground[i]));
            let ([x, y, z], [r, g, b]) = (points.positions[i], points.colours[i]);
            [x, y, z, r, g, b, moving]
        };
        let rows: Vec<f32> = (0..points.len()).flat_map(row).collect();
        let mut writer = NpzWriter::new();
        Ok(writer.f32("data", &[points.len(), 7], &rows).write(&self.0.join("init_pt_cld.npz"))?)
    }

    /// The list of trackers: name and level, of which dense ones are optical flow.
    pub(crate) fn trackers(&self, trackers: &[(String, bool)]) -> Result<()> {
        let entry = |(name, dense): &(String, bool)| {
            let (level, format) = if *dense { ("dense", "exr") } else { ("medium", "npz") };
            json!({
                "name": name, "level": level, "format": format, "pixel_center": "half",
                "pattern": format!("{name}/{{camera}}/{{frame:06}}.{format}"),
            })
        };
        let entries: Vec<Value> = trackers.iter().map(entry).collect();
        write_json(&self.0.join("tracks/tracks.json"), &json!({ "trackers": entries }))
    }

    /// What a tracker found in a view from `frame - 1` to `frame`.
    pub(crate) fn motion(
        &self,
        tracker: &str,
        camera: &str,
        frame: usize,
        motion: &ViewMotion,
    ) -> Result<()> {
        let stem = self.0.join(format!("tracks/{tracker}/{camera}/{frame:06}"));
        match motion {
            ViewMotion::Tracks(TrackSet { src, tgt, visibility }) => {
                let shape = [src.len(), 2];
                let mut writer = NpzWriter::new();
                writer.f32("src", &shape, src.as_flattened()).f32("tgt", &shape, tgt.as_flattened());
                writer.f32("visibility", &[src.len()], visibility);
                Ok(writer.write(&stem.with_extension("npz"))?)
            }
            ViewMotion::Dense(dense) => write_flow(&stem.with_extension("exr"), dense),
        }
    }
}

fn name_of(split: Split) -> &'static str {
    match split {
        Split::Train => "train",
        Split::Test => "test",
        Split::Init => "init",
    }
}

/// Flow as half floats; what is not known is not a number.
fn write_flow(path: &std::path::Path, dense: &DenseMotion) -> Result<()> {
    std::fs::create_dir_all(path.parent().context("a folder")?)?;
    let width = dense.size.width;
    let pixel = |at: exr::prelude::Vec2<usize>| {
        let p = at.1 * width + at.0;
        let [u, v] = if dense.confidence[p] > 0.0 { dense.flow[p] } else { [f32::NAN; 2] };
        (f16::from_f32(u), f16::from_f32(v))
    };
    let channels = SpecificChannels::build()
        .with_channel::<f16>(Text::from("U"))
        .with_channel::<f16>(Text::from("V"))
        .with_pixel_fn(pixel);
    let image = exr::prelude::Image::from_channels((width, dense.size.height), channels);
    image.write().to_file(path).with_context(|| format!("cannot write {}", path.display()))
}

/// A pixel's position and where it goes, as a tracker writes them.
pub(crate) fn correspondences(pairs: impl Iterator<Item = (DVec2, DVec2)>) -> TrackSet {
    let (src, tgt): (Vec<_>, Vec<_>) =
        pairs.map(|(a, b)| (a.as_vec2().to_array(), b.as_vec2().to_array())).unzip();
    TrackSet { visibility: vec![1.0; src.len()], src, tgt }
}
