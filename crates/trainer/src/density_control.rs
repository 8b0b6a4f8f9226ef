//! Adaptive density control of 3D Gaussian Splatting (Kerbl et al. 2023, section 5), with a hard cap.
//!
//! A Gaussian whose projected mean has a large average gradient is replaced by two, or cloned ([`Split`]);
//! transparent and oversized ones are removed. When the cap leaves no room for all candidates, those with the
//! largest gradients win.

use ffgs_core::{Gaussians, logit, sigmoid};
use glam::{Quat, Vec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Children of a split.
const CHILDREN: usize = 2;
/// A sampled child's scale is its parent's divided by `0.8 * CHILDREN` (3DGS `densify_and_split`).
const CHILD_SHRINK: f32 = 0.8 * CHILDREN as f32;
/// Halves lie this far from their parent along its longest axis (standard deviations), and are so many times as large along it and
/// along the others, and as opaque.
const HALF: HalfShape = HalfShape { offset: 0.5, along: 0.5, across: 0.85, opacity: 0.6 };

/// How one half differs from its parent.
struct HalfShape {
    offset: f32,
    along: f32,
    across: f32,
    opacity: f32,
}

/// How Gaussians that grow become more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// As in 3DGS: small ones are cloned, large ones replaced by two random samples of their density.
    Sampled,
    /// All are replaced by two halves beside each other on the longest axis, less opaque, as they overlap (long-axis split of Deng et
    /// al. 2024, "Efficient Density Control for 3D Gaussian Splatting"; docs/adr/0071).
    Halves,
}

/// Thresholds of the density control; defaults of 3DGS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensityConfig {
    /// Mean gradient of the projected position from which a Gaussian grows (loss per half image width, NDC units).
    pub grow_gradient: f32,
    /// How they become more.
    pub split: Split,
    /// Largest standard deviation that is still cloned and not split, as a share of the scene's extent ([`Split::Sampled`]).
    pub split_scale: f32,
    /// Opacity below which a Gaussian is removed.
    pub prune_opacity: f32,
    /// Largest standard deviation that is kept, as a share of the scene's extent; infinite = off.
    pub prune_scale: f32,
    /// Number of Gaussians never exceeded by growth.
    pub max_gaussians: usize,
}

impl Default for DensityConfig {
    fn default() -> Self {
        Self {
            grow_gradient: 2e-4,
            split: Split::Sampled,
            split_scale: 0.01,
            prune_opacity: 0.005,
            prune_scale: 0.1,
            max_gaussians: 1_000_000,
        }
    }
}

/// What the views since the last round of density control say of every Gaussian; columns of length N.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GradientSums {
    /// Sum of the norms of the loss gradient by the projected mean, scaled from pixels to normalised device coordinates:
    /// `|(dL/dx * width / 2, dL/dy * height / 2)|`.
    pub norms: Vec<f32>,
    /// Number of views that drew the Gaussian.
    pub views: Vec<u32>,
}

impl GradientSums {
    /// Nothing yet of `n` Gaussians.
    pub fn new(n: usize) -> Self {
        Self { norms: vec![0.0; n], views: vec![0; n] }
    }

    /// Adds one view: the norms of those Gaussians that it drew.
    ///
    /// # Panics
    /// When a column has another length than the set.
    pub fn add(&mut self, norms: &[f32], drawn: &[bool]) {
        let n = self.views.len();
        assert_eq!([norms.len(), drawn.len()], [n; 2], "columns of the view");
        for i in (0..n).filter(|&i| drawn[i]) {
            self.norms[i] += norms[i];
            self.views[i] += 1;
        }
    }

    /// Mean of the norms over the views that drew Gaussian `i`; 0 when none did.
    pub fn mean(&self, i: usize) -> f32 {
        if self.views[i] == 0 { 0.0 } else { self.norms[i] / self.views[i] as f32 }
    }
}

/// What becomes of each Gaussian, columns of length N. A Gaussian is never both grown and pruned by size.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DensityPlan {
    /// Indices that get a copy, ascending.
    pub clone: Vec<usize>,
    /// Indices that are replaced by two children, ascending.
    pub split: Vec<usize>,
    /// Whether the Gaussian is removed, (N).
    pub prune: Vec<bool>,
}

impl DensityPlan {
    /// All of `count` Gaussians stay, and none grows.
    pub(crate) fn unchanged(count: usize) -> Self {
        Self { prune: vec![false; count], ..Self::default() }
    }

    /// Removes those of a column (N) as well; they do not grow.
    pub(crate) fn remove(&mut self, gone: &[bool]) {
        self.prune.iter_mut().zip(gone).for_each(|(prune, gone)| *prune |= gone);
        self.clone.retain(|&i| !gone[i]);
        self.split.retain(|&i| !gone[i]);
    }

    /// How many are removed.
    pub(crate) fn removed(&self) -> usize {
        self.prune.iter().filter(|&&prune| prune).count()
    }
}

/// Where each Gaussian of the new set came from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct IndexMap {
    /// Index in the old set, (N new); carries labels and covariances over.
    pub sources: Vec<usize>,
    /// Whether it is the same Gaussian, with its moments; new ones come after all kept ones.
    pub keeps_moments: Vec<bool>,
}

impl IndexMap {
    /// Every Gaussian stays what it is.
    pub fn identity(count: usize) -> Self {
        Self { sources: (0..count).collect(), keeps_moments: vec![true; count] }
    }

    /// Number of Gaussians of the new set.
    pub fn len(&self) -> usize {
        self.sources.len()
    }

    /// Whether the new set is empty.
    pub fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }

    /// Number of kept Gaussians; they come first.
    pub fn kept(&self) -> usize {
        self.keeps_moments.partition_point(|&keeps| keeps)
    }

    /// A column of the old set, carried over to the new one.
    pub fn carry<T: Clone>(&self, column: &[T]) -> Vec<T> {
        self.sources.iter().map(|&i| column[i].clone()).collect()
    }
}

/// Turns gradient sums into growth and removal.
#[derive(Clone, Debug)]
pub struct DensityControl {
    config: DensityConfig,
    rng: ChaCha8Rng,
}

impl DensityControl {
    /// `seed` fixes where children of a split come to lie.
    pub fn new(config: DensityConfig, seed: u64) -> Self {
        Self { config, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// Sets the number of Gaussians that growth never exceeds.
    pub fn set_limit(&mut self, max_gaussians: usize) {
        self.config.max_gaussians = max_gaussians;
    }

    /// Decides by `sums`; `extent` is the radius of the camera positions (m).
    pub fn plan(&self, gaussians: &Gaussians, sums: &GradientSums, extent: f32) -> DensityPlan {
        let prune: Vec<bool> = (0..gaussians.len()).map(|i| self.is_pruned(gaussians, extent, i)).collect();
        let kept = prune.iter().filter(|&&p| !p).count();
        let room = self.config.max_gaussians.saturating_sub(kept);
        let (mut clone, mut split) = (Vec::new(), Vec::new());
        for i in self.best_candidates(&prune, sums, room) {
            let cloned = self.config.split == Split::Sampled
                && largest_scale(gaussians, i) <= self.config.split_scale * extent;
            if cloned { clone.push(i) } else { split.push(i) }
        }
        DensityPlan { clone, split, prune }
    }

    /// Candidates for growth, at most `room` (each adds one Gaussian), ascending.
    fn best_candidates(&self, prune: &[bool], sums: &GradientSums, room: usize) -> Vec<usize> {
        let grows = |i: &usize| !prune[*i] && sums.mean(*i) >= self.config.grow_gradient;
        let mut candidates: Vec<usize> = (0..prune.len()).filter(grows).collect();
        if candidates.len() > room {
            candidates.sort_by(|&a, &b| sums.mean(b).total_cmp(&sums.mean(a)).then(a.cmp(&b)));
            candidates.truncate(room);
            candidates.sort_unstable();
        }
        candidates
    }

    /// NaN opacities and scales are removed as well.
    fn is_pruned(&self, gaussians: &Gaussians, extent: f32, i: usize) -> bool {
        let opaque = sigmoid(gaussians.opacity_logits[i]) >= self.config.prune_opacity;
        let small = largest_scale(gaussians, i) <= self.config.prune_scale * extent;
        !(opaque && small)
    }

    /// Carries out a plan. Kept Gaussians come first in their old order, then clones,
    /// then children of splits. The caller passes the map on to `Adam::remap` and to its own columns.
    pub fn apply(&mut self, plan: &DensityPlan, gaussians: &mut Gaussians) -> IndexMap {
        let mut gone = plan.prune.clone();
        plan.split.iter().for_each(|&i| gone[i] = true);
        let mut sources: Vec<usize> = (0..gaussians.len()).filter(|&i| !gone[i]).collect();
        let mut keeps_moments = vec![true; sources.len()];
        sources.extend(&plan.clone);
        let first_child = sources.len();
        sources.extend(plan.split.iter().flat_map(|&i| [i; CHILDREN]));
        keeps_moments.resize(sources.len(), false);
        *gaussians = gaussians.select(&sources);
        for i in first_child..sources.len() {
            match self.config.split {
                Split::Sampled => self.make_child(gaussians, i),
                Split::Halves => make_half(gaussians, i, (i - first_child).is_multiple_of(CHILDREN)),
            }
        }
        IndexMap { sources, keeps_moments }
    }

    /// From Gaussian `first` on, invisible ones become children of those with the largest gradients, which are split:
    /// the number of Gaussians stays.
    pub(crate) fn reuse(
        &mut self,
        gaussians: &mut Gaussians,
        sums: &GradientSums,
        first: usize,
        extent: f32,
    ) {
        let count = gaussians.len();
        let invisible = |i: usize| self.is_pruned(gaussians, extent, i);
        let barred: Vec<bool> = (0..count).map(|i| i < first || invisible(i)).collect();
        let slots: Vec<usize> = (first..count).filter(|&i| barred[i]).collect();
        let parents = self.best_candidates(&barred, sums, slots.len());
        for (parent, slot) in parents.into_iter().zip(slots) {
            let copy = gaussians.select(&[parent]);
            gaussians.set_from(slot, &copy, 0);
            self.make_child(gaussians, parent);
            self.make_child(gaussians, slot);
        }
    }

    /// Turns a copy of the parent into a child: a sample of the parent's density, scale divided by 1.6.
    fn make_child(&mut self, gaussians: &mut Gaussians, i: usize) {
        let scale = Vec3::from(gaussians.log_scales[i]).exp();
        let offset = scale * Vec3::from_array(std::array::from_fn(|_| normal(&mut self.rng)));
        move_by(gaussians, i, offset);
        gaussians.log_scales[i] = gaussians.log_scales[i].map(|s| s - CHILD_SHRINK.ln());
    }
}

/// Turns a copy of the parent into its half ahead, or behind, on the longest axis.
fn make_half(gaussians: &mut Gaussians, i: usize, ahead: bool) {
    let longest = Vec3::from(gaussians.log_scales[i]).max_position();
    let mut offset = Vec3::ZERO;
    offset[longest] = gaussians.log_scales[i][longest].exp() * if ahead { HALF.offset } else { -HALF.offset };
    move_by(gaussians, i, offset);
    for (axis, scale) in gaussians.log_scales[i].iter_mut().enumerate() {
        *scale += if axis == longest { HALF.along.ln() } else { HALF.across.ln() };
    }
    gaussians.opacity_logits[i] = logit(HALF.opacity * sigmoid(gaussians.opacity_logits[i]));
}

/// Moves a Gaussian by an offset along its own axes (m).
fn move_by(gaussians: &mut Gaussians, i: usize, offset: Vec3) {
    let [w, x, y, z] = gaussians.quats[i];
    let rotation = Quat::from_xyzw(x, y, z, w);
    let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { Quat::IDENTITY };
    gaussians.means[i] = (Vec3::from(gaussians.means[i]) + rotation * offset).to_array();
}

/// A standard normal sample (Box-Muller).
pub fn normal(rng: &mut impl Rng) -> f32 {
    let (radius, angle): (f32, f32) = (rng.random(), rng.random());
    // 1 - u lies in (0, 1], so that the logarithm is finite.
    (-2.0 * (1.0 - radius).ln()).sqrt() * (std::f32::consts::TAU * angle).cos()
}

fn largest_scale(gaussians: &Gaussians, i: usize) -> f32 {
    Vec3::from(gaussians.log_scales[i]).max_element().exp()
}

/// Lowers every opacity to at most `ceiling` (3DGS: 0.01); call `Adam::reset_opacity` with it.
pub(crate) fn reset_opacities(gaussians: &mut Gaussians, ceiling: f32) {
    let limit = logit(ceiling);
    gaussians.opacity_logits.iter_mut().for_each(|o| *o = o.min(limit));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gaussian 0 small and moving, 1 large and moving, 2 at rest, 3 transparent, 4 too large.
    fn scene() -> Gaussians {
        let mut g = Gaussians::zeros(5, 1);
        g.quats.fill([1.0, 0.0, 0.0, 0.0]);
        g.log_scales.fill([0.001f32.ln(); 3]);
        g.log_scales[1] = [0.05f32.ln(), 0.001f32.ln(), 0.001f32.ln()];
        g.log_scales[4] = [0.5f32.ln(); 3];
        g.opacity_logits[3] = logit(0.001);
        g
    }

    fn control(config: DensityConfig) -> DensityControl {
        DensityControl::new(config, 7)
    }

    fn sums() -> GradientSums {
        let (mut sums, norms) = (GradientSums::new(5), [3e-4, 5e-4, 1e-4, 1e-3, 1e-3]);
        sums.add(&norms, &[true; 5]);
        sums.add(&norms, &[false; 5]);
        sums
    }

    #[test]
    fn grows_by_size_and_removes() {
        let mut g = scene();
        let parent = g.clone();
        let mut control = control(DensityConfig::default());
        let plan = control.plan(&g, &sums(), 1.0);
        assert_eq!((&plan.clone[..], &plan.split[..]), (&[0][..], &[1][..]));
        assert_eq!(plan.prune, [false, false, false, true, true]);
        let map = control.apply(&plan, &mut g);
        assert_eq!(map.sources, [0, 2, 0, 1, 1]);
        assert_eq!(map.kept(), 2);
        assert_eq!(map.carry(&['a', 'b', 'c', 'd', 'e']), ['a', 'c', 'a', 'b', 'b']);
        g.validate().unwrap();
        assert_eq!(g.means[2], parent.means[0]);
        assert_ne!(g.means[3], g.means[4]);
        assert!((g.log_scales[3][0] - (0.05f32 / 1.6).ln()).abs() < 1e-6);
        assert!(g.means[3][0].abs() < 5.0 * 0.05 && g.means[3][1].abs() < 5.0 * 0.001);
    }

    #[test]
    fn halves_lie_on_the_longest_axis_and_hide_no_more_than_their_parent() {
        let mut g = scene();
        // A quarter turn about z: the longest axis, x, points along y.
        g.quats[1] = [2.0, 0.0, 0.0, 2.0];
        let parent = g.clone();
        let mut control = control(DensityConfig { split: Split::Halves, ..DensityConfig::default() });
        let plan = control.plan(&g, &sums(), 1.0);
        assert_eq!((plan.clone.len(), &plan.split[..]), (0, &[0, 1][..]), "small ones are split, too");
        let map = control.apply(&plan, &mut g);
        assert_eq!(map.sources, [2, 0, 0, 1, 1]);
        g.validate().unwrap();
        for (half, side) in [(3, 0.025), (4, -0.025)] {
            let expected = Vec3::from(parent.means[1]) + Vec3::Y * side;
            assert!((Vec3::from(g.means[half]) - expected).length() < 1e-6, "{:?}", g.means[half]);
            let scales = g.log_scales[half].map(f32::exp);
            let expected = [0.025, 0.000_85, 0.000_85];
            assert!(scales.iter().zip(expected).all(|(s, e)| (s / e - 1.0).abs() < 1e-4), "{scales:?}");
            let [one, whole] = [sigmoid(g.opacity_logits[half]), sigmoid(parent.opacity_logits[1])];
            assert!((one - 0.6 * whole).abs() < 1e-6);
        }
    }

    #[test]
    fn the_cap_admits_the_largest_gradients() {
        let config = DensityConfig { max_gaussians: 4, ..DensityConfig::default() };
        let plan = control(config).plan(&scene(), &sums(), 1.0);
        assert_eq!((plan.clone.len(), plan.split), (0, vec![1]));
    }

    #[test]
    fn one_seed_one_result() {
        let run = || {
            let (mut g, mut control) = (scene(), control(DensityConfig::default()));
            let plan = control.plan(&g, &sums(), 1.0);
            control.apply(&plan, &mut g);
            g
        };
        assert_eq!(run(), run());
    }

    #[test]
    fn invisible_ones_are_used_again_and_the_first_stay() {
        let (mut g, before) = (scene(), scene());
        control(DensityConfig::default()).reuse(&mut g, &sums(), 1, 1.0);
        assert_eq!(g.len(), 5);
        assert_eq!((g.means[0], g.means[2]), (before.means[0], before.means[2]));
        // 3 is transparent, 4 too large; 1 alone is visible, moves and is not fixed.
        assert_eq!(g.opacity_logits[3], before.opacity_logits[1]);
        assert!((g.log_scales[3][0] - (0.05f32 / 1.6).ln()).abs() < 1e-6);
        assert_eq!(g.log_scales[3], g.log_scales[1]);
        assert_ne!(g.means[3], g.means[1]);
        assert_eq!(g.log_scales[4], before.log_scales[4], "there was no second one to split");
        g.validate().unwrap();
    }

    #[test]
    fn opacities_are_lowered_never_raised() {
        let mut g = scene();
        reset_opacities(&mut g, 0.01);
        assert!((sigmoid(g.opacity_logits[0]) - 0.01).abs() < 1e-6);
        assert!((sigmoid(g.opacity_logits[3]) - 0.001).abs() < 1e-6);
    }
}
