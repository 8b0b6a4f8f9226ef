//! The exact state after a frame, from which a run goes on.

use anyhow::{Result, bail};
use ffgs_core::{Aside, Dynamic, Gaussians, Knowledge, PixelFilter, Scene, SkyCube};
use ffgs_splats::{FrameState, load_checkpoint, save_checkpoint};
use glam::DMat3;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Name of the flag that the last masks were taken for wrong.
const DOUBTED: &str = "masks_doubted";

/// Name of the number of Gaussians to which growth is held.
const ENTITLED: &str = "dynamic_entitled";

/// Name of the flag that the layers are drawn with the plain filter.
const PLAIN: &str = "plain_filter";

/// Writes the state atomically.
///
/// # Errors
/// When the file cannot be written.
pub fn save(path: &Path, frame: usize, scene: &Scene) -> Result<()> {
    let state = FrameState {
        frame: frame as u64,
        static_layer: Cow::Borrowed(&scene.static_layer),
        dynamic_layer: Cow::Borrowed(&scene.dynamic.gaussians),
        dynamic_covariances: scene.dynamic.covariances.clone(),
        sky_face_size: scene.sky.face_size(),
        sky: scene.sky.texels.as_flattened().to_vec(),
        q: scene.dynamic.q,
        dynamic_steps: scene.dynamic.steps.clone(),
        dynamic_ids: scene.dynamic.ids.clone(),
        next_id: scene.dynamic.next_id,
        dynamic_information: Cow::Borrowed(&scene.dynamic.knowledge.information),
        reals: reals(&scene.dynamic.knowledge),
        dynamic_flexibility: scene.dynamic.flexibility.clone(),
        static_hidden: scene.hidden.clone(),
        static_colours: scene.static_colours.clone(),
        aside: scene.aside.indices.clone(),
        aside_layer: Cow::Borrowed(&scene.aside.gaussians),
        integers: integers(scene),
        ..FrameState::default()
    };
    if let Some(fault) = fault(&state) {
        bail!(
            "frame {frame} went wrong: {fault}; nothing of it is kept. Is a rate of the configuration too large?"
        );
    }
    Ok(save_checkpoint(path, &state)?)
}

/// Names of the drifts and of the noise among a state's numbers.
const DRIFT: [&str; 5] = ["drift turns", "drift log scales", "drift opacities", "drift sh0", "drift sh rest"];
const NOISE: [&str; 2] = ["noise sigma", "noise correlated"];

fn integers(scene: &Scene) -> BTreeMap<String, u64> {
    let always =
        [(DOUBTED, u64::from(scene.dynamic.masks_doubted)), (ENTITLED, scene.dynamic.growth_limit as u64)];
    let plain = (scene.static_layer.filter == PixelFilter::Plain).then_some((PLAIN, 1));
    always.into_iter().chain(plain).map(|(name, value)| (name.to_owned(), value)).collect()
}

fn reals(knowledge: &Knowledge) -> BTreeMap<String, f64> {
    let drift = DRIFT.iter().zip(knowledge.drift);
    drift.chain(NOISE.iter().zip(knowledge.noise)).map(|(name, value)| ((*name).to_owned(), value)).collect()
}

/// Reads the state after `frame`.
///
/// # Errors
/// A file that is damaged, of another frame, or of layers that no run can go on from.
pub fn load(path: &Path, frame: usize) -> Result<Scene> {
    let state = load_checkpoint(path)?;
    let fault = if state.frame == frame as u64 {
        fault(&state)
    } else {
        Some(format!("it is the state after frame {}", state.frame))
    };
    if let Some(fault) = fault {
        bail!("{}: {fault}; remove this frame's folder and resume", path.display());
    }
    let mut sky = SkyCube::filled(state.sky_face_size, [0.0; 3]);
    sky.texels = state.sky.as_chunks::<3>().0.to_vec();
    let real = |name: &&str| state.reals.get(*name).copied().unwrap_or(0.0);
    let knowledge = Knowledge {
        information: state.dynamic_information.into_owned(),
        drift: DRIFT.each_ref().map(real),
        noise: NOISE.each_ref().map(real),
    };
    let plain = state.integers.get(PLAIN).is_some_and(|v| *v > 0);
    let filter = if plain { PixelFilter::Plain } else { PixelFilter::Compensated };
    let growth_limit = state.integers.get(ENTITLED).map_or(state.dynamic_layer.len(), |&n| n as usize);
    let dynamic = Dynamic {
        gaussians: state.dynamic_layer.into_owned().with_filter(filter),
        covariances: state.dynamic_covariances,
        q: state.q,
        steps: state.dynamic_steps,
        ids: state.dynamic_ids,
        next_id: state.next_id,
        knowledge,
        flexibility: state.dynamic_flexibility,
        growth_limit,
        masks_doubted: state.integers.get(DOUBTED).is_some_and(|v| *v > 0),
    };
    let static_layer = Arc::new(state.static_layer.into_owned().with_filter(filter));
    let aside = Aside { indices: state.aside, gaussians: state.aside_layer.into_owned().with_filter(filter) };
    Ok(Scene {
        static_layer,
        hidden: state.static_hidden,
        static_colours: state.static_colours,
        aside,
        dynamic,
        sky,
    })
}

/// What keeps a run from going on; `None` for a sound state.
fn fault(state: &FrameState) -> Option<String> {
    let (fixed, moving) = (&state.static_layer, &state.dynamic_layer);
    if state.sky_face_size == 0 {
        return Some("it has no sky".into());
    }
    if state.dynamic_covariances.len() != moving.len() {
        return Some(format!(
            "{} covariances of {} Gaussians",
            state.dynamic_covariances.len(),
            moving.len()
        ));
    }
    if state.dynamic_ids.len() != moving.len() {
        return Some(format!("{} ids of {} Gaussians", state.dynamic_ids.len(), moving.len()));
    }
    if fixed.sh_degree() != moving.sh_degree() {
        let degrees = (fixed.sh_degree(), moving.sh_degree());
        return Some(format!("its layers have spherical harmonics of degrees {degrees:?}"));
    }
    let not_a_number = |what: &str| Some(format!("{what} is not a number"));
    let aside = &state.aside_layer;
    if !aside.is_empty() && aside.sh_degree() != fixed.sh_degree() {
        let degrees = (aside.sh_degree(), fixed.sh_degree());
        return Some(format!(
            "what is put aside and the static layer have spherical harmonics of degrees {degrees:?}"
        ));
    }
    for (name, layer) in [("static", fixed), ("dynamic", moving), ("put aside", aside)] {
        if let Some(column) = column_not_finite(layer) {
            return not_a_number(&format!("{column} of the {name} layer"));
        }
    }
    if !state.static_colours.as_flattened().iter().all(|v| v.is_finite() && *v > 0.0) {
        return Some("a variance of the static layer's colours is not a positive number".into());
    }
    if state.dynamic_covariances.iter().any(DMat3::is_nan) {
        return not_a_number("a covariance");
    }
    if !state.sky.iter().all(|v| v.is_finite()) {
        return not_a_number("a texel of the sky");
    }
    if state.q.is_nan() { not_a_number("the process noise") } else { None }
}

fn column_not_finite(layer: &Gaussians) -> Option<&'static str> {
    let columns = [
        ("a position", layer.means.as_flattened()),
        ("a rotation", layer.quats.as_flattened()),
        ("a scale", layer.log_scales.as_flattened()),
        ("an opacity", &layer.opacity_logits),
        ("a colour", layer.sh.as_flattened()),
    ];
    columns.into_iter().find(|(_, values)| !values.iter().all(|v| v.is_finite())).map(|(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    type Change = fn(&mut FrameState<'static>);

    fn sound() -> FrameState<'static> {
        FrameState {
            frame: 1,
            static_layer: Cow::Owned(Gaussians::zeros(2, 1)),
            dynamic_layer: Cow::Owned(Gaussians::zeros(1, 1)),
            dynamic_covariances: vec![DMat3::from_diagonal(DVec3::ONE)],
            dynamic_ids: vec![0],
            next_id: 1,
            sky_face_size: 1,
            sky: vec![0.5; 18],
            ..FrameState::default()
        }
    }

    fn put_aside(state: &mut FrameState<'static>, degree: usize, logit: f32) {
        state.aside = vec![1];
        let layer = state.aside_layer.to_mut();
        *layer = Gaussians::zeros(1, degree);
        layer.opacity_logits[0] = logit;
    }

    #[test]
    fn a_state_that_no_run_can_go_on_from_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.ffgs");
        save_checkpoint(&path, &sound()).unwrap();
        assert_eq!(load(&path, 1).unwrap().dynamic.gaussians.len(), 1);
        let faults: [(Change, &str); 12] = [
            (|s| s.frame = 2, "after frame 2"),
            (|s| s.dynamic_covariances.clear(), "0 covariances of 1"),
            (|s| s.dynamic_ids.clear(), "0 ids of 1"),
            (|s| s.dynamic_layer = Cow::Owned(Gaussians::zeros(1, 2)), "degrees (1, 2)"),
            (|s| s.static_layer.to_mut().means[1][2] = f32::NAN, "a position of the static layer"),
            (|s| s.dynamic_layer.to_mut().sh[0][0] = f32::INFINITY, "a colour of the dynamic layer"),
            (|s| s.dynamic_covariances[0].x_axis.y = f64::NAN, "a covariance is not a number"),
            (|s| s.sky[3] = f32::NAN, "a texel of the sky"),
            (|s| s.static_colours = vec![[1.0, 0.0]; 2], "a variance of the static layer's colours"),
            (|s| put_aside(s, 1, f32::NAN), "an opacity of the put aside layer is not a number"),
            (
                |s| put_aside(s, 2, 0.0),
                "put aside and the static layer have spherical harmonics of degrees (2, 1)",
            ),
            (|s| (s.sky_face_size, s.sky) = (0, Vec::new()), "no sky"),
        ];
        for (change, words) in faults {
            let mut changed = sound();
            change(&mut changed);
            save_checkpoint(&path, &changed).unwrap();
            let error = load(&path, 1).err().unwrap().to_string();
            assert!(error.contains(words) && error.contains("state.ffgs"), "{error}");
        }
    }
}
