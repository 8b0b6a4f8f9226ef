//! What a run is asked to do.

use crate::job::device::Device;
use crate::plugins::choice::MethodChoice;
use crate::settings::config::Config;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::str::FromStr;

/// What to run.
#[derive(Clone, Debug)]
pub struct RunRequest {
    /// Capture folder.
    pub capture: PathBuf,
    /// Output folder.
    pub out: PathBuf,
    /// Go on after the last finished frame.
    pub resume: bool,
    /// How the scene moves from frame to frame; `None` = the default, or for a single frame any.
    pub method: Option<MethodChoice>,
    /// Frames; `None` = all. The first is trained from the initial points.
    pub frames: Option<FrameRange>,
    /// Training cameras; `None` = all.
    pub train_views: Option<Vec<String>>,
    /// Take frame 0 from this run instead of training it.
    pub first_frame: Option<PathBuf>,
    /// Finetune the frame taken from `first_frame` for so many iterations, as a later frame is; `None` = leave it.
    pub refine_first: Option<usize>,
    /// Keep the Gaussians of every so many-th frame and of the last alone; `None` = of every frame.
    pub keep: Option<NonZeroUsize>,
    /// Most memory that it may take (MiB), else it does not start; `None` = what the machine has free.
    pub memory: Option<usize>,
    /// Where to compute.
    pub device: Device,
    /// No progress bars.
    pub quiet: bool,
    /// Everything else.
    pub config: Config,
}

/// Frames from `start` up to but not including `end`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameRange {
    /// First frame.
    pub start: usize,
    /// Frame behind the last; `None` = to the end.
    pub end: Option<usize>,
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not A..B, e.g. 0..4 for the frames 0 to 3");
        let (start, end) = text.split_once("..").ok_or_else(wrong)?;
        let number = |part: &str| match part {
            "" => Ok(None),
            digits => digits.parse().map(Some).map_err(|_| wrong()),
        };
        let range = Self { start: number(start)?.unwrap_or(0), end: number(end)? };
        match range.end {
            Some(end) if end <= range.start => Err(format!("'{text}' holds no frame")),
            _ => Ok(range),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_mean_nothing_are_refused() {
        assert_eq!("..3".parse(), Ok(FrameRange { start: 0, end: Some(3) }));
        assert_eq!("3..".parse(), Ok(FrameRange { start: 3, end: None }));
        for wrong in ["3", "3..3", "4..2", "a..b", "-1..2"] {
            assert!(wrong.parse::<FrameRange>().is_err(), "{wrong}");
        }
    }
}
