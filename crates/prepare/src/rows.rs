//! Rows of `init_pt_cld.npz`.

use glam::DVec3;
use std::ops::Range;

/// Position, colour and foreground.
pub(crate) type Row = [f32; 7];

/// Where its colour is.
pub(crate) const COLOUR: Range<usize> = 3..6;

/// The row of a point.
pub(crate) fn row(p: DVec3, colour: [f32; 3], foreground: bool) -> Row {
    let p = p.as_vec3();
    [p.x, p.y, p.z, colour[0], colour[1], colour[2], f32::from(u8::from(foreground))]
}
