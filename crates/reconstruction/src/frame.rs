//! The sequence of a frame. Read this file first: each step that it names has a file of its own.
//!
//! ```text
//! frame 0   photographs -> train all Gaussians -> remove exposures -> split by masks -> learn information -> continue surfaces behind what moves
//! frame t   state of t-1, photographs of t
//!           -> follow the light -> mark again -> predict (the method) -> keep what stopped -> add newborn -> leave out what is covered or stands before it
//!           -> dynamic, static and sky lane -> disocclusion -> learn information -> state of t
//! ```

use crate::birth::warn_if_all_are_gone;
use crate::exposures::Exposures;
use crate::first_training::{Earlier, FirstViews};
use crate::knowledge::{Predicted, learn};
use crate::lanes::FrameStart;
use crate::reconstructor::{Reconstructor, State};
use crate::reduced::Reduced;
use crate::stops::Moving;
use anyhow::{Context, Result};
use ffgs_core::{Scene, StageLog, TrainingView};
use ffgs_method::{Finetuning, Step};
use ffgs_trainer::DynamicLaneConfig;

impl Reconstructor<'_> {
    /// Frame 0, or the first frame of a run: all Gaussians are trained together from the capture's points, or taken from `earlier`, and
    /// split into layers.
    ///
    /// # Errors
    /// When the capture has no initial points, masks do not fit their cameras, or the method or the device fails.
    pub fn first_frame(
        &mut self,
        frame: usize,
        mut photographs: FirstViews,
        earlier: Option<Earlier>,
        log: &mut StageLog,
    ) -> Result<State> {
        let finetune = earlier.as_ref().and_then(|earlier| earlier.finetune);
        let (mut scene, exposures) = match earlier {
            Some(earlier) => self.take_earlier(earlier, &mut photographs)?,
            None => self.train_first(&mut photographs, log)?,
        };
        if scene.dynamic.knowledge.information.is_empty() {
            let coarse = self.reduced(&scene, &photographs.views);
            learn(&mut scene, None, &coarse, log);
        }
        self.continue_surfaces(&mut scene, &photographs.views, log)?;
        self.find_hidden(&mut scene, &photographs.views)?;
        let mut state = State::new(scene, photographs.into_training(), exposures);
        if let Some(iterations) = finetune {
            self.finetune_first(frame, &mut state, iterations, log)?;
        }
        self.method.begin(&state.scene).with_context(|| self.named("first frame"))?;
        Ok(state)
    }

    /// Frame t from t-1. `now` are the photographs of t as they were taken. `predicted` is called with the scene before it is trained, and the exposures
    /// of the frame: what it measures is the motion initialisation.
    ///
    /// # Errors
    /// When masks do not fit their cameras, or the method, the device or `predicted` fails.
    pub fn later_frame(
        &mut self,
        frame: usize,
        mut state: State,
        mut now: Vec<TrainingView>,
        log: &mut StageLog,
        predicted: &mut dyn FnMut(&Step, &Scene, &Exposures) -> Result<()>,
    ) -> Result<State> {
        self.follow_light(frame, &mut state, &mut now, log)?;
        let moved = state.scene.dynamic.gaussians.len();
        if self.config.marking.every_frame && self.method.births() {
            self.mark_again(&mut state, log)?;
        }
        let keeps_stopped = self.config.marking.second_chance && self.method.births();
        let moving = keeps_stopped.then(|| Moving::of(&state.scene.dynamic));
        let before = std::mem::take(&mut state.views);
        let coarse = self.reduced(&state.scene, &now);
        let coarse_before = Reduced::new(&before, coarse.factor);
        let step = self.step(frame, [&before, &now], [&coarse_before, &coarse]);
        let prediction = self.method.predict(&step, &mut state.scene, log);
        prediction.with_context(|| self.named(&format!("prediction of frame {frame}")))?;
        state.scene.take_back();
        if let Some(moving) = moving {
            self.keep_stopped(&moving, &mut state, &now, log)?;
        }
        predicted(&step, &state.scene, &state.exposures)?;
        if self.method.births() {
            self.add_newborn(frame, &mut state.scene, &coarse.views, log)?;
            warn_if_all_are_gone(moved, &state.scene, &now, log);
        }
        let known = Predicted::new(&state.scene, &self.config.dynamic);
        let finetuning = self.method.finetune(&step, &mut state.scene, log);
        match finetuning.with_context(|| self.named(&format!("finetuning of frame {frame}")))? {
            Finetuning::ByLanes => {
                let prior = known.as_ref().map(Predicted::prior);
                let left_out = self.find_left_out(&state.scene, &coarse.views, log)?;
                let start = FrameStart {
                    frame,
                    dynamic_lane: self.config.dynamic,
                    prior,
                    views: &now,
                    coarse: &coarse,
                    left_out: &left_out.all,
                    trains_background: frame.is_multiple_of(self.config.background.every),
                };
                self.train_lanes(&start, &mut state, log)?;
                self.train_disoccluded(frame, &mut state, &now, log)?;
                self.remove_denied(frame, &mut state, &left_out.denied, log);
                learn(&mut state.scene, known.as_ref(), &coarse, log);
            }
            Finetuning::Done => {}
        }
        state.views = now;
        Ok(state)
    }

    /// Finetunes a first frame that was trained less.
    fn finetune_first(
        &self,
        frame: usize,
        state: &mut State,
        iterations: usize,
        log: &mut StageLog,
    ) -> Result<()> {
        let dynamic_lane = DynamicLaneConfig { iterations, ..self.config.dynamic };
        let known = Predicted::new(&state.scene, &dynamic_lane);
        let prior = known.as_ref().map(Predicted::prior);
        let views = std::mem::take(&mut state.views);
        let coarse = &self.reduced(&state.scene, &views);
        let left_out = self.find_left_out(&state.scene, &coarse.views, log)?;
        let start = FrameStart {
            frame,
            dynamic_lane,
            prior,
            views: &views,
            coarse,
            left_out: &left_out.all,
            trains_background: true,
        };
        self.train_lanes(&start, state, log)?;
        learn(&mut state.scene, known.as_ref(), coarse, log);
        state.views = views;
        Ok(())
    }
}
