//! The conformance suite of splat formats.

use super::{assert_names, in_1_and_8_threads};
use ffgs_core::{Gaussians, PixelFilter};
use ffgs_method::{SplatWriter, Splats};
use glam::Vec3;
use std::fs;
use std::path::Path;

/// Largest error of a place that is read again, in parts of the cloud's extent: 24 bits of fixed point, or 11 per axis of a
/// chunk of Gaussians.
const PLACE: f32 = 1e-3;

/// What a [`SplatWriter`] owes: every SH degree and no Gaussian at all is written or refused by a fault that names the file;
/// 1 and 8 threads write the same; nothing but the file is left in its folder; what it reads again is what it wrote, and
/// cut-off files are refused.
pub fn splat_writer(format: &dyn SplatWriter) {
    let name = format.name();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join(format!("frame{}", format.extension()));
    assert!(format.extension().starts_with('.'), "{name}: an ending has a dot");
    for degree in 0..=3 {
        let gaussians = cloud(40, degree);
        let [one, eight] = in_1_and_8_threads(|| {
            write(format, &file, &gaussians);
            fs::read(&file).expect("what was written")
        });
        assert!(one == eight, "{name}: 1 and 8 threads write different bytes");
        let left = fs::read_dir(folder.path()).expect("the folder").count();
        assert_eq!(left, 1, "{name}: more than the file is left in its folder");
        read_again(format, &file, &gaussians);
    }
    if let Err(fault) = format.write(&file, &Splats::from(&cloud(0, 0))) {
        assert_names(&fault, &file, name);
    }
    let nowhere = file.join("below/a.file");
    let refused = format.write(&nowhere, &Splats::from(&cloud(3, 0)));
    assert_names(&refused.expect_err("a folder that cannot be made"), &nowhere, name);
}

fn write(format: &dyn SplatWriter, file: &Path, gaussians: &Gaussians) {
    let written = format.write(file, &Splats::from(gaussians));
    written.unwrap_or_else(|fault| panic!("{}: {fault}", format.name()));
}

/// Places only: a format may store the rest more coarsely, and in any order.
fn read_again(format: &dyn SplatWriter, file: &Path, gaussians: &Gaussians) {
    let name = format.name();
    let Some(read) = format.read(file) else { return };
    let read = read.unwrap_or_else(|fault| panic!("{name}: {fault}"));
    assert_eq!(read.len(), gaussians.len(), "{name}: another number of Gaussians is read again");
    for mean in &gaussians.means {
        let far = |other: &[f32; 3]| Vec3::from(*mean).distance(Vec3::from(*other));
        let nearest = read.means.iter().map(far).fold(f32::INFINITY, f32::min);
        assert!(nearest < PLACE, "{name}: no Gaussian is read near {mean:?}");
    }
    let bytes = fs::read(file).expect("what was written");
    // Every length would take minutes: all of the head, then some of the rest.
    for length in (0..bytes.len()).filter(|length| *length < 64 || length % 251 == 0) {
        fs::write(file, &bytes[..length]).expect("a file");
        match format.read(file) {
            Some(Err(fault)) => assert_names(&fault, file, name),
            _ => panic!("{name}: the first {length} of {} bytes are taken for a whole file", bytes.len()),
        }
    }
}

/// Gaussians on a spiral within a cube of a metre.
fn cloud(count: usize, degree: usize) -> Gaussians {
    let mut out = Gaussians::zeros(count, degree).with_filter(PixelFilter::Plain);
    for i in 0..count {
        let t = i as f32;
        out.means[i] = [0.5 * t.sin(), 0.5 * t.cos(), 0.5 - t / 40.0];
        out.quats[i] = [1.0, 0.1 * t.sin(), 0.0, 0.2];
        out.log_scales[i] = [-4.0, -4.5 + 0.01 * t, -5.0];
        out.opacity_logits[i] = 0.1 * t - 2.0;
    }
    out.sh.as_flattened_mut().iter_mut().enumerate().for_each(|(i, v)| *v = 0.3 * (i as f32).sin());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_method::{Fault, Plugin};

    /// Writes the number of Gaussians, and reads as many at the origin.
    struct Careless;

    impl Plugin for Careless {
        fn name(&self) -> &'static str {
            "careless"
        }

        fn summary(&self) -> &'static str {
            "writes a number"
        }
    }

    impl SplatWriter for Careless {
        fn extension(&self) -> &'static str {
            ".count"
        }

        fn write(&self, file: &Path, splats: &Splats) -> Result<(), Fault> {
            fs::write(file, [splats.gaussians.len() as u8]).map_err(|e| Fault::new(file, e, "elsewhere"))
        }

        fn read(&self, file: &Path) -> Option<Result<Gaussians, Fault>> {
            let bytes = fs::read(file).map_err(|e| Fault::new(file, e, "elsewhere"));
            Some(bytes.map(|bytes| Gaussians::zeros(bytes.first().map_or(0, |n| usize::from(*n)), 0)))
        }
    }

    #[test]
    #[should_panic(expected = "careless: no Gaussian is read near")]
    fn a_format_that_loses_the_places_is_found() {
        splat_writer(&Careless);
    }
}
