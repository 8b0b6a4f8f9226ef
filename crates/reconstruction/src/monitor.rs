//! How a caller follows the trainings of a frame while they run.

use ffgs_trainer::Progress;

/// Called after every step of a training; dropped at its end.
pub type Report<'a> = Box<dyn Fn(Progress) + Send + Sync + 'a>;

/// Is told of trainings, several of which may run at the same time.
pub trait Monitor: Sync {
    /// A training of at most `iterations` steps begins.
    fn begin(&self, name: &'static str, iterations: usize) -> Report<'_>;
}

/// Shows nothing.
#[derive(Clone, Copy, Debug)]
pub struct Silent;

impl Monitor for Silent {
    fn begin(&self, _: &'static str, _: usize) -> Report<'_> {
        Box::new(|_| {})
    }
}
