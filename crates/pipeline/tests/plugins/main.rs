//! Everything that is registered keeps the contract, and so does a method that is added here as anyone would add one.

mod captures;
mod constant_velocity;

use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, Image, WritableImage};
use ffgs_arrays::NpzWriter;
use ffgs_core::ImageSize;
use ffgs_method::{Plugin, Registry};
use ffgs_pipeline::plugins::method::{Method, MethodContext};
use ffgs_pipeline::plugins::registry::{CAPTURES, METHODS};
use ffgs_pipeline::settings::config::Config;
use ffgs_testkit::conformance::{Sample, capture_format, motion_method, splat_writer, track_format};
use std::path::Path;
use std::sync::LazyLock;

/// What is added beside the program's own methods: a file and this line.
const ADDED: Registry<Method> = Registry { kind: "method", items: &[&constant_velocity::METHOD] };

static DEFAULT: LazyLock<Config> = LazyLock::new(Config::default);
static LITERAL: LazyLock<Config> = LazyLock::new(Config::literal);

fn conforms(method: &Method, config: &'static Config) {
    // The name of the tracker of the suite's world.
    let argument = if method.usage.contains(':') { "exact" } else { "" };
    motion_method(method.name(), &|tracks| {
        (method.build)(&MethodContext { config, tracks, gpu: None }, argument).unwrap()
    });
}

#[test]
fn every_method_conforms() {
    for method in METHODS.items.iter().chain(ADDED.items) {
        conforms(method, &DEFAULT);
    }
}

#[test]
fn the_literal_method_conforms() {
    conforms(METHODS.items[0], &LITERAL);
}

/// A sound file of a track format. A format that is added needs one here.
fn sample(format: &str) -> Sample {
    const SIZE: ImageSize = ImageSize { width: 4, height: 3 };
    let values: Vec<f32> = (0..24).map(|i| i as f32 / 8.0).collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("sample");
    let written = |write: &dyn Fn(&Path)| {
        write(&file);
        std::fs::read(&file).unwrap()
    };
    let bytes = match format {
        "npz" => written(&|file| {
            NpzWriter::new().f32("src", &[12, 2], &values).f32("tgt", &[12, 2], &values).write(file).unwrap();
        }),
        "npy" => {
            let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4, 2), }\n";
            let head =
                [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes()];
            [head.concat(), values.iter().flat_map(|v| v.to_le_bytes()).collect()].concat()
        }
        "flo" => {
            let head = [b"PIEH".as_slice(), &4_i32.to_le_bytes(), &3_i32.to_le_bytes()].concat();
            [head, values.iter().flat_map(|v| v.to_le_bytes()).collect()].concat()
        }
        "exr" => written(&|file| {
            let channel = |name| AnyChannel::new(name, FlatSamples::F32(values[..12].to_vec()));
            let channels = AnyChannels::sort(vec![channel("U"), channel("V")].into());
            Image::from_channels((4, 3), channels).write().to_file(file).unwrap();
        }),
        other => panic!("no sample of the track format {other}: add one"),
    };
    Sample { bytes, size: SIZE }
}

#[test]
fn every_track_format_conforms() {
    for format in ffgs_tracks::FORMATS.items {
        track_format(*format, &sample(format.name()));
    }
}

#[test]
fn every_splat_writer_conforms() {
    ffgs_splats::FORMATS.items.iter().for_each(|format| splat_writer(*format));
}

#[test]
fn every_capture_format_conforms() {
    for format in CAPTURES.items {
        let folder = tempfile::tempdir().unwrap();
        captures::write(format.name(), folder.path());
        capture_format(*format, folder.path());
    }
}
