//! A point seen from three cameras, once with a mistake of two pixels: where is it, and how well is it known?

use anyhow::Result;
use ffgs_core::{Camera, Estimates, ImageSize, Intrinsics, Observations};
use ffgs_triangulation::WeightedRays;
use glam::{DMat4, DVec3};

fn main() -> Result<()> {
    let size = ImageSize { width: 640, height: 480 };
    let lens = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };
    let camera = |x| Camera::new(lens, DMat4::from_translation(DVec3::new(x, 0.0, 0.0)), size);
    let cameras = [camera(-1.0)?, camera(0.0)?, camera(1.0)?];
    let (before, truth) = (DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.1, 0.2, 4.1));
    for mistake in [0.0, 2.0] {
        let mut observations = Observations::unobserved(cameras.len(), 1);
        for (view, camera) in cameras.iter().enumerate() {
            let seen = camera.project(truth).map(|seen| seen.pixel);
            observations.targets[view] = seen.unwrap_or_default();
            observations.weights[view] = 1.0;
        }
        observations.targets[0].y += mistake;
        let mut out = Estimates::default();
        WeightedRays::default().triangulate(&[before], &cameras, &observations, &mut out)?;
        let deviation = out.covariances[0].to_cols_array();
        let [x, y, z] = [0, 4, 8].map(|axis| 1e3 * deviation[axis].sqrt());
        println!("{mistake} px: {:?}, {} within {x:.1}, {y:.1}, {z:.1} mm", out.status[0], out.means[0]);
    }
    Ok(())
}
