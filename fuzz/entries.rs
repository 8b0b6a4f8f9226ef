//! What the program parses, each as a function of bytes that must return whatever they are.

use ffgs_arrays::{NpzFile, read_npy};
use ffgs_calibration::detect;
use ffgs_core::ImageSize;
use ffgs_dataset::Capture;
use ffgs_method::Split;
use ffgs_pipeline::job::lock::FolderLock;
use ffgs_pipeline::job::manifest::Manifest;
use ffgs_pipeline::outputs::json::read_json;
use ffgs_pipeline::outputs::record::FrameRecord;
use ffgs_pipeline::settings::config::Config;
use ffgs_prepare::{Request, Step, prepare};
use ffgs_splats::{decode_spz, load_checkpoint, read_ply};
use ffgs_stream::Reader;
use ffgs_tracks::TrackStore;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// A parser of a file's bytes, which says whether it accepts them.
pub(crate) type Entry = fn(&[u8]) -> bool;

/// Name and parser of every kind of file that is read.
pub(crate) const ENTRIES: [(&str, Entry); 35] = [
    ("npy", npy),
    ("npz", npz),
    ("npz_array", npz_array),
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
    ("spz", |bytes| decode_spz(bytes).is_ok()),
    ("config", config),
    ("frame_json", |bytes| json::<FrameRecord>(bytes)),
    ("run_json", |bytes| json::<Manifest>(bytes)),
    ("pictures_json", |bytes| json::<ffgs_report::FramePictures>(bytes)),
    ("lock", lock),
    ("colmap_images", |bytes| footage("colmap", "sparse/0/images.bin", bytes)),
    ("colmap_cameras", |bytes| footage("colmap", "sparse/0/cameras.bin", bytes)),
    ("colmap_text", |bytes| footage("colmap", "sparse/0/images.txt", bytes)),
    ("dynamic3dgs", |bytes| footage("dynamic3dgs", "train_meta.json", bytes)),
    ("transforms", |bytes| footage("transforms", "transforms.json", bytes)),
    ("opencv_yaml", |bytes| footage("easyvolcap", "intri.yml", bytes)),
    ("opencv_xml", |bytes| footage("opencv", "a.xml", bytes)),
    ("camera_toml", |bytes| footage("toml", "calibration.toml", bytes)),
    ("panoptic", |bytes| footage("panoptic", "calibration_1.json", bytes)),
    ("qualisys", |bytes| footage("qualisys", "trial.qca.txt", bytes)),
    ("poses_bounds", |bytes| footage("n3dv", "poses_bounds.npy", bytes)),
    ("timestamps", |bytes| preparation("footage/timestamps.csv", bytes)),
    ("prepare_json", |bytes| preparation("out/prepare.json", bytes)),
    ("stream_manifest", stream_manifest),
    ("stream_list", stream_list),
    ("stream_frame", stream_frame),
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

fn npy(bytes: &[u8]) -> bool {
    let folder = folder("a.npy", bytes);
    let file = folder.path().join("a.npy");
    let one = read_npy::<f32>(&file, &[None], 1 << 24).is_ok();
    let two = read_npy::<i64>(&file, &[None, None], 1 << 24).is_ok();
    one | two | read_npy::<u8>(&file, &[None, None, None], 1 << 24).is_ok()
}

fn npz(bytes: &[u8]) -> bool {
    let folder = folder("a.npz", bytes);
    let Ok(file) = NpzFile::open_within(&folder.path().join("a.npz"), 1 << 24) else { return false };
    file.names().iter().all(|name| file.f64(name).is_ok() | file.u8(name).is_ok())
}

/// The bytes as the array of an archive that is sound, so that damage gets past its checksum.
fn npz_array(bytes: &[u8]) -> bool {
    let (name, length, sum) =
        (b"a.npy", (bytes.len() as u32).to_le_bytes(), crc32fast::hash(bytes).to_le_bytes());
    let sizes = [&sum[..], &length, &length, &[5, 0, 0, 0]].concat();
    let local = [b"PK\x03\x04\x14\0\0\0\0\0\0\0\0\0", &sizes[..], name, bytes].concat();
    let central = [b"PK\x01\x02\x14\0\x14\0\0\0\0\0\0\0\0\0", &sizes[..], &[0; 14], name].concat();
    let places = [central.len() as u32, local.len() as u32].map(u32::to_le_bytes).concat();
    npz(&[local, central, b"PK\x05\x06\0\0\0\0\x01\0\x01\0".to_vec(), places, vec![0; 2]].concat())
}

fn track(level: &str, format: &str, bytes: &[u8]) -> bool {
    let folder = folder("tracks/a/0", bytes);
    let tracker =
        format!(r#"{{"name":"t","level":"{level}","format":"{format}","pattern":"{{camera}}/{{frame}}"}}"#);
    write(folder.path(), "tracks/tracks.json", format!(r#"{{"trackers":[{tracker}]}}"#).as_bytes());
    let store = TrackStore::open(folder.path()).expect("a sound list").expect("a list");
    store.load(0, "a", 0, SIZE).is_ok()
}

fn tracks_json(bytes: &[u8]) -> bool {
    let folder = folder("tracks/tracks.json", bytes);
    write(folder.path(), "train_meta.json", META.as_bytes());
    let capture = Capture::open(folder.path()).expect("a sound camera list");
    let Ok(Some(store)) = TrackStore::of(&capture) else { return false };
    for tracker in 0..store.trackers().len() {
        let path = store.path(tracker, "a", 0).expect("an accepted pattern expands");
        assert!(path.starts_with(folder.path().join("tracks")), "{} leaves the folder", path.display());
    }
    true
}

fn meta(bytes: &[u8]) -> bool {
    let folder = folder("train_meta.json", bytes);
    let Ok(capture) = Capture::open(folder.path()) else { return false };
    for view in 0..capture.views(Split::Train).len() {
        let _ = capture.camera(Split::Train, view, 0);
        let image = capture.image_path(Split::Train, view, 0).expect("a view has an image");
        let inside = image.strip_prefix(folder.path().join("ims")).expect("below the images");
        assert!(inside.components().all(|part| matches!(part, std::path::Component::Normal(_))));
    }
    true
}

fn capture_with(name: &str, bytes: &[u8]) -> (TempDir, Capture) {
    let folder = folder(name, bytes);
    write(folder.path(), "train_meta.json", META.as_bytes());
    let capture = Capture::open(folder.path()).expect("a sound camera list");
    (folder, capture)
}

fn image(bytes: &[u8]) -> bool {
    let (folder, capture) = capture_with("ims/a/0.png", bytes);
    write(folder.path(), "seg/a/0.png", bytes);
    let image = capture.load_image(Split::Train, 0, 0).is_ok();
    image & capture.load_mask(Split::Train, 0, 0).is_ok()
}

fn points(bytes: &[u8]) -> bool {
    let (_folder, capture) = capture_with("init_pt_cld.npz", bytes);
    capture.initial_points().is_ok()
}

/// The bytes as they are, and as the payload of a file whose length and checksum are right.
fn state(bytes: &[u8]) -> bool {
    let mut sealed = b"FFGSCKPT\x04\x00\x00\x00".to_vec();
    sealed.extend((bytes.len() as u64).to_le_bytes());
    sealed.extend(bytes);
    sealed.extend(crc32fast::hash(&sealed).to_le_bytes());
    [bytes, &sealed].iter().fold(false, |accepted, bytes| {
        let folder = folder("state.ffgs", bytes);
        let _ = ffgs_pipeline::outputs::state::load(&folder.path().join("state.ffgs"), 0);
        accepted | load_checkpoint(&folder.path().join("state.ffgs")).is_ok()
    })
}

fn ply(bytes: &[u8]) -> bool {
    let folder = folder("a.ply", bytes);
    read_ply(&folder.path().join("a.ply")).is_ok()
}

fn config(bytes: &[u8]) -> bool {
    let folder = folder("a.toml", bytes);
    let Ok(config) = Config::read(&folder.path().join("a.toml")) else { return false };
    let text = config.to_toml().expect("an accepted configuration can be written");
    write(folder.path(), "b.toml", text.as_bytes());
    assert_eq!(Config::read(&folder.path().join("b.toml")).expect("and read"), config);
    true
}

fn json<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> bool {
    let folder = folder("a.json", bytes);
    read_json::<T>(&folder.path().join("a.json")).is_ok()
}

fn lock(bytes: &[u8]) -> bool {
    let folder = folder("run.lock", bytes);
    FolderLock::take(folder.path()).is_ok()
}

/// A picture of footage.
const PICTURE: &[u8] = include_bytes!("corpus/image/grey.png");
/// What belongs to the calibrations besides the file that is damaged.
const BESIDES: [(&str, &[u8]); 4] = [
    ("sparse/0/images.bin", include_bytes!("corpus/colmap_images/images.bin")),
    ("sparse/0/cameras.bin", include_bytes!("besides/cameras.bin")),
    ("sparse/0/cameras.txt", include_bytes!("besides/cameras.txt")),
    ("extri.yml", include_bytes!("besides/extri.yml")),
];

fn footage(format: &str, name: &str, bytes: &[u8]) -> bool {
    let folder = folder("images/a/0.png", PICTURE);
    write(folder.path(), "images/b/0.png", PICTURE);
    let ending = name.rsplit('.').next().unwrap_or_default();
    for (other, bytes) in BESIDES.iter().filter(|other| other.0.ends_with(ending)) {
        write(folder.path(), other, bytes);
    }
    write(folder.path(), name, bytes);
    let Ok((format, file)) = detect(folder.path(), Some(format)) else { return false };
    (format.read)(folder.path(), &file).is_ok()
}

/// Pictures made of footage, or made before, with one file of these bytes.
fn preparation(name: &str, bytes: &[u8]) -> bool {
    let folder = folder(name, bytes);
    let source = folder.path().join("footage");
    write(&source, "calibration.toml", include_bytes!("corpus/camera_toml/calibration.toml"));
    write(&source, "images/a/0.png", PICTURE);
    write(&source, "images/b/0.png", PICTURE);
    let [only, force] = [(); 2].map(|()| vec![Step::Pictures]);
    let request = Request { only, force, ..Request::new(source, folder.path().join("out")) };
    prepare(&request, &|_: &str, _, _| ()).is_ok()
}

const MANIFEST: &[u8] = include_bytes!("../fixtures/reference/stream/manifest.json");
const KEY_FRAME: &[u8] = include_bytes!("corpus/stream_frame/key.4df");

fn stream_manifest(bytes: &[u8]) -> bool {
    let folder = folder("manifest.json", bytes);
    Reader::open(folder.path()).is_ok()
}

fn stream_list(bytes: &[u8]) -> bool {
    let folder = folder("frames.jsonl", bytes);
    write(folder.path(), "manifest.json", MANIFEST);
    write(folder.path(), "000000.4df", KEY_FRAME);
    let Ok(mut reader) = Reader::open(folder.path()) else { return false };
    let frames: Vec<u64> = reader.entries().iter().map(|entry| entry.frame).take(4).collect();
    frames.into_iter().fold(false, |accepted, frame| accepted | reader.read(frame).is_ok())
}

/// The bytes as the first frame and as one that changes a sound frame, with right checksums.
fn stream_frame(bytes: &[u8]) -> bool {
    let sealed = |bytes: &[u8]| {
        let body = &bytes[..bytes.len().saturating_sub(4)];
        [body, &crc32fast::hash(body).to_le_bytes()].concat()
    };
    let (key, second) = (sealed(KEY_FRAME), sealed(bytes));
    let entry = |frame: usize, bytes: &[u8], key: bool| {
        let (body, length) = (&bytes[..bytes.len() - 4], bytes.len());
        let sum = crc32fast::hash(body);
        format!(
            "{{\"frame\":{frame},\"file\":\"{frame}.4df\",\"bytes\":{length},\"crc32\":{sum},\"key\":{key},\"static_key\":{key},\
             \"sky\":{key},\"gaussians\":[200,150],\"sections\":{{}}}}\n"
        )
    };
    [true, false].into_iter().fold(false, |accepted, first| {
        let head = if first { String::new() } else { entry(0, &key, true) };
        let list = head + &entry(usize::from(!first), &second, first);
        let folder = folder("frames.jsonl", list.as_bytes());
        write(folder.path(), "manifest.json", MANIFEST);
        write(folder.path(), "0.4df", if first { &second } else { &key });
        write(folder.path(), "1.4df", &second);
        let mut reader = Reader::open(folder.path()).expect("a sound list");
        accepted | reader.read(u64::from(!first)).is_ok()
    })
}
