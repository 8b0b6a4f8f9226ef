//! An ffmpeg that has libvmaf, which Debian's has not: from the Python package imageio-ffmpeg, for `ffgs eval`.

use crate::workspace;
use anyhow::{Context, Result, ensure};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The variable in which `ffgs eval` looks for it.
pub(crate) const VARIABLE: &str = "FFGS_FFMPEG";
const PACKAGE: &str = "imageio-ffmpeg==0.8.1";
const PRINT_PATH: &str = "import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())";

/// Where the installed program's path is noted.
fn note(root: &Path) -> PathBuf {
    workspace::target(root).join("vmaf").join(PACKAGE)
}

/// The installed program; `None` where it is not installed.
pub(crate) fn installed(root: &Path) -> Option<PathBuf> {
    let program = PathBuf::from(std::fs::read_to_string(note(root)).ok()?.trim());
    program.is_file().then_some(program)
}

/// Installs it in a virtual environment below the target folder, once per version.
pub(crate) fn install(root: &Path) -> Result<()> {
    if installed(root).is_some() {
        return Ok(());
    }
    let note = note(root);
    let folder = note.parent().context("a note in a folder")?;
    println!("installing: {PACKAGE} (an ffmpeg with libvmaf) in {}", folder.display());
    said(Command::new("python3").args(["-m", "venv", "--clear"]).arg(folder))?;
    let python = folder.join("bin/python");
    let words = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:"];
    said(Command::new(&python).args(words).arg(PACKAGE))?;
    let path = said(Command::new(&python).args(["-c", PRINT_PATH]))?;
    std::fs::write(&note, path).with_context(|| format!("cannot write {}", note.display()))
}

/// What a program prints.
fn said(command: &mut Command) -> Result<String> {
    let output = command.output().with_context(|| format!("cannot start {command:?}"))?;
    ensure!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr).trim());
    String::from_utf8(output.stdout).context("no text")
}
