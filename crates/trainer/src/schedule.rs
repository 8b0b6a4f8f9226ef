use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Draws items in epochs: every item once in a seeded random order, then again in another.
#[derive(Clone, Debug)]
pub struct Epochs {
    order: Vec<usize>,
    next: usize,
    rng: ChaCha8Rng,
}

impl Epochs {
    /// Draws from `items`, in orders that `seed` fixes.
    pub fn new(items: Vec<usize>, seed: u64) -> Self {
        let next = items.len();
        Self { order: items, next, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// The next item; `None` when there are none at all.
    pub fn draw(&mut self) -> Option<usize> {
        if self.next >= self.order.len() {
            self.order.shuffle(&mut self.rng);
            self.next = 0;
        }
        self.next += 1;
        self.order.get(self.next - 1).copied()
    }
}

/// Log-linear interpolation from `start` to `end`.
pub fn decay(start: f32, end: f32, iteration: usize, iterations: usize) -> f32 {
    let t = iteration as f32 / iterations.max(1) as f32;
    (start.ln() * (1.0 - t) + end.ln() * t).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_epoch_visits_every_item_once() {
        let mut epochs = Epochs::new(vec![3, 5, 8], 1);
        for _ in 0..4 {
            let mut seen: Vec<_> = (0..3).map(|_| epochs.draw().unwrap()).collect();
            seen.sort_unstable();
            assert_eq!(seen, [3, 5, 8]);
        }
        assert_eq!(Epochs::new(Vec::new(), 1).draw(), None);
    }
}
