//! A camera with one pose whose picture moves.

use ffgs_arrays::NpzWriter;
use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};
use ffgs_method::{Capture, Fault, Points, Split, ViewAt};
use ffgs_tracks::{TrackStore, moving_backgrounds};
use glam::{DMat4, DVec3};
use std::fs;
use std::path::{Path, PathBuf};

const SIZE: ImageSize = ImageSize { width: 100, height: 60 };

/// Two cameras, three frames; the left 60 columns are foreground.
#[derive(Debug)]
struct Filmed {
    root: PathBuf,
    names: Vec<String>,
    /// Where (m) the cameras are in each frame.
    places: [f64; 3],
}

impl Capture for Filmed {
    fn root(&self) -> &Path {
        &self.root
    }

    fn frames(&self) -> usize {
        3
    }

    fn views(&self, split: Split) -> &[String] {
        if split == Split::Train { &self.names } else { &[] }
    }

    fn camera(&self, at: ViewAt) -> Result<Camera, Fault> {
        let pose = DMat4::from_translation(DVec3::X * self.places[at.frame]);
        Ok(Camera::new(Intrinsics { fx: 80.0, fy: 80.0, cx: 50.0, cy: 30.0 }, pose, SIZE).unwrap())
    }

    fn image(&self, at: ViewAt) -> Result<ImageRgb8, Fault> {
        Err(Fault::new(&self.root.join(at.frame.to_string()), "no image", "none is needed"))
    }

    fn mask(&self, _: ViewAt) -> Result<Option<Mask>, Fault> {
        let data = (0..SIZE.pixels()).map(|i| u8::from(i % SIZE.width < 60)).collect();
        Ok(Mask::new(SIZE, data))
    }

    fn points(&self) -> Result<Option<Points>, Fault> {
        Ok(None)
    }
}

/// Cameras whose background is told, when the foreground moves by 9 px and the background of camera b by `background`, both in frame 1.
fn told(background: f32, places: [f64; 3]) -> Vec<(String, f32)> {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().to_owned();
    let list = r#"{"trackers": [{"name": "x", "level": "medium", "format": "npz", "pattern": "x/{camera}/{frame}.npz"}]}"#;
    for (camera, still) in [("a", 0.4), ("b", background)] {
        fs::create_dir_all(root.join("tracks/x").join(camera)).unwrap();
        let src: Vec<[f32; 2]> = (0..120).map(|i| [(i % 24) as f32 * 4.0, (i / 24) as f32 * 10.0]).collect();
        let tgt: Vec<[f32; 2]> =
            src.iter().map(|p| [p[0] + if p[0] < 60.0 { 9.0 } else { still }, p[1]]).collect();
        let file = root.join("tracks/x").join(camera).join("1.npz");
        let shape = [src.len(), 2];
        let (src, tgt) = (src.as_flattened(), tgt.as_flattened());
        NpzWriter::new().f32("src", &shape, src).f32("tgt", &shape, tgt).write(&file).unwrap();
    }
    fs::write(root.join("tracks/tracks.json"), list).unwrap();
    let store = TrackStore::open(&root).unwrap().unwrap();
    let capture = Filmed { root, names: vec!["a".into(), "b".into()], places };
    moving_backgrounds(&store, &capture).into_iter().map(|m| (m.camera, m.pixels)).collect()
}

#[test]
fn only_a_fixed_camera_whose_background_moves_is_told() {
    assert_eq!(told(0.6, [0.0; 3]), []);
    let found = told(4.0, [0.0; 3]);
    assert!(found.len() == 1 && found[0].0 == "b" && (found[0].1 - 4.0).abs() < 1e-3, "{found:?}");
    // A camera that says that it moves may.
    assert_eq!(told(4.0, [0.0, 0.1, 0.2]), []);
    assert_eq!(told(4.0, [0.0, 0.0, 0.1]), [], "also where it rests at first");
}
