//! `run.json`: what was run, on what, with which settings.

use crate::job::provenance::{VERSION, capture_digest, file_digest};
use crate::job::request::RunRequest;
use crate::outputs::folder::RunFolder;
use crate::outputs::json::{read_json, write_json};
use crate::plugins::choice::MethodChoice;
use crate::settings::config::Config;
use crate::settings::config_ranges::leaves;
use anyhow::{Context, Result, ensure};
use ffgs_core::instruction_set;
use ffgs_method::Capture;
use ffgs_report::Fact;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// The description of a run. Two runs with equal descriptions give the same bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Name of the capture folder.
    pub capture: String,
    /// Where it lay.
    pub capture_path: PathBuf,
    /// Frames.
    pub frames: Range<usize>,
    /// How the scene moved.
    #[serde(alias = "init")]
    pub method: MethodChoice,
    /// Training cameras, when not all.
    pub train_views: Option<Vec<String>>,
    /// Run that frame 0 was taken from.
    pub first_frame: Option<PathBuf>,
    /// Digest of that frame's Gaussians; empty where they are gone, and in old runs.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub first_frame_digest: String,
    /// Iterations for which that frame was finetuned; absent when it was not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refine_first: Option<usize>,
    /// Frames per part, when the run was joined of parts (`ffgs segment`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment_length: Option<usize>,
    /// Device.
    pub device: String,
    /// Program version and commit.
    pub version: String,
    /// Digest of cameras, points and the list of trackers; empty in old runs.
    #[serde(default)]
    pub capture_digest: String,
    /// Where the origin of all positions that the run writes is, in the coordinates of the capture's files (m). Zero
    /// but for captures far from theirs.
    #[serde(default)]
    pub origin: [f64; 3],
    /// Processor architecture, its threads, operating system.
    pub machine: String,
    /// Vector instructions, on which the last bits of every number depend; empty in old runs.
    #[serde(default)]
    pub instructions: String,
    /// Every setting, the seed included.
    pub config: Config,
}

impl Manifest {
    /// Describes a request.
    ///
    /// # Errors
    /// When the capture or one of its files cannot be read.
    pub fn new(
        request: &RunRequest,
        method: &MethodChoice,
        capture: &dyn Capture,
        frames: &Range<usize>,
        device: String,
    ) -> Result<Self> {
        let path = std::fs::canonicalize(&request.capture)
            .with_context(|| format!("no capture at {}", request.capture.display()))?;
        for named in [Some(&path), request.first_frame.as_ref()].into_iter().flatten() {
            ensure!(named.to_str().is_some(), "{} is not UTF-8: rename the folder", named.display());
        }
        Ok(Self {
            capture: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            capture_path: path,
            frames: frames.clone(),
            method: method.clone(),
            train_views: request.train_views.clone(),
            first_frame: request.first_frame.as_deref().map(absolute),
            first_frame_digest: digest_of_first(request, frames.start)?,
            refine_first: request.refine_first,
            segment_length: None,
            device,
            version: VERSION.into(),
            capture_digest: capture_digest(capture)?,
            origin: capture.origin().to_array(),
            machine: format!(
                "{} {}, {} threads",
                std::env::consts::OS,
                std::env::consts::ARCH,
                rayon::current_num_threads()
            ),
            instructions: instruction_set().into(),
            config: request.config,
        })
    }

    /// Takes the output folder for this run: an empty one, or on resume one that the same run began.
    ///
    /// # Errors
    /// When the folder holds another run, or cannot be written.
    pub(crate) fn claim(&self, folder: &RunFolder, resume: bool) -> Result<()> {
        let (file, out) = (folder.manifest(), folder.0.display());
        if file.exists() {
            let other = read_json(&file)?;
            let differences = self.differences(&other);
            ensure!(
                differences.is_empty(),
                "{out} holds another run: {}; choose another --out or remove the folder",
                differences.join("; ")
            );
            self.other_instructions(&other).into_iter().for_each(|words| tracing::warn!("{out}: {words}"));
        }
        if folder.has_finished_frames() {
            ensure!(resume, "{out} holds finished frames; add --resume, or choose another --out");
            ensure!(
                file.exists(),
                "{out} holds finished frames but no run.json, which says what they are of; bring it back or choose \
                 another --out"
            );
        }
        write_json(&file, self)
    }

    /// What is said when frames were made with other instructions: their numbers differ in the last bits, and nothing else.
    fn other_instructions(&self, other: &Self) -> Option<String> {
        let (there, here) = (&other.instructions, &self.instructions);
        (!there.is_empty() && there != here).then(|| {
            format!(
                "its frames were made with the instructions {there}, those to come are made with {here}: the last bits \
                 differ from those of one machine (FFGS_SIMD chooses instructions)"
            )
        })
    }

    /// What keeps this run from going on with `other`, a setting each. Threads and the last frame may differ: results do
    /// not depend on them. So may the places of the capture and of the first frame when their content is the same.
    fn differences(&self, other: &Self) -> Vec<String> {
        let mut same = other.clone();
        (same.machine, same.instructions) = (self.machine.clone(), self.instructions.clone());
        same.frames.end = self.frames.end;
        if other.capture_digest.is_empty() || other.capture_digest == self.capture_digest {
            same.capture_digest.clone_from(&self.capture_digest);
        }
        if other.capture_digest == self.capture_digest {
            (same.capture, same.capture_path) = (self.capture.clone(), self.capture_path.clone());
        }
        same.first_frame = other.first_frame.as_deref().map(absolute);
        let [theirs, ours] = [other, self].map(|manifest| &manifest.first_frame_digest);
        if theirs == ours && !ours.is_empty() {
            same.first_frame.clone_from(&self.first_frame);
        }
        if theirs.is_empty() || ours.is_empty() {
            same.first_frame_digest.clone_from(ours);
        }
        different_settings(&same, self)
    }

    /// Refuses a first frame of another capture, and warns of other settings that the first frame depends on.
    ///
    /// # Errors
    /// When that run is of another capture, or none.
    pub(crate) fn check_first_frame(&self, run: &RunFolder) -> Result<()> {
        let other: Self = read_json(&run.manifest()).context("--first-frame: not a run")?;
        let known = !other.capture_digest.is_empty();
        let same = if known {
            other.capture_digest == self.capture_digest
        } else {
            other.capture_path == self.capture_path
        };
        let out = run.0.display();
        ensure!(same, "--first-frame: {out} is a run of another capture, or its capture has changed since");
        let mut theirs = self.clone();
        theirs.config.first_frame = other.config.first_frame;
        (theirs.config.seed, theirs.config.sky_face_size) = (other.config.seed, other.config.sky_face_size);
        theirs.train_views = other.train_views;
        for difference in different_settings(&theirs, self) {
            tracing::warn!("the first frame is that of {out}: {difference}");
        }
        Ok(())
    }

    /// For the report.
    pub fn facts(&self) -> Vec<Fact> {
        let fact = |name: &str, value: String| Fact { name: name.into(), value };
        let origin = self.origin.map(|x| x.to_string()).join(", ");
        let far = self.origin != [0.0; 3];
        let mut facts = vec![
            fact("program", format!("ffgs {}", self.version)),
            fact("machine", self.machine.clone()),
            fact("instructions", self.instructions.clone()),
            fact("device", self.device.clone()),
            fact("frames", format!("{}..{}", self.frames.start, self.frames.end)),
            fact("method", self.method.to_string()),
            fact("seed", self.config.seed.to_string()),
        ];
        facts.extend(far.then(|| fact("origin of positions (m)", origin)));
        facts
    }
}

/// `KEY is A there and B here` for every value that differs.
fn different_settings(there: &Manifest, here: &Manifest) -> Vec<String> {
    // Texts, numbers and lists alone, as `write_json` relies on too.
    let [there, here] = [there, here].map(|manifest| serde_json::to_value(manifest).unwrap_or_default());
    let mut found = BTreeMap::new();
    leaves("", &there, &mut |key, value| {
        found.insert(key.to_owned(), value.clone());
    });
    let mut differences = Vec::new();
    leaves("", &here, &mut |key, value| {
        let before = found.remove(key).unwrap_or_default();
        if before != *value {
            let key = key.strip_prefix("config.").unwrap_or(key);
            differences.push(format!("{key} is {before} there and {value} here"));
        }
    });
    // What was asked for there alone.
    differences.extend(found.iter().map(|(key, value)| format!("{key} is {value} there and not set here")));
    differences
}

/// The folder by its whole path; one that is not there as it was named.
fn absolute(folder: &Path) -> PathBuf {
    std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned())
}

fn digest_of_first(request: &RunRequest, frame: usize) -> Result<String> {
    let state = request.first_frame.as_ref().map(|run| RunFolder(run.clone()).state(frame));
    state.filter(|state| state.is_file()).map_or(Ok(String::new()), |state| file_digest(&state))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest() -> Manifest {
        Manifest {
            capture: "mini".into(),
            capture_path: "/captures/mini".into(),
            frames: 0..4,
            method: MethodChoice::default(),
            train_views: None,
            first_frame: None,
            first_frame_digest: String::new(),
            refine_first: None,
            segment_length: None,
            device: "CPU".into(),
            version: VERSION.into(),
            capture_digest: "0123abcd".into(),
            origin: [0.0; 3],
            machine: "a machine".into(),
            instructions: "avx2".into(),
            config: Config::default(),
        }
    }

    fn differing(change: impl FnOnce(&mut Manifest)) -> Vec<String> {
        let mut there = manifest();
        change(&mut there);
        manifest().differences(&there)
    }

    #[test]
    fn what_decides_the_result_keeps_a_run_from_going_on() {
        assert_eq!(differing(|there| there.config.seed = 9), ["seed is 9 there and 1 here"]);
        let method = differing(|there| there.method = "none".parse().unwrap());
        assert_eq!(method, ["method is \"none\" there and \"trackers\" here"]);
        assert_eq!(differing(|there| there.capture_digest = "ffff0000".into()).len(), 1);
        assert_eq!(differing(|there| there.frames.start = 1), ["frames.start is 1 there and 0 here"]);
    }

    /// What one run alone asked for is a difference from both sides.
    #[test]
    fn what_is_left_out_is_a_difference() {
        let told = differing(|there| there.refine_first = Some(50));
        assert_eq!(told, ["refine_first is 50 there and not set here"]);
        let refined = Manifest { refine_first: Some(50), ..manifest() };
        assert_eq!(refined.differences(&manifest()), ["refine_first is null there and 50 here"]);
        assert_eq!(refined.differences(&refined), [""; 0]);
        assert_eq!(differing(|there| there.segment_length = Some(9)).len(), 1, "a joined run");
    }

    #[test]
    fn a_first_frame_is_known_by_its_content_wherever_it_lies() {
        let from = |path: &str, digest: &str| Manifest {
            first_frame: Some(path.into()),
            first_frame_digest: digest.into(),
            ..manifest()
        };
        let differences = |a: (&str, &str), b: (&str, &str)| from(b.0, b.1).differences(&from(a.0, a.1));
        assert_eq!(differences(("/a", "1-2"), ("/moved", "1-2")), [""; 0]);
        assert_eq!(differences(("/a", "1-2"), ("/a", "3-4")).len(), 1, "made again since");
        assert_eq!(differences(("/a", ""), ("/a", "3-4")), [""; 0], "of an old run");
        assert_eq!(differences(("/a", ""), ("/b", "3-4")).len(), 1);
        let here = std::env::current_dir().unwrap();
        let spelt = (here.to_str().unwrap(), ".");
        assert_eq!(differences((spelt.1, ""), (spelt.0, "")), [""; 0], "another spelling of one folder");
    }

    #[test]
    fn what_decides_nothing_may_differ() {
        assert!(differing(|there| there.machine = "another".into()).is_empty());
        assert!(differing(|there| there.instructions = "scalar".into()).is_empty());
        assert!(differing(|there| there.frames.end = 2).is_empty());
        assert!(differing(|there| there.capture_path = "/moved/mini".into()).is_empty());
        assert!(differing(|there| there.capture_digest = String::new()).is_empty(), "runs before the digest");
    }

    #[test]
    fn other_instructions_are_told() {
        let with = |instructions: &str| Manifest { instructions: instructions.into(), ..manifest() };
        let told = with("avx2").other_instructions(&with("avx512")).unwrap();
        assert!(told.contains("instructions avx512") && told.contains("made with avx2"), "{told}");
        assert_eq!(with("avx2").other_instructions(&with("avx2")), None);
        assert_eq!(with("avx2").other_instructions(&with("")), None, "runs before the name");
    }

    #[test]
    fn a_folder_is_claimed_once_and_by_its_own_run() {
        let root = tempfile::tempdir().unwrap();
        let folder = RunFolder(root.path().to_owned());
        manifest().claim(&folder, false).unwrap();
        assert_eq!(read_json::<Manifest>(&folder.manifest()).unwrap(), manifest());
        std::fs::create_dir_all(folder.frame(0)).unwrap();
        manifest().claim(&folder, false).unwrap();
        std::fs::write(folder.state(0), "x").unwrap();
        let refused = manifest().claim(&folder, false).unwrap_err().to_string();
        assert!(refused.contains("add --resume"), "{refused}");
        manifest().claim(&folder, true).unwrap();
        let mut other = manifest();
        other.config.seed = 2;
        let refused = other.claim(&folder, true).unwrap_err().to_string();
        assert!(refused.contains("holds another run: seed is 1 there and 2 here"), "{refused}");
        std::fs::remove_file(folder.manifest()).unwrap();
        let refused = manifest().claim(&folder, true).unwrap_err().to_string();
        assert!(refused.contains("no run.json"), "{refused}");
    }

    #[test]
    fn a_first_frame_is_of_the_same_capture() {
        let root = tempfile::tempdir().unwrap();
        let folder = RunFolder(root.path().to_owned());
        write_json(&folder.manifest(), &manifest()).unwrap();
        let mut here = manifest();
        (here.config.seed, here.capture_path) = (5, "/moved".into());
        here.check_first_frame(&folder).unwrap();
        here.capture_digest = "ffff0000".into();
        assert!(here.check_first_frame(&folder).unwrap_err().to_string().contains("another capture"));
    }
}
