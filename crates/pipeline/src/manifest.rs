//! `run.json`: what was run, on what, with which settings.

use crate::choice::MethodChoice;
use crate::config::Config;
use crate::record::{RunFolder, read_json, write_json};
use crate::run::RunRequest;
use anyhow::{Context, Result, bail};
use ffgs_report::Fact;
use serde::{Deserialize, Serialize};
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
    /// Device.
    pub device: String,
    /// Program version.
    pub version: String,
    /// Processor architecture, its threads, operating system.
    pub machine: String,
    /// Every setting, the seed included.
    pub config: Config,
}

impl Manifest {
    /// Describes a request.
    pub fn new(request: &RunRequest, frames: &Range<usize>, device: String) -> Result<Self> {
        let path = std::fs::canonicalize(&request.capture)
            .with_context(|| format!("no capture at {}", request.capture.display()))?;
        Ok(Self {
            capture: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            capture_path: path,
            frames: frames.clone(),
            method: request.method.clone(),
            train_views: request.train_views.clone(),
            first_frame: request.first_frame.clone(),
            device,
            version: env!("CARGO_PKG_VERSION").into(),
            machine: format!(
                "{} {}, {} threads",
                std::env::consts::OS,
                std::env::consts::ARCH,
                rayon::current_num_threads()
            ),
            config: request.config,
        })
    }

    /// Takes the output folder for this run: an empty one, or on resume one that the same run began.
    pub fn claim(&self, folder: &RunFolder, resume: bool) -> Result<()> {
        let file = folder.manifest();
        if file.exists() {
            let other: Self = read_json(&file)?;
            if !self.continues(&other) {
                bail!(
                    "{} holds another run ({}, {}); choose another --out or remove the folder",
                    folder.0.display(),
                    other.capture,
                    other.method
                );
            }
            if !resume && has_frames(&folder.0) {
                bail!("{} holds finished frames; add --resume, or choose another --out", folder.0.display());
            }
        }
        write_json(&file, self)
    }

    /// Threads and the last frame may differ: results do not depend on them.
    fn continues(&self, other: &Self) -> bool {
        let mut same = other.clone();
        same.machine.clone_from(&self.machine);
        same.frames.end = self.frames.end;
        same == *self
    }

    /// For the report.
    pub fn facts(&self) -> Vec<Fact> {
        let fact = |name: &str, value: String| Fact { name: name.into(), value };
        vec![
            fact("program", format!("ffgs {}", self.version)),
            fact("machine", self.machine.clone()),
            fact("device", self.device.clone()),
            fact("frames", format!("{}..{}", self.frames.start, self.frames.end)),
            fact("method", self.method.to_string()),
            fact("seed", self.config.seed.to_string()),
        ]
    }
}

fn has_frames(folder: &Path) -> bool {
    std::fs::read_dir(folder.join("frames")).is_ok_and(|mut entries| entries.next().is_some())
}
