//! The formats as plug-ins.

use crate::{
    ShBits, SplatError, read_ply, read_spz, write_compressed_ply, write_glb, write_ply, write_sog, write_spz,
};
use ffgs_core::Gaussians;
use ffgs_method::{Fault, Plugin, Registry, RenderMode, SplatWriter};
use std::path::Path;

/// Every format that can be written; one line adds another.
pub const FORMATS: Registry<dyn SplatWriter> =
    Registry { kind: "splat format", items: &[&PLY, &COMPRESSED_PLY, &SPZ, &SOG, &GLB] };

type Write = fn(&Path, &Gaussians, RenderMode) -> Result<(), SplatError>;
type Read = fn(&Path) -> Result<Gaussians, SplatError>;

/// A format by the functions of its file.
struct Format {
    name: &'static str,
    summary: &'static str,
    extension: &'static str,
    write: Write,
    read: Option<Read>,
}

const PLY: Format = Format {
    name: "ply-seq",
    summary: "SuperSplat (as a sequence), Brush and every viewer; exact, 248 bytes per Gaussian of SH degree 3",
    extension: ".ply",
    write: |file, gaussians, mode| write_ply(file, gaussians, None, mode),
    read: Some(|file| read_ply(file).map(|ply| ply.gaussians)),
};

const COMPRESSED_PLY: Format = Format {
    name: "compressed-ply-seq",
    summary: "SuperSplat (as a sequence) and the PlayCanvas engine",
    extension: ".compressed.ply",
    write: write_compressed_ply,
    read: None,
};

const SPZ: Format = Format {
    name: "spz",
    summary: "players of Niantic's SPZ, version 4",
    extension: ".spz",
    write: |file, gaussians, mode| write_spz(file, gaussians, mode, ShBits::default()),
    read: Some(|file| read_spz(file).map(|(gaussians, _)| gaussians)),
};

const SOG: Format = Format {
    name: "sog",
    summary: "the PlayCanvas engine, also as a flipbook, and SuperSplat",
    extension: ".sog",
    write: write_sog,
    read: None,
};

const GLB: Format = Format {
    name: "glb",
    summary: "viewers of glTF with KHR_gaussian_splatting",
    extension: ".glb",
    write: |file, gaussians, _| write_glb(file, gaussians),
    read: None,
};

impl Plugin for Format {
    fn name(&self) -> &'static str {
        self.name
    }

    fn summary(&self) -> &'static str {
        self.summary
    }
}

impl SplatWriter for Format {
    fn extension(&self) -> &'static str {
        self.extension
    }

    fn write(&self, file: &Path, gaussians: &Gaussians, mode: RenderMode) -> Result<(), Fault> {
        (self.write)(file, gaussians, mode).map_err(|e| fault(&e, "choose another folder or format"))
    }

    fn read(&self, file: &Path) -> Option<Result<Gaussians, Fault>> {
        self.read.map(|read| read(file).map_err(|e| fault(&e, "remove the file and write it again")))
    }
}

fn fault(error: &SplatError, fix: &str) -> Fault {
    Fault::new(&error.path, &error.problem, fix)
}
