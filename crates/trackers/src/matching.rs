use crate::Descriptor;

/// The nearest descriptor, and how near the nearest two are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbours {
    /// Index of the nearest one.
    pub index: usize,
    /// Squared distance to it.
    pub nearest: f32,
    /// Squared distance to the second; infinite when there is none.
    pub second: f32,
}

impl Neighbours {
    /// Lowe's ratio test.
    pub fn is_distinct(&self, ratio: f32) -> bool {
        self.nearest < ratio * ratio * self.second
    }
}

/// The two nearest of the candidates (indices into `all`); `None` without candidates.
pub fn nearest_two(
    wanted: &Descriptor,
    all: &[Descriptor],
    candidates: impl IntoIterator<Item = usize>,
) -> Option<Neighbours> {
    let mut best: Option<Neighbours> = None;
    for index in candidates {
        let distance = squared_distance(wanted, &all[index]);
        best = Some(match best {
            None => Neighbours { index, nearest: distance, second: f32::INFINITY },
            Some(b) if distance < b.nearest => Neighbours { index, nearest: distance, second: b.nearest },
            Some(b) => Neighbours { second: b.second.min(distance), ..b },
        });
    }
    best
}

/// In a fixed order of sixteen partial sums.
fn squared_distance(a: &Descriptor, b: &Descriptor) -> f32 {
    let mut sums = [0.0_f32; 16];
    for (x, y) in a.as_chunks::<16>().0.iter().zip(b.as_chunks::<16>().0) {
        for ((s, x), y) in sums.iter_mut().zip(x).zip(y) {
            *s += (x - y) * (x - y);
        }
    }
    sums.iter().sum()
}
