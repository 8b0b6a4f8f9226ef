//! `ffgs stage associate`: Gaussians are blended and gather the motion under their footprints, as in a run.

use super::agreement::motions;
use super::contributors::mask;
use super::input::{Input, narrow};
use super::rasterize::{gaussians, read_camera};
use anyhow::{Result, ensure};
use ffgs_arrays::NpzWriter;
use ffgs_motion::AssociationConfig;
use ffgs_rasterizer::{Association, AssociationScene, AssociationScratch, Observed};
use glam::DVec2;

pub(super) fn run(input: &Input) -> Result<NpzWriter> {
    let (mut gaussians, camera) = (gaussians(input)?, read_camera(input)?);
    let fields = motions(input)?;
    let size = camera.size();
    ensure!(fields[0].size == size, input.fault("flow", "another size than height, width"));
    let mask = mask(input, size)?;
    let (l, n) = (fields.len(), gaussians.len());
    // Colours play no part.
    gaussians.sh = vec![[0.0; 3]; n];
    let means = gaussians.positions();
    let (mut targets, mut weights) = (vec![DVec2::ZERO; l * n], vec![0.0; l * n]);
    let columns = targets.chunks_mut(n).zip(weights.chunks_mut(n));
    let mut observed: Vec<Observed> =
        columns.map(|(targets, weights)| Observed { targets, weights }).collect();
    let config = AssociationConfig::default();
    let association = Association {
        camera: &camera,
        mask: &mask,
        fields: &fields,
        flow_floor_px: config.flow_floor_px,
        min_coverage: config.min_coverage,
        min_hits: config.min_hits,
        min_transmittance: config.min_transmittance,
        contributors: config.contributors,
        normalise: config.normalise,
    };
    let scene = AssociationScene::new(&[&gaussians], &means);
    association.observe(&scene, &mut observed, &mut AssociationScratch::default());
    let targets: Vec<f64> = targets.iter().flat_map(DVec2::to_array).collect();
    let mut results = NpzWriter::new();
    results.f32("weight", &[l, n], &narrow(&weights));
    results.f32("target", &[l, n, 2], &narrow(&targets));
    Ok(results)
}
