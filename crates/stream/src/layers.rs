//! The sections of both layers. Each is written down once, for the sender and the receiver.

use crate::delta::{GATE, Residual, ResidualModels, changed_harmonics, predict};
use crate::error::Problem;
use crate::frame_file::take_u32;
use crate::harmonics::HarmonicModels;
use crate::motion::Motion;
use crate::numbers::{Flag, Number};
use crate::range_coder::{Coder, Decoder, Encoder};
use crate::row::{MAX_GROUPS, MAX_HARMONICS, Row};
use crate::row_models::{RowModels, code_colour, plus};
use crate::steps::{Measures, Steps, round};

/// Gaussians that a section may claim: more would not fit in the memory of a player.
const MAX_ROWS: usize = 1 << 25;
/// Most rows that a byte of a section can stand for: what never changes costs a few hundredths of a bit.
const ROWS_PER_BYTE: usize = 1 << 12;

/// A count that bytes of this length can stand for.
fn plausible(count: u32, bytes: &[u8]) -> Result<usize, Problem> {
    let most = MAX_ROWS.min((bytes.len() + 1).saturating_mul(ROWS_PER_BYTE));
    match count as usize {
        count if count <= most => Ok(count),
        count => Err(Problem::Corrupt(format!("{count} Gaussians in {} bytes", bytes.len()))),
    }
}

/// All rows of a layer.
pub(crate) fn encode_key(rows: &[Row], steps: &Steps) -> Vec<u8> {
    let (mut coder, mut models) = (Encoder::new(), RowModels::new(steps));
    rows.iter().for_each(|row| {
        models.code(&mut coder, steps, row);
    });
    counted(&[rows.len()], &[], coder)
}

/// Inverse of [`encode_key`].
pub(crate) fn decode_key(mut bytes: &[u8], steps: &Steps) -> Result<Vec<Row>, Problem> {
    let count = plausible(take_u32(&mut bytes)?, bytes)?;
    let (mut coder, mut models) = (Decoder::new(bytes), RowModels::new(steps));
    Ok((0..count).map(|_| models.code(&mut coder, steps, &Row::default())).collect())
}

/// Counts, motions and what a coder wrote.
fn counted(counts: &[usize], motions: &[Motion], coder: Encoder) -> Vec<u8> {
    let mut out: Vec<u8> = counts.iter().flat_map(|&n| (n as u32).to_le_bytes()).collect();
    out.extend(motions.iter().flat_map(Motion::numbers).flat_map(f32::to_le_bytes));
    out.extend(coder.finish());
    out
}

/// Colours of the static layer after those of `rows`, which are changed to what a receiver has.
pub(crate) fn encode_colours(rows: &mut [Row], steps: &Steps, target: impl Fn(usize) -> Measures) -> Vec<u8> {
    let (mut coder, mut models) = (Encoder::new(), ColourModels::default());
    for (i, row) in rows.iter_mut().enumerate() {
        let change = ColourChange::of(&target(i), row, steps);
        models.code(&mut coder, steps, &change).apply(row);
    }
    coder.finish()
}

/// Applies [`encode_colours`].
pub(crate) fn decode_colours(rows: &mut [Row], steps: &Steps, bytes: &[u8]) {
    let (mut coder, mut models) = (Decoder::new(bytes), ColourModels::default());
    for row in rows {
        models.code(&mut coder, steps, &ColourChange::default()).apply(row);
    }
}

/// Change of a static Gaussian's colour.
struct ColourChange {
    colour: [i32; 3],
    harmonics: [i16; MAX_HARMONICS],
}

impl Default for ColourChange {
    fn default() -> Self {
        Self { colour: [0; 3], harmonics: [0; MAX_HARMONICS] }
    }
}

impl ColourChange {
    /// What is worth sending: all three channels when one has changed enough.
    fn of(target: &Measures, row: &Row, steps: &Steps) -> Self {
        let change = [0, 1, 2].map(|k| target.colour[k] - f64::from(row.colour[k]));
        let sent = change.iter().any(|c| c.abs() >= GATE);
        let colour = if sent { change.map(round) } else { [0; 3] };
        Self { colour, harmonics: changed_harmonics(target, &row.harmonics, steps) }
    }

    fn apply(&self, row: &mut Row) {
        row.colour = plus(row.colour, self.colour);
        row.harmonics.iter_mut().zip(self.harmonics).for_each(|(v, d)| *v = v.wrapping_add(d));
    }
}

#[derive(Default)]
struct ColourModels {
    changed: Flag,
    colour: [Number; 3],
    harmonics: HarmonicModels,
}

impl ColourModels {
    fn code(&mut self, coder: &mut impl Coder, steps: &Steps, change: &ColourChange) -> ColourChange {
        let mut colour = [0; 3];
        if self.changed.code(coder, change.colour != [0; 3]) {
            colour = code_colour(&mut self.colour, coder, change.colour);
        }
        ColourChange {
            colour,
            harmonics: self.harmonics.code(coder, steps.coded_harmonics(), &change.harmonics),
        }
    }
}

/// One frame of the dynamic layer after the last: what becomes of each row, and new ones.
pub(crate) struct Change<'a> {
    /// Of each group.
    pub(crate) motions: &'a [Motion],
    /// Of each row so far: where it is now, or that it is gone.
    pub(crate) targets: &'a [Option<Measures>],
    /// New rows.
    pub(crate) births: &'a [Row],
}

/// Models of a [`Change`].
struct ChangeModels {
    gone: Flag,
    residuals: ResidualModels,
    births: RowModels,
}

impl ChangeModels {
    fn new(steps: &Steps) -> Self {
        Self { gone: Flag::default(), residuals: ResidualModels::default(), births: RowModels::new(steps) }
    }
}

/// Writes a change; `rows` become what a receiver has.
pub(crate) fn encode_change(rows: &mut Vec<Row>, steps: &Steps, change: &Change) -> Vec<u8> {
    let (mut coder, mut models) = (Encoder::new(), ChangeModels::new(steps));
    let mut kept = Vec::with_capacity(rows.len());
    for (row, target) in rows.iter().zip(change.targets) {
        models.gone.code(&mut coder, target.is_none());
        let Some(target) = target else { continue };
        let predicted = predict(row, motion_of(change.motions, row), steps);
        let residual = Residual::of(target, &predicted, steps);
        kept.push(models.residuals.code(&mut coder, steps, &residual).apply(&predicted, steps));
    }
    kept.extend(change.births.iter().map(|row| models.births.code(&mut coder, steps, row)));
    *rows = kept;
    counted(&[change.motions.len(), change.births.len()], change.motions, coder)
}

fn motion_of<'a>(motions: &'a [Motion], row: &Row) -> &'a Motion {
    motions.get(usize::from(row.group)).unwrap_or(&Motion::NONE)
}

/// Applies [`encode_change`].
pub(crate) fn decode_change(rows: &mut Vec<Row>, steps: &Steps, mut bytes: &[u8]) -> Result<(), Problem> {
    let (groups, births) = (take_u32(&mut bytes)? as usize, take_u32(&mut bytes)?);
    if groups > MAX_GROUPS {
        return Err(Problem::Corrupt(format!("{groups} groups")));
    }
    let motions = (0..groups).map(|_| take_motion(&mut bytes)).collect::<Result<Vec<_>, _>>()?;
    let births = plausible(births, bytes)?;
    let (mut coder, mut models) = (Decoder::new(bytes), ChangeModels::new(steps));
    let mut kept = Vec::with_capacity(rows.len());
    for row in rows.iter() {
        if models.gone.code(&mut coder, false) {
            continue;
        }
        let predicted = predict(row, motion_of(&motions, row), steps);
        let residual = models.residuals.code(&mut coder, steps, &Residual::default());
        kept.push(residual.apply(&predicted, steps));
    }
    kept.extend((0..births).map(|_| models.births.code(&mut coder, steps, &Row::default())));
    *rows = kept;
    Ok(())
}

fn take_motion(bytes: &mut &[u8]) -> Result<Motion, Problem> {
    let mut numbers = [0.0; Motion::NUMBERS];
    for number in &mut numbers {
        *number = f32::from_bits(take_u32(bytes)?);
    }
    if numbers.iter().all(|v| v.is_finite()) {
        Ok(Motion::from_numbers(numbers))
    } else {
        Err(Problem::Corrupt("a motion is not finite".into()))
    }
}

/// Steps of an uncertainty per factor of two.
const UNCERTAINTY_PER_OCTAVE: f64 = 4.0;

/// Uncertainties (the capture's unit) as logarithms, each after its neighbour's.
pub(crate) fn encode_uncertainty(values: &[f32]) -> Vec<u8> {
    let (mut coder, mut model, mut last) = (Encoder::new(), Number::default(), 0);
    for value in values {
        let now = round(f64::from(value.max(f32::MIN_POSITIVE)).log2() * UNCERTAINTY_PER_OCTAVE);
        model.code(&mut coder, now - last);
        last = now;
    }
    coder.finish()
}

/// Inverse of [`encode_uncertainty`].
pub(crate) fn decode_uncertainty(count: usize, bytes: &[u8]) -> Vec<f32> {
    let (mut coder, mut model, mut last) = (Decoder::new(bytes), Number::default(), 0_i32);
    (0..count)
        .map(|_| {
            last = last.wrapping_add(model.code(&mut coder, 0));
            (f64::from(last) / UNCERTAINTY_PER_OCTAVE).exp2() as f32
        })
        .collect()
}
