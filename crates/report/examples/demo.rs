//! Writes a report of made-up data: `cargo run -p ffgs-report --example demo -- OUT.html`.

use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Seconds};
use ffgs_report::{
    Fact, FramePictures, FrameReport, MotionAccuracy, ReportInput, SkipCount, Thumbnails, ViewReport,
    motion_picture, uncertainty_picture, write_report,
};
use glam::{DMat3, DMat4, DVec3};
use std::error::Error;
use std::path::{Path, PathBuf};

const SIZE: ImageSize = ImageSize { width: 480, height: 270 };
const FRAMES: usize = 8;

fn main() -> Result<(), Box<dyn Error>> {
    let out = PathBuf::from(std::env::args().nth(1).ok_or("usage: demo OUT.html")?);
    let pictures = out.with_extension("pictures");
    std::fs::create_dir_all(&pictures)?;
    let frames = (0..FRAMES).map(|i| frame(&pictures, i)).collect::<Result<_, _>>()?;
    let fact = |name: &str, value: &str| Fact { name: name.into(), value: value.into() };
    let input = ReportInput {
        title: "A ball on a road <demo>".into(),
        configuration: "[dynamic]\niterations = 300\n\n[fusion]\nprior = \"random_walk\"\n".into(),
        facts: vec![fact("version", "0.1.0"), fact("machine", "2 cores, 8 GiB"), fact("seed", "1")],
        frames,
        skips: vec![SkipCount { what: "track file missing (view cam_03, lightglue)".into(), count: 4 }],
        warnings: vec!["frame 3: 21 % of the dynamic Gaussians failed validation".into()],
        motion: vec![motion("one tracker", 6.0, 0.5), motion("fused", 1.5, 1.0)],
    };
    write_report(&out, &input)?;
    std::fs::remove_dir_all(&pictures)?;
    Ok(())
}

fn frame(folder: &Path, i: usize) -> Result<FrameReport, Box<dyn Error>> {
    let ball = 120.0 + 30.0 * i as f64;
    let (truth, render) = (scene(ball, 0.0), scene(ball + 2.0, 0.6));
    let thumbnails = Thumbnails::for_run(FRAMES, 2);
    let images = thumbnails.view(&truth, &render)?.ok_or("size")?;
    let overlays = if i == 0 { Vec::new() } else { overlays(&truth, i)? };
    let mut overlays = overlays.iter().map(|picture| thumbnails.encode(picture));
    let pictures = FramePictures {
        views: vec![images.clone(), images],
        motion: overlays.next().transpose()?,
        uncertainty: overlays.next().transpose()?,
    };
    let path = folder.join(format!("{i}.json"));
    std::fs::write(&path, serde_json::to_vec(&pictures)?)?;
    Ok(FrameReport {
        index: i,
        views: ["trackside_01", "drone"].map(|name| view(name, i)).into(),
        initial_mpsnr: (i > 0).then_some(19.0 - 0.1 * i as f64),
        static_gaussians: 41_200,
        dynamic_gaussians: 5_000 + 90 * i,
        bytes: 11_500_000,
        seconds: seconds(i as f64),
        pictures: Some(path),
    })
}

/// Errors around `centimetres` whose covariances claim too little unless `honesty` is 1.
fn motion(name: &str, centimetres: f64, honesty: f64) -> MotionAccuracy {
    let bins_cm: Vec<f64> = (0..7).map(|k| 0.5 * f64::from(1 << k)).collect();
    let share = |k: usize| (-((0.75 * bins_cm[k.min(6)] / centimetres).ln().powi(2))).exp();
    let total: f64 = (0..8).map(share).sum();
    MotionAccuracy {
        name: name.into(),
        median_cm: centimetres,
        p95_cm: 4.0 * centimetres,
        measured: 0.97,
        shares: (0..8).map(|k| share(k) / total).collect(),
        bins_cm,
        calibration: (1..10).map(|p| f64::from(p) / 10.0).map(|p| (p, p * honesty)).collect(),
    }
}

fn seconds(i: f64) -> Seconds {
    let stages = [
        ("load", 0.08),
        ("voronoi", 0.31 + 0.01 * i),
        ("agreement", 0.02),
        ("association", 0.12),
        ("triangulation", 0.05),
        ("fusion", 0.01),
        ("validation", 0.004),
        ("dynamic", 6.2 + 0.2 * i),
        ("static", 9.4),
        ("sky", 1.3),
        ("wall", 12.2 + 0.2 * i),
    ];
    stages.map(|(stage, seconds)| (stage.to_owned(), seconds)).into()
}

fn scene(ball: f64, noise: f64) -> ImageRgb8 {
    let pixel = |i: usize| {
        let (x, y) = (i % SIZE.width, i / SIZE.width);
        let (u, v) = (x as f64, y as f64);
        let grain = noise * (((x * 7919 + y * 104_729) % 31) as f64 - 15.0);
        let colour = if (u - ball).hypot(v - 150.0) < 45.0 {
            [210.0 - 0.5 * (v - 105.0), 60.0, 40.0]
        } else if v < 120.0 {
            [140.0 + 0.3 * v, 180.0 + 0.3 * v, 230.0]
        } else {
            [0.5 * v; 3]
        };
        colour.map(|c: f64| (c + grain) as u8)
    };
    let data = (0..SIZE.pixels()).flat_map(pixel).collect();
    ImageRgb8::new(SIZE, data).expect("three bytes per pixel")
}

fn view(name: &str, i: usize) -> ViewReport {
    let drop = 0.2 * i as f64 + if name == "drone" { 1.7 } else { 0.0 };
    ViewReport {
        name: name.into(),
        psnr: Some(27.4 - drop + 0.3 * (i as f64).sin()),
        mpsnr: (i != 5).then_some(21.3 - drop),
        ssim: Some(0.91 - 0.01 * drop),
        ..ViewReport::default()
    }
}

/// Motion and uncertainty of a ball that spins and moves to the right.
fn overlays(background: &ImageRgb8, i: usize) -> Result<Vec<ImageRgb8>, Box<dyn Error>> {
    let intrinsics = Intrinsics { fx: 400.0, fy: 400.0, cx: 240.0, cy: 135.0 };
    let camera = Camera::new(intrinsics, DMat4::IDENTITY, SIZE)?;
    let centre = DVec3::new((120.0 + 30.0 * i as f64 - 240.0) / 40.0, 0.375, 10.0);
    let sphere: Vec<DVec3> = (0..4000).map(on_sphere).collect();
    let prev: Vec<DVec3> = sphere.iter().map(|p| centre - DVec3::new(0.75, 0.0, 0.0) + *p).collect();
    let spin = DMat3::from_rotation_z(0.9);
    let now: Vec<DVec3> = sphere.iter().map(|p| centre + spin * *p).collect();
    let variance = |p: &DVec3| DMat3::from_diagonal(DVec3::splat(1e-4 * (3.0 * p.x).exp()));
    let covariances: Vec<DMat3> = sphere.iter().map(variance).collect();
    let motion = motion_picture(&camera, &prev, &now, background)?;
    Ok(vec![motion, uncertainty_picture(&camera, &now, &covariances, background)?])
}

/// Spread evenly (golden angle).
fn on_sphere(i: usize) -> DVec3 {
    let z = 1.0 - 2.0 * (i as f64 + 0.5) / 4000.0;
    let (sin, cos) = (2.399_963 * i as f64).sin_cos();
    1.1 * DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
}
