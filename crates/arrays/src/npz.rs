//! Archives of arrays (npz): the directory is read at once, each array when it is asked for.

use crate::npy::{Accepted, MAX_BYTES, read_array};
use crate::{Array, ArraysError, Cause, Element};
use ffgs_core::open_input;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use zip::ZipArchive;
use zip::result::ZipError;

/// Names of arrays that a message lists, and characters of each: a damaged archive may hold thousands.
const NAMES_TOLD: usize = 12;
const LETTERS_TOLD: usize = 40;

/// An open .npz file (a zip archive of npy arrays, stored or deflated).
#[derive(Debug)]
pub struct NpzFile {
    path: PathBuf,
    names: Vec<String>,
    max_bytes: usize,
    archive: Mutex<ZipArchive<BufReader<File>>>,
}

impl NpzFile {
    /// Opens the file and reads its directory; no array is read yet.
    ///
    /// # Errors
    /// When the file cannot be read or is no archive.
    pub fn open(path: &Path) -> Result<Self, ArraysError> {
        Self::open_within(path, MAX_BYTES)
    }

    /// As [`NpzFile::open`], refusing arrays whose header claims more than `max_bytes` before they are unpacked.
    ///
    /// # Errors
    /// As [`NpzFile::open`], or when the archive is larger than `max_bytes` unpacked.
    pub fn open_within(path: &Path, max_bytes: usize) -> Result<Self, ArraysError> {
        let open = || -> Result<_, Cause> {
            let file = BufReader::new(open_input(path)?);
            ZipArchive::new(file).map_err(archive_cause)
        };
        let archive = open().map_err(|cause| ArraysError::new(path, None, cause))?;
        let mut names: Vec<_> = archive.file_names().filter_map(|n| array_name(&n.ok()?)).collect();
        names.sort();
        Ok(Self { path: path.to_owned(), names, max_bytes, archive: Mutex::new(archive) })
    }

    /// Names of the arrays, sorted.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Whether there is an array of that name.
    pub fn has(&self, name: &str) -> bool {
        self.names.binary_search_by(|n| n.as_str().cmp(name)).is_ok()
    }

    /// The file's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads an array as `T` from whatever numeric dtype it has.
    ///
    /// # Errors
    /// When the array is missing or damaged, or of no type that converts to `T`.
    pub fn read<T: Element>(&self, name: &str) -> Result<Array<T>, ArraysError> {
        self.entry(name, Accepted { shape: None, bytes: self.max_bytes })
    }

    /// As [`NpzFile::read`]; any other shape is refused from the header, before the entries are unpacked. `None` stands
    /// for any length of that axis.
    ///
    /// # Errors
    /// As [`NpzFile::read`], or when the shape is another.
    pub fn shaped<T: Element>(&self, name: &str, shape: &[Option<usize>]) -> Result<Array<T>, ArraysError> {
        self.entry(name, Accepted { shape: Some(shape), bytes: self.max_bytes })
    }

    /// Reads an array as f32.
    ///
    /// # Errors
    /// As [`NpzFile::read`].
    pub fn f32(&self, name: &str) -> Result<Array<f32>, ArraysError> {
        self.read(name)
    }

    /// Reads an array as f64.
    ///
    /// # Errors
    /// As [`NpzFile::read`].
    pub fn f64(&self, name: &str) -> Result<Array<f64>, ArraysError> {
        self.read(name)
    }

    /// Reads an array of whole numbers as i64.
    ///
    /// # Errors
    /// As [`NpzFile::read`].
    pub fn i64(&self, name: &str) -> Result<Array<i64>, ArraysError> {
        self.read(name)
    }

    /// Reads an array of whole numbers in 0..=255, or of bool (0 or 1), as u8.
    ///
    /// # Errors
    /// As [`NpzFile::read`].
    pub fn u8(&self, name: &str) -> Result<Array<u8>, ArraysError> {
        self.read(name)
    }

    fn entry<T: Element>(&self, name: &str, accepted: Accepted) -> Result<Array<T>, ArraysError> {
        let (shape, data) =
            self.unpack(name, accepted).map_err(|cause| ArraysError::new(&self.path, Some(name), cause))?;
        Ok(Array::new(shape, data, &self.path, Some(name)))
    }

    fn unpack<T: Element>(&self, name: &str, accepted: Accepted) -> Result<(Vec<usize>, Vec<T>), Cause> {
        if !self.has(name) {
            return Err(Cause::MissingKey(told(&self.names)));
        }
        // A panic while reading leaves nothing half-changed: the next read seeks anew.
        let mut archive = self.archive.lock().unwrap_or_else(PoisonError::into_inner);
        let mut entry = archive.by_name(&format!("{name}.npy")).map_err(archive_cause)?;
        read_array(&mut entry, accepted)
    }
}

fn array_name(file_name: &str) -> Option<String> {
    file_name.strip_suffix(".npy").map(str::to_owned)
}

fn told(names: &[String]) -> Vec<String> {
    names.iter().take(NAMES_TOLD).map(|name| name.chars().take(LETTERS_TOLD).collect()).collect()
}

fn archive_cause(error: ZipError) -> Cause {
    match error {
        ZipError::Io(e) => Cause::Io(e),
        other => Cause::Archive(other.to_string()),
    }
}
