//! Runs over two or three frames of the sample, with next to no training.

use ffgs_core::{Exposure, PixelFilter};
use ffgs_dataset::write_image;
use ffgs_method::{Split, ViewAt};
use ffgs_pipeline::job::device::Device;
use ffgs_pipeline::job::request::{FrameRange, RunRequest};
use ffgs_pipeline::job::run::run;
use ffgs_pipeline::outputs::folder::RunFolder;
use ffgs_pipeline::outputs::json::read_json;
use ffgs_pipeline::outputs::record::{FrameRecord, Metrics};
use ffgs_pipeline::outputs::state;
use ffgs_pipeline::plugins::registry::open_capture;
use ffgs_pipeline::settings::config::Config;
use ffgs_splats::read_ply;
use ffgs_trainer::StaticMethod;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini")
}

/// Two frames whose second takes so many steps in the dynamic lane, and none in the others.
fn request(out: &Path, steps: usize) -> RunRequest {
    let mut config = Config::default();
    config.first_frame.iterations = 3;
    config.dynamic.iterations = steps;
    config.background.static_method = StaticMethod::Steps;
    config.background.static_iterations = 0;
    config.background.sky_iterations = 0;
    RunRequest {
        capture: sample(),
        out: out.to_owned(),
        resume: false,
        method: None,
        frames: Some(FrameRange { start: 0, end: Some(2) }),
        train_views: Some(["trk000", "trk004", "trk008"].map(str::to_owned).to_vec()),
        first_frame: None,
        refine_first: None,
        keep: None,
        memory: None,
        device: Device::Cpu,
        quiet: true,
        config,
    }
}

fn metrics(out: &Path) -> Metrics {
    read_json(&out.join("metrics.json")).unwrap()
}

fn mpsnr(frame: &FrameRecord) -> f64 {
    let values: Vec<f64> = frame.views.iter().filter_map(|v| v.mpsnr).collect();
    assert!(values.len() > 1);
    values.iter().sum::<f64>() / values.len() as f64
}

fn report(out: &Path) -> String {
    fs::read_to_string(out.join("report.html")).unwrap()
}

#[test]
fn a_run_is_drawn_with_the_filter_that_it_was_trained_with() {
    let folder = TempDir::new().unwrap();
    let quality = [true, false].map(|antialiased| {
        let mut request = request(&folder.path().join(antialiased.to_string()), 3);
        request.config.first_frame.antialiased = antialiased;
        run(&request).unwrap();
        let out = RunFolder(request.out);
        let expected = if antialiased { PixelFilter::Compensated } else { PixelFilter::Plain };
        let scene = state::load(&out.state(1), 1).unwrap();
        let files = ["static", "dynamic"]
            .map(|layer| read_ply(&out.frame(1).join(format!("{layer}.ply"))).unwrap().gaussians);
        for (layer, file) in scene.layers().into_iter().zip(&files) {
            assert!(!layer.is_empty() && layer.filter == expected && file.filter == expected);
        }
        mpsnr(&metrics(&out.0).frames[1])
    });
    assert!((quality[0] - quality[1]).abs() > 1e-3, "the filter changes nothing: {quality:?}");
}

#[test]
fn the_initialisation_is_graded_as_it_was_before_finetuning() {
    let folder = TempDir::new().unwrap();
    let [untouched, finetuned] = ["untouched", "finetuned"].map(|name| folder.path().join(name));
    let nothing_covered = |out: &Path, steps: usize| {
        let mut request = request(out, steps);
        request.config.marking.covering_alpha = 0.0;
        request
    };
    run(&nothing_covered(&untouched, 0)).unwrap();
    run(&RunRequest { first_frame: Some(untouched.clone()), ..nothing_covered(&finetuned, 3) }).unwrap();
    let (a, b) = (metrics(&untouched), metrics(&finetuned));
    let grade = a.frames[1].initial_mpsnr.unwrap();
    assert!((grade - mpsnr(&a.frames[1])).abs() < 1e-9, "{grade}, nothing was finetuned");
    assert_eq!(b.frames[1].initial_mpsnr, Some(grade));
    assert!((mpsnr(&b.frames[1]) - grade).abs() > 1e-3, "finetuning changed nothing");
    for (metrics, out) in [(&a, &untouched), (&b, &finetuned)] {
        assert_eq!(metrics.frames[0].initial_mpsnr, None);
        assert_eq!(metrics.mean.initial_mpsnr, Some(grade));
        assert!(report(out).contains("initialisation alone"));
    }
}

fn first(end: usize) -> FrameRange {
    FrameRange { start: 0, end: Some(end) }
}

/// On the CPU, with the linear solve of the static lane, which is the default and keeps traces between frames.
#[test]
fn a_resumed_run_has_the_bytes_of_one_that_never_stopped() {
    let folder = TempDir::new().unwrap();
    let [whole, cut] = ["whole", "cut"].map(|name| folder.path().join(name));
    let request = |out: &Path, end: usize, resume: bool| {
        let mut request = RunRequest { frames: Some(first(end)), resume, ..request(out, 3) };
        request.config.background.static_method = StaticMethod::Solve;
        request.config.background.solve_iterations = 2;
        request.config.background.sky_iterations = 2;
        request
    };
    run(&request(&whole, 3, false)).unwrap();
    run(&request(&cut, 2, false)).unwrap();
    run(&request(&cut, 3, true)).unwrap();
    let aside = state::load(&RunFolder(cut.clone()).state(1), 1).unwrap().aside;
    assert!(!aside.indices.is_empty(), "nothing is shown for one frame alone");
    for frame in 0..3 {
        for file in ["state.ffgs", "static.ply", "dynamic.ply", "pictures.json"] {
            let bytes = |out: &Path| fs::read(RunFolder(out.to_owned()).frame(frame).join(file)).unwrap();
            assert!(bytes(&whole) == bytes(&cut), "frame {frame}, {file}");
        }
    }
}

#[test]
fn motion_may_be_left_out_or_come_from_one_tracker() {
    let folder = TempDir::new().unwrap();
    let out = |name: &str| folder.path().join(name);
    run(&RunRequest { frames: Some(first(1)), ..request(&out("first"), 0) }).unwrap();
    let run_with = |name: &str, method: &str| {
        let method = Some(method.parse().unwrap());
        let request = RunRequest { method, first_frame: Some(out("first")), ..request(&out(name), 0) };
        run(&request).map(|_| state::load(&RunFolder(out(name)).state(1), 1).unwrap().dynamic.gaussians)
    };
    let none = run_with("none", "none").unwrap();
    let start = state::load(&RunFolder(out("first")).state(0), 0).unwrap().dynamic.gaussians;
    assert!(none == start, "nothing moves without motion and finetuning");
    let one = run_with("one", "tracker:points_raft").unwrap();
    let fused = run_with("fused", "trackers").unwrap();
    assert!(one != none && one != fused);
    let error = format!("{:#}", run_with("unknown", "tracker:points").unwrap_err());
    assert!(error.contains("points_raft") && error.contains("dense_gmflow"), "{error}");
}

/// Every method that trains in its own way: few steps, one layer, and a resumed run with the bytes of one that never stopped.
#[test]
fn other_methods_train_one_layer_and_resume() {
    let folder = TempDir::new().unwrap();
    let out = |name: String| folder.path().join(name);
    let first_frame = out("first".to_owned());
    run(&RunRequest { frames: Some(first(1)), ..request(&first_frame, 0) }).unwrap();
    for name in ["dynamic3dgs", "hicom", "queen", "recongs", "trackersplat"] {
        let request = |part: &str, end: usize, resume: bool| {
            let mut request = request(&out(format!("{name} {part}")), 0);
            let method = &mut request.config.method;
            (method.dynamic3dgs.iterations, method.trackersplat.iterations) = (2, 2);
            method.queen.epochs = 1;
            for (motion, added) in [
                (&mut method.hicom.motion, &mut method.hicom.added),
                (&mut method.recongs.motion, &mut method.recongs.added),
            ] {
                (motion.iterations, added.iterations, added.densify_every) = (2, 3, 2);
            }
            let first_frame = Some(first_frame.clone());
            RunRequest {
                method: Some(name.parse().unwrap()),
                frames: Some(first(end)),
                resume,
                first_frame,
                ..request
            }
        };
        let all = [request("whole", 3, false), request("cut", 2, false), request("cut", 3, true)];
        all.iter().for_each(|request| drop(run(request).unwrap()));
        let [whole, cut] = [&all[0].out, &all[2].out].map(|out| RunFolder(out.clone()));
        for file in ["state.ffgs", "method.state", "dynamic.ply"] {
            // A method that keeps nothing has no state.
            let bytes = |run: &RunFolder| fs::read(run.frame(2).join(file)).ok();
            assert!(
                bytes(&whole) == bytes(&cut)
                    && bytes(&whole).is_some() == (file != "method.state" || name != "trackersplat"),
                "{name}: {file}"
            );
        }
        let start = state::load(&RunFolder(first_frame.clone()).state(0), 0).unwrap();
        let scene = state::load(&whole.state(2), 2).unwrap();
        assert!(scene.static_layer.is_empty() && scene.sky.texels == start.sky.texels, "{name}");
        assert_ne!(scene.dynamic.gaussians, start.joint(), "{name}");
    }
}

/// The method's own result of a second frame, without finetuning: positions with covariances of their own, and growth up to its limit.
#[test]
fn a_second_frame_has_covariances_of_its_own_and_grows_to_its_limit() {
    let folder = TempDir::new().unwrap();
    let run_with = |max_growth: f64| {
        let out = folder.path().join(max_growth.to_string());
        let mut request = request(&out, 0);
        request.config.densification.max_growth = max_growth;
        run(&request).unwrap();
        [0, 1].map(|t| state::load(&RunFolder(out.clone()).state(t), t).unwrap().dynamic)
    };
    let ([first, kept], [_, grown]) = (run_with(0.5), run_with(1.5));
    assert_eq!(kept.next_id, first.next_id, "nothing grows where more are left than allowed");
    assert!(grown.next_id > first.next_id && grown.gaussians.len() > kept.gaussians.len());
    assert!(grown.gaussians.len() as f64 <= 1.5 * grown.growth_limit as f64);

    let sound = |c: &glam::DMat3| c.is_finite() && c.determinant() > 0.0;
    assert!(kept.q > 0.0 && kept.covariances.iter().all(sound));
    let before = |id: &u32| first.covariances[first.ids.iter().position(|other| other == id).unwrap()];
    let changed = kept.ids.iter().zip(&kept.covariances).filter(|(id, c)| before(id) != **c).count();
    assert!(2 * changed > kept.ids.len(), "{changed} of {} were fused", kept.ids.len());
}

/// The sample with photographs of some cameras as if these had other exposures: lists of cameras and offsets (log odds), each in a frame.
fn exposed(folder: &Path, frames: &[(usize, &[(&str, f64)])]) -> PathBuf {
    let copy = folder.join("capture");
    let files = walkdir(&sample());
    for file in files {
        let to = copy.join(file.strip_prefix(sample()).unwrap());
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(&file, to).unwrap();
    }
    let capture = open_capture(&sample()).unwrap();
    let find = |name: &str| {
        let of_split =
            |split| capture.views(split).iter().position(|view| view == name).map(|view| (split, view));
        [Split::Train, Split::Test].into_iter().find_map(of_split).unwrap()
    };
    for &(frame, exposures) in frames {
        for (name, offset) in exposures {
            let (split, view) = find(name);
            let at = ViewAt { split, view, frame };
            let exposure = Exposure { offsets: [-offset; 3] };
            let image = exposure.removed(&capture.image(at).unwrap());
            let file = capture.image_file(at).unwrap();
            write_image(&copy.join(file.strip_prefix(sample()).unwrap()), &image).unwrap();
        }
    }
    copy
}

fn walkdir(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { walkdir(&path) } else { vec![path] }).collect()
}

#[test]
fn unequal_exposures_are_found_kept_and_given_back() {
    let folder = TempDir::new().unwrap();
    let exposures = [("trk000", 0.8), ("trk004", -0.5), ("trk008", -0.3)];
    let capture = exposed(folder.path(), &[(0, &exposures)]);
    let out = |name: &str| folder.path().join(name);
    let request = |name: &str, remove: bool, first_frame: Option<&str>| {
        let mut request = request(&out(name), 0);
        request.config.first_frame.iterations = 100;
        // All of the few steps after the change of photographs are needed.
        request.config.first_frame.cool_down = 0.0;
        request.config.first_frame.exposures = remove;
        RunRequest {
            capture: capture.clone(),
            frames: Some(first(1)),
            first_frame: first_frame.map(&out),
            ..request
        }
    };
    run(&request("removed", true, None)).unwrap();
    run(&request("kept", false, None)).unwrap();
    run(&request("again", true, Some("removed"))).unwrap();
    let found: serde_json::Value = read_json(&out("removed").join("exposures.json")).unwrap();
    for (name, offset) in exposures {
        let red = found["train"][name][0].as_f64().unwrap();
        assert!((red - offset).abs() < 0.2, "{name}: {red}, {offset}");
    }
    assert!(!out("kept").join("exposures.json").exists());
    let file = |name: &str| fs::read(out(name).join("exposures.json")).unwrap();
    assert!(file("removed") == file("again"), "--first-frame takes its exposures");
    assert!(report(&out("removed")).contains("exposures.json"));
    // The test cameras have the common exposure.
    let psnr = |name: &str| metrics(&out(name)).frames[0].views.iter().map(|view| view.psnr).sum::<f64>();
    assert!(psnr("removed") > psnr("kept"), "{} {}", psnr("removed"), psnr("kept"));
}

/// The light of the second frame is another one, and one camera changes its exposure in the third: both are found, a resumed run finds the same, and the
/// test views, which see the light alone, are shown in it.
#[test]
fn light_and_exposures_that_change_are_followed_and_resumed() {
    let folder = TempDir::new().unwrap();
    let sample = open_capture(&sample()).unwrap();
    let test = sample.views(Split::Test).iter().map(String::as_str);
    let trained = ["trk000", "trk004", "trk008"];
    let light: Vec<(&str, f64)> = trained.into_iter().chain(test).map(|name| (name, -0.4)).collect();
    let mut one_more = light.clone();
    one_more[1].1 = 0.0;
    let capture = exposed(folder.path(), &[(1, &light), (2, &one_more)]);
    let request = |name: &str, follow: bool, frames: usize| {
        let mut request = request(&folder.path().join(name), 0);
        request.config.first_frame.iterations = 100;
        request.config.first_frame.exposures = false;
        let background = &mut request.config.background;
        background.exposure_change = if follow { background.exposure_change } else { 0.0 };
        RunRequest { capture: capture.clone(), frames: Some(first(frames)), ..request }
    };
    run(&request("followed", true, 3)).unwrap();
    run(&request("left", false, 3)).unwrap();
    let out = RunFolder(folder.path().join("followed"));
    assert!(!out.frame(1).join("exposures.json").exists(), "all cameras see it: it is the light");
    let found: serde_json::Value = read_json(&out.frame(2).join("exposures.json")).unwrap();
    let change = |name: &str| found["change"][name][0].as_f64().unwrap();
    assert!((change("trk004") - 0.4).abs() < 0.1, "{found}");
    assert_eq!((change("trk000"), change("trk008")), (0.0, 0.0), "{found}");
    let psnr = |name: &str, frame: usize| {
        let views = &metrics(&folder.path().join(name)).frames[frame].views;
        views.iter().map(|view| view.psnr).sum::<f64>() / views.len() as f64
    };
    for frame in [1, 2] {
        let (followed, left) = (psnr("followed", frame), psnr("left", frame));
        assert!(followed > left + 0.5, "frame {frame}: {followed} {left}");
    }
    let short = request("resumed", true, 2);
    run(&short).unwrap();
    run(&RunRequest { resume: true, ..request("resumed", true, 3) }).unwrap();
    let state = |name: &str| fs::read(RunFolder(folder.path().join(name)).state(2)).unwrap();
    assert!(state("followed") == state("resumed"));
}
