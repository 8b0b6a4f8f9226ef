//! Programs of the Python package index, in virtual environments of their own below the target folder.

use crate::workspace;
use anyhow::{Context, Result, ensure};
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The folder of the environment `name`, into which `packages` are installed.
pub(crate) fn with(root: &Path, name: &str, packages: &[&str]) -> Result<PathBuf> {
    let folder = workspace::target(root).join(format!("{name}-venv"));
    captured(Command::new("python3").args(["-m", "venv"]).arg(&folder))?;
    captured(
        Command::new(folder.join("bin/python")).args(["-m", "pip", "install", "--quiet"]).args(packages),
    )?;
    Ok(folder)
}

/// Runs a command; both its streams, in the order written, as the value or inside the error.
pub(crate) fn captured(command: &mut Command) -> Result<String> {
    let mut log: File = tempfile::tempfile().context("cannot make a temporary file")?;
    let status = command
        .stdout(log.try_clone()?)
        .stderr(log.try_clone()?)
        .status()
        .with_context(|| format!("cannot start {}", command.get_program().display()))?;
    let mut bytes = Vec::new();
    log.seek(SeekFrom::Start(0))?;
    log.read_to_end(&mut bytes)?;
    let output = String::from_utf8_lossy(&bytes).into_owned();
    ensure!(status.success(), "{output}\n{command:?}: {status}");
    Ok(output)
}
