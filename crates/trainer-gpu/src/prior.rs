//! The prior of a layer's parameters, on the device. CPU twin: `Penalty` in trainer/src/prior.rs.

use crate::kernels;
use crate::layout::{NaturalUniform, PriorUniform};
use crate::optimiser::Optimiser;
use crate::target::Target;
use ffgs_gpu::{Buffer, Commands, Gpu, GpuError, Groups};
use ffgs_rasterizer::Information;
use ffgs_rasterizer_gpu::{Geometry, GpuScene};
use ffgs_trainer::{Damping, LearningRates, Prior, SSIM_WEIGHT, expected_gain};

/// The prior of a training and where the layer was at its start.
pub(crate) struct GpuPrior<'a> {
    /// As the host knows it.
    prior: Prior<'a>,
    damping: Damping,
    /// Mean over views of the pixels that count.
    pixels: usize,
    uniform: Buffer,
    natural: Buffer,
    /// Views that see each Gaussian.
    seen: Buffer,
    information: Known,
    /// What natural steps divide by.
    curvature: Known,
    start: GpuScene,
}

/// An information on the device.
struct Known {
    /// (N, 8) xx, xy, xz, yy, yz, zz of that of the positions (1/m^2).
    positions: Buffer,
    /// Of the other parameters.
    others: GpuScene,
}

impl Known {
    fn upload(gpu: &Gpu, information: &Information) -> Result<Self, GpuError> {
        let rows: Vec<[f32; 8]> = information
            .positions
            .iter()
            .map(|m| [m.x_axis.x, m.x_axis.y, m.x_axis.z, m.y_axis.y, m.y_axis.z, m.z_axis.z, 0.0, 0.0])
            .map(|row| row.map(|v| v as f32))
            .collect();
        let positions = gpu.upload("information", &rows)?;
        Ok(Self { positions, others: GpuScene::upload(gpu, &information.others)? })
    }
}

impl<'a> GpuPrior<'a> {
    /// `seen` = views that see each Gaussian of `start`, `pixels` = mean over views of those that count.
    pub(crate) fn new(
        gpu: &Gpu,
        prior: Prior<'a>,
        start: &GpuScene,
        (seen, pixels): (Buffer, usize),
    ) -> Result<Self, GpuError> {
        let unit = (1.0 - SSIM_WEIGHT as f32) * (prior.noise.sigma * prior.noise.correlated) as f32;
        let damping = Damping::new(prior.curvature);
        let uniform = PriorUniform {
            items: start.count as u32,
            coefficients: ffgs_core::sh_coefficients(start.sh_degree) as u32,
            strength: prior.weight * unit,
            damping_means: damping.means,
            damping_turns: damping.turns,
            damping_scales: damping.scales,
            damping_opacities: damping.opacities,
            damping_sh0: damping.sh0,
            damping_sh_rest: damping.sh_rest,
            ..PriorUniform::default()
        };
        Ok(Self {
            prior,
            damping,
            pixels,
            uniform: gpu.uniform("prior", &uniform)?,
            natural: gpu.uniform("natural step", &NaturalUniform::default())?,
            seen,
            information: Known::upload(gpu, prior.information)?,
            curvature: Known::upload(gpu, prior.curvature)?,
            start: GpuScene::joined(gpu, &[start])?,
        })
    }

    /// Adds its derivative to that of the loss of a view, for the Gaussians that the view drew.
    pub(crate) fn pull(&self, commands: &mut Commands, target: &Target, optimiser: &Optimiser) {
        let Self { uniform, seen, information: Known { positions, others }, start, .. } = self;
        let (scene, gradients) = (&optimiser.scene, &optimiser.gradients);
        let shared = |now, start, known, gradient| {
            [
                uniform,
                &target.loss,
                target.view.uniform(),
                &gradients.ledger,
                seen,
                now,
                start,
                known,
                gradient,
            ]
        };
        let [a, b, c, d, e, now, before, known, gradient] =
            shared(&scene.geometry, &start.geometry, &others.geometry, &gradients.scene.geometry);
        let geometry = [a, b, c, d, e, now, before, known, gradient, positions];
        commands.run(&kernels::PRIOR_GEOMETRY, &geometry, Groups::Items(scene.count));
        let colours = shared(&scene.sh, &start.sh, &others.sh, &gradients.scene.sh);
        let values = scene.count * 3 * ffgs_core::sh_coefficients(scene.sh_degree);
        commands.run(&kernels::PRIOR_COLOURS, &colours, Groups::Items(values));
    }

    /// Sets the step that [`step`](Self::step) records: `share` of the way to the minimum, within `rates`.
    pub(crate) fn prepare(&self, gpu: &Gpu, (share, rates): (f32, &LearningRates), stamp: u32, fixed: usize) {
        let LearningRates { means, quats, scales, opacities, sh0, sh_rest } = *rates;
        let fixed = fixed as u32;
        // Of the loss of a view with the mean number of pixels, as views are drawn by theirs.
        let unit = self.prior.curvature(self.damping, &[], self.pixels).unit;
        let step = NaturalUniform {
            stamp,
            fixed,
            share: share / unit,
            means,
            quats,
            scales,
            opacities,
            sh0,
            sh_rest,
            ..NaturalUniform::default()
        };
        gpu.write(&self.natural, &[step]);
    }

    /// What the positions could still gain, as `Training::expected_gain` has it. Waits for the device.
    pub(crate) fn expected_gain(&self, optimiser: &Optimiser) -> Result<Option<f64>, GpuError> {
        let (gpu, count) = (optimiser.gpu, optimiser.scene.count);
        let first: Vec<Geometry> = gpu.download(&optimiser.first.geometry, count)?;
        let first: Vec<[f32; 3]> = first.iter().map(|row| row.mean).collect();
        let steps: Vec<u32> = optimiser.ledger()?.iter().map(|row| row.steps).collect();
        let seen: Vec<u32> = gpu.download(&self.seen, count)?;
        Ok(expected_gain(&first, &steps, self.prior.curvature(self.damping, &seen, self.pixels)))
    }

    /// Records one step along the natural gradient.
    pub(crate) fn step(&self, commands: &mut Commands, optimiser: &Optimiser) {
        let Self { uniform, natural, seen, curvature: Known { positions, others }, .. } = self;
        let Optimiser { scene, gradients, first, .. } = optimiser;
        let ledger = &gradients.ledger;
        let corrections = optimiser.corrections();
        let [a, b, c, d, e] = [uniform, natural, ledger, corrections, seen];
        let [known, down, now, mean] = [others, &gradients.scene, scene, first].map(|s| &s.geometry);
        let geometry = [a, b, c, d, e, known, positions, down, now, mean];
        commands.run(&kernels::NATURAL_GEOMETRY, &geometry, Groups::Items(scene.count));
        let [known, down, now, mean] = [others, &gradients.scene, scene, first].map(|s| &s.sh);
        let colours = [a, b, c, d, e, known, down, now, mean];
        let values = scene.count * 3 * ffgs_core::sh_coefficients(scene.sh_degree);
        commands.run(&kernels::NATURAL_COLOURS, &colours, Groups::Items(values));
    }
}
