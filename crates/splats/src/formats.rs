//! The formats of splat files. One is added by a file and a line here.

use crate::{compressed_ply, glb, ply_write, sog, spz};
use ffgs_method::{Registry, SplatWriter};

/// Every format that can be written; the first is that of a run.
pub const FORMATS: Registry<dyn SplatWriter> = Registry {
    kind: "splat format",
    items: &[&ply_write::FORMAT, &compressed_ply::FORMAT, &spz::FORMAT, &sog::FORMAT, &glb::FORMAT],
};
