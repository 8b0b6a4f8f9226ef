//! `exposures.json`: the exposures of a run's cameras between its frames, and views loaded in one exposure.

use crate::job::frame::{load_views, training_views};
use crate::job::provenance::Checksum;
use crate::outputs::folder::RunFolder;
use crate::outputs::json::{read_json, write_json};
use anyhow::{Context, Result, ensure};
use ffgs_core::TrainingView;
use ffgs_method::{Capture, ViewAt};
use ffgs_reconstruction::Exposures;

/// Those of a run; neutral where it wrote none.
///
/// # Errors
/// When the file is damaged.
pub fn read_exposures(folder: &RunFolder) -> Result<Exposures> {
    let file = folder.exposures();
    if !file.exists() {
        return Ok(Exposures::default());
    }
    let exposures: Exposures = read_json(&file)?;
    ensure!(
        exposures.are_sound(),
        "{}: an offset is no number between -20 and 20; bring the file back",
        file.display()
    );
    Ok(exposures)
}

/// Writes them for the frames to come; removes those of an earlier run where all cameras agree.
///
/// # Errors
/// When the file cannot be written.
pub(crate) fn write_exposures(exposures: &Exposures, folder: &RunFolder) -> Result<()> {
    let file = folder.exposures();
    if !exposures.are_neutral() {
        return write_json(&file, exposures);
    }
    if file.exists() {
        std::fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
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

/// What the report says of them; `None` where all cameras agree.
pub(crate) fn exposures_fact(exposures: &Exposures) -> Option<String> {
    let (name, offset) = exposures.furthest()?;
    Some(format!(
        "differ by {:.2} (root mean square of the log odds), most {name} by {offset:+.2}; removed from the photographs, \
         given back to the renders (exposures.json)",
        exposures.deviation()
    ))
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
        write_exposures(&exposures, &run).unwrap();
        assert_eq!(read_exposures(&run).unwrap(), exposures);
        let said = exposures_fact(&exposures).unwrap();
        assert!(said.contains("b by +1.00"), "{said}");
        std::fs::write(run.exposures(), r#"{"train": {"a": [1e9, 0, 0]}, "init": {}}"#).unwrap();
        assert!(format!("{:#}", read_exposures(&run).unwrap_err()).contains("exposures.json"));
        write_exposures(&Exposures::default(), &run).unwrap();
        assert!(!run.exposures().exists() && exposures_fact(&read_exposures(&run).unwrap()).is_none());
    }
}
