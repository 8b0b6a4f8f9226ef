//! A method as a stranger would add it: every Gaussian goes on as in the last frame.

use anyhow::{Result, ensure};
use ffgs_core::{Scene, StageLog};
use ffgs_method::{MotionMethod, Step};
use ffgs_pipeline::plugins::method::Method;
use glam::Vec3;
use std::collections::BTreeMap;

pub(crate) const METHOD: Method = Method {
    usage: "constant-velocity",
    former: None,
    summary: "every Gaussian goes on as in the last frame",
    build: |_, _| Ok(Box::new(ConstantVelocity::default())),
};

/// Where each Gaussian was in the last frame (m), by its id.
#[derive(Default)]
struct ConstantVelocity(BTreeMap<u32, Vec3>);

impl MotionMethod for ConstantVelocity {
    fn predict(&mut self, _: &Step, scene: &mut Scene, _: &mut StageLog) -> Result<()> {
        let dynamic = &mut scene.dynamic;
        for (id, mean) in dynamic.ids.iter().zip(&mut dynamic.gaussians.means) {
            let now = Vec3::from(*mean);
            let before = self.0.insert(*id, now).unwrap_or(now);
            *mean = (now + (now - before)).to_array();
        }
        Ok(())
    }

    fn save(&self) -> Vec<u8> {
        let row = |(id, place): (&u32, &Vec3)| {
            [id.to_le_bytes(), place.x.to_le_bytes(), place.y.to_le_bytes(), place.z.to_le_bytes()]
        };
        self.0.iter().flat_map(row).flatten().collect()
    }

    fn restore(&mut self, state: &[u8], _: &Scene) -> Result<()> {
        let (rows, rest) = state.as_chunks::<16>();
        ensure!(rest.is_empty(), "{} bytes are no rows of an id and a place", state.len());
        let word = |row: &[u8; 16], at: usize| [row[at], row[at + 1], row[at + 2], row[at + 3]];
        let place = |row| Vec3::from_array([4, 8, 12].map(|at| f32::from_le_bytes(word(row, at))));
        self.0 = rows.iter().map(|row| (u32::from_le_bytes(word(row, 0)), place(row))).collect();
        Ok(())
    }
}
