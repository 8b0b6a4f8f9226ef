//! Files that are not what they should be: used, or refused with a sentence; nothing written where it does not belong.

use super::capture::files;
use super::case::{Case, names_a_file, run_words, said};
use super::checksum::crc32;
use super::damage::damage;
use super::mutation::{damage_file, odd_value};
use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

/// A file of the capture damaged: checked, and every third time run.
pub(crate) fn damaged_capture(case: &mut Case) -> Result<()> {
    let capture = case.copied_capture()?;
    // Camera lists and the list of trackers are few among many images and are damaged as often.
    let all = files(&capture)?;
    let json: Vec<PathBuf> = all.iter().filter(|file| is_json(file)).cloned().collect();
    let pool = if case.below(2) == 0 { json } else { all };
    let file = case.one_of(&pool);
    change(case, &file)?;
    attempt(case, &capture)
}

fn is_json(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension == "json")
}

/// Damages a file by its kind.
pub(crate) fn change(case: &mut Case, file: &Path) -> Result<()> {
    let mut bytes = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    damage_file(case, is_json(file), &mut bytes);
    Ok(fs::write(file, bytes)?)
}

/// Checks the capture, and every third time runs it.
fn attempt(case: &mut Case, capture: &Path) -> Result<()> {
    let checked = case.ffgs(&["check".into(), capture.display().to_string(), "--quiet".into()])?;
    if case.below(3) == 0 {
        let out = case.path("out");
        let run = case.ffgs(&run_words(capture, &out, &[]))?;
        ensure!(
            checked.status.success() || !run.status.success(),
            "a run of what the check refuses: {}",
            said(&checked)
        );
        finite_metrics(&run, &out)?;
    }
    stays_inside(case)
}

/// A run that ends well measured something.
fn finite_metrics(run: &Output, out: &Path) -> Result<()> {
    if !run.status.success() {
        return Ok(());
    }
    let metrics: Value = serde_json::from_str(&fs::read_to_string(out.join("metrics.json"))?)?;
    for view in
        metrics["frames"].as_array().into_iter().flatten().filter_map(|f| f["views"].as_array()).flatten()
    {
        ensure!(view["psnr"].as_f64().is_some_and(f64::is_finite), "a PSNR of {}", view["psnr"]);
    }
    Ok(())
}

/// Nothing is written beside the case's own folders.
pub(crate) fn stays_inside(case: &Case) -> Result<()> {
    let known = ["capture", "footage", "out", "run", "settings.toml", "in.npz", "out.npz"];
    for entry in fs::read_dir(case.path("."))?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        ensure!(known.contains(&name.as_str()), "{name} was written outside of the output folder");
    }
    Ok(())
}

/// Cameras and trackers with names that leave folders, command terminals or end scripts.
pub(crate) fn hostile_names(case: &mut Case) -> Result<()> {
    let capture = case.copied_capture()?;
    let names = [
        "../../escape",
        "a\u{1b}[2Jb",
        "</script><b>",
        "a b\n",
        "\u{202e}abc",
        "ä",
        "{{x}}",
        "..",
        ".hidden",
    ];
    let (name, tracker) = (case.one_of(&names), case.below(2) == 0);
    let file = capture.join(if tracker { "tracks/tracks.json" } else { "test_meta.json" });
    let mut value: Value = serde_json::from_str(&fs::read_to_string(&file)?)?;
    if tracker {
        value["trackers"][0]["name"] = json!(name);
    } else {
        for (frame, row) in value["fn"].as_array_mut().context("no names")?.iter_mut().enumerate() {
            let from = row[0].as_str().context("no name")?.to_owned();
            let to = format!("{name}/{frame:06}.png");
            row[0] = json!(to);
            for folder in ["ims", "seg"] {
                let target = capture.join(folder).join(&to);
                if !name.contains("..") {
                    fs::create_dir_all(target.parent().context("no folder")?)?;
                    fs::rename(capture.join(folder).join(&from), target)?;
                }
            }
        }
    }
    fs::write(&file, value.to_string())?;
    attempt(case, &capture)
}

/// Pipes, devices, links in circles and folders where files should be: refused, never waited for.
pub(crate) fn no_files(case: &mut Case) -> Result<()> {
    let capture = case.copied_capture()?;
    let pool = files(&capture)?;
    let file = case.one_of(&pool);
    replace_by_no_file(case, &file)?;
    let ended = case.ffgs(&["check".into(), capture.display().to_string(), "--quiet".into()])?;
    // What is removed again here could not be copied if the case failed.
    let _ = fs::remove_file(&file).or_else(|_| fs::remove_dir(&file));
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let optional = ended.status.success();
    ensure!(optional || said(&ended).contains(&name), "{name} is not named: {}", said(&ended));
    Ok(())
}

/// Puts a pipe, a device, a link in a circle or a folder in the place of a file.
pub(crate) fn replace_by_no_file(case: &mut Case, file: &Path) -> Result<()> {
    fs::remove_file(file)?;
    match case.below(4) {
        0 => {
            std::process::Command::new("mkfifo").arg(file).status()?;
        }
        1 => std::os::unix::fs::symlink("/dev/zero", file)?,
        2 => std::os::unix::fs::symlink(file, file)?,
        _ => fs::create_dir(file)?,
    }
    Ok(())
}

/// A copy of the undisturbed run with a damaged file, states with a right checksum too.
pub(crate) fn damaged_file_of_run(case: &mut Case) -> Result<PathBuf> {
    let run = case.copied_run()?;
    let pool: Vec<PathBuf> =
        files(&run)?.into_iter().filter(|f| is_json(f) || f.ends_with("state.ffgs")).collect();
    let file = case.one_of(&pool);
    change(case, &file)?;
    if file.ends_with("state.ffgs") && case.below(4) > 0 {
        mend_checksum(&file)?;
    }
    Ok(run)
}

/// A damaged run: measured, rendered and resumed.
pub(crate) fn damaged_run(case: &mut Case) -> Result<()> {
    let run = damaged_file_of_run(case)?;
    let path = run.display().to_string();
    let words: Vec<String> = match case.below(3) {
        0 => ["eval", &path, "--device", "cpu", "--quiet"].map(str::to_owned).to_vec(),
        1 => {
            ["render", &path, "--camera", "trk000", "--device", "cpu", "--quiet"].map(str::to_owned).to_vec()
        }
        _ => run_words(&case.laboratory.capture(), &run, &["--resume"]),
    };
    let ended = case.ffgs(&words)?;
    ensure!(ended.status.success() || names_a_file(case, &said(&ended)), "which file? {}", said(&ended));
    stays_inside(case)
}

/// Makes length and checksum those of the damaged payload.
fn mend_checksum(file: &Path) -> Result<()> {
    const HEAD: usize = 20;
    let mut bytes = fs::read(file)?;
    bytes.resize(bytes.len().max(HEAD + 4), 0);
    let payload = bytes.len() - HEAD - 4;
    bytes[..8].copy_from_slice(b"FFGSCKPT");
    bytes[12..HEAD].copy_from_slice(&(payload as u64).to_le_bytes());
    let end = bytes.len() - 4;
    let sum = crc32(&bytes[..end]);
    bytes[end..].copy_from_slice(&sum.to_le_bytes());
    Ok(fs::write(file, bytes)?)
}

/// A setting or two at random values: refused by name, or a run of finite numbers.
pub(crate) fn odd_settings(case: &mut Case) -> Result<()> {
    let printed = case.ffgs(&["config".into()])?;
    let mut settings: toml::Table = toml::from_str(&String::from_utf8_lossy(&printed.stdout))?;
    for _ in 0..=case.below(2) {
        let (path, value) = odd_setting(case, &settings)?;
        *at(&mut settings, &path).context("no such key")? = value;
    }
    let file = case.path("settings.toml");
    let mut text = toml::to_string(&settings)?.into_bytes();
    if case.below(4) == 0 {
        damage(&mut case.random, &mut text);
    }
    fs::write(&file, text)?;
    let out = case.path("out");
    let named = file.display().to_string();
    let run =
        case.ffgs(&run_words(&case.laboratory.capture(), &out, &["--config", &named, "--frames", "0..2"]))?;
    ensure!(run.status.success() || names_a_file(case, &said(&run)), "which file? {}", said(&run));
    finite_metrics(&run, &out)
}

/// A random key and a value of its type that is seldom sensible.
fn odd_setting(case: &mut Case, settings: &toml::Table) -> Result<(Vec<String>, toml::Value)> {
    let (mut path, mut table) = (Vec::new(), settings);
    loop {
        let key = table.keys().nth(case.below(table.len())).context("an empty table")?.clone();
        path.push(key.clone());
        match &table[&key] {
            toml::Value::Table(inner) => table = inner,
            toml::Value::Integer(_) => {
                let value = case.one_of(&[0, 1, 2, 3, 4, 7, 64, 4096, 1 << 20, 1 << 32, -1, i64::MAX]);
                // Iterations take as long as asked.
                let bounded = if path.concat().contains("iterations") { value.min(7) } else { value };
                return Ok((path, toml::Value::Integer(bounded)));
            }
            toml::Value::Float(_) => {
                let extremes = [0.0, -1.0, 1e-300, 1e-30, 1e-3, 0.5, 1.0, 2.0, 1e3, 1e30, 1e300];
                let value = case.one_of(&[&extremes[..], &[f64::NAN, f64::INFINITY]].concat());
                return Ok((path, toml::Value::Float(value)));
            }
            toml::Value::Boolean(old) => return Ok((path, toml::Value::Boolean(!old))),
            _ => {
                let odd = odd_value(case);
                return Ok((path, toml::Value::String(odd.to_string())));
            }
        }
    }
}

fn at<'a>(table: &'a mut toml::Table, path: &[String]) -> Option<&'a mut toml::Value> {
    let (key, rest) = path.split_first()?;
    let value = table.get_mut(key)?;
    if rest.is_empty() { Some(value) } else { at(value.as_table_mut()?, rest) }
}

/// A reference input of a stage, damaged.
pub(crate) fn damaged_stage_input(case: &mut Case) -> Result<()> {
    let folder = case.laboratory.root.join("fixtures/reference");
    let pool: Vec<PathBuf> =
        files(&folder)?.into_iter().filter(|f| f.extension().is_some_and(|e| e == "npz")).collect();
    let from = case.one_of(&pool);
    let stage = from.strip_prefix(&folder)?.components().next().context("no stage")?;
    let stage = stage.as_os_str().to_string_lossy().into_owned();
    let mut bytes = fs::read(&from)?;
    damage(&mut case.random, &mut bytes);
    let [input, output] = ["in.npz", "out.npz"].map(|name| case.path(name));
    fs::write(&input, bytes)?;
    let paths = [&input, &output].map(|path| path.display().to_string());
    let words =
        ["stage", &stage, "--literal", "--input", &paths[0], "--output", &paths[1], "--device", "cpu"];
    let ended = case.ffgs(&words.map(str::to_owned))?;
    ensure!(ended.status.success() == output.exists(), "an output beside an error, or none without");
    ensure!(ended.status.success() || said(&ended).contains("in.npz"), "which file? {}", said(&ended));
    Ok(())
}
