//! Numbers that stay the same: the bytes of a run and of each stage for any number of threads, with each of the instruction sets
//! that this machine has, and how far the sets are from one another.

use ffgs_arrays::NpzFile;
use ffgs_testkit::relative_difference;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tempfile::TempDir;

/// Every file of a run that holds no time.
fn results(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let timed = ["report.html", "run.json", "metrics.json", "frame.json"]
            .iter()
            .any(|name| entry.ends_with(name));
        if entry.is_dir() {
            found.extend(results(&entry));
        } else if !timed {
            found.push((entry.clone(), fs::read(entry).unwrap()));
        }
    }
    found.sort();
    found
}

/// Sets of one machine may differ so much in the PSNR of a view (dB): 1.4e-5 was measured on the sample, and longer runs diverge.
const PSNR_TOLERANCE: f64 = 1e-3;

/// Two frames of the sample, every stage of the method in the second; `None` where the processor lacks the set.
fn run(out: &Path, set: &str, threads: usize) -> Option<()> {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let words =
        ["--frames", "0..2", "--first-iterations", "12", "--iterations", "4", "--device", "cpu", "--quiet"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.arg("run").arg(sample).arg("--out").arg(out).args(words);
    command.args(["--train-views", "trk000,trk008"]);
    command.env("FFGS_SIMD", set).env("RAYON_NUM_THREADS", threads.to_string());
    let output = command.stdin(Stdio::null()).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    if told.contains("FFGS_SIMD") {
        assert!(set != "scalar" && output.status.code() == Some(1), "{told}");
        return None;
    }
    assert!(output.status.success(), "{told}");
    Some(())
}

/// PSNR of each view of each frame.
fn psnr(out: &Path) -> Vec<f64> {
    let metrics: Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    let views = metrics["frames"].as_array().unwrap().iter().flat_map(|f| f["views"].as_array().unwrap());
    views.map(|view| view["psnr"].as_f64().unwrap()).collect()
}

fn assert_equal(a: &Path, b: &Path) {
    let named = |folder: &Path| -> Vec<_> {
        let found = results(folder).into_iter();
        found.map(|(path, bytes)| (path.strip_prefix(folder).unwrap().to_owned(), bytes)).collect()
    };
    let (expected, found) = (named(a), named(b));
    assert!(expected.len() > 10 && expected.len() == found.len(), "states, splats, skies, pictures");
    for ((name, a), (other, b)) in expected.iter().zip(&found) {
        assert!(name == other && a == b, "{} differs", name.display());
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes_with_each_instruction_set() {
    let folder = TempDir::new().unwrap();
    let out = |set: &str, threads: usize| folder.path().join(format!("{set}-{threads}"));
    // One set with many numbers of threads, the others with two.
    let matrix = [("scalar", &[1, 3][..]), ("avx2", &[1, 2, 3]), ("avx512", &[1, 8])];
    let mut had = Vec::new();
    for (set, threads) in matrix {
        if threads.iter().all(|&threads| run(&out(set, threads), set, threads).is_some()) {
            threads[1..].iter().for_each(|&other| assert_equal(&out(set, threads[0]), &out(set, other)));
            had.push(set);
        }
    }
    for set in &had {
        let pairs = psnr(&out("scalar", 1)).into_iter().zip(psnr(&out(set, 1)));
        let most = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("{set} differs from scalar by {most:.2e} dB at most");
        assert!(most < PSNR_TOLERANCE, "{set}: {most} dB");
    }
    assert_eq!(had[0], "scalar");
}

const SETS: [&str; 3] = ["scalar", "avx2", "avx512"];

/// Stages, and how far two instruction sets may be from one another, as a share of the largest value of an array; 0 = the
/// same bytes. Where products are fused with sums: 1.7e-9 was measured for triangulation in `f64`, 2.4e-6 for
/// the gradients of rendering in `f32`.
const STAGES: [(&str, f64); 7] = [
    ("voronoi", 0.0),
    ("agreement", 0.0),
    ("associate", 0.0),
    ("fuse", 0.0),
    ("validate", 0.0),
    ("triangulate", 1e-7),
    ("rasterize", 2e-5),
];

/// The bytes that a stage writes; `None` where the processor lacks the set.
fn stage(stage: &str, input: &Path, output: &Path, set: &str, threads: &str) -> Option<Vec<u8>> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.args(["stage", stage, "--literal", "--device", "cpu", "--input"]).arg(input);
    command.arg("--output").arg(output).env("FFGS_SIMD", set).env("RAYON_NUM_THREADS", threads);
    let output_of = command.stdin(Stdio::null()).output().unwrap();
    let told = String::from_utf8_lossy(&output_of.stderr);
    if told.contains("FFGS_SIMD") {
        return None;
    }
    assert!(output_of.status.success(), "{stage}: {told}");
    Some(fs::read(output).unwrap())
}

/// The largest difference of each array, as a share of its largest value. What is no number is so in both.
fn differences(a: &Path, b: &Path) -> BTreeMap<String, f64> {
    let (a, b) = (NpzFile::open(a).unwrap(), NpzFile::open(b).unwrap());
    let finite = |values: Vec<f64>| values.into_iter().map(|v| if v.is_finite() { v } else { 0.0 });
    let of = |name: &String| {
        let [a, b] = [&a, &b].map(|file| file.f64(name).unwrap().data);
        assert!(a.iter().zip(&b).all(|(a, b)| a.is_finite() == b.is_finite()), "{name}");
        let [a, b]: [Vec<f64>; 2] = [a, b].map(|values| finite(values).collect());
        (name.clone(), relative_difference(&b, &a))
    };
    a.names().iter().map(of).collect()
}

#[test]
fn each_stage_gives_the_same_bytes_or_keeps_within_its_bound() {
    let folder = TempDir::new().unwrap();
    let reference = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/reference");
    for (name, bound) in STAGES {
        let mut most = BTreeMap::<String, f64>::new();
        for entry in fs::read_dir(reference.join(name)).unwrap() {
            let input = entry.unwrap().path();
            let output = |set: &str| folder.path().join(format!("{set}.npz"));
            let expected = stage(name, &input, &output("scalar"), "scalar", "1").unwrap();
            for set in SETS {
                let Some(one) = stage(name, &input, &output(set), set, "1") else { continue };
                let three = stage(name, &input, &folder.path().join("three.npz"), set, "3");
                assert!(three.as_ref() == Some(&one), "{name}, {set}: other bytes with three threads");
                assert!(bound > 0.0 || one == expected, "{name}: {set} gives other bytes than scalar");
                for (array, difference) in differences(&output("scalar"), &output(set)) {
                    let kept = most.entry(array).or_default();
                    *kept = kept.max(difference);
                }
            }
        }
        let worst = most.iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
        println!("{name}: {} differs most between instruction sets, by {:.1e}", worst.0, worst.1);
        assert!(*worst.1 <= bound, "{name}: {worst:?}");
    }
}

#[test]
fn an_instruction_set_that_is_none_is_refused() {
    let output =
        Command::new(env!("CARGO_BIN_EXE_ffgs")).arg("methods").env("FFGS_SIMD", "sse9").output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && told.contains("scalar, avx2 or avx512"), "{told}");
}
