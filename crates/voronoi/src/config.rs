//! Settings of the densification of tracks, and the choice of the interpolator.

use crate::normalised::any;
use crate::{GaussianKnn, MotionError, MotionInterpolator, NaturalNeighbour};
use ffgs_core::{DenseMotion, ImageSize, Mask, TrackSet};
use serde::{Deserialize, Serialize};

/// Which interpolator densifies tracks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Algorithm 2: [`GaussianKnn`].
    #[default]
    GaussianKnn,
    /// Delaunay: [`NaturalNeighbour`].
    NaturalNeighbour,
}

/// Which tracks may speak for masked pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceFilter {
    /// Only tracks whose source lies in the mask of t-1: background motion cannot bleed over the object's edge.
    #[default]
    Foreground,
    /// All tracks (literal Algorithm 2).
    All,
}

/// Settings of the densification of sparse and medium trackers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VoronoiConfig {
    /// Interpolator.
    pub method: Method,
    /// Number of neighbours K (Gaussian kNN only).
    pub k: usize,
    /// Kernel scale in normalised image coordinates; also the scale of the distance confidence.
    pub sigma: f64,
    /// Which tracks are used.
    pub source_filter: SourceFilter,
    /// Multiply the confidence by the interpolated visibility; `false` = literal Algorithm 2.
    pub use_visibility: bool,
}

impl Default for VoronoiConfig {
    fn default() -> Self {
        let GaussianKnn { k, sigma } = GaussianKnn::default();
        Self {
            method: Method::default(),
            k,
            sigma,
            source_filter: SourceFilter::default(),
            use_visibility: true,
        }
    }
}

impl VoronoiConfig {
    /// The interpolator these settings describe.
    pub fn interpolator(&self) -> Box<dyn MotionInterpolator> {
        match self.method {
            Method::GaussianKnn => Box::new(GaussianKnn { k: self.k, sigma: self.sigma }),
            Method::NaturalNeighbour => Box::new(NaturalNeighbour { sigma: self.sigma }),
        }
    }
}

/// The tracks whose source (px, centre + 0.5) falls in a foreground pixel of `mask`.
pub fn filter_sources(tracks: &TrackSet, mask: &Mask) -> TrackSet {
    let ImageSize { width, height } = mask.size();
    let inside = |&[x, y]: &[f32; 2]| {
        let framed = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
        framed && mask.contains(x as usize, y as usize)
    };
    let mut out = TrackSet::default();
    for ((src, tgt), &visibility) in tracks.src.iter().zip(&tracks.tgt).zip(&tracks.visibility) {
        if inside(src) {
            out.src.push(*src);
            out.tgt.push(*tgt);
            out.visibility.push(visibility);
        }
    }
    out
}

/// The whole stage for one tracker and view: source filter, interpolation over `mask` (t-1), visibility.
///
/// The field has the mask's size; pixels outside the mask are unknown.
///
/// # Errors
/// As [`MotionInterpolator::densify`].
pub fn densify_view(
    config: &VoronoiConfig,
    tracks: &TrackSet,
    mask: &Mask,
) -> Result<DenseMotion, MotionError> {
    let interpolator = config.interpolator();
    let mut out = match config.source_filter {
        SourceFilter::Foreground => {
            interpolator.densify(&filter_sources(tracks, mask), mask.size(), Some(mask))?
        }
        SourceFilter::All => interpolator.densify(tracks, mask.size(), Some(mask))?,
    };
    if config.use_visibility {
        weigh_by_visibility(&mut out, mask);
    }
    Ok(out)
}

/// Multiplies the confidence by the visibility. Only where there is something of the mask: the rest is unknown, and its memory
/// untouched.
fn weigh_by_visibility(motion: &mut DenseMotion, mask: &Mask) {
    const PART: usize = 64;
    let parts = motion.confidence.chunks_mut(PART).zip(motion.visibility.chunks(PART));
    for ((confidence, visibility), mask) in parts.zip(mask.data().chunks(PART)) {
        if any(mask) {
            confidence.iter_mut().zip(visibility).for_each(|(c, v)| *c *= v);
        }
    }
}
