//! What is compared: methods with their settings, and these at a budget.

use super::departures;
use anyhow::{Result, anyhow, ensure};
use ffgs_method::Plugin;
use ffgs_pipeline::job::request::FrameRange;
use ffgs_pipeline::plugins::choice::MethodChoice;
use ffgs_pipeline::plugins::registry::{METHODS, open_capture};
use ffgs_pipeline::settings::config::Config;
use std::path::{Path, PathBuf};

/// A row of the tables.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub name: String,
    pub method: MethodChoice,
    /// At budget 1.
    pub config: Config,
    /// Its own budget, in place of those of all.
    pub budget: Option<f64>,
}

impl Candidate {
    /// Of a method's name, of `literal` or `word_for_word`, the paper's method as we read it, or of `without:KEY`, our method with that
    /// setting as printed; with `@BUDGET` behind it, or not.
    fn named(text: &str) -> Result<Self, String> {
        let (name, budget) = text.split_once('@').map_or((text, None), |(name, b)| (name, Some(b)));
        let wrong = |_| format!("'{text}': what stands behind @ is no number");
        let budget = budget.map(str::parse).transpose().map_err(wrong)?;
        let ours = match name.strip_prefix(departures::WITHOUT) {
            Some(key) => Some(departures::without(key)?),
            None if name == LITERAL => Some(Config::literal()),
            None if name == WORD_FOR_WORD => Some(Config::word_for_word()),
            None => None,
        };
        let method = if ours.is_some() { MethodChoice::default() } else { name.parse()? };
        Ok(Self { name: name.to_owned(), method, config: ours.unwrap_or_default(), budget })
    }

    /// Name of the run's folder.
    pub(super) fn folder(&self, budget: f64) -> String {
        format!("{}@{budget}", self.name.replace(':', "_"))
    }
}

const ALL: &str = "all";
const INITIALISATIONS: &str = "initialisations";
const DEPARTURES: &str = "departures";
const LITERAL: &str = "literal";
const WORD_FOR_WORD: &str = "word_for_word";

/// Refuses what no capture can be compared by.
///
/// # Errors
/// When a name is of no method, a budget not above 0, or the frames do not begin at the first.
pub(super) fn check(methods: &[String], budgets: &[f64], frames: Option<FrameRange>) -> Result<()> {
    for name in methods.iter().filter(|name| ![ALL, INITIALISATIONS, DEPARTURES].contains(&name.as_str())) {
        Candidate::named(name).map_err(|error| {
            anyhow!(
                "--methods: {error}; or all, initialisations, departures, literal and word_for_word (the paper's method as \
                 printed)"
            )
        })?;
    }
    let own = methods.iter().filter_map(|name| Candidate::named(name).ok()?.budget);
    for budget in budgets.iter().copied().chain(own) {
        ensure!(budget.is_finite() && budget > 0.0, "--budgets: {budget} is not above 0");
    }
    ensure!(frames.is_none_or(|f| f.start == 0), "--frames: all methods start from the first frame, 0");
    Ok(())
}

/// What `names` stand for on a capture; one that cannot be opened has no trackers, and its runs say why.
pub(super) fn candidates(capture: &Path, names: &[String]) -> Vec<Candidate> {
    let mut out: Vec<Candidate> = Vec::new();
    for name in names.iter().flat_map(|name| meant(capture, name)) {
        let candidate = Candidate::named(&name).ok();
        out.extend(
            candidate.filter(|new| out.iter().all(|old| (&old.name, old.budget) != (&new.name, new.budget))),
        );
    }
    out
}

fn meant(capture: &Path, name: &str) -> Vec<String> {
    match name {
        ALL => {
            let plain = METHODS.items.iter().filter(|method| !method.usage.contains(':'));
            let mut names: Vec<String> = plain.map(|method| method.name().to_owned()).collect();
            names.insert(1, LITERAL.to_owned());
            names
        }
        INITIALISATIONS => {
            let tracks = open_capture(capture).ok().and_then(|capture| ffgs_tracks::sources(&*capture).ok());
            let alone = tracks.iter().flatten().map(|source| format!("tracker:{}", source.name()));
            ["trackers".to_owned(), "none".to_owned()].into_iter().chain(alone).collect()
        }
        DEPARTURES => {
            let whole = ["trackers", LITERAL, WORD_FOR_WORD].map(str::to_owned);
            let single =
                departures::all().into_iter().map(|keys| departures::WITHOUT.to_owned() + &keys.join("+"));
            whole.into_iter().chain(single).collect()
        }
        one => vec![one.to_owned()],
    }
}

/// The settings with `budget` times the steps of every method.
pub(super) fn scaled(mut config: Config, budget: f64) -> Config {
    let method = &mut config.method;
    for steps in [
        &mut config.dynamic.iterations,
        &mut method.dynamic3dgs.iterations,
        &mut method.hicom.motion.iterations,
        &mut method.hicom.added.iterations,
        &mut method.queen.epochs,
        &mut method.recongs.motion.iterations,
        &mut method.recongs.added.iterations,
        &mut method.trackersplat.iterations,
    ] {
        *steps = ((*steps as f64 * budget).round() as usize).max(1);
    }
    config
}

/// Name of the folder of a capture's runs, another one for each.
pub(super) fn folder_name(captures: &[PathBuf], at: usize) -> String {
    let name = |path: &PathBuf| {
        let whole = path.canonicalize().unwrap_or_else(|_| path.clone());
        whole.file_name().map_or("capture".into(), |name| name.to_string_lossy().into_owned())
    };
    let own = name(&captures[at]);
    match captures[..at].iter().filter(|other| name(other) == own).count() {
        0 => own,
        before => format!("{own}-{}", before + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(of: &[&str]) -> Vec<String> {
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let asked: Vec<String> = of.iter().map(|name| (*name).to_owned()).collect();
        candidates(&sample, &asked).into_iter().map(|candidate| candidate.name).collect()
    }

    #[test]
    fn names_stand_for_methods_and_each_is_compared_once() {
        let alone = ["tracker:sparse_xfeat", "tracker:points_raft", "tracker:dense_gmflow"];
        assert_eq!(names(&["initialisations"]), [&["trackers", "none"], &alone[..]].concat());
        let all = ["trackers", "literal", "none", "dynamic3dgs", "hicom", "queen", "recongs", "trackersplat"];
        assert_eq!(names(&["all"]), all);
        let departures = names(&["departures"]);
        assert_eq!(departures[..3], ["trackers", "literal", "word_for_word"]);
        assert!(departures.contains(&"without:marking.every_frame".to_owned()), "{departures:?}");
        assert_eq!(names(&["queen", "all"])[..3], ["queen", "trackers", "literal"]);
        assert_eq!(names(&["queen", "queen@0.1", "queen"]), ["queen", "queen"]);
    }

    #[test]
    fn what_cannot_be_compared_is_refused_with_what_there_is() {
        let refused = |methods: &[&str], budgets: &[f64], frames: Option<FrameRange>| {
            let methods: Vec<String> = methods.iter().map(|name| (*name).to_owned()).collect();
            check(&methods, budgets, frames).map_err(|error| error.to_string()).err()
        };
        assert_eq!(refused(&["all", "tracker:a", "literal"], &[0.1, 1.0], None), None);
        let error = refused(&["quern"], &[1.0], None).unwrap();
        assert!(
            error.contains("quern") && error.contains("queen") && error.contains("initialisations"),
            "{error}"
        );
        assert!(refused(&["all"], &[0.0], None).unwrap().contains("above 0"));
        assert!(refused(&["queen@-1"], &[1.0], None).unwrap().contains("above 0"));
        assert!(refused(&["queen@half"], &[1.0], None).unwrap().contains("no number"));
        assert!(refused(&["all"], &[f64::NAN], None).is_some());
        let late = FrameRange { start: 2, end: None };
        assert!(refused(&["all"], &[1.0], Some(late)).unwrap().contains("first frame"));
    }

    #[test]
    fn a_budget_scales_the_steps_of_every_method_and_nothing_else() {
        let whole = Config::default();
        assert_eq!(scaled(whole, 1.0), whole);
        let less = scaled(whole, 0.5);
        assert_eq!(less.dynamic.iterations * 2, whole.dynamic.iterations);
        assert_eq!((less.method.queen.epochs, less.method.hicom.added.iterations), (5, 50));
        assert_eq!(less.first_frame, whole.first_frame);
        assert_eq!(scaled(whole, 1e-9).method.queen.epochs, 1);
    }

    #[test]
    fn captures_of_one_name_have_folders_of_their_own() {
        let captures = ["a/rain", "b/rain", "night"].map(PathBuf::from);
        assert_eq!([0, 1, 2].map(|at| folder_name(&captures, at)), ["rain", "rain-2", "night"]);
    }
}
