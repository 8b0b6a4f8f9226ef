//! How a caller follows the preparation.

/// Told how far a step is; called from any thread.
pub trait Progress: Sync {
    /// `done` of `total` parts of a step are finished.
    fn advance(&self, step: &str, done: usize, total: usize);
}

impl<F: Fn(&str, usize, usize) + Sync> Progress for F {
    fn advance(&self, step: &str, done: usize, total: usize) {
        self(step, done, total);
    }
}
