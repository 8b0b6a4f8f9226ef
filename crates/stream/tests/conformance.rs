//! The conformance streams under fixtures/reference, of the version that is written and of the one before: any decoder must find
//! their fingerprints.

use ffgs_stream::Reader;
use std::path::{Path, PathBuf};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/reference").join(name)
}

fn check(reader: &mut Reader, expected: &[[u32; 2]], at: usize) {
    let frame = reader.entries()[at].frame;
    reader.read(frame).unwrap();
    assert_eq!(reader.fingerprint(), Some(expected[at]), "frame {frame}");
}

fn check_all(folder: &Path) {
    let text = std::fs::read_to_string(folder.join("expected.json")).unwrap();
    let expected: Vec<[u32; 2]> = serde_json::from_str(&text).unwrap();
    let mut reader = Reader::open(folder).unwrap();
    assert_eq!(reader.entries().len(), expected.len());
    (0..expected.len()).for_each(|at| check(&mut reader, &expected, at));
    [5, 1, 6, 0, 3].into_iter().for_each(|at| check(&mut reader, &expected, at));
    (0..expected.len()).for_each(|at| check(&mut Reader::open(folder).unwrap(), &expected, at));
}

#[test]
fn the_reference_decoder_finds_the_fingerprints_in_order_and_at_random() {
    check_all(&folder("stream"));
}

#[test]
fn streams_of_version_2_are_read_as_before() {
    check_all(&folder("stream-2"));
}

#[test]
fn the_stream_has_every_kind_of_section() {
    let reader = Reader::open(&folder("stream")).unwrap();
    let mut kinds: Vec<&String> = reader.entries().iter().flat_map(|e| e.sections.keys()).collect();
    kinds.sort();
    kinds.dedup();
    let still = ["StaticColours", "StaticKey", "StaticRows"];
    assert_eq!(kinds, [&["DynamicChange", "DynamicKey", "Sky"], &still[..], &["Uncertainty"]].concat());
}
