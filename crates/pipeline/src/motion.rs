//! Motion initialisation of one frame: Algorithm 1, lines 3 to 42.

use crate::cli::Init;
use crate::config::Config;
use crate::frame::TrainViews;
use crate::turn::turn;
use anyhow::Result;
use ffgs_core::{Camera, DenseMotion, EstimateStatus, Estimates, Gaussians, Mask, Observations, ViewMotion};
use ffgs_fusion::{
    DensifyConfig, FusionInput, InformationFuser, MotionFuser, ProcessNoise, apply_densification,
    count_views, plan_densification, second_chance, spatial_objects, validate,
};
use ffgs_rasterizer::{Background, CpuRasterizer, FootprintSums, RenderOptions, RenderTape, TileMask, View};
use ffgs_report::StageSeconds;
use ffgs_tracks::TrackStore;
use ffgs_trainer::TrainingView;
use ffgs_triangulation::{Triangulator, WeightedRays};
use ffgs_voronoi::{agreement, densify_view};
use glam::{DMat3, DVec2, DVec3};
use std::collections::BTreeMap;
use std::time::Instant;

/// The moving layer and how sure its positions are.
#[derive(Clone, Debug, Default)]
pub struct Dynamic {
    /// The Gaussians.
    pub gaussians: Gaussians,
    /// Position covariances (m^2).
    pub covariances: Vec<DMat3>,
    /// Process noise of the last fused frame (m).
    pub q: f64,
    /// Steps of the last initialisation (m); empty before the first.
    pub steps: Vec<DVec3>,
}

/// What a frame's initialisation needs besides the layer itself.
pub struct MotionInput<'a> {
    /// Configuration.
    pub config: &'a Config,
    /// Trackers.
    pub init: &'a Init,
    /// Track files; `None` when the capture has none.
    pub tracks: Option<&'a TrackStore>,
    /// Views used.
    pub views: &'a TrainViews,
    /// Training views at t - 1.
    pub before: &'a [TrainingView],
    /// Training views at t.
    pub now: &'a [TrainingView],
    /// t.
    pub frame: usize,
    /// The static layer, which hides parts of the dynamic one.
    pub static_layer: &'a Gaussians,
}

/// Counts and pictures' data of one frame's initialisation.
#[derive(Clone, Debug, Default)]
pub struct MotionOutcome {
    /// Seconds a stage.
    pub seconds: StageSeconds,
    /// Counted skips: what, how often.
    pub skips: BTreeMap<String, u64>,
    /// Warnings.
    pub warnings: Vec<String>,
    /// Positions at t - 1 of the Gaussians that are left (m).
    pub previous: Vec<DVec3>,
}

impl MotionOutcome {
    fn skip(&mut self, what: String, count: usize) {
        if count > 0 {
            *self.skips.entry(what).or_default() += count as u64;
        }
    }
}

fn add_seconds(total: &mut Option<f64>, since: Instant) {
    *total = Some(total.unwrap_or(0.0) + since.elapsed().as_secs_f64());
}

/// Positions in f64.
pub fn positions(gaussians: &Gaussians) -> Vec<DVec3> {
    gaussians.means.iter().map(|m| DVec3::from_array(m.map(f64::from))).collect()
}

/// Moves `dynamic` from t - 1 to t, removes what left the masks, and splits where the position is uncertain.
pub fn initialise(input: &MotionInput, dynamic: &mut Dynamic) -> Result<MotionOutcome> {
    let mut outcome = MotionOutcome { previous: positions(&dynamic.gaussians), ..MotionOutcome::default() };
    if *input.init == Init::None || dynamic.gaussians.is_empty() {
        return Ok(outcome);
    }
    let observations = observe(input, &dynamic.gaussians, &mut outcome, &mut |_, _| {})?;
    let estimates = triangulate(input, &observations, &mut outcome)?;
    fuse(input, &estimates, dynamic, &mut outcome)?;
    validate_positions(input, dynamic, &mut outcome)?;
    densify(input, dynamic, &mut outcome);
    Ok(outcome)
}

/// Trackers used, as indices into the store.
pub fn selected_trackers(input: &MotionInput, outcome: &mut MotionOutcome) -> Vec<usize> {
    let Some(store) = input.tracks else {
        outcome
            .warnings
            .push("the capture has no tracks/tracks.json: nothing moves the dynamic layer".into());
        return Vec::new();
    };
    let named = |name: &str| match input.init {
        Init::Fused => true,
        Init::None => false,
        Init::Tracker(only) => only == name,
    };
    (0..store.trackers().len()).filter(|&l| named(&store.trackers()[l].name)).collect()
}

/// Lines 3 to 19: motion fields view by view (so that memory does not grow with the views), agreement, association.
/// `inspect` sees each view's index and fields.
pub fn observe(
    input: &MotionInput,
    gaussians: &Gaussians,
    outcome: &mut MotionOutcome,
    inspect: &mut dyn FnMut(usize, &[DenseMotion]),
) -> Result<Vec<Observations>> {
    let trackers = selected_trackers(input, outcome);
    let n = gaussians.len();
    let mut observations = vec![Observations::unobserved(input.before.len(), n); trackers.len()];
    let mut joint = gaussians.clone();
    joint.extend(input.static_layer);
    let mut scratch = (RenderTape::default(), FootprintSums::default());
    let previous = outcome.previous.clone();
    for (v, view) in input.before.iter().enumerate().filter(|(_, view)| view.mask.count() > 0) {
        let fields = motion_fields(input, &trackers, v, &view.mask, outcome)?;
        inspect(v, &fields);
        let start = Instant::now();
        associate(input, view, &joint, &fields, &mut scratch);
        let at = ObservedView { config: input.config, camera: &view.camera, view: v, previous: &previous };
        at.fill(&scratch.1, &mut observations);
        add_seconds(&mut outcome.seconds.association, start);
    }
    Ok(observations)
}

fn motion_fields(
    input: &MotionInput,
    trackers: &[usize],
    view: usize,
    mask: &Mask,
    outcome: &mut MotionOutcome,
) -> Result<Vec<DenseMotion>> {
    let Some(store) = input.tracks else { return Ok(Vec::new()) };
    let camera = &input.views.selected[view].1;
    let mut fields = Vec::with_capacity(trackers.len());
    for &l in trackers {
        let start = Instant::now();
        let loaded = store.load_counted(l, camera, input.frame, mask.size())?;
        add_seconds(&mut outcome.seconds.load, start);
        let start = Instant::now();
        let mut field = DenseMotion::unknown(mask.size());
        let name = &store.trackers()[l].name;
        match loaded {
            None => outcome.skip(format!("{name}: no file for a view"), 1),
            Some((motion, stats)) => {
                outcome.skip(format!("{name}: rows or pixels that are not finite"), stats.dropped);
                match motion {
                    ViewMotion::Dense(dense) => field = dense,
                    ViewMotion::Tracks(set) => densify_view(&input.config.voronoi, &set, mask, &mut field)?,
                }
            }
        }
        add_seconds(&mut outcome.seconds.voronoi, start);
        fields.push(field);
    }
    let start = Instant::now();
    agreement(&mut fields, &input.config.agreement)?;
    add_seconds(&mut outcome.seconds.agreement, start);
    Ok(fields)
}

/// Sums `alpha T` times mask, flow and confidence over every Gaussian's pixels: 1 + 3 channels a tracker.
fn associate(
    input: &MotionInput,
    view: &TrainingView,
    joint: &Gaussians,
    fields: &[DenseMotion],
    (tape, sums): &mut (RenderTape, FootprintSums),
) {
    let inside: Vec<f32> = view.mask.data().iter().map(|&m| f32::from(m)).collect();
    let mut channels = vec![inside.clone()];
    for field in fields {
        let floor = input.config.association.flow_floor_px;
        // A tracker that knows nothing at a pixel must not pull the mean displacement toward zero.
        let known = |p: usize| inside[p] * f32::from(field.confidence[p] > 0.0);
        let n = inside.len();
        channels.push((0..n).map(known).collect());
        channels.push((0..n).map(|p| known(p) * field.flow[p][0]).collect());
        channels.push((0..n).map(|p| known(p) * field.flow[p][1]).collect());
        let weight = |p: usize| field.confidence[p] * field.flow[p][0].hypot(field.flow[p][1]).max(floor);
        channels.push((0..n).map(|p| inside[p] * weight(p)).collect());
    }
    let channels: Vec<&[f32]> = channels.iter().map(Vec::as_slice).collect();
    let tiles = TileMask::covering(&view.mask);
    let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
    let options = RenderOptions { antialiased: true, sh_degree: Some(0) };
    CpuRasterizer::new(options).accumulate(joint, &frame, &channels, tape, sums);
}

/// Channels a tracker takes in the footprint sums: coverage, flow x, flow y, weight.
const CHANNELS: usize = 4;

struct ObservedView<'a> {
    config: &'a Config,
    /// Camera at t - 1: the flow leads from its image to the image at t, camera motion included.
    camera: &'a Camera,
    view: usize,
    previous: &'a [DVec3],
}

impl ObservedView<'_> {
    fn fill(&self, sums: &FootprintSums, observations: &mut [Observations]) {
        let association = &self.config.association;
        for (i, &mean) in self.previous.iter().enumerate() {
            let values = sums.of(i);
            let Some(projection) = self.camera.project(mean) else { continue };
            if values[0] <= association.min_coverage || sums.hits(i) < association.min_hits {
                continue;
            }
            for (l, observation) in observations.iter_mut().enumerate() {
                let [coverage, x, y, weight] = [0, 1, 2, 3].map(|c| f64::from(values[1 + l * CHANNELS + c]));
                if coverage > f64::from(association.min_coverage) && weight > 0.0 {
                    let entry = self.view * observation.gaussians + i;
                    observation.targets[entry] = projection.pixel + DVec2::new(x, y) / coverage;
                    observation.weights[entry] = weight;
                }
            }
        }
    }
}

/// Lines 20 to 24: every tracker's estimates.
pub fn triangulate(
    input: &MotionInput,
    observations: &[Observations],
    outcome: &mut MotionOutcome,
) -> Result<Vec<Estimates>> {
    let start = Instant::now();
    let cameras: Vec<Camera> = input.now.iter().map(|v| v.camera).collect();
    let solver = WeightedRays { config: input.config.triangulation };
    let mut all = Vec::with_capacity(observations.len());
    for observation in observations {
        let mut estimates = Estimates::default();
        solver.triangulate(&outcome.previous, &cameras, observation, &mut estimates)?;
        all.push(estimates);
    }
    let failed = all.iter().flat_map(|e| &e.status).filter(|s| **s != EstimateStatus::Ok).count();
    outcome.skip("triangulations without a result (too few views, residual, geometry)".into(), failed);
    add_seconds(&mut outcome.seconds.triangulation, start);
    Ok(all)
}

/// Size of a pixel at each Gaussian (m): z / f in the nearest camera that sees it.
pub fn pixel_sizes(means: &[DVec3], views: &[TrainingView]) -> Vec<f64> {
    let size = |mean: &DVec3| {
        let sizes = views.iter().filter_map(|v| {
            v.camera.pixel_of(*mean)?;
            Some(v.camera.project(*mean)?.depth / v.camera.intrinsics().focal())
        });
        sizes.fold(f64::INFINITY, f64::min)
    };
    let sizes: Vec<f64> = means.iter().map(size).collect();
    let mut seen: Vec<f64> = sizes.iter().copied().filter(|s| s.is_finite()).collect();
    seen.sort_by(f64::total_cmp);
    // A Gaussian that no view sees takes the median size; with none seen at all, a centimetre.
    let typical = seen.get(seen.len() / 2).copied().unwrap_or(0.01);
    sizes.into_iter().map(|s| if s.is_finite() { s } else { typical }).collect()
}

/// Lines 25 to 34: moves the layer.
pub fn fuse(
    input: &MotionInput,
    estimates: &[Estimates],
    dynamic: &mut Dynamic,
    outcome: &mut MotionOutcome,
) -> Result<()> {
    let start = Instant::now();
    let mut pixel_m = pixel_sizes(&outcome.previous, input.before);
    pixel_m.sort_by(f64::total_cmp);
    let fuser = InformationFuser { config: input.config.fusion };
    let objects = match input.config.fusion.q_mode {
        ProcessNoise::Global => None,
        ProcessNoise::PerObject => Some(spatial_objects(&outcome.previous, &input.config.fusion.groups)),
    };
    let standing = vec![DVec3::ZERO; outcome.previous.len()];
    let steps = if dynamic.steps.len() == standing.len() { &dynamic.steps } else { &standing };
    let fused = fuser.fuse(&FusionInput {
        prior_means: &outcome.previous,
        prior_covariances: &dynamic.covariances,
        estimates,
        previous_steps: Some(steps),
        groups: objects.as_deref(),
        last_q: dynamic.q,
        q_floor_m: 0.25 * pixel_m.get(pixel_m.len() / 2).copied().unwrap_or(0.01),
    })?;
    let g = &mut dynamic.gaussians;
    g.means.iter_mut().zip(&fused.means).for_each(|(place, mean)| *place = mean.as_vec3().to_array());
    turn(g, &fused.rotations, input.config.association.rotate);
    dynamic.steps = fused.means.iter().zip(&outcome.previous).map(|(now, before)| *now - *before).collect();
    let left = fused.group_of.iter().filter(|g| g.is_none()).count();
    outcome.skip("Gaussians that follow their neighbours rather than a rigid group".into(), left);
    outcome.skip("Gaussians that no tracker measured".into(), fused.measured.iter().filter(|m| !**m).count());
    dynamic.covariances = fused.covariances;
    dynamic.q = fused.q;
    add_seconds(&mut outcome.seconds.fusion, start);
    Ok(())
}

/// Lines 35 to 40: who left the masks gets one second chance beside its neighbours, then goes.
fn validate_positions(input: &MotionInput, dynamic: &mut Dynamic, outcome: &mut MotionOutcome) -> Result<()> {
    let start = Instant::now();
    let mut means = positions(&dynamic.gaussians);
    let valid = valid_positions(input, &means)?;
    second_chance(&outcome.previous, &mut means, &valid)?;
    let valid = valid_positions(input, &means)?;
    let kept: Vec<usize> = (0..means.len()).filter(|&i| valid[i]).collect();
    let lost = means.len() - kept.len();
    outcome.skip("Gaussians removed: outside the masks".into(), lost);
    if lost as f64 > input.config.marking.loss_warning * means.len() as f64 {
        outcome.warnings.push(format!("{lost} of {} dynamic Gaussians left the masks", means.len()));
    }
    for (target, mean) in dynamic.gaussians.means.iter_mut().zip(&means) {
        *target = mean.as_vec3().to_array();
    }
    dynamic.gaussians = dynamic.gaussians.select(&kept);
    dynamic.covariances = kept.iter().map(|&i| dynamic.covariances[i]).collect();
    dynamic.steps = kept.iter().map(|&i| means[i] - outcome.previous[i]).collect();
    outcome.previous = kept.iter().map(|&i| outcome.previous[i]).collect();
    add_seconds(&mut outcome.seconds.validation, start);
    Ok(())
}

/// With the masks grown as for marking: a splat's mean may lie beside the mask that its footprint touches.
fn valid_positions(input: &MotionInput, means: &[DVec3]) -> Result<Vec<bool>> {
    let with_foreground = input.now.iter().filter(|v| v.mask.count() > 0);
    let dilation = input.config.marking.dilation;
    let (cameras, masks): (Vec<Camera>, Vec<Mask>) =
        with_foreground.map(|v| (v.camera, v.mask.dilated(dilation))).unzip();
    let counts = count_views(means, &cameras, &masks)?;
    Ok(counts.into_iter().map(|c| validate(c, input.config.marking.slack)).collect())
}

fn densify(input: &MotionInput, dynamic: &mut Dynamic, outcome: &mut MotionOutcome) {
    let start = Instant::now();
    let config: &DensifyConfig = &input.config.densification;
    let pixel_m = pixel_sizes(&positions(&dynamic.gaussians), input.now);
    let plan = plan_densification(&dynamic.gaussians, &dynamic.covariances, &pixel_m, config);
    let seed = input.config.seed ^ (input.frame as u64) << 32;
    apply_densification(&mut dynamic.gaussians, &mut dynamic.covariances, &plan, seed);
    dynamic.steps.extend(plan.iter().map(|p| dynamic.steps[p.0]).collect::<Vec<_>>());
    outcome.previous.extend(plan.iter().map(|p| outcome.previous[p.0]).collect::<Vec<_>>());
    add_seconds(&mut outcome.seconds.fusion, start);
}
