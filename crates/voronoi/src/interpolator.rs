//! The contract of motion interpolation: sparse tracks in, a dense field with confidence out.

use ffgs_core::{DenseMotion, ImageSize, Mask, TrackSet};
use thiserror::Error;

/// Why a whole field could not be computed.
#[derive(Debug, Error, PartialEq)]
pub enum MotionError {
    /// The columns of a track set differ in length.
    #[error("track columns differ in length: {src} sources, {tgt} targets, {visibility} visibilities")]
    Columns {
        /// Number of source positions.
        src: usize,
        /// Number of target positions.
        tgt: usize,
        /// Number of visibilities.
        visibility: usize,
    },
    /// A track position or visibility is NaN or infinite.
    #[error("track {index} holds a value that is not finite")]
    NotFinite {
        /// Index of the track.
        index: usize,
    },
    /// A field or mask does not have the size asked for.
    #[error("sizes differ: expected {expected:?}, found {found:?}")]
    Size {
        /// Size asked for.
        expected: ImageSize,
        /// Size found.
        found: ImageSize,
    },
    /// The kernel scale is not a positive number.
    #[error("sigma must be positive and finite, found {0}")]
    Sigma(f64),
    /// The number of neighbours is zero.
    #[error("k must be at least 1")]
    NoNeighbours,
    /// The magnitude floor is negative or not finite.
    #[error("the magnitude floor must be finite and not negative, found {0} px")]
    Floor(f32),
    /// The spatial index refused the points.
    #[error("spatial index: {0}")]
    Index(String),
}

/// Tracks in the coordinates of Algorithm 2: the centre of pixel (column u, row v) lies at (u, v).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IntegerCentredTracks {
    /// (N) positions at t-1 (px).
    pub src: Vec<[f64; 2]>,
    /// (N) positions at t (px).
    pub tgt: Vec<[f64; 2]>,
    /// (N) visibility at t in 0..=1.
    pub visibility: Vec<f64>,
}

impl From<&TrackSet> for IntegerCentredTracks {
    /// Subtracts the half pixel; exact, because it is done in f64.
    fn from(tracks: &TrackSet) -> Self {
        let shift = |p: &[f32; 2]| p.map(|v| f64::from(v) - 0.5);
        Self {
            src: tracks.src.iter().map(shift).collect(),
            tgt: tracks.tgt.iter().map(shift).collect(),
            visibility: tracks.visibility.iter().map(|&v| f64::from(v)).collect(),
        }
    }
}

impl IntegerCentredTracks {
    /// Checks that the columns have one length and hold finite values.
    ///
    /// # Errors
    /// When columns differ in length or a value is not finite.
    pub fn validate(&self) -> Result<(), MotionError> {
        let (src, tgt, visibility) = (self.src.len(), self.tgt.len(), self.visibility.len());
        if src != tgt || src != visibility {
            return Err(MotionError::Columns { src, tgt, visibility });
        }
        let finite = |i: usize| {
            self.src[i].iter().chain(&self.tgt[i]).all(|v| v.is_finite()) && self.visibility[i].is_finite()
        };
        match (0..src).find(|&i| !finite(i)) {
            Some(index) => Err(MotionError::NotFinite { index }),
            None => Ok(()),
        }
    }
}

/// Turns the correspondences of one tracker and view into a dense motion field.
///
/// Every implementation keeps this contract (one conformance suite checks it): without tracks the field is unknown;
/// a single track gives its displacement everywhere; equal tracks behave like one; nothing is ever NaN; pixels
/// outside `region` stay unknown; confidence is `exp(-d^2 / 2 sigma^2)` of the distance to the nearest track in
/// normalised coordinates (Algorithm 2, line 14).
pub trait MotionInterpolator: Sync {
    /// The field of `size` of tracks in integer-centred pixels.
    ///
    /// `region` restricts the work to its foreground pixels (`None` = every pixel).
    ///
    /// # Errors
    /// [`MotionError`] when columns differ in length, hold values that are not finite, or `region` has another size.
    fn densify_integer_centred(
        &self,
        tracks: &IntegerCentredTracks,
        size: ImageSize,
        region: Option<&Mask>,
    ) -> Result<DenseMotion, MotionError>;

    /// The field of `size` of tracks in the project's pixel coordinates (centre + 0.5).
    ///
    /// # Errors
    /// As [`MotionInterpolator::densify_integer_centred`].
    fn densify(
        &self,
        tracks: &TrackSet,
        size: ImageSize,
        region: Option<&Mask>,
    ) -> Result<DenseMotion, MotionError> {
        self.densify_integer_centred(&tracks.into(), size, region)
    }
}
