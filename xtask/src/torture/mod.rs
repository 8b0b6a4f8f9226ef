//! `cargo xtask torture`: runs that are killed, starved and fed damaged files, and what became of them.
//!
//! Every case is made from a seed alone, so that each failure prints the command that repeats it.

mod capture;
mod case;
#[path = "../../../fuzz/damage.rs"]
mod damage;
mod inputs;
mod interrupted;
mod mutation;

use crate::{ffgs, workspace};
use anyhow::{Context, Result, ensure};
use case::{Case, Laboratory};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

/// What to torture, and for how long.
#[derive(clap::Args)]
pub struct Options {
    /// Seed of the first round
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Go on with further rounds, each with the next seed, until so many minutes have passed; 0 = one round
    #[arg(long, default_value_t = 0)]
    minutes: u64,
    /// Only these kinds, by the names that the table shows
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    only: Vec<String>,
    /// Only this case of each kind
    #[arg(long, value_name = "N")]
    case: Option<usize>,
    /// Profile of the program: `dev` checks arithmetic for overflow, `release` is what users have
    #[arg(long, default_value = "release")]
    profile: String,
}

impl Options {
    /// One round of every kind.
    pub fn one_round(profile: &str) -> Self {
        Self { seed: 1, minutes: 0, only: Vec::new(), case: None, profile: profile.to_owned() }
    }
}

/// What a case of a kind does; an error says what is wrong with the program.
type Torment = fn(&mut Case) -> Result<()>;

/// Name, cases a round, and the case itself.
const KINDS: [(&str, usize, Torment); 11] = [
    ("kills", 6, interrupted::killed),
    ("signals", 2, interrupted::signalled),
    ("file-size", 4, interrupted::short_of_disk),
    ("memory", 3, interrupted::short_of_memory),
    ("concurrent", 3, interrupted::concurrent),
    ("captures", 60, inputs::damaged_capture),
    ("names", 12, inputs::hostile_names),
    ("devices", 8, inputs::no_files),
    ("runs", 30, inputs::damaged_run),
    ("settings", 30, inputs::odd_settings),
    ("stages", 40, inputs::damaged_stage_input),
];

/// Cases and failures of a kind.
#[derive(Default)]
struct Count {
    cases: usize,
    failures: usize,
    seconds: f64,
}

/// Runs rounds of all kinds, prints each failure with its reproduction and a table of counts.
pub fn run(root: &Path, options: &Options) -> Result<()> {
    let names: Vec<&str> = KINDS.iter().map(|kind| kind.0).collect();
    let unknown = options.only.iter().find(|name| !names.contains(&name.as_str()));
    ensure!(unknown.is_none(), "no kind {unknown:?}; there are: {}", names.join(", "));
    let program = ffgs::build_in(root, &options.profile)?;
    let laboratory = Laboratory::new(root, program)?;
    let kept = workspace::target(root).join("torture");
    let (start, mut counts) = (Instant::now(), BTreeMap::new());
    for round in 0.. {
        torment(&laboratory, options, options.seed + round, &kept, &mut counts)?;
        if start.elapsed() >= Duration::from_secs(60 * options.minutes) {
            break;
        }
    }
    let table = table(&counts);
    println!("{table}");
    std::fs::create_dir_all(&kept)?;
    std::fs::write(kept.join("report.txt"), table).context("cannot write the report")?;
    let failures: usize = counts.values().map(|count: &Count| count.failures).sum();
    ensure!(failures == 0, "{failures} failures; what they ran on is below {}", kept.display());
    Ok(())
}

fn torment(
    laboratory: &Laboratory,
    options: &Options,
    seed: u64,
    kept: &Path,
    counts: &mut BTreeMap<&'static str, Count>,
) -> Result<()> {
    let wanted = |name: &str| options.only.is_empty() || options.only.iter().any(|only| only == name);
    for (name, cases, torment) in KINDS.into_iter().filter(|kind| wanted(kind.0)) {
        let chosen = options.case.map_or(0..cases, |case| case..case + 1);
        let count = counts.entry(name).or_default();
        let start = Instant::now();
        for number in chosen {
            let mut case = Case::new(laboratory, seed, name, number)?;
            count.cases += 1;
            if let Err(fault) = torment(&mut case) {
                count.failures += 1;
                let again =
                    format!("--seed {seed} --only {name} --case {number} --profile {}", options.profile);
                println!("FAILED {name} {number}: {fault:#}\n  again: cargo xtask torture {again}");
                case.keep(&kept.join(format!("{name}-{seed}-{number}")))?;
            }
        }
        count.seconds += start.elapsed().as_secs_f64();
    }
    Ok(())
}

fn table(counts: &BTreeMap<&str, Count>) -> String {
    let line = |(name, count): (&&str, &Count)| {
        format!("{name:<12} {:>6} cases {:>4} failures {:>8.1} s", count.cases, count.failures, count.seconds)
    };
    counts.iter().map(line).collect::<Vec<_>>().join("\n")
}
