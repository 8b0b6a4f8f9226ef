//! Every stage alone, as `ffgs stage` runs it: reference cases (fixtures/reference) and inputs that cannot be used.

use ffgs_arrays::{NpzFile, NpzWriter};
use ffgs_pipeline::commands::stage::{Form, Stage, run as run_on};
use ffgs_pipeline::job::device::Device;
use ffgs_testkit::{largest, largest_difference, relative_difference};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn run(stage: Stage, input: &Path, output: &Path) -> anyhow::Result<()> {
    run_on(stage, Form::Literal, input, output, &Device::Cpu)
}

fn cases(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/reference").join(folder);
    let mut paths: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "no case in {}", folder.display());
    paths
}

/// Runs every case of a stage; hands input and output over.
fn on_cases(stage: Stage, folder: &str, judge: impl Fn(&NpzFile, &NpzFile, &str)) {
    let temporary = TempDir::new().unwrap();
    for path in cases(folder) {
        let output = temporary.path().join("out.npz");
        run(stage, &path, &output).unwrap();
        judge(&NpzFile::open(&path).unwrap(), &NpzFile::open(&output).unwrap(), &path.display().to_string());
    }
}

fn values(file: &NpzFile, key: &str) -> Vec<f64> {
    file.f64(key).unwrap().data
}

/// Output `key` against input `expected_key`, absolute.
fn assert_expected(input: &NpzFile, output: &NpzFile, key: &str, tolerance: f64, case: &str) {
    let error = largest_difference(&values(output, key), &values(input, &format!("expected_{key}")));
    assert!(error <= tolerance, "{case}, {key}: {error:.1e}");
}

#[test]
fn voronoi_and_agreement_match() {
    on_cases(Stage::Voronoi, "voronoi", |input, output, case| {
        assert_expected(input, output, "flow", 1e-4, case);
        assert_expected(input, output, "visibility", 1e-5, case);
        assert_expected(input, output, "confidence", 1e-5, case);
    });
    on_cases(Stage::Agreement, "agreement", |input, output, case| {
        assert_expected(input, output, "confidence", 1e-5, case);
    });
}

#[test]
fn associate_matches() {
    on_cases(Stage::Associate, "associate", |input, output, case| {
        let weight = 1e-4 * largest(values(input, "expected_weight"));
        assert_expected(input, output, "weight", weight, case);
        assert_expected(input, output, "target", 1e-3, case);
        assert_expected(input, output, "coverage", 1e-4, case);
    });
}

#[test]
fn fuse_and_validate_match() {
    on_cases(Stage::Fuse, "fuse", |input, output, case| {
        for key in ["means", "covariances", "q"] {
            let size = largest(values(input, &format!("expected_{key}")));
            assert_expected(input, output, key, 1e-9 * size, case);
        }
    });
    on_cases(Stage::Validate, "validate", |input, output, case| {
        for key in ["valid", "inside", "seen"] {
            assert_expected(input, output, key, 0.0, case);
        }
    });
}

#[test]
fn triangulate_finds_exact_points_and_is_sound_with_noise() {
    on_cases(Stage::Triangulate, "triangulate", |input, output, case| {
        assert!(values(output, "covariances").iter().all(|v| v.is_finite()), "{case}");
        if input.f64("noise_px").unwrap().data[0] == 0.0 {
            let error = largest_difference(&values(output, "means"), &values(input, "truth"));
            assert!(error < 1e-9, "{case}: {error:.1e}");
        }
        let valid = values(output, "valid");
        assert!(valid.iter().sum::<f64>() >= 0.97 * valid.len() as f64, "{case}");
    });
}

#[test]
fn rasterize_matches() {
    on_cases(Stage::Rasterize, "rasterize", |input, output, case| {
        let fragile = values(input, "pixel_fragile");
        let [image, expected] = [output, input].map(|file| values(file, "image"));
        let sound = |v: &[f64]| -> Vec<f64> {
            (0..v.len()).filter(|i| fragile[i / 3] == 0.0).map(|i| v[i]).collect()
        };
        assert!(largest_difference(&sound(&image), &sound(&expected)) <= 2e-5, "{case}: image");
        for key in ["means", "quats", "log_scales", "opacity_logits", "sh", "viewmat", "background"] {
            let [ours, expected] = [output, input].map(|file| values(file, &format!("grad_{key}")));
            // The last row of a pose is constant; the reference may hold its derivative.
            let count = if key == "viewmat" { 12 } else { ours.len() };
            let error = relative_difference(&ours[..count], &expected[..count]);
            assert!(error <= 1e-3, "{case}, grad_{key}: {error:.1e}");
        }
    });
}

#[test]
fn ssim_matches() {
    let temporary = TempDir::new().unwrap();
    let file = NpzFile::open(&cases("ssim")[0]).unwrap();
    let names: Vec<&str> = file.names().iter().filter_map(|n| n.strip_suffix("__img1")).collect();
    assert!(!names.is_empty());
    for name in names {
        let [input, output] = ["in.npz", "out.npz"].map(|f| temporary.path().join(f));
        let mut writer = NpzWriter::new();
        for key in ["img1", "img2"] {
            let image = file.f32(&format!("{name}__{key}")).unwrap();
            writer.f32(key, &image.shape, &image.data);
        }
        writer.write(&input).unwrap();
        run(Stage::Ssim, &input, &output).unwrap();
        let output = NpzFile::open(&output).unwrap();
        for key in ["same_value", "same_map", "same_grad", "valid_value", "valid_grad", "loss3dgs_value"] {
            let error = largest_difference(&values(&output, key), &values(&file, &format!("{name}__{key}")));
            assert!(error <= 1e-5, "{name}, {key}: {error:.1e}");
        }
    }
}

/// In the forms of a run: a group of Gaussians that moves rigidly is told more of, the loss is that of the f64 form within
/// rounding to 8 bit, and a Gaussian is displaced by the flow under it.
#[test]
fn stages_do_what_a_run_does() {
    let folder = TempDir::new().unwrap();
    let [input, output] = ["in.npz", "out.npz"].map(|name| folder.path().join(name));
    let run = |stage, form| {
        run_on(stage, form, &input, &output, &Device::Cpu).unwrap();
        NpzFile::open(&output).unwrap()
    };
    let image: Vec<f32> = (0..3 * 20 * 24).map(|i| (i * 37 % 256) as f32 / 255.0).collect();
    let other: Vec<f32> = image.iter().map(|v| 0.8 * v + 0.1).collect();
    NpzWriter::new()
        .f32("img1", &[3, 20, 24], &other)
        .f32("img2", &[3, 20, 24], &image)
        .write(&input)
        .unwrap();
    let (ours, literal) = (run(Stage::Ssim, Form::Run), run(Stage::Ssim, Form::Literal));
    assert!(largest_difference(&values(&ours, "ssim"), &values(&literal, "same_value")) < 1e-5);
    assert!(largest_difference(&values(&ours, "loss"), &values(&literal, "loss3dgs_value")) < 1e-5);
    assert!(relative_difference(&values(&ours, "loss_grad"), &values(&literal, "loss3dgs_grad")) < 1e-3);

    let (width, height) = (24, 20);
    let flow: Vec<f32> = [2.0, -1.0].repeat(width * height);
    let ones = vec![1.0; width * height];
    NpzWriter::new()
        .f32("in_means", &[1, 3], &[0.0, 0.0, 2.0])
        .f32("in_quats", &[1, 4], &[1.0, 0.0, 0.0, 0.0])
        .f32("in_log_scales", &[1, 3], &[-2.0; 3])
        .f32("in_opacity_logits", &[1], &[1.0])
        .f32("in_sh", &[1, 1, 3], &[0.0; 3])
        .f32("in_viewmat", &[4, 4], &glam::Mat4::IDENTITY.to_cols_array())
        .f32("in_K", &[3, 3], &[20.0, 0.0, 12.0, 0.0, 20.0, 10.0, 0.0, 0.0, 1.0])
        .f32("width", &[], &[width as f32])
        .f32("height", &[], &[height as f32])
        .f32("flow", &[1, height, width, 2], &flow)
        .f32("confidence", &[1, height, width], &ones)
        .f32("mask", &[height, width], &ones)
        .write(&input)
        .unwrap();
    let moved = run(Stage::Associate, Form::Run);
    assert!(largest_difference(&values(&moved, "target"), &[14.0, 9.0]) < 1e-4);
    assert!(values(&moved, "weight")[0] > 0.0);

    let case = &cases("fuse")[0];
    fs::copy(case, &input).unwrap();
    let (ours, literal) = (run(Stage::Fuse, Form::Run), run(Stage::Fuse, Form::Literal));
    let difference = largest_difference(&values(&ours, "means"), &values(&literal, "means"));
    assert!(difference.is_finite() && difference > 0.0, "groups change nothing");
}

const FOLDERS: [(Stage, &str); 7] = [
    (Stage::Voronoi, "voronoi"),
    (Stage::Agreement, "agreement"),
    (Stage::Associate, "associate"),
    (Stage::Triangulate, "triangulate"),
    (Stage::Fuse, "fuse"),
    (Stage::Validate, "validate"),
    (Stage::Rasterize, "rasterize"),
];

/// The message of a run that must fail and leave no output.
fn failure(stage: Stage, input: &Path) -> String {
    let output = input.with_file_name("never.npz");
    let error = run(stage, input, &output).expect_err("bad input must be refused");
    assert!(!output.exists(), "{stage:?} left an output");
    format!("{error:#}")
}

/// A copy of `source` in which `change` may alter each array.
fn changed(
    source: &Path,
    folder: &TempDir,
    change: impl Fn(&str, &mut Vec<usize>, &mut Vec<f64>),
) -> PathBuf {
    let file = NpzFile::open(source).unwrap();
    let mut writer = NpzWriter::new();
    for name in file.names() {
        let mut array = file.f64(name).unwrap();
        change(name, &mut array.shape, &mut array.data);
        if name != "gone" && !array.shape.contains(&usize::MAX) {
            writer.f64(name, &array.shape, &array.data);
        }
    }
    let path = folder.path().join("changed.npz");
    writer.write(&path).unwrap();
    path
}

/// Arrays that the stage reads: not what the reference adds.
fn inputs(source: &Path) -> Vec<String> {
    let unread =
        ["truth", "noise_px", "seed", "image", "alpha", "visible", "depths", "means2d", "conics", "colors"];
    let names = NpzFile::open(source).unwrap().names().to_vec();
    let rasterize = names.iter().any(|n| n == "in_means");
    let read = |name: &String| {
        let named =
            ["width", "height", "sh_degree", "antialiased", "w_rgb", "w_alpha"].contains(&name.as_str());
        if rasterize { name.starts_with("in_") || named } else { !name.starts_with("expected_") }
    };
    names.into_iter().filter(|n| read(n) && !unread.contains(&n.as_str())).collect()
}

#[test]
fn a_missing_array_is_named() {
    let folder = TempDir::new().unwrap();
    for (stage, name) in FOLDERS {
        let source = &cases(name)[0];
        for key in inputs(source) {
            let path = changed(source, &folder, |n, shape, _| {
                if n == key {
                    *shape = vec![usize::MAX];
                }
            });
            let message = failure(stage, &path);
            assert!(message.contains("changed.npz") && message.contains(&format!("'{key}'")), "{message}");
        }
    }
}

#[test]
fn another_shape_or_an_empty_array_is_named() {
    let folder = TempDir::new().unwrap();
    for (stage, name) in FOLDERS {
        let source = &cases(name)[0];
        for key in inputs(source) {
            let longer = changed(source, &folder, |n, shape, data| {
                if n == key {
                    data.extend(data.clone());
                    *shape = vec![data.len()];
                }
            });
            let message = failure(stage, &longer);
            assert!(message.contains("array '") && message.contains("shape"), "{name} {key}: {message}");
            let empty = changed(source, &folder, |n, shape, data| {
                if n == key {
                    data.clear();
                    if let Some(first) = shape.first_mut() {
                        *first = 0;
                    }
                    if shape.is_empty() {
                        shape.push(0);
                    }
                }
            });
            assert!(failure(stage, &empty).contains("array '"), "{name} {key}");
        }
    }
}

#[test]
fn damaged_and_missing_files_are_named() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("cut.npz");
    for (stage, name) in FOLDERS {
        let bytes = fs::read(&cases(name)[0]).unwrap();
        for share in [0, 1, 2, 3] {
            fs::write(&path, &bytes[..bytes.len() * share / 4]).unwrap();
            assert!(failure(stage, &path).contains("cut.npz"));
        }
        assert!(failure(stage, &folder.path().join("absent.npz")).contains("absent.npz"));
    }
}

#[test]
fn numbers_out_of_range_are_refused() {
    let folder = TempDir::new().unwrap();
    let bad = [
        (Stage::Voronoi, "voronoi", "k", 0.0),
        (Stage::Voronoi, "voronoi", "sigma", -1.0),
        (Stage::Voronoi, "voronoi", "size", 1e9),
        (Stage::Voronoi, "voronoi", "src", f64::NAN),
        (Stage::Agreement, "agreement", "magnitude_floor", -1.0),
        (Stage::Associate, "associate", "top_indices", 1e6),
        (Stage::Associate, "associate", "flow", f64::INFINITY),
        (Stage::Triangulate, "triangulate", "camera_from_world", 7.0),
        (Stage::Fuse, "fuse", "prior_means", f64::NAN),
        (Stage::Validate, "validate", "slack", -1.0),
        (Stage::Rasterize, "rasterize", "sh_degree", 4.0),
        (Stage::Rasterize, "rasterize", "width", 0.0),
        (Stage::Rasterize, "rasterize", "in_K", -1.0),
    ];
    for (stage, name, key, value) in bad {
        let path = changed(&cases(name)[0], &folder, |n, _, data| {
            if n == key {
                data.fill(value);
            }
        });
        assert!(failure(stage, &path).contains("changed.npz, array '"), "{name} {key}");
    }
}
