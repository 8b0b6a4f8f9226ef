//! The scene as methods without layers know it: every Gaussian may move, the sky stays behind (docs/adr/0036).

use ffgs_core::{Dynamic, Gaussians, Knowledge, Scene};
use glam::DMat3;
use std::sync::Arc;

/// Moves the static layer behind the Gaussians of the dynamic one, where its Gaussians get ids. What is known of the
/// dynamic layer's positions is dropped: these methods estimate no covariance, and none is written (zero).
pub(crate) fn join(scene: &mut Scene) {
    scene.take_back();
    let Scene { static_layer, hidden, static_colours, dynamic, .. } = scene;
    if !static_layer.is_empty() {
        hidden.clear();
        static_colours.clear();
        let none = Arc::new(Gaussians::empty(static_layer.sh_degree()));
        let fixed = std::mem::replace(static_layer, none);
        dynamic.gaussians.extend(&fixed);
    }
    dynamic.knowledge = Knowledge::default();
    dynamic.flexibility.clear();
    dynamic.steps.clear();
    number(dynamic);
}

/// Replaces the Gaussians; the first of the new ones are the old ones `kept`, in this order.
pub(crate) fn replace(dynamic: &mut Dynamic, gaussians: Gaussians, kept: &[usize]) {
    dynamic.ids = kept.iter().map(|&i| dynamic.ids[i]).collect();
    dynamic.gaussians = gaussians;
    number(dynamic);
}

fn number(dynamic: &mut Dynamic) {
    dynamic.number_new();
    dynamic.covariances.clear();
    dynamic.covariances.resize(dynamic.gaussians.len(), DMat3::ZERO);
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::SkyCube;

    #[test]
    fn ids_stay_and_new_gaussians_get_new_ones() {
        let dynamic = Dynamic { gaussians: Gaussians::zeros(2, 1), ..Dynamic::default() };
        let mut scene = Scene::new(Gaussians::zeros(3, 1), dynamic, SkyCube::filled(1, [0.0; 3]));
        (scene.hidden, scene.static_colours) = (vec![1; 3], vec![[1.0; 2]; 3]);
        scene.put_aside(vec![1], &Gaussians::zeros(3, 1));
        scene.dynamic.number_new();
        join(&mut scene);
        assert_eq!((scene.static_layer.len(), &scene.dynamic.ids[..]), (0, &[0, 1, 2, 3, 4][..]));
        assert_eq!((scene.static_layer.sh_degree(), scene.dynamic.covariances.len()), (1, 5));
        assert!(scene.hidden.is_empty() && scene.static_colours.is_empty());
        let mut before = scene.clone();
        join(&mut scene);
        assert_eq!(scene.dynamic.ids, before.dynamic.ids, "once is enough");
        replace(&mut before.dynamic, Gaussians::zeros(4, 1), &[1, 3, 4]);
        assert_eq!((&before.dynamic.ids[..], before.dynamic.covariances.len()), (&[1, 3, 4, 5][..], 4));
    }
}
