//! What a server offers: paths, and where their bytes come from.

use std::fmt;
use std::fs::File;
use std::io::{Cursor, Read, Seek};
use std::path::{Path, PathBuf};

/// What is served, by the first part of its path.
#[derive(Default)]
pub struct Site {
    mounts: Vec<(String, Source)>,
}

/// Finds the file of a path below a prefix.
pub type Find = Box<dyn Fn(&str) -> Option<PathBuf> + Send + Sync>;

/// Where the bytes of a path come from.
pub enum Source {
    /// Exactly this path.
    Bytes(Vec<u8>),
    /// Files directly in a folder or below it.
    Folder(PathBuf),
    /// Files that a function names; what it does not know is not found.
    Lookup(Find),
}

impl fmt::Debug for Site {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.mounts.iter().map(|(prefix, _)| prefix)).finish()
    }
}

/// Bytes that can be read from any place.
pub(crate) trait Content: Read + Seek + Send {}

impl<T: Read + Seek + Send> Content for T {}

impl Site {
    /// Serves `source` at a path (bytes) or below it (the others); an empty path is the root. Earlier ones win.
    #[must_use]
    pub fn with(mut self, path: &str, source: Source) -> Self {
        self.mounts.push((path.to_owned(), source));
        self
    }

    /// Opens what a path names, and says how long it is.
    pub(crate) fn open(&self, path: &str) -> Option<(Box<dyn Content>, u64)> {
        self.mounts.iter().find_map(|(prefix, source)| match source {
            Source::Bytes(bytes) => {
                (path == prefix).then(|| (Box::new(Cursor::new(bytes.clone())) as _, bytes.len() as u64))
            }
            Source::Folder(folder) => open_file(&inside(folder, below(path, prefix)?)?),
            Source::Lookup(find) => open_file(&find(below(path, prefix)?)?),
        })
    }
}

/// What follows a prefix that ends with a whole part of the path.
fn below<'a>(path: &'a str, prefix: &str) -> Option<&'a str> {
    if prefix.is_empty() { Some(path) } else { path.strip_prefix(prefix)?.strip_prefix('/') }
}

/// A file below a folder. Parts with other characters than those of our own names, hidden files and links that lead out are not found.
fn inside(folder: &Path, path: &str) -> Option<PathBuf> {
    let plain = |part: &str| {
        let known = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        !part.is_empty() && !part.starts_with('.') && part.chars().all(known)
    };
    if !path.split('/').all(plain) {
        return None;
    }
    let (folder, file) = (folder.canonicalize().ok()?, folder.join(path).canonicalize().ok()?);
    file.starts_with(folder).then_some(file)
}

fn open_file(path: &Path) -> Option<(Box<dyn Content>, u64)> {
    let file = File::open(path).ok()?;
    let found = file.metadata().ok()?;
    found.is_file().then(|| (Box::new(file) as _, found.len()))
}
