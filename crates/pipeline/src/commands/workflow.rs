//! `ffgs workflow`: captures, methods and seeds as jobs for Snakemake.

use crate::cli::terminal;
use crate::commands::segment::{Plan, PlanArgs};
use crate::job::request::FrameRange;
use crate::outputs::json::{read_json, write_json};
use crate::plugins::choice::{MethodChoice, MethodParser};
use anyhow::{Context, Result, ensure};
use clap::Args;
use ffgs_core::{counted, write_atomically};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// `ffgs workflow`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Write a Snakemake workflow over captures, methods and seeds",
    long_about = "Writes a Snakemake workflow that reconstructs captures: first frame, scout, parts, joining, evaluation and \
        export are jobs, and table.md and report.html compare all runs. The default method runs in parts (ffgs segment), another \
        method as one job. A worker that is killed loses the frame it was at: its job goes on when Snakemake is started again, or \
        at once with --retries. Snakemake is a Python package: pip install snakemake. The folder must be one that all machines \
        see; of several workers on one job the later ones are refused.",
    after_help = "Examples:\n  ffgs workflow CAPTURE --out out/farm --length 50\n  \
        cd out/farm && snakemake --profile profiles/laptop --cores 2     # two jobs at a time here\n  \
        snakemake --profile profiles/slurm                               # on a cluster; adapt the profile first\n  \
        ffgs workflow CAPTURE CAPTURE --out out/all --length 50 --seeds 1,2 --methods trackers,hicom --gpus 0,1"
)]
pub struct WorkflowArgs {
    /// Folders of captures
    #[arg(required = true)]
    captures: Vec<PathBuf>,
    /// New folder for the workflow and all runs
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Frames from one key frame to the next
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(2..))]
    length: u32,
    /// Frames 0 to B, B left out: `..B`
    #[arg(long, value_name = "A..B")]
    frames: Option<FrameRange>,
    /// Methods, each a run of its own
    #[arg(long, value_name = "METHOD,METHOD", value_delimiter = ',', value_parser = MethodParser)]
    methods: Vec<MethodChoice>,
    /// Seeds, each a run of its own
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_value = "1")]
    seeds: Vec<u64>,
    /// Settings of all runs
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// GPUs of each machine, each for one job at a time; without, jobs run on the CPU
    #[arg(long, value_name = "N,N", value_delimiter = ',')]
    gpus: Vec<usize>,
}

/// The program's files beside config.json,
const FILES: [(&str, &str); 4] = [
    ("Snakefile", include_str!("../../workflow/Snakefile")),
    ("lease.py", include_str!("../../workflow/lease.py")),
    ("table.py", include_str!("../../workflow/table.py")),
    ("report.py", include_str!("../../workflow/report.py")),
];
/// and those that users adapt to their machines.
const PROFILES: [(&str, &str); 5] = [
    ("profiles/laptop/config.yaml", include_str!("../../workflow/profiles/laptop/config.yaml")),
    ("profiles/slurm/config.yaml", include_str!("../../workflow/profiles/slurm/config.yaml")),
    ("profiles/kubernetes/config.yaml", include_str!("../../workflow/profiles/kubernetes/config.yaml")),
    ("profiles/kubernetes/Dockerfile", include_str!("../../workflow/profiles/kubernetes/Dockerfile")),
    ("profiles/kubernetes/snakemake.yaml", include_str!("../../workflow/profiles/kubernetes/snakemake.yaml")),
];

/// `config.json`.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Settings {
    /// The program.
    ffgs: PathBuf,
    /// GPUs of a machine, separated by commas.
    gpus: String,
    runs: BTreeMap<String, RunJobs>,
}

/// A run: in parts, or one command.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct RunJobs {
    /// Number of parts; 0 = none.
    parts: usize,
    /// Options of `ffgs run`, where there are no parts.
    command: String,
}

/// Writes the workflow.
///
/// # Errors
/// When a capture cannot be used, or the folder has another workflow.
pub(crate) fn write(args: &WorkflowArgs) -> Result<()> {
    let (mut runs, mut plans) = (BTreeMap::new(), Vec::new());
    for capture in &args.captures {
        let path =
            std::fs::canonicalize(capture).with_context(|| format!("no capture at {}", capture.display()))?;
        for seed in distinct(&args.seeds) {
            for method in args.chosen() {
                let name =
                    format!("{}-{method}-{seed}", path.file_name().unwrap_or_default().to_string_lossy());
                ensure!(
                    is_plain(&name),
                    "{name}: folders of captures need names of letters, digits, '-', '_' and '.'"
                );
                let (jobs, plan) = args.jobs(&path, &name, &method, seed)?;
                plans.extend(plan.map(|plan| (args.out.join(&name), plan)));
                ensure!(
                    runs.insert(name.clone(), jobs).is_none(),
                    "two captures are called {}; rename one",
                    path.file_name().unwrap_or_default().display()
                );
            }
        }
    }
    let gpus = args.gpus.iter().map(usize::to_string).collect::<Vec<_>>().join(",");
    let settings = Settings { ffgs: std::env::current_exe()?, gpus, runs };
    let file = args.out.join("config.json");
    let other = file.exists().then(|| read_json::<Settings>(&file)).transpose()?;
    ensure!(
        other.is_none_or(|other| other.runs == settings.runs),
        "{} holds another workflow; choose another --out or remove it",
        args.out.display()
    );
    plans.iter().try_for_each(|(folder, plan)| plan.write(folder))?;
    for (name, text) in FILES {
        put(&args.out.join(name), text)?;
    }
    for (name, text) in PROFILES {
        put_unless_adapted(&args.out.join(name), text)?;
    }
    write_json(&file, &settings)?;
    terminal::print(format!(
        "{}: {}; start them there with snakemake",
        args.out.display(),
        counted(settings.runs.len(), "run")
    ));
    Ok(())
}

impl WorkflowArgs {
    /// The methods; the default when none is named.
    fn chosen(&self) -> Vec<MethodChoice> {
        if self.methods.is_empty() { vec![MethodChoice::default()] } else { distinct(&self.methods) }
    }

    /// A run's jobs, and the plan of its parts where it has any.
    fn jobs(
        &self,
        capture: &Path,
        name: &str,
        method: &MethodChoice,
        seed: u64,
    ) -> Result<(RunJobs, Option<Plan>)> {
        if *method == MethodChoice::default() {
            let plan = Plan::new(&PlanArgs {
                capture: capture.to_owned(),
                out: self.out.join(name),
                length: self.length,
                frames: self.frames,
                config: self.config.clone(),
                seed: Some(seed),
                ..PlanArgs::default()
            })?;
            return Ok((RunJobs { parts: plan.parts().len(), command: String::new() }, Some(plan)));
        }
        let frames = self.frames.map_or(String::new(), |f| {
            format!(" --frames {}..{}", f.start, f.end.map_or(String::new(), |end| end.to_string()))
        });
        let config = match &self.config {
            Some(file) => format!(" --config {}", quoted(&std::fs::canonicalize(file)?)),
            None => String::new(),
        };
        let command =
            format!("{} --out {name} --method {method} --seed {seed}{frames}{config}", quoted(capture));
        Ok((RunJobs { parts: 0, command }, None))
    }
}

/// Each once, in the order in which they were named.
fn distinct<T: Clone + PartialEq>(named: &[T]) -> Vec<T> {
    let is_first = |(i, value): &(usize, &T)| !named[..*i].contains(value);
    named.iter().enumerate().filter(is_first).map(|(_, value)| value.clone()).collect()
}

/// A path as one word of a shell's command.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', r"'\''"))
}

/// Whether a name is safe in a shell and in a pattern of Snakemake.
fn is_plain(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.:".contains(c);
    !name.starts_with(['-', '.']) && name.chars().all(plain)
}

fn put(file: &Path, text: &str) -> Result<()> {
    write_atomically(file, |out| out.write_all(text.as_bytes()))
        .with_context(|| format!("cannot write {}", file.display()))
}

/// Keeps a file that says something else: its user wrote it.
fn put_unless_adapted(file: &Path, text: &str) -> Result<()> {
    if !file.exists() {
        return put(file, text);
    }
    if std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))? != text.as_bytes() {
        terminal::print(format!("{} was adapted and stays as it is; remove it to get ours", file.display()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_adapted_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("profiles/slurm/config.yaml");
        let written = |text| {
            put_unless_adapted(&file, text).unwrap();
            std::fs::read_to_string(&file).unwrap()
        };
        assert_eq!(written("jobs: 8\n"), "jobs: 8\n");
        std::fs::write(&file, "jobs: 64\n").unwrap();
        assert_eq!(written("jobs: 8\n"), "jobs: 64\n");
        std::fs::remove_file(&file).unwrap();
        assert_eq!(written("jobs: 9\n"), "jobs: 9\n", "ours again");
    }

    #[test]
    fn what_is_named_twice_counts_once_and_paths_are_one_word() {
        assert_eq!(distinct(&[2, 1, 2, 3, 1]), [2, 1, 3]);
        let words = std::process::Command::new("sh")
            .args(["-c", &format!("printf '%s|' {}", quoted(Path::new("/tom's own/a b")))])
            .output()
            .unwrap();
        assert_eq!(String::from_utf8(words.stdout).unwrap(), "/tom's own/a b|");
    }

    #[test]
    fn names_that_a_shell_would_take_apart_are_refused() {
        assert!(is_plain("fairmont-mini-trackers-1") && is_plain("a-tracker:raft-2"));
        for name in ["a b-1", "a;rm-1", "-x-1", "../up-1", "a'b-1"] {
            assert!(!is_plain(name), "{name}");
        }
    }
}
