//! What each kernel of a step must at least move and compute, as the heads of the shaders say.

/// Sizes that the work of a step depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Those that touch a tile.
    pub in_sight: usize,
    /// SH coefficients a colour.
    pub coefficients: usize,
    /// Rows of tiles that splats touch.
    pub spans: usize,
    /// (tile, splat) pairs.
    pub pairs: usize,
    /// Computed tiles.
    pub tiles: usize,
    /// Pixels of the view.
    pub pixels: usize,
    /// (pixel, Gaussian) pairs that are blended.
    pub contributions: u64,
}

/// Work of a kernel in one step, over all its dispatches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Floor {
    /// Bytes to and from the device's memory, each needed value once.
    pub bytes: f64,
    /// Operations on f32; a multiply-add is one.
    pub operations: f64,
}

/// Passes of the sort by depth: 32 bits, four at a time.
const DEPTH_PASSES: f64 = 8.0;
/// Operations a contribution, as on the CPU: counted in the blend walk and its backward pass.
const BLEND: f64 = 25.0;
const BLEND_BACKWARD: f64 = 46.0;

impl Counts {
    /// Floor of a kernel by its name; `None` for one that is no part of a step.
    ///
    /// Sorting is counted by the lines that hold the keys: 8 bytes per pair.
    pub fn floor(&self, kernel: &str) -> Option<Floor> {
        let [n, seen, spans, pairs] =
            [self.gaussians, self.in_sight, self.spans, self.pairs].map(|count| count as f64);
        let [tiles, pixels, sh] = [self.tiles, self.pixels, self.coefficients].map(|count| count as f64);
        let blended = self.contributions as f64;
        let sorted = DEPTH_PASSES * n + self.tile_passes() * pairs;
        // Sixteen counters a block of 1024, and the pair counts of the Gaussians.
        let counters = sorted / 64.0;
        let scanned = n + counters;
        let values = seen * (11.0 + 3.0 * sh);
        let bytes_and_operations = match kernel {
            "project" => (120.0 * n + 12.0 * sh * seen + 4.0 * spans, 400.0 * n),
            "rank_counts" => (28.0 * n, 0.0),
            "scan_blocks" => (4.0 * scanned, scanned),
            "scan_spine" => (8.0 * scanned / 1024.0, scanned / 1024.0),
            "scan_apply" => (8.0 * scanned, scanned),
            "scan_single" => (8.0 * counters, counters),
            "sort_count" => (8.0 * sorted + 4.0 * counters, sorted),
            "sort_scatter" => (16.0 * sorted + 4.0 * counters, 4.0 * sorted),
            "plan_pairs" => (56.0, 0.0),
            "emit_pairs" => (28.0 * n + 4.0 * spans + 12.0 * pairs, 0.0),
            "tile_ranges" => (20.0 * pairs + 16.0 * tiles, 0.0),
            "blend" => (56.0 * pairs + 52.0 * pixels, BLEND * blended),
            "blend_backward" | "blend_backward_subgroups" => {
                (92.0 * pairs + 68.0 * pixels, BLEND_BACKWARD * blended)
            }
            "projection_backward" => {
                (16.0 * n + 36.0 * pairs + (128.0 + 36.0 * sh) * seen, 900.0 * seen + 9.0 * pairs)
            }
            "loss_statistics" => (70.0 * pixels + 48.0 * tiles, 390.0 * pixels),
            "loss_gradient" => (82.0 * pixels, 300.0 * pixels),
            "loss_value" => (48.0 * tiles, 9.0 * tiles),
            "adam" => (28.0 * values + 16.0 * n, 15.0 * values),
            _ => return None,
        };
        let (bytes, operations) = bytes_and_operations;
        Some(Floor { bytes, operations })
    }

    /// Passes of the sort by tile, four bits each.
    fn tile_passes(&self) -> f64 {
        let bits = usize::BITS - self.tiles.saturating_sub(1).leading_zeros();
        f64::from(bits.div_ceil(4))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Part, Probe};
    use ffgs_core::{Camera, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, TrainingView};
    use ffgs_gpu::Gpu;
    use ffgs_rasterizer::RenderOptions;
    use std::collections::BTreeSet;

    #[test]
    fn passes_of_the_sort_by_tile() {
        let passes = |tiles| Counts { tiles, ..Counts::default() }.tile_passes();
        assert_eq!([1, 16, 17, 240, 3600, 8160].map(passes), [0.0, 1.0, 2.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    #[ignore = "needs a GPU"]
    fn every_kernel_of_a_step_has_a_floor_and_a_time() {
        let gpu = Gpu::for_test();
        let size = ImageSize { width: 40, height: 24 };
        let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 20.0, cy: 12.0 };
        let camera = Camera::new(lens, glam::DMat4::IDENTITY, size).unwrap();
        let mut gaussians = Gaussians::zeros(2, 1);
        // One in sight, one behind the camera.
        gaussians.means.copy_from_slice(&[[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]]);
        gaussians.log_scales.fill([-2.0; 3]);
        let image = ImageRgb8::new(size, vec![90; 3 * size.pixels()]).unwrap();
        let view = TrainingView { camera, image, mask: Mask::filled(size, true) };
        let probe = Probe::new(&gpu, &gaussians, &view, RenderOptions::default()).unwrap();
        let counts = probe.counts(5).unwrap();
        assert_eq!((counts.gaussians, counts.in_sight, counts.tiles, counts.pixels), (2, 1, 6, 960));
        let Some(times) = probe.times(Part::Step).unwrap() else { return };
        let kernels: BTreeSet<_> = times.iter().map(|t| t.kernel).collect();
        let without: Vec<_> = kernels.iter().filter(|k| counts.floor(k).is_none()).collect();
        assert!(kernels.len() >= 15 && without.is_empty(), "{kernels:?}, without a floor: {without:?}");
        let parts = [Part::Forward, Part::Loss, Part::Backward, Part::Adam].map(|p| probe.times(p).unwrap());
        assert_eq!(parts.into_iter().flatten().map(|t| t.len()).sum::<usize>(), times.len());
    }
}
