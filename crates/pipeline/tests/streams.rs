//! The stream of a run, which `ffgs export` and the pages of `ffgs view` write in turn.

use ffgs_stream::{Entry, Reader};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// A page looks for frames every two seconds; machines may be busy.
const PATIENCE: Duration = Duration::from_mins(2);

fn ffgs(words: &[&str], run: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ffgs"));
    command.args(words).arg(run).stdin(Stdio::null()).stdout(Stdio::null());
    command
}

/// What it said on the standard error, when it succeeded, or else when it failed.
fn ended(command: &mut Command) -> Result<String, String> {
    let output = command.output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    if output.status.success() { Ok(said) } else { Err(said) }
}

/// A run of two frames of the sample, which is made once; each test has a copy.
fn copy_of_the_run(place: &Path) -> PathBuf {
    static RUN: OnceLock<tempfile::TempDir> = OnceLock::new();
    let run = RUN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let few = ["--first-iterations", "4", "--iterations", "3", "--frames", "0..2"];
        let views = ["--device", "cpu", "--train-views", "trk000,trk004,trk008", "--quiet"];
        let out = folder.path().join("run");
        ended(ffgs(&["run", "--out"], &out).arg(sample).args(few).args(views)).unwrap();
        folder
    });
    let copy = place.join("run");
    copy_folder(&run.path().join("run"), &copy);
    copy
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// `ffgs view`, which is stopped in the end.
struct Page {
    process: Child,
    said: PathBuf,
}

impl Page {
    fn open(run: &Path, place: &Path, name: &str) -> Self {
        let [engine, said] = ["engine", name].map(|name| place.join(name));
        fs::write(&engine, "no engine: nobody looks at the page").unwrap();
        let mut command = ffgs(&["view"], run);
        command.env("FFGS_PLAYCANVAS", &engine).stderr(File::create(&said).unwrap());
        Self { process: command.spawn().unwrap(), said }
    }

    fn says(&self, text: &str) {
        let said = || fs::read_to_string(&self.said).unwrap();
        wait_until(|| said().contains(text), said);
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }
}

fn wait_until(is_so: impl Fn() -> bool, what: impl Fn() -> String) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < PATIENCE, "{}", what());
        std::thread::sleep(Duration::from_millis(100));
    }
}

fn entries(stream: &Path) -> Vec<Entry> {
    Reader::open(stream).map(|reader| reader.entries().to_vec()).unwrap_or_default()
}

fn wait_for_frames(stream: &Path, count: usize) {
    wait_until(|| entries(stream).len() == count, || format!("{:?}", entries(stream)));
}

#[test]
fn a_stream_has_one_writer_and_others_wait_for_their_turn() {
    let place = tempfile::tempdir().unwrap();
    let run = copy_of_the_run(place.path());
    let stream = run.join("export/stream");
    // As while the run has not finished its second frame.
    let [last, aside] = ["frames/000001", "aside"].map(|name| run.join(name));
    fs::rename(&last, &aside).unwrap();
    let first = Page::open(&run, place.path(), "first");
    wait_for_frames(&stream, 1);
    let export = || ended(&mut ffgs(&["export", "--quiet", "--uncertainty", "--to", "stream"], &run));
    let refused = export().unwrap_err();
    assert!(refused.contains(&format!("(process {})", first.process.id())), "{refused}");
    // Another page shows what the first one writes, and goes on when that is gone.
    let second = Page::open(&run, place.path(), "second");
    second.says("no further frames from this process");
    drop(first);
    fs::rename(&aside, &last).unwrap();
    wait_for_frames(&stream, 2);
    assert!(export().is_err());
    drop(second);
    export().unwrap();
    assert!(!stream.join("run.lock").exists());
}

#[test]
fn a_page_goes_on_with_a_key_frame_after_a_frame_that_could_not_be_written() {
    let place = tempfile::tempdir().unwrap();
    let run = copy_of_the_run(place.path());
    let stream = run.join("export/stream");
    // Nothing can be put under the name of a folder with content.
    let obstacle = stream.join("000001.4df");
    fs::create_dir_all(obstacle.join("content")).unwrap();
    let page = Page::open(&run, place.path(), "page");
    page.says("000001.4df");
    fs::remove_dir_all(&obstacle).unwrap();
    wait_for_frames(&stream, 2);
    assert!(entries(&stream).iter().all(|entry| entry.key));
    let mut reader = Reader::open(&stream).unwrap();
    (0..2).for_each(|frame| assert_eq!(reader.read(frame).unwrap().frame, frame));
    // A frame that can be written follows without one.
    drop(page);
    fs::remove_dir_all(&stream).unwrap();
    ended(&mut ffgs(&["export", "--quiet", "--to", "stream"], &run)).unwrap();
    assert_eq!(entries(&stream).iter().map(|entry| entry.key).collect::<Vec<_>>(), [true, false]);
}

#[test]
fn frames_of_a_stream_have_uncertainties_or_none_has() {
    let place = tempfile::tempdir().unwrap();
    let run = copy_of_the_run(place.path());
    let stream = run.join("export/stream");
    let export = |more: &[&str]| ended(ffgs(&["export", "--quiet", "--to", "stream"], &run).args(more));
    for (options, others, told) in [
        (&["--uncertainty"][..], &[][..], "with uncertainties; give --uncertainty"),
        (&[], &["--uncertainty"], "without uncertainties; leave --uncertainty out"),
    ] {
        export(&[options, &["--frames", "0..1"]].concat()).unwrap();
        let refused = export(others).unwrap_err();
        assert!(refused.contains(told), "{refused}");
        assert_eq!(entries(&stream).len(), 1);
        export(options).unwrap();
        let with: Vec<bool> = entries(&stream).iter().map(Entry::has_uncertainty).collect();
        assert_eq!(with, [!options.is_empty(); 2]);
        fs::remove_dir_all(&stream).unwrap();
    }
    // The page goes on with a stream as it is, and begins one with uncertainties.
    for (exported, with) in [(true, false), (false, true)] {
        if exported {
            export(&["--frames", "0..1"]).unwrap();
        }
        let page = Page::open(&run, place.path(), "page");
        wait_for_frames(&stream, 2);
        assert!(entries(&stream).iter().all(|entry| entry.has_uncertainty() == with));
        drop(page);
        fs::remove_dir_all(&stream).unwrap();
    }
}

#[test]
fn an_option_without_an_effect_is_refused_before_anything_is_written() {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("no run");
    for (to, option) in [("stream", "--native"), ("site", "--bake-iterations=9"), ("spz", "--precision=2")] {
        let refused = ended(&mut ffgs(&["export", "--to", to, option], &run)).unwrap_err();
        let name = option.split('=').next().unwrap();
        assert!(refused.contains(&format!("{name} has no effect on --to {to}")), "{refused}");
    }
    let refused = ended(&mut ffgs(&["export", "--to", "stream", "--precision=2"], &run)).unwrap_err();
    assert!(refused.contains("no output folder"), "{refused}");
    assert!(!run.exists());
}
