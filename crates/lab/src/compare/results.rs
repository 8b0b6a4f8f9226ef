//! What the runs gave, as tables.

use super::plan::Candidate;
use super::table::Table;
use ffgs_core::stage;
use ffgs_pipeline::outputs::record::{FrameRecord, Mean, Metrics};
use std::collections::BTreeMap;

/// A capture and the runs on it.
pub(super) struct Compared {
    pub capture: String,
    /// Of the run that holds the first frame of all.
    pub first: Option<Metrics>,
    pub outcomes: Vec<Outcome>,
}

impl Compared {
    pub(super) fn new(capture: String) -> Self {
        Self { capture, first: None, outcomes: Vec::new() }
    }
}

/// One run.
pub(super) struct Outcome {
    pub name: String,
    pub budget: f64,
    pub metrics: Metrics,
    /// Why it ended before its last frame, or did not begin.
    pub stopped: Option<String>,
}

impl Outcome {
    pub(super) fn new(candidate: &Candidate, budget: f64, metrics: Metrics, stopped: Option<String>) -> Self {
        Self { name: candidate.name.clone(), budget, metrics, stopped }
    }

    pub(super) fn title(&self) -> String {
        if self.budget == 1.0 { self.name.clone() } else { format!("{} x {}", self.name, self.budget) }
    }

    /// Seconds per frame after the first.
    pub(super) fn seconds(&self) -> Option<f64> {
        self.metrics.mean.seconds_per_frame
    }

    /// Time on processors (s) per frame after the first, of all that the process did between two frames. A step that is
    /// not positive does not count: the run was resumed there, by a process whose counter began anew. Where that process had
    /// done much else before, the step is positive and cannot be told from others.
    fn processor_seconds(&self) -> Option<f64> {
        let step = |pair: &[FrameRecord]| Some(pair[1].processor_seconds? - pair[0].processor_seconds?);
        let steps: Vec<f64> = self.metrics.frames.windows(2).filter_map(step).filter(|s| *s > 0.0).collect();
        (!steps.is_empty()).then(|| steps.iter().sum::<f64>() / steps.len() as f64)
    }
}

/// Of the paper's tables: quality, seconds by stage, storage, preparation; and what each method reaches in our seconds.
pub(super) fn tables(all: &[Compared]) -> Vec<Table> {
    let mut out = Vec::new();
    for compared in all {
        out.push(quality(compared));
        out.extend(equal_seconds(compared));
        out.push(stages(compared));
        out.push(storage(compared));
    }
    out.push(preparation(all));
    out
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// Of whole pictures and of the foreground.
fn scores(mean: &Mean) -> [String; 8] {
    let whole = [(mean.psnr, 2), (mean.ssim, 4), (mean.vmaf, 2), (mean.flicker, 2)];
    let foreground = [(mean.mpsnr, 2), (mean.mssim, 4), (mean.mvmaf, 2), (mean.mflicker, 2)];
    let values: [_; 8] = std::array::from_fn(|i| if i < 4 { whole[i] } else { foreground[i - 4] });
    values.map(|(value, digits)| number(value, digits))
}

const SCORES: [&str; 8] = ["PSNR", "SSIM", "VMAF", "flicker", "MPSNR", "MSSIM", "MVMAF", "mflicker"];

fn quality(compared: &Compared) -> Table {
    let head =
        [&["method"][..], &SCORES, &["MPSNR before", "s", "processor s", "PE", "VE", "frames", ""]].concat();
    let note = "Means over the test views of the frames after the first. MPSNR before: of the motion alone, before training. \
                s: seconds per frame; processor s: time on processors per frame, renders of the test views included; \
                PE and VE: PSNR and VMAF by seconds. Flicker: change of the error since the frame before, less is better. \
                Names that begin with M or m: over the foreground.";
    let mut table = Table::new(format!("{}: quality", compared.capture), note, &head);
    for outcome in &compared.outcomes {
        let mean = &outcome.metrics.mean;
        let mut row = vec![outcome.title()];
        row.extend(scores(mean));
        row.push(number(mean.initial_mpsnr, 2));
        row.extend([mean.seconds_per_frame, outcome.processor_seconds()].map(|value| number(value, 1)));
        row.extend([mean.psnr_per_second, mean.vmaf_per_second].map(|value| number(value, 2)));
        row.push(outcome.metrics.frames.len().saturating_sub(1).to_string());
        row.push(outcome.stopped.as_ref().map_or_else(String::new, |why| format!("stopped: {why}")));
        table.rows.push(row);
    }
    table
}

/// What a method reaches in at most the seconds that the first row takes: its largest budget within them.
fn equal_seconds(compared: &Compared) -> Option<Table> {
    /// Seconds are measured, and this is how much of a difference is none.
    const SLACK: f64 = 1.05;
    let ours = compared.outcomes.iter().find(|o| o.budget == 1.0)?;
    let limit = SLACK * ours.seconds()?;
    let note = format!(
        "Each method at the largest of its budgets that takes no longer than {} at budget 1; - where none does.",
        ours.name
    );
    let head = [&["method", "budget", "s"][..], &SCORES].concat();
    let mut table = Table::new(format!("{}: at equal seconds", compared.capture), &note, &head);
    let mut best = BTreeMap::<&str, &Outcome>::new();
    for outcome in compared.outcomes.iter().filter(|o| o.seconds().is_some_and(|s| s <= limit)) {
        let known = best.entry(&outcome.name).or_insert(outcome);
        if outcome.budget > known.budget {
            *known = outcome;
        }
    }
    let mut names: Vec<&str> = Vec::new();
    for Outcome { name, .. } in &compared.outcomes {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    for name in names {
        let found = best.get(name);
        let mut row = vec![name.to_owned(), number(found.map(|o| o.budget), 2)];
        row.push(number(found.and_then(|o| o.seconds()), 1));
        row.extend(scores(&found.map_or_else(Mean::default, |o| o.metrics.mean.clone())));
        table.rows.push(row);
    }
    Some(table)
}

fn stages(compared: &Compared) -> Table {
    let title = format!("{}: seconds by stage", compared.capture);
    let note =
        "Per frame after the first, the longest stage first; stages of one frame may run beside each other.";
    let mut table = Table::new(title, note, &["method", "s per frame", "stages"]);
    for outcome in &compared.outcomes {
        let later: Vec<_> = outcome.metrics.frames.iter().filter(|frame| frame.frame > 0).collect();
        let mut sums = BTreeMap::<&str, f64>::new();
        for (stage, seconds) in later.iter().flat_map(|frame| &frame.log.seconds) {
            *sums.entry(stage).or_default() += seconds / later.len() as f64;
        }
        sums.remove("wall");
        let mut sums: Vec<(&str, f64)> = sums.into_iter().collect();
        sums.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(b.0)));
        let text: Vec<String> = sums.iter().map(|(stage, seconds)| format!("{stage} {seconds:.2}")).collect();
        table.rows.push(vec![outcome.title(), number(outcome.seconds(), 2), text.join(", ")]);
    }
    table
}

fn storage(compared: &Compared) -> Table {
    let note = "Of the files that reproduce a frame, in the method's own form where it has one. Gaussians: after the last frame.";
    let title = format!("{}: storage", compared.capture);
    let mut table = Table::new(title, note, &["method", "MB per frame", "with the first", "Gaussians"]);
    for outcome in &compared.outcomes {
        let mean = &outcome.metrics.mean;
        let mb = |bytes: Option<f64>| number(bytes.map(|bytes| bytes / 1e6), 3);
        let last = outcome.metrics.frames.last().map(|f| (f.static_gaussians + f.dynamic_gaussians) as f64);
        let row = [mb(mean.bytes_per_frame), mb(mean.bytes_per_frame_with_first), number(last, 0)];
        table.rows.push([vec![outcome.title()], row.to_vec()].concat());
    }
    table
}

fn preparation(all: &[Compared]) -> Table {
    let note = "What comes before the frames that are compared. Masks and tracks are the captures': how long they took is not known here.";
    let mut table = Table::new("Preparation".into(), note, &["capture", "first frame, s", "Gaussians", "MB"]);
    for compared in all {
        let first = compared.first.as_ref().and_then(|metrics| metrics.frames.first());
        let row = [
            number(first.and_then(|f| f.log.seconds.get(stage::WALL).copied()), 1),
            number(first.map(|f| (f.static_gaussians + f.dynamic_gaussians) as f64), 0),
            number(first.map(|f| f.bytes as f64 / 1e6), 2),
        ];
        table.rows.push([vec![compared.capture.clone()], row.to_vec()].concat());
    }
    table
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use ffgs_pipeline::outputs::record::ViewMetrics;

    pub(in super::super) fn outcome(name: &str, budget: f64, psnr: f64, seconds: f64) -> Outcome {
        let frame = |frame| {
            let views = vec![ViewMetrics { psnr, ssim: 0.5, ..ViewMetrics::default() }];
            let mut record = FrameRecord { frame, views, bytes: 2_000_000, ..FrameRecord::default() };
            record.log.seconds.insert("wall".into(), seconds);
            record.log.seconds.insert("training".into(), seconds / 2.0);
            record
        };
        let metrics = Metrics::of((0..3).map(frame).collect());
        Outcome { name: name.into(), budget, metrics, stopped: None }
    }

    fn compared() -> Compared {
        let mut failed = outcome("queen", 1.0, 0.0, 0.0);
        (failed.metrics, failed.stopped) = (Metrics::default(), Some("it diverged".into()));
        let outcomes = vec![
            outcome("trackers", 1.0, 25.0, 2.0),
            outcome("hicom", 0.1, 20.0, 0.5),
            outcome("hicom", 0.4, 21.0, 2.05),
            outcome("hicom", 1.0, 22.0, 5.0),
            failed,
        ];
        Compared { capture: "rain".into(), first: None, outcomes }
    }

    #[test]
    fn a_run_that_failed_is_a_row_that_says_so() {
        let table = quality(&compared());
        assert_eq!(table.rows[0][..3], ["trackers", "25.00", "0.5000"]);
        assert_eq!(table.rows[2][0], "hicom x 0.4");
        assert_eq!((table.rows[0][14].as_str(), table.rows[4][14].as_str()), ("2", "0"));
        assert_eq!(table.rows[4].last().map(String::as_str), Some("stopped: it diverged"));
        assert!(table.rows.iter().all(|row| row.len() == table.head.len()));
    }

    #[test]
    fn processor_seconds_are_of_the_steps_between_frames_of_one_process() {
        let of = |counter: &[Option<f64>]| {
            let frame = |(frame, seconds): (usize, &Option<f64>)| FrameRecord {
                frame,
                processor_seconds: *seconds,
                ..FrameRecord::default()
            };
            let metrics = Metrics::of(counter.iter().enumerate().map(frame).collect());
            Outcome { name: "trackers".into(), budget: 1.0, metrics, stopped: None }.processor_seconds()
        };
        assert_eq!(of(&[Some(50.0), Some(53.0), Some(58.0)]), Some(4.0));
        assert_eq!(of(&[Some(50.0), Some(53.0), Some(2.0), Some(7.0)]), Some(4.0), "resumed before frame 2");
        assert_eq!(of(&[Some(50.0), None, Some(60.0), Some(66.0)]), Some(6.0), "no step across a gap");
        assert_eq!(of(&[Some(50.0), Some(2.0)]), None);
        assert_eq!((of(&[Some(50.0)]), of(&[])), (None, None));
        let mut compared = compared();
        compared.outcomes[0]
            .metrics
            .frames
            .iter_mut()
            .for_each(|f| f.processor_seconds = Some(3.0 * f.frame as f64));
        let table = quality(&compared);
        let column = table.head.iter().position(|name| name == "processor s").unwrap();
        assert_eq!([0, 1, 4].map(|row| table.rows[row][column].as_str()), ["3.0", "-", "-"]);
    }

    #[test]
    fn at_equal_seconds_each_method_has_its_largest_budget_within_ours() {
        let table = equal_seconds(&compared()).unwrap();
        let names: Vec<&str> = table.rows.iter().map(|row| row[0].as_str()).collect();
        assert_eq!(names, ["trackers", "hicom", "queen"]);
        assert_eq!(table.rows[1][1..4], ["0.40", "2.0", "21.00"]);
        assert_eq!(table.rows[2][1..4], ["-", "-", "-"]);
        assert!(table.rows.iter().all(|row| row.len() == table.head.len()));
    }

    #[test]
    fn stages_and_bytes_are_of_the_frames_after_the_first() {
        assert_eq!(stages(&compared()).rows[0][1..], ["2.00", "training 1.00"]);
        assert_eq!(storage(&compared()).rows[0][1..3], ["2.000", "2.000"]);
        assert_eq!(tables(&[compared(), compared()]).len(), 9);
    }
}
