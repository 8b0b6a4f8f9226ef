//! `cameras.json`: the cameras of a capture, for the page that plays a stream.

use crate::outputs::exposure_files::read_exposures;
use crate::outputs::folder::RunFolder;
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
    /// Per frame the offsets of the log odds of red, green, blue in the photographs; one where they do not change, none where they are zero.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    exposures: Vec<[f64; 3]>,
}

impl Views {
    /// The training and test cameras, those that cannot be read left out; with the exposures that `run` has found so far.
    pub(crate) fn of(capture: &dyn Capture, run: Option<&RunFolder>, with_photographs: bool) -> Result<Self> {
        let of_frame = |frame| run.map_or_else(|| Ok(Exposures::default()), |run| read_exposures(run, frame));
        let exposures = (0..capture.frames()).map(of_frame).collect::<Result<Vec<_>>>()?;
        let mut views = Vec::new();
        for split in [Split::Test, Split::Train] {
            for (index, name) in capture.views(split).iter().enumerate() {
                let view = view_of(capture, split, index, name, with_photographs)?;
                let of_frame = |(frame, of_frame): (usize, &Exposures)| {
                    of_frame
                        .of(capture, ViewAt { split, view: index, frame })
                        .map(|exposure| exposure.offsets)
                };
                let frames = exposures.iter().enumerate().take(capture.frames_of(split));
                let exposures = frames.map(of_frame).collect::<Result<Vec<_>>>()?;
                views.extend(view.map(|view| ViewOf { exposures: shortened(exposures), ..view }));
            }
        }
        Ok(Self { views })
    }
}

/// One value for all frames where it is the same in all, none where that is neutral.
fn shortened(mut offsets: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    if offsets.iter().all(|o| *o == offsets[0]) {
        offsets.truncate(1);
    }
    if offsets == [Exposure::NEUTRAL.offsets] { Vec::new() } else { offsets }
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
        exposures: Vec::new(),
    }))
}
