//! Binary foreground masks, and their dilation.

use crate::ImageSize;

/// A binary foreground mask, one byte per pixel, 0 or 1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    size: ImageSize,
    data: Vec<u8>,
}

impl Mask {
    /// Any non-zero byte is foreground; `None` when the length is not `height * width`.
    pub fn new(size: ImageSize, mut data: Vec<u8>) -> Option<Self> {
        data.iter_mut().for_each(|v| *v = u8::from(*v != 0));
        (data.len() == size.pixels()).then_some(Self { size, data })
    }

    /// A mask with every pixel foreground (`true`) or background.
    pub fn filled(size: ImageSize, foreground: bool) -> Self {
        Self { size, data: vec![u8::from(foreground); size.pixels()] }
    }

    /// Mask size.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Row-major bytes, 0 or 1.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// Whether a pixel is foreground.
    pub fn contains(&self, column: usize, row: usize) -> bool {
        self.data[row * self.size.width + column] != 0
    }

    /// Number of foreground pixels.
    pub fn count(&self) -> usize {
        self.data.iter().map(|&v| usize::from(v)).sum()
    }

    /// Grows the foreground by a square of `radius` pixels (separable maximum).
    #[must_use]
    pub fn dilated(&self, radius: usize) -> Self {
        let ImageSize { width, height } = self.size;
        let mut data = vec![0; self.data.len()];
        let mut wide = vec![0; width];
        for (y, row) in self.data.chunks_exact(width).enumerate() {
            if row.iter().fold(0, |any, v| any | v) == 0 {
                continue;
            }
            wide.fill(0);
            spread(width, radius, |x| row[x] != 0, |x| wide[x] = 1);
            // Whole rows at a time: down the columns every byte would be another cache line.
            let near = y.saturating_sub(radius) * width..(y + radius + 1).min(height) * width;
            for out in data[near].chunks_exact_mut(width) {
                out.iter_mut().zip(&wide).for_each(|(o, &v)| *o |= v);
            }
        }
        Self { size: self.size, data }
    }

    /// Grows the foreground by the margin that `pixels` are on an image whose longer side has 320 of them, and by no less: outlines
    /// err by a share of the image, as those who draw or find them see it as a whole.
    #[must_use]
    pub fn widened(&self, pixels: usize) -> Self {
        self.dilated(self.margin(pixels))
    }

    /// The radius (px) by which [`widened`](Self::widened) grows.
    pub fn margin(&self, pixels: usize) -> usize {
        (pixels as f64 * self.size.enlargement()).round() as usize
    }

    /// Without the parts that no square of `2 radius + 1` pixels fits into (morphological opening).
    #[must_use]
    pub fn opened(&self, radius: usize) -> Self {
        let inverse = |mask: &Self| Self { size: mask.size, data: mask.data.iter().map(|v| 1 - v).collect() };
        inverse(&inverse(self).dilated(radius)).dilated(radius)
    }
}

/// Marks every position within `radius` of a set one, in linear time.
fn spread(n: usize, radius: usize, is_set: impl Fn(usize) -> bool, mut mark: impl FnMut(usize)) {
    let mut done = 0;
    for i in (0..n).filter(|&i| is_set(i)) {
        let end = (i + radius + 1).min(n);
        for j in done.max(i.saturating_sub(radius))..end {
            mark(j);
        }
        done = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dilation_is_a_square_clipped_at_the_border() {
        let size = ImageSize { width: 7, height: 5 };
        let mut data = vec![0; 35];
        data[0] = 255;
        data[3 * 7 + 4] = 1;
        let mask = Mask::new(size, data).unwrap().dilated(1);
        for y in 0..5 {
            for x in 0..7 {
                let near = (x <= 1 && y <= 1) || ((3..=5).contains(&x) && (2..=4).contains(&y));
                assert_eq!(mask.contains(x, y), near, "({x}, {y})");
            }
        }
        assert_eq!(mask.count(), 4 + 9);
    }

    #[test]
    fn a_margin_is_as_wide_a_share_of_every_image() {
        let dot = |size: ImageSize| {
            let middle = size.height / 2 * size.width + size.width / 2;
            let data = (0..size.pixels()).map(|p| u8::from(p == middle)).collect();
            Mask::new(size, data).unwrap().widened(2).count()
        };
        assert_eq!(dot(ImageSize { width: 320, height: 180 }), 5 * 5);
        assert_eq!(dot(ImageSize { width: 1080, height: 1920 }), 25 * 25);
        assert_eq!(dot(ImageSize { width: 64, height: 48 }), 5 * 5, "no less on small images");
    }

    #[test]
    fn opening_removes_what_is_narrow_and_keeps_the_rest() {
        let size = ImageSize { width: 12, height: 9 };
        // A square of 5 pixels, a line beside it, a dot.
        let set = |p: usize| {
            let (x, y) = (p % 12, p / 12);
            u8::from((1..6).contains(&x) && (2..7).contains(&y) || y == 4 && x < 10 || (x, y) == (11, 0))
        };
        let mask = Mask::new(size, (0..size.pixels()).map(set).collect()).unwrap();
        let opened = mask.opened(1);
        assert_eq!(opened.count(), 25);
        assert!(
            opened.contains(1, 2)
                && opened.contains(5, 6)
                && !opened.contains(8, 4)
                && !opened.contains(11, 0)
        );
        assert_eq!(mask.opened(0), mask);
        assert_eq!(mask.opened(3).count(), 0);
    }
}
