//! The scene at one frame: static layer, dynamic layer, sky, and what is known of them from earlier frames.

use crate::{Exposure, Gaussians, SkyCube};
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// The scene at one frame: two layers of Gaussians before a sky.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Stands still: its colours change, its shapes only where disocclusion trains them. Shared, so that a device that holds it knows it again: a change of it
    /// (`Arc::make_mut`) makes another one.
    pub static_layer: Arc<Gaussians>,
    /// In how many rounds a static Gaussian still is to be trained in full, because moving things hid it from most
    /// views so far; one per static Gaussian, or empty when none was hidden.
    pub hidden: Vec<u8>,
    /// Variance of SH coefficient 0 and of each other coefficient of the static Gaussians; empty when unknown.
    pub static_colours: Vec<[f32; 2]>,
    /// The static Gaussians that this frame shows otherwise than the next one is to find them.
    pub aside: Aside,
    /// Moves every frame.
    pub dynamic: Dynamic,
    /// At infinity.
    pub sky: SkyCube,
}

/// Opacity logit of a Gaussian that is covered: far below the opacity with which a splat is drawn.
pub const TRANSPARENT: f32 = -10.0;

/// Gaussians of a layer, put aside while others stand in their places.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Aside {
    /// Their places in the layer.
    pub indices: Vec<u32>,
    /// The Gaussians.
    pub gaussians: Gaussians,
}

impl Scene {
    /// Two layers of which nothing is known from earlier frames.
    pub fn new(static_layer: impl Into<Arc<Gaussians>>, dynamic: Dynamic, sky: SkyCube) -> Self {
        let (static_layer, hidden, static_colours) = (static_layer.into(), Vec::new(), Vec::new());
        Self { static_layer, hidden, static_colours, aside: Aside::default(), dynamic, sky }
    }

    /// The static layer with some of its Gaussians transparent, by their indices.
    pub fn without(&self, covered: &[u32]) -> Arc<Gaussians> {
        let mut layer = Arc::clone(&self.static_layer);
        if !covered.is_empty() {
            let logits = &mut Arc::make_mut(&mut layer).opacity_logits;
            covered.iter().for_each(|&i| logits[i as usize] = TRANSPARENT);
        }
        layer
    }

    /// Makes Gaussians transparent, by their indices in [`joint`](Self::joint).
    pub fn make_transparent(&mut self, indices: &[usize]) {
        let still = self.static_layer.len();
        for &i in indices {
            let logit = match i.checked_sub(still) {
                None => &mut Arc::make_mut(&mut self.static_layer).opacity_logits[i],
                Some(i) => &mut self.dynamic.gaussians.opacity_logits[i],
            };
            *logit = TRANSPARENT;
        }
    }

    /// Puts static Gaussians aside as they are in `layer`, until [`take_back`](Self::take_back): what stands in their places in the static layer is
    /// for this frame.
    pub fn put_aside(&mut self, indices: Vec<u32>, layer: &Gaussians) {
        let places: Vec<usize> = indices.iter().map(|&i| i as usize).collect();
        self.aside = Aside { indices, gaussians: layer.select(&places) };
    }

    /// Static Gaussians, by their ascending indices, stay as they are now: nothing is aside in their places any more.
    pub fn keep(&mut self, indices: &[usize]) {
        let Aside { indices: places, gaussians } = &self.aside;
        let others = (0..places.len()).filter(|&at| indices.binary_search(&(places[at] as usize)).is_err());
        let others: Vec<usize> = others.collect();
        if others.len() < places.len() {
            self.aside = Aside {
                indices: others.iter().map(|&at| places[at]).collect(),
                gaussians: gaussians.select(&others),
            };
        }
    }

    /// Puts back what is aside.
    pub fn take_back(&mut self) {
        let Aside { indices, gaussians } = std::mem::take(&mut self.aside);
        if !indices.is_empty() {
            let layer = Arc::make_mut(&mut self.static_layer);
            (0..).zip(indices).for_each(|(from, to)| layer.set_from(to as usize, &gaussians, from));
        }
    }

    /// Shows everything in another light: an offset of the log odds of all colours.
    pub fn relight(&mut self, light: Exposure) {
        let layers =
            [Arc::make_mut(&mut self.static_layer), &mut self.aside.gaussians, &mut self.dynamic.gaussians];
        layers.into_iter().for_each(|layer| layer.relight(light));
        self.sky.texels.iter_mut().for_each(|texel| *texel = light.of_colour(*texel).0);
    }

    /// Both layers, the static one first: what is rendered.
    pub fn layers(&self) -> [&Gaussians; 2] {
        [&self.static_layer, &self.dynamic.gaussians]
    }

    /// Copies both layers into one, the static one first. What only renders borrows [`Scene::layers`].
    #[must_use]
    pub fn joint(&self) -> Gaussians {
        let mut joint = Gaussians::clone(&self.static_layer);
        joint.extend(&self.dynamic.gaussians);
        joint
    }
}

/// The moving layer, and what is known of its positions. Columns have one entry per Gaussian.
#[derive(Clone, Debug, Default)]
pub struct Dynamic {
    /// The Gaussians.
    pub gaussians: Gaussians,
    /// Position covariances (m^2).
    pub covariances: Vec<DMat3>,
    /// Process noise of the last fused frame (m).
    pub q: f64,
    /// Steps of the last initialisation (m); empty before the first.
    pub steps: Vec<DVec3>,
    /// Ids, which stay with a Gaussian over all frames.
    pub ids: Vec<u32>,
    /// The first id that no Gaussian ever had.
    pub next_id: u32,
    /// Information of the photographs so far on the other parameters.
    pub knowledge: Knowledge,
    /// Logarithm of the odds that a Gaussian departs from its rigid group; empty before the first initialisation.
    pub flexibility: Vec<f64>,
    /// Whether so many Gaussians left the masks in the last frame that the masks were taken for wrong and the Gaussians kept.
    pub masks_doubted: bool,
    /// Number of Gaussians that were marked as moving and have not left all images, to which growth by uncertainty is held.
    pub growth_limit: usize,
}

/// Information of the photographs on the parameters of a layer, and how fast it fades.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Knowledge {
    /// Information (inverse variance) of every parameter but the positions, shaped like the Gaussians; turns about the
    /// body's axes (1/rad^2) in the last three values of a quaternion. Empty when nothing is known.
    pub information: Gaussians,
    /// Variance gained from frame to frame: turns (rad^2), log scales, opacity logits, SH coefficient 0, the others; zeros
    /// before the first frame.
    pub drift: [f64; 5],
    /// Standard deviation of a channel of a pixel, and how many values of whole photographs share one error.
    pub noise: [f64; 2],
}

impl Dynamic {
    /// Gives an id to every Gaussian appended since the last call; nothing is known of it yet.
    pub fn number_new(&mut self) {
        let new = self.gaussians.len().saturating_sub(self.ids.len()) as u32;
        self.ids.extend(self.next_id..self.next_id + new);
        self.next_id += new;
        let known = &mut self.knowledge.information;
        if !known.is_empty() {
            known.extend(&Gaussians::zeros(self.gaussians.len() - known.len(), known.sh_degree()));
        }
    }

    /// Keeps the Gaussians `kept`, in this order, with all that is known of them.
    pub fn keep(&mut self, kept: &[usize]) {
        fn select<T: Copy>(column: &mut Vec<T>, kept: &[usize]) {
            if !column.is_empty() {
                *column = kept.iter().map(|&i| column[i]).collect();
            }
        }
        self.gaussians = self.gaussians.select(kept);
        select(&mut self.covariances, kept);
        select(&mut self.steps, kept);
        select(&mut self.ids, kept);
        select(&mut self.flexibility, kept);
        if !self.knowledge.information.is_empty() {
            self.knowledge.information = self.knowledge.information.select(kept);
        }
    }

    /// The last steps (m), if there are any.
    pub fn known_steps(&self) -> Option<&[DVec3]> {
        self.known(&self.steps)
    }

    /// The evidence that Gaussians depart from their rigid groups, if there is any.
    pub fn known_flexibility(&self) -> Option<&[f64]> {
        self.known(&self.flexibility)
    }

    /// A column, if it is one of this layer.
    fn known<'a, T>(&self, column: &'a [T]) -> Option<&'a [T]> {
        (!column.is_empty() && column.len() == self.gaussians.len()).then_some(column)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SH_C0, sigmoid};

    fn logits(scene: &Scene) -> &[f32] {
        &scene.static_layer.opacity_logits
    }

    #[test]
    fn another_light_reaches_all_that_is_shown_and_what_is_aside() {
        let colour = |g: &Gaussians, i: usize| g.sh[i].map(|v| SH_C0 * v + 0.5);
        let dynamic = Dynamic { gaussians: Gaussians::zeros(1, 0), ..Dynamic::default() };
        let mut scene = Scene::new(Gaussians::zeros(2, 0), dynamic, SkyCube::filled(1, [0.5; 3]));
        scene.put_aside(vec![1], &scene.static_layer.clone());
        scene.relight(Exposure { offsets: [0.0, 1.0, -1.0] });
        let expected = [0.5, sigmoid(1.0), sigmoid(-1.0)];
        let shown = [
            colour(&scene.static_layer, 0),
            colour(&scene.aside.gaussians, 0),
            colour(&scene.dynamic.gaussians, 0),
            scene.sky.texels[0],
        ];
        for found in shown {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{shown:?}");
        }
    }

    #[test]
    fn what_is_aside_comes_back() {
        let mut layer = Gaussians::zeros(4, 0);
        layer.opacity_logits = vec![0.1, 0.2, 0.3, 0.4];
        let mut scene = Scene::new(layer, Dynamic::default(), SkyCube::filled(1, [0.0; 3]));
        let before = Arc::clone(&scene.static_layer);
        assert!(Arc::ptr_eq(&scene.without(&[]), &before), "nothing is copied for nothing");
        assert_eq!(scene.without(&[1]).opacity_logits, [0.1, TRANSPARENT, 0.3, 0.4]);
        scene.static_layer = scene.without(&[0, 2, 3]);
        scene.put_aside(vec![0, 2, 3], &before);
        scene.keep(&[1, 3]);
        assert_eq!(logits(&scene), [TRANSPARENT, 0.2, TRANSPARENT, TRANSPARENT]);
        scene.take_back();
        assert_eq!(logits(&scene), [0.1, 0.2, 0.3, TRANSPARENT], "the last one was kept");
        assert_eq!(scene.aside, Aside::default());
        let layer = Arc::clone(&scene.static_layer);
        scene.take_back();
        assert!(Arc::ptr_eq(&layer, &scene.static_layer), "nothing is aside");
    }
}
