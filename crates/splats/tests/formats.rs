//! The formats of today's players: what a file holds is what was written, to the format's precision.

use ffgs_core::{Gaussians, PixelFilter, sigmoid};
use ffgs_splats::{
    FORMATS, Panorama, decode_spz, encode_sky_equirectangular, read_ply, write_sky_equirectangular,
};
use glam::{Quat, Vec3};
use std::path::Path;

/// Gaussians over a few metres with plausible shapes and colours.
fn some_gaussians(n: usize, degree: usize) -> Gaussians {
    let mut counter = 0.0_f32;
    let mut next = |scale: f32| {
        counter += 0.37;
        (counter * counter).sin() * scale
    };
    let mut g = Gaussians::zeros(n, degree);
    g.means.as_flattened_mut().iter_mut().for_each(|v| *v = next(6.0));
    g.quats.as_flattened_mut().iter_mut().for_each(|v| *v = next(2.0));
    g.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v = next(1.5) - 3.0);
    g.opacity_logits.iter_mut().for_each(|v| *v = next(4.0));
    g.sh.as_flattened_mut().iter_mut().for_each(|v| *v = next(0.4));
    g
}

/// Largest difference of positions, log scales, opacities, constant colours and other harmonics, and the largest angle.
fn differences(a: &Gaussians, b: &Gaussians) -> [f32; 6] {
    assert_eq!((a.len(), a.sh_degree()), (b.len(), b.sh_degree()));
    let largest = |a: &[f32], b: &[f32]| a.iter().zip(b).fold(0.0, |m, (x, y)| largest(m, x - y));
    let opacities = |g: &Gaussians| g.opacity_logits.iter().map(|&o| sigmoid(o)).collect::<Vec<_>>();
    let part = |g: &Gaussians, constant: bool| -> Vec<f32> {
        let stride = g.sh_stride();
        let rows = g.sh.iter().enumerate().filter(|(i, _)| (i % stride == 0) == constant);
        rows.flat_map(|(_, rgb)| *rgb).collect()
    };
    let turn = |q: &[f32; 4]| Quat::from_xyzw(q[1], q[2], q[3], q[0]).normalize();
    let angles = a.quats.iter().zip(&b.quats).map(|(p, q)| angle(turn(p), turn(q)));
    [
        largest(a.means.as_flattened(), b.means.as_flattened()),
        largest(a.log_scales.as_flattened(), b.log_scales.as_flattened()),
        largest(&opacities(a), &opacities(b)),
        largest(&part(a, true), &part(b, true)),
        largest(&part(a, false), &part(b, false)),
        angles.fold(0.0, self::largest),
    ]
}

/// Angle between two rotations (rad); unlike an arc cosine it is exact near zero.
fn angle(p: Quat, q: Quat) -> f32 {
    let apart = (p - q).length().min((p + q).length());
    4.0 * (0.5 * apart).asin()
}

/// The larger magnitude; a NaN stays.
fn largest(so_far: f32, value: f32) -> f32 {
    if value.abs() <= so_far { so_far } else { value.abs() }
}

fn assert_within(found: [f32; 6], limits: [f32; 6]) {
    for (what, (found, limit)) in
        ["mean", "scale", "opacity", "dc", "sh", "angle"].iter().zip(found.iter().zip(limits))
    {
        assert!(*found <= limit, "{what}: {found} > {limit}");
    }
}

/// The bytes of a file in a registered format.
fn written(format: &str, g: &Gaussians) -> Vec<u8> {
    let file = tempfile::NamedTempFile::new().unwrap();
    FORMATS.find(format).unwrap().write(file.path(), &g.into()).unwrap();
    std::fs::read(file.path()).unwrap()
}

/// Half a step of each of SPZ's columns: 2^-13 m, 1/32, 1/510, 1/(2 * 255 * 0.15), half a bucket and half a byte, the angle of nine bits.
const SPZ: [f32; 6] = [1.3e-4, 0.032, 0.002, 0.0132, 1.0 / 16.0 + 1.0 / 256.0 + 1e-6, 0.005];

#[test]
fn spz_comes_back_within_half_a_step() {
    for degree in 0..=3 {
        let g = some_gaussians(300, degree);
        let back = decode_spz(&written("spz", &g)).unwrap();
        assert_eq!(back.filter, PixelFilter::Compensated);
        assert_within(differences(&g, &back), SPZ);
    }
    let plain = some_gaussians(3, 0).with_filter(PixelFilter::Plain);
    assert_eq!(decode_spz(&written("spz", &plain)).unwrap().filter, PixelFilter::Plain);
}

#[test]
fn spz_positions_follow_the_size_of_the_scene_and_of_its_gaussians() {
    for (scale, step) in [(1e3, 1e-2), (1e-3, 1e-6)] {
        let mut g = some_gaussians(100, 0);
        g.means.as_flattened_mut().iter_mut().for_each(|v| *v *= scale);
        g.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v += scale.ln());
        let back = decode_spz(&written("spz", &g)).unwrap();
        let found = differences(&g, &back)[0];
        assert!(found < step, "{scale}: {found}");
    }
}

#[test]
fn a_damaged_spz_is_an_error_and_never_a_panic() {
    let good = written("spz", &some_gaussians(40, 1));
    for length in 0..good.len() {
        assert!(decode_spz(&good[..length]).is_err(), "{length} bytes");
    }
    for byte in 0..good.len() {
        let mut bad = good.clone();
        bad[byte] ^= 0x55;
        // A changed payload may decode to something else; it must not panic or allocate without bound.
        let _ = decode_spz(&bad);
    }
    let mut huge = good.clone();
    huge[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(decode_spz(&huge).is_err());
}

#[test]
fn every_format_writes_every_degree_and_an_empty_set() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS.items {
        for g in [some_gaussians(700, 3), some_gaussians(1, 1), some_gaussians(5, 0), Gaussians::empty(2)] {
            let path = folder.path().join(format!("a{}", format.extension()));
            format.write(&path, &(&g).into()).unwrap();
            assert!(std::fs::metadata(&path).unwrap().len() > 0, "{}", format.name());
        }
    }
    // One file per format: temporary files are gone.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), FORMATS.items.len());
}

#[test]
fn a_header_names_the_filter() {
    let folder = tempfile::tempdir().unwrap();
    for format in &FORMATS.items[..2] {
        let path = folder.path().join(format!("a{}", format.extension()));
        for (filter, named) in [(PixelFilter::Compensated, true), (PixelFilter::Plain, false)] {
            let gaussians = some_gaussians(3, 0).with_filter(filter);
            format.write(&path, &(&gaussians).into()).unwrap();
            assert!(
                format.read(&path).is_none_or(|read| read.unwrap().filter == filter),
                "{}",
                format.name()
            );
            let text = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
            assert_eq!(text.contains("comment SplatRenderMode: mip\n"), named, "{}", format.name());
        }
    }
}

#[test]
fn a_glb_is_complete_and_its_table_fits_its_bytes() {
    let g = some_gaussians(10, 2);
    let bytes = written("glb", &g);
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((word(0), word(4), word(8)), (0x4654_6c67, 2, bytes.len()));
    let text = word(12);
    let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
    assert_eq!(28 + text + word(20 + text), bytes.len());
    assert_eq!(document["buffers"][0]["byteLength"], word(20 + text));
    let primitive = &document["meshes"][0]["primitives"][0];
    assert_eq!(primitive["attributes"].as_object().unwrap().len(), 5 + 9);
    // Positions come first.
    let x = f32::from_le_bytes(bytes[28 + text..32 + text].try_into().unwrap());
    assert_eq!(x, g.means[0][0]);
}

#[test]
fn the_sky_looks_up_at_the_top_and_forward_in_the_middle() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.jpg");
    // Faces +x red, -x dark, +y green, -y dark, +z blue, -z grey.
    let colours = [[0.9, 0.0, 0.0], [0.1; 3], [0.0, 0.9, 0.0], [0.1; 3], [0.0, 0.0, 0.9], [0.5; 3]];
    let texels: Vec<f32> = colours.iter().flat_map(|c| c.repeat(16 * 16)).collect();
    write_sky_equirectangular(&path, 16, &texels, Vec3::Z, Vec3::X).unwrap();
    let picture = image::open(&path).unwrap().to_rgb8();
    assert_eq!((picture.width(), picture.height()), (64, 32));
    let brightest = |x, y| {
        let p = picture.get_pixel(x, y).0;
        (0..3).max_by_key(|&c| p[c]).unwrap()
    };
    // Right of +x, with +z up, is -y; +y is a quarter turn to the left.
    assert_eq!([brightest(32, 16), brightest(5, 1), brightest(16, 16)], [0, 2, 1]);
    let right = picture.get_pixel(48, 16).0;
    assert!(right.iter().all(|&v| v < 60), "{right:?}");
    let panorama = Panorama::decode(&std::fs::read(&path).unwrap(), Vec3::Z, Vec3::X).unwrap();
    for (direction, colour) in [(Vec3::X, colours[0]), (Vec3::Y, colours[2]), (Vec3::Z, colours[4])] {
        let found = Vec3::from(panorama.colour(direction));
        assert!((found - Vec3::from(colour)).abs().max_element() < 0.04, "{direction}: {found}");
    }
}

/// Between the middles of two texels a panorama shows what lies between their colours, as a render of the cube does.
#[test]
fn a_panorama_is_interpolated() {
    // The rows of +x are 0, 0.3, 0.6, 0.9; its t runs towards -y.
    let rows: Vec<f32> = (0..16).flat_map(|i| [0.3 * (i / 4) as f32; 3]).collect();
    let texels = rows.repeat(6);
    let jpeg = encode_sky_equirectangular(4, &texels, Vec3::Z, Vec3::X).unwrap();
    let picture = image::load_from_memory(&jpeg).unwrap().to_rgb8();
    assert_eq!((picture.width(), picture.height()), (16, 8));
    for column in 6..10 {
        let angle = (column as f32 + 0.5) * std::f32::consts::PI / 8.0 - std::f32::consts::PI;
        let expected = 0.3 * ((0.5 + 0.5 * angle.tan()) * 4.0 - 0.5).clamp(0.0, 3.0);
        let found = [3, 4].map(|row| f32::from(picture.get_pixel(column, row)[1]) / 255.0);
        assert!(found.iter().all(|f| (f - expected).abs() < 0.05), "{column}: {found:?}, not {expected}");
    }
}

/// Every format, opened by PlayCanvas' splat-transform and read again as PLY. Its command line is named by
/// `FFGS_SPLAT_TRANSFORM`; `cargo xtask ci players` installs it.
#[test]
fn players_read_what_was_written() {
    let Some(judge) = std::env::var_os("FFGS_SPLAT_TRANSFORM") else {
        eprintln!(
            "left out: FFGS_SPLAT_TRANSFORM does not name splat-transform; cargo xtask ci players does"
        );
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    // 11 and 10 bits over a chunk of at most 12 m; palettes of 256; SOG keeps 8 bits of a rotation.
    let limits = |name: &str| match name {
        "ply-seq" => [1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-3],
        "compressed-ply-seq" => [0.006, 0.002, 0.002, 0.006, 1.0 / 32.0, 0.004],
        "spz" => SPZ,
        "sog" => [1e-3, 0.02, 0.002, 0.02, 0.45, 0.02],
        _ => [1e-6, 1e-5, 1e-5, 1e-6, 1e-6, 1e-3],
    };
    for format in FORMATS.items.iter().filter(|f| f.name() != "glb") {
        let g = some_gaussians(2000, 3);
        let written = folder.path().join(format!("a{}", format.extension()));
        format.write(&written, &(&g).into()).unwrap();
        let back = folder.path().join("back.ply");
        transform(&judge, &written, &back);
        let text = String::from_utf8_lossy(&std::fs::read(&back).unwrap()[..200]).into_owned();
        assert!(text.contains("SplatRenderMode: mip"), "{}: {text}", format.name());
        assert_within(differences(&g, &read_ply(&back).unwrap().gaussians), limits(format.name()));
    }
}

fn transform(judge: &std::ffi::OsStr, from: &Path, to: &Path) {
    let output = std::process::Command::new("node").arg(judge).arg("-w").args([from, to]).output().unwrap();
    let text =
        String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && to.exists(), "{}: {text}", from.display());
}

#[test]
fn a_file_that_is_no_spz_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.spz");
    std::fs::write(&path, [7; 64]).unwrap();
    let error = FORMATS.find("spz").unwrap().read(&path).unwrap().unwrap_err().to_string();
    assert!(error.contains("x.spz") && error.contains("SPZ"), "{error}");
}
