//! Which Gaussians move: those inside the masks (Algorithm 1, line 2).

use crate::outside::{HIDDEN_BELOW, is_outside, looking_at, shown_weights};
use crate::reconstructor::{Reconstructor, State};
use anyhow::Result;
use ffgs_core::{
    Camera, Dynamic, Gaussians, Mask, Scene, SkyCube, StageLog, TrainingView, spatial_order, stage,
};
use ffgs_fusion::{Silhouettes, initial_covariance};
use ffgs_motion::{MarkingConfig, join, pixel_sizes};
use ffgs_trainer::BackgroundConfig;
use glam::{DMat3, DVec3};
use std::sync::Arc;
use std::time::Instant;

/// What Gaussians are counted as that leave the dynamic layer for the static one.
pub(crate) const STANDS_STILL: &str = "stands still";

impl Reconstructor<'_> {
    /// Which Gaussians move, decided again by the masks of t-1.
    pub(crate) fn mark_again(&self, state: &mut State, log: &mut StageLog) -> Result<()> {
        let start = Instant::now();
        let State { scene, views, static_lane, .. } = state;
        scene.take_back();
        let [started, stopped] = mark_again(&self.config.marking, &self.config.background, scene, views)?;
        if started + stopped > 0 {
            static_lane.forget();
        }
        log.change("starts to move", started);
        log.change(STANDS_STILL, stopped);
        log.since(stage::MARKING, start);
        Ok(())
    }
}

/// The trained Gaussians as layers: those inside the masks of all that was trained on (`training`) move, unless the photographs show them outside. Of the first
/// `standing`, which stood still before, those stay that no photograph shows. `views` are those that later frames have: they say how large a pixel is where a
/// Gaussian lies.
///
/// # Errors
/// When the masks do not fit their cameras.
pub(crate) fn split(
    marking: &MarkingConfig,
    (all, standing): (&Gaussians, usize),
    sky: SkyCube,
    views: &[TrainingView],
    training: &[TrainingView],
) -> Result<Scene> {
    let places = all.positions();
    let mut moving = silhouettes(marking, training)?.hold(&places)?;
    for (i, weights) in shown_weights(marking, all, training).into_iter().enumerate() {
        let stays = i < standing && weights[1] < HIDDEN_BELOW;
        moving[i] &= !stays && !is_outside(marking, weights, || looking_at(places[i], training));
    }
    // Training left what it added at the end; all later frames keep this order.
    let order = spatial_order(&all.means);
    let indices = |keep: bool| order.iter().copied().filter(|&i| moving[i] == keep).collect::<Vec<_>>();
    let gaussians = all.select(&indices(true));
    if gaussians.is_empty() {
        tracing::warn!("no Gaussian lies inside the masks: nothing is dynamic");
    }
    let covariances = covariances(&gaussians, views);
    let growth_limit = gaussians.len();
    let mut dynamic = Dynamic { gaussians, covariances, growth_limit, ..Dynamic::default() };
    dynamic.number_new();
    Ok(Scene::new(all.select(&indices(false)), dynamic, sky))
}

/// The layers of t-1 with their border drawn anew by `views`, of t-1: static Gaussians inside the masks move from now on, moving ones outside stand still.
/// Returns the number of both.
///
/// # Errors
/// When the masks do not fit their cameras.
fn mark_again(
    marking: &MarkingConfig,
    background: &BackgroundConfig,
    scene: &mut Scene,
    views: &[TrainingView],
) -> Result<[usize; 2]> {
    let silhouettes = silhouettes(marking, views)?;
    let indices = |held: Vec<bool>| (0..held.len()).partition(|&i| held[i]);
    let (starting, standing): (Vec<usize>, Vec<usize>) =
        indices(silhouettes.hold(&scene.static_layer.positions())?);
    let (moving, stopping): (Vec<usize>, Vec<usize>) =
        indices(silhouettes.hold(&scene.dynamic.gaussians.positions())?);
    if starting.is_empty() && stopping.is_empty() {
        return Ok([0; 2]);
    }
    let stopped = scene.dynamic.gaussians.select(&stopping);
    let started = scene.static_layer.select(&starting);
    scene.dynamic.keep(&moving);
    scene.dynamic.growth_limit = scene.dynamic.growth_limit.saturating_sub(stopping.len());
    join(&mut scene.dynamic, &started, views);
    // What stood still has come nowhere, and its place is known.
    let Dynamic { steps, covariances: all, .. } = &mut scene.dynamic;
    steps.iter_mut().skip(moving.len()).for_each(|step| *step = DVec3::ZERO);
    all.splice(moving.len().., covariances(&started, views));
    // Those that stop come before those that start go: a column without rows would count as absent.
    let came = scene.static_layer.len()..scene.static_layer.len() + stopping.len();
    add_static(background, scene, &stopped);
    let kept: Vec<usize> = standing.into_iter().chain(came).collect();
    scene.static_layer = Arc::new(scene.static_layer.select(&kept));
    follow(&mut scene.hidden, &kept, 0, 0);
    follow(&mut scene.static_colours, &kept, 0, [0.0; 2]);
    Ok([starting.len(), stopping.len()])
}

/// Adds Gaussians that moved to the static layer. They are in sight, and nothing is known of how their colours change.
pub(crate) fn add_static(background: &BackgroundConfig, scene: &mut Scene, stopped: &Gaussians) {
    let all: Vec<usize> = (0..scene.static_layer.len()).collect();
    Arc::make_mut(&mut scene.static_layer).extend(stopped);
    follow(&mut scene.hidden, &all, stopped.len(), 0);
    let unknown =
        [background.solve_sh0_change, background.solve_sh_rest_change].map(|change| change * change);
    follow(&mut scene.static_colours, &all, stopped.len(), unknown);
}

/// A column of the static layer, where there is one, of which only `standing` stay and to which `stopping` come.
fn follow<T: Copy>(column: &mut Vec<T>, standing: &[usize], stopping: usize, value: T) {
    if !column.is_empty() {
        *column = standing.iter().map(|&i| column[i]).collect();
        column.resize(standing.len() + stopping, value);
    }
}

/// Cameras of the views, and their masks.
pub(crate) fn cameras_and_masks(views: &[TrainingView]) -> (Vec<Camera>, Vec<Mask>) {
    views.iter().map(|v| (v.camera, v.mask.clone())).unzip()
}

fn silhouettes(marking: &MarkingConfig, views: &[TrainingView]) -> Result<Silhouettes> {
    let (cameras, masks) = cameras_and_masks(views);
    Ok(Silhouettes::new(&cameras, &masks, marking.dilation, marking.slack())?)
}

/// Position covariances (m^2) of Gaussians that stood still until now.
fn covariances(gaussians: &Gaussians, views: &[TrainingView]) -> Vec<DMat3> {
    let pixel_m = pixel_sizes(&gaussians.positions(), views.iter().map(|view| &view.camera));
    let smallest = |s: &[f32; 3]| f64::from(s.iter().copied().fold(f32::INFINITY, f32::min).exp());
    let axes = gaussians.log_scales.iter().map(smallest);
    axes.zip(pixel_m).map(|(axis, pixel)| initial_covariance(axis, pixel)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{ball, photographs};
    use ffgs_core::{ImageRgb8, ImageSize, Intrinsics};
    use glam::{DMat4, Vec3};

    const SIZE: ImageSize = ImageSize { width: 40, height: 30 };

    /// Four cameras side by side whose masks hold the left half of the image.
    fn views() -> Vec<TrainingView> {
        let view = |v: i32| {
            let intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 20.0, cy: 15.0 };
            let pose = DMat4::from_translation(DVec3::X * 0.01 * f64::from(v));
            let left = (0..SIZE.pixels()).map(|p| u8::from(p % SIZE.width < 20)).collect();
            let image = ImageRgb8::new(SIZE, vec![0; 3 * SIZE.pixels()]).unwrap();
            let camera = Camera::new(intrinsics, pose, SIZE).unwrap();
            TrainingView { camera, image, mask: Mask::new(SIZE, left).unwrap() }
        };
        (0..4).map(view).collect()
    }

    fn at(places: &[f32]) -> Gaussians {
        let mut gaussians = Gaussians::zeros(places.len(), 0);
        gaussians.means.iter_mut().zip(places).for_each(|(mean, &x)| *mean = [x, 0.0, 4.0]);
        gaussians
    }

    #[test]
    fn what_stood_still_inside_the_body_is_marked_again_as_such() {
        let mut all = ball(Vec3::ZERO).select(&[0]);
        all.means[0] = [0.0; 3];
        all.extend(&ball(Vec3::ZERO));
        let views = photographs(&ball(Vec3::ZERO));
        let standing = |count| {
            let sky = SkyCube::filled(1, [0.0; 3]);
            split(&MarkingConfig::default(), (&all, count), sky, &views, &views).unwrap().static_layer.len()
        };
        assert_eq!([standing(0), standing(1)], [0, 1], "no view shows it");
        assert!(standing(all.len()) < 1000, "what the views show is inside the masks");
    }

    #[test]
    fn what_enters_the_masks_moves_and_what_leaves_them_stands_still() {
        let (marking, background) = (MarkingConfig::literal(), BackgroundConfig::default());
        let sky = SkyCube::filled(1, [0.0; 3]);
        let mut scene = split(&marking, (&at(&[-1.0, -0.5, 1.0]), 0), sky, &views(), &views()).unwrap();
        assert_eq!(scene.dynamic.ids, [0, 1]);
        let ids = |scene: &Scene, x: f32| {
            scene.dynamic.gaussians.means.iter().position(|m| m[0] == x).map(|i| scene.dynamic.ids[i])
        };
        let moved = ids(&scene, -1.0);
        scene.dynamic.gaussians.means.iter_mut().filter(|m| m[0] == -0.5).for_each(|m| m[0] = 0.5);
        scene.dynamic.steps = vec![DVec3::X; 2];
        Arc::make_mut(&mut scene.static_layer).means[0][0] = -0.8;
        (scene.hidden, scene.static_colours) = (vec![2], vec![[0.1, 0.2]]);
        let counts = mark_again(&marking, &background, &mut scene, &views()).unwrap();
        assert_eq!(counts, [1, 1]);
        assert_eq!(scene.static_layer.means, [[0.5, 0.0, 4.0]]);
        assert_eq!((&scene.hidden, scene.static_colours.len()), (&vec![0], 1));
        assert!(
            scene.static_colours[0][0] > 0.05,
            "nothing is known of its colour: {:?}",
            scene.static_colours
        );
        assert_eq!(scene.dynamic.gaussians.means, [[-1.0, 0.0, 4.0], [-0.8, 0.0, 4.0]]);
        assert_eq!(
            (ids(&scene, -1.0), ids(&scene, -0.8)),
            (moved, Some(2)),
            "an id stays, and none is used twice"
        );
        assert_eq!(scene.dynamic.steps, [DVec3::X, DVec3::ZERO]);
        assert_eq!(scene.dynamic.covariances.len(), 2);
        assert_eq!(
            mark_again(&marking, &background, &mut scene, &views()).unwrap(),
            [0; 2],
            "nothing changes twice"
        );
    }
}
