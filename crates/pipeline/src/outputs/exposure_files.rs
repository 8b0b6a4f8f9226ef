//! `exposures.json`: the exposures of a run's cameras, of all frames and of those that change any, and views loaded in one exposure.

use crate::job::frame::{load_views, training_views};
use crate::job::provenance::Checksum;
use crate::outputs::folder::RunFolder;
use crate::outputs::json::{read_json, write_json};
use anyhow::{Context, Result, ensure};
use ffgs_core::{TrainingView, counted};
use ffgs_method::{Capture, ViewAt};
use ffgs_reconstruction::Exposures;
use std::path::Path;

/// Those of a frame of a run; neutral where it wrote none.
///
/// # Errors
/// When the file is damaged.
pub fn read_exposures(folder: &RunFolder, frame: usize) -> Result<Exposures> {
    let file = folder.exposures_of(frame);
    if file.exists() { read(&file) } else { read_usual(folder) }
}

/// Those of the frames that change none.
///
/// # Errors
/// When the file is damaged.
pub(crate) fn read_usual(folder: &RunFolder) -> Result<Exposures> {
    read(&folder.exposures())
}

fn read(file: &Path) -> Result<Exposures> {
    if !file.exists() {
        return Ok(Exposures::default());
    }
    let exposures: Exposures = read_json(file)?;
    ensure!(
        exposures.are_sound(),
        "{}: an offset is no number between -20 and 20; bring the file back",
        file.display()
    );
    Ok(exposures)
}

/// Writes those of the frames to come; removes those of an earlier run where all cameras agree.
///
/// # Errors
/// When the file cannot be written.
pub(crate) fn write_usual(exposures: &Exposures, folder: &RunFolder) -> Result<()> {
    let usual = exposures.usual();
    write(&usual, &folder.exposures(), !usual.are_neutral())
}

/// Writes those of a frame where it changes any; removes those of an earlier run otherwise.
///
/// # Errors
/// When the file cannot be written.
pub(crate) fn write_changed(exposures: &Exposures, folder: &RunFolder, frame: usize) -> Result<()> {
    write(exposures, &folder.exposures_of(frame), exposures.changes() > 0)
}

fn write(exposures: &Exposures, file: &Path, wanted: bool) -> Result<()> {
    if wanted {
        return write_json(file, exposures);
    }
    if file.exists() {
        std::fs::remove_file(file).with_context(|| format!("cannot remove {}", file.display()))?;
    }
    Ok(())
}

/// Loads views in one exposure, in parallel, and the checksums of what they were read from.
///
/// # Errors
/// When one of them cannot be read.
pub(crate) fn load_equal(
    capture: &dyn Capture,
    exposures: &Exposures,
    shots: &[ViewAt],
) -> Result<(Vec<TrainingView>, Vec<Checksum>)> {
    let (mut views, sums) = load_views(capture, shots)?;
    exposures.remove(capture, shots, &mut views)?;
    Ok((views, sums))
}

/// Loads the training views `views` (by index) of a frame in one exposure.
///
/// # Errors
/// When one of them cannot be read.
pub fn load_training(
    capture: &dyn Capture,
    exposures: &Exposures,
    views: &[usize],
    frame: usize,
) -> Result<Vec<TrainingView>> {
    load_equal(capture, exposures, &training_views(views, frame)).map(|(views, _)| views)
}

/// What the report says of them, when `changing` frames have exposures of their own; `None` where all cameras agree in all frames.
pub(crate) fn exposures_fact(usual: &Exposures, changing: usize) -> Option<String> {
    let differ = |(name, offset): (&str, f64)| {
        format!(
            "differ by {:.2} (root mean square of the log odds), most {name} by {offset:+.2} (exposures.json)",
            usual.deviation()
        )
    };
    let change = (changing > 0)
        .then(|| format!("change in {} (frames/NNNNNN/exposures.json)", counted(changing, "frame")));
    let found: Vec<String> = usual.furthest().map(differ).into_iter().chain(change).collect();
    let told = found.join("; ");
    (!found.is_empty()).then(|| format!("{told}; removed from the photographs, given back to the renders"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_keeps_them_and_damage_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder(folder.path().to_owned());
        let file = r#"{"train": {"a": [0.0, 0.0, 0.0], "b": [1.0, 1.0, 1.0]}, "init": {}}"#;
        let exposures: Exposures = serde_json::from_str(file).unwrap();
        write_usual(&exposures, &run).unwrap();
        assert_eq!(read_exposures(&run, 3).unwrap(), exposures);
        let change = r#""change": {"a": [0.5, 0.5, 0.5], "b": [0.0, 0.0, 0.0]}, "init":"#;
        let changed: Exposures = serde_json::from_str(&file.replace(r#""init":"#, change)).unwrap();
        write_changed(&changed, &run, 3).unwrap();
        write_changed(&exposures, &run, 4).unwrap();
        assert_eq!((read_exposures(&run, 3).unwrap(), changed.changes()), (changed.clone(), 1));
        assert_eq!(read_exposures(&run, 4).unwrap(), exposures, "nothing changes there");
        assert_eq!(changed.usual(), exposures);
        write_changed(&exposures, &run, 3).unwrap();
        assert!(!run.exposures_of(3).exists(), "one of an earlier run goes");
        let said = exposures_fact(&exposures, 0).unwrap();
        assert!(said.contains("b by +1.00") && !said.contains("change"), "{said}");
        let said = exposures_fact(&Exposures::default(), 3).unwrap();
        assert!(said.starts_with("change in 3 frames"), "{said}");
        std::fs::write(run.exposures(), r#"{"train": {"a": [1e9, 0, 0]}, "init": {}}"#).unwrap();
        assert!(format!("{:#}", read_usual(&run).unwrap_err()).contains("exposures.json"));
        write_usual(&Exposures::default(), &run).unwrap();
        assert!(!run.exposures().exists() && exposures_fact(&read_usual(&run).unwrap(), 0).is_none());
    }
}
