//! Damaged bytes through every parser: the same functions that `fuzz/` drives for hours, for seconds and on stable Rust.

#[path = "../../../fuzz/damage.rs"]
mod damage;
#[path = "../../../fuzz/entries.rs"]
mod entries;

use damage::{Random, damage};
use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, Image, WritableImage};
use ffgs_arrays::NpzWriter;
use ffgs_core::Gaussians;
use ffgs_splats::{FrameState, RenderMode, save_checkpoint, write_ply};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Damaged copies of each seed.
const COPIES: usize = 150;

fn sample(file: &str) -> Vec<u8> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    fs::read(root.join(file)).unwrap()
}

fn written(name: &str, write: impl FnOnce(&Path)) -> Vec<u8> {
    let folder = TempDir::new().unwrap();
    let path: PathBuf = folder.path().join(name);
    write(&path);
    fs::read(path).unwrap()
}

fn npz(names: &[&str], columns: usize) -> Vec<u8> {
    written("a.npz", |path| {
        let mut writer = NpzWriter::new();
        for name in names {
            writer.f32(name, &[8, columns], &vec![0.5; 8 * columns]);
        }
        writer.write(path).unwrap();
    })
}

fn npy(shape: &str, bytes: usize) -> Vec<u8> {
    let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n");
    let head = [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat();
    [head, vec![0; bytes]].concat()
}

/// A sound file of every kind.
fn seed(name: &str) -> Vec<u8> {
    let (size, tracker) = ((32_i32, 24_i32), "xfeat/{camera}/{stem}.npz");
    match name {
        "npy" => npy("(4, 6)", 96),
        "flow_npy" => npy("(24, 32, 2)", 4 * 24 * 32 * 2),
        "npz" | "correspondences" => npz(&["src", "tgt"], 2),
        "points" => npz(&["data"], 7),
        "flo" => {
            let head = [b"PIEH".as_slice(), &size.0.to_le_bytes(), &size.1.to_le_bytes()].concat();
            [head, vec![0; 8 * 24 * 32]].concat()
        }
        "exr" => written("a.exr", |path| {
            let channel = |name| AnyChannel::new(name, FlatSamples::F32(vec![0.5; 32 * 24]));
            let channels = AnyChannels::sort(vec![channel("U"), channel("V")].into());
            Image::from_channels((32, 24), channels).write().to_file(path).unwrap();
        }),
        "tracks_json" => {
            let entry = format!(r#"{{"name":"x","level":"sparse","format":"npz","pattern":"{tracker}"}}"#);
            format!(r#"{{"trackers":[{entry}]}}"#).into_bytes()
        }
        "meta" => sample("init_meta.json"),
        "image" => written("a.png", |path| image::GrayImage::new(32, 24).save(path).unwrap()),
        "state" => written("a", |path| {
            let layer = Gaussians::zeros(2, 1);
            let state = FrameState {
                static_layer: std::borrow::Cow::Owned(layer),
                sky_face_size: 1,
                sky: vec![0.0; 18],
                ..FrameState::default()
            };
            save_checkpoint(path, &state).unwrap();
        })[20..]
            .to_vec(),
        "ply" => {
            written("a.ply", |path| write_ply(path, &Gaussians::zeros(3, 1), None, RenderMode::Mip).unwrap())
        }
        "config" => ffgs_pipeline::config::Config::default().to_toml().unwrap().into_bytes(),
        "frame_json" => br#"{"frame":1,"views":[{"camera":"a","fixed":true,"psnr":20.5,"ssim":0.5}],
            "static_gaussians":3,"dynamic_gaussians":1,"bytes":9,"seconds":{},"skips":{},"warnings":[]}"#
            .to_vec(),
        other => panic!("no seed of {other}"),
    }
}

#[test]
fn no_parser_gives_up_on_damaged_bytes() {
    for (name, parse) in entries::ENTRIES {
        let seed = seed(name);
        parse(&seed);
        parse(&[]);
        let mut random = Random(name.len() as u64);
        for copy in 0..COPIES {
            let mut bytes = seed.clone();
            damage(&mut random, &mut bytes);
            let ended = std::panic::catch_unwind(|| parse(&bytes));
            assert!(ended.is_ok(), "{name}, copy {copy}: {bytes:?}");
        }
    }
}
