//! A small scene for tests whose photographs are renders: a textured body that moves, before a backdrop that stands still.

use ffgs_core::{
    Camera, Dynamic, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage, Scene, SkyCube,
    StageLog, TrainingView,
};
use ffgs_method::{MotionMethod, Step};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use ffgs_testkit::{conformance, look_at};
use ffgs_trainer::SkyView;
use glam::{DVec3, Vec3};

const SIZE: ImageSize = ImageSize { width: 64, height: 48 };
const VIEWS: usize = 6;
/// Gaussians of the body and of the backdrop.
pub(crate) const BODY: usize = 150;
const BACKDROP: usize = 80;
/// Radius of the body (m).
const RADIUS: f32 = 0.4;

pub(crate) struct World {
    body: Gaussians,
    backdrop: Gaussians,
    pub sky: SkyCube,
    /// How far the body goes per frame (m).
    pub step: Vec3,
}

/// Deterministic values in -1..1.
pub(crate) fn waves(column: &mut [f32], phase: f32) {
    column.iter_mut().enumerate().for_each(|(i, v)| *v = (1.7 * i as f32 + phase * (i as f32 + 1.0)).sin());
}

fn cloud(count: usize, centre: Vec3, radius: f32, size: f32, phase: f32) -> Gaussians {
    let mut out = Gaussians::zeros(count, 0);
    waves(out.means.as_flattened_mut(), phase);
    out.means.iter_mut().for_each(|mean| *mean = (centre + radius * Vec3::from(*mean)).to_array());
    waves(out.quats.as_flattened_mut(), phase + 1.0);
    out.log_scales.fill([size.ln(); 3]);
    waves(&mut out.opacity_logits, phase + 2.0);
    out.opacity_logits.iter_mut().for_each(|o| *o += 3.0);
    waves(out.sh.as_flattened_mut(), phase + 3.0);
    out.sh.as_flattened_mut().iter_mut().for_each(|v| *v *= 1.6);
    out
}

fn camera(view: usize) -> Camera {
    let angle = std::f64::consts::TAU * view as f64 / VIEWS as f64;
    let eye = DVec3::new(6.0 * angle.cos(), 6.0 * angle.sin(), 2.4 + 0.8 * (view % 2) as f64);
    let lens = Intrinsics { fx: 240.0, fy: 240.0, cx: 32.0, cy: 24.0 };
    Camera::new(lens, look_at(eye, DVec3::ZERO), SIZE).unwrap()
}

impl World {
    /// The body stands still.
    pub(crate) fn new() -> Self {
        Self::moving(Vec3::ZERO)
    }

    pub(crate) fn moving(step: Vec3) -> Self {
        let body = cloud(BODY, Vec3::ZERO, RADIUS, 0.05, 0.4);
        let backdrop = cloud(BACKDROP, Vec3::new(0.0, 0.0, -0.9), 1.2, 0.15, 2.7);
        Self { body, backdrop, sky: SkyCube::filled(4, [0.3, 0.5, 0.7]), step }
    }

    /// The body at a frame, then the backdrop.
    pub(crate) fn gaussians_at(&self, frame: usize) -> Gaussians {
        let mut all = self.body.clone();
        let far = frame as f32 * self.step;
        all.means.iter_mut().for_each(|mean| *mean = (Vec3::from(*mean) + far).to_array());
        all.extend(&self.backdrop);
        all
    }

    pub(crate) fn gaussians(&self) -> Gaussians {
        self.gaussians_at(0)
    }

    /// The true scene of frame 0.
    pub(crate) fn scene(&self) -> Scene {
        let mut dynamic = Dynamic { gaussians: self.body.clone(), ..Dynamic::default() };
        dynamic.number_new();
        dynamic.covariances.resize(BODY, glam::DMat3::IDENTITY);
        Scene::new(self.backdrop.clone(), dynamic, self.sky.clone())
    }

    fn view(&self, view: usize, frame: usize) -> TrainingView {
        let (camera, gaussians) = (camera(view), self.gaussians_at(frame));
        let mut tape = RenderTape::default();
        let rasterizer = CpuRasterizer::default();
        let mut sky = PlanarImage::zeros(SIZE);
        SkyView::new(&camera, self.sky.face_size()).render(&self.sky, &mut sky);
        let shown = |background| View { camera: &camera, background, tiles: None };
        rasterizer.render(&self.body_at(frame), &shown(Background::Colour([0.0; 3])), &mut tape);
        let inside = tape.transmittance().iter().map(|&t| u8::from(t < 0.5)).collect();
        rasterizer.render(&gaussians, &shown(Background::Image(&sky)), &mut tape);
        let (image, mask) = (ImageRgb8::from(tape.image()), Mask::new(SIZE, inside).unwrap());
        TrainingView { camera, image, mask }
    }

    fn body_at(&self, frame: usize) -> Gaussians {
        self.gaussians_at(frame).select(&(0..BODY).collect::<Vec<_>>())
    }

    fn views(&self, frame: usize) -> Vec<TrainingView> {
        (0..VIEWS).map(|view| self.view(view, frame)).collect()
    }

    pub(crate) fn with_step<T>(&self, frame: usize, work: impl FnOnce(&Step) -> T) -> T {
        // Methods that look at photographs alone ask nothing of the capture.
        let capture = conformance::World::new(1, DVec3::ZERO);
        let (before, now) = (self.views(frame - 1), self.views(frame));
        let views: Vec<usize> = (0..VIEWS).collect();
        let tracks = &[];
        work(&Step {
            frame,
            seed: 1,
            capture: &capture,
            views: &views,
            before: &before,
            now: &now,
            reduced: [&before, &now],
            tracks,
        })
    }

    /// How far the Gaussians of the body are from where they are at `frame` (m): root mean square, and of their mean.
    pub(crate) fn errors(&self, scene: &Scene, frame: usize) -> [f32; 2] {
        let truth = self.body_at(frame).means;
        let found = scene.dynamic.ids.iter().zip(&scene.dynamic.gaussians.means);
        let body = found.filter(|(id, _)| (**id as usize) < BODY);
        let far: Vec<Vec3> =
            body.map(|(id, mean)| Vec3::from(*mean) - Vec3::from(truth[*id as usize])).collect();
        assert!(far.len() > BODY / 2, "{} Gaussians of the body are left", far.len());
        let count = far.len() as f32;
        let mean = far.iter().sum::<Vec3>() / count;
        [(far.iter().map(|far| far.length_squared()).sum::<f32>() / count).sqrt(), mean.length()]
    }
}

/// Runs frame `frame` of a method.
pub(crate) fn advance(
    world: &World,
    method: &mut dyn MotionMethod,
    frame: usize,
    scene: &mut Scene,
) -> anyhow::Result<()> {
    world.with_step(frame, |step| {
        let mut log = StageLog::default();
        method.predict(step, scene, &mut log)?;
        method.finetune(step, scene, &mut log).map(|_| ())
    })
}

/// What every method here owes beyond the contract's suite, with its training: a resumed run ends with the same bytes, and so does one in
/// another number of threads.
pub(crate) fn repeats(make: &(dyn Fn() -> Box<dyn MotionMethod> + Sync)) {
    let world = World::moving(Vec3::new(0.01, 0.0, 0.0));
    let run = |frames: std::ops::RangeInclusive<usize>, state: Option<&[u8]>, mut scene: Scene| {
        let mut method = make();
        match state {
            Some(state) => method.restore(state, &scene).unwrap(),
            None => method.begin(&scene).unwrap(),
        }
        frames.for_each(|frame| advance(&world, &mut *method, frame, &mut scene).unwrap());
        let state = method.save();
        (scene, state)
    };
    let in_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(1..=2, None, world.scene()))
    };
    let [whole, other] = [1, 3].map(in_threads);
    let (scene, state) = run(1..=1, None, world.scene());
    let resumed = run(2..=2, Some(&state), scene);
    for (name, (scene, state)) in [("threads", &other), ("resumed", &resumed)] {
        assert_eq!(scene.dynamic.gaussians, whole.0.dynamic.gaussians, "{name}");
        assert!(scene.dynamic.ids == whole.0.dynamic.ids && *state == whole.1, "{name}");
    }
    assert_ne!(whole.0.dynamic.gaussians, world.gaussians(), "nothing was trained");
    let damaged = [&state[..], &[0]].concat();
    assert!(make().restore(&damaged, &whole.0).is_err(), "a damaged state");
}
