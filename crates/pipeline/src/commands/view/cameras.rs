//! `cameras.json`: the cameras of a capture, for the page that plays a stream.

use anyhow::Result;
use ffgs_core::Exposure;
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_reconstruction::Exposures;
use serde::Serialize;

/// `cameras.json`: the cameras of a capture.
#[derive(Debug, Serialize)]
pub(crate) struct Views {
    views: Vec<ViewOf>,
}

#[derive(Debug, Serialize)]
struct ViewOf {
    name: String,
    split: String,
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Per frame the first three rows of the pose, row by row; one where the camera stands still.
    world_from_camera: Vec<[f64; 12]>,
    /// Per frame, where the page has them.
    photographs: Option<Vec<String>>,
    /// Offsets of the log odds of red, green, blue in the photographs, where cameras differ.
    #[serde(skip_serializing_if = "Option::is_none")]
    exposure: Option<[f64; 3]>,
}

impl Views {
    /// The training and test cameras, those that cannot be read left out.
    pub(crate) fn of(capture: &dyn Capture, exposures: &Exposures, with_photographs: bool) -> Result<Self> {
        let mut views = Vec::new();
        for split in [Split::Test, Split::Train] {
            for (index, name) in capture.views(split).iter().enumerate() {
                let view = view_of(capture, split, index, name, with_photographs)?;
                let exposure = exposures.of(capture, ViewAt { split, view: index, frame: 0 })?;
                let exposure = (exposure != Exposure::NEUTRAL).then_some(exposure.offsets);
                views.extend(view.map(|view| ViewOf { exposure, ..view }));
            }
        }
        Ok(Self { views })
    }
}

fn view_of(
    capture: &dyn Capture,
    split: Split,
    index: usize,
    name: &str,
    with_photographs: bool,
) -> Result<Option<ViewOf>> {
    let frames = 0..capture.frames_of(split);
    let cameras = frames.clone().map(|frame| capture.camera(ViewAt { split, view: index, frame }));
    let cameras = cameras.collect::<Result<Vec<_>, _>>()?;
    let Some(first) = cameras.first() else { return Ok(None) };
    let (lens, size) = (first.intrinsics(), first.size());
    let pose = |camera: &ffgs_core::Camera| {
        let (turn, centre) = (camera.rotation().transpose(), camera.center());
        let row = |k: usize| [turn.row(k).x, turn.row(k).y, turn.row(k).z, centre[k]];
        let [a, b, c] = [0, 1, 2].map(row);
        std::array::from_fn(|i| [a, b, c][i / 4][i % 4])
    };
    let mut poses: Vec<[f64; 12]> = cameras.iter().map(pose).collect();
    if poses.iter().all(|p| *p == poses[0]) {
        poses.truncate(1);
    }
    let photographs = frames.map(|t| format!("photo/{split}/{index}/{t}.png")).collect();
    Ok(Some(ViewOf {
        name: name.to_owned(),
        split: split.to_string(),
        width: size.width,
        height: size.height,
        fx: lens.fx,
        fy: lens.fy,
        cx: lens.cx,
        cy: lens.cy,
        world_from_camera: poses,
        photographs: with_photographs.then_some(photographs),
        exposure: None,
    }))
}
