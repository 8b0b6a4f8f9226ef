//! Builds the programs in release and starts them.

use crate::{vmaf, workspace};
use anyhow::{Context, Result, bail, ensure};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, ExitStatus};

/// The capture that ships with the repository.
pub(crate) const SAMPLE: &str = "fixtures/scenes/fairmont-mini";

/// A program, and those of its commands that `cargo xtask` hands on.
struct Program {
    package: &'static str,
    name: &'static str,
    commands: &'static [&'static str],
}

const FFGS: Program = Program {
    package: "ffgs-pipeline",
    name: "ffgs",
    commands: &[
        "prepare", "track", "convert", "run", "check", "stage", "render", "eval", "export", "view", "config",
        "devices", "segment", "workflow", "methods", "formats",
    ],
};
const LAB: Program = Program {
    package: "ffgs-lab",
    name: "ffgs-lab",
    commands: &[
        "motion-eval",
        "mask-eval",
        "simulate",
        "ablations",
        "compare",
        "synthetic",
        "enlarge",
        "expose",
        "later",
        "markers",
    ],
};

/// `cargo xtask pipeline`: `ffgs run` on the sample capture or on the given one.
pub(crate) fn pipeline(root: &Path, args: Vec<String>) -> Result<ExitCode> {
    let plan = RunPlan::new(args, &shown(root));
    let program = build(root)?;
    let status = start(root, &program, &plan.words())?;
    let report = plan.out.join("report.html");
    if status.success() && report.is_file() {
        println!("report: {}", report.display());
    }
    Ok(workspace::exit_code(status))
}

/// Any other command of a program, with its own arguments.
pub(crate) fn pass_through(root: &Path, args: &[String]) -> Result<ExitCode> {
    let name = args.first().map_or("", String::as_str);
    let Some(program) = [FFGS, LAB].into_iter().find(|program| program.commands.contains(&name)) else {
        bail!("no command `{name}`; `cargo xtask --help` lists them");
    };
    Ok(workspace::exit_code(start(root, &program.build(root, "release")?, args)?))
}

/// Builds the release binary of `ffgs` and returns its path.
pub(crate) fn build(root: &Path) -> Result<PathBuf> {
    build_in(root, "release")
}

/// Builds the release binary of `ffgs-lab` and returns its path.
pub(crate) fn build_lab(root: &Path) -> Result<PathBuf> {
    LAB.build(root, "release")
}

/// Builds `ffgs` with a profile, `release` or `dev`, and returns its path.
pub(crate) fn build_in(root: &Path, profile: &str) -> Result<PathBuf> {
    FFGS.build(root, profile)
}

impl Program {
    fn build(&self, root: &Path, profile: &str) -> Result<PathBuf> {
        let binary = self.binary(root, profile);
        let mut command = workspace::cargo(root);
        command.args(["build", "--locked", "--profile", profile, "-p", self.package, "--bin", self.name]);
        // A first build takes minutes and shows its progress; later ones leave the screen to the program.
        if binary.is_file() {
            command.arg("--quiet");
        }
        let status = command.status().context("cannot start cargo")?;
        ensure!(status.success(), "the build of {} failed", self.name);
        Ok(binary)
    }

    /// Where the binary of a profile lies.
    fn binary(&self, root: &Path, profile: &str) -> PathBuf {
        let target =
            std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), |dir| root.join(dir));
        // Cargo's folder of the profile `dev` has another name.
        let folder = if profile == "dev" { "debug" } else { profile };
        target.join(folder).join(format!("{}{}", self.name, std::env::consts::EXE_SUFFIX))
    }
}

/// Starts a program, which is told of the ffmpeg that `cargo xtask setup` has installed unless another one is named.
fn start(root: &Path, program: &Path, args: &[String]) -> Result<ExitStatus> {
    let mut command = Command::new(program);
    let ffmpeg = vmaf::installed(root).filter(|_| std::env::var_os(vmaf::VARIABLE).is_none());
    command.args(args).envs(ffmpeg.map(|ffmpeg| (vmaf::VARIABLE, ffmpeg)));
    command.status().with_context(|| format!("cannot start {}", program.display()))
}

/// The root as a person in the current folder would write it: empty when they are in it.
fn shown(root: &Path) -> PathBuf {
    match std::env::current_dir() {
        Ok(current) if current == root => PathBuf::new(),
        _ => root.to_path_buf(),
    }
}

#[derive(Debug, PartialEq)]
struct RunPlan {
    capture: String,
    out: PathBuf,
    rest: Vec<String>,
}

impl RunPlan {
    fn new(mut args: Vec<String>, root: &Path) -> Self {
        let named = args.first().is_some_and(|first| !first.starts_with('-'));
        let capture = if named { args.remove(0) } else { root.join(SAMPLE).to_string_lossy().into_owned() };
        let out = take_out(&mut args).map_or_else(|| default_out(root, &capture), PathBuf::from);
        Self { capture, out, rest: args }
    }

    fn words(&self) -> Vec<String> {
        let out = self.out.to_string_lossy().into_owned();
        let mut words = vec!["run".to_owned(), self.capture.clone(), "--out".to_owned(), out];
        words.extend(self.rest.iter().cloned());
        words
    }
}

/// Where a run of `capture` is written unless `--out` says otherwise.
pub(crate) fn default_out(root: &Path, capture: &str) -> PathBuf {
    let absolute = Path::new(capture).canonicalize().unwrap_or_else(|_| PathBuf::from(capture));
    let name = absolute.file_name().map_or_else(|| "run".into(), ToOwned::to_owned);
    root.join("out").join(name)
}

/// Takes `--out DIR` or `--out=DIR` from the arguments.
fn take_out(args: &mut Vec<String>) -> Option<String> {
    let at = args.iter().position(|a| a == "--out" || a.starts_with("--out="))?;
    if args[at] == "--out" {
        // Without its value the option stays, so that the program itself reports it.
        return (at + 1 < args.len()).then(|| args.drain(at..=at + 1).nth(1)).flatten();
    }
    args.remove(at).strip_prefix("--out=").map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(args: &[&str]) -> RunPlan {
        RunPlan::new(args.iter().map(|&a| a.to_owned()).collect(), Path::new(""))
    }

    #[test]
    fn the_sample_is_the_default() {
        let words = plan(&[]).words();
        assert_eq!(words, ["run", SAMPLE, "--out", "out/fairmont-mini"]);
    }

    #[test]
    fn a_named_capture_replaces_the_sample_and_options_follow() {
        let words = plan(&["caps/street", "--frames", "0..2", "--out", "there", "--resume"]).words();
        assert_eq!(words, ["run", "caps/street", "--out", "there", "--frames", "0..2", "--resume"]);
        assert_eq!(plan(&["caps/street"]).out, Path::new("out/street"));
        assert_eq!(plan(&["--out=x", "--quiet"]).words(), ["run", SAMPLE, "--out", "x", "--quiet"]);
    }

    #[test]
    fn an_option_without_its_value_is_left_to_the_program() {
        assert_eq!(plan(&["--out"]).rest, ["--out"]);
    }

    #[test]
    fn an_unknown_command_is_refused_before_anything_is_built() {
        let error = pass_through(Path::new("/nowhere"), &["inspect".to_owned()]).unwrap_err();
        assert!(error.to_string().contains("inspect"));
    }
}
