//! Tiny networks whose outputs are known (`make_networks.py`), by the library that `ORT_DYLIB_PATH` names. Without the
//! variable and without an installed library there is nothing to test, which is said.

use ffgs_core::{ImageRgb8, ImageSize};
use ffgs_networks::{Description, Motion, Network, NetworkError};
use std::path::Path;

const SIZE: ImageSize = ImageSize { width: 60, height: 44 };

/// The network `name` of the folder beside this file, with a description made of `rest`.
fn load(name: &str, rest: &str) -> Option<Result<Network, NetworkError>> {
    let folder = tempfile::tempdir().unwrap();
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/networks/{name}.onnx"));
    let file = folder.path().join("net.toml");
    std::fs::write(&file, format!("name = 'net'\nmodel = '{}'\n{rest}", model.display())).unwrap();
    let loaded = Network::load(Description::of(&file.display().to_string()).unwrap(), 1);
    match loaded {
        Err(NetworkError::Library(reason)) if std::env::var_os("ORT_DYLIB_PATH").is_none() => {
            eprintln!("skipped: {reason}");
            None
        }
        other => Some(other),
    }
}

const BLOCKS: &str = "[input]\nnames = ['before', 'now']\ndivide = [255, 255, 255]\n";

/// Random grey values, smooth over some pixels, moved by whole pixels.
fn picture(size: ImageSize, motion: (i64, i64)) -> ImageRgb8 {
    let value = |x: i64, y: i64| {
        let mut z = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (y as u64).rotate_left(32);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((z ^ (z >> 27)) >> 56) as u8
    };
    let at =
        |i: usize| value((i % size.width) as i64 - motion.0 + 99, (i / size.width) as i64 - motion.1 + 99);
    ImageRgb8::new(size, (0..size.pixels()).flat_map(|i| [at(i); 3]).collect()).unwrap()
}

fn pair(size: ImageSize) -> [ImageRgb8; 2] {
    [picture(size, (0, 0)), picture(size, (3, -2))]
}

#[test]
fn flow_is_found_for_every_pixel_and_any_size() {
    let Some(network) = load("blocks", &format!("{BLOCKS}multiple = 8\n[flow]\noutput = 'flow'\n")) else {
        return;
    };
    let mut network = network.unwrap();
    for size in [SIZE, ImageSize { width: 33, height: 40 }] {
        let [before, now] = pair(size);
        let Motion::Flow(flow) = network.motion(&before, &now).unwrap() else { panic!("not flow") };
        assert_eq!(flow.len(), size.pixels());
        let is_inside = |i: &usize| {
            let (x, y) = (i % size.width, i / size.width);
            (7..size.width - 7).contains(&x) && (7..size.height - 7).contains(&y)
        };
        let inside: Vec<usize> = (0..flow.len()).filter(is_inside).collect();
        assert!(inside.len() > 400 && inside.iter().all(|i| flow[*i] == [3.0, -2.0]));
        assert_eq!(network.motion(&before, &before).unwrap(), Motion::Flow(vec![[0.0; 2]; size.pixels()]));
    }
}

#[test]
fn pairs_become_tracks_with_half_centres() {
    let rest = format!("{BLOCKS}[matches]\nfirst = 'first'\nsecond = 'second'\nindices = 'matches'\n");
    let Some(network) = load("matcher", &rest) else { return };
    let [before, now] = pair(SIZE);
    let Motion::Tracks(tracks) = network.unwrap().motion(&before, &now).unwrap() else {
        panic!("not tracks")
    };
    // Half of the lattice of 6 x 4.
    assert_eq!((tracks.src.len(), tracks.src[0], tracks.tgt[0]), (12, [8.5, 8.5], [11.5, 6.5]));
    assert!(tracks.src.iter().zip(&tracks.tgt).all(|(s, t)| [t[0] - s[0], t[1] - s[1]] == [3.0, -2.0]));
}

#[test]
fn a_network_of_one_size_serves_pictures_of_any() {
    let Some(network) = load("fixed", "[input]\nnames = ['both']\n[flow]\noutput = 'flow'\n") else { return };
    let [before, now] = pair(ImageSize { width: 64, height: 72 });
    let Motion::Flow(flow) = network.unwrap().motion(&before, &now).unwrap() else { panic!("not flow") };
    // (2, 1) of a network's picture of 32 x 24.
    assert_eq!(flow, vec![[4.0, 3.0]; 64 * 72]);
}

#[test]
fn a_description_that_does_not_fit_is_refused_with_what_would() {
    let told = |name: &str, rest: &str| load(name, rest).map(|result| result.unwrap_err().to_string());
    let cases = [
        (
            "blocks",
            "[input]\nnames = ['image1', 'now']\n[flow]\noutput = 'flow'\n",
            "no input 'image1'; it has before",
        ),
        (
            "blocks",
            "[input]\nnames = ['before', 'now']\n[flow]\noutput = 'flows'\n",
            "no output 'flows'; it has flow",
        ),
        ("blocks", "[input]\nnames = ['now']\n[flow]\noutput = 'flow'\n", "an input 'before' besides now"),
        (
            "blocks",
            "[input]\nnames = ['before', 'now']\nlayout = 'nhwc'\n[flow]\noutput = 'flow'\n",
            "layout, colour",
        ),
        (
            "blocks",
            "[input]\nnames = ['before', 'now']\ncolour = 'grey'\n[flow]\noutput = 'flow'\n",
            "layout, colour",
        ),
        (
            "fixed",
            "[input]\nnames = ['both']\njoin = 'batch'\n[flow]\noutput = 'flow'\n",
            "layout, colour, join",
        ),
        (
            "fixed",
            "[input]\nnames = ['both']\nsize = [64, 48]\n[flow]\noutput = 'flow'\n",
            "pictures of 32 x 24",
        ),
        ("none", "[input]\nnames = ['both']\n[flow]\noutput = 'flow'\n", "none.onnx: "),
    ];
    for (name, rest, wanted) in cases {
        let Some(message) = told(name, rest) else { return };
        assert!(message.contains(wanted), "{message}");
        assert!(message.contains(&format!("{name}.onnx")), "{message}");
    }
}

#[test]
fn outputs_that_cannot_be_motion_are_refused() {
    let cases = [
        ("nan", "5280 of 5280 values of output 'nan' are NaN or infinite"),
        ("half", "[1, 3, 22, 30] instead of [1, 2, 44, 60]"),
        ("three", "[3, 44, 60]"),
    ];
    for (output, wanted) in cases {
        let Some(network) = load("broken", &format!("{BLOCKS}[flow]\noutput = '{output}'\n")) else { return };
        let [before, now] = pair(SIZE);
        let message = network.unwrap().motion(&before, &now).unwrap_err().to_string();
        assert!(message.contains(wanted) && message.contains("broken.onnx"), "{message}");
    }
}

#[test]
fn a_file_that_is_no_network_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("text.onnx");
    std::fs::write(&model, "not a network").unwrap();
    let error = Network::load(Description::of(&format!("raft={}", model.display())).unwrap(), 1).unwrap_err();
    if matches!(error, NetworkError::Library(_)) && std::env::var_os("ORT_DYLIB_PATH").is_none() {
        eprintln!("skipped: {error}");
        return;
    }
    assert!(error.to_string().contains("text.onnx"), "{error}");
    assert!(error.fix().contains("ONNX"));
}
