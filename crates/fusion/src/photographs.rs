//! What the fusion asks of the photographs, without knowing how it is computed: the corrections of rigid groups.

use crate::groups::Groups;
use glam::DVec3;

/// What photographs tell of the rigid groups, beside the trackers.
pub trait Photographs {
    /// Improves the motions of the groups.
    fn align(&mut self, groups: &mut Groups);

    /// Per cell of `groups`, the logarithm of the odds that it moved by `offsets` (m) beyond its group's motion rather than
    /// with the group; 0 where nothing can be said.
    fn departures(&mut self, groups: &Groups, offsets: &[Option<DVec3>]) -> Vec<f64>;
}

/// None are at hand: the trackers are believed.
impl Photographs for () {
    fn align(&mut self, _: &mut Groups) {}

    fn departures(&mut self, _: &Groups, offsets: &[Option<DVec3>]) -> Vec<f64> {
        vec![0.0; offsets.len()]
    }
}
