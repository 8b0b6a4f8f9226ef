//! Every format, and every way in which it is wrong.

use exr::prelude::{AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Image, WritableImage, f16};
use ffgs_arrays::NpzWriter;
use ffgs_core::{Camera, ImageRgb8, ImageSize, Mask, ViewMotion};
use ffgs_method::{Capture, Fault, Points, Split, ViewAt};
use ffgs_tracks::{FilesRead, TrackStore, check};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const SIZE: ImageSize = ImageSize { width: 3, height: 2 };

fn store(level: &str, format: &str) -> (TempDir, TrackStore, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join("tracks/x/cam")).unwrap();
    let tracker = format!(
        r#"{{"name": "x", "level": "{level}", "format": "{format}", "pattern": "x/{{camera}}/{{frame:06}}.{format}"}}"#
    );
    fs::write(folder.path().join("tracks/tracks.json"), format!(r#"{{"trackers": [{tracker}]}}"#)).unwrap();
    let store = TrackStore::open(folder.path()).unwrap().unwrap();
    let file = store.path(0, "cam", 1).unwrap();
    assert!(file.ends_with(format!("tracks/x/cam/000001.{format}")));
    (folder, store, file)
}

fn flo(flow: &[f32]) -> Vec<u8> {
    let mut bytes = b"PIEH\x03\x00\x00\x00\x02\x00\x00\x00".to_vec();
    for v in flow {
        bytes.extend_from_slice(&v.to_le_bytes());
    }
    bytes
}

fn write_exr(file: &Path, names: [&str; 2]) {
    let u = FlatSamples::F16((0..6).map(|i| f16::from_f32(i as f32 * 0.5)).collect());
    let v = FlatSamples::F32((0..6).map(|i| -(i as f32)).collect());
    let channels = vec![AnyChannel::new(names[0], u), AnyChannel::new(names[1], v)];
    Image::from_channels((3, 2), AnyChannels::sort(channels.into())).write().to_file(file).unwrap();
}

#[test]
fn a_missing_file_is_none_and_a_capture_without_trackers_too() {
    let (_folder, store, _) = store("sparse", "npz");
    assert!(store.load(0, "cam", 1, SIZE).unwrap().is_none());
    assert!(TrackStore::open(tempfile::tempdir().unwrap().path()).unwrap().is_none());
}

#[test]
fn correspondences_shift_and_drop_what_is_not_finite() {
    let (_folder, store, file) = store("medium", "npz");
    let src = [0.0, 0.0, f32::NAN, 1.0, 2.0, 1.0];
    NpzWriter::new()
        .f32("src", &[3, 2], &src)
        .f64("tgt", &[3, 2], &[1.0; 6])
        .f32("visibility", &[3], &[0.5, 1.0, 2.0])
        .write(&file)
        .unwrap();
    let stats = store.load(0, "cam", 1, SIZE).unwrap().unwrap();
    let ViewMotion::Tracks(tracks) = stats.motion else { panic!() };
    assert_eq!(tracks.src, [[0.5, 0.5], [2.5, 1.5]]);
    assert_eq!(tracks.tgt, [[1.5, 1.5]; 2]);
    assert_eq!(tracks.visibility, [0.5, 1.0]);
    assert_eq!((stats.read, stats.dropped), (3, 1));
}

#[test]
fn columns_of_other_lengths_and_shapes_are_refused() {
    let (_folder, store, file) = store("sparse", "npz");
    NpzWriter::new().f32("src", &[2, 2], &[0.0; 4]).f32("tgt", &[1, 2], &[0.0; 2]).write(&file).unwrap();
    let error = store.load(0, "cam", 1, SIZE).unwrap_err();
    assert_eq!((error.problem.as_str(), error.file), ("'tgt' has 1 rows, 'src' has 2", file.clone()));
    NpzWriter::new().f32("src", &[2, 3], &[0.0; 6]).write(&file).unwrap();
    assert!(store.load(0, "cam", 1, SIZE).unwrap_err().to_string().contains("expected shape (*, 2)"));
}

#[test]
fn flo_keeps_standing_pixels_and_drops_unknown_ones() {
    let (_folder, store, file) = store("dense", "flo");
    let flow = [0.0, 0.0, 1.5, -2.0, 1e10, 0.0, f32::NAN, 0.0, 0.0, f32::INFINITY, 3.0, 4.0];
    fs::write(&file, flo(&flow)).unwrap();
    let stats = store.load(0, "cam", 1, SIZE).unwrap().unwrap();
    let ViewMotion::Dense(motion) = stats.motion else { panic!() };
    assert_eq!(motion.confidence, [1.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    assert_eq!((motion.flow[1], motion.flow[2]), ([1.5, -2.0], [0.0, 0.0]));
    assert_eq!(stats.dropped, 3);
}

#[test]
fn exr_reads_half_and_float_channels_of_any_name() {
    for names in [["U", "V"], ["u", "v"], ["flow.U", "flow.V"]] {
        let (_folder, store, file) = store("dense", "exr");
        write_exr(&file, names);
        let ViewMotion::Dense(motion) = store.load(0, "cam", 1, SIZE).unwrap().unwrap().motion else {
            panic!()
        };
        assert_eq!(motion.flow[4], [2.0, -4.0]);
    }
    let (_folder, store, file) = store("dense", "exr");
    write_exr(&file, ["R", "V"]);
    assert!(store.load(0, "cam", 1, SIZE).unwrap_err().to_string().contains("no channel U"));
}

#[test]
fn another_size_names_both() {
    let (_folder, store, file) = store("dense", "flo");
    fs::write(&file, flo(&[0.0; 12])).unwrap();
    let error = store.load(0, "cam", 1, ImageSize { width: 4, height: 2 }).unwrap_err();
    assert!(error.to_string().contains("flow is 3 x 2, but its camera is 4 x 2"), "{error}");
}

#[test]
fn what_is_far_larger_than_its_image_is_refused_before_it_is_unpacked() {
    let (_folder, store, file) = store("sparse", "npz");
    let rows = 1 << 20;
    NpzWriter::new()
        .f32("src", &[rows, 2], &vec![0.0; 2 * rows])
        .f32("tgt", &[rows, 2], &vec![0.0; 2 * rows])
        .write(&file)
        .unwrap();
    assert!(store.load(0, "cam", 1, SIZE).unwrap_err().to_string().contains("too large"));

    let (_folder, store, file) = self::store("dense", "exr");
    let channel = |i: usize| AnyChannel::new(format!("C{i:03}").as_str(), FlatSamples::F32(vec![0.0; 6]));
    let channels: Vec<_> = (0..100).map(channel).collect();
    Image::from_channels((3, 2), AnyChannels::sort(channels.into())).write().to_file(&file).unwrap();
    assert!(store.load(0, "cam", 1, SIZE).unwrap_err().to_string().contains("100 channels"));
    write_exr(&file, ["U", "V"]);
    let error = store.load(0, "cam", 1, ImageSize { width: 4, height: 2 }).unwrap_err();
    assert!(error.problem.contains("flow is 3 x 2"), "{error}");
}

/// The decoder of B44 blocks subtracts without looking: with overflow checked it panics on some damaged ones.
#[test]
fn damaged_b44_blocks_are_errors_and_no_panics() {
    let (_folder, store, file) = store("dense", "exr");
    let half = |k: usize| FlatSamples::F16((0..256).map(|i| f16::from_f32((i * k) as f32)).collect());
    let channels = vec![AnyChannel::new("U", half(3)), AnyChannel::new("V", half(7))];
    let encoding = Encoding { compression: Compression::B44, ..Encoding::UNCOMPRESSED };
    let channels = AnyChannels::sort(channels.into());
    Image::from_encoded_channels((16, 16), encoding, channels).write().to_file(&file).unwrap();
    let size = ImageSize { width: 16, height: 16 };
    assert!(store.load(0, "cam", 1, size).is_ok());
    let good = fs::read(&file).unwrap();
    for at in 0..good.len() {
        for value in [0x00, 0x7f, 0xff] {
            let mut damaged = good.clone();
            damaged[at] = value;
            fs::write(&file, damaged).unwrap();
            let _ = store.load(0, "cam", 1, size);
        }
    }
}

/// A capture of one camera whose files do not start at 0.
#[derive(Debug)]
struct Numbered(PathBuf, [String; 1]);

impl Capture for Numbered {
    fn root(&self) -> &Path {
        &self.0
    }
    fn frames(&self) -> usize {
        2
    }
    fn views(&self, split: Split) -> &[String] {
        if split == Split::Train { &self.1 } else { &[] }
    }
    fn camera(&self, _: ViewAt) -> Result<Camera, Fault> {
        Err(Fault::new(&self.0, "none", "none"))
    }
    fn image(&self, _: ViewAt) -> Result<ImageRgb8, Fault> {
        Err(Fault::new(&self.0, "none", "none"))
    }
    fn image_file(&self, at: ViewAt) -> Option<PathBuf> {
        Some(self.0.join(format!("ims/cam/{:06}.png", 16 + at.frame)))
    }
    fn mask(&self, _: ViewAt) -> Result<Option<Mask>, Fault> {
        Ok(None)
    }
    fn points(&self) -> Result<Option<Points>, Fault> {
        Ok(None)
    }
}

#[test]
fn files_may_be_named_after_the_images() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join("tracks/x/cam")).unwrap();
    let index = folder.path().join("tracks/tracks.json");
    let write = |pattern: &str| {
        let tracker =
            format!(r#"{{"name": "x", "level": "dense", "format": "flo", "pattern": "{pattern}"}}"#);
        fs::write(&index, format!(r#"{{"trackers": [{tracker}]}}"#)).unwrap();
    };
    write("x/{camera}/{stem}.flo");
    let store = TrackStore::of(&Numbered(folder.path().to_owned(), ["cam".into()])).unwrap().unwrap();
    assert!(store.path(0, "cam", 1).unwrap().ends_with("x/cam/000017.flo"));
    let error = store.load(0, "cam", 2, SIZE).unwrap_err().to_string();
    assert!(error.contains("camera 'cam' has no image of frame 2"), "{error}");
    for pattern in ["x/{camera}/{stem}_{frame}.flo", "x/{camera}/a.flo", "x/{stem}.flo"] {
        write(pattern);
        let refused = TrackStore::open(folder.path()).unwrap_err().to_string();
        assert!(refused.contains("needs {camera}"), "{pattern}: {refused}");
    }
}

#[test]
fn more_trackers_than_can_be_fused_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("tracks")).unwrap();
    let tracker = |i| {
        format!(r#"{{"name": "{i}", "level": "dense", "format": "flo", "pattern": "{{camera}}/{{frame}}"}}"#)
    };
    let write = |count: usize| {
        let all: Vec<String> = (0..count).map(tracker).collect();
        let text = format!(r#"{{"trackers": [{}]}}"#, all.join(", "));
        fs::write(folder.path().join("tracks/tracks.json"), text).unwrap();
    };
    write(64);
    assert_eq!(TrackStore::open(folder.path()).unwrap().unwrap().trackers().len(), 64);
    write(65);
    let error = TrackStore::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("65 trackers; at most 64"), "{error}");
}

#[test]
fn truncated_and_damaged_files_are_errors() {
    let (_folder, store, file) = store("dense", "flo");
    let (_exr_folder, exr_store, exr_file) = self::store("dense", "exr");
    write_exr(&exr_file, ["U", "V"]);
    for (store, file, bytes) in
        [(store, file, flo(&[0.0; 12])), (exr_store, exr_file.clone(), fs::read(&exr_file).unwrap())]
    {
        for length in 0..bytes.len() {
            fs::write(&file, &bytes[..length]).unwrap();
            assert!(store.load(0, "cam", 1, SIZE).is_err(), "{} {length}", file.display());
        }
        for i in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[i] ^= 0xff;
            fs::write(&file, damaged).unwrap();
            let _ = store.load(0, "cam", 1, SIZE);
        }
    }
}

#[test]
fn a_wrong_index_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("tracks")).unwrap();
    let entry = |level: &str, pattern: &str| {
        format!(
            r#"{{"trackers": [{{"name": "x", "level": "{level}", "format": "npz", "pattern": "{pattern}"}}]}}"#
        )
    };
    let bad = [
        "{",
        "{}",
        &entry("dense", "{camera}/{frame}"),
        &entry("sparse", "{camera}"),
        &entry("sparse", "../{camera}/{frame}"),
        &entry("sparse", "{camera}/{frame:6x}"),
        &entry("sparse", "{camera}/{frame}").replace("npz", "png"),
    ];
    for text in bad {
        fs::write(folder.path().join("tracks/tracks.json"), text).unwrap();
        let refused = TrackStore::open(folder.path()).unwrap_err().to_string();
        assert!(refused.contains("tracks.json: not a list of trackers"), "{text}: {refused}");
    }
}

#[test]
fn the_sample_has_every_file() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let store = TrackStore::open(&root).unwrap().unwrap();
    let report =
        check(&store, &[("trk001".to_owned(), ImageSize { width: 320, height: 180 })], 6, FilesRead::All);
    assert!(report.faults.is_empty(), "{report}");
    assert!(report.trackers.iter().all(|t| t.files == 5 && t.missing == 0 && t.tracks > 0), "{report}");
    let blind = check(&store, &[("nobody".to_owned(), SIZE)], 6, FilesRead::All);
    assert_eq!(blind.faults.len(), 3);
}

#[test]
fn exchanged_tracks_are_faults_and_frames_without_any_are_noted() {
    let (_folder, store, file) = store("medium", "npz");
    let write = |file: &Path, rows: &[f32]| {
        NpzWriter::new().f32("src", &[2, 2], rows).f32("tgt", &[2, 2], rows).write(file).unwrap();
    };
    let size = ImageSize { width: 9, height: 3 };
    let faults = |frames| check(&store, &[("cam".into(), size)], frames, FilesRead::All).to_string();
    write(&file, &[7.0, 1.0, 5.0, 2.0]);
    assert!(!faults(2).contains("fault"), "{}", faults(2));
    assert!(faults(3).contains("note: tracker 'x': no view has a file for frame 2"), "{}", faults(3));
    assert!(!faults(3).contains("fault"), "{}", faults(3));
    write(&file, &[1.0, 7.0, 2.0, 5.0]);
    assert!(
        faults(2)
            .contains("2 of 2 tracks start outside of the image\n  fix: store src and tgt as column, row")
    );
    write(&file, &[70.0, 10.0, 50.0, 20.0]);
    assert!(faults(2).contains("those of another size"), "{}", faults(2));
}

#[test]
fn a_long_capture_is_judged_by_some_of_its_files() {
    let (_folder, store, _) = store("medium", "npz");
    let size = ImageSize { width: 9, height: 3 };
    for frame in 1..40 {
        let rows = [7.0, 1.0, 5.0, 2.0];
        let file = store.path(0, "cam", frame).unwrap();
        NpzWriter::new().f32("src", &[2, 2], &rows).f32("tgt", &[2, 2], &rows).write(&file).unwrap();
    }
    fs::write(store.path(0, "cam", 4).unwrap(), "no archive").unwrap();
    let report = |read| check(&store, &[("cam".into(), size)], 40, read);
    let some = report(FilesRead::Sampled);
    assert!(some.faults.is_empty() && some.trackers[0].files == 39, "{some}");
    assert!((20..39).contains(&some.trackers[0].tracks), "two per file that is read: {some}");
    assert_eq!(report(FilesRead::All).faults.len(), 1);
    fs::remove_file(store.path(0, "cam", 5).unwrap()).unwrap();
    assert_eq!(report(FilesRead::Sampled).trackers[0].missing, 1);
}

/// A view without a file is left out; a link that leads nowhere is a fault that names it.
#[cfg(unix)]
#[test]
fn a_link_to_nowhere_is_not_a_missing_file() {
    let (folder, store, file) = store("dense", "flo");
    assert!(store.load(0, "cam", 1, SIZE).unwrap().is_none());
    std::os::unix::fs::symlink(folder.path().join("nowhere"), &file).unwrap();
    let error = store.load(0, "cam", 1, SIZE).unwrap_err().to_string();
    assert!(error.contains(&file.display().to_string()), "{error}");
}
