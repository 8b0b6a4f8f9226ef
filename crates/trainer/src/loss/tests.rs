//! Tests of the loss against its definition in f64 and against finite differences.

use super::*;

const SIZE: ImageSize = ImageSize { width: 37, height: 29 };

/// Deterministic noise in 0..1 (a linear congruential generator).
fn noise(seed: u64, n: usize) -> Vec<f32> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    (0..n).map(|_| next()).collect()
}

fn images(size: ImageSize) -> (PlanarImage, ImageRgb8) {
    let n = size.pixels() * 3;
    let mut rendered = PlanarImage::zeros(size);
    rendered.data_mut().copy_from_slice(&noise(1, n));
    let target = noise(2, n).iter().map(|v| (v * 255.0) as u8).collect();
    (rendered, ImageRgb8::new(size, target).unwrap())
}

fn disc(size: ImageSize) -> Mask {
    let inside = |i: usize| {
        let (x, y) = ((i % size.width) as f64 - 20.0, (i / size.width) as f64 - 9.0);
        u8::from(x * x + y * y < 70.0)
    };
    Mask::new(size, (0..size.pixels()).map(inside).collect()).unwrap()
}

/// The definition in f64: composite, a window of 11 x 11 pixels at every counted pixel, means.
fn naive(rendered: &[f64], target: &ImageRgb8, mask: Option<&Mask>) -> LossValue {
    let size = target.size();
    let n = size.pixels();
    let counts = |i: usize| mask.is_none_or(|m| m.data()[i] != 0);
    let mut sums = LossValue::default();
    for c in 0..3 {
        let y: Vec<f64> = (0..n).map(|i| f64::from(target.data()[i * 3 + c]) / 255.0).collect();
        let x: Vec<f64> = (0..n).map(|i| if counts(i) { rendered[c * n + i] } else { y[i] }).collect();
        for i in (0..n).filter(|&i| counts(i)) {
            sums.l1 += (x[i] - y[i]).abs();
            sums.mse += (x[i] - y[i]).powi(2);
            sums.ssim += naive_ssim(&x, &y, size, i);
        }
    }
    let samples = 3.0 * (0..n).filter(|&i| counts(i)).count() as f64;
    let (l1, ssim, mse) = (sums.l1 / samples, sums.ssim / samples, sums.mse / samples);
    LossValue { total: 0.8 * l1 + 0.2 * (1.0 - ssim), l1, ssim, mse }
}

fn naive_ssim(x: &[f64], y: &[f64], size: ImageSize, centre: usize) -> f64 {
    let tap = |d: i64| (-((d * d) as f64) / 4.5).exp();
    let norm: f64 = (-5..=5).map(tap).sum();
    let (cx, cy) = ((centre % size.width) as i64, (centre / size.width) as i64);
    let mut m = [0.0; 5];
    for (dy, dx) in (-5..=5).flat_map(|dy| (-5..=5).map(move |dx| (dy, dx))) {
        let (px, py) = (cx + dx, cy + dy);
        if px < 0 || py < 0 || px >= size.width as i64 || py >= size.height as i64 {
            continue;
        }
        let i = py as usize * size.width + px as usize;
        let w = tap(dx) * tap(dy) / (norm * norm);
        for (sum, v) in m.iter_mut().zip([x[i], y[i], x[i] * x[i], y[i] * y[i], x[i] * y[i]]) {
            *sum += w * v;
        }
    }
    let [mx, my, xx, yy, xy] = m;
    let (c1, c2) = (0.0001, 0.0009);
    let similar = (2.0 * mx * my + c1) * (2.0 * (xy - mx * my) + c2);
    similar / ((mx * mx + my * my + c1) * (xx - mx * mx + yy - my * my + c2))
}

fn assert_matches_definition(mask: Option<&Mask>) {
    let (rendered, target) = images(SIZE);
    let region = mask.map_or(LossRegion::Full, LossRegion::Mask);
    let mut gradient = PlanarImage::zeros(SIZE);
    let value = PhotometricLoss::new().evaluate(&rendered, &target, region, &mut gradient);
    let mut x: Vec<f64> = rendered.data().iter().map(|&v| f64::from(v)).collect();
    let want = naive(&x, &target, mask);
    for (a, b) in
        [(value.total, want.total), (value.l1, want.l1), (value.ssim, want.ssim), (value.mse, want.mse)]
    {
        assert!((a - b).abs() < 2e-6, "{value:?} {want:?}");
    }
    let scale = gradient.data().iter().fold(0.0f32, |m, v| m.max(v.abs()));
    for i in (0..x.len()).step_by(41) {
        let (step, at) = (1e-6, x[i]);
        x[i] = at + step;
        let above = naive(&x, &target, mask).total;
        x[i] = at - step;
        let below = naive(&x, &target, mask).total;
        x[i] = at;
        let want = (above - below) / (2.0 * step);
        let error = (f64::from(gradient.data()[i]) - want).abs() / f64::from(scale);
        assert!(error < 1e-4, "sample {i}: {} against {want}", gradient.data()[i]);
    }
}

#[test]
fn value_and_gradient_match_the_definition() {
    assert_matches_definition(None);
}

#[test]
fn the_masked_loss_matches_its_definition() {
    assert_matches_definition(Some(&disc(SIZE)));
}

#[test]
fn scratch_carries_nothing_from_one_call_to_the_next() {
    let size = ImageSize { width: 150, height: 70 };
    let (rendered, target) = images(size);
    let mask = disc(size);
    let fresh = |region: LossRegion| {
        let mut gradient = PlanarImage::zeros(size);
        let value = PhotometricLoss::new().evaluate(&rendered, &target, region, &mut gradient);
        (value, gradient)
    };
    let mut shared = (PhotometricLoss::new(), PlanarImage::zeros(SIZE));
    for region in [LossRegion::Full, LossRegion::Mask(&mask), LossRegion::Full, LossRegion::Mask(&mask)] {
        let value = shared.0.evaluate(&rendered, &target, region, &mut shared.1);
        assert_eq!((value, shared.1.clone()), fresh(region));
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let size = ImageSize { width: 150, height: 70 };
    let (rendered, target) = images(size);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut gradient = PlanarImage::zeros(size);
        let mut loss = PhotometricLoss::new();
        let value = pool.install(|| loss.evaluate(&rendered, &target, LossRegion::Full, &mut gradient));
        (value, gradient)
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn an_empty_mask_gives_zero() {
    let (rendered, target) = images(SIZE);
    let mask = Mask::filled(SIZE, false);
    let mut gradient = rendered.clone();
    let value = PhotometricLoss::new().evaluate(&rendered, &target, LossRegion::Mask(&mask), &mut gradient);
    assert_eq!(value, LossValue::default());
    assert!(gradient.data().iter().all(|&v| v == 0.0));
}
