//! The conformance suite of capture formats.

use super::{assert_names, in_1_and_8_threads};
use ffgs_method::{Capture, CaptureFormat, Part, Split, ViewAt};
use std::fs;
use std::path::Path;

/// What a [`CaptureFormat`] owes, on the capture in `folder`: it is detected there and not in an empty folder; names are
/// unique; images and masks have their camera's size; 1 and 8 threads read the same; what the capture does not hold is a
/// fault that names a file of it.
pub fn capture_format(format: &dyn CaptureFormat, folder: &Path) {
    let name = format.name();
    let empty = tempfile::tempdir().expect("a temporary folder");
    assert!(format.detect(empty.path()).is_none(), "{name}: an empty folder is taken for a capture");
    if let Err(fault) = format.open(empty.path()) {
        assert_names(&fault, empty.path(), name);
    } else {
        panic!("{name}: an empty folder is opened");
    }
    assert!(format.detect(folder).is_some(), "{name}: {} is not detected", folder.display());
    let capture = format.open(folder).unwrap_or_else(|fault| panic!("{name}: {fault}"));
    assert_eq!(capture.root(), folder, "{name}: the capture is elsewhere");
    assert!(
        capture.frames() > 0 && capture.views(Split::Train).len() > 1,
        "{name}: nothing to reconstruct from"
    );
    for split in Split::ALL {
        let names = capture.views(split);
        let twice = names.iter().enumerate().find(|(i, view)| names[..*i].contains(view));
        assert!(twice.is_none(), "{name}: two views have one name: {twice:?}");
        assert!(capture.part(Part::Cameras(split)).starts_with(folder), "{name}: cameras lie elsewhere");
        for view in 0..names.len() {
            view_conforms(name, &*capture, ViewAt { split, view, frame: 0 });
        }
        let strangers = [(names.len(), 0), (0, capture.frames_of(split))];
        for (view, frame) in strangers {
            let at = ViewAt { split, view, frame };
            for fault in [capture.camera(at).err(), capture.image(at).err()] {
                let fault = fault.unwrap_or_else(|| panic!("{name}: {at:?} is held by no capture"));
                assert_names(&fault, folder, name);
            }
        }
    }
}

fn view_conforms(name: &str, capture: &dyn Capture, at: ViewAt) {
    let stop = |fault| panic!("{name}: {at:?}: {fault}");
    let camera = capture.camera(at).unwrap_or_else(stop);
    capture.probe(at).unwrap_or_else(|fault| panic!("{name}: {at:?}: {fault}"));
    let [one, eight] =
        in_1_and_8_threads(|| capture.image(at).unwrap_or_else(|fault| panic!("{name}: {at:?}: {fault}")));
    assert!(one == eight, "{name}: 1 and 8 threads read different images");
    assert_eq!(one.size(), camera.size(), "{name}: {at:?}: an image of another size than its camera");
    let mask = capture.mask(at).unwrap_or_else(|fault| panic!("{name}: {at:?}: {fault}"));
    assert!(mask.is_none_or(|mask| mask.size() == camera.size()), "{name}: {at:?}: a mask of another size");
    let file = capture.image_file(at);
    assert!(file.as_ref().is_none_or(|file| file.is_file()), "{name}: {at:?}: there is no file {file:?}");
    let read = capture.image_with_file(at);
    let (image, bytes) = read.unwrap_or_else(|fault| panic!("{name}: {at:?}: {fault}"));
    assert!(image == one, "{name}: {at:?}: another image when its file is asked for too");
    let read = file.and_then(|file| fs::read(file).ok());
    assert!(bytes.is_none() || bytes == read, "{name}: {at:?}: the bytes are not those of the file");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conformance::World;
    use ffgs_method::{Fault, Plugin};
    use glam::DVec3;

    /// Takes every folder for a capture.
    struct Eager;

    impl Plugin for Eager {
        fn name(&self) -> &'static str {
            "eager"
        }

        fn summary(&self) -> &'static str {
            "sees captures everywhere"
        }
    }

    impl CaptureFormat for Eager {
        fn detect(&self, folder: &Path) -> Option<String> {
            Some(folder.display().to_string())
        }

        fn open(&self, _: &Path) -> Result<Box<dyn Capture>, Fault> {
            Ok(Box::new(World::new(3, DVec3::ZERO)))
        }
    }

    #[test]
    #[should_panic(expected = "eager: an empty folder is taken for a capture")]
    fn a_format_that_sees_captures_everywhere_is_found() {
        capture_format(&Eager, Path::new("anywhere"));
    }
}
