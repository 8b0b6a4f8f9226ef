//! Blocks of voxels of which many views say the same: they show all of a block, and it lies inside of their masks, or outside.
//!
//! Only the views that remain are asked about each voxel. A thing fills little of what the cameras look at, so mostly none are.

use crate::region::Region;
use crate::silhouettes::Silhouette;
use ffgs_core::{Camera, ImageSize};
use glam::{DVec2, DVec3, UVec3};
use rayon::prelude::*;
use std::ops::Range;

/// One view in so many may deny a voxel: masks have holes.
pub(crate) const DENIALS_PER_VIEW: usize = 6;
/// Voxels along the side of a block.
const SIDE: u32 = 8;
/// Positions are rounded by less (px).
const ROUNDING: f64 = 0.01;

/// A grid of voxels in blocks.
pub(crate) struct Blocks<'a> {
    silhouettes: &'a [Silhouette],
    /// How many blocks there are along each axis.
    counts: UVec3,
    all: Vec<Block>,
}

/// What the views say of all voxels of a block.
#[derive(Default)]
struct Block {
    /// Views that show all of them, inside of their masks or outside,
    seen: usize,
    /// and that show all of them inside.
    inside: usize,
    /// Views that have to be asked about each.
    open: Vec<usize>,
}

/// What a view says of all places in a box.
enum Says {
    /// It shows none of them,
    Unseen,
    /// all of them outside of its mask,
    Outside,
    /// all of them inside,
    Inside,
    /// or it has to be asked about each.
    Open,
}

impl<'a> Blocks<'a> {
    /// Of a grid of `voxels` with these centres (m).
    pub(crate) fn new(
        silhouettes: &'a [Silhouette],
        voxels: UVec3,
        centre: impl Fn(UVec3) -> DVec3 + Sync,
    ) -> Self {
        let views: Vec<Sums> = silhouettes.par_iter().map(Sums::new).collect();
        let counts = voxels.map(|n| n.div_ceil(SIDE));
        let block = |i: u32| {
            let first = SIDE * UVec3::new(i % counts.x, i / counts.x % counts.y, i / counts.x / counts.y);
            Block::new(&views, Region { low: centre(first), high: centre(first + SIDE - 1) })
        };
        Self { silhouettes, counts, all: (0..counts.element_product()).into_par_iter().map(block).collect() }
    }

    /// How many views see a voxel, where so few of them deny it that it may be occupied.
    pub(crate) fn views_of(&self, voxel: UVec3, centre: DVec3) -> Option<usize> {
        let UVec3 { x, y, z } = voxel / SIDE;
        let block = &self.all[((z * self.counts.y + y) * self.counts.x + x) as usize];
        let Block { mut seen, mut inside, .. } = *block;
        let mut left = block.open.len();
        for &view in &block.open {
            if !may_be_occupied(seen + left, inside + left) {
                return None;
            }
            left -= 1;
            let Silhouette { camera, mask } = &self.silhouettes[view];
            if let Some((x, y)) = camera.pixel_of(centre) {
                seen += 1;
                inside += usize::from(mask.contains(x, y));
            }
        }
        may_be_occupied(seen, inside).then_some(seen)
    }
}

impl Block {
    /// Of voxels with their centres in a box, edges included.
    fn new(views: &[Sums], centres: Region) -> Self {
        let mut block = Self::default();
        for (i, view) in views.iter().enumerate() {
            match view.says_of(centres) {
                Says::Unseen => {}
                Says::Outside => block.seen += 1,
                Says::Inside => (block.seen, block.inside) = (block.seen + 1, block.inside + 1),
                Says::Open => block.open.push(i),
            }
        }
        block
    }
}

/// Whether so few of the views that see a place deny it that it may be occupied.
fn may_be_occupied(seen: usize, inside: usize) -> bool {
    inside + seen / DENIALS_PER_VIEW >= seen
}

/// A view, with sums of its mask.
struct Sums {
    camera: Camera,
    /// Foreground pixels above and left of each corner of a pixel: (height + 1) x (width + 1).
    sums: Vec<u32>,
}

impl Sums {
    fn new(Silhouette { camera, mask }: &Silhouette) -> Self {
        let ImageSize { width, height } = mask.size();
        let mut sums = vec![0; (width + 1) * (height + 1)];
        for (y, row) in mask.data().chunks_exact(width).enumerate() {
            let (above, here) = sums[y * (width + 1)..].split_at_mut(width + 1);
            let mut in_row = 0;
            for x in 0..width {
                in_row += u32::from(row[x]);
                here[x + 1] = above[x + 1] + in_row;
            }
        }
        Self { camera: *camera, sums }
    }

    fn says_of(&self, Region { low, high }: Region) -> Says {
        let corner =
            |i: usize| DVec3::new([low, high][i & 1].x, [low, high][i >> 1 & 1].y, [low, high][i >> 2].z);
        let pixels = || (0..8).filter_map(|i| Some(self.camera.project(corner(i))?.pixel));
        match pixels().count() {
            0 => return Says::Unseen,
            8 => {}
            _ => return Says::Open,
        }
        let first = pixels().fold(DVec2::INFINITY, DVec2::min) - ROUNDING;
        let last = pixels().fold(DVec2::NEG_INFINITY, DVec2::max) + ROUNDING;
        let ImageSize { width, height } = self.camera.size();
        if last.x < 0.0 || last.y < 0.0 || first.x >= width as f64 || first.y >= height as f64 {
            return Says::Unseen;
        }
        if !(self.camera.shows(first) && self.camera.shows(last)) {
            return Says::Open;
        }
        let [columns, rows] = [(first.x, last.x), (first.y, last.y)].map(|(a, b)| a as usize..b as usize + 1);
        let pixels = columns.len() * rows.len();
        match self.count(columns, rows) as usize {
            0 => Says::Outside,
            inside if inside == pixels => Says::Inside,
            _ => Says::Open,
        }
    }

    /// Foreground pixels in some columns and rows.
    fn count(&self, columns: Range<usize>, rows: Range<usize>) -> u32 {
        let at = |column: usize, row: usize| self.sums[row * (self.camera.size().width + 1) + column];
        at(columns.end, rows.end) + at(columns.start, rows.start)
            - at(columns.start, rows.end)
            - at(columns.end, rows.start)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::silhouettes::views_of;
    use ffgs_core::{Intrinsics, Mask};
    use glam::DMat4;

    const SIZE: ImageSize = ImageSize { width: 64, height: 48 };

    /// Views side by side, some of them turned aside; foreground are the pixels of a rectangle.
    fn silhouettes() -> Vec<Silhouette> {
        let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 32.0, cy: 24.0 };
        let inside = |i: usize| (20..40).contains(&(i % SIZE.width)) && (10..40).contains(&(i / SIZE.width));
        let mask = Mask::new(SIZE, (0..SIZE.pixels()).map(|i| u8::from(inside(i))).collect()).unwrap();
        let silhouette = |i: u32| {
            let aside = DMat4::from_rotation_y(0.2 * f64::from(i));
            let pose =
                DMat4::from_translation(DVec3::new(-0.1 * f64::from(i), 0.0, 0.5 * f64::from(i))) * aside;
            Silhouette { camera: Camera::new(intrinsics, pose, SIZE).unwrap(), mask: mask.clone() }
        };
        (0..8).map(silhouette).collect()
    }

    #[test]
    fn sums_count_the_foreground_of_rectangles() {
        let view = Sums::new(&silhouettes()[0]);
        assert_eq!(view.count(0..64, 0..48), 600);
        assert_eq!(
            [view.count(19..21, 9..12), view.count(0..20, 0..48), view.count(25..26, 39..48)],
            [2, 0, 1]
        );
    }

    #[test]
    fn blocks_say_of_each_voxel_what_the_views_do() {
        let silhouettes = silhouettes();
        let voxels = UVec3::new(60, 50, 70);
        let centre = |v: UVec3| DVec3::new(-3.0, -2.0, -1.0) + 0.1 * v.as_dvec3();
        let blocks = Blocks::new(&silhouettes, voxels, centre);
        let mut occupied = 0;
        for i in 0..voxels.element_product() {
            let voxel = UVec3::new(i % 60, i / 60 % 50, i / 3000);
            let (seen, inside) = views_of(&silhouettes, centre(voxel));
            let expected = may_be_occupied(seen, inside).then_some(seen);
            assert_eq!(blocks.views_of(voxel, centre(voxel)), expected, "{voxel}");
            occupied += usize::from(expected.is_some_and(|seen| seen > 3));
        }
        assert!(occupied > 1000, "{occupied} voxels");
        let asked: usize = blocks.all.iter().map(|block| block.open.len()).sum();
        assert!(3 * asked < 2 * blocks.all.len() * silhouettes.len(), "{asked} views of blocks are asked");
    }
}
