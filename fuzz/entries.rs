//! What the program parses, each as a function of bytes that must return whatever they are.

use ffgs_arrays::{NpzFile, read_npy};
use ffgs_core::ImageSize;
use ffgs_dataset::Capture;
use ffgs_method::Split;
use ffgs_pipeline::config::Config;
use ffgs_pipeline::json::read_json;
use ffgs_pipeline::record::FrameRecord;
use ffgs_splats::{load_checkpoint, read_ply};
use ffgs_tracks::TrackStore;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// A parser of a file's bytes.
pub type Entry = fn(&[u8]);

/// Name and parser of every kind of file that is read.
pub const ENTRIES: [(&str, Entry); 14] = [
    ("npy", npy),
    ("npz", npz),
    ("correspondences", |bytes| track("sparse", "npz", bytes)),
    ("flo", |bytes| track("dense", "flo", bytes)),
    ("exr", |bytes| track("dense", "exr", bytes)),
    ("flow_npy", |bytes| track("dense", "npy", bytes)),
    ("tracks_json", tracks_json),
    ("meta", meta),
    ("image", image),
    ("points", points),
    ("state", state),
    ("ply", ply),
    ("config", config),
    ("frame_json", frame_json),
];

/// Size of the one camera of the captures below.
const SIZE: ImageSize = ImageSize { width: 32, height: 24 };
const META: &str = r#"{"w":32,"h":24,"k":[[[[30,0,16],[0,30,12],[0,0,1]]]],
    "w2c":[[[[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]]],"fn":[["a/0.png"]],"cam_id":[[0]]}"#;

/// A folder with one file of these bytes.
fn folder(name: &str, bytes: &[u8]) -> TempDir {
    let folder = TempDir::new().expect("a temporary folder");
    write(folder.path(), name, bytes);
    folder
}

fn write(folder: &Path, name: &str, bytes: &[u8]) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().expect("below the folder")).expect("a folder");
    fs::write(path, bytes).expect("a file");
}

fn npy(bytes: &[u8]) {
    let folder = folder("a.npy", bytes);
    let file = folder.path().join("a.npy");
    let _ = read_npy::<f32>(&file, &[None], 1 << 24);
    let _ = read_npy::<i64>(&file, &[None, None], 1 << 24);
    let _ = read_npy::<u8>(&file, &[None, None, None], 1 << 24);
}

fn npz(bytes: &[u8]) {
    let folder = folder("a.npz", bytes);
    let Ok(file) = NpzFile::open_within(&folder.path().join("a.npz"), 1 << 24) else { return };
    for name in file.names() {
        let _ = (file.f64(name).is_ok(), file.u8(name).is_ok());
    }
}

fn track(level: &str, format: &str, bytes: &[u8]) {
    let folder = folder("tracks/a/0", bytes);
    let tracker =
        format!(r#"{{"name":"t","level":"{level}","format":"{format}","pattern":"{{camera}}/{{frame}}"}}"#);
    write(folder.path(), "tracks/tracks.json", format!(r#"{{"trackers":[{tracker}]}}"#).as_bytes());
    let store = TrackStore::open(folder.path()).expect("a sound list").expect("a list");
    let _ = store.load(0, "a", 0, SIZE);
}

fn tracks_json(bytes: &[u8]) {
    let folder = folder("tracks/tracks.json", bytes);
    write(folder.path(), "train_meta.json", META.as_bytes());
    let capture = Capture::open(folder.path()).expect("a sound camera list");
    let Ok(Some(store)) = TrackStore::of(&capture) else { return };
    for tracker in 0..store.trackers().len() {
        let path = store.path(tracker, "a", 0).expect("an accepted pattern expands");
        assert!(path.starts_with(folder.path().join("tracks")), "{} leaves the folder", path.display());
    }
}

fn meta(bytes: &[u8]) {
    let folder = folder("train_meta.json", bytes);
    let Ok(capture) = Capture::open(folder.path()) else { return };
    for view in 0..capture.views(Split::Train).len() {
        let _ = capture.camera(Split::Train, view, 0);
        let image = capture.image_path(Split::Train, view, 0).expect("a view has an image");
        let inside = image.strip_prefix(folder.path().join("ims")).expect("below the images");
        assert!(inside.components().all(|part| matches!(part, std::path::Component::Normal(_))));
    }
}

fn capture_with(name: &str, bytes: &[u8]) -> (TempDir, Capture) {
    let folder = folder(name, bytes);
    write(folder.path(), "train_meta.json", META.as_bytes());
    let capture = Capture::open(folder.path()).expect("a sound camera list");
    (folder, capture)
}

fn image(bytes: &[u8]) {
    let (folder, capture) = capture_with("ims/a/0.png", bytes);
    write(folder.path(), "seg/a/0.png", bytes);
    let _ = capture.load_image(Split::Train, 0, 0);
    let _ = capture.load_mask(Split::Train, 0, 0);
}

fn points(bytes: &[u8]) {
    let (_folder, capture) = capture_with("init_pt_cld.npz", bytes);
    let _ = capture.initial_points();
}

/// The bytes as they are, and as the payload of a file whose length and checksum are right.
fn state(bytes: &[u8]) {
    let mut sealed = b"FFGSCKPT\x04\x00\x00\x00".to_vec();
    sealed.extend((bytes.len() as u64).to_le_bytes());
    sealed.extend(bytes);
    sealed.extend(crc32fast::hash(&sealed).to_le_bytes());
    for bytes in [bytes, &sealed] {
        let folder = folder("state.ffgs", bytes);
        let _ = load_checkpoint(&folder.path().join("state.ffgs"));
        let _ = ffgs_pipeline::state::load(&folder.path().join("state.ffgs"), 0);
    }
}

fn ply(bytes: &[u8]) {
    let folder = folder("a.ply", bytes);
    let _ = read_ply(&folder.path().join("a.ply"));
}

fn config(bytes: &[u8]) {
    let folder = folder("a.toml", bytes);
    if let Ok(config) = Config::read(&folder.path().join("a.toml")) {
        let text = config.to_toml().expect("an accepted configuration can be written");
        write(folder.path(), "b.toml", text.as_bytes());
        assert_eq!(Config::read(&folder.path().join("b.toml")).expect("and read"), config);
    }
}

fn frame_json(bytes: &[u8]) {
    let folder = folder("frame.json", bytes);
    let _ = read_json::<FrameRecord>(&folder.path().join("frame.json"));
}
