//! The median of some numbers.

/// The mean of the two middle values, or the one in the middle, as numpy's; `None` of nothing.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (below, upper, odd) = split(values)?;
    let lower = below.into_iter().reduce(f64::max).filter(|_| !odd);
    Some(lower.map_or(upper, |lower| f64::midpoint(lower, upper)))
}

/// The upper one of the two middle values, or the one in the middle: one of the values in any case. `None` of nothing.
pub fn upper_median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    split(values).map(|(_, upper, _)| upper)
}

/// The values below the upper middle one, that one, and whether their number is odd.
fn split(values: impl IntoIterator<Item = f64>) -> Option<(Vec<f64>, f64, bool)> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let (count, half) = (values.len(), values.len() / 2);
    if count == 0 {
        return None;
    }
    let (_, &mut upper, _) = values.select_nth_unstable_by(half, f64::total_cmp);
    values.truncate(half);
    Some((values, upper, count % 2 == 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_numbers_of_values_have_two_middles() {
        assert_eq!((median([3.0, 1.0, 2.0]), upper_median([3.0, 1.0, 2.0])), (Some(2.0), Some(2.0)));
        assert_eq!(
            (median([4.0, 1.0, 3.0, 2.0]), upper_median([4.0, 1.0, 3.0, 2.0])),
            (Some(2.5), Some(3.0))
        );
        assert_eq!((median([]), upper_median([])), (None, None));
        assert_eq!((median([7.0]), upper_median([7.0])), (Some(7.0), Some(7.0)));
    }
}
