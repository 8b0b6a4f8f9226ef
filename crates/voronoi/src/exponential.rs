//! A fast exponential that loops over pixels can be vectorised with.

/// `exp(-x)` for `x >= 0`, relative error below 1e-11; 0 beyond the normal numbers. No call, so that loops over it become
/// vectors.
#[inline(always)]
pub(crate) fn exp_negative(x: f64) -> f64 {
    /// Adding this rounds to a whole number, which is then in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const INVERSE_FACTORIALS: [f64; 10] = [
        1.0,
        1.0,
        1.0 / 2.0,
        1.0 / 6.0,
        1.0 / 24.0,
        1.0 / 120.0,
        1.0 / 720.0,
        1.0 / 5040.0,
        1.0 / 40320.0,
        1.0 / 362_880.0,
    ];
    let octaves = if x < 700.0 { x } else { 700.0 } * -std::f64::consts::LOG2_E;
    let rounded = octaves + ROUND;
    let rest = (octaves - (rounded - ROUND)) * std::f64::consts::LN_2;
    let mut power = INVERSE_FACTORIALS[9];
    for i in (0..9).rev() {
        power = power * rest + INVERSE_FACTORIALS[i];
    }
    let scale = f64::from_bits((rounded.to_bits() << 52).wrapping_add(1023 << 52));
    if x < 700.0 { power * scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_accurate_and_ends_at_zero() {
        for i in 0..70_000 {
            let x = f64::from(i) * 0.01;
            let exact = (-x).exp();
            assert!((exp_negative(x) - exact).abs() <= 2e-11 * exact, "exp(-{x})");
        }
        assert_eq!(exp_negative(0.0), 1.0);
        assert_eq!(exp_negative(1e300), 0.0);
    }
}
