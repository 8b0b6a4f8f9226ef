//! The training of frame 0: a trial where cameras are few, all Gaussians together, from its middle on in one exposure, then the split.

use crate::exposures::Exposures;
use crate::few_views::{self, trial};
use crate::initial_points::start;
use crate::marking::split;
use crate::reconstructor::Reconstructor;
use crate::sky::sky_or_none;
use anyhow::Result;
use ffgs_core::{Gaussians, Scene, SkyCube, StageLog, TrainingView, stage};
use ffgs_method::{Split, ViewAt};
use ffgs_trainer::{Equalise, FirstFrame, FirstFrameConfig, FirstFrameTask, camera_extent};
use std::time::Instant;

/// The training of few cameras' first frame without one of them, to the monitor and in the log.
const TRIAL: &str = "first frame without its middle view";

/// Photographs of a first frame.
pub struct FirstViews {
    /// Where each was taken: those of the training views, then those that only frame 0 has.
    pub shots: Vec<ViewAt>,
    /// As loaded, one per shot.
    pub views: Vec<TrainingView>,
}

/// A first frame that was reconstructed before.
pub struct Earlier {
    /// Its layers.
    pub scene: Scene,
    /// The exposures that were removed from its photographs.
    pub exposures: Exposures,
    /// Whether it is to be split into layers again, by the masks and the settings of now.
    pub split_again: bool,
    /// Iterations of finetuning, as a later frame is finetuned: for a frame that was trained less. `None` = it stays as it is.
    pub finetune: Option<usize>,
}

impl FirstViews {
    /// How many are of training views.
    fn training_count(&self) -> usize {
        self.shots.iter().filter(|at| at.split == Split::Train).count()
    }

    /// Those of the training views, which later frames have, too.
    fn training(&self) -> &[TrainingView] {
        &self.views[..self.training_count()]
    }

    /// As [`training`](Self::training), without the others.
    pub(crate) fn into_training(mut self) -> Vec<TrainingView> {
        self.views.truncate(self.training_count());
        self.views
    }
}

impl Reconstructor<'_> {
    /// Trains all Gaussians and splits them into layers. Where the exposures of the cameras differ, they are removed from `photographs`.
    pub(crate) fn train_first(
        &self,
        photographs: &mut FirstViews,
        log: &mut StageLog,
    ) -> Result<(Scene, Exposures)> {
        self.warn_of_few_views(photographs, log)?;
        let (trained, exposures) = self.train_in_one_exposure(photographs, log)?;
        let sky = sky_or_none(trained.sky, &trained.gaussians, photographs.training());
        Ok((self.split((&trained.gaussians, 0), sky, photographs)?, exposures))
    }

    /// A first frame that was reconstructed before; its exposures are removed from `photographs`.
    pub(crate) fn take_earlier(
        &self,
        earlier: Earlier,
        photographs: &mut FirstViews,
    ) -> Result<(Scene, Exposures)> {
        let Earlier { mut scene, exposures, split_again, .. } = earlier;
        scene.take_back();
        exposures.remove(self.capture, &photographs.shots, &mut photographs.views)?;
        if split_again {
            let standing = scene.static_layer.len();
            scene = self.split((&scene.joint(), standing), scene.sky, photographs)?;
        }
        Ok((scene, exposures))
    }

    fn split(&self, all: (&Gaussians, usize), sky: SkyCube, photographs: &FirstViews) -> Result<Scene> {
        split(&self.config.marking, all, sky, photographs.training(), &photographs.views)
    }

    /// Few cameras: how far is the scene to be trusted between them?
    fn warn_of_few_views(&self, photographs: &FirstViews, log: &mut StageLog) -> Result<()> {
        let start = Instant::now();
        let mut train = |views: &[TrainingView]| {
            let config = self.first_config(views);
            let iterations = (few_views::STEPS * config.iterations as f32) as usize;
            // What comes and goes in the trial is of no interest.
            let log = &mut StageLog::default();
            self.train_all(TRIAL, &FirstFrameConfig { iterations, ..config }, views, &mut |_| None, log)
        };
        let FirstViews { shots, views } = photographs;
        if let Some(trial) = trial(self.config.first_frame.few_views, views, self.devices, &mut train)? {
            log.since(TRIAL, start);
            let left_out = shots[trial.view];
            let camera = &self.capture.views(left_out.split)[left_out.view];
            trial.warning(camera).into_iter().for_each(|warning| log.warn(warning));
        }
        Ok(())
    }

    /// Where the exposures of the cameras differ, they are removed from `photographs`, and the training goes on with these.
    fn train_in_one_exposure(
        &self,
        photographs: &mut FirstViews,
        log: &mut StageLog,
    ) -> Result<(FirstFrame, Exposures)> {
        let FirstViews { shots, views } = photographs;
        let (mut exposures, mut estimating) = (Exposures::default(), None);
        let mut equalise = |surfaces: &Gaussians| {
            if !self.config.first_frame.exposures {
                return None;
            }
            let start = Instant::now();
            exposures = Exposures::estimate(self.capture, shots, views, surfaces);
            estimating = Some(start.elapsed().as_secs_f64());
            if exposures.are_neutral() {
                return None;
            }
            let mut equal = views.clone();
            // A camera that cannot be read is told below.
            exposures.remove(self.capture, shots, &mut equal).ok()?;
            Some(equal)
        };
        let trained = self.train_all("first frame", &self.first_config(views), views, &mut equalise, log)?;
        estimating.into_iter().for_each(|seconds| log.add_seconds(stage::EXPOSURES, seconds));
        exposures.remove(self.capture, shots, views)?;
        Ok((trained, exposures))
    }

    /// How the first frame is trained on such photographs.
    fn first_config(&self, views: &[TrainingView]) -> FirstFrameConfig {
        let pixels = views.iter().map(|view| view.image.size().pixels()).sum();
        self.config.first_frame.for_photographs(views.len(), pixels)
    }

    /// One training of all Gaussians, from the capture's points.
    fn train_all(
        &self,
        name: &'static str,
        config: &FirstFrameConfig,
        views: &[TrainingView],
        equalise: Equalise,
        log: &mut StageLog,
    ) -> Result<FirstFrame> {
        let report = self.monitor.begin(name, config.iterations);
        let start = start(self.capture, &self.config, config.sh_degree, views)?;
        let task = FirstFrameTask { views, start, extent: camera_extent(views), seed: self.config.seed };
        self.devices.first_frame(config, task, equalise, log, &mut |p| report(p))
    }
}
