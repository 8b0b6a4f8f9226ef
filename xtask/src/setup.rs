//! Debian packages the project needs, installed only where they are missing.

use anyhow::{Context, Result, bail, ensure};
use std::path::Path;
use std::process::{Command, Stdio};

/// A program on the PATH and the Debian package that brings it.
struct Requirement {
    program: &'static str,
    package: &'static str,
}

/// Everything beyond the Rust toolchain. Rust needs a C compiler as its linker driver.
const REQUIREMENTS: [Requirement; 1] = [Requirement { program: "cc", package: "build-essential" }];

/// Installs what is missing; silent when nothing is.
pub fn run() -> Result<()> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<_> = std::env::split_paths(&path).collect();
    install(&missing(&REQUIREMENTS, |program| folders.iter().any(|f| f.join(program).is_file())))
}

/// Installs Debian packages where that is possible, otherwise says how to.
pub fn install(packages: &[&str]) -> Result<()> {
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

fn missing(requirements: &[Requirement], present: impl Fn(&str) -> bool) -> Vec<&'static str> {
    requirements.iter().filter(|r| !present(r.program)).map(|r| r.package).collect()
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
        let requirements =
            [Requirement { program: "there", package: "a" }, Requirement { program: "absent", package: "b" }];
        assert_eq!(missing(&requirements, |program| program == "there"), ["b"]);
        assert!(missing(&requirements, |_| true).is_empty());
    }
}
