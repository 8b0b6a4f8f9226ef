//! The conformance suite of track formats.

use super::{assert_names, in_1_and_8_threads};
use ffgs_core::{ImageSize, ViewMotion};
use ffgs_method::{PixelCenter, TrackFormat};
use std::fs;

/// A sound file of a format.
pub struct Sample {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// Size of the camera that it belongs to.
    pub size: ImageSize,
}

/// What a [`TrackFormat`] owes: finite motion of the camera's size; 1 and 8 threads read the same; a file that is missing,
/// cut off anywhere or, if dense, of another size is a fault that names it.
pub fn track_format(format: &dyn TrackFormat, sample: &Sample) {
    let name = format.name();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("motion");
    let Sample { bytes, size } = sample;
    let read = |size| format.read(&file, size, PixelCenter::Integer);
    let refused = |size, what: &str| match read(size) {
        Err(fault) => assert_names(&fault, &file, name),
        Ok(_) => panic!("{name}: {what} is taken for sound"),
    };
    refused(*size, "a missing file");
    fs::write(&file, bytes).expect("a file");
    let [tracked, again] =
        in_1_and_8_threads(|| read(*size).unwrap_or_else(|fault| panic!("{name}: {fault}")));
    assert_eq!(tracked, again, "{name}: 1 and 8 threads read different motion");
    assert!(tracked.read > tracked.dropped, "{name}: nothing of the sample is left");
    match &tracked.motion {
        ViewMotion::Dense(field) => {
            assert!(format.is_dense() && field.size == *size, "{name}: a field of another kind or size");
            assert!(
                field.flow.as_flattened().iter().all(|v| v.is_finite()),
                "{name}: flow that is not finite"
            );
            refused(ImageSize { width: size.width + 1, ..*size }, "a flow of another size");
        }
        ViewMotion::Tracks(tracks) => {
            assert!(!format.is_dense(), "{name}: correspondences of a dense format");
            let ends = tracks.src.iter().chain(&tracks.tgt);
            assert!(ends.flatten().all(|v| v.is_finite()), "{name}: places that are not finite");
        }
    }
    for length in 0..bytes.len() {
        fs::write(&file, &bytes[..length]).expect("a file");
        refused(*size, &format!("the first {length} of {} bytes", bytes.len()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::DenseMotion;
    use ffgs_method::{Fault, Plugin, Tracked};
    use std::path::Path;

    /// Takes every file for a field without motion.
    struct Credulous {
        checks_length: bool,
    }

    impl Plugin for Credulous {
        fn name(&self) -> &'static str {
            "credulous"
        }

        fn summary(&self) -> &'static str {
            "believes every file"
        }
    }

    impl TrackFormat for Credulous {
        fn is_dense(&self) -> bool {
            true
        }

        fn read(&self, file: &Path, size: ImageSize, _: PixelCenter) -> Result<Tracked, Fault> {
            let found = fs::read(file).map_err(|error| Fault::new(file, error, "add the file"))?;
            let wanted = size.pixels();
            if self.checks_length && found.len() != wanted {
                return Err(Fault::new(
                    file,
                    format!("{} bytes, not {wanted}", found.len()),
                    "write it again",
                ));
            }
            Ok(Tracked { motion: ViewMotion::Dense(DenseMotion::unknown(size)), read: wanted, dropped: 0 })
        }
    }

    fn sample() -> Sample {
        Sample { bytes: vec![0; 6], size: ImageSize { width: 3, height: 2 } }
    }

    #[test]
    fn a_format_that_checks_its_files_conforms() {
        track_format(&Credulous { checks_length: true }, &sample());
    }

    #[test]
    #[should_panic(expected = "a flow of another size is taken for sound")]
    fn a_format_that_believes_every_file_is_found() {
        track_format(&Credulous { checks_length: false }, &sample());
    }
}
