//! Reading what numpy writes, refusing what it does not.

use ffgs_arrays::{Array, ArraysError, Cause, Element, NpzFile, NpzWriter, read_npy};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn npy(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let text = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend_from_slice(&(text.len() as u16).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
    out.extend_from_slice(data);
    out
}

fn file(bytes: &[u8]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    fs::write(&path, bytes).unwrap();
    (folder, path)
}

/// Any vector of up to 4 GB.
fn read<T: Element>(path: &Path) -> Result<Array<T>, ArraysError> {
    read_npy(path, &[None], 4 << 30)
}

fn values(descr: &str, data: &[u8]) -> Vec<f64> {
    let (_folder, path) = file(&npy(descr, "False", "(2,)", data));
    read_npy(&path, &[None], 1 << 10).unwrap().data
}

#[test]
fn every_numeric_dtype_and_byte_order_converts() {
    assert_eq!(values("<f2", &[0x00, 0x3e, 0x00, 0xc0]), [1.5, -2.0]);
    assert_eq!(values(">f4", &[0x3f, 0xc0, 0, 0, 0xc0, 0, 0, 0]), [1.5, -2.0]);
    assert_eq!(values("<i2", &[1, 0, 0xff, 0xff]), [1.0, -1.0]);
    assert_eq!(values(">i2", &[0, 1, 0xff, 0xff]), [1.0, -1.0]);
    assert_eq!(values("|i1", &[1, 0xff]), [1.0, -1.0]);
    assert_eq!(values("|u1", &[1, 0xff]), [1.0, 255.0]);
    assert_eq!(values("|b1", &[1, 0]), [1.0, 0.0]);
    assert_eq!(values("<u8", &[1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]), [1.0, 256.0]);
    assert_eq!(values("<i8", &[&[1, 0, 0, 0, 0, 0, 0, 0][..], &[0xff; 8]].concat()), [1.0, -1.0]);
}

#[test]
fn fortran_order_becomes_c_order() {
    let (_folder, path) = file(&npy("|u1", "True", "(2, 3)", &[1, 4, 2, 5, 3, 6]));
    let array = read_npy::<u8>(&path, &[None, Some(3)], 1 << 10).unwrap();
    assert_eq!((array.shape, array.data), (vec![2, 3], vec![1, 2, 3, 4, 5, 6]));
}

#[test]
fn a_hostile_shape_is_refused_without_allocating() {
    let huge = "(4294967296, 4294967296, 4294967296)";
    let (_folder, path) = file(&npy("<f8", "False", huge, &[0; 8]));
    assert!(matches!(read_npy::<f64>(&path, &[None; 3], 1 << 20).unwrap_err().cause, Cause::TooLarge(_)));
    let (_folder, path) = file(&npy("<f8", "False", "(1099511627776,)", &[0; 8]));
    assert!(matches!(read::<f64>(&path).unwrap_err().cause, Cause::TooLarge(_)));
    let (_folder, path) = file(&npy("<f8", "False", "(500000000,)", &[0; 8]));
    assert!(matches!(read::<f64>(&path).unwrap_err().cause, Cause::Truncated { found: 8, .. }));
}

#[test]
fn an_array_that_is_too_large_or_of_another_shape_is_refused_from_its_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bomb.npz");
    NpzWriter::new().u8("data", &[1 << 20, 7], &vec![0; 7 << 20]).write(&path).unwrap();
    let packed = fs::metadata(&path).unwrap().len();
    assert!(packed < 20_000, "{packed} bytes pretend to be {}", 7 << 20);
    // As f64 the bytes take eight times their room.
    let npz = NpzFile::open_within(&path, 8 << 20).unwrap();
    assert!(matches!(npz.f64("data").unwrap_err().cause, Cause::TooLarge(_)));
    assert_eq!(npz.u8("data").unwrap().data.len(), 7 << 20);
    // The entries are cut off, which is not noticed: they are not looked at.
    let damaged: Vec<u8> = npy("<f4", "False", "(4, 3)", &[0; 8]);
    let (_folder, path) = file(&damaged);
    let refused = |shape: &[Option<usize>]| read_npy::<f32>(&path, shape, 1 << 20).unwrap_err().cause;
    assert!(matches!(refused(&[None, Some(2)]), Cause::Shape { .. }));
    assert!(matches!(refused(&[None, Some(3)]), Cause::Truncated { .. }));
}

#[test]
fn a_missing_array_is_told_with_a_few_of_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("many.npz");
    let names: Vec<String> = (0..40).map(|i| format!("{i:03}{}", "x".repeat(500))).collect();
    let mut writer = NpzWriter::new();
    for name in &names {
        writer.u8(name, &[1], &[0]);
    }
    writer.write(&path).unwrap();
    let error = NpzFile::open(&path).unwrap().u8("data").unwrap_err().to_string();
    assert!(error.contains("'data': missing; the file holds [\"000xx") && error.len() < 1000, "{error}");
}

#[test]
fn blocks_join_without_a_seam() {
    let data: Vec<f64> = (0..20_000).map(f64::from).collect();
    let bytes: Vec<u8> = data.iter().flat_map(|v| v.to_be_bytes()).collect();
    let (_folder, path) = file(&npy(">f8", "False", "(20000,)", &bytes));
    assert_eq!(read::<f64>(&path).unwrap().data, data);
    let mut fraction = bytes;
    fraction[8 * 15_000..8 * 15_001].copy_from_slice(&0.5_f64.to_be_bytes());
    let (_folder, path) = file(&npy(">f8", "False", "(20000,)", &fraction));
    let error = read::<i64>(&path).unwrap_err();
    assert!(matches!(error.cause, Cause::Value { index: 15_000, .. }), "{error}");
}

#[test]
fn what_is_not_a_numeric_npy_is_refused() {
    for (descr, shape) in [("<U5", "(1,)"), ("|O", "(1,)"), ("<c8", "(1,)"), ("<f3", "(1,)")] {
        let (_folder, path) = file(&npy(descr, "False", shape, &[0; 64]));
        assert!(matches!(read::<f32>(&path).unwrap_err().cause, Cause::Dtype(_)), "{descr}");
    }
    for bytes in [
        &b"\x93NUM"[..],
        b"PK\x03\x04 and more",
        b"\x93NUMPY\x02\x00\xff\xff\xff\xff",
        b"\x93NUMPY\x01\x00\x10\x00{",
    ] {
        let (_folder, path) = file(bytes);
        assert!(matches!(read::<f32>(&path).unwrap_err().cause, Cause::Header(_)));
    }
}

#[test]
fn integers_refuse_fractions_and_overflow() {
    let (_folder, path) = file(&npy("<f2", "False", "(2,)", &[0x00, 0x3c, 0x00, 0x3e]));
    let error = read::<i64>(&path).unwrap_err();
    assert!(matches!(error.cause, Cause::Value { index: 1, .. }), "{error}");
    let (_folder, path) = file(&npy("<i2", "False", "(1,)", &[0, 1]));
    assert!(read::<u8>(&path).is_err());
}

#[test]
fn what_is_written_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sub/x.npz");
    let mut writer = NpzWriter::new();
    writer.f32("a", &[2, 2], &[1.0, f32::NAN, 3.0, 4.0]).f64("b", &[], &[2.5]).u8("m", &[0, 3], &[]);
    writer.i32("i", &[2], &[-7, 7]).write(&path).unwrap();
    let npz = NpzFile::open(&path).unwrap();
    assert_eq!(npz.names(), ["a", "b", "i", "m"]);
    assert!(npz.f32("a").unwrap().data[1].is_nan());
    assert_eq!(npz.f32("b").unwrap().scalar().unwrap(), 2.5);
    assert_eq!(npz.i64("i").unwrap().data, [-7, 7]);
    assert_eq!(npz.u8("m").unwrap().shape, [0, 3]);
}

#[test]
fn errors_name_file_key_and_shapes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.npz");
    NpzWriter::new().f32("tgt", &[3], &[0.0; 3]).write(&path).unwrap();
    let npz = NpzFile::open(&path).unwrap();
    let missing = npz.f32("src").unwrap_err().to_string();
    assert!(missing.contains("x.npz, array 'src'") && missing.contains("tgt"), "{missing}");
    let shape = npz.shaped::<f32>("tgt", &[None, Some(2)]).unwrap_err().to_string();
    assert!(shape.contains("expected shape (*, 2), found [3]"), "{shape}");
    assert!(npz.f32("tgt").unwrap().scalar().is_err());
}

#[test]
fn every_truncation_of_an_archive_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.npz");
    let data: Vec<f32> = (0..50).map(|v| (v as f32).sin()).collect();
    NpzWriter::new().f32("a", &[50], &data).write(&path).unwrap();
    let bytes = fs::read(&path).unwrap();
    for length in 0..bytes.len() {
        fs::write(&path, &bytes[..length]).unwrap();
        assert!(NpzFile::open(&path).and_then(|npz| npz.f32("a")).is_err(), "{length}");
    }
}

#[test]
fn a_flipped_byte_never_panics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.npz");
    NpzWriter::new().f32("a", &[4], &[1.0, 2.0, 3.0, 4.0]).write(&path).unwrap();
    let bytes = fs::read(&path).unwrap();
    for i in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[i] ^= 0xff;
        fs::write(&path, &damaged).unwrap();
        let _ = NpzFile::open(&path).and_then(|npz| npz.f32("a"));
    }
}
