//! Opening of files that others wrote, with limits: a folder, a pipe or an endless file under the expected name is an error.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Opens a file that someone else wrote. A pipe would wait for ever and a device may never end: only files are opened.
///
/// # Errors
/// Those of the system, and anything that is no regular file (after following links).
pub fn open_input(path: &Path) -> io::Result<File> {
    // Looking first, because opening a pipe waits for its other end.
    if !fs::metadata(path)?.is_file() {
        return Err(io::Error::new(ErrorKind::InvalidInput, "not a file (a folder, pipe or device)"));
    }
    File::open(path)
}

/// Whether anything has this name, a regular file or not. What is there and cannot be read (a link that leads nowhere or in
/// a circle, a folder, a pipe) counts as present, so that opening it tells the fault and the file is not taken as missing.
pub fn is_present(path: &Path) -> bool {
    !fs::symlink_metadata(path).is_err_and(|error| error.kind() == ErrorKind::NotFound)
}

/// Refuses a link. Folders come from others too, and what is written through a link of theirs lies where they want it.
///
/// # Errors
/// When the path is a link, wherever it leads.
pub fn refuse_link(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path) {
        Ok(info) if info.is_symlink() => Err(io::Error::new(
            ErrorKind::InvalidInput,
            "a link, through which nothing is written; remove it",
        )),
        _ => Ok(()),
    }
}

/// Reads a file of at most `max_bytes` that someone else wrote.
///
/// # Errors
/// As [`open_input`]; also a longer file.
pub fn read_bytes(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_within(path, max_bytes)?.take(max_bytes).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads a text file of at most `max_bytes` that someone else wrote.
///
/// # Errors
/// As [`open_input`]; also a longer file, and what is not UTF-8.
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    let mut text = String::new();
    open_within(path, max_bytes)?.take(max_bytes).read_to_string(&mut text)?;
    Ok(text)
}

fn open_within(path: &Path, max_bytes: u64) -> io::Result<File> {
    let file = open_input(path)?;
    if file.metadata()?.len() > max_bytes {
        let fault = format!("longer than {max_bytes} bytes");
        return Err(io::Error::new(ErrorKind::FileTooLarge, fault));
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_devices_are_refused_and_files_have_a_longest() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(open_input(folder.path()).unwrap_err().kind(), ErrorKind::InvalidInput);
        let file = folder.path().join("a");
        fs::write(&file, "four").unwrap();
        assert_eq!(read_text(&file, 4).unwrap(), "four");
        assert_eq!(read_text(&file, 3).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read_text(&folder.path().join("b"), 3).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[cfg(unix)]
    #[test]
    fn what_cannot_be_read_is_present() {
        let folder = tempfile::tempdir().unwrap();
        let [file, nowhere, circle] = ["file", "nowhere", "circle"].map(|name| folder.path().join(name));
        assert!(!is_present(&file) && is_present(folder.path()));
        std::os::unix::fs::symlink(&file, &nowhere).unwrap();
        std::os::unix::fs::symlink(&circle, &circle).unwrap();
        assert!(is_present(&nowhere) && is_present(&circle));
        fs::write(&file, "").unwrap();
        assert!(is_present(&file) && is_present(&file.join("below a file")));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_to_a_device_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("zero");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        assert_eq!(open_input(&link).unwrap_err().kind(), ErrorKind::InvalidInput);
    }
}
