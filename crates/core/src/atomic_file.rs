//! Files that are complete or absent: written beside their place, synchronised, and renamed. Resuming relies on it.

use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::Path;

/// Bytes between two calls to the system: splats and states are megabytes.
const BUFFER: usize = 1 << 18;

/// Writes `path` through a temporary file beside it and a rename, so that a reader (or a resumed run) sees the
/// whole file or none, after a power failure too: the file, its name and new folders are on the disk when this returns,
/// where the system can say so. Missing parent folders are created. On an error the temporary file is removed.
///
/// # Errors
/// When the file cannot be written or renamed, or `write` fails; what was there before stays then.
pub fn write_atomically<E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
) -> Result<(), E> {
    let folder = folder_of(path);
    create_folder(folder)?;
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    let temporary = path.with_file_name(name);
    let result = write_and_sync(&temporary, write).and_then(|()| Ok(fs::rename(&temporary, path)?));
    if result.is_err() {
        // The error that matters is the first one; the temporary file may never have been created.
        let _ = fs::remove_file(&temporary);
    }
    result?;
    sync_folder(folder)?;
    Ok(())
}

/// The folder that holds a name.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn create_folder(folder: &Path) -> io::Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    let parent = folder_of(folder);
    create_folder(parent)?;
    match fs::create_dir(folder) {
        Err(_) if folder.is_dir() => Ok(()), // Another thread was faster.
        made => made.and_then(|()| sync_folder(parent)),
    }
}

/// Puts the names in a folder on the disk. Windows has no such call and needs none; elsewhere a folder that may not be read
/// cannot be opened, and some network file systems sync files only.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(windows) {
        return Ok(());
    }
    let cannot = [ErrorKind::PermissionDenied, ErrorKind::InvalidInput, ErrorKind::Unsupported];
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(error) if cannot.contains(&error.kind()) => Ok(()),
        synced => synced,
    }
}

fn write_and_sync<E: From<io::Error>>(
    temporary: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
) -> Result<(), E> {
    let mut writer = BufWriter::with_capacity(BUFFER, File::create(temporary)?);
    write(&mut writer)?;
    writer.flush()?;
    writer.get_ref().sync_data()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_made_as_deep_as_asked_and_by_several_at_once() {
        let folder = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            for name in ["x", "y", "z", "w"] {
                let path = folder.path().join("a/b/c").join(name);
                scope.spawn(move || write_atomically(&path, |w| w.write_all(name.as_bytes())).unwrap());
            }
        });
        assert_eq!(fs::read_dir(folder.path().join("a/b/c")).unwrap().count(), 4);
        assert_eq!(folder_of(Path::new("name")), Path::new("."));
        fs::write(folder.path().join("file"), "").unwrap();
        let inside = folder.path().join("file/inside");
        assert!(write_atomically(&inside, |w| w.write_all(b"")).is_err(), "a file is no folder");
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_temporary() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sub/x.bin");
        write_atomically(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |w| {
            w.write_all(b"half")?;
            Err(io::Error::other("stop"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }
}
