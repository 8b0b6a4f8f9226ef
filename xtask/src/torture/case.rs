//! One case: its random numbers, its folder, and the program run under limits.

use super::capture::{self, FRAMES, copy_folder, files};
use super::circling;
use super::damage::Random;
use super::interposer::{CallCounts, Interposer, call_counts};
use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

/// As little training as shows a difference.
pub(crate) const FEW: [&str; 7] =
    ["--first-iterations", "4", "--iterations", "3", "--device", "cpu", "--quiet"];
/// A case that takes more processor time hangs (s).
const CPU_SECONDS: u64 = 60;
/// A case that takes more time waits for something that never comes (s); others may be using the machine.
pub(crate) const WALL_SECONDS: u64 = 900;
/// No capture of this size needs more address space (KiB).
const ADDRESS_KIB: u64 = 6 << 20;
/// Runs have from one to so many threads.
const MOST_THREADS: usize = 3;
/// Signals that limits end a program with.
const SIGXCPU: i32 = 24;

/// What all cases share: the program, a small sound capture and a run of it that nothing disturbed.
pub(crate) struct Laboratory {
    /// The repository.
    pub root: PathBuf,
    /// Calls to the system of the undisturbed run of the smallest capture; none where the library is not to be had.
    pub calls: CallCounts,
    /// Most memory that the undisturbed run held (KiB); 0 where it is not known.
    pub peak: u64,
    interposer: Result<Interposer>,
    program: PathBuf,
    folder: TempDir,
}

impl Laboratory {
    /// Makes the captures and their runs.
    pub(crate) fn new(root: &Path, program: PathBuf) -> Result<Self> {
        let folder = tempfile::tempdir().context("cannot make a temporary folder")?;
        let interposer = Interposer::build(folder.path());
        let (root, calls) = (root.to_owned(), CallCounts::new());
        let mut laboratory = Self { root, calls, peak: 0, interposer, program, folder };
        capture::cut(&laboratory.root, &laboratory.capture())?;
        circling::write(&laboratory.smallest_capture(), FRAMES)?;
        let mut case = Case::new(&laboratory, 0, "reference", 0)?;
        undisturbed(&mut case, &laboratory.smallest_capture(), &laboratory.smallest_run())?;
        let calls = call_counts(&laboratory.report());
        undisturbed(&mut case, &laboratory.capture(), &laboratory.run())?;
        let peak = case.peak();
        (laboratory.calls, laboratory.peak) = (calls, peak);
        Ok(laboratory)
    }

    /// Why calls to the system cannot be made to fail here; `None` where they can.
    pub(crate) fn no_interposer(&self) -> Option<String> {
        self.interposer.as_ref().err().map(|reason| format!("{reason:#}"))
    }

    /// Where the library between the program and the system writes.
    pub(crate) fn report(&self) -> PathBuf {
        self.folder.path().join("told")
    }

    /// A folder that cases share, made by `make` when it is first asked for.
    pub(crate) fn shared(&self, name: &str, make: impl FnOnce(&Path) -> Result<()>) -> Result<PathBuf> {
        let path = self.folder.path().join(name);
        if !path.exists() {
            make(&path)?;
        }
        Ok(path)
    }

    /// The capture; cases that change it copy it.
    pub(crate) fn capture(&self) -> PathBuf {
        self.folder.path().join("capture")
    }

    /// The undisturbed run.
    pub(crate) fn run(&self) -> PathBuf {
        self.folder.path().join("run")
    }

    /// A computed capture of tiny pictures, for what is done to every call of a run.
    pub(crate) fn smallest_capture(&self) -> PathBuf {
        self.folder.path().join("smallest")
    }

    /// The undisturbed run of it.
    pub(crate) fn smallest_run(&self) -> PathBuf {
        self.folder.path().join("smallest-run")
    }
}

fn undisturbed(case: &mut Case, capture: &Path, run: &Path) -> Result<()> {
    let output = case.ffgs(&run_words(capture, run, &[]))?;
    ensure!(output.status.success(), "the undisturbed run failed: {}", said(&output));
    Ok(())
}

/// `run CAPTURE --out OUT`, little training, and more options.
pub(crate) fn run_words(capture: &Path, out: &Path, more: &[&str]) -> Vec<String> {
    let paths = [capture, out].map(|path| path.display().to_string());
    let [capture, out] = paths;
    let options = FEW.iter().chain(more).map(|word| (*word).to_owned());
    ["run".to_owned(), capture, "--out".to_owned(), out].into_iter().chain(options).collect()
}

/// One case.
pub(crate) struct Case<'a> {
    /// What all cases share.
    pub laboratory: &'a Laboratory,
    /// Which case of its kind.
    pub number: u64,
    folder: TempDir,
    /// The case's random numbers.
    pub random: Random,
    /// Most memory that the program has held (KiB), where it is known.
    peak: Cell<u64>,
}

impl<'a> Case<'a> {
    /// The case of a kind and number: its random numbers follow from these and the seed alone.
    pub(crate) fn new(laboratory: &'a Laboratory, seed: u64, kind: &str, number: usize) -> Result<Self> {
        let folder = tempfile::tempdir().context("cannot make a temporary folder")?;
        let start = kind.bytes().fold(seed, |sum, byte| sum.wrapping_mul(257).wrapping_add(byte.into()));
        let random = Random(start ^ (number as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        Ok(Self { laboratory, number: number as u64, folder, random, peak: Cell::new(0) })
    }

    /// Most memory that the program has held in this case (KiB).
    pub(crate) fn peak(&self) -> u64 {
        self.peak.get()
    }

    /// A random number below `count`, which is not 0.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        self.random.below(count)
    }

    /// One of them.
    pub(crate) fn one_of<T: Clone>(&mut self, items: &[T]) -> T {
        items[self.below(items.len())].clone()
    }

    /// A path in the case's folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A copy of the capture that may be damaged.
    pub(crate) fn copied_capture(&self) -> Result<PathBuf> {
        let to = self.path("capture");
        copy_folder(&self.laboratory.capture(), &to).map(|()| to)
    }

    /// A copy of the undisturbed run that may be damaged.
    pub(crate) fn copied_run(&self) -> Result<PathBuf> {
        let to = self.path("run");
        copy_folder(&self.laboratory.run(), &to).map(|()| to)
    }

    /// Keeps what the case ran on.
    pub(crate) fn keep(self, at: &Path) -> Result<()> {
        let _ = fs::remove_dir_all(at);
        copy_folder(self.folder.path(), at)
    }

    /// The program under shell limits (`ulimit ...;`) and that of processor time, ready to start.
    pub(crate) fn limited(&mut self, limits: &str, words: &[String]) -> Command {
        self.started(&format!("ulimit -t {CPU_SECONDS}; {limits}"), words)
    }

    /// The program under shell limits, ready to start.
    pub(crate) fn started(&mut self, limits: &str, words: &[String]) -> Command {
        let mut command = Command::new("sh");
        let script = format!("{limits} export LD_PRELOAD=\"$TORTURE_LIBRARY\"; exec \"$0\" \"$@\"");
        command.args(["-c", &script]).arg(&self.laboratory.program).args(words);
        command.env("RAYON_NUM_THREADS", (1 + self.below(MOST_THREADS)).to_string());
        if let Ok(interposer) = &self.laboratory.interposer {
            interposer.put_under(&mut command, &self.laboratory.report());
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Runs the program to its end under the usual limits. A failure of it is an error: a panic, a signal, no end,
    /// an error without a word, a control character on the terminal.
    pub(crate) fn ffgs(&mut self, words: &[String]) -> Result<Output> {
        let limits = format!("ulimit -v {ADDRESS_KIB};");
        let inner = self.limited(&limits, words);
        let mut command = Command::new("timeout");
        command.arg(WALL_SECONDS.to_string()).arg(inner.get_program()).args(inner.get_args());
        inner.get_envs().for_each(|(key, value)| {
            command.env(key, value.unwrap_or_default());
        });
        let report = self.laboratory.report();
        let _ = fs::remove_file(&report);
        let output = command.stdin(Stdio::null()).output().context("cannot start the program")?;
        let peak = call_counts(&report).get("peak").copied().unwrap_or(0);
        self.peak.set(self.peak.get().max(peak));
        judged(output).with_context(|| format!("ffgs {}", words.join(" ")))
    }
}

/// Both streams as text.
pub(crate) fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// Whether a message names a file of the case or of what all cases share.
pub(crate) fn names_a_file(case: &Case, text: &str) -> bool {
    let within = |folder: &Path| text.contains(&format!("{}/", folder.display()));
    within(case.folder.path()) || within(case.laboratory.folder.path())
}

/// Refuses an end that no input may cause.
pub(crate) fn judged(output: Output) -> Result<Output> {
    let text = said(&output);
    ensure!(!text.contains("panicked at"), "a panic: {text}");
    ensure!(!text.contains('\u{1b}'), "a terminal escape: {text:?}");
    match (output.status.code(), output.status.signal()) {
        (Some(0 | 2), _) => Ok(output),
        (Some(1), _) if text.contains("error: ") || text.contains("fix: ") => Ok(output),
        (Some(124), _) => bail!("no end after {WALL_SECONDS} s"),
        (_, Some(SIGXCPU)) | (Some(152), _) => bail!("no end after {CPU_SECONDS} s of processor time"),
        (code, signal) => bail!("ended with status {code:?}, signal {signal:?}: {text}"),
    }
}

/// The files of a run that must be the same whatever happened on the way: all of them where the clock stood still, else
/// everything but times, memory and the report's copy of them.
pub(crate) fn results(run: &Path, no_time: bool) -> Result<BTreeMap<PathBuf, Vec<u8>>> {
    let mut results = BTreeMap::new();
    for file in files(run)? {
        let name = file.strip_prefix(run)?.to_owned();
        let bytes = match name.file_name().and_then(|n| n.to_str()) {
            Some("report.html" | "run.json") if no_time => threadless(&file)?,
            _ if no_time => fs::read(&file)?,
            Some("report.html" | "run.json") => continue,
            Some("metrics.json" | "frame.json") => timeless(&file)?,
            _ => fs::read(&file)?,
        };
        results.insert(name, bytes);
    }
    Ok(results)
}

/// A text without the number of threads that a run began with.
fn threadless(file: &Path) -> Result<Vec<u8>> {
    let text = fs::read_to_string(file)?;
    Ok((1..=MOST_THREADS).fold(text, |text, n| text.replace(&format!(", {n} threads"), "")).into_bytes())
}

fn timeless(file: &Path) -> Result<Vec<u8>> {
    let mut value: Value = serde_json::from_str(&fs::read_to_string(file)?)?;
    forget_times(&mut value);
    Ok(value.to_string().into_bytes())
}

/// What a run measures of itself: no two runs have the same.
const MEASURED: [&str; 7] = [
    "seconds",
    "seconds_per_frame",
    "processor_seconds",
    "psnr_per_second",
    "vmaf_per_second",
    "peak_memory_mib",
    "read_mib",
];

fn forget_times(value: &mut Value) {
    match value {
        Value::Object(map) => {
            map.retain(|key, _| !MEASURED.contains(&key.as_str()));
            map.values_mut().for_each(forget_times);
        }
        Value::Array(items) => items.iter_mut().for_each(forget_times),
        _ => {}
    }
}

/// Refuses a run that differs from an undisturbed one, its times too when none passed; how many files were compared.
pub(crate) fn equal_runs(undisturbed: &Path, run: &Path, no_time: bool) -> Result<usize> {
    let (expected, found) = (results(undisturbed, no_time)?, results(run, no_time)?);
    for (name, bytes) in &expected {
        let other = found.get(name).with_context(|| format!("{} is missing", name.display()))?;
        ensure!(bytes == other, "{} differs from that of a run that was never stopped", name.display());
    }
    let extra: Vec<_> = found.keys().filter(|name| !expected.contains_key(*name)).collect();
    ensure!(extra.is_empty(), "left behind: {extra:?}");
    ensure!(run.join("report.html").is_file(), "no report");
    Ok(expected.len())
}
