//! Association while blending against that on lists of contributors, which the reference cases check.

use ffgs_core::{Camera, DenseMotion, Gaussians, ImageSize, Intrinsics, Mask};
use ffgs_rasterizer::{
    Association, AssociationScene, AssociationScratch, Background, ContributorLists, CpuRasterizer, Observed,
    RenderOptions, RenderTape, TopContributors, View, associate_lists,
};
use glam::{DMat4, DVec2, DVec3};

const SIZE: ImageSize = ImageSize { width: 50, height: 34 };
const CONTRIBUTORS: usize = 3;

/// Eighty balls in layers, all over the image, and their centres (m).
fn heap() -> (Gaussians, Vec<DVec3>) {
    let mut gaussians = Gaussians::zeros(80, 0);
    for i in 0..80 {
        let depth = 2.0 + 0.05 * i as f32;
        let [x, y] = [i * 7 % 13, i * 5 % 11].map(|v| v as f32 / 12.0 - 0.5);
        gaussians.means[i] = [x * depth, 0.7 * y * depth, depth];
        gaussians.quats[i] = [1.0, 0.0, 0.0, 0.0];
        gaussians.log_scales[i] = [(0.1 + 0.02 * (i % 5) as f32).ln(); 3];
        gaussians.opacity_logits[i] = 0.5 * (i % 6) as f32 - 1.5;
    }
    let means = gaussians.means.iter().map(|m| DVec3::from_array(m.map(f64::from))).collect();
    (gaussians, means)
}

/// A tracker that turns the image one way or the other.
fn field(turn: f32) -> DenseMotion {
    let mut field = DenseMotion::unknown(SIZE);
    for p in 0..SIZE.pixels() {
        let [x, y] = [p % SIZE.width, p / SIZE.width].map(|v| v as f32);
        field.flow[p] = [turn * (y - 20.0), -turn * (x - 10.0)];
        field.confidence[p] = 0.2 + 0.01 * x;
    }
    field
}

#[test]
fn the_heaviest_contributors_are_those_of_the_lists() {
    let (gaussians, means) = heap();
    let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 25.0, cy: 17.0 };
    let camera = Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap();
    let mask = Mask::new(SIZE, (0..SIZE.pixels()).map(|p| u8::from(p % 50 + p / 50 > 30)).collect()).unwrap();
    let fields = [field(0.1), field(-0.3)];

    let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    let top = rasterizer.top_contributors(&gaussians, &view, CONTRIBUTORS, &mut RenderTape::default());
    let projected: Vec<DVec2> = means.iter().map(|&m| camera.project(m).unwrap().pixel).collect();
    let (indices, weights, count) = (&top.indices, &top.weights, top.count);
    let lists = ContributorLists { count, indices, weights, mask: &mask, projected: &projected };
    let expected = associate_lists(&lists, &fields, 0.25).unwrap();

    let n = means.len();
    let (mut targets, mut weights) = (vec![DVec2::ZERO; 2 * n], vec![0.0; 2 * n]);
    let columns = targets.chunks_mut(n).zip(weights.chunks_mut(n));
    let mut out: Vec<Observed> = columns.map(|(targets, weights)| Observed { targets, weights }).collect();
    let association = Association {
        camera: &camera,
        mask: &mask,
        fields: &fields,
        flow_floor_px: 0.25,
        min_coverage: 0.0,
        min_hits: 1,
        min_transmittance: 1e-4,
        contributors: CONTRIBUTORS,
        normalise: true,
    };
    let scene = AssociationScene::new(&[&gaussians], &means);
    association.observe(&scene, &mut out, &mut AssociationScratch::default());

    let seen = expected.coverage.iter().filter(|c| **c > 0.0).count();
    assert!((20..n).contains(&seen), "{seen} of {n} are among the heaviest somewhere");
    for e in 0..2 * n {
        let (weight, target) = (expected.weights[e], expected.targets[e]);
        assert!((weights[e] - weight).abs() <= 1e-5 * weight, "{e}: {} for {weight}", weights[e]);
        assert!(weight == 0.0 || targets[e].distance(target) < 1e-4, "{e}: {} for {target}", targets[e]);
    }
}

#[test]
fn lists_of_some_pixels_are_those_of_all() {
    let (gaussians, _) = heap();
    let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 25.0, cy: 17.0 };
    let camera = Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap();
    let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
    let (rasterizer, mut tape) = (CpuRasterizer::default(), RenderTape::default());
    let wanted = |pixel: usize| pixel % 3 == 1;
    let all = rasterizer.top_contributors(&gaussians, &view, CONTRIBUTORS, &mut tape);
    let some = TopContributors::of(&tape, view.camera.size(), CONTRIBUTORS, wanted);
    let (mut listed, mut unlisted) = (0, 0);
    for pixel in 0..SIZE.pixels() {
        let list = pixel * CONTRIBUTORS..(pixel + 1) * CONTRIBUTORS;
        if wanted(pixel) {
            assert_eq!(some.indices[list.clone()], all.indices[list.clone()], "pixel {pixel}");
            assert_eq!(some.weights[list.clone()], all.weights[list.clone()], "pixel {pixel}");
            listed += usize::from(all.indices[list.start] >= 0);
        } else {
            assert!(some.indices[list.clone()].iter().all(|&index| index == -1), "pixel {pixel}");
            unlisted += usize::from(all.indices[list.start] >= 0);
        }
        assert!(all.weights[list].is_sorted_by(|a, b| a >= b), "heaviest first");
    }
    assert!(listed > 100 && unlisted > 100, "{listed} and {unlisted} pixels show something");
}
