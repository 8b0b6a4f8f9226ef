//! `cargo xtask fuzz`: every parser under libFuzzer and AddressSanitizer, one after another.
//!
//! All targets are one program, which parses what its own name says: it is built once.

use crate::workspace;
use anyhow::{Context, Result, ensure};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Which parsers, for how long.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Seconds for each parser
    #[arg(long, default_value_t = 30)]
    seconds: u64,
    /// Seed of the first parser; the others have the next ones
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only these parsers, by the names of the folders in fuzz/corpus
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    only: Vec<String>,
    /// Keep a few small inputs that reach other code than those kept before, in fuzz/reached
    #[arg(long)]
    keep: bool,
}

/// An input that takes longer hangs (s).
const SLOWEST: u64 = 10;
/// Most memory that a parser may hold, sanitizer included (MiB). Pictures may take 512 while they are decoded.
const MOST_MEMORY: u64 = 2048;
/// Most inputs of a parser that are kept beside its sound files, and their length (bytes).
const KEPT: usize = 8;
const LONGEST_KEPT: u64 = 4096;

/// What a parser went through.
struct Ended {
    inputs: u64,
    edges: u64,
    found: usize,
    is_sound: bool,
}

/// Builds the targets, runs them and prints a table; an error where one of them failed.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let program = build(root)?;
    let folder = workspace::target(root).join("fuzz");
    let mut failed = Vec::new();
    for (i, name) in names(root, &options.only)?.iter().enumerate() {
        let target = Target { root, folder: &folder, name };
        target.link(&program)?;
        let ended = target.fuzz(options.seconds, options.seed + i as u64)?;
        if !ended.is_sound {
            failed.push(name.clone());
        }
        let kept = if options.keep { target.keep()? } else { 0 };
        println!(
            "{name:<16} {:>9} inputs {:>6} edges {:>5} new {kept:>2} kept{}",
            ended.inputs,
            ended.edges,
            ended.found,
            if ended.is_sound { "" } else { "  FAILED" }
        );
    }
    ensure!(failed.is_empty(), "failed: {}; what repeats it is above", failed.join(", "));
    Ok(())
}

/// The parsers, each of which has a folder of sound files.
fn names(root: &Path, only: &[String]) -> Result<Vec<String>> {
    let folders = fs::read_dir(root.join("fuzz/corpus")).context("no fuzz/corpus")?;
    let mut names: Vec<String> =
        folders.flatten().map(|folder| folder.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    let unknown = only.iter().find(|name| !names.contains(name));
    ensure!(unknown.is_none(), "no parser {unknown:?}; there are: {}", names.join(", "));
    names.retain(|name| only.is_empty() || only.contains(name));
    Ok(names)
}

/// Builds one of the targets with cargo-fuzz; all others are the same program.
fn build(root: &Path) -> Result<PathBuf> {
    let mut command = Command::new("rustup");
    command.args(["run", "nightly", "cargo", "fuzz", "build", "npy"]).current_dir(root.join("fuzz"));
    let status = command.status().context("no rustup")?;
    ensure!(
        status.success(),
        "the targets were not built: they need `rustup toolchain install nightly`, a C++ compiler and `cargo install \
         --locked cargo-fuzz`"
    );
    let host = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    Ok(root.join("fuzz/target").join(host).join("release/npy"))
}

struct Target<'a> {
    root: &'a Path,
    folder: &'a Path,
    name: &'a str,
}

impl Target<'_> {
    fn program(&self) -> PathBuf {
        self.folder.join(self.name)
    }

    /// Inputs that were found and are of no repository.
    fn work(&self) -> PathBuf {
        self.folder.join("corpus").join(self.name)
    }

    /// The kept inputs: sound files, and what reaches other code.
    fn kept(&self) -> Vec<PathBuf> {
        let folders = ["fuzz/corpus", "fuzz/reached"].map(|folder| self.root.join(folder).join(self.name));
        folders.into_iter().filter(|folder| folder.is_dir()).collect()
    }

    fn link(&self, program: &Path) -> Result<()> {
        fs::create_dir_all(self.work()).context("cannot make the folder of inputs")?;
        let _ = fs::remove_file(self.program());
        fs::hard_link(program, self.program()).with_context(|| format!("cannot link {}", program.display()))
    }

    fn command(&self) -> Command {
        let mut command = Command::new(self.program());
        let limits = [format!("-timeout={SLOWEST}"), format!("-rss_limit_mb={MOST_MEMORY}")];
        command.args(limits).current_dir(self.folder);
        // Every input is a file in a temporary folder: not on a disk where it can be helped.
        if Path::new("/dev/shm").is_dir() {
            command.env("TMPDIR", "/dev/shm");
        }
        command
    }

    fn fuzz(&self, seconds: u64, seed: u64) -> Result<Ended> {
        let artifact = format!("-artifact_prefix={}/{}-", self.folder.display(), self.name);
        let mut command = self.command();
        command.args([artifact, format!("-max_total_time={seconds}"), format!("-seed={seed}")]);
        command.args(["-print_final_stats=1", "-max_len=65536"]).arg(self.work()).args(self.kept());
        let output = command.output().context("cannot start a target")?;
        let told = String::from_utf8_lossy(&output.stderr);
        if !output.status.success() {
            println!("{told}\nagain: cargo +nightly fuzz run {} FILE, with the file named above", self.name);
        }
        let last = told.lines().rfind(|line| line.contains(" cov: ")).unwrap_or_default();
        Ok(Ended {
            inputs: number_after(&told, "stat::number_of_executed_units:"),
            edges: number_after(last, " cov:"),
            found: number_after(&told, "stat::new_units_added:") as usize,
            is_sound: output.status.success(),
        })
    }

    /// Copies the inputs that reach most of what the kept ones do not; how many.
    fn keep(&self) -> Result<usize> {
        let (control, nowhere) = (self.folder.join("reach"), tempfile::tempdir()?);
        let _ = fs::remove_file(&control);
        let mut command = self.command();
        command.arg("-merge=1").arg(format!("-merge_control_file={}", control.display()));
        let output = command.arg(nowhere.path()).args(self.kept()).arg(self.work()).output()?;
        ensure!(output.status.success(), "no merge: {}", String::from_utf8_lossy(&output.stderr));
        let reach = reach(&fs::read_to_string(control)?);
        let to = self.root.join("fuzz/reached").join(self.name);
        let chosen = chosen(&reach, &self.kept(), KEPT.saturating_sub(count(&to)));
        for file in &chosen {
            fs::create_dir_all(&to)?;
            fs::copy(file, to.join(file.file_name().context("no name")?))?;
        }
        Ok(chosen.len())
    }
}

fn count(folder: &Path) -> usize {
    fs::read_dir(folder).into_iter().flatten().count()
}

/// The first number after a word; 0 where there is none.
fn number_after(text: &str, word: &str) -> u64 {
    let rest = text.split_once(word).map_or("", |(_, rest)| rest);
    rest.split_whitespace().next().and_then(|number| number.parse().ok()).unwrap_or(0)
}

/// Each file of libFuzzer's merge with the features that it reaches.
fn reach(control: &str) -> Vec<(PathBuf, BTreeSet<u64>)> {
    let mut lines = control.lines();
    let files: usize = lines.next().and_then(|line| line.parse().ok()).unwrap_or(0);
    let mut reach: Vec<_> =
        lines.by_ref().skip(1).take(files).map(|file| (PathBuf::from(file), BTreeSet::new())).collect();
    for line in lines.filter_map(|line| line.strip_prefix("FT ")) {
        let mut numbers = line.split(' ').filter_map(|number| number.parse::<u64>().ok());
        let file = numbers.next().and_then(|file| reach.get_mut(file as usize));
        file.into_iter().for_each(|(_, features)| features.extend(numbers.by_ref()));
    }
    reach
}

/// The few small files that together reach most of what those in the kept folders do not, the best first.
fn chosen(reach: &[(PathBuf, BTreeSet<u64>)], kept: &[PathBuf], most: usize) -> Vec<PathBuf> {
    let is_kept = |file: &Path| kept.iter().any(|folder| file.starts_with(folder));
    let mut reached: BTreeSet<u64> =
        reach.iter().filter(|(file, _)| is_kept(file)).flat_map(|(_, features)| features.clone()).collect();
    let is_small = |file: &Path| fs::metadata(file).is_ok_and(|info| info.len() <= LONGEST_KEPT);
    let new: Vec<_> = reach.iter().filter(|(file, _)| !is_kept(file) && is_small(file)).collect();
    let mut chosen = Vec::new();
    while chosen.len() < most {
        let gain = |features: &BTreeSet<u64>| features.difference(&reached).count();
        let Some((file, features)) = new.iter().max_by_key(|(_, features)| gain(features)) else { break };
        if gain(features) == 0 {
            break;
        }
        reached.extend(features);
        chosen.push(file.clone());
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_that_reach_most_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        for name in ["sound/a", "work/b", "work/c", "work/d"] {
            fs::create_dir_all(folder.path().join(name).parent().unwrap()).unwrap();
            fs::write(path(name), "x").unwrap();
        }
        fs::write(path("work/d"), [0; 5000]).unwrap();
        let files = ["sound/a", "work/b", "work/c", "work/d"].map(path).join("\n");
        let control =
            format!("4\n0\n{files}\nSTARTED 0 1\nFT 0 1 2\nCOV 0 1\nFT 1 2 3\nFT 2 3 4 5\nFT 3 6 7 8 9");
        let kept = [folder.path().join("sound")];
        let found = chosen(&reach(&control), &kept, 8);
        assert_eq!(found, [PathBuf::from(path("work/c"))], "b reaches nothing else, d is too long");
        assert!(chosen(&reach(&control), &kept, 0).is_empty());
    }

    #[test]
    fn numbers_of_the_log_are_found() {
        assert_eq!(number_after("#9\tDONE   cov: 312 ft: 700", " cov:"), 312);
        assert_eq!(number_after("nothing", " cov:"), 0);
    }
}
