//! How much masks change from one round to the next.

use ffgs_core::Mask;
use std::ops::Add;

/// Pixels that one of two masks holds, and pixels that one holds or both do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Change {
    one: usize,
    any: usize,
}

impl Change {
    pub(crate) fn between(a: &Mask, b: &Mask) -> Self {
        let held =
            |both: bool| a.data().iter().zip(b.data()).filter(|(a, b)| **a + **b > u8::from(both)).count();
        let any = held(false);
        Self { one: any - held(true), any }
    }

    /// The share of what the masks hold, in which they differ.
    pub(crate) fn share(self) -> f64 {
        self.one as f64 / self.any.max(1) as f64
    }
}

impl Add for Change {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { one: self.one + other.one, any: self.any + other.any }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    #[test]
    fn what_one_mask_alone_holds_is_the_change() {
        let mask = |values: [u8; 5]| Mask::new(ImageSize { width: 5, height: 1 }, values.to_vec()).unwrap();
        let change = Change::between(&mask([1, 1, 1, 0, 0]), &mask([0, 1, 1, 1, 0]));
        assert_eq!(change, Change { one: 2, any: 4 });
        let same = Change::between(&mask([0, 1, 1, 1, 1]), &mask([0, 1, 1, 1, 1]));
        assert_eq!((change + same).share(), 0.25);
        assert_eq!(Change::default().share(), 0.0, "nothing in any mask");
    }
}
