//! Rounds of masks: what one finds tells the next what stands still.

use super::View;
use super::change::Change;
use super::frame::masks_of;
use super::learnt::{Before, Learnt, learn};
use crate::PrepareError;
use crate::beside::Beside;
use crate::extraction::file_name;
use crate::pictures::read_mask;
use ffgs_core::Mask;
use ffgs_dataset::{Capture, write_mask};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Frames of the capture from which backgrounds are learnt. Each round makes the masks of these; those of the others follow once.
const SAMPLES: usize = 20;
/// From the second round on, backgrounds are learnt without what the one before found, and the colours of that count. There are so many
/// rounds at most, and none after one that changes less than this share of what the masks hold.
const MOST: usize = 6;
const SETTLED: f64 = 0.02;

/// What masks are made of, and the folder in which they are written.
pub(super) struct Rounds<'a> {
    pub capture: &'a Capture,
    pub views: &'a [View],
    pub beside: &'a Beside<'a>,
    pub folder: &'a Path,
}

/// What is known of each camera; nothing of one that moves.
type AllLearnt = Vec<Option<Learnt>>;

impl Rounds<'_> {
    /// Writes the masks of all frames. Where the `empty` scene was filmed with all cameras, one round tells all. `progress` gets what is
    /// done, and of how much.
    pub(super) fn make(&self, empty: bool, progress: &dyn Fn(usize, usize)) -> Result<(), PrepareError> {
        let frames = self.capture.frames();
        let samples = samples(frames);
        let others: Vec<usize> = (0..frames).filter(|frame| !samples.contains(frame)).collect();
        let most = if empty { 1 } else { MOST };
        let one = self.views.len() + samples.len();
        let all = most * one + others.len();
        let learnt = self.settled(&samples, most, &|round, done| progress(round * one + done, all))?;
        for (i, &frame) in others.iter().enumerate() {
            progress(most * one + i, all);
            self.write(frame, &masks_of(self.capture, self.views, &learnt, frame)?)?;
        }
        progress(all, all);
        Ok(())
    }

    /// What is known of each camera in the last round, which has written the masks of the `samples`.
    fn settled(
        &self,
        samples: &[usize],
        most: usize,
        progress: &dyn Fn(usize, usize),
    ) -> Result<AllLearnt, PrepareError> {
        let mut learnt = self.learn(samples, None)?;
        for round in 0.. {
            let mut change = Change::default();
            for (i, &frame) in samples.iter().enumerate() {
                progress(round, self.views.len() + i);
                let masks = masks_of(self.capture, self.views, &learnt, frame)?;
                if round > 0 {
                    change = change + self.change(frame, &masks)?;
                }
                self.write(frame, &masks)?;
            }
            if round > 0 {
                tracing::info!("masks, round {}: {:.1} % changed", round + 1, 100.0 * change.share());
            }
            if round + 1 == most || round > 0 && change.share() < SETTLED {
                break;
            }
            learnt = self.learn(samples, Some(&learnt))?;
        }
        Ok(learnt)
    }

    /// From the samples, with masks of them if there was a round `before`.
    fn learn(&self, samples: &[usize], before: Option<&AllLearnt>) -> Result<AllLearnt, PrepareError> {
        let one = |(v, view): (usize, &View)| {
            let before = before.map(|all| Before { folder: self.folder, learnt: all[v].as_ref() });
            learn(self.capture, view, samples, before, self.beside)
        };
        self.views.par_iter().enumerate().map(one).collect()
    }

    /// How the masks of a frame differ from those that were written before.
    fn change(&self, frame: usize, masks: &[Mask]) -> Result<Change, PrepareError> {
        let one = |(view, mask)| Ok(Change::between(&read_mask(&self.file(view, frame))?, mask));
        self.views.par_iter().zip(masks).map(one).try_reduce(Change::default, |a, b| Ok(a + b))
    }

    fn write(&self, frame: usize, masks: &[Mask]) -> Result<(), PrepareError> {
        let one = |(view, mask)| write_mask(&self.file(view, frame), mask);
        Ok(self.views.par_iter().zip(masks).try_for_each(one)?)
    }

    fn file(&self, view: &View, frame: usize) -> PathBuf {
        self.folder.join(file_name(&view.name, frame))
    }
}

/// Spread over so many frames; all of a few.
fn samples(frames: usize) -> Vec<usize> {
    let count = frames.min(SAMPLES);
    (0..count).map(|i| i * frames / count).collect()
}
