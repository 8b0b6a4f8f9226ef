//! The conformance stream under fixtures/reference/stream: any decoder must find its fingerprints.

use ffgs_stream::Reader;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/reference/stream")
}

fn expected() -> Vec<[u32; 2]> {
    serde_json::from_str(&std::fs::read_to_string(folder().join("expected.json")).unwrap()).unwrap()
}

fn check(reader: &mut Reader, at: usize) {
    let frame = reader.entries()[at].frame;
    reader.read(frame).unwrap();
    assert_eq!(reader.fingerprint(), Some(expected()[at]), "frame {frame}");
}

#[test]
fn the_reference_decoder_finds_the_fingerprints_in_order_and_at_random() {
    let mut reader = Reader::open(&folder()).unwrap();
    assert_eq!(reader.entries().len(), expected().len());
    (0..expected().len()).for_each(|at| check(&mut reader, at));
    [5, 1, 6, 0, 3].into_iter().for_each(|at| check(&mut reader, at));
    (0..expected().len()).for_each(|at| check(&mut Reader::open(&folder()).unwrap(), at));
}

#[test]
fn the_stream_has_every_kind_of_section() {
    let reader = Reader::open(&folder()).unwrap();
    let mut kinds: Vec<&String> = reader.entries().iter().flat_map(|e| e.sections.keys()).collect();
    kinds.sort();
    kinds.dedup();
    let still = ["StaticColours", "StaticKey", "StaticRows"];
    assert_eq!(kinds, [&["DynamicChange", "DynamicKey", "Sky"], &still[..], &["Uncertainty"]].concat());
}
