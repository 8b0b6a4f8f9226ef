//! Single kernels of training against their CPU twins.

#[allow(dead_code, reason = "the tests of the lanes need more of it")]
#[path = "../tests/scene/mod.rs"]
mod scene;

use crate::optimiser::Optimiser;
use crate::prior::GpuPrior;
use crate::target::{Shared, Target, leave_device};
use crate::workspace::{OPTIONS, Workspace, largest_view};
use ffgs_core::{Gaussians, Mask, PlanarImage, SkyCube};
use ffgs_gpu::Gpu;
use ffgs_rasterizer::constants::AREA;
use ffgs_rasterizer::{Background, CpuRasterizer, Information, RenderTape, TileMask, View};
use ffgs_rasterizer_gpu::{GpuScene, Ledger, bin_to_tiles, count_views, prepare};
use ffgs_trainer::constants::LONGEST;
use ffgs_trainer::{
    Adam, Columns, Damping, IndexMap, LearningRates, LossRegion, PhotometricLoss, PixelNoise, Prior,
    TaskView, Update, expected_gain,
};
use glam::DMat3;
use scene::{SIZE, SKY, blob, information, joint, perturbed, photographs, render, world};

fn half(first: usize) -> Mask {
    let inside = |i: usize| u8::from(i % SIZE.width >= first && i / SIZE.width > 4 && i != 700);
    Mask::new(SIZE, (0..SIZE.pixels()).map(inside).collect()).unwrap()
}

#[test]
#[ignore = "needs a GPU"]
fn the_loss_and_its_gradient_agree() {
    let gpu = Gpu::for_test();
    let views = photographs(&blob(40, [0.0; 3], 1.0, 1), &blob(1, [0.0; 3], 0.1, 2));
    // Another sky: of an error within rounding, the sign is the adapter's.
    let sky = SkyCube::filled(8, SKY.map(|c| c + 0.01));
    let rendered = render(&blob(40, [0.1, 0.0, 0.0], 1.0, 1), &sky, &views[0].camera);
    let pixels: Vec<[f32; 4]> =
        (0..SIZE.pixels()).map(|p| rendered.pixel(p)).map(|[r, g, b]| [r, g, b, 1.0]).collect();
    for region in [None, Some(half(13)), Some(Mask::filled(SIZE, false))] {
        let target = Target::new(&gpu, &views[0], (region.as_ref(), None), &Shared::default()).unwrap();
        let workspace = Workspace::new(&gpu, 1, SIZE.pixels()).unwrap();
        gpu.write(&workspace.scratch.pixels, &pixels);
        let mut commands = gpu.commands();
        workspace.loss(&mut commands, &target);
        gpu.submit(commands).unwrap();
        let found: Vec<[f32; 4]> = gpu.download(&workspace.scratch.upstream, SIZE.pixels()).unwrap();
        let mut expected = PlanarImage::zeros(SIZE);
        let whole = region.as_ref().map_or(LossRegion::Full, LossRegion::Mask);
        let value = PhotometricLoss::new().evaluate(&rendered, &views[0].image, whole, &mut expected);
        let largest = expected.data().iter().fold(1e-9_f32, |m, v| m.max(v.abs()));
        for (p, rgbt) in found.iter().enumerate() {
            for (found, expected) in rgbt.iter().zip(expected.pixel(p)) {
                assert!((found - expected).abs() < 2e-4 * largest, "pixel {p}: {found}, not {expected}");
            }
            assert_eq!(rgbt[3], 0.0);
        }
        let [loss, mse] = workspace.running().unwrap();
        assert!(
            (loss - value.total).abs() < 1e-5 && (mse - value.mse).abs() < 1e-6,
            "{loss} {mse} {value:?}"
        );
    }
}

#[test]
#[ignore = "needs a GPU"]
fn steps_of_the_optimiser_agree() {
    for coasts in [false, true] {
        steps_agree(coasts);
    }
}

fn steps_agree(coasts: bool) {
    let gpu = Gpu::for_test();
    let mut expected = blob(50, [0.0; 3], 1.0, 3);
    let scene = GpuScene::upload(&gpu, &expected).unwrap();
    let optimiser = Optimiser::new(&gpu, scene, Columns::ALL).unwrap().moving(0, coasts);
    let mut adam = Adam::new(expected.len(), expected.sh_degree());
    let rates = LearningRates { quats: 0.0, ..LearningRates::with_means(1e-3) };
    for step in 1..=5_u32 {
        let gradient = blob(50, [0.0; 3], 1e-6, 10 + u64::from(step));
        let touched: Vec<bool> = (0..50).map(|i| i % (step as usize + 1) != 0).collect();
        let update = if coasts { Update::Coasting(&touched) } else { Update::Touched(&touched) };
        adam.step(&mut expected, &gradient, &rates, update);
        write_step(&gpu, &optimiser, &gradient, (&touched, adam.steps()), step);
        optimiser.prepare(&rates, step);
        let mut commands = gpu.commands();
        optimiser.step(&mut commands);
        gpu.submit(commands).unwrap();
    }
    let found = optimiser.download().unwrap();
    let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 2e-6 * (1.0 + b.abs()));
    assert!(close(found.means.as_flattened(), expected.means.as_flattened()));
    assert_eq!(found.quats, expected.quats);
    assert!(close(found.log_scales.as_flattened(), expected.log_scales.as_flattened()));
    assert!(close(&found.opacity_logits, &expected.opacity_logits));
    assert!(close(found.sh.as_flattened(), expected.sh.as_flattened()));
}

/// Five natural steps on the device and on the CPU. Nothing is known of one Gaussian, as if it had just been born; some steps reach their
/// limit, most do not.
#[test]
#[ignore = "needs a GPU"]
fn natural_steps_agree() {
    let gpu = Gpu::for_test();
    let mut expected = blob(50, [0.0; 3], 1.0, 3);
    let (known, mut expecting) = (Information::none(50, expected.sh_degree()), information(50));
    expecting.positions[7] = DMat3::ZERO;
    expecting.others.log_scales[7] = [0.0; 3];
    let noise = PixelNoise { sigma: 0.04, correlated: 9.0 };
    let prior = Prior { information: &known, noise, weight: 0.1, curvature: &expecting };
    let seen: Vec<u32> = (0..50).map(|i| i % 4).collect();
    let scene = GpuScene::upload(&gpu, &expected).unwrap();
    let optimiser = Optimiser::new(&gpu, scene, Columns::ALL).unwrap();
    let pixels = 500;
    let on_device =
        GpuPrior::new(&gpu, prior, &optimiser.scene, (gpu.upload("views", &seen).unwrap(), pixels)).unwrap();
    let curvature = prior.curvature(Damping::new(&expecting), &seen, pixels);
    let mut adam = Adam::new(expected.len(), expected.sh_degree());
    let rates = LearningRates::with_means(1e-3);
    let (mut limited, mut free) = (0, 0);
    for step in 1..=5_u32 {
        let gradient = blob(50, [0.0; 3], 1e-6, 10 + u64::from(step));
        let touched: Vec<bool> = (0..50).map(|i| i % (step as usize + 1) != 0).collect();
        let before = expected.clone();
        adam.step_naturally(&mut expected, &gradient, (0.3, &rates), curvature, &touched);
        for (before, now) in before.opacity_logits.iter().zip(&expected.opacity_logits) {
            let change = (before - now).abs();
            limited += u32::from(change > 0.99 * LONGEST * rates.opacities);
            free += u32::from(change > 0.0 && change < 0.9 * LONGEST * rates.opacities);
        }
        write_step(&gpu, &optimiser, &gradient, (&touched, adam.steps()), step);
        on_device.prepare(&gpu, (0.3, &rates), step, 0);
        let mut commands = gpu.commands();
        on_device.step(&mut commands, &optimiser);
        gpu.submit(commands).unwrap();
    }
    assert!(limited > 5 && free > 50, "{limited} steps were limited, {free} were not");
    let gain = on_device.expected_gain(&optimiser).unwrap().unwrap();
    let on_host = expected_gain(&adam.first_moments().means, adam.steps(), curvature).unwrap();
    assert!((gain / on_host - 1.0).abs() < 1e-4, "{gain}, {on_host} on the host");
    let found = optimiser.download().unwrap();
    let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-5 * (1.0 + b.abs()));
    assert!(close(found.means.as_flattened(), expected.means.as_flattened()));
    assert!(close(found.quats.as_flattened(), expected.quats.as_flattened()));
    assert!(close(found.log_scales.as_flattened(), expected.log_scales.as_flattened()));
    assert!(close(&found.opacity_logits, &expected.opacity_logits));
    assert!(close(found.sh.as_flattened(), expected.sh.as_flattened()));
}

/// The gradient of a step, of which `touched` Gaussians were drawn, as the rasterizer would leave it.
fn write_step(
    gpu: &Gpu,
    optimiser: &Optimiser,
    gradient: &Gaussians,
    (touched, steps): (&[bool], &[u32]),
    stamp: u32,
) {
    let rows: Vec<_> = (0..50).map(|i| ffgs_rasterizer_gpu::Geometry::of(gradient, i)).collect();
    gpu.write(&optimiser.gradients.scene.geometry, &rows);
    gpu.write(&optimiser.gradients.scene.sh, &gradient.sh);
    let row = |(&touched, &steps): (&bool, &u32)| Ledger {
        stamp: if touched { stamp } else { 0 },
        steps,
        ..Ledger::default()
    };
    let ledger: Vec<Ledger> = touched.iter().zip(steps).map(row).collect();
    gpu.write(&optimiser.gradients.ledger, &ledger);
}

/// Moments after a step and a round of density control, with and without a reset of the opacities.
#[test]
#[ignore = "needs a GPU"]
fn moments_are_carried_over_a_round_of_density_control() {
    let gpu = Gpu::for_test();
    let (start, gradient) = (blob(5, [0.0; 3], 1.0, 3), blob(5, [0.0; 3], 1.0, 4));
    let map = IndexMap { sources: vec![0, 2, 3, 2, 4], keeps_moments: vec![true, true, true, false, false] };
    for keep_opacity in [true, false] {
        let scene = GpuScene::upload(&gpu, &start).unwrap();
        let mut optimiser = Optimiser::new(&gpu, scene, Columns::ALL).unwrap();
        let mut adam = Adam::new(start.len(), start.sh_degree());
        let rates = LearningRates::with_means(1e-3);
        adam.step(&mut start.clone(), &gradient, &rates, Update::Dense);
        let rows: Vec<_> = (0..5).map(|i| ffgs_rasterizer_gpu::Geometry::of(&gradient, i)).collect();
        gpu.write(&optimiser.gradients.scene.geometry, &rows);
        gpu.write(&optimiser.gradients.scene.sh, &gradient.sh);
        gpu.write(&optimiser.gradients.ledger, &[Ledger { stamp: 1, steps: 1, ..Ledger::default() }; 5]);
        optimiser.prepare(&rates, 1);
        let mut commands = gpu.commands();
        optimiser.step(&mut commands);
        gpu.submit(commands).unwrap();
        optimiser.replace(&start, &map, (keep_opacity, false)).unwrap();
        adam.remap(&map);
        if !keep_opacity {
            adam.reset_opacity();
        }
        let expected = [adam.first_moments(), adam.second_moments()];
        for (found, expected) in optimiser.moments().unwrap().iter().zip(expected) {
            let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-6 * b.abs());
            assert!(close(found.means.as_flattened(), expected.means.as_flattened()));
            assert!(close(found.quats.as_flattened(), expected.quats.as_flattened()));
            assert!(close(found.log_scales.as_flattened(), expected.log_scales.as_flattened()));
            assert!(close(&found.opacity_logits, &expected.opacity_logits));
            assert!(close(found.sh.as_flattened(), expected.sh.as_flattened()));
            assert!(found.means[0] != [0.0; 3] && found.means[3] == [0.0; 3]);
        }
    }
}

/// In a step of which the loss has no gradient, all that moves the layer is the prior: against the CPU, value by value.
#[test]
#[ignore = "needs a GPU"]
fn the_pull_of_the_prior_agrees() {
    let gpu = Gpu::for_test();
    let (start, views) = (blob(50, [0.0; 3], 1.0, 3), world().views);
    let mut now = perturbed(&start, 4);
    now.quats.as_flattened_mut().iter_mut().for_each(|v| *v += 0.05);
    now.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v -= 0.1);
    now.opacity_logits.iter_mut().for_each(|v| *v += 0.3);
    let (information, curvature) = (information(50), Information::none(50, start.sh_degree()));
    let noise = PixelNoise { sigma: 0.04, correlated: 9.0 };
    let prior = Prior { information: &information, noise, weight: 0.1, curvature: &curvature };
    let seen: Vec<u32> = (0..50).map(|i| i % 4).collect();
    let optimiser = Optimiser::new(&gpu, GpuScene::upload(&gpu, &now).unwrap(), Columns::ALL).unwrap();
    let on_device = GpuPrior::new(
        &gpu,
        prior,
        &GpuScene::upload(&gpu, &start).unwrap(),
        (gpu.upload("views", &seen).unwrap(), 500),
    );
    let region = half(13);
    let target = Target::new(&gpu, &views[0], (Some(&region), None), &Shared::default()).unwrap();
    let drawn = |i: usize| !i.is_multiple_of(3);
    let ledger: Vec<Ledger> =
        (0..50).map(|i| Ledger { stamp: u32::from(drawn(i)), ..Ledger::default() }).collect();
    gpu.write(&optimiser.gradients.ledger, &ledger);
    let scratch = Workspace::new(&gpu, 50, SIZE.pixels()).unwrap().scratch;
    prepare(&gpu, &optimiser.scene, &target.view, &scratch, OPTIONS, 1);
    let mut commands = gpu.commands();
    on_device.unwrap().pull(&mut commands, &target, &optimiser);
    gpu.submit(commands).unwrap();
    let found = optimiser.gradients.scene.download(&gpu).unwrap();
    let touched: Vec<bool> = (0..50).map(drawn).collect();
    let expected = prior.pull(&start, seen, &now, region.count(), &touched);
    let close = |a: &[f32], b: &[f32]| {
        let largest = b.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        largest > 0.0 && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 2e-5 * largest)
    };
    assert!(close(found.means.as_flattened(), expected.means.as_flattened()));
    assert!(close(found.quats.as_flattened(), expected.quats.as_flattened()));
    assert!(close(found.log_scales.as_flattened(), expected.log_scales.as_flattened()));
    assert!(close(&found.opacity_logits, &expected.opacity_logits));
    assert!(close(found.sh.as_flattened(), expected.sh.as_flattened()));
}

#[test]
#[ignore = "needs a GPU"]
fn views_that_see_a_gaussian_are_counted_as_on_the_cpu() {
    let (gpu, world) = (Gpu::for_test(), world());
    let layer = joint(&world.moving, &world.fixed);
    let scene = GpuScene::upload(&gpu, &layer).unwrap();
    let counts = gpu.buffer("counts", 4 * layer.len() as u64).unwrap();
    let mut expected = vec![0; layer.len()];
    for view in &world.views {
        let tiles = TileMask::covering(&view.mask);
        let target = Target::new(&gpu, view, (None, Some(&tiles)), &Shared::default()).unwrap();
        let tasks = [TaskView { view, region: None, tiles: None }];
        let mut workspace = Workspace::new(&gpu, layer.len(), largest_view(&tasks)).unwrap();
        workspace.fit(&scene, std::slice::from_ref(&target), OPTIONS).unwrap();
        prepare(&gpu, &scene, &target.view, &workspace.scratch, OPTIONS, 0);
        let mut commands = gpu.commands();
        bin_to_tiles(&mut commands, &scene, &target.view, &workspace.scratch);
        count_views(&mut commands, &scene, &target.view, &workspace.scratch, &counts);
        gpu.submit(commands).unwrap();
        let frame =
            View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
        let mut tape = RenderTape::default();
        CpuRasterizer::new(OPTIONS).render(&layer, &frame, &mut tape);
        tape.visible_indices().for_each(|i| expected[i] += 1);
    }
    assert_eq!(gpu.download::<u32>(&counts, layer.len()).unwrap(), expected);
    assert!(expected.contains(&4) && expected.iter().any(|&n| n < 4), "{expected:?}");
}

#[test]
#[ignore = "needs a GPU"]
fn what_leaves_the_device_comes_back_for_each_view() {
    let (gpu, world) = (Gpu::for_test(), world());
    let mut targets: Vec<Target> = world
        .views
        .iter()
        .map(|view| {
            let tiles = TileMask::covering(&view.mask);
            Target::new(&gpu, view, (None, Some(&tiles)), &Shared::default()).unwrap()
        })
        .collect();
    let layers = |t: usize, target: &Target| vec![[t as f32, 0.5, 0.0, 1.0]; target.view.slots() * AREA * 2];
    targets.iter().enumerate().for_each(|(t, target)| gpu.write(&target.view.layers, &layers(t, target)));
    let before = gpu.memory_held();
    assert!(leave_device(&mut targets, &gpu).unwrap());
    assert!(gpu.memory_held() < before);
    for t in [2, 0, 3, 1, 0] {
        let target = &targets[t];
        target.bring(&gpu);
        let expected = layers(t, target);
        assert_eq!(
            gpu.download::<[f32; 4]>(&target.view.layers, expected.len()).unwrap(),
            expected,
            "view {t}"
        );
        let image = world.views[t].image.data();
        assert_eq!(gpu.download::<u8>(&target.photograph, image.len()).unwrap(), image, "view {t}");
    }
    assert!(!leave_device(&mut targets, &gpu).unwrap(), "nothing is left");
}
