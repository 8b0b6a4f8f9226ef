//! The exact state after a frame, from which a run goes on.

use anyhow::{Result, bail};
use ffgs_core::{Dynamic, Scene, SkyCube};
use ffgs_splats::{FrameState, load_checkpoint, save_checkpoint};
use std::borrow::Cow;
use std::path::Path;

/// Writes the state atomically.
pub fn save(path: &Path, frame: usize, scene: &Scene) -> Result<()> {
    let state = FrameState {
        frame: frame as u64,
        static_layer: Cow::Borrowed(&scene.static_layer),
        dynamic_layer: Cow::Borrowed(&scene.dynamic.gaussians),
        dynamic_covariances: Cow::Borrowed(&scene.dynamic.covariances),
        sky_face_size: scene.sky.face_size(),
        sky: Cow::Borrowed(scene.sky.texels.as_flattened()),
        q: scene.dynamic.q,
<<<<<<< HEAD
        dynamic_steps: scene.dynamic.steps.clone(),
        dynamic_ids: scene.dynamic.ids.clone(),
        next_id: scene.dynamic.next_id,
=======
        dynamic_steps: Cow::Borrowed(&scene.dynamic.steps),
>>>>>>> 5f87654 (report: pictures are encoded once per frame; a run decodes images once)
        ..FrameState::default()
    };
    Ok(save_checkpoint(path, &state)?)
}

/// Reads a state.
pub fn load(path: &Path) -> Result<Scene> {
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
        gaussians: state.dynamic_layer.into_owned(),
        covariances: state.dynamic_covariances.into_owned(),
        q: state.q,
<<<<<<< HEAD
        steps: state.dynamic_steps,
        ids: state.dynamic_ids,
        next_id: state.next_id,
=======
        steps: state.dynamic_steps.into_owned(),
>>>>>>> 5f87654 (report: pictures are encoded once per frame; a run decodes images once)
    };
    Ok(Scene { static_layer: state.static_layer.into_owned(), dynamic, sky })
}
