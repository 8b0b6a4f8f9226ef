//! The file formats of trackers. One is added by a file and a line here.

use crate::exr::Exr;
use crate::flo::Flo;
use crate::npy::Npy;
use crate::npz::Npz;
use ffgs_method::{Registry, TrackFormat};

/// Formats that `tracks.json` may name.
pub const FORMATS: Registry<dyn TrackFormat> =
    Registry { kind: "track format", items: &[&Npz, &Flo, &Exr, &Npy] };
