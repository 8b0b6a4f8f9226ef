//! HiCoM's motion: grids of cubes over the scene, from coarse to fine, with one motion per cube.

use crate::added::AddedConfig;
use crate::deformation::{DELTA, Deformation, Deltas, MotionFitConfig};
use crate::hicom::HicomConfig;
use crate::saved::{Reader, Writer};
use crate::two_stages::Nodes;
use anyhow::{Result, bail, ensure};
use ffgs_method::Step;
use ffgs_trainer::AdamVec;

/// Grids of cubes over one box, from fine to coarse, with a delta per cell.
pub(super) struct Grids {
    /// Corners of the box (m).
    least: [f32; 3],
    most: [f32; 3],
    /// Cells along each axis, per level.
    sizes: Vec<usize>,
    /// Of all cells, level after level.
    deltas: Deltas,
}

impl Grids {
    /// A box of the given quantiles of the positions, and so many cells that each of the finest holds
    /// `gaussians_per_cell`.
    fn new(means: &[[f32; 3]], config: &HicomConfig) -> Self {
        let corner = |share: f32| [0, 1, 2].map(|a| quantile(means, a, share) * (1.0 + config.quantile));
        let cells = means.len() as f64 / config.gaussians_per_cell as f64;
        let sizes = sizes(cells.cbrt().ceil() as usize, config);
        let nodes: usize = sizes.iter().map(|n| n * n * n).sum();
        let (least, most) = (corner(config.quantile), corner(1.0 - config.quantile));
        Self { least, most, sizes, deltas: Deltas::identity(nodes) }
    }

    /// As in the official code, half a cell off: the first cell of an axis is one and a half wide, the last half of one.
    fn cell(&self, size: usize, mean: &[f32; 3]) -> usize {
        (0..3).fold(0, |cell, a| {
            let share = (mean[a] - self.least[a]) / (self.most[a] - self.least[a]);
            // A NaN (a box without width) becomes 0 in the cast.
            cell * size + (share.clamp(0.0, 1.0) * size as f32 - 0.5) as usize
        })
    }
}

impl Nodes for Grids {
    type Config = HicomConfig;

    fn stages(config: &HicomConfig) -> (&MotionFitConfig, &AddedConfig) {
        (&config.motion, &config.added)
    }

    /// The grids of the first frame that moves, for good; the moments start anew in each.
    fn next(last: Option<Self>, means: &[[f32; 3]], config: &HicomConfig, _: &Step) -> Result<Self> {
        let mut grids = last.unwrap_or_else(|| Self::new(means, config));
        grids.deltas.adam = AdamVec::new(grids.deltas.nodes().len(), DELTA);
        Ok(grids)
    }

    /// Positions outside the box follow the cells at its faces.
    fn deformation(&mut self, means: &[[f32; 3]]) -> Result<(Deformation, &mut Deltas)> {
        let mut first = 0;
        let level = |&size: &usize| {
            let cells = means.iter().map(|mean| (first + self.cell(size, mean)) as u32).collect();
            first += size * size * size;
            cells
        };
        let levels = self.sizes.iter().map(level).collect();
        Ok((Deformation::new(levels, self.deltas.nodes().len()), &mut self.deltas))
    }

    fn deltas(&self) -> &Deltas {
        &self.deltas
    }

    fn save(&self, out: Writer) -> Writer {
        out.column(&[self.least, self.most].concat()).count(self.sizes[0]).column(&self.deltas.values)
    }

    fn restore(state: &mut Reader, config: &HicomConfig) -> Result<Self> {
        let (corners, finest, deltas) = (state.column()?, state.count()?, state.column()?);
        let [[a, b, c], [d, e, f]] = *corners.as_chunks::<3>().0 else { bail!("a box has two corners") };
        let sizes = sizes(finest, config);
        let nodes: usize = sizes.iter().map(|n| n.saturating_pow(3)).sum();
        ensure!(deltas.len() == nodes.saturating_mul(DELTA), "{} values of {nodes} cells", deltas.len());
        Ok(Self { least: [a, b, c], most: [d, e, f], sizes, deltas: Deltas::new(deltas) })
    }
}

/// Cells along an axis, per level.
fn sizes(finest: usize, config: &HicomConfig) -> Vec<usize> {
    let coarser = |n: &usize| Some(n / config.level_ratio);
    std::iter::successors(Some(finest), coarser).take_while(|n| *n > 0).take(config.levels).collect()
}

/// Linear between the two nearest values.
fn quantile(means: &[[f32; 3]], axis: usize, share: f32) -> f32 {
    let mut values: Vec<f32> = means.iter().map(|mean| mean[axis]).collect();
    values.sort_by(f32::total_cmp);
    let at = share * (values.len() - 1) as f32;
    let (below, part) = (at as usize, at.fract());
    let above = values[(below + 1).min(values.len() - 1)];
    values[below] + part * (above - values[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_is_of_quantiles_and_levels_halve() {
        let means: Vec<[f32; 3]> = (0..=100).map(|i| [i as f32, 10.0 * i as f32, 0.0]).collect();
        let config = HicomConfig { gaussians_per_cell: 1, ..HicomConfig::default() };
        let grids = Grids::new(&means, &config);
        for (corner, expected) in [(grids.least, [5.25, 52.5, 0.0]), (grids.most, [99.75, 997.5, 0.0])] {
            assert!(ffgs_testkit::largest_difference(&corner, &expected) < 1e-3, "{corner:?}");
        }
        assert_eq!(grids.sizes, [5, 2, 1]);
        assert_eq!(grids.deltas.nodes().len(), 125 + 8 + 1);
    }

    /// x in [0, 4], four cells: the borders lie at 1.5, 2.5 and 3.5.
    #[test]
    fn cells_are_those_of_the_official_code_and_outliers_go_to_the_faces() {
        let grids =
            Grids { least: [0.0; 3], most: [4.0, 1.0, 1.0], sizes: vec![4], deltas: Deltas::identity(0) };
        for (x, column) in [(-3.0, 0), (1.4, 0), (1.6, 1), (2.6, 2), (3.4, 2), (3.6, 3), (9.0, 3)] {
            assert_eq!(grids.cell(4, &[x, 0.0, 0.0]), 16 * column, "x = {x}");
        }
        assert_eq!(grids.cell(4, &[4.0, 1.0, 1.0]), 63);
    }
}
