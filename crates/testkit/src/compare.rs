//! Comparisons of numbers that fail on NaN.

/// Largest magnitude; infinite when a value is NaN (`f64::max` would drop it), 0 without values.
pub fn largest(values: impl IntoIterator<Item: Into<f64>>) -> f64 {
    let magnitude = |value: f64| if value.is_nan() { f64::INFINITY } else { value.abs() };
    values.into_iter().map(|value| magnitude(value.into())).fold(0.0, f64::max)
}

/// Largest absolute difference of two columns of one length; infinite when a value of either is NaN, so that
/// `difference < tolerance` fails.
pub fn largest_difference<A, B>(found: &[A], expected: &[B]) -> f64
where
    A: Copy + Into<f64>,
    B: Copy + Into<f64>,
{
    assert_eq!(found.len(), expected.len(), "columns of different lengths");
    largest(found.iter().zip(expected).map(|(&a, &b)| a.into() - b.into()))
}

/// [`largest_difference`] in units of the largest expected magnitude, which is taken as at least 1e-12.
pub fn relative_difference<A, B>(found: &[A], expected: &[B]) -> f64
where
    A: Copy + Into<f64>,
    B: Copy + Into<f64>,
{
    let scale = largest(expected.iter().copied());
    let difference = largest_difference(found, expected);
    // Infinity over infinity would be NaN.
    if difference.is_finite() { difference / scale.max(1e-12) } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_those_of_the_worst_value() {
        assert_eq!(largest_difference(&[1.0_f32, -2.0, 0.5], &[1.0, -2.25, 0.5]), 0.25);
        assert_eq!(relative_difference(&[1.0, -2.0], &[1.0, -2.5]), 0.2);
        assert_eq!(largest([1.0, -3.0]), 3.0);
        assert_eq!(largest(Vec::<f64>::new()), 0.0);
        assert_eq!(relative_difference(&[0.0], &[0.0]), 0.0);
    }

    /// The negative control: one NaN, in any place and on either side, exceeds every tolerance.
    #[test]
    fn a_nan_on_either_side_is_an_infinite_difference() {
        let sound = [0.5, 1.0, 2.0];
        for place in 0..sound.len() {
            for nan in [f64::NAN, -f64::NAN] {
                let mut broken = sound;
                broken[place] = nan;
                for (found, expected) in [(&broken, &sound), (&sound, &broken), (&broken, &broken)] {
                    assert_eq!(largest_difference(found, expected), f64::INFINITY);
                    assert_eq!(relative_difference(found, expected), f64::INFINITY);
                }
                assert_eq!(largest(broken), f64::INFINITY);
            }
        }
    }

    #[test]
    fn infinities_are_never_close_to_anything() {
        assert_eq!(largest_difference(&[f64::INFINITY], &[1.0]), f64::INFINITY);
        assert_eq!(largest_difference(&[f64::INFINITY], &[f64::INFINITY]), f64::INFINITY);
        assert_eq!(relative_difference(&[1.0], &[f64::INFINITY]), f64::INFINITY);
    }

    #[test]
    #[should_panic(expected = "different lengths")]
    fn a_column_that_is_too_short_is_no_match() {
        largest_difference(&[1.0], &[1.0, 2.0]);
    }
}
