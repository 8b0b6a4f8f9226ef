//! A format by the functions of its file.

use crate::SplatError;
use ffgs_core::Gaussians;
use ffgs_method::{Fault, Plugin, SplatWriter, Splats};
use std::path::Path;

type Write = fn(&Path, &Splats) -> Result<(), SplatError>;
type Read = fn(&Path) -> Result<Gaussians, SplatError>;

/// What a format's file says of it.
pub(crate) struct Format {
    pub name: &'static str,
    pub summary: &'static str,
    pub extension: &'static str,
    pub write: Write,
    pub read: Option<Read>,
}

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

    fn write(&self, file: &Path, splats: &Splats) -> Result<(), Fault> {
        (self.write)(file, splats)
            .map_err(|e| fault(&e, "make room on the disk, or choose another folder or format"))
    }

    fn read(&self, file: &Path) -> Option<Result<Gaussians, Fault>> {
        self.read.map(|read| read(file).map_err(|e| fault(&e, "remove the file and write it again")))
    }
}

fn fault(error: &SplatError, fix: &str) -> Fault {
    Fault::new(&error.path, &error.problem, fix)
}
