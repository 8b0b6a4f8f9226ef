//! Motion fields and their agreement on the device, over the masked pixels of one view.

use crate::kernels;
use crate::layout::{DensifyUniform, FieldsUniform, UnpackUniform};
use crate::packed::Packed;
use ffgs_core::{DenseMotion, ImageSize, Mask, TrackSet};
use ffgs_gpu::{Buffer, Gpu, GpuError, Groups};
use ffgs_voronoi::{
    AgreementConfig, IntegerCentredTracks, Method, MotionError, SourceFilter, VoronoiConfig, filter_sources,
};
use thiserror::Error;

/// Neighbours that a pixel keeps at most, `MOST_NEIGHBOURS` of the shader.
pub(crate) const MOST_NEIGHBOURS: usize = 16;
/// Trackers of a view at most, `MOST_TRACKERS` of the shaders.
pub(crate) const MOST_TRACKERS: usize = 8;
/// Planes of a tracker: known, flow x, flow y, weight.
const PLANES: usize = 4;

/// Why a view's motion fields could not be computed.
#[derive(Debug, Error, PartialEq)]
pub enum FieldsError {
    /// The device failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The input is no motion.
    #[error(transparent)]
    Motion(#[from] MotionError),
}

/// Whether these settings have kernels; the CPU does the rest.
pub fn supports(config: &VoronoiConfig, trackers: usize) -> bool {
    let method = config.method == Method::GaussianKnn && (1..=MOST_NEIGHBOURS).contains(&config.k);
    method && (1..=MOST_TRACKERS).contains(&trackers)
}

/// Motion fields of all trackers of one view on the device, over the masked pixels only.
pub struct ViewFields<'a> {
    gpu: &'a Gpu,
    size: ImageSize,
    trackers: usize,
    numbers: Vec<u32>,
    pixels: Buffer,
    /// (trackers, masked pixels) of flow (px), visibility, confidence.
    fields: Buffer,
}

impl<'a> ViewFields<'a> {
    /// Fields that know no motion anywhere.
    ///
    /// # Errors
    /// When the device has too little memory.
    pub fn new(gpu: &'a Gpu, mask: &Mask, trackers: usize) -> Result<Self, GpuError> {
        let inside = mask.data().iter().enumerate().filter(|(_, m)| **m != 0);
        let numbers: Vec<u32> = inside.map(|(p, _)| p as u32).collect();
        Ok(Self {
            gpu,
            size: mask.size(),
            trackers,
            pixels: gpu.upload("masked pixels", &numbers)?,
            fields: gpu.buffer("motion fields", (trackers * numbers.len() * 16) as u64)?,
            numbers,
        })
    }

    /// Densifies the tracks of tracker `l`; CPU twin: [`ffgs_voronoi::densify_view`].
    ///
    /// # Errors
    /// As the twin, or when the device fails.
    pub fn densify(
        &self,
        l: usize,
        config: &VoronoiConfig,
        tracks: &TrackSet,
        mask: &Mask,
    ) -> Result<(), FieldsError> {
        let all = IntegerCentredTracks::from(tracks);
        all.validate()?;
        let square = config.sigma * config.sigma;
        if !(config.sigma > 0.0 && square.is_normal()) {
            return Err(MotionError::Sigma(config.sigma).into());
        }
        if config.k == 0 {
            return Err(MotionError::NoNeighbours.into());
        }
        let used = match config.source_filter {
            SourceFilter::Foreground => IntegerCentredTracks::from(&filter_sources(tracks, mask)),
            SourceFilter::All => all,
        };
        let side = |n: usize| 1.0 / n.saturating_sub(1).max(1) as f32;
        let uniform = DensifyUniform {
            pixels: self.numbers.len() as u32,
            tracks: used.src.len() as u32,
            neighbours: config.k.min(MOST_NEIGHBOURS) as u32,
            first: self.first(l),
            scale: [side(self.size.width), side(self.size.height)],
            half_precision: (0.5 / square) as f32,
            use_visibility: u32::from(config.use_visibility),
            width: self.size.width as u32,
            padding: 0,
        };
        Ok(self.run_densify(&uniform, &used)?)
    }

    fn run_densify(&self, uniform: &DensifyUniform, tracks: &IntegerCentredTracks) -> Result<(), GpuError> {
        let gpu = self.gpu;
        let row = |(s, t): (&[f64; 2], &[f64; 2])| [s[0], s[1], t[0] - s[0], t[1] - s[1]].map(|v| v as f32);
        let rows: Vec<[f32; 4]> = tracks.src.iter().zip(&tracks.tgt).map(row).collect();
        let visibility: Vec<f32> = tracks.visibility.iter().map(|&v| v as f32).collect();
        let job = gpu.uniform("densify", uniform)?;
        let tracks = gpu.upload("tracks", &rows)?;
        let visibility = gpu.upload("visibility", &visibility)?;
        let mut commands = gpu.commands();
        let buffers = [&job, &self.pixels, &tracks, &visibility, &self.fields];
        commands.run(&kernels::DENSIFY, &buffers, Groups::Items(self.numbers.len()));
        gpu.submit(commands)
    }

    /// Takes a dense tracker's field, in 16-bit numbers; a flow that is no number is unknown.
    ///
    /// # Errors
    /// [`MotionError::Size`] when it has not the mask's size, or when the device fails.
    pub fn take(&self, l: usize, field: &DenseMotion) -> Result<(), FieldsError> {
        if field.size != self.size {
            return Err(MotionError::Size { expected: self.size, found: field.size }.into());
        }
        let gpu = self.gpu;
        let packed = Packed::new(field, &self.numbers);
        let uniform = UnpackUniform {
            middle: packed.middle,
            reach: packed.reach,
            pixels: self.numbers.len() as u32,
            first: self.first(l),
            padding: [0; 2],
        };
        let job = gpu.uniform("unpack", &uniform)?;
        let numbers = gpu.upload("dense field", &packed.pixels)?;
        let mut commands = gpu.commands();
        let groups = Groups::Items(self.numbers.len());
        commands.run(&kernels::UNPACK_FIELD, &[&job, &numbers, &self.fields], groups);
        Ok(gpu.submit(commands)?)
    }

    /// Scales the confidences by the trackers' agreement; CPU twin: [`ffgs_voronoi::agreement`].
    ///
    /// # Errors
    /// [`MotionError::Floor`] for a negative floor, or when the device fails.
    pub fn agree(&self, config: &AgreementConfig) -> Result<(), FieldsError> {
        let magnitude_floor = config.magnitude_floor_px;
        if !(magnitude_floor >= 0.0 && magnitude_floor.is_finite()) {
            return Err(MotionError::Floor(magnitude_floor).into());
        }
        let ignore_unknown = u32::from(config.ignore_unknown);
        let job =
            self.uniform(FieldsUniform { ignore_unknown, magnitude_floor, ..FieldsUniform::default() })?;
        let mut commands = self.gpu.commands();
        let groups = Groups::Items(self.numbers.len());
        commands.run(&kernels::AGREEMENT, &[&job, &self.fields], groups);
        Ok(self.gpu.submit(commands)?)
    }

    /// Number of planes that [`ViewFields::planes`] makes.
    pub fn plane_count(&self) -> usize {
        1 + PLANES * self.trackers
    }

    /// (1 + 4 trackers, H, W) f32: the mask, and of every tracker whether it knows a motion, flow x, flow y (px) where it
    /// does, and confidence times flow of at least `flow_floor` px.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn planes(&self, flow_floor: f32) -> Result<Buffer, GpuError> {
        let job = self.uniform(FieldsUniform { flow_floor, ..FieldsUniform::default() })?;
        let bytes = self.plane_count() * self.size.pixels() * 4;
        let planes = self.gpu.buffer("planes of motion", bytes as u64)?;
        let mut commands = self.gpu.commands();
        let buffers = [&job, &self.pixels, &self.fields, &planes];
        commands.run(&kernels::FIELD_PLANES, &buffers, Groups::Items(self.numbers.len()));
        self.gpu.submit(commands)?;
        Ok(planes)
    }

    /// The field of tracker `l`, unknown outside the mask. Waits for the device.
    ///
    /// # Errors
    /// When the device failed.
    pub fn download(&self, l: usize) -> Result<DenseMotion, GpuError> {
        let all: Vec<[f32; 4]> = self.gpu.download(&self.fields, self.trackers * self.numbers.len())?;
        let mut out = DenseMotion::unknown(self.size);
        let rows = &all[self.first(l) as usize..];
        for (&pixel, &[x, y, visibility, confidence]) in self.numbers.iter().zip(rows) {
            let p = pixel as usize;
            (out.flow[p], out.visibility[p], out.confidence[p]) = ([x, y], visibility, confidence);
        }
        Ok(out)
    }

    fn first(&self, l: usize) -> u32 {
        (l * self.numbers.len()) as u32
    }

    fn uniform(&self, values: FieldsUniform) -> Result<Buffer, GpuError> {
        let (pixels, plane) = (self.numbers.len() as u32, self.size.pixels() as u32);
        let trackers = self.trackers as u32;
        self.gpu.uniform("fields", &FieldsUniform { pixels, plane, trackers, ..values })
    }
}
