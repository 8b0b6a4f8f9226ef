//! Everything that plugs in. A plug-in is added by a line here, and no other file of the program names one.

use crate::plugins::method::Method;
use crate::plugins::methods;
use anyhow::Result;
use ffgs_calibration::formats::{COLMAP, EASYVOLCAP, N3DV, OPENCV, PANOPTIC, QUALISYS, TOML, TRANSFORMS};
use ffgs_dataset::Dynamic3dGaussians;
use ffgs_method::{Capture, CaptureFormat, Fault, Registry, SplatWriter};
use ffgs_prepare::InPlace;
use std::path::Path;

/// Layouts of captures, in the order in which they are tried.
pub const CAPTURES: Registry<dyn CaptureFormat> = Registry {
    kind: "capture format",
    items: &[
        &Dynamic3dGaussians,
        &InPlace(&PANOPTIC),
        &InPlace(&N3DV),
        &InPlace(&TRANSFORMS),
        &InPlace(&EASYVOLCAP),
        &InPlace(&TOML),
        &InPlace(&QUALISYS),
        &InPlace(&COLMAP),
        &InPlace(&OPENCV),
    ],
};

/// How the scene moves from frame to frame; the first is the default.
pub const METHODS: Registry<Method> = Registry {
    kind: "method",
    items: &[
        &methods::TRACKERS,
        &methods::TRACKER,
        &methods::NONE,
        &methods::DYNAMIC3DGS,
        &methods::HICOM,
        &methods::QUEEN,
        &methods::RECONGS,
        &methods::TRACKERSPLAT,
    ],
};

/// The splat format in which a run writes its frames: the first.
pub(crate) fn run_format() -> &'static dyn SplatWriter {
    ffgs_splats::FORMATS.items[0]
}

/// What `ffgs formats` prints.
pub(crate) fn formats() -> String {
    let [captures, tracks, splats] =
        [CAPTURES.table(), ffgs_tracks::FORMATS.table(), ffgs_splats::FORMATS.table()];
    format!(
        "captures (run):\n{captures}tracks (tracks/tracks.json):\n{tracks}splats (export --to):\n{splats}"
    )
}

/// Opens the capture in `folder`, whatever its format.
///
/// # Errors
/// When no format finds its files there, or the one that does cannot read them.
pub fn open_capture(folder: &Path) -> Result<Box<dyn Capture>, Fault> {
    let format = CAPTURES.items.iter().find(|format| format.detect(folder).is_some());
    let format = format.ok_or_else(|| {
        let problem = if folder.is_dir() { "no capture of a known format" } else { "no such capture folder" };
        Fault::new(folder, problem, format!("give the folder of a capture; formats:\n{}", CAPTURES.table()))
    })?;
    format.open(folder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_method::Plugin;
    use std::collections::BTreeSet;

    #[test]
    fn names_are_unique_and_fit_into_options() {
        for names in [
            METHODS.items.iter().map(|m| m.name()).collect::<Vec<_>>(),
            CAPTURES.items.iter().map(|c| c.name()).collect(),
            ffgs_tracks::FORMATS.items.iter().map(|f| f.name()).collect(),
            ffgs_splats::FORMATS.items.iter().map(|f| f.name()).collect(),
        ] {
            assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len(), "{names:?}");
            let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
            assert!(names.iter().all(|name| !name.is_empty() && name.chars().all(plain)), "{names:?}");
        }
    }

    #[test]
    fn a_folder_that_is_no_capture_is_refused_with_the_formats() {
        let folder = tempfile::tempdir().unwrap();
        let refused = open_capture(folder.path()).unwrap_err().to_string();
        assert!(
            refused.contains("no capture of a known format") && refused.contains("train_meta.json"),
            "{refused}"
        );
        let refused = open_capture(&folder.path().join("none")).unwrap_err().to_string();
        assert!(refused.contains("no such capture folder"), "{refused}");
    }
}
