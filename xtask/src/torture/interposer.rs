//! The library of `interposer.c` between the program and the system: it fails or kills at a chosen call, stops the clock and
//! tells what a run took.

use anyhow::{Context, Result, bail, ensure};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What befalls the program at one of its calls.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Strike {
    /// `rename`, `sync`, `write`, `open` (of a new file) or `read`.
    pub call: &'static str,
    /// Which of these calls, from 1.
    pub at: u64,
    /// The error that it fails with; 0 = the program is killed.
    pub errno: i32,
    /// Whether all later ones fail too.
    pub lasting: bool,
}

/// Calls by their names, and `peak`: the most memory that was held (KiB).
pub(crate) type CallCounts = BTreeMap<String, u64>;

/// The compiled library.
pub(crate) struct Interposer(PathBuf);

impl Interposer {
    /// Compiles the library into a folder.
    ///
    /// # Errors
    /// The reason why this cannot be had here.
    pub(crate) fn build(folder: &Path) -> Result<Self> {
        if !cfg!(target_os = "linux") {
            bail!("it is for Linux");
        }
        let (source, library) = (folder.join("interposer.c"), folder.join("interposer.so"));
        fs::write(&source, include_str!("interposer.c"))?;
        let mut compiler = Command::new("cc");
        compiler.args(["-O1", "-shared", "-fPIC", "-o"]).arg(&library).arg(&source).arg("-ldl");
        let output = compiler.output().context("no C compiler `cc`")?;
        ensure!(output.status.success(), "cc: {}", String::from_utf8_lossy(&output.stderr));
        Ok(Self(library))
    }

    /// Puts the library under a program that is started through a shell (which exports its name as `LD_PRELOAD`), and stops
    /// its clock.
    pub(crate) fn put_under(&self, command: &mut Command, report: &Path) {
        command.env("TORTURE_LIBRARY", &self.0).env("TORTURE_REPORT", report).env("TORTURE_CLOCK", "1");
    }
}

impl Strike {
    /// Lets it befall a program that has the library under it.
    pub(crate) fn befall(&self, command: &mut Command) {
        let numbers = [("TORTURE_HOW", self.errno.to_string()), ("TORTURE_AT", self.at.to_string())];
        command.env("TORTURE_CALL", self.call).envs(numbers);
        command.env("TORTURE_LASTING", if self.lasting { "1" } else { "0" });
    }
}

/// What the library wrote at the end of a program that was not killed.
pub(crate) fn call_counts(report: &Path) -> CallCounts {
    let text = fs::read_to_string(report).unwrap_or_default();
    let number =
        |line: &str| line.split_once(' ').and_then(|(name, n)| Some((name.to_owned(), n.parse().ok()?)));
    text.lines().filter_map(number).collect()
}
