//! Removal of files that may be missing.

use crate::PrepareError;
use std::fs;
use std::path::Path;

/// Removes a file or folder that may be missing.
pub(crate) fn remove(path: &Path) -> Result<(), PrepareError> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(PrepareError::io(path, e)),
        _ => Ok(()),
    }
}
