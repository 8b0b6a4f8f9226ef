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

/// Reads a text file of at most `max_bytes` that someone else wrote.
///
/// # Errors
/// As [`open_input`]; also a longer file, and what is not UTF-8.
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    let file = open_input(path)?;
    if file.metadata()?.len() > max_bytes {
        let fault = format!("longer than {max_bytes} bytes");
        return Err(io::Error::new(ErrorKind::FileTooLarge, fault));
    }
    let mut text = String::new();
    file.take(max_bytes).read_to_string(&mut text)?;
    Ok(text)
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
    fn a_link_to_a_device_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("zero");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        assert_eq!(open_input(&link).unwrap_err().kind(), ErrorKind::InvalidInput);
    }
}
