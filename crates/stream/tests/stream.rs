//! Streams of made-up layers: what is read is what was written, to the step, in any order, and damage is an error.

use ffgs_core::{Gaussians, sigmoid};
use ffgs_stream::{DecodedFrame, Entry, Frame, Manifest, Precision, Reader, Steps, Writer};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use std::path::Path;
use tempfile::TempDir;

const PRECISION: Precision = Precision {
    position: 8.0,
    scales_per_octave: 6,
    rotation: 48,
    opacity: 48,
    colour: 0.05,
    harmonic: 0.05,
};
const KEY_EVERY: u64 = 4;

/// Gaussians over a few metres.
fn layer(n: usize, degree: usize, seed: f32) -> Gaussians {
    let mut counter = seed;
    let mut next = |scale: f32| {
        counter += 0.37;
        (counter * counter).sin() * scale
    };
    let mut g = Gaussians::zeros(n, degree);
    g.means.as_flattened_mut().iter_mut().for_each(|v| *v = next(6.0));
    g.quats.as_flattened_mut().iter_mut().for_each(|v| *v = next(2.0));
    g.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v = next(1.0) - 2.0);
    g.opacity_logits.iter_mut().for_each(|v| *v = next(3.0));
    g.sh.as_flattened_mut().iter_mut().for_each(|v| *v = next(0.3));
    g
}

/// A capture of `frames` frames: the static layer's colours drift; the dynamic layer moves and turns as one body, every frame
/// one of it dies and one is born.
struct Scene {
    still: Vec<Gaussians>,
    moving: Vec<Gaussians>,
    ids: Vec<Vec<u32>>,
}

impl Scene {
    fn new(frames: usize) -> Self {
        let (mut still, mut moving, mut ids) =
            (layer(200, 3, 1.0), layer(150, 3, 2.0), (0..150).collect::<Vec<u32>>());
        let mut out = Self { still: Vec::new(), moving: Vec::new(), ids: Vec::new() };
        for t in 0..frames {
            out.still.push(still.clone());
            out.moving.push(moving.clone());
            out.ids.push(ids.clone());
            still.sh.iter_mut().step_by(3).for_each(|rgb| rgb[t % 3] += 0.08);
            advance(&mut moving);
            let alive: Vec<usize> = (0..moving.len()).filter(|&i| i != 3 * t + 1).collect();
            moving = moving.select(&alive);
            ids = alive.iter().map(|&i| ids[i]).collect();
            moving.extend(&layer(1, 3, t as f32 + 5.0));
            ids.push(1000 + t as u32);
        }
        out
    }

    /// From frame t on, every tenth static Gaussian is a little elsewhere, and every twentieth is another one.
    fn settle(&mut self, t: usize) {
        let other = layer(200, 3, 20.0 + t as f32);
        for still in &mut self.still[t..] {
            for i in (t..200).step_by(10) {
                still.means[i][t % 3] += 0.3;
                still.quats[i][0] += 0.2;
                still.log_scales[i][1] += 0.2;
                still.opacity_logits[i] += 0.5;
            }
            for i in (t + 1..200).step_by(20) {
                still.means[i] = other.means[i];
                still.quats[i] = other.quats[i];
                still.log_scales[i] = other.log_scales[i];
                still.sh[16 * i..16 * (i + 1)].copy_from_slice(other.sh_of(i));
            }
        }
    }

    fn frame(&self, t: usize) -> Frame<'_> {
        Frame {
            frame: t as u64,
            static_layer: &self.still[t],
            dynamic_layer: &self.moving[t],
            ids: &self.ids[t],
            uncertainty: None,
            sky: b"a sky",
            sky_has_changed: false,
            importance: None,
        }
    }

    fn manifest(&self) -> Manifest {
        Manifest {
            format: String::new(),
            version: 0,
            title: "test".into(),
            frames_per_second: 30.0,
            antialiased: true,
            up: [0.0, 0.0, 1.0],
            forward: [1.0, 0.0, 0.0],
            static_steps: Steps::of(&self.still[0], &PRECISION),
            dynamic_steps: Steps::of(&self.moving[0], &PRECISION),
        }
    }

    fn writer(&self, folder: &Path) -> Writer {
        let first = [&self.still[0], &self.moving[0]];
        Writer::create(folder, self.manifest(), first, [&PRECISION; 2], KEY_EVERY).unwrap()
    }

    fn write(&self, folder: &Path) {
        let mut writer = self.writer(folder);
        (0..self.still.len()).for_each(|t| {
            writer.push(&self.frame(t)).unwrap();
        });
    }

    /// Checks a decoded frame against what was written.
    fn check(&self, t: usize, found: &DecodedFrame) {
        assert_eq!(found.sky, b"a sky");
        let all: Vec<usize> = (0..self.still[t].len()).collect();
        assert_near(&self.still[t], &found.static_layer, &all);
        // Rows are in another order; the nearest place tells which is which.
        let order: Vec<usize> =
            found.dynamic_layer.means.iter().map(|p| nearest(&self.moving[t], *p)).collect();
        let mut sorted = order.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert_eq!(sorted.len(), self.moving[t].len(), "frame {t}");
        assert_near(&self.moving[t], &found.dynamic_layer, &order);
    }
}

/// One step of a rigid motion about the origin: 0.1 rad about z, 0.5 m along x.
fn advance(g: &mut Gaussians) {
    let (sin, cos) = 0.1_f32.sin_cos();
    let (half_sin, half_cos) = 0.05_f32.sin_cos();
    for [x, y, _] in &mut g.means {
        [*x, *y] = [cos * *x - sin * *y + 0.5, sin * *x + cos * *y];
    }
    for [w, x, y, z] in &mut g.quats {
        [*w, *x, *y, *z] = [
            half_cos * *w - half_sin * *z,
            half_cos * *x - half_sin * *y,
            half_cos * *y + half_sin * *x,
            half_cos * *z + half_sin * *w,
        ];
    }
}

fn nearest(g: &Gaussians, p: [f32; 3]) -> usize {
    let distance = |i: &usize| (0..3).map(|k| (g.means[*i][k] - p[k]).powi(2)).sum::<f32>();
    (0..g.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
}

/// Every column within a step, or the three quarters below which no change is sent; harmonics within what is left out of a
/// row whose changes are not worth their bytes. `order` says which Gaussian a row is.
fn assert_near(wanted: &Gaussians, found: &Gaussians, order: &[usize]) {
    assert_eq!(wanted.len(), found.len());
    let within = |what: &str, a: f32, b: f32, limit: f32| {
        assert!((a - b).abs() <= limit, "{what}: {a} {b}, limit {limit}");
    };
    for (row, &i) in order.iter().enumerate() {
        // Axes may come back in another order.
        let [a, b] = [sorted(wanted.log_scales[i]), sorted(found.log_scales[row])];
        let widest = a[2].exp();
        for k in 0..3 {
            within("mean", wanted.means[i][k], found.means[row][k], widest / 8.0 * 1.2);
            within("scale", a[k], b[k], 0.8 * 0.693 / 6.0);
        }
        within("opacity", sigmoid(wanted.opacity_logits[i]), sigmoid(found.opacity_logits[row]), 0.8 / 48.0);
        let sh = wanted.sh_of(i).as_flattened().iter().zip(found.sh_of(row).as_flattened());
        for (k, (a, b)) in sh.enumerate() {
            within("sh", *a, *b, if k < 3 { 0.8 * 0.05 } else { 3.0 * 0.05 });
        }
        // A variance is off by 0.16 of it with such scales, and by 0.07 of the largest with rotations that are off by 0.035 rad.
        let [a, b] = [covariance(wanted, i), covariance(found, row)];
        let off = (a - b).abs().max();
        assert!(off <= 0.25 * widest * widest, "covariance: {a} {b}");
    }
}

fn sorted(mut values: [f32; 3]) -> [f32; 3] {
    values.sort_unstable_by(f32::total_cmp);
    values
}

fn covariance(g: &Gaussians, i: usize) -> Matrix3<f32> {
    let [w, x, y, z] = g.quats[i];
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)).to_rotation_matrix();
    let axes = Matrix3::from_diagonal(&Vector3::from(g.log_scales[i].map(f32::exp)));
    rotation.matrix() * axes * axes * rotation.matrix().transpose()
}

#[test]
fn what_is_read_is_what_was_written_in_any_order() {
    let (scene, folder) = (Scene::new(11), TempDir::new().unwrap());
    scene.write(folder.path());
    let mut reader = Reader::open(folder.path()).unwrap();
    let in_order: Vec<DecodedFrame> = (0..11).map(|t| reader.read(t).unwrap()).collect();
    in_order.iter().enumerate().for_each(|(t, frame)| scene.check(t, frame));
    for t in [7, 2, 10, 10, 0, 9, 4, 3, 8] {
        assert_eq!(reader.read(t).unwrap(), in_order[t as usize], "frame {t}");
        let alone = Reader::open(folder.path()).unwrap().read(t).unwrap();
        assert_eq!(alone, in_order[t as usize], "frame {t} first");
    }
    let keys: Vec<u64> = reader.entries().iter().filter(|e| e.key).map(|e| e.frame).collect();
    assert_eq!(keys, [0, 4, 8]);
}

/// Writes the conformance stream when a folder is named: `FFGS_WRITE_CONFORMANCE=fixtures/reference/stream`.
#[test]
fn a_conformance_stream_can_be_written_again() {
    let named = std::env::var_os("FFGS_WRITE_CONFORMANCE").map(std::path::PathBuf::from);
    let scratch = TempDir::new().unwrap();
    let folder = named.as_deref().unwrap_or(scratch.path());
    let mut scene = Scene::new(7);
    scene.settle(2);
    scene.settle(3);
    for t in 5..7 {
        scene.still[t] = layer(60, 3, 8.0 + t as f32);
    }
    let mut writer = scene.writer(folder);
    for t in 0..7 {
        let uncertainty: Vec<f32> = scene.ids[t].iter().map(|&id| 1e-3 * (1 + id % 50) as f32).collect();
        writer.push(&Frame { uncertainty: Some(&uncertainty), ..scene.frame(t) }).unwrap();
    }
    let mut reader = Reader::open(folder).unwrap();
    let fingerprint = |t| reader.read(t).map(|_| reader.fingerprint().unwrap()).unwrap();
    let fingerprints: Vec<[u32; 2]> = (0..7).map(fingerprint).collect();
    assert_ne!(fingerprints[4][1], fingerprints[5][1]);
    std::fs::write(folder.join("expected.json"), serde_json::to_string(&fingerprints).unwrap() + "\n")
        .unwrap();
}

#[test]
fn what_only_moves_costs_little() {
    let (mut scene, folder) = (Scene::new(3), TempDir::new().unwrap());
    let mut body = layer(3000, 0, 4.0);
    for t in 0..3 {
        scene.still[t] = layer(3000, 0, 9.0);
        scene.moving[t] = body.clone();
        scene.ids[t] = (0..3000).collect();
        advance(&mut body);
    }
    scene.write(folder.path());
    let reader = Reader::open(folder.path()).unwrap();
    let bytes: Vec<u64> = reader.entries().iter().map(|e| e.sections.values().sum()).collect();
    assert!(bytes[1] < bytes[0] / 10, "{bytes:?}");
}

#[test]
fn a_stream_that_grows_can_be_read_and_continued() {
    let (scene, folder) = (Scene::new(6), TempDir::new().unwrap());
    let mut writer = scene.writer(folder.path());
    let mut reader = Reader::open(folder.path()).unwrap();
    assert!(reader.entries().is_empty() && reader.read(0).is_err());
    for t in 0..3 {
        writer.push(&scene.frame(t)).unwrap();
        reader.refresh().unwrap();
        scene.check(t, &reader.read(t as u64).unwrap());
    }
    drop(writer);
    let mut writer = Writer::append(folder.path(), KEY_EVERY).unwrap();
    assert_eq!(writer.last_frame(), Some(2));
    assert!(writer.push(&scene.frame(2)).unwrap_err().to_string().contains("after frame 2"));
    assert!(writer.push(&scene.frame(3)).unwrap().key);
    // A line that is still being written does not count.
    let list = folder.path().join("frames.jsonl");
    let text = std::fs::read_to_string(&list).unwrap();
    std::fs::write(&list, text.clone() + "{\"frame\": 4, \"fi").unwrap();
    reader.refresh().unwrap();
    assert_eq!(reader.entries().len(), 4);
    scene.check(3, &reader.read(3).unwrap());
}

#[test]
fn a_static_layer_that_changes_its_shape_is_written_again() {
    let (mut scene, folder) = (Scene::new(4), TempDir::new().unwrap());
    scene.still[2] = layer(210, 3, 8.0);
    scene.still[3] = scene.still[2].clone();
    scene.write(folder.path());
    let mut reader = Reader::open(folder.path()).unwrap();
    let keys: Vec<bool> = reader.entries().iter().map(|e| e.static_key).collect();
    assert_eq!(keys, [true, false, true, false]);
    for t in [3, 1, 2, 0] {
        scene.check(t, &reader.read(t as u64).unwrap());
    }
}

#[test]
fn static_gaussians_that_changed_are_sent_alone() {
    let (mut scene, folder) = (Scene::new(10), TempDir::new().unwrap());
    scene.settle(2);
    scene.settle(5);
    scene.settle(6);
    scene.write(folder.path());
    let mut reader = Reader::open(folder.path()).unwrap();
    let sent = |e: &Entry| e.sections.get("StaticRows").copied();
    let frames: Vec<u64> = reader.entries().iter().filter(|e| sent(e).is_some()).map(|e| e.frame).collect();
    // Key frames count from the static key.
    assert_eq!(frames, [2, 4, 5, 6, 8]);
    let whole = reader.entries()[0].sections["StaticKey"];
    assert!(sent(&reader.entries()[2]).is_some_and(|bytes| bytes < whole / 4), "{whole}");
    assert!(reader.entries()[1..].iter().all(|e| !e.static_key));
    for t in [9, 1, 3, 8, 5, 4, 6, 2, 7, 0] {
        scene.check(t, &reader.read(t as u64).unwrap());
    }
}

#[test]
fn harmonics_of_what_shows_cost_more_and_are_nearer() {
    let mut scene = Scene::new(1);
    // Near the step of 0.05, where there is a choice.
    scene.still[0].sh.as_flattened_mut().iter_mut().for_each(|v| *v *= 0.3);
    let [halves, ones] = [[4.0_f32, 0.0], [1.0, 1.0]].map(|[shown, hidden]| {
        let of = |n: usize| (0..n).map(|i| if i < n / 2 { shown } else { hidden }).collect::<Vec<f32>>();
        [of(scene.still[0].len()), of(scene.moving[0].len())]
    });
    // Squared errors of harmonics of the first and the second half of the static layer.
    let errors = |importance: &[Vec<f32>; 2]| {
        let folder = TempDir::new().unwrap();
        let importance = Some([&importance[0][..], &importance[1][..]]);
        scene.writer(folder.path()).push(&Frame { importance, ..scene.frame(0) }).unwrap();
        let found = Reader::open(folder.path()).unwrap().read(0).unwrap().static_layer;
        let pairs = scene.still[0].sh.as_flattened().iter().zip(found.sh.as_flattened());
        let squares: Vec<f32> = pairs.map(|(a, b)| (a - b).powi(2)).collect();
        let (first, second) = squares.split_at(squares.len() / 2);
        [first, second].map(|half| half.iter().sum::<f32>())
    };
    let (unequal, equal) = (errors(&halves), errors(&ones));
    assert!(unequal[0] < equal[0] && unequal[1] > 1.5 * unequal[0], "{unequal:?} {equal:?}");
    let short = Some([&ones[0][..], &[][..]]);
    let folder = TempDir::new().unwrap();
    let error = scene.writer(folder.path()).push(&Frame { importance: short, ..scene.frame(0) });
    assert!(error.unwrap_err().to_string().contains("importances"));
}

#[test]
fn empty_layers_and_every_degree_are_frames() {
    for degree in 0..=3 {
        let (mut scene, folder) = (Scene::new(3), TempDir::new().unwrap());
        for t in 0..3 {
            scene.still[t] = layer(if degree == 2 { 0 } else { 20 }, degree, 1.0);
            scene.moving[t] = if t == 1 { Gaussians::empty(degree) } else { layer(10, degree, 3.0) };
            scene.ids[t] = (0..scene.moving[t].len() as u32).collect();
        }
        scene.write(folder.path());
        let mut reader = Reader::open(folder.path()).unwrap();
        (0..3).for_each(|t| scene.check(t, &reader.read(t as u64).unwrap()));
    }
}

#[test]
fn uncertainties_come_back_within_an_eighth_of_an_octave() {
    let (scene, folder) = (Scene::new(2), TempDir::new().unwrap());
    let mut writer = scene.writer(folder.path());
    for t in 0..2 {
        let values: Vec<f32> = scene.moving[t].means.iter().map(|p| p[0].abs() + 1e-3).collect();
        writer.push(&Frame { uncertainty: Some(&values), ..scene.frame(t) }).unwrap();
        let found = Reader::open(folder.path()).unwrap().read(t as u64).unwrap();
        for (p, u) in found.dynamic_layer.means.iter().zip(found.uncertainty.unwrap()) {
            let wanted = values[nearest(&scene.moving[t], *p)];
            assert!((u / wanted).log2().abs() < 0.126, "{u} {wanted}");
        }
    }
}

#[test]
fn damage_is_an_error_that_names_the_file_and_other_frames_still_play() {
    let (scene, folder) = (Scene::new(6), TempDir::new().unwrap());
    scene.write(folder.path());
    let path = folder.path().join("000005.4df");
    let good = std::fs::read(&path).unwrap();
    for at in (0..good.len()).step_by(97) {
        let mut bad = good.clone();
        bad[at] ^= 0x10;
        std::fs::write(&path, &bad).unwrap();
        let error = Reader::open(folder.path()).unwrap().read(5).unwrap_err().to_string();
        assert!(error.contains("000005.4df"), "{error}");
    }
    std::fs::remove_file(&path).unwrap();
    let mut reader = Reader::open(folder.path()).unwrap();
    assert!(reader.read(5).is_err());
    scene.check(3, &reader.read(3).unwrap());
    assert!(reader.read(77).unwrap_err().to_string().contains("77"));
}

#[test]
fn the_list_tells_files_apart_and_lists_of_before_are_read() {
    let (scene, folder) = (Scene::new(3), TempDir::new().unwrap());
    scene.write(folder.path());
    let mut entries = Reader::open(folder.path()).unwrap().entries().to_vec();
    let relist = |entries: &[Entry]| {
        let lines = entries.iter().map(|entry| serde_json::to_string(entry).unwrap() + "\n");
        std::fs::write(folder.path().join("frames.jsonl"), lines.collect::<String>()).unwrap();
    };
    // The constant of the first lists: the CRC-32 of bytes and their CRC-32.
    let sums: Vec<u32> = entries.iter().map(|entry| entry.crc32).collect();
    entries.iter_mut().for_each(|entry| entry.crc32 = 558_161_692);
    relist(&entries);
    scene.check(2, &Reader::open(folder.path()).unwrap().read(2).unwrap());
    // A sound file of the listed size, but of another frame.
    entries.iter_mut().zip(sums).for_each(|(entry, sum)| entry.crc32 = sum);
    entries[1].bytes = entries[2].bytes;
    relist(&entries);
    let [one, two] = [1, 2].map(|i: usize| folder.path().join(&entries[i].file));
    std::fs::copy(two, one).unwrap();
    let error = Reader::open(folder.path()).unwrap().read(1).unwrap_err().to_string();
    assert!(error.contains("000001.4df") && error.contains("not the file that the list names"), "{error}");
}

#[test]
fn another_version_a_foreign_manifest_and_a_path_outside_are_refused() {
    let (scene, folder) = (Scene::new(1), TempDir::new().unwrap());
    scene.write(folder.path());
    let manifest = folder.path().join("manifest.json");
    let good = std::fs::read_to_string(&manifest).unwrap();
    for (from, to, says) in [
        ("\"version\": 3", "\"version\": 9", "version 9"),
        ("ffgs-4d", "other", "other"),
        ("\"rotation\": 48", "\"rotation\": 0", "range"),
        ("\"title\"", "\"subtitle\"", "title"),
    ] {
        assert!(good.contains(from), "{from}");
        std::fs::write(&manifest, good.replace(from, to)).unwrap();
        let error = Reader::open(folder.path()).unwrap_err().to_string();
        assert!(error.contains("manifest.json") && error.contains(says), "{error}");
    }
    std::fs::write(&manifest, good.replace("\"version\": 3", "\"version\": 1")).unwrap();
    scene.check(0, &Reader::open(folder.path()).unwrap().read(0).unwrap());
    let list = folder.path().join("frames.jsonl");
    let text = std::fs::read_to_string(&list).unwrap();
    std::fs::write(&list, text.replace("000000.4df", "../x")).unwrap();
    assert!(Reader::open(folder.path()).unwrap_err().to_string().contains("outside"));
}

#[test]
fn frames_that_do_not_fit_are_refused() {
    let (scene, folder) = (Scene::new(2), TempDir::new().unwrap());
    let mut writer = scene.writer(folder.path());
    assert!(writer.push(&Frame { ids: &[1, 2], ..scene.frame(0) }).is_err());
    let mut broken = scene.moving[0].clone();
    broken.means[7][1] = f32::NAN;
    let error = writer.push(&Frame { dynamic_layer: &broken, ..scene.frame(0) }).unwrap_err().to_string();
    assert!(error.contains("not finite"), "{error}");
    assert!(writer.push(&Frame { static_layer: &layer(3, 1, 1.0), ..scene.frame(0) }).is_err());
    writer.push(&scene.frame(0)).unwrap();
}

/// As on a full disk: nothing can be put under a name that a folder with content has.
#[test]
fn a_frame_that_cannot_be_written_is_missed_by_no_later_one() {
    for name in ["000002.4df", "frames.jsonl"] {
        let (scene, folder) = (Scene::new(4), TempDir::new().unwrap());
        let [place, aside] = [name, "aside"].map(|name| folder.path().join(name));
        let mut writer = scene.writer(folder.path());
        let keys = [0, 1].map(|t| writer.push(&scene.frame(t)).unwrap().key);
        assert_eq!(keys, [true, false]);
        let was_there = std::fs::rename(&place, &aside).is_ok();
        std::fs::create_dir_all(place.join("content")).unwrap();
        let error = writer.push(&scene.frame(2)).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
        std::fs::remove_dir_all(&place).unwrap();
        if was_there {
            std::fs::rename(&aside, &place).unwrap();
        }
        for t in [2, 3] {
            let error = writer.push(&scene.frame(t)).unwrap_err().to_string();
            assert!(error.contains("open the stream again"), "{error}");
        }
        assert_eq!(writer.last_frame(), Some(1));

        let mut writer = Writer::append(folder.path(), KEY_EVERY).unwrap();
        let keys = [2, 3].map(|t| writer.push(&scene.frame(t)).unwrap().key);
        assert_eq!(keys, [true, false], "{name}");
        let mut reader = Reader::open(folder.path()).unwrap();
        (0..4).for_each(|t| scene.check(t, &reader.read(t as u64).unwrap()));
    }
}

#[test]
fn a_line_that_was_not_finished_is_cut_off_before_the_next() {
    let (scene, folder) = (Scene::new(3), TempDir::new().unwrap());
    let list = folder.path().join("frames.jsonl");
    let append = || Writer::append(folder.path(), KEY_EVERY).unwrap();
    drop(scene.writer(folder.path()));
    // Interrupted in the first line, and in a later one.
    std::fs::write(&list, "{\"frame\": 0, \"fi").unwrap();
    assert_eq!(append().last_frame(), None);
    assert_eq!(std::fs::read_to_string(&list).unwrap(), "");
    append().push(&scene.frame(0)).unwrap();
    let sound = std::fs::read_to_string(&list).unwrap();
    std::fs::write(&list, sound.clone() + &sound[..sound.len() / 2]).unwrap();
    append().push(&scene.frame(1)).unwrap();
    // What is whole stays.
    let whole = std::fs::read_to_string(&list).unwrap();
    assert!(whole.starts_with(&sound));
    drop(append());
    assert_eq!(std::fs::read_to_string(&list).unwrap(), whole);
    let mut reader = Reader::open(folder.path()).unwrap();
    assert_eq!(reader.entries().len(), 2);
    (0..2).for_each(|t| scene.check(t, &reader.read(t as u64).unwrap()));
}

#[test]
fn the_list_says_which_frames_have_uncertainties() {
    let (scene, folder) = (Scene::new(2), TempDir::new().unwrap());
    let mut writer = scene.writer(folder.path());
    let values = vec![0.1; scene.moving[0].len()];
    writer.push(&Frame { uncertainty: Some(&values), ..scene.frame(0) }).unwrap();
    writer.push(&scene.frame(1)).unwrap();
    let reader = Reader::open(folder.path()).unwrap();
    let said: Vec<bool> = reader.entries().iter().map(Entry::has_uncertainty).collect();
    assert_eq!(said, [true, false]);
}
