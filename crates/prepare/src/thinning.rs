//! Some of many, evenly chosen.

/// At most so many of a list, at equal distances in it.
pub(crate) fn evenly<T: Copy>(all: Vec<T>, most: usize) -> Vec<T> {
    if all.len() <= most {
        return all;
    }
    (0..most).map(|k| all[k * all.len() / most]).collect()
}

#[cfg(test)]
mod tests {
    use super::evenly;

    #[test]
    fn they_are_few_and_from_everywhere() {
        assert_eq!(evenly((0..10).collect(), 4), [0, 2, 5, 7]);
        assert_eq!(evenly(vec![3, 4], 4), [3, 4]);
        assert!(evenly(vec![3, 4], 0).is_empty());
    }
}
