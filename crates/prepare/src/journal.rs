//! `prepare.json`: what was asked for and what was found out, so that a preparation can go on.

use crate::camera_lists::write_json;
use crate::{PrepareError, Request, Step};
use ffgs_calibration::{Footage, SourceCamera};
use ffgs_core::read_text;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Its name in the capture.
pub(crate) const FILE: &str = "prepare.json";
/// It holds a sentence per camera and step.
const MAX_JOURNAL_BYTES: u64 = 1 << 24;

/// The journal of a preparation.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Journal {
    /// What the pictures depend on.
    pub settings: BTreeMap<String, serde_json::Value>,
    /// Finished steps and the sentence that says what they did.
    pub steps: BTreeMap<Step, String>,
    /// Steps whose results are being removed, to be made again.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub to_clear: Vec<Step>,
    /// The versions of these steps; 0 without one.
    #[serde(default)]
    pub versions: BTreeMap<Step, u32>,
    /// The clean plates that the masks were made from.
    #[serde(default)]
    pub clean_plates: Option<PathBuf>,
    /// The calibration that the pictures were made by: the checksum of each camera.
    #[serde(default)]
    pub calibration: BTreeMap<String, u32>,
    /// Where the capture's origin lies in the calibration's world (its unit).
    pub origin: [f64; 3],
    /// Metres in a unit of the calibration.
    pub metres_per_unit: f64,
    /// What was taken for granted.
    pub assumed: Vec<String>,
    /// What was left out.
    pub skipped: Vec<String>,
}

impl Journal {
    /// Reads a journal.
    pub(crate) fn read(file: &Path) -> Result<Self, PrepareError> {
        let text = read_text(file, MAX_JOURNAL_BYTES).map_err(|e| PrepareError::io(file, e))?;
        serde_json::from_str(&text).map_err(|e| PrepareError::picture(file, e.to_string()))
    }

    /// The journal of the output folder, or a new one. A folder with something else in it is refused.
    pub(crate) fn open(request: &Request) -> Result<Self, PrepareError> {
        let file = path(&request.out);
        if !file.is_file() {
            let occupied =
                request.out.is_dir() && std::fs::read_dir(&request.out).is_ok_and(|mut d| d.next().is_some());
            let refuse =
                |reason: &str| PrepareError::Output { folder: request.out.clone(), reason: reason.into() };
            let new = Self { settings: settings(request), ..Self::default() };
            return if occupied {
                Err(refuse("the folder is not empty and not a capture that was prepared"))
            } else {
                Ok(new)
            };
        }
        let mut journal = Self::read(&file)?;
        let wanted = settings(request);
        let differs = wanted.iter().find(|(key, value)| journal.settings.get(*key) != Some(*value));
        if let Some((key, value)) = differs
            && !request.force.contains(&Step::Pictures)
        {
            let old = journal.settings.get(key).unwrap_or(&serde_json::Value::Null);
            let reason = format!(
                "its pictures were made with {}, now {} is asked for (--force pictures makes everything again)",
                told(key, old),
                told(key, value)
            );
            return Err(PrepareError::Output { folder: request.out.clone(), reason });
        }
        if request.force.contains(&Step::Pictures) {
            // Masks, points and tracks belong to their pictures.
            return Ok(Self { settings: wanted, to_clear: request.force.clone(), ..Self::default() });
        }
        journal.to_clear.extend(&request.force);
        let Self { steps, to_clear, .. } = &mut journal;
        steps.retain(|step, _| !to_clear.contains(step));
        journal.refuse_other_plates(request)?;
        Ok(journal)
    }

    /// Masks that are there were made from the clean plates that are asked for.
    fn refuse_other_plates(&self, request: &Request) -> Result<(), PrepareError> {
        let wanted = request.clean_plates.as_deref().map(absolute);
        if wanted.is_none() || wanted == self.clean_plates || !self.steps.contains_key(&Step::Masks) {
            return Ok(());
        }
        let reason = "its masks were not made from these clean plates; --force masks makes them again".into();
        Err(PrepareError::Output { folder: request.out.clone(), reason })
    }

    /// Pictures that are there were made by the calibration of now.
    pub(crate) fn refuse_other_calibration(
        &self,
        footage: &Footage,
        request: &Request,
    ) -> Result<(), PrepareError> {
        let (then, now) = (&self.calibration, checksums(footage));
        let camera = then.keys().chain(now.keys()).find(|name| then.get(*name) != now.get(*name));
        // Journals of before the checksums have none.
        let (Some(camera), false) = (camera, then.is_empty()) else { return Ok(()) };
        let differs = match (then.get(camera), now.get(camera)) {
            (Some(_), None) => "is no longer in the footage",
            (None, _) => "was not in the footage when the pictures were made",
            _ => "was calibrated otherwise when its pictures were made",
        };
        let reason = format!("camera '{camera}' {differs}; --force pictures makes everything again");
        Err(PrepareError::Output { folder: request.out.clone(), reason })
    }

    /// Writes the journal.
    pub(crate) fn save(&self, out: &Path) -> Result<(), PrepareError> {
        write_json(&path(out), &json!(self))
    }

    /// Notes a finished step.
    pub(crate) fn finish(&mut self, step: Step, text: String, out: &Path) -> Result<(), PrepareError> {
        self.steps.insert(step, text);
        self.versions.insert(step, step.version());
        self.save(out)
    }

    /// What a finished step did, and how to have the results of today where an older program did it.
    pub(crate) fn account(&self, step: Step) -> Option<String> {
        let text = self.steps.get(&step)?;
        Some(if self.is_older(step) {
            format!("{text}; made by an older version of this program (--force {step} makes them again)")
        } else {
            text.clone()
        })
    }

    /// Whether a step was finished by an older program, whose results were not those of today.
    pub(crate) fn is_older(&self, step: Step) -> bool {
        let version = self.versions.get(&step).copied().unwrap_or_default();
        self.steps.contains_key(&step) && version < step.version()
    }

    /// Notes each sentence once.
    pub(crate) fn assume(&mut self, sentences: &[String]) {
        add(&mut self.assumed, sentences);
    }

    /// Notes each sentence once.
    pub(crate) fn skip(&mut self, sentences: &[String]) {
        add(&mut self.skipped, sentences);
    }
}

/// A checksum of each camera's lens and poses.
pub(crate) fn checksums(footage: &Footage) -> BTreeMap<String, u32> {
    let checksum =
        |camera: &SourceCamera| crc32fast::hash(format!("{:?} {:?}", camera.lens, camera.poses).as_bytes());
    footage.cameras.iter().map(|camera| (camera.name.clone(), checksum(camera))).collect()
}

fn add(list: &mut Vec<String>, sentences: &[String]) {
    let new: Vec<String> = sentences.iter().filter(|s| !list.contains(s)).cloned().collect();
    list.extend(new);
}

fn path(out: &Path) -> PathBuf {
    out.join(FILE)
}

/// The folder by its whole path; one that is not there as it was named.
pub(crate) fn absolute(folder: &Path) -> PathBuf {
    std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned())
}

/// A setting as a user would name it.
fn told(key: &str, value: &serde_json::Value) -> String {
    if value.is_null() { format!("no --{key}") } else { format!("{key} = {value}") }
}

fn settings(request: &Request) -> BTreeMap<String, serde_json::Value> {
    let source = absolute(&request.source);
    let test = format!("{:?}", request.test);
    [
        ("source", json!(source)),
        ("start", json!(request.start)),
        ("count", json!(request.count)),
        ("every", json!(request.every)),
        ("scale", json!(request.scale)),
        ("offset", json!(request.offsets)),
        ("unit", json!(request.metres_per_unit)),
        ("format", json!(request.format)),
        ("test", json!(test)),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::TempDir;

    /// A journal of before there were versions, and one of now.
    #[test]
    fn results_of_older_programs_are_told() {
        let old = r#"{"settings": {}, "steps": {"pictures": "few", "points": "many"}, "origin": [0, 0, 0],
            "metres_per_unit": 1, "assumed": [], "skipped": []}"#;
        let mut journal: Journal = serde_json::from_str(old).unwrap();
        let account = |journal: &Journal, step| journal.account(step).unwrap();
        assert_eq!(account(&journal, Step::Pictures), "few");
        assert!(account(&journal, Step::Points).contains("--force points"));
        assert_eq!(journal.account(Step::Tracks), None);
        let older =
            |journal: &Journal| Step::ALL.into_iter().filter(|s| journal.is_older(*s)).collect::<Vec<_>>();
        assert_eq!(older(&journal), [Step::Points]);
        let folder = TempDir::new().unwrap();
        journal.finish(Step::Points, "many".to_owned(), folder.path()).unwrap();
        let read = Journal::read(&folder.path().join(FILE)).unwrap();
        assert_eq!(account(&read, Step::Points), "many");
        assert_eq!(older(&read), []);
    }
}
