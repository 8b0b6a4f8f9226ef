//! The file formats of trackers. One is added by a file and a line here.

use crate::exr::EXR;
use crate::flo::FLO;
use crate::npy::NPY;
use crate::npz::Npz;
use ffgs_method::{Registry, TrackFormat};

/// Formats that `tracks.json` may name.
pub const FORMATS: Registry<dyn TrackFormat> =
    Registry { kind: "track format", items: &[&Npz, &FLO, &EXR, &NPY] };
