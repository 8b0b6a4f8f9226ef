//! Checkpoints restore every bit, and refuse anything else. The sky's PNGs.

use ffgs_core::Gaussians;
use ffgs_splats::{FrameState, load_checkpoint, save_checkpoint, write_sky_cross};
use glam::{DMat3, DVec3};
use std::borrow::Cow;
use std::fs;

fn state() -> FrameState<'static> {
    let mut static_layer = Gaussians::zeros(3, 2);
    static_layer.sh[5] = [f32::MIN_POSITIVE / 8.0, -0.0, 1.0 / 3.0];
    static_layer.quats[1] = [0.1, 0.2, 0.3, 0.4];
    let mut dynamic_layer = Gaussians::zeros(2, 3);
    dynamic_layer.means[1] = [1e-30, 1e30, -7.5];
    FrameState {
        frame: 12,
        static_layer: Cow::Owned(static_layer),
        dynamic_layer: Cow::Owned(dynamic_layer),
        dynamic_covariances: vec![DMat3::from_diagonal(DVec3::new(0.1, 1.0 / 3.0, 1e-300)); 2],
        dynamic_ids: vec![9, u32::MAX - 1],
        next_id: u32::MAX,
        dynamic_information: Cow::Owned(Gaussians::zeros(2, 3)),
        static_information: Cow::Owned(Gaussians::zeros(3, 2)),
        sky_face_size: 2,
        sky: (0..72).map(|i| i as f32 / 7.0).collect(),
        q: 0.123_456_789,
        dynamic_steps: vec![DVec3::new(-0.0, 1.4, 1e-300); 2],
        dynamic_flexibility: vec![-0.0, 3.5],
        static_hidden: vec![0, 2, u8::MAX],
        static_colours: vec![[0.1, 1.0 / 3.0]; 3],
        aside: vec![0, 2],
        aside_layer: Cow::Owned(Gaussians::zeros(2, 2)),
        reals: [("scale".to_owned(), f64::MIN_POSITIVE)].into(),
        integers: [("iteration".to_owned(), u64::MAX), ("seed".to_owned(), 3)].into(),
    }
}

#[test]
fn a_checkpoint_comes_back_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame/12.ckpt");
    save_checkpoint(&path, &state()).unwrap();
    let first = fs::read(&path).unwrap();
    let back = load_checkpoint(&path).unwrap();
    assert_eq!(back, state());
    save_checkpoint(&path, &back).unwrap();
    assert_eq!(fs::read(&path).unwrap(), first);
}

#[test]
fn truncation_and_any_changed_byte_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.ckpt");
    save_checkpoint(&path, &state()).unwrap();
    let good = fs::read(&path).unwrap();
    for i in (0..good.len()).step_by(13).chain([good.len() - 1]) {
        fs::write(&path, &good[..i]).unwrap();
        assert!(load_checkpoint(&path).unwrap_err().to_string().contains("x.ckpt"), "cut at {i}");
        let mut bad = good.clone();
        bad[i] ^= 0x40;
        fs::write(&path, bad).unwrap();
        assert!(load_checkpoint(&path).is_err(), "byte {i}");
    }
}

type Change = fn(&mut FrameState<'static>);

#[test]
fn columns_that_do_not_go_together_are_errors_though_the_checksum_is_right() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.ckpt");
    let faults: [(Change, &str); 11] = [
        (|s| s.sky_face_size = 3, "faces of 3 px"),
        (|s| s.sky_face_size = 1 << 32, "faces of 4294967296 px"),
        (|s| s.sky_face_size = 1 << 63, "faces of"),
        (|s| s.dynamic_covariances.truncate(1), "1 covariances of 2"),
        (|s| s.dynamic_steps.truncate(1), "1 last steps of 2"),
        (|s| s.dynamic_ids = vec![1; 3], "3 ids of 2"),
        (|s| s.static_hidden.truncate(1), "1 counts of rounds of 3"),
        (|s| s.static_colours.truncate(2), "2 variances of colours of 3"),
        (|s| s.aside = vec![0, 3], "Gaussian 3 of 3 is put aside"),
        (|s| s.aside.truncate(1), "2 Gaussians of 1 places are put aside"),
        (|s| s.static_information = Cow::Owned(Gaussians::zeros(4, 0)), "4 rows of information of"),
    ];
    for (change, words) in faults {
        let mut changed = state();
        change(&mut changed);
        save_checkpoint(&path, &changed).unwrap();
        let error = load_checkpoint(&path).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn the_sky_is_written_as_a_cross() {
    let folder = tempfile::tempdir().unwrap();
    let mut texels = vec![0.0; 72];
    texels[0] = 1.0;
    let cross = folder.path().join("sky.png");
    write_sky_cross(&cross, 2, &texels).unwrap();
    let cross = image::open(cross).unwrap().to_rgb8();
    assert_eq!((cross.dimensions(), cross.get_pixel(4, 2).0), ((8, 6), [255, 0, 0]));
    assert!(write_sky_cross(&folder.path().join("wrong.png"), 3, &texels).is_err());
}
