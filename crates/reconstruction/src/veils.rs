//! What veils a picture that is taken from where no camera stood (docs/adr/0094-what-was-seen-from-afar-is-no-veil.md,
//! docs/adr/0103-a-camera-in-a-wall-sees-what-is-before-it.md).

use ffgs_core::{Camera, Projection, Scene};
use ffgs_rasterizer::constants::FRUSTUM_MARGIN;
use ffgs_trainer::{depths_behind, depths_without};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// A veil has this many times the pixels per length (focal length over distance) that any training view has there: how it looks from so near is not known.
const MAGNIFIED: f64 = 4.0;
/// What the pixels of a veil show lies 1.28 times as far away as the veil; the natural logarithm.
const FAR_BEHIND: f32 = 0.25;
/// A view may show what reaches into its image, widened by this factor,
const WIDENED: f64 = 1.0 + FRUSTUM_MARGIN as f64;
/// and a Gaussian reaches so many of its largest standard deviations.
const REACH: f64 = 3.0;
/// What a camera is built into has so many times the pixels per length for it that any training view has there,
const BUILT_INTO: f64 = 16.0;
/// and training views see other sides of it. Cosine of the angle, 60 degrees, from which a surface shows another side.
const OTHER_SIDE: f64 = 0.5;

/// `scene` without the Gaussians that veil the picture of `camera`; `None` where none does. `trained` are the cameras of the training views, none of
/// which has a veil.
///
/// A veil has several times as many pixels per length as any training view has seen it with, and something lies far behind it.
/// A surface is no veil: its pixels show the surface itself. But the wall that a camera is built into, which training views have seen from much
/// farther away and from other sides alone, is no surface for it: what lies behind that is what shows without it.
pub fn unveiled(scene: &Scene, camera: &Camera, trained: &[Camera]) -> Option<Scene> {
    if trained.contains(camera) {
        return None;
    }
    let [wall, others] = magnified(scene, camera, trained);
    let is_veil = |(&i, behind): (&usize, &f32)| (*behind > FAR_BEHIND).then_some(i);
    let behind = if wall.is_empty() { Vec::new() } else { depths_without(&scene.layers(), &wall, camera) };
    let mut veils: Vec<usize> = wall.iter().zip(&behind).filter_map(is_veil).collect();
    let mut found = (!veils.is_empty()).then(|| transparent(scene, &veils));
    if !others.is_empty() {
        let layers = found.as_ref().unwrap_or(scene).layers();
        let behind = depths_behind(&layers, &[*camera]);
        let before: Vec<usize> = others.into_iter().filter(|&i| behind[i] > FAR_BEHIND).collect();
        if !before.is_empty() {
            veils.extend(&before);
            found = Some(transparent(scene, &veils));
        }
    }
    tracing::debug!("{} Gaussians veil a picture", veils.len());
    found
}

fn transparent(scene: &Scene, veils: &[usize]) -> Scene {
    let mut scene = scene.clone();
    scene.make_transparent(veils);
    scene
}

/// Ascending indices, in both layers joined, of the Gaussians that `camera` would show from nearer than the training views: of those that
/// it is built into, and of the others.
fn magnified(scene: &Scene, camera: &Camera, trained: &[Camera]) -> [Vec<usize>; 2] {
    let is_magnified = |blob: &Blob| {
        let least = pixels_per_length(camera, blob.place) / MAGNIFIED;
        let as_near = |other: &Camera| pixels_per_length(other, blob.place) >= least && may_show(other, blob);
        may_show(camera, blob) && !trained.iter().any(as_near)
    };
    let ray = |from: &Camera, blob: &Blob| (blob.place - from.center()).normalize_or_zero();
    let is_built_into = |blob: &Blob| {
        let least = pixels_per_length(camera, blob.place) / BUILT_INTO;
        let mut seen = trained.iter().filter(|other| may_show(other, blob)).peekable();
        let surface = |other: &Camera| {
            pixels_per_length(other, blob.place) > least
                || ray(other, blob).dot(ray(camera, blob)) >= OTHER_SIDE
        };
        seen.peek().is_some() && !seen.any(surface)
    };
    let blobs: Vec<Blob> = scene
        .layers()
        .into_iter()
        .flat_map(|layer| {
            layer.means.iter().zip(&layer.log_scales).map(|(mean, scales)| Blob::new(mean, scales))
        })
        .collect();
    let near: Vec<usize> = (0..blobs.len()).into_par_iter().filter(|&i| is_magnified(&blobs[i])).collect();
    let (wall, others) = near.into_iter().partition(|&i| is_built_into(&blobs[i]));
    [wall, others]
}

/// A Gaussian as far as it matters here.
struct Blob {
    place: DVec3,
    reach: f64,
}

impl Blob {
    fn new(mean: &[f32; 3], log_scales: &[f32; 3]) -> Self {
        let largest = log_scales.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        Self { place: DVec3::from(mean.map(f64::from)), reach: REACH * f64::from(largest.exp()) }
    }
}

fn pixels_per_length(camera: &Camera, place: DVec3) -> f64 {
    camera.intrinsics().focal() / camera.center().distance(place)
}

fn may_show(camera: &Camera, blob: &Blob) -> bool {
    let size = camera.size();
    let half = DVec2::new(size.width as f64, size.height as f64) / 2.0;
    camera.project(blob.place).is_some_and(|Projection { pixel, depth }| {
        let reach = blob.reach * camera.intrinsics().focal() / depth;
        (pixel - half).abs().cmple(WIDENED * half + reach).all()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Dynamic, Gaussians, ImageSize, Intrinsics, SkyCube};
    use ffgs_testkit::look_at;
    use ffgs_trainer::from_points;

    const SIZE: ImageSize = ImageSize { width: 64, height: 48 };

    /// `distance` before the origin, where one looks at the wall behind it.
    fn camera(distance: f64) -> Camera {
        let pose = look_at(DVec3::new(distance, 0.0, 0.0), DVec3::new(-1.0, 0.0, 0.0));
        Camera::new(Intrinsics { fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 }, pose, SIZE).unwrap()
    }

    /// A wall 4 m behind the origin, after discs of `spacing` at `places` (in the plane across the view).
    fn scene(places: &[[f32; 2]], spacing: f32) -> Scene {
        let wall = |i: usize| [-4.0, 0.2 * (i % 61) as f32 - 6.0, 0.2 * (i / 61) as f32 - 6.0];
        let near = places.iter().map(|&[y, z]| [0.0, y, z]);
        let means: Vec<[f32; 3]> = near.chain((0..61 * 61).map(wall)).collect();
        let mut layer = from_points(&means, &vec![[0.4; 3]; means.len()], 0, 0.6);
        layer.log_scales[..places.len()].fill([spacing.ln(), spacing.ln(), spacing.ln()]);
        layer.log_scales[places.len()..].fill([0.2_f32.ln(); 3]);
        Scene::new(layer, Dynamic::default(), SkyCube::filled(4, [0.2; 3]))
    }

    /// The Gaussians that are not drawn.
    fn left_out(scene: &Scene, camera: &Camera, trained: &[Camera]) -> Vec<usize> {
        let Some(found) = unveiled(scene, camera, trained) else { return Vec::new() };
        let (before, after) = (scene.joint().opacity_logits, found.joint().opacity_logits);
        assert_eq!(before.len(), after.len());
        (0..before.len()).filter(|&i| after[i] < before[i]).collect()
    }

    #[test]
    fn what_was_seen_from_afar_is_left_out_where_it_veils() {
        let scene = scene(&[[0.0, 0.05]], 0.2);
        let near = camera(0.5);
        assert_eq!(left_out(&scene, &near, &[camera(8.0), camera(9.0)]), [0]);
        assert_eq!(left_out(&scene, &near, &[camera(8.0), camera(1.0)]), [0; 0], "a view from twice as far");
        assert_eq!(left_out(&scene, &near, &[near]), [0; 0], "a training view");
        assert_eq!(left_out(&scene, &camera(-0.5), &[camera(8.0)]), [0; 0], "it is behind the camera");
        let aside = Camera::new(
            near.intrinsics(),
            look_at(DVec3::new(1.0, 0.0, 0.0), DVec3::new(9.0, 0.0, 0.0)),
            SIZE,
        );
        assert_eq!(left_out(&scene, &near, &[aside.unwrap()]), [0], "a view that looks elsewhere");
        assert_eq!(left_out(&scene, &near, &[]), [0], "no view");
    }

    #[test]
    fn moving_gaussians_veil_as_well() {
        let all = scene(&[[0.0, 0.05]], 0.2);
        let layer = |from, to| all.static_layer.select(&(from..to).collect::<Vec<_>>());
        let (near, wall) = (layer(0, 1), layer(1, all.static_layer.len()));
        let last = wall.len();
        let moving = |gaussians| Dynamic { gaussians, ..Dynamic::default() };
        let mixed = Scene::new(wall.clone(), moving(near), all.sky.clone());
        assert_eq!(left_out(&mixed, &camera(0.5), &[camera(8.0)]), [last]);
        let one_layer =
            Scene::new(Gaussians::zeros(0, 0), moving(Gaussians::clone(&all.static_layer)), all.sky.clone());
        assert_eq!(left_out(&one_layer, &camera(0.5), &[camera(8.0)]), [0], "a method with one layer");
    }

    #[test]
    fn a_surface_is_no_veil() {
        let places: Vec<[f32; 2]> =
            (0..41 * 41).map(|i| [0.05 * (i % 41) as f32 - 1.0, 0.05 * (i / 41) as f32 - 1.0]).collect();
        let board = scene(&places, 0.05);
        assert_eq!(left_out(&board, &camera(0.5), &[camera(8.0)]), [0; 0]);
        let empty = Scene::new(Gaussians::zeros(0, 0), Dynamic::default(), SkyCube::filled(4, [0.2; 3]));
        assert_eq!(left_out(&empty, &camera(0.5), &[camera(8.0)]), [0; 0]);
    }

    /// Thirty discs in a heap, which hide from each other what lies behind them.
    #[test]
    fn what_a_camera_is_built_into_is_left_out() {
        let heap: Vec<[f32; 2]> = (0..30).map(|i| [0.004 * (i % 6) as f32, 0.004 * (i / 6) as f32]).collect();
        let scene = scene(&heap, 0.05);
        let built_in = camera(0.1);
        let from = |x: f64, towards: f64| {
            let pose = look_at(DVec3::new(x, 0.0, 0.0), DVec3::new(towards, 0.0, 0.0));
            Camera::new(built_in.intrinsics(), pose, SIZE).unwrap()
        };
        let across = from(-3.5, 1.0);
        assert_eq!(left_out(&scene, &built_in, &[across]), (0..heap.len()).collect::<Vec<_>>());
        assert_eq!(
            left_out(&scene, &built_in, &[across, camera(8.0)]),
            [0; 0],
            "another camera sees this side"
        );
        assert_eq!(
            left_out(&scene, &built_in, &[from(-1.2, 1.0)]),
            [0; 0],
            "twelve times as near: a surface"
        );
        assert_eq!(left_out(&scene, &across, &[across]), [0; 0], "a training camera");
    }

    #[test]
    fn places_that_are_no_numbers_are_no_veil() {
        let mut scene = scene(&[[0.0, 0.0], [0.0, 0.1]], 0.2);
        let layer = std::sync::Arc::make_mut(&mut scene.static_layer);
        layer.means[0] = [f32::NAN; 3];
        assert_eq!(left_out(&scene, &camera(0.5), &[camera(8.0)]), [1]);
    }
}
