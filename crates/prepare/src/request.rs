//! What is to be prepared, from which footage, into which capture.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::str::FromStr;

/// What to prepare, and how.
#[derive(Clone, Debug)]
pub struct Request {
    /// Folder of the footage.
    pub source: PathBuf,
    /// Folder of the capture.
    pub out: PathBuf,
    /// Name of the format; recognised when `None`.
    pub format: Option<String>,
    /// First frame of the footage.
    pub start: usize,
    /// Frames of the capture; all when `None`.
    pub count: Option<usize>,
    /// Every n-th frame is taken.
    pub every: NonZeroUsize,
    /// Size of the new images in parts of the old, in (0, 1].
    pub scale: f64,
    /// By camera (a name as the calibration or as the capture spells it), frames of its own video that come before the common start; negative when it starts late.
    pub offsets: BTreeMap<String, i64>,
    /// Metres in one unit of the calibration; the format's own when `None`.
    pub metres_per_unit: Option<f64>,
    /// Which cameras are held out.
    pub test: TestCameras,
    /// Folder with pictures or videos of the empty scene, named as the cameras; masks are then made from these.
    pub clean_plates: Option<PathBuf>,
    /// The steps to take; all when empty.
    pub only: Vec<Step>,
    /// The steps whose results are thrown away and made again.
    pub force: Vec<Step>,
    /// Networks that track too: files of descriptions, or `NAME=MODEL.onnx`.
    pub networks: Vec<String>,
}

impl Request {
    /// Everything, with the settings of an empty command line.
    pub fn new(source: PathBuf, out: PathBuf) -> Self {
        Self {
            source,
            out,
            format: None,
            start: 0,
            count: None,
            every: NonZeroUsize::MIN,
            scale: 1.0,
            offsets: BTreeMap::new(),
            metres_per_unit: None,
            test: TestCameras::default(),
            clean_plates: None,
            only: Vec::new(),
            force: Vec::new(),
            networks: Vec::new(),
        }
    }

    /// Whether a step is wanted.
    pub fn wants(&self, step: Step) -> bool {
        self.only.is_empty() || self.only.contains(&step)
    }
}

/// A step of the preparation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Step {
    /// Extraction, undistortion and the camera lists.
    Pictures,
    /// Foreground masks.
    Masks,
    /// Initial points.
    Points,
    /// Tracks from frame to frame.
    Tracks,
}

impl Step {
    /// All steps in their order.
    pub const ALL: [Self; 4] = [Self::Pictures, Self::Masks, Self::Points, Self::Tracks];

    /// Grows when the step's results become better, so that captures that were prepared before can be told.
    pub(crate) fn version(self) -> u32 {
        match self {
            Self::Pictures => 0,
            // What is seen behind other things has points (docs/adr/0095-what-views-look-through-stands-behind.md).
            Self::Points => 1,
            // Tracks have neighbours that agree (docs/adr/0091-tracks-need-neighbours-that-agree.md), and corners in masks where texture is faint
            // (docs/adr/0098-in-masks-what-can-be-followed-is-a-corner.md).
            Self::Tracks => 2,
            // Each of a few views asks the others for its mask (docs/adr/0097-each-of-a-few-views-asks-the-others.md), what stands and sways
            // is found (docs/adr/0102-what-is-enclosed-and-does-not-lie-still-moves.md), and a background that never changed is right
            // (docs/adr/0104-a-background-that-never-changed-is-right.md).
            Self::Masks => 3,
        }
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Pictures => "pictures",
            Self::Masks => "masks",
            Self::Points => "points",
            Self::Tracks => "tracks",
        })
    }
}

impl FromStr for Step {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|s| s.to_string() == text);
        known.ok_or_else(|| format!("'{text}' is none of pictures, masks, points, tracks"))
    }
}

/// Which cameras are held out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum TestCameras {
    /// Those of the format; else, of 16 cameras and more, every eighth.
    #[default]
    Usual,
    /// None.
    None,
    /// Every n-th, the first included.
    Every(usize),
    /// These.
    Named(Vec<String>),
}

impl FromStr for TestCameras {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.strip_prefix("every:")) {
            ("none", _) => Ok(Self::None),
            (_, Some(n)) => match n.parse() {
                Ok(n) if n >= 2 => Ok(Self::Every(n)),
                _ => Err(format!("'{n}' is not a number of at least 2")),
            },
            _ => Ok(Self::Named(text.split(',').map(|name| name.trim().to_owned()).collect())),
        }
    }
}
