//! Other people's programs from npm: a reader of splat files that judges ours, the engine of our page, and what drives a browser.

use crate::workspace;
use anyhow::{Context, Result, bail, ensure};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Versions of node below this cannot run the reader.
const LEAST_NODE: u32 = 20;
/// Which packages, in which versions.
const PACKAGES: [&str; 2] = ["package.json", "package-lock.json"];
/// The engine of our page, below the folder that [`install`] returns.
pub(crate) const ENGINE: &str = "node_modules/playcanvas/build/playcanvas.min.mjs";
const READER: &str = "node_modules/@playcanvas/splat-transform/bin/cli.mjs";

/// Installs splat-transform, the PlayCanvas engine and playwright-core below the target folder, once per version; returns where.
pub(crate) fn install(root: &Path) -> Result<PathBuf> {
    let (source, home) = (root.join("xtask/players"), workspace::target(root).join("players"));
    let stamp = home.join("installed.json");
    let lock = std::fs::read(source.join(PACKAGES[1]))?;
    if std::fs::read(&stamp).ok().as_ref() == Some(&lock) {
        return Ok(home);
    }
    require_node()?;
    std::fs::create_dir_all(&home)?;
    for file in PACKAGES {
        std::fs::copy(source.join(file), home.join(file))?;
    }
    // No install script of a package runs, and its optional GPU module is not needed.
    let words = ["ci", "--ignore-scripts", "--omit=optional", "--no-audit", "--no-fund"];
    let output = Command::new("npm").args(words).current_dir(&home).output().context("cannot start npm")?;
    ensure!(output.status.success(), "npm ci: {}", String::from_utf8_lossy(&output.stderr));
    std::fs::write(&stamp, &lock)?;
    Ok(home)
}

/// The variable that the tests of `splats` look for, and its value.
pub(crate) fn judge(root: &Path) -> Result<(&'static str, OsString)> {
    require_node()?;
    Ok(("FFGS_SPLAT_TRANSFORM", install(root)?.join(READER).into_os_string()))
}

fn require_node() -> Result<()> {
    let output = Command::new("node").arg("--version").output();
    let text = output.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned()).unwrap_or_default();
    match major(&text) {
        Some(version) if version >= LEAST_NODE => Ok(()),
        Some(_) => bail!("node {text} is too old: version {LEAST_NODE} or newer, with npm, is needed"),
        None => bail!("no node: version {LEAST_NODE} or newer, with npm (Debian packages nodejs, npm)"),
    }
}

/// The first number of `v20.11.1`.
fn major(version: &str) -> Option<u32> {
    version.strip_prefix('v')?.split('.').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_major_version_is_read() {
        assert_eq!(
            (major("v20.11.1"), major("v9.0.0"), major(""), major("20")),
            (Some(20), Some(9), None, None)
        );
    }
}
