//! The error of a plug-in that reads or writes files: which file, what is wrong, what to do.

use std::fmt;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A file that cannot be used, why, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{}: {problem}\n  fix: {fix}", .file.display())]
pub struct Fault {
    /// The file or folder at fault.
    pub file: PathBuf,
    /// What is wrong; does not repeat the file.
    pub problem: String,
    /// What the user can do.
    pub fix: String,
}

impl Fault {
    /// A fault of `file`. A problem that begins with the file's name is shortened: the name is printed in front.
    pub fn new(file: &Path, problem: impl fmt::Display, fix: impl Into<String>) -> Self {
        let text = problem.to_string();
        let problem = text.strip_prefix(&format!("{}: ", file.display())).map_or(text.clone(), str::to_owned);
        Self { file: file.to_owned(), problem, fix: fix.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_named_once() {
        let fault = Fault::new(Path::new("a/b.png"), "a/b.png: truncated", "copy it again");
        assert_eq!(fault.to_string(), "a/b.png: truncated\n  fix: copy it again");
    }
}
