//! Tracks in the unit square, as Algorithm 2 has them, and what both interpolators share.

use crate::{IntegerCentredTracks, MotionError};
use ffgs_core::{DenseMotion, ImageSize, Mask};
use kiddo::ImmutableKdTree;

/// Maps integer-centred pixels to the unit square; a side of one pixel maps to 0.
#[derive(Clone, Copy)]
pub(crate) struct Normalisation {
    scale: [f64; 2],
}

impl Normalisation {
    pub(crate) fn new(size: ImageSize) -> Self {
        let side = |n: usize| 1.0 / n.saturating_sub(1).max(1) as f64;
        Self { scale: [side(size.width), side(size.height)] }
    }

    pub(crate) fn apply(self, pixel: [f64; 2]) -> [f64; 2] {
        [pixel[0] * self.scale[0], pixel[1] * self.scale[1]]
    }
}

/// Tracks in normalised coordinates with what is interpolated: displacement x, displacement y (px), visibility.
pub(crate) struct NormalisedTracks {
    pub points: Vec<[f64; 2]>,
    pub values: Vec<[f64; 3]>,
}

impl NormalisedTracks {
    pub(crate) fn new(tracks: &IntegerCentredTracks, size: ImageSize) -> Result<Self, MotionError> {
        tracks.validate()?;
        let normalisation = Normalisation::new(size);
        let points = tracks.src.iter().map(|&p| normalisation.apply(p)).collect();
        let values = (tracks.src.iter().zip(&tracks.tgt).zip(&tracks.visibility))
            .map(|((s, t), &v)| [t[0] - s[0], t[1] - s[1], v])
            .collect();
        Ok(Self { points, values })
    }

    pub(crate) fn tree(&self) -> Result<ImmutableKdTree<f64, 2>, MotionError> {
        ImmutableKdTree::new_from_slice(&self.points).map_err(|e| MotionError::Index(format!("{e:?}")))
    }
}

/// An unknown field, if `region` has its size.
pub(crate) fn prepare(size: ImageSize, region: Option<&Mask>) -> Result<DenseMotion, MotionError> {
    match region {
        Some(mask) if mask.size() != size => Err(MotionError::Size { expected: size, found: mask.size() }),
        _ => Ok(DenseMotion::unknown(size)),
    }
}

/// Refuses a kernel scale whose square could be zero or infinite.
pub(crate) fn check_sigma(sigma: f64) -> Result<(), MotionError> {
    let square = sigma * sigma;
    if !(sigma > 0.0 && square.is_normal()) {
        return Err(MotionError::Sigma(sigma));
    }
    Ok(())
}

/// Whether any pixel of a part of a mask is set. Without an early exit, so that whole vectors are looked at.
#[inline(always)]
pub(crate) fn any(mask: &[u8]) -> bool {
    mask.iter().fold(0, |all, m| all | m) != 0
}

/// Rows of a field that one task fills.
pub(crate) struct RowBand<'a> {
    /// Row index of the band's first row.
    pub first_row: usize,
    pub width: usize,
    pub flow: &'a mut [[f32; 2]],
    pub visibility: &'a mut [f32],
    pub confidence: &'a mut [f32],
}

impl RowBand<'_> {
    pub(crate) fn rows(&self) -> usize {
        self.flow.len() / self.width
    }

    /// Writes the pixel at (column, row within the band).
    pub(crate) fn set(&mut self, column: usize, row: usize, value: [f64; 3], confidence: f64) {
        let i = row * self.width + column;
        self.flow[i] = [value[0] as f32, value[1] as f32];
        self.visibility[i] = value[2] as f32;
        self.confidence[i] = confidence as f32;
    }
}

/// Splits a field into bands of `rows` rows.
pub(crate) fn bands(out: &mut DenseMotion, rows: usize) -> Vec<RowBand<'_>> {
    let width = out.size.width;
    let n = width * rows;
    let columns = out.visibility.chunks_mut(n).zip(out.confidence.chunks_mut(n));
    (out.flow.chunks_mut(n).zip(columns).enumerate())
        .map(|(band, (flow, (visibility, confidence)))| RowBand {
            first_row: band * rows,
            width,
            flow,
            visibility,
            confidence,
        })
        .collect()
}
