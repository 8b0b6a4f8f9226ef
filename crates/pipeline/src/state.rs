//! The exact state after a frame, from which a run goes on.

use crate::motion::Dynamic;
use crate::scoring::Layers;
use anyhow::{Result, bail};
use ffgs_splats::{FrameState, load_checkpoint, save_checkpoint};
use ffgs_trainer::SkyCube;
use std::path::Path;

/// Writes the state atomically.
pub fn save(path: &Path, frame: usize, layers: &Layers) -> Result<()> {
    let state = FrameState {
        frame: frame as u64,
        static_layer: layers.static_layer.clone(),
        dynamic_layer: layers.dynamic.gaussians.clone(),
        dynamic_covariances: layers.dynamic.covariances.clone(),
        sky_face_size: layers.sky.face_size(),
        sky: layers.sky.texels.as_flattened().to_vec(),
        q: layers.dynamic.q,
        dynamic_steps: layers.dynamic.steps.clone(),
        ..FrameState::default()
    };
    Ok(save_checkpoint(path, &state)?)
}

/// Reads a state.
pub fn load(path: &Path) -> Result<Layers> {
    let state = load_checkpoint(path)?;
    let texels = state.sky.as_chunks::<3>().0.to_vec();
    if state.sky_face_size == 0 || texels.len() != 6 * state.sky_face_size * state.sky_face_size {
        bail!(
            "{}: the sky has {} texels for faces of {} px",
            path.display(),
            texels.len(),
            state.sky_face_size
        );
    }
    let mut sky = SkyCube::filled(state.sky_face_size, [0.0; 3]);
    sky.texels = texels;
    let dynamic = Dynamic {
        gaussians: state.dynamic_layer,
        covariances: state.dynamic_covariances,
        q: state.q,
        steps: state.dynamic_steps,
    };
    Ok(Layers { static_layer: state.static_layer, dynamic, sky })
}
