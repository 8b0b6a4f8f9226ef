//! SSIM and its gradients against float64 values of an independent implementation (fixtures/reference/ssim).

use ffgs_core::{ImageRgb8, ImageSize, PlanarImage};
use ffgs_metrics::{
    Border, LossAndGradient, SsimError, SsimPair, image_ssim, loss_3dgs, ssim, ssim_and_gradient,
};
use npyz::npz::NpzArchive;
use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;

/// The reference's maps are stored as f32, its images too; values and gradients as f64.
const TOLERANCE: f64 = 1e-6;

struct Fixture(NpzArchive<BufReader<File>>);

impl Fixture {
    fn open() -> Self {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/reference/ssim/ssim.npz");
        Self(NpzArchive::new(BufReader::new(File::open(path).unwrap())).unwrap())
    }

    fn cases(&self) -> Vec<String> {
        let name = |key: &str| key.strip_suffix("__img1").map(str::to_owned);
        let mut names: Vec<String> = self.0.array_names().filter_map(name).collect();
        names.sort();
        names
    }

    fn f32(&mut self, case: &str, key: &str) -> (Vec<u64>, Vec<f32>) {
        let array = self.0.by_name(&format!("{case}__{key}")).unwrap().unwrap();
        (array.shape().to_vec(), array.into_vec().unwrap())
    }

    fn f64(&mut self, case: &str, key: &str) -> Vec<f64> {
        self.0.by_name(&format!("{case}__{key}")).unwrap().unwrap().into_vec().unwrap()
    }
}

fn assert_close(case: &str, key: &str, found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{case} {key}");
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst <= TOLERANCE, "{case} {key}: off by {worst:.1e}");
}

fn check(fixture: &mut Fixture, case: &str, prefix: &str, found: &LossAndGradient) {
    assert_close(case, prefix, &[found.value], &fixture.f64(case, &format!("{prefix}_value")));
    assert_close(case, prefix, &found.gradient, &fixture.f64(case, &format!("{prefix}_grad")));
    if prefix != "loss3dgs" {
        let (_, map) = fixture.f32(case, &format!("{prefix}_map"));
        let map: Vec<f64> = map.into_iter().map(f64::from).collect();
        assert_close(case, &format!("{prefix}_map"), &found.map, &map);
    }
}

#[test]
fn every_reference_case_holds() {
    let mut fixture = Fixture::open();
    let cases = fixture.cases();
    assert!(cases.len() >= 8);
    for case in &cases {
        let (shape, rendered) = fixture.f32(case, "img1");
        let (_, target) = fixture.f32(case, "img2");
        let shape = [shape[0] as usize, shape[1] as usize, shape[2] as usize];
        let pair = SsimPair::new(shape, &rendered, &target).unwrap();
        let same = ssim_and_gradient(pair, Border::Same).unwrap();
        assert!((ssim(pair, Border::Same).unwrap() - same.value).abs() < 1e-12);
        check(&mut fixture, case, "same", &same);
        check(&mut fixture, case, "valid", &ssim_and_gradient(pair, Border::Valid).unwrap());
        check(&mut fixture, case, "loss3dgs", &loss_3dgs(pair).unwrap());
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
    assert!((image_ssim(&rendered, &target).unwrap() - 1.0).abs() < 1e-12);
    rendered.data_mut()[3] = f32::NAN;
    let value = image_ssim(&rendered, &target).unwrap();
    assert!(value.is_finite() && value < 1.0);
}
