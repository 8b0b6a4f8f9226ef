//! The ground truth of a rendered capture: rigid parts with their poses, and where each surface point truly moves.

use ffgs_arrays::{ArraysError, NpzFile};
use glam::{DAffine3, DMat4, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why the ground truth cannot be used.
#[derive(Debug, Error)]
pub enum TruthError {
    /// A file cannot be read.
    #[error("cannot read {}: {source}; the capture needs truth/poses.json and truth/tracks.npz", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// `poses.json` is not what it should be.
    #[error("{}: {reason}", file.display())]
    Poses {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: String,
    },
    /// An array file cannot be read.
    #[error(transparent)]
    Arrays(#[from] ArraysError),
    /// The spatial index refused the surface points.
    #[error("spatial index: {0}")]
    Index(String),
}

/// What a rigid part is, judged by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The body of an object.
    Body,
    /// A wheel: its spin aliases between frames.
    Wheel,
    /// Any other part.
    Other,
}

/// Ground truth of a capture: rigid parts with their poses, and points on their surfaces.
#[derive(Debug)]
pub struct Truth {
    names: BTreeMap<u32, String>,
    /// `world_from_part` by frame and part.
    poses: Vec<BTreeMap<u32, DAffine3>>,
    /// Surface points by frame.
    surface: Vec<Vec<DVec3>>,
    part_of_point: Vec<u32>,
    /// A place farther than this from every surface point sits on no part (m).
    reach: f64,
}

#[derive(Deserialize)]
struct PosesFile {
    parts: BTreeMap<String, Vec<String>>,
    world_from_part: BTreeMap<String, BTreeMap<String, [[f64; 4]; 4]>>,
    #[serde(default = "reach_of_cars")]
    reach: f64,
}

/// The reach where `poses.json` names none (m): that of rendered cars.
fn reach_of_cars() -> f64 {
    0.5
}

/// Surface points that vote for a Gaussian's part.
const VOTERS: usize = 5;

impl Truth {
    /// Reads `truth/poses.json` and `truth/tracks.npz` below `capture`.
    ///
    /// # Errors
    /// [`TruthError`] when a file is missing or does not have its documented form.
    pub fn read(capture: &Path) -> Result<Self, TruthError> {
        let file = capture.join("truth/poses.json");
        let text =
            std::fs::read_to_string(&file).map_err(|source| TruthError::Io { file: file.clone(), source })?;
        let wrong = |reason: String| TruthError::Poses { file: file.clone(), reason };
        let parsed: PosesFile = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        let id = |text: &String| text.parse::<u32>().map_err(|_| wrong(format!("part id '{text}'")));
        let mut names = BTreeMap::new();
        for (part, name) in &parsed.parts {
            names.insert(id(part)?, name.join(" "));
        }
        let mut poses = Vec::new();
        for t in 0..parsed.world_from_part.len() {
            let frame = parsed.world_from_part.get(&t.to_string());
            let frame = frame.ok_or_else(|| wrong(format!("no poses of frame {t}")))?;
            let of = |(part, rows): (&String, &[[f64; 4]; 4])| {
                Ok((id(part)?, DAffine3::from_mat4(DMat4::from_cols_array_2d(rows).transpose())))
            };
            poses.push(frame.iter().map(of).collect::<Result<BTreeMap<_, _>, TruthError>>()?);
        }
        let points = NpzFile::open(&capture.join("truth/tracks.npz"))?;
        let part_of_point: Vec<u32> = points.u8("part_id")?.data.into_iter().map(u32::from).collect();
        let n = part_of_point.len();
        let xyz = points.shaped::<f64>("xyz", &[None, Some(n), Some(3)])?;
        let frame = |points: &[f64]| points.as_chunks::<3>().0.iter().map(|p| DVec3::from(*p)).collect();
        let surface = xyz.data.chunks(3 * n.max(1)).map(frame).collect();
        Ok(Self { names, poses, surface, part_of_point, reach: parsed.reach })
    }

    /// Frames with poses and surface points.
    pub fn frames(&self) -> usize {
        self.poses.len().min(self.surface.len())
    }

    /// Name of a part: object and part.
    pub fn name(&self, part: u32) -> &str {
        self.names.get(&part).map_or("unnamed", String::as_str)
    }

    /// Kind of a part.
    pub fn kind(&self, part: u32) -> Kind {
        let name = self.name(part);
        match () {
            () if name.contains("body") => Kind::Body,
            () if name.contains("wheel") => Kind::Wheel,
            () => Kind::Other,
        }
    }

    /// The part each place (m) of a frame sits on: that of most of the five nearest surface points (the nearest one's
    /// among equals), `None` beyond the truth's reach from the surface.
    ///
    /// # Errors
    /// [`TruthError::Index`] when the spatial index refuses the points.
    pub fn parts_at(&self, frame: usize, places: &[DVec3]) -> Result<Vec<Option<u32>>, TruthError> {
        let Some(points) = self.surface.get(frame).filter(|p| !p.is_empty()) else {
            return Ok(vec![None; places.len()]);
        };
        let rows: Vec<[f64; 3]> = points.iter().map(DVec3::to_array).collect();
        let tree: ImmutableKdTree<f64, 3> =
            ImmutableKdTree::new_from_slice(&rows).map_err(|e| TruthError::Index(format!("{e:?}")))?;
        let k = NonZero::new(VOTERS.min(rows.len())).unwrap_or(NonZero::<usize>::MIN);
        let part = |place: &DVec3| {
            let found = tree.query(&place.to_array()).nearest_n::<SquaredEuclidean<f64>>(k).execute();
            let near = found.first().is_some_and(|n| n.distance <= self.reach * self.reach);
            let votes: Vec<u32> = found.iter().map(|n| self.part_of_point[n.item as usize]).collect();
            near.then(|| majority(&votes)).flatten()
        };
        Ok(places.iter().map(part).collect())
    }

    /// Rigid motion of a part between two frames; `None` where a pose is missing.
    pub fn motion(&self, part: u32, from: usize, to: usize) -> Option<DAffine3> {
        let at = |t: usize| self.poses.get(t).and_then(|p| p.get(&part));
        Some(*at(to)? * at(from)?.inverse())
    }

    /// The same in a world whose origin is at `origin` of this one (m).
    #[must_use]
    pub fn relative_to(mut self, origin: DVec3) -> Self {
        if origin != DVec3::ZERO {
            let poses = self.poses.iter_mut().flat_map(BTreeMap::values_mut);
            poses.for_each(|pose| pose.translation -= origin);
            self.surface.iter_mut().flatten().for_each(|point| *point -= origin);
        }
        self
    }

    /// Surface points of a frame (m) with their parts.
    pub fn surface(&self, frame: usize) -> (&[DVec3], &[u32]) {
        (self.surface.get(frame).map_or(&[], Vec::as_slice), &self.part_of_point)
    }
}

/// The most frequent value, the first one among equals.
fn majority(votes: &[u32]) -> Option<u32> {
    let count = |v: &u32| votes.iter().filter(|w| *w == v).count();
    let most = votes.iter().map(count).max()?;
    votes.iter().find(|v| count(v) == most).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ties_go_to_the_nearest() {
        assert_eq!(majority(&[3, 1, 1, 3, 2]), Some(3));
        assert_eq!(majority(&[3, 1, 1]), Some(1));
        assert_eq!(majority(&[]), None);
    }
}
