//! Moving Gaussians where masks are not explained: what enters after frame 0, or was lost (docs/adr/0049-birth.md).

use crate::config::ReconstructionConfig;
use crate::devices::Devices;
use crate::reconstructor::Reconstructor;
use anyhow::Result;
use ffgs_core::{Gaussians, Mask, Scene, StageLog, TrainingView, sigmoid, stage};
use ffgs_fusion::{Seed, SeedView, seeds};
use ffgs_motion::join;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, TileMask, View};
use ffgs_trainer::{INITIAL_OPACITY, Newborn, Progress, Standing, from_points, unexplained};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::time::Instant;

/// Fewest seeds that are worth a training.
const LEAST_SEEDS: usize = 8;
/// Share of the views that lacked an explanation at a newborn's place in which it has one now.
const EXPLAINS: f64 = 0.5;

impl Reconstructor<'_> {
    /// Moving Gaussians where the masks are not explained.
    pub(crate) fn add_newborn(
        &self,
        frame: usize,
        scene: &mut Scene,
        views: &[TrainingView],
        log: &mut StageLog,
    ) -> Result<()> {
        let start = Instant::now();
        let report = self.monitor.begin(stage::BIRTH, self.config.birth.iterations);
        let seed = self.seed(frame);
        let born = add_newborn(self.devices, &self.config, scene, views, seed, &mut |p| report(p))?;
        if born > 0 {
            tracing::info!("frame {frame}: {born} Gaussians are born where the masks were not explained");
        }
        log.change("born", born);
        log.since(stage::BIRTH, start);
        Ok(())
    }
}

/// A layer of `before` Gaussians that has died must not do so in silence: masks that disagree have removed what moves, and nothing is born
/// where they still do.
pub(crate) fn warn_if_all_are_gone(before: usize, scene: &Scene, views: &[TrainingView], log: &mut StageLog) {
    let held = views.iter().filter(|view| view.mask.count() > 0).count();
    if before > 0 && scene.dynamic.gaussians.is_empty() && held > 0 {
        log.warn(format!(
            "nothing moves any more, though the masks of {held} of {} views hold something: there is no place that most of them hold. \
             Compare the masks of the views, in masks.png where they were made, or by ffgs check --pictures",
            views.len()
        ));
    }
}

/// Adds moving Gaussians where the masks of `views` are not explained; returns how many.
fn add_newborn(
    devices: Devices,
    config: &ReconstructionConfig,
    scene: &mut Scene,
    views: &[TrainingView],
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<usize> {
    let room = config.densification.max_dynamic.saturating_sub(scene.dynamic.gaussians.len());
    let most = config.birth.most.min(room);
    if config.birth.iterations == 0 || most == 0 {
        return Ok(0);
    }
    let standing = Standing { layer: &scene.static_layer, sky: &scene.sky };
    let open = all_unexplained(&scene.dynamic.gaussians, standing, views);
    let found = find_seeds(config, scene, views, &open, most);
    if found.len() < LEAST_SEEDS {
        return Ok(0);
    }
    let newborn = Newborn { gaussians: of_seeds(&found, scene), views, unexplained: &open };
    let Some(born) = devices.newborn(&config.birth, newborn, scene, seed, report)? else { return Ok(0) };
    let mut together = scene.dynamic.gaussians.clone();
    together.extend(&born);
    let still_open = all_unexplained(&together, standing, views);
    let kept = explaining(&born, config.densification.min_opacity, views, (&open, &still_open));
    join(&mut scene.dynamic, &born.select(&kept), views);
    Ok(kept.len())
}

fn all_unexplained(layer: &Gaussians, standing: Standing, views: &[TrainingView]) -> Vec<Mask> {
    views.par_iter().map(|view| unexplained(layer, standing, view)).collect()
}

/// Places for at most `most` Gaussians in `open`.
fn find_seeds(
    config: &ReconstructionConfig,
    scene: &Scene,
    views: &[TrainingView],
    open: &[Mask],
    most: usize,
) -> Vec<Seed> {
    if open.iter().filter(|open| open.count() > 0).count() < 2 {
        return Vec::new();
    }
    // As in marking, a view without any foreground has no say.
    let with_say = views.par_iter().zip(open).filter(|(view, _)| view.mask.count() > 0);
    let views: Vec<SeedView> = with_say
        .map(|(view, open)| SeedView {
            camera: &view.camera,
            image: &view.image,
            mask: view.mask.widened(config.marking.dilation),
            unexplained: open,
            depth: depths(&scene.static_layer, view),
        })
        .collect();
    seeds(&views, config.marking.slack(), most)
}

/// (H, W) depth (m) of the static Gaussian that each pixel shows most of; infinite where there is none.
fn depths(layer: &Gaussians, view: &TrainingView) -> Vec<f32> {
    let (tiles, background) = (TileMask::covering(&view.mask), Background::Colour([0.0; 3]));
    let frame = View { camera: &view.camera, background, tiles: Some(&tiles) };
    let options = RenderOptions { sh_degree: Some(0), ..RenderOptions::default() };
    let top = CpuRasterizer::new(options).top_contributors(layer, &frame, 1, &mut RenderTape::default());
    let depth = |&i: &i32| -> Option<f32> {
        let place = Vec3::from(*layer.means.get(usize::try_from(i).ok()?)?);
        Some(view.camera.project(place.as_dvec3())?.depth as f32)
    };
    top.indices.iter().map(|i| depth(i).unwrap_or(f32::INFINITY)).collect()
}

fn of_seeds(seeds: &[Seed], scene: &Scene) -> Gaussians {
    let positions: Vec<[f32; 3]> = seeds.iter().map(|seed| seed.position.as_vec3().to_array()).collect();
    let colours: Vec<[f32; 3]> = seeds.iter().map(|seed| seed.colour).collect();
    let born = from_points(&positions, &colours, scene.static_layer.sh_degree(), INITIAL_OPACITY);
    born.with_filter(scene.static_layer.filter)
}

/// Those that show something, and where they are seen, something that lacked an explanation (`before`) has one (`after`).
fn explaining(
    born: &Gaussians,
    min_opacity: f32,
    views: &[TrainingView],
    (before, after): (&[Mask], &[Mask]),
) -> Vec<usize> {
    let explains = |place: DVec3| {
        let (mut open, mut explained) = (0, 0);
        for ((view, before), after) in views.iter().zip(before).zip(after) {
            if let Some((x, y)) = view.camera.pixel_of(place).filter(|&(x, y)| before.contains(x, y)) {
                open += 1;
                explained += usize::from(!after.contains(x, y));
            }
        }
        open > 0 && explained as f64 >= EXPLAINS * f64::from(open)
    };
    let positions = born.positions();
    (0..born.len())
        .filter(|&i| sigmoid(born.opacity_logits[i]) >= min_opacity && explains(positions[i]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{SIZE, ball, photographs, scene, without_masks};

    fn born(scene: &mut Scene, views: &[TrainingView]) -> usize {
        add_newborn(Devices(&[]), &ReconstructionConfig::default(), scene, views, 1, &mut |_| {}).unwrap()
    }

    fn open_pixels(scene: &Scene, views: &[TrainingView]) -> usize {
        let standing = Standing { layer: &scene.static_layer, sky: &scene.sky };
        all_unexplained(&scene.dynamic.gaussians, standing, views).iter().map(Mask::count).sum()
    }

    /// A ball that the layer has, one that it lacks, and both together.
    fn balls() -> [Gaussians; 3] {
        let (old, new) = (ball(Vec3::new(0.0, -1.0, 0.0)), ball(Vec3::new(0.0, 0.9, 0.0)));
        let mut both = old.clone();
        both.extend(&new);
        [old, new, both]
    }

    /// Of the ball that enters.
    fn assert_most_are_near_the_surface(born: &[DVec3]) {
        let near = |p: &&DVec3| (p.distance(DVec3::new(0.0, 0.9, 0.0)) - 0.6).abs() < 0.2;
        let (right, count) = (born.iter().filter(near).count(), born.len());
        assert!(right * 10 > count * 8, "{right} of {count} are near the surface");
    }

    #[test]
    fn what_enters_is_born_where_it_is_and_once() {
        let [old, _, both] = balls();
        let views = photographs(&both);
        let mut scene = scene(&old);
        let before = open_pixels(&scene, &views);
        let count = born(&mut scene, &views);
        assert!(before > 500 && count > 300, "{before} pixels, {count} born");
        let after = open_pixels(&scene, &views);
        assert!(after * 5 < before, "{before} unexplained pixels, then {after}");
        let dynamic = &scene.dynamic;
        assert_eq!(dynamic.gaussians.select(&(0..old.len()).collect::<Vec<_>>()), old, "the others stay");
        assert_eq!(
            [dynamic.ids.len(), dynamic.covariances.len(), dynamic.growth_limit],
            [old.len() + count; 3]
        );
        assert_most_are_near_the_surface(&dynamic.gaussians.positions()[old.len()..]);
        let again = born(&mut scene, &views);
        assert!(again * 5 < count, "{again} more of what is there");
    }

    #[test]
    fn nothing_is_born_of_a_background_that_masks_hold() {
        let [old, new, both] = balls();
        let views = photographs(&both);
        let mut scene = scene(&old);
        scene.static_layer = std::sync::Arc::new(new);
        assert_eq!(born(&mut scene, &views), 0, "the other ball stands still");
    }

    #[test]
    fn reduced_photographs_show_what_enters_too() {
        let [old, _, both] = balls();
        let views = TrainingView::all_reduced(&photographs(&both), 2).into_owned();
        let mut scene = scene(&old);
        let before = open_pixels(&scene, &views);
        let count = born(&mut scene, &views);
        assert!(before > 125 && count > 75, "{before} pixels, {count} born");
        let after = open_pixels(&scene, &views);
        assert!(after * 5 < before, "{before} unexplained pixels, then {after}");
        assert_most_are_near_the_surface(&scene.dynamic.gaussians.positions()[old.len()..]);
    }

    #[test]
    fn a_layer_that_dies_is_told_while_masks_hold_something() {
        let (all, none) = (scene(&ball(Vec3::ZERO)), scene(&ball(Vec3::ZERO).select(&[])));
        let views = photographs(&ball(Vec3::ZERO));
        let told = |before: usize, scene: &Scene, views: &[TrainingView]| {
            let mut log = StageLog::default();
            warn_if_all_are_gone(before, scene, views, &mut log);
            log.warnings.concat()
        };
        let hold = format!("masks of {0} of {0} views hold something", views.len());
        assert!(told(9, &none, &views).contains(&hold), "{}", told(9, &none, &views));
        assert_eq!(told(9, &all, &views), "", "some are left");
        assert_eq!(told(0, &none, &views), "", "nothing moved before");
        assert_eq!(told(9, &none, &without_masks(views)), "", "it has left");
    }

    #[test]
    fn nothing_is_born_where_all_is_explained_or_where_one_mask_alone_errs() {
        let only = ball(Vec3::ZERO);
        let mut views = photographs(&only);
        let mut scene = scene(&only);
        assert_eq!(born(&mut scene, &views), 0);
        views[2].mask = Mask::filled(SIZE, true);
        assert_eq!(born(&mut scene, &views), 0, "a mask that flickers");
        let empty = without_masks(views);
        assert_eq!(born(&mut scene, &empty), 0, "no foreground");
    }
}
