//! SSIM and its gradients against float64 values of an independent implementation (fixtures/reference/ssim).

use ffgs_core::{ImageRgb8, ImageSize, Mask, PlanarImage};
use ffgs_metrics::{
    Border, LossAndGradient, SsimError, SsimMap, SsimPair, loss_3dgs, ssim, ssim_and_gradient,
};
use ffgs_testkit::{Case, case, largest_difference};

/// The reference's maps are stored as f32, its images too; values and gradients as f64.
const TOLERANCE: f64 = 1e-6;

/// Names of the pairs of images: the file holds `NAME__img1` and further arrays of each.
fn pairs(file: &Case) -> Vec<String> {
    let name = |key: &String| key.strip_suffix("__img1").map(str::to_owned);
    let mut names: Vec<String> = file.file.names().iter().filter_map(name).collect();
    names.sort();
    names
}

fn assert_close(case: &str, key: &str, found: &[f64], expected: &[f64]) {
    let worst = largest_difference(found, expected);
    assert!(worst <= TOLERANCE, "{case} {key}: off by {worst:.1e}");
}

fn check(file: &Case, case: &str, prefix: &str, found: &LossAndGradient) {
    let expected = |what: &str| file.array(&format!("{case}__{prefix}_{what}"));
    assert_close(case, prefix, &[found.value], &expected("value"));
    assert_close(case, prefix, &found.gradient, &expected("grad"));
    if prefix != "loss3dgs" {
        assert_close(case, prefix, &found.map, &expected("map"));
    }
}

#[test]
fn every_reference_case_holds() {
    let file = case("ssim", "ssim");
    let cases = pairs(&file);
    assert!(cases.len() >= 8);
    for case in &cases {
        let image = |key: &str| file.file.f32(&format!("{case}__{key}")).unwrap();
        let (rendered, target) = (image("img1"), image("img2"));
        let shape = [rendered.shape[0], rendered.shape[1], rendered.shape[2]];
        let pair = SsimPair::new(shape, &rendered.data, &target.data).unwrap();
        let same = ssim_and_gradient(pair, Border::Same).unwrap();
        assert!((ssim(pair, Border::Same).unwrap() - same.value).abs() < 1e-12);
        check(&file, case, "same", &same);
        check(&file, case, "valid", &ssim_and_gradient(pair, Border::Valid).unwrap());
        check(&file, case, "loss3dgs", &loss_3dgs(pair).unwrap());
    }
}

#[test]
fn an_image_smaller_than_the_window_has_no_valid_map() {
    let (a, b) = ([0.2; 15], [0.4; 15]);
    let pair = SsimPair::new([1, 3, 5], &a, &b).unwrap();
    assert_eq!(ssim(pair, Border::Valid), Err(SsimError::SmallerThanWindow { height: 3, width: 5 }));
    assert!(ssim(pair, Border::Same).unwrap().is_finite());
    assert!(SsimPair::new([1, 3, 4], &a, &b).is_err());
    assert!(SsimPair::new([0, 3, 4], &[], &[]).is_err());
}

#[test]
fn the_gradient_is_that_of_finite_differences_on_a_tiny_image() {
    let target: Vec<f32> = (0..21).map(|i| (i * 37 % 19) as f32 / 19.0).collect();
    let mut rendered: Vec<f32> = (0..21).map(|i| (i * 23 % 17) as f32 / 17.0 + 0.01).collect();
    let shape = [1, 3, 7];
    let gradient = loss_3dgs(SsimPair::new(shape, &rendered, &target).unwrap()).unwrap().gradient;
    for (i, gradient) in gradient.iter().enumerate() {
        let centre = rendered[i];
        let mut value_at = |v: f32| {
            rendered[i] = v;
            loss_3dgs(SsimPair::new(shape, &rendered, &target).unwrap()).unwrap().value
        };
        let (low, high) = (centre - 1e-3, centre + 1e-3);
        let slope = (value_at(high) - value_at(low)) / (f64::from(high) - f64::from(low));
        rendered[i] = centre;
        assert!((slope - gradient).abs() < 1e-4, "value {i}: {slope} {gradient}");
    }
}

#[test]
fn a_render_with_nan_has_a_finite_value() {
    let size = ImageSize { width: 13, height: 5 };
    let target = ImageRgb8::new(size, vec![90; 195]).unwrap();
    let mut rendered = PlanarImage::from(&target);
    assert!((SsimMap::new(&rendered, &target).unwrap().mean() - 1.0).abs() < 1e-12);
    rendered.data_mut()[3] = f32::NAN;
    let value = SsimMap::new(&rendered, &target).unwrap().mean();
    assert!(value.is_finite() && value < 1.0);
}

#[test]
fn two_masks_that_make_up_the_image_make_up_its_value() {
    let size = ImageSize { width: 16, height: 14 };
    let target =
        ImageRgb8::new(size, (0..3 * size.pixels()).map(|i| (i * 37 % 251) as u8).collect()).unwrap();
    let mut rendered = PlanarImage::from(&target);
    rendered.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v += (i % 7) as f32 / 40.0);
    let map = SsimMap::new(&rendered, &target).unwrap();
    let part = |keep: &dyn Fn(usize) -> bool| {
        let mask = Mask::new(size, (0..size.pixels()).map(|i| u8::from(keep(i))).collect()).unwrap();
        (map.mean_inside(&mask).unwrap(), mask.count() as f64)
    };
    let whole = map.mean();
    let ((left, n), (right, m)) = (part(&|i| i % 16 < 5), part(&|i| i % 16 >= 5));
    let (left, right) = (left.unwrap(), right.unwrap());
    assert!((left - right).abs() > 1e-6, "parts of one value could not tell the mask: {left} {right}");
    assert!(((n * left + m * right) / (n + m) - whole).abs() < 1e-12);
    assert_eq!(part(&|_| false).0, None);
    let small = Mask::filled(ImageSize { width: 14, height: 16 }, true);
    assert!(map.mean_inside(&small).is_err());
}
