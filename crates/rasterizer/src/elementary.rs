//! Exponential, logarithm and sigmoid without branches and calls, so that a loop over Gaussians can be vectorised.

/// `exp(x)` to a relative error below 1.2e-7; NaN for NaN. `x` is limited to -87..=88, where the result is a normal number.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    /// 1.5 * 2^23: a sum with it has the nearest integer in its low bits.
    const ROUND: f32 = 12_582_912.0;
    // Comparisons, not `clamp`: NaN must come through.
    let x = if x < -87.0 { -87.0 } else { x };
    let x = if x > 88.0 { 88.0 } else { x };
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    // ln 2 in two parts: n times the first is exact (Cody and Waite 1980).
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let p = (1.0 / 5040.0 * r + 1.0 / 720.0) * r + 1.0 / 120.0;
    let p = ((p * r + 1.0 / 24.0) * r + 1.0 / 6.0) * r + 0.5;
    let p = 1.0 + (p * r * r + r);
    p * f32::from_bits((shifted.to_bits() << 23).wrapping_add(1.0_f32.to_bits()))
}

/// `ln(x)` for positive normal `x`, to an error below 3e-7 (absolute near 1, else relative).
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    /// Bits of sqrt(1/2): mantissas are taken from there to sqrt(2).
    const LOW: u32 = 0x3f35_04f3;
    let offset = x.to_bits().wrapping_sub(LOW);
    let exponent = (offset as i32) >> 23;
    let m = f32::from_bits((offset & 0x007f_ffff).wrapping_add(LOW));
    // ln m = 2 atanh(s).
    let s = (m - 1.0) / (m + 1.0);
    let q = s * s;
    let series = (((q / 9.0 + 1.0 / 7.0) * q + 0.2) * q + 1.0 / 3.0) * q + 1.0;
    2.0 * s * series + exponent as f32 * std::f32::consts::LN_2
}

/// `1 / (1 + exp(-x))`.
#[inline(always)]
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_and_logarithm_are_accurate() {
        for i in -8600..8700 {
            let x = i as f32 * 1e-2;
            let exact = f64::from(x).exp();
            assert!((f64::from(exp(x)) / exact - 1.0).abs() < 1.2e-7, "exp({x})");
            let y = exp(x);
            let error = (f64::from(ln(y)) - f64::from(y).ln()).abs();
            assert!(error < 3e-7 * f64::from(y).ln().abs().max(1.0), "ln({y})");
        }
        assert!((f64::from(ln(255.0 * 0.004)) - f64::from(255.0_f32 * 0.004).ln()).abs() < 1e-7);
    }

    #[test]
    fn what_is_not_finite_stays_visible() {
        assert!(exp(f32::NAN).is_nan());
        assert!(exp(f32::INFINITY) > 1e38 && exp(f32::NEG_INFINITY) < 1e-37);
    }
}
