//! Writing of npz archives whose bytes depend on the arrays alone, so that runs can be compared by checksum.

use crate::ArraysError;
use ffgs_core::write_atomically;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Collects arrays and writes them as one deflated .npz file. The bytes depend on the arrays alone (no time stamp).
#[derive(Debug, Default)]
pub struct NpzWriter {
    entries: Vec<(String, Vec<u8>)>,
}

impl NpzWriter {
    /// A writer without arrays.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an f32 array in C order. Panics when `shape` does not hold `data` (a fault of the caller).
    pub fn f32(&mut self, name: &str, shape: &[usize], data: &[f32]) -> &mut Self {
        self.add(name, "<f4", shape, data, f32::to_le_bytes)
    }

    /// Adds an f64 array in C order; panics as [`NpzWriter::f32`].
    pub fn f64(&mut self, name: &str, shape: &[usize], data: &[f64]) -> &mut Self {
        self.add(name, "<f8", shape, data, f64::to_le_bytes)
    }

    /// Adds an i32 array in C order; panics as [`NpzWriter::f32`].
    pub fn i32(&mut self, name: &str, shape: &[usize], data: &[i32]) -> &mut Self {
        self.add(name, "<i4", shape, data, i32::to_le_bytes)
    }

    /// Adds an i64 array in C order; panics as [`NpzWriter::f32`].
    pub fn i64(&mut self, name: &str, shape: &[usize], data: &[i64]) -> &mut Self {
        self.add(name, "<i8", shape, data, i64::to_le_bytes)
    }

    /// Adds a u8 array in C order; panics as [`NpzWriter::f32`].
    pub fn u8(&mut self, name: &str, shape: &[usize], data: &[u8]) -> &mut Self {
        self.add(name, "|u1", shape, data, u8::to_le_bytes)
    }

    /// Writes the file through a temporary one and a rename.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ArraysError> {
        write_atomically(path, |w| self.write_archive(w))
            .map_err(|e: io::Error| ArraysError::new(path, None, e))
    }

    fn add<T: Copy, const K: usize>(
        &mut self,
        name: &str,
        dtype: &str,
        shape: &[usize],
        data: &[T],
        bytes: impl Fn(T) -> [u8; K],
    ) -> &mut Self {
        assert_eq!(shape.iter().product::<usize>(), data.len(), "shape {shape:?} of array '{name}'");
        let mut npy = header(dtype, shape);
        npy.reserve(data.len() * K);
        for &v in data {
            npy.extend_from_slice(&bytes(v));
        }
        self.entries.push((format!("{name}.npy"), npy));
        self
    }

    fn write_archive(&self, writer: &mut BufWriter<File>) -> io::Result<()> {
        let mut zip = ZipWriter::new(writer);
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
        for (name, npy) in &self.entries {
            zip.start_file(name.as_str(), options.large_file(npy.len() > u32::MAX as usize))?;
            zip.write_all(npy)?;
        }
        zip.finish()?;
        Ok(())
    }
}

/// Version 1.0 header, padded so that the data starts at a multiple of 64 bytes.
fn header(dtype: &str, shape: &[usize]) -> Vec<u8> {
    let axes: Vec<_> = shape.iter().map(ToString::to_string).collect();
    let axes = axes.join(", ") + if shape.len() == 1 { "," } else { "" };
    let mut text = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({axes}), }}");
    let unpadded = 10 + text.len() + 1;
    text.push_str(&" ".repeat(unpadded.next_multiple_of(64) - unpadded));
    text.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend_from_slice(&(text.len() as u16).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
    out
}
