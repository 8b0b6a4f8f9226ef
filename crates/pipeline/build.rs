//! Names the commit that is built, and what differs from it, for `--version` and run.json.

use std::collections::hash_map::DefaultHasher;
use std::hash::Hasher;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Crates that the program does not consist of: they stand above it or belong to tests.
const OTHERS: [&str; 4] = ["lab", "motion-eval", "simulator", "testkit"];
/// What of a crate is compiled into the program.
const PARTS: [&str; 5] = ["src", "shaders", "templates", "web", "CONFIGURATION.md"];

fn main() {
    let version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let sources = sources(Path::new("../.."));
    let named = git(&["rev-parse", "--short=12", "HEAD"])
        .map_or(version.clone(), |commit| format!("{version} ({commit}{})", changes(&sources)));
    println!("cargo:rustc-env=FFGS_VERSION={named}");
    // The log changes with every commit and checkout. Outside a repository there is nothing to watch.
    match git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        Some(log) => {
            println!("cargo:rerun-if-changed={log}");
            sources.iter().for_each(|path| println!("cargo:rerun-if-changed={}", path.display()));
        }
        None => println!("cargo:rerun-if-changed=build.rs"),
    }
}

/// What the program is built of.
fn sources(root: &Path) -> Vec<PathBuf> {
    let crates = std::fs::read_dir(root.join("crates")).into_iter().flatten().flatten();
    let own = crates.filter(|folder| !OTHERS.iter().any(|other| folder.file_name() == *other));
    let files = ["Cargo.toml", "Cargo.lock"].map(|name| root.join(name));
    let parts = own.flat_map(|folder| PARTS.map(|part| folder.path().join(part)));
    let mut sources: Vec<_> = parts.chain(files).collect();
    sources.retain(|path| path.exists());
    sources.sort();
    sources
}

/// `, changed HASH` when the sources are not those of the commit; equal changes have equal hashes.
fn changes(sources: &[PathBuf]) -> String {
    let mut diff = Command::new("git");
    diff.args(["diff", "--no-ext-diff", "--no-color", "HEAD", "--"]).args(sources);
    let text = diff.output().map(|output| output.stdout).unwrap_or_default();
    let mut hasher = DefaultHasher::new();
    hasher.write(&text);
    if text.is_empty() { String::new() } else { format!(", changed {:08x}", hasher.finish() as u32) }
}

fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}
