//! `cargo xtask torture`: runs that are killed, starved and fed damaged files, and what became of them.
//!
//! Every case is made from a seed alone, so that each failure prints the command that repeats it.

mod capture;
mod case;
mod checksum;
mod circling;
#[path = "../../../fuzz/damage.rs"]
mod damage;
mod exports;
mod footage;
mod injected;
mod inputs;
mod interposer;
mod interrupted;
mod long;
mod mutation;

use crate::{ffgs, workspace};
use anyhow::{Context, Result, ensure};
use case::{Case, Laboratory};
use interposer::CallCounts;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// What to torture, and for how long.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Seed of the first round
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Go on with further rounds, each with the next seed, until so many minutes have passed; 0 = one round
    #[arg(long, default_value_t = 0)]
    minutes: u64,
    /// Only these kinds, by the names that the table shows
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    only: Vec<String>,
    /// Cases per kind and round instead of the usual number
    #[arg(long, value_name = "N")]
    cases: Option<usize>,
    /// Every call of `calls` and `io-errors` in turn, instead of some of them
    #[arg(long, conflicts_with_all = ["cases", "case"])]
    sweep: bool,
    /// Only this case of each kind
    #[arg(long, value_name = "N")]
    case: Option<usize>,
    /// Profile of the program: `dev` checks arithmetic for overflow, `release` is what users have
    #[arg(long, default_value = "release")]
    profile: String,
    /// A program that is built already, instead of building one
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// The few cases of CI
    #[arg(long = "few")]
    in_ci: bool,
    /// Which of the samples of calls comes first
    #[arg(skip)]
    turn: u64,
}

impl Options {
    /// The round of CI; each turn takes other calls.
    pub(crate) fn ci(profile: &str, turn: u64) -> Self {
        Self {
            seed: 1,
            minutes: 0,
            only: Vec::new(),
            cases: None,
            case: None,
            profile: profile.to_owned(),
            program: None,
            sweep: false,
            in_ci: true,
            turn,
        }
    }

    fn wants(&self, name: &str) -> bool {
        if self.only.is_empty() { name != LONG } else { self.only.iter().any(|only| only == name) }
    }

    /// The numbers of a round's cases.
    fn cases(&self, kind: &Kind, round: u64, calls: &CallCounts) -> Vec<usize> {
        let count = self.cases.unwrap_or(if self.in_ci { kind.in_ci } else { kind.by_hand });
        match (self.case, kind.every) {
            (Some(case), _) => vec![case],
            (None, None) => (0..count).collect(),
            (None, Some(every)) if self.sweep => (0..every(calls) as usize).collect(),
            (None, Some(every)) => sample(every(calls), count as u64, self.seed + self.turn + round),
        }
    }
}

/// So many of `total` cases, far from one another; successive rounds go through all of them.
fn sample(total: u64, count: u64, round: u64) -> Vec<usize> {
    // A prime that divides no number of calls of a short run.
    const STRIDE: u64 = 7919;
    (0..count.min(total)).map(|i| ((round * count + i) % total * STRIDE % total) as usize).collect()
}

/// What a case of a kind does; an error says what is wrong with the program.
type Torment = fn(&mut Case) -> Result<()>;

/// What is done to the program again and again.
struct Kind {
    name: &'static str,
    /// Cases of the round in CI, which takes seconds.
    in_ci: usize,
    /// Cases of a round by hand.
    by_hand: usize,
    torment: Torment,
    /// How many different cases there are when they do not follow from the seed.
    every: Option<fn(&CallCounts) -> u64>,
}

const fn kind(name: &'static str, in_ci: usize, by_hand: usize, torment: Torment) -> Kind {
    Kind { name, in_ci, by_hand, torment, every: None }
}

impl Kind {
    const fn of(self, every: fn(&CallCounts) -> u64) -> Self {
        Self { every: Some(every), ..self }
    }
}

const KINDS: [Kind; 17] = [
    kind("kills", 2, 6, interrupted::killed),
    kind("calls", 2, 4, injected::killed_at_calls).of(injected::kills),
    kind("io-errors", 3, 8, injected::failing_calls).of(injected::faults),
    kind("signals", 1, 2, interrupted::signalled),
    kind("file-size", 1, 4, interrupted::short_of_disk),
    kind("memory", 1, 3, interrupted::short_of_memory),
    kind("concurrent", 1, 3, interrupted::concurrent),
    kind("captures", 12, 60, inputs::damaged_capture),
    kind("names", 4, 12, inputs::hostile_names),
    kind("devices", 6, 8, inputs::no_files),
    kind("footage", 4, 20, footage::damaged_footage),
    kind("runs", 8, 30, inputs::damaged_run),
    kind("exports", 3, 10, exports::damaged_export),
    kind("streams", 3, 12, exports::damaged_stream),
    kind(SETTINGS, 8, 30, inputs::odd_settings),
    kind("stages", 20, 40, inputs::damaged_stage_input),
    kind(LONG, 0, 1, long::killed_a_hundred_times),
];
/// The kind that takes many minutes: only by its name.
const LONG: &str = "long";
/// The kind whose settings may ask for any amount of memory.
const SETTINGS: &str = "settings";
/// Most memory of any case, in that of the undisturbed run: no damage to a file of that size may cost more.
const MOST_MEMORY: u64 = 2;

/// Cases and failures of a kind.
#[derive(Default)]
struct Count {
    cases: usize,
    failures: usize,
    seconds: f64,
    /// Most memory that the program held (KiB), where it is known.
    peak: u64,
}

/// How many commits led here, so that each takes another sample of the calls; 0 where git does not say.
pub(crate) fn turn(root: &Path) -> u64 {
    let count = Command::new("git").args(["rev-list", "--count", "HEAD"]).current_dir(root).output();
    let text = count.map(|output| String::from_utf8_lossy(&output.stdout).into_owned());
    text.ok().and_then(|text| text.trim().parse().ok()).unwrap_or(0)
}

/// Runs rounds of all kinds, prints each failure with its reproduction and a table of counts.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let names: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
    let unknown = options.only.iter().find(|name| !names.contains(&name.as_str()));
    ensure!(unknown.is_none(), "no kind {unknown:?}; there are: {}", names.join(", "));
    let program = match &options.program {
        Some(program) => program.canonicalize().with_context(|| format!("no {}", program.display()))?,
        None => ffgs::build_in(root, &options.profile)?,
    };
    let laboratory = Laboratory::new(root, program)?;
    println!("calls of the undisturbed run: {:?}", laboratory.calls);
    if let Some(reason) = laboratory.no_interposer() {
        println!("skipped calls, io-errors: {reason}");
    }
    let kept = workspace::target(root).join("torture");
    let (start, mut counts) = (Instant::now(), BTreeMap::new());
    for round in 0.. {
        torment(&laboratory, options, round, &kept, &mut counts)?;
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
    round: u64,
    kept: &Path,
    counts: &mut BTreeMap<&'static str, Count>,
) -> Result<()> {
    let seed = options.seed + round;
    let possible = |kind: &&Kind| laboratory.no_interposer().is_none() || kind.every.is_none();
    let swept = |kind: &&Kind| !options.sweep || kind.every.is_some();
    for kind in KINDS.iter().filter(|kind| options.wants(kind.name)).filter(possible).filter(swept) {
        let name = kind.name;
        let count = counts.entry(name).or_default();
        let start = Instant::now();
        for number in options.cases(kind, round, &laboratory.calls) {
            let mut case = Case::new(laboratory, seed, name, number)?;
            count.cases += 1;
            let ended = (kind.torment)(&mut case).and_then(|()| within_memory(&case, name));
            count.peak = count.peak.max(case.peak());
            if let Err(fault) = ended {
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

fn within_memory(case: &Case, name: &str) -> Result<()> {
    let (held, usual) = (case.peak(), case.laboratory.peak);
    let bounded = name != SETTINGS && usual > 0;
    ensure!(
        !bounded || held <= MOST_MEMORY * usual,
        "{} MiB were held; a run that nothing disturbs holds {} MiB",
        held >> 10,
        usual >> 10
    );
    Ok(())
}

fn table(counts: &BTreeMap<&str, Count>) -> String {
    let line = |(name, count): (&&str, &Count)| {
        let Count { cases, failures, seconds, peak } = count;
        format!(
            "{name:<12} {cases:>6} cases {failures:>4} failures {seconds:>8.1} s {:>6} MiB at most",
            peak >> 10
        )
    };
    counts.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn samples_of_successive_rounds_go_through_every_case() {
        for (total, count) in [(107_u64, 3), (582, 2), (5, 8)] {
            let rounds = total.div_ceil(count.min(total));
            let met: BTreeSet<usize> =
                (7..7 + rounds).flat_map(|round| sample(total, count, round)).collect();
            assert_eq!(met.len() as u64, total, "{total} by {count}");
        }
    }
}
