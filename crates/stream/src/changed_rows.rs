//! Static Gaussians whose shape has changed: those that were trained where moving objects had occluded them.

use crate::delta::{Residual, ResidualModels};
use crate::numbers::Flag;
use crate::range_coder::{Coder, Decoder, Encoder};
use crate::row::Row;
use crate::row_models::RowModels;
use crate::steps::{Measures, Steps};

/// A quaternion's component that is not stored follows from the others; below this magnitude their errors would grow in it.
const LEAST_LARGEST: f64 = 0.5;

/// What becomes of a row.
enum Change {
    /// It stays: colours are another section's.
    Stays,
    /// Differences to what it was.
    By(Residual),
    /// Another Gaussian has taken its place.
    To(Row),
}

impl Change {
    fn of(target: &Measures, row: &Row, steps: &Steps) -> Self {
        let target = &target.like(row, steps);
        let residual = Residual::of(target, row, steps);
        if !residual.changes_shape() {
            return Self::Stays;
        }
        let new = Row::rounded(target, steps, row.group);
        let finer = steps.level(new.scales) < steps.level(row.scales);
        let turned = target.quat[usize::from(row.largest)].abs() < LEAST_LARGEST;
        if finer || turned { Self::To(new) } else { Self::By(residual) }
    }
}

/// How many rows would be sent.
pub(crate) fn count(rows: &[Row], steps: &Steps, target: impl Fn(usize) -> Measures) -> usize {
    let changes = |(i, row): &(usize, &Row)| Residual::of(&target(*i), row, steps).changes_shape();
    rows.iter().enumerate().filter(changes).count()
}

/// Rows whose shape differs from the target's; they become what a receiver has.
pub(crate) fn encode_rows(rows: &mut [Row], steps: &Steps, target: impl Fn(usize) -> Measures) -> Vec<u8> {
    let (mut coder, mut models) = (Encoder::new(), Models::new(steps));
    for (i, row) in rows.iter_mut().enumerate() {
        models.code(&mut coder, steps, row, &Change::of(&target(i), row, steps));
    }
    coder.finish()
}

/// Applies [`encode_rows`].
pub(crate) fn decode_rows(rows: &mut [Row], steps: &Steps, bytes: &[u8]) {
    let (mut coder, mut models) = (Decoder::new(bytes), Models::new(steps));
    rows.iter_mut().for_each(|row| models.code(&mut coder, steps, row, &Change::Stays));
}

struct Models {
    changed: Flag,
    new: Flag,
    residuals: ResidualModels,
    rows: RowModels,
}

impl Models {
    fn new(steps: &Steps) -> Self {
        let (changed, new) = (Flag::default(), Flag::default());
        Self { changed, new, residuals: ResidualModels::default(), rows: RowModels::new(steps) }
    }

    /// Codes a change and applies it; a decoder gets it back whatever it hands in.
    fn code(&mut self, coder: &mut impl Coder, steps: &Steps, row: &mut Row, change: &Change) {
        let (residual, new) = match change {
            Change::Stays => (Residual::default(), None),
            Change::By(residual) => (*residual, None),
            Change::To(new) => (Residual::default(), Some(*new)),
        };
        if !self.changed.code(coder, !matches!(change, Change::Stays)) {
            return;
        }
        *row = if self.new.code(coder, new.is_some()) {
            self.rows.code(coder, steps, &new.unwrap_or_default())
        } else {
            self.residuals.code(coder, steps, &residual).apply(row, steps)
        };
    }
}
