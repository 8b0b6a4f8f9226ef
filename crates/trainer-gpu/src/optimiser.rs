//! Adam on the device: gradients, moments and the change of rows by density control.

use crate::kernels;
use crate::layout::{AdamUniform, CarryUniform};
use ffgs_core::Gaussians;
use ffgs_gpu::{Buffer, Commands, Gpu, GpuError, Groups};
use ffgs_rasterizer_gpu::{Geometry, GpuGradients, GpuScene, Ledger};
use ffgs_trainer::{Columns, IndexMap, LearningRates, bias_corrections};

/// No row, or no column, of `carry`.
pub(crate) const NEW: u32 = u32::MAX;
/// Where a row of [`Geometry`] holds the opacity.
const OPACITY_COLUMN: u32 = (std::mem::offset_of!(Geometry, opacity_logit) / 4) as u32;
/// Values a Gaussian other than its colour.
const GEOMETRY_WIDTH: usize = size_of::<Geometry>() / 4;

/// Gaussians with their gradients and Adam's moments, all on the device.
pub(crate) struct Optimiser<'a> {
    pub(crate) gpu: &'a Gpu,
    pub scene: GpuScene,
    pub gradients: GpuGradients,
    pub first: GpuScene,
    second: GpuScene,
    corrections: Buffer,
    geometry_step: Buffer,
    sh_step: Buffer,
    columns: Columns,
    /// Gaussians at the front that stay.
    pub(crate) fixed: usize,
    /// Whether Gaussians that a step does not draw go on by their momentum.
    pub(crate) coasts: bool,
}

/// Zeros for the columns that move.
fn moments(gpu: &Gpu, scene: &GpuScene, columns: Columns) -> Result<GpuScene, GpuError> {
    let bytes = |moves: bool, column: &Buffer| if moves { column.bytes() } else { 0 };
    Ok(GpuScene {
        geometry: gpu.buffer("moments", bytes(columns.geometry(), &scene.geometry))?,
        sh: gpu.buffer("moments", bytes(columns.colours, &scene.sh))?,
        ..scene.clone()
    })
}

impl<'a> Optimiser<'a> {
    /// Trains `columns` of `scene` in place; no moments are kept of the others.
    pub(crate) fn new(gpu: &'a Gpu, scene: GpuScene, columns: Columns) -> Result<Self, GpuError> {
        Ok(Self {
            gpu,
            fixed: 0,
            coasts: false,
            gradients: GpuGradients::new(gpu, &scene, false)?,
            first: moments(gpu, &scene, columns)?,
            second: moments(gpu, &scene, columns)?,
            columns,
            corrections: gpu.upload("bias corrections", &bias_corrections())?,
            geometry_step: gpu.uniform("Adam", &AdamUniform::default())?,
            sh_step: gpu.uniform("Adam", &AdamUniform::default())?,
            scene,
        })
    }

    /// Leaves the first `fixed` Gaussians as they are, and moves others that are not drawn where it `coasts`.
    pub(crate) fn moving(self, fixed: usize, coasts: bool) -> Self {
        Self { fixed, coasts, ..self }
    }

    /// Factors of the moments by number of steps.
    pub(crate) fn corrections(&self) -> &Buffer {
        &self.corrections
    }

    /// Sets the step that [`Optimiser::step`] records: 480 bytes to the device.
    pub(crate) fn prepare(&self, rates: &LearningRates, stamp: u32) {
        let items = self.scene.count as u32;
        let [m, o, q, s] = [rates.means, rates.opacities, rates.quats, rates.scales];
        let geometry = [m, m, m, o, q, q, q, q, s, s, s, 0.0];
        let width = self.sh_width();
        let sh = |column: usize| if column < 3 { rates.sh0 } else { rates.sh_rest };
        let step = |width: usize, rate: &dyn Fn(usize) -> f32| AdamUniform {
            items,
            width: width as u32,
            stamp,
            fixed: self.fixed as u32,
            coasts: u32::from(self.coasts),
            unused: 0,
            padding: [0; 2],
            rates: std::array::from_fn(|row| {
                std::array::from_fn(|k| if row * 4 + k < width { rate(row * 4 + k) } else { 0.0 })
            }),
        };
        self.gpu.write(&self.geometry_step, &[step(GEOMETRY_WIDTH, &|column| geometry[column])]);
        self.gpu.write(&self.sh_step, &[step(width, &sh)]);
    }

    fn sh_width(&self) -> usize {
        3 * ffgs_core::sh_coefficients(self.scene.sh_degree)
    }

    /// Records one step down the gradients.
    pub(crate) fn step(&self, commands: &mut Commands) {
        let Self { scene, first, second, gradients, .. } = self;
        let ledger = [&gradients.ledger, &self.corrections];
        let columns = |step, gradient, p, m, v| [step, ledger[0], ledger[1], gradient, p, m, v];
        let (g, n) = (&gradients.scene, scene.count);
        if self.columns.geometry() {
            let geometry =
                columns(&self.geometry_step, &g.geometry, &scene.geometry, &first.geometry, &second.geometry);
            commands.run(&kernels::ADAM, &geometry, Groups::Items(n * GEOMETRY_WIDTH));
        }
        if self.columns.colours {
            let sh = columns(&self.sh_step, &g.sh, &scene.sh, &first.sh, &second.sh);
            commands.run(&kernels::ADAM, &sh, Groups::Items(n * self.sh_width()));
        }
    }

    /// First and second moments. Waits for the device.
    #[cfg(test)]
    pub(crate) fn moments(&self) -> Result<[Gaussians; 2], GpuError> {
        Ok([self.first.download(self.gpu)?, self.second.download(self.gpu)?])
    }

    /// The Gaussians. Waits for the device.
    pub(crate) fn download(&self) -> Result<Gaussians, GpuError> {
        self.scene.download(self.gpu)
    }

    /// What the steps noted of every Gaussian. Waits for the device.
    pub(crate) fn ledger(&self) -> Result<Vec<Ledger>, GpuError> {
        self.gpu.download(&self.gradients.ledger, self.scene.count)
    }

    /// Takes `gaussians`, made from the old ones as `map` says: kept ones keep moments and steps, new ones start anew.
    /// `keep_opacity` = false zeroes the opacities' moments; `keep_sums` = false zeroes the statistics of density control.
    pub(crate) fn replace(
        &mut self,
        gaussians: &Gaussians,
        map: &IndexMap,
        (keep_opacity, keep_sums): (bool, bool),
    ) -> Result<(), GpuError> {
        let ledger = self.ledger()?;
        let number = |(&source, &keeps): (&usize, &bool)| if keeps { source as u32 } else { NEW };
        let numbers: Vec<u32> = map.sources.iter().zip(&map.keeps_moments).map(number).collect();
        let numbers = self.gpu.upload("sources", &numbers)?;
        let moments = [&self.first, &self.second].map(|m| self.carry(m, &numbers, map.len(), keep_opacity));
        let carried = map.sources.iter().zip(&map.keeps_moments);
        let rows: Vec<Ledger> = carried
            .map(|(&source, &keeps)| {
                let before = if keeps { ledger[source] } else { Ledger::default() };
                if keep_sums { before } else { Ledger { steps: before.steps, ..Ledger::default() } }
            })
            .collect();
        let [first, second] = moments;
        let scene = GpuScene::upload(self.gpu, gaussians)?;
        let gradients = GpuGradients::new(self.gpu, &scene, false)?;
        self.gpu.write(&gradients.ledger, &rows);
        (self.first, self.second, self.scene, self.gradients) = (first?, second?, scene, gradients);
        self.gpu.release_unused();
        Ok(())
    }

    /// Moments of `rows` Gaussians, each from the row that `numbers` names.
    fn carry(
        &self,
        moments: &GpuScene,
        numbers: &Buffer,
        rows: usize,
        keep_opacity: bool,
    ) -> Result<GpuScene, GpuError> {
        let gpu = self.gpu;
        let mut commands = gpu.commands();
        let mut carried = |before: &Buffer, width: usize, dropped: u32| {
            let after = gpu.buffer("moments", (rows * width * 4) as u64)?;
            let job = CarryUniform { rows: rows as u32, width: width as u32, dropped, padding: 0 };
            let job = gpu.uniform("carry", &job)?;
            commands.run(&kernels::CARRY, &[&job, numbers, before, &after], Groups::Items(rows * width));
            Ok::<_, GpuError>(after)
        };
        let dropped = if keep_opacity { NEW } else { OPACITY_COLUMN };
        let geometry = carried(&moments.geometry, GEOMETRY_WIDTH, dropped)?;
        let sh = carried(&moments.sh, self.sh_width(), NEW)?;
        gpu.submit(commands)?;
        Ok(GpuScene { geometry, sh, count: rows, ..moments.clone() })
    }
}
