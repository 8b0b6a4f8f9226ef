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
    /// The training and test cameras, with the exposures that `run` has found so far. One that cannot be read is left out with a
    /// warning: the page shows the rest without it.
    ///
    /// # Errors
    /// When the exposures of the run cannot be read.
    pub(crate) fn of(capture: &dyn Capture, run: Option<&RunFolder>, with_photographs: bool) -> Result<Self> {
        let of_frame = |frame| run.map_or_else(|| Ok(Exposures::default()), |run| read_exposures(run, frame));
        let exposures = (0..capture.frames()).map(of_frame).collect::<Result<Vec<_>>>()?;
        let mut views = Vec::new();
        for split in [Split::Test, Split::Train] {
            for (index, name) in capture.views(split).iter().enumerate() {
                let exposed = || offsets(capture, split, index, &exposures);
                match view_of(capture, split, index, with_photographs).and_then(|view| Ok((view, exposed()?)))
                {
                    Ok((view, exposures)) => views.extend(view.map(|view| ViewOf { exposures, ..view })),
                    Err(error) => tracing::warn!("the page lacks camera {name}: {error:#}"),
                }
            }
        }
        Ok(Self { views })
    }
}

/// The exposures of a view in the frames that it has.
fn offsets(
    capture: &dyn Capture,
    split: Split,
    view: usize,
    exposures: &[Exposures],
) -> Result<Vec<[f64; 3]>> {
    let of_frame = |(frame, exposures): (usize, &Exposures)| {
        exposures.of(capture, ViewAt { split, view, frame }).map(|exposure| exposure.offsets)
    };
    let frames = exposures.iter().enumerate().take(capture.frames_of(split));
    Ok(shortened(frames.map(of_frame).collect::<Result<_>>()?))
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
        name: capture.views(split)[index].clone(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plugins::registry::open_capture;
    use ffgs_core::{Camera, ImageRgb8, Mask};
    use ffgs_method::{Fault, Points};
    use std::path::Path;

    /// The sample, in which the camera of this name cannot be read in frame 1.
    #[derive(Debug)]
    struct Damaged(Box<dyn Capture>, &'static str);

    impl Capture for Damaged {
        fn root(&self) -> &Path {
            self.0.root()
        }

        fn frames(&self) -> usize {
            self.0.frames()
        }

        fn views(&self, split: Split) -> &[String] {
            self.0.views(split)
        }

        fn camera(&self, at: ViewAt) -> Result<Camera, Fault> {
            if at.frame == 1 && self.views(at.split)[at.view] == self.1 {
                return Err(Fault::new(self.root(), "damaged", "copy it again"));
            }
            self.0.camera(at)
        }

        fn image(&self, at: ViewAt) -> Result<ImageRgb8, Fault> {
            self.0.image(at)
        }

        fn mask(&self, at: ViewAt) -> Result<Option<Mask>, Fault> {
            self.0.mask(at)
        }

        fn points(&self) -> Result<Option<Points>, Fault> {
            self.0.points()
        }
    }

    #[test]
    fn a_camera_that_cannot_be_read_is_left_out_and_no_other() {
        let names = |damaged| {
            let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
            let views = Views::of(&Damaged(open_capture(&sample).unwrap(), damaged), None, false).unwrap();
            views.views.into_iter().map(|view| view.name).collect::<Vec<String>>()
        };
        let mut all = names("none");
        assert!(all.len() > 2 && all.iter().any(|name| name == "trk004"));
        all.retain(|name| name != "trk004");
        assert_eq!(names("trk004"), all);
    }
}
