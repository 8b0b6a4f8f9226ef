//! Image pyramids: grey levels and derivatives at halved sizes, for motions larger than a window.

use ffgs_core::kernel::{Kernel, dispatch};
use ffgs_core::{ImageRgb8, ImageSize};

/// Pixels repeated around every level, so that windows may reach over the border.
pub(crate) const PAD: usize = 10;
/// A level with a shorter side than this has too little content for a window.
const SMALLEST_SIDE: usize = 20;

/// One level: grey values (0 to 255) and their derivatives per pixel of this level, padded by repetition.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    pub size: ImageSize,
    stride: usize,
    pub grey: Vec<f32>,
    pub dx: Vec<f32>,
    pub dy: Vec<f32>,
}

/// Grey image in halves of its size. With pixel centres at + 0.5, a position of one level is half of that one level
/// below it, exactly, because the filter (1 3 3 1) is even.
#[derive(Clone, Debug)]
pub struct Pyramid {
    pub(crate) levels: Vec<Level>,
}

impl Pyramid {
    /// The pyramid of a photograph, of at most `levels` levels.
    pub fn new(image: &ImageRgb8, levels: usize) -> Self {
        dispatch(Build { image, levels })
    }
}

struct Build<'a> {
    image: &'a ImageRgb8,
    levels: usize,
}

impl Kernel for Build<'_> {
    type Output = Pyramid;

    #[inline(always)]
    fn run<const FMA: bool>(self) -> Pyramid {
        let Self { image, levels } = self;
        let grey = |p: &[u8]| 0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2]);
        let mut data: Vec<f32> = image.data().chunks_exact(3).map(grey).collect();
        let mut size = image.size();
        let mut out = Pyramid { levels: vec![Level::new(&data, size)] };
        while out.levels.len() < levels && size.width.min(size.height) >= 2 * SMALLEST_SIDE {
            (data, size) = halved(&data, size);
            out.levels.push(Level::new(&data, size));
        }
        out
    }
}

impl Level {
    #[inline(always)]
    fn new(data: &[f32], size: ImageSize) -> Self {
        let stride = size.width + 2 * PAD;
        let grey = padded(data, size);
        let mut level = Self { size, stride, dx: vec![0.0; grey.len()], dy: vec![0.0; grey.len()], grey };
        level.differentiate();
        level
    }

    /// Scharr's derivatives.
    #[inline(always)]
    fn differentiate(&mut self) {
        let (s, g) = (self.stride, &self.grey);
        let rows = g.len() / s;
        for y in 1..rows - 1 {
            let (above, here, below) =
                (&g[(y - 1) * s..y * s], &g[y * s..(y + 1) * s], &g[(y + 1) * s..(y + 2) * s]);
            let (dx, dy) = (&mut self.dx[y * s..(y + 1) * s], &mut self.dy[y * s..(y + 1) * s]);
            let (above, here, below) = (&above[..s], &here[..s], &below[..s]);
            let (dx, dy) = (&mut dx[..s], &mut dy[..s]);
            for x in 1..s - 1 {
                let right = 3.0 * (above[x + 1] + below[x + 1]) + 10.0 * here[x + 1];
                let left = 3.0 * (above[x - 1] + below[x - 1]) + 10.0 * here[x - 1];
                dx[x] = (right - left) / 32.0;
                let down = 3.0 * (below[x - 1] + below[x + 1]) + 10.0 * below[x];
                let up = 3.0 * (above[x - 1] + above[x + 1]) + 10.0 * above[x];
                dy[x] = (down - up) / 32.0;
            }
        }
    }

    /// Index of a pixel in the padded planes; it may lie up to `PAD` outside.
    pub(crate) fn index(&self, column: isize, row: isize) -> usize {
        (row + PAD as isize) as usize * self.stride + (column + PAD as isize) as usize
    }

    /// Length of a padded row.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }
}

fn padded(data: &[f32], size: ImageSize) -> Vec<f32> {
    let mut out = Vec::with_capacity((size.width + 2 * PAD) * (size.height + 2 * PAD));
    for y in 0..size.height + 2 * PAD {
        let row = y.saturating_sub(PAD).min(size.height - 1);
        let row = &data[row * size.width..(row + 1) * size.width];
        out.extend(std::iter::repeat_n(row[0], PAD));
        out.extend_from_slice(row);
        out.extend(std::iter::repeat_n(row[size.width - 1], PAD));
    }
    out
}

/// Half the size (rounded up), filtered by (1 3 3 1) / 8 in both directions; borders repeat.
#[inline(always)]
fn halved(data: &[f32], size: ImageSize) -> (Vec<f32>, ImageSize) {
    let half = ImageSize { width: size.width.div_ceil(2), height: size.height.div_ceil(2) };
    let taps = |i: usize, n: usize| {
        let at = |offset: isize| (2 * i as isize + offset).clamp(0, n as isize - 1) as usize;
        [at(-1), at(0), at(1), at(2)]
    };
    let filter = |v: [f32; 4]| (v[0] + v[3] + 3.0 * (v[1] + v[2])) / 8.0;
    let mut narrow = vec![0.0; half.width * size.height];
    for (row, out) in data.chunks_exact(size.width).zip(narrow.chunks_exact_mut(half.width)) {
        // Inside the borders no index has to be bounded.
        let inside = row.get(1..).unwrap_or_default().windows(4).step_by(2);
        for (out, v) in out[1..].iter_mut().zip(inside) {
            *out = filter([v[0], v[1], v[2], v[3]]);
        }
        for x in [0, half.width - 1] {
            out[x] = filter(taps(x, size.width).map(|i| row[i]));
        }
    }
    let mut out = vec![0.0; half.pixels()];
    for (y, out) in out.chunks_exact_mut(half.width).enumerate() {
        let [a, b, c, d] = taps(y, size.height).map(|r| &narrow[r * half.width..][..half.width]);
        for x in 0..out.len() {
            out[x] = filter([a[x], b[x], c[x], d[x]]);
        }
    }
    (out, half)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_shows_the_same_place() {
        let size = ImageSize { width: 160, height: 80 };
        // A plane: its value at a position is the same in every level.
        let value = |x: f32, y: f32| 0.9 * x + 0.6 * y;
        let plane: Vec<f32> =
            (0..size.pixels()).map(|i| value((i % 160) as f32 + 0.5, (i / 160) as f32 + 0.5)).collect();
        let (half, half_size) = halved(&plane, size);
        let (quarter, quarter_size) = halved(&half, half_size);
        for (data, size, factor) in [(half, half_size, 2.0), (quarter, quarter_size, 4.0)] {
            let (x, y) = (size.width / 2, size.height / 2);
            let wanted = value((x as f32 + 0.5) * factor, (y as f32 + 0.5) * factor);
            assert!((data[y * size.width + x] - wanted).abs() < 1e-3);
            let level = Level::new(&data, size);
            let at = level.index(x as isize, y as isize);
            assert!((level.dx[at] - 0.9 * factor).abs() < 1e-3 && (level.dy[at] - 0.6 * factor).abs() < 1e-3);
        }
    }
}
