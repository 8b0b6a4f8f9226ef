//! The sequence of frames on a capture in memory: no file, no program, only the reconstructor and a method.

use ffgs_core::{Gaussians, StageLog, sigmoid, stage};
use ffgs_method::{Split, TrackSource, ViewAt};
use ffgs_motion::{MotionConfig, TrackerMotion};
use ffgs_reconstruction::{
    Devices, Earlier, Exposures, FirstViews, Monitor, ReconstructionConfig, Reconstructor, Report, Silent,
    State,
};
use ffgs_testkit::conformance::World;
use glam::DVec3;
use std::sync::Mutex;

const COUNT: usize = 120;
/// Part of the way that a Gaussian may be off: under a footprint the motion is a mean over depths.
const TOLERANCE: f64 = 0.2;
const VIEWS: [usize; 4] = [0, 1, 2, 3];

/// The photographs of the world are grey: everything is measured by the trackers, nothing is trained.
fn untrained() -> ReconstructionConfig {
    let mut config = ReconstructionConfig::default();
    config.dynamic.iterations = 0;
    config.birth.iterations = 0;
    config.background.static_iterations = 0;
    config.background.sky_iterations = 0;
    config
}

fn reconstructor<'a>(world: &'a World, tracks: &'a [Box<dyn TrackSource>]) -> Reconstructor<'a> {
    Reconstructor {
        config: untrained(),
        devices: Devices(&[]),
        capture: world,
        views: &VIEWS,
        tracks,
        method: Box::new(TrackerMotion { config: MotionConfig::default(), only: None, gpu: None }),
        method_name: "trackers".to_owned(),
        monitor: &Silent,
    }
}

/// The world's own first frame.
fn first(reconstructor: &mut Reconstructor, world: &World) -> State {
    let shots = VIEWS.map(|view| ViewAt { split: Split::Train, view, frame: 0 }).to_vec();
    let photographs = FirstViews { shots, views: world.training(0) };
    let scene = world.scene(&(0..COUNT).collect::<Vec<_>>());
    let earlier = Earlier { scene, exposures: Exposures::default(), split_again: false, finetune: None };
    reconstructor.first_frame(0, photographs, Some(earlier), &mut StageLog::default()).unwrap()
}

#[test]
fn each_frame_starts_from_the_state_of_the_one_before() {
    let world = World::new(COUNT, DVec3::new(0.03, 0.0, 0.01));
    let tracks = [world.tracker()];
    let mut reconstructor = reconstructor(&world, &tracks);
    let mut state = first(&mut reconstructor, &world);
    for frame in 1..=2 {
        let (mut log, mut asked) = (StageLog::default(), Vec::new());
        let mut predicted = |step: &ffgs_method::Step, scene: &ffgs_core::Scene, _: &Exposures| {
            asked.push((step.frame, scene.dynamic.gaussians.len()));
            Ok(())
        };
        let now = world.training(frame);
        state = reconstructor.later_frame(frame, state, now, &mut log, &mut predicted).unwrap();
        assert_eq!(asked, [(frame, COUNT)], "asked once, before the training");
        for (id, place) in state.scene.dynamic.ids.iter().zip(state.scene.dynamic.gaussians.positions()) {
            let truth = world.places[*id as usize] + frame as f64 * world.step;
            let error = place.distance(truth) / (frame as f64 * world.step.length());
            assert!(error < TOLERANCE, "frame {frame}, Gaussian {id}: {error} of the way");
        }
        for name in [stage::FUSION, stage::GROWTH, stage::BIRTH, stage::DYNAMIC, stage::INFORMATION] {
            assert!(log.seconds.contains_key(name), "{name}: {:?}", log.seconds.keys());
        }
    }
    assert_eq!(state.scene.dynamic.ids.len(), COUNT);
}

/// Notes the trainings that begin, with their steps.
#[derive(Default)]
struct Begun(Mutex<Vec<(&'static str, usize)>>);

impl Monitor for Begun {
    fn begin(&self, name: &'static str, iterations: usize) -> Report<'_> {
        self.0.lock().unwrap().push((name, iterations));
        Box::new(|_| {})
    }
}

#[test]
fn few_views_take_a_short_trial_and_a_short_first_frame() {
    let world = World::new(COUNT, DVec3::ZERO);
    let begun = Begun::default();
    let mut reconstructor = Reconstructor { monitor: &begun, ..reconstructor(&world, &[]) };
    reconstructor.config.first_frame.iterations = 100;
    let shots = VIEWS.map(|view| ViewAt { split: Split::Train, view, frame: 0 }).to_vec();
    let photographs = FirstViews { shots, views: world.training(0) };
    let mut log = StageLog::default();
    reconstructor.first_frame(0, photographs, None, &mut log).unwrap();
    let trial = "first frame without its middle view";
    assert_eq!(*begun.0.lock().unwrap(), [(trial, 15), ("first frame", 35)]);
    assert!(
        log.seconds.contains_key(trial) && log.seconds.contains_key(stage::EXPOSURES),
        "{:?}",
        log.seconds
    );
}

#[test]
fn the_background_is_trained_in_the_frames_that_are_due() {
    let world = World::new(COUNT, DVec3::ZERO);
    let (tracks, begun) = ([world.tracker()], Begun::default());
    let mut reconstructor = Reconstructor { monitor: &begun, ..reconstructor(&world, &tracks) };
    reconstructor.config.background.every = 2;
    let mut state = first(&mut reconstructor, &world);
    for frame in 1..=4 {
        let (static_layer, sky) = (state.scene.static_layer.clone(), state.scene.sky.clone());
        begun.0.lock().unwrap().clear();
        let (now, log) = (world.training(frame), &mut StageLog::default());
        state = reconstructor.later_frame(frame, state, now, log, &mut |_, _, _| Ok(())).unwrap();
        let passes = begun.0.lock().unwrap().iter().find(|(name, _)| *name == stage::STATIC).unwrap().1;
        assert_eq!(passes > 0, frame % 2 == 0, "frame {frame}");
        if frame % 2 == 1 {
            assert!(state.scene.static_layer == static_layer && state.scene.sky == sky, "frame {frame}");
        }
    }
}

#[test]
fn an_error_of_the_caller_ends_the_frame() {
    let world = World::new(COUNT, DVec3::ZERO);
    let tracks = [world.tracker()];
    let mut reconstructor = reconstructor(&world, &tracks);
    let state = first(&mut reconstructor, &world);
    let mut fails =
        |_: &ffgs_method::Step, _: &ffgs_core::Scene, _: &Exposures| anyhow::bail!("the disk is full");
    let ended = reconstructor.later_frame(1, state, world.training(1), &mut StageLog::default(), &mut fails);
    assert_eq!(ended.err().unwrap().to_string(), "the disk is full");
}

#[test]
fn what_stands_before_a_thing_that_is_seen_is_left_out_and_goes_in_a_round() {
    let world = World::new(COUNT, DVec3::new(0.03, 0.0, 0.01));
    let tracks = [world.tracker()];
    let mut reconstructor = reconstructor(&world, &tracks);
    reconstructor.config.disocclusion.every = 2;
    reconstructor.config.marking.dilation = 0;
    let mut state = first(&mut reconstructor, &world);
    // Wide enough to be a body without gaps.
    state.scene.dynamic.gaussians.log_scales.fill([0.1_f32.ln(); 3]);
    let centre = world.places.iter().sum::<DVec3>() / COUNT as f64;
    let before = (centre + world.training(0)[0].camera.center()) / 2.0;
    let aside = centre + 100.0 * world.step;
    let mut layer = Gaussians::zeros(2, 0);
    layer.means = [before, aside].map(|place| place.as_vec3().to_array()).to_vec();
    layer.log_scales.fill([-5.0; 3]);
    state.scene.static_layer = layer.into();
    state.scene.hidden = vec![0; 2];
    for (frame, gone) in [(1, false), (2, true)] {
        let (now, mut log) = (world.training(frame), StageLog::default());
        state = reconstructor.later_frame(frame, state, now, &mut log, &mut |_, _, _| Ok(())).unwrap();
        let opacities = |state: &State| [0, 1].map(|i| sigmoid(state.scene.static_layer.opacity_logits[i]));
        assert!(opacities(&state)[0] < 1e-3, "frame {frame}: it is not drawn");
        assert_eq!(opacities(&state)[1], 0.5, "frame {frame}: the other one is");
        let told = log.skips.iter().filter(|(what, _)| what.contains("before what moves"));
        assert_eq!(told.map(|(_, count)| *count).sum::<u64>(), 1, "frame {frame}: {:?}", log.skips);
        assert_eq!(log.changes.contains_key("stood before what moves"), gone, "frame {frame}");
        state.scene.take_back();
        assert_eq!(opacities(&state)[0] < 1e-3, gone, "frame {frame}");
    }
}
