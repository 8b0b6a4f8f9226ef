//! The exact state after a frame, from which a run goes on.

use anyhow::{Result, bail};
use ffgs_core::{Dynamic, Knowledge, Scene, SkyCube};
use ffgs_splats::{FrameState, load_checkpoint, save_checkpoint};
use std::collections::BTreeMap;
use std::path::Path;

/// Name of the flag that the last masks were doubted.
const DOUBTED: &str = "masks_doubted";

/// Name of the number of Gaussians that growth may make up for.
const ENTITLED: &str = "dynamic_entitled";

/// Writes the state atomically.
pub fn save(path: &Path, frame: usize, scene: &Scene) -> Result<()> {
    let state = FrameState {
        frame: frame as u64,
        static_layer: scene.static_layer.clone(),
        dynamic_layer: scene.dynamic.gaussians.clone(),
        dynamic_covariances: scene.dynamic.covariances.clone(),
        sky_face_size: scene.sky.face_size(),
        sky: scene.sky.texels.as_flattened().to_vec(),
        q: scene.dynamic.q,
        dynamic_steps: scene.dynamic.steps.clone(),
        dynamic_ids: scene.dynamic.ids.clone(),
        next_id: scene.dynamic.next_id,
        dynamic_information: scene.dynamic.knowledge.information.clone(),
        reals: reals(&scene.dynamic.knowledge),
        dynamic_flexibility: scene.dynamic.flexibility.clone(),
        integers: [
            (DOUBTED.to_owned(), u64::from(scene.dynamic.doubted)),
            (ENTITLED.to_owned(), scene.dynamic.entitled as u64),
        ]
        .into(),
        ..FrameState::default()
    };
    Ok(save_checkpoint(path, &state)?)
}

/// Names of the drifts and of the noise among a state's numbers.
const DRIFT: [&str; 5] = ["drift turns", "drift log scales", "drift opacities", "drift sh0", "drift sh rest"];
const NOISE: [&str; 2] = ["noise sigma", "noise correlated"];

fn reals(knowledge: &Knowledge) -> BTreeMap<String, f64> {
    let drift = DRIFT.iter().zip(knowledge.drift);
    drift.chain(NOISE.iter().zip(knowledge.noise)).map(|(name, value)| ((*name).to_owned(), value)).collect()
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
    let real = |name: &&str| state.reals.get(*name).copied().unwrap_or(0.0);
    let knowledge = Knowledge {
        information: state.dynamic_information,
        drift: DRIFT.each_ref().map(real),
        noise: NOISE.each_ref().map(real),
    };
    let entitled = state.integers.get(ENTITLED).map_or(state.dynamic_layer.len(), |&n| n as usize);
    let dynamic = Dynamic {
        gaussians: state.dynamic_layer,
        covariances: state.dynamic_covariances,
        q: state.q,
        steps: state.dynamic_steps,
        ids: state.dynamic_ids,
        next_id: state.next_id,
        knowledge,
        flexibility: state.dynamic_flexibility,
        entitled,
        doubted: state.integers.get(DOUBTED).is_some_and(|v| *v > 0),
    };
    Ok(Scene { static_layer: state.static_layer, dynamic, sky })
}
