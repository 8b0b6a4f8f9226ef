//! Debian packages the project needs, installed only where they are missing.

use anyhow::{Context, Result, bail, ensure};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Something that must be there, and the Debian package that brings it.
struct Requirement {
    probe: Probe,
    package: &'static str,
}

/// How to tell whether it is.
enum Probe {
    /// A program on the PATH.
    Program(&'static str),
    /// A file with this ending in this folder.
    FileIn(&'static str, &'static str),
    /// A module of Python.
    Module(&'static str),
}

/// Everything beyond the Rust toolchain. Rust needs a C compiler as its linker driver.
const REQUIREMENTS: [Requirement; 1] =
    [Requirement { probe: Probe::Program("cc"), package: "build-essential" }];

/// The GPU tests run on software Vulkan where there is no GPU, those of the videos make some, and those of interruptions
/// send signals. The tools of the checks come in virtual environments, for which Debian's Python lacks a part. A run needs none of them.
const TEST_REQUIREMENTS: [Requirement; 5] = [
    Requirement { probe: Probe::Program("git"), package: "git" },
    Requirement { probe: Probe::Program("kill"), package: "procps" },
    Requirement { probe: Probe::Module("ensurepip"), package: "python3-venv" },
    Requirement { probe: Probe::FileIn("/usr/share/vulkan/icd.d", "json"), package: "mesa-vulkan-drivers" },
    Requirement { probe: Probe::Program("ffmpeg"), package: "ffmpeg" },
];

/// Installs what building and running need and is missing; silent when nothing is.
pub(crate) fn run() -> Result<()> {
    install(&missing(&REQUIREMENTS, is_present))
}

/// As [`run`], and what the tests need.
pub(crate) fn run_for_tests() -> Result<()> {
    let mut packages = missing(&REQUIREMENTS, is_present);
    if cfg!(target_os = "linux") {
        packages.extend(missing(&TEST_REQUIREMENTS, is_present));
    }
    install(&packages)
}

/// Chromium's program; installed where it is missing and can be.
pub(crate) fn chromium() -> Result<PathBuf> {
    const PROGRAM: &str = "chromium";
    if place_of(PROGRAM).is_none() {
        install(&[PROGRAM])?;
    }
    place_of(PROGRAM).context("chromium is installed, but not on the PATH")
}

/// Where a program of the PATH is.
fn place_of(program: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).map(|folder| folder.join(program)).find(|file| file.is_file())
}

fn is_present(probe: &Probe) -> bool {
    match probe {
        Probe::Program(program) => place_of(program).is_some(),
        Probe::FileIn(folder, ending) => std::fs::read_dir(folder)
            .is_ok_and(|files| files.flatten().any(|f| f.path().extension().is_some_and(|e| e == *ending))),
        Probe::Module(module) => succeeds("python3", &["-c", &format!("import {module}")]),
    }
}

/// Installs Debian packages where that is possible, otherwise says how to.
pub(crate) fn install(packages: &[&str]) -> Result<()> {
    if packages.is_empty() {
        return Ok(());
    }
    let list = packages.join(" ");
    if !Path::new("/usr/bin/apt-get").is_file() {
        bail!(
            "missing: {list} (Debian package names). This system has no apt-get: install their like by hand"
        );
    }
    let Some(prefix) = privilege() else {
        bail!("missing: {list}. Install with: sudo apt-get update && sudo apt-get install -y {list}");
    };
    println!("installing: {list}");
    apt_get(prefix, &["update", "--quiet"])?;
    let mut words = vec!["install", "--yes", "--no-install-recommends"];
    words.extend(packages);
    apt_get(prefix, &words)
}

fn missing(requirements: &[Requirement], present: impl Fn(&Probe) -> bool) -> Vec<&'static str> {
    requirements.iter().filter(|r| !present(&r.probe)).map(|r| r.package).collect()
}

/// Words before `apt-get`: none as root, `sudo --non-interactive` where that works, otherwise `None`.
fn privilege() -> Option<&'static [&'static str]> {
    if succeeds("sh", &["-c", "test \"$(id -u)\" = 0"]) {
        Some(&[])
    } else if succeeds("sudo", &["--non-interactive", "true"]) {
        Some(&["sudo", "--non-interactive"])
    } else {
        None
    }
}

fn succeeds(program: &str, args: &[&str]) -> bool {
    let status = Command::new(program).args(args).stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}

fn apt_get(prefix: &[&str], args: &[&str]) -> Result<()> {
    let words: Vec<&str> =
        prefix.iter().copied().chain(["env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]).collect();
    let status =
        Command::new(words[0]).args(&words[1..]).args(args).status().context("cannot start apt-get")?;
    ensure!(status.success(), "apt-get {} failed", args.join(" "));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_missing_is_installed() {
        let program = |name, package| Requirement { probe: Probe::Program(name), package };
        let requirements = [program("there", "a"), program("absent", "b")];
        let there = |probe: &Probe| matches!(probe, Probe::Program("there"));
        assert_eq!(missing(&requirements, there), ["b"]);
        assert!(missing(&requirements, |_| true).is_empty());
    }

    #[test]
    fn files_are_found_by_their_ending() {
        let folder = env!("CARGO_MANIFEST_DIR");
        assert!(is_present(&Probe::FileIn(folder, "toml")));
        assert!(!is_present(&Probe::FileIn(folder, "json")));
        assert!(!is_present(&Probe::FileIn("/nowhere", "json")));
    }
}
