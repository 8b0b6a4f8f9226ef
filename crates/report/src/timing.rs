//! The paper's timing table.

use crate::{FrameReport, StageSeconds};
use serde::Serialize;

#[derive(Debug, Serialize)]
pub struct Row {
    pub label: &'static str,
    pub lane: &'static str,
    pub mean: String,
    pub range: String,
    pub paper: &'static str,
    /// Share of the longest row, percent: the bar's width.
    pub bar: f64,
    pub is_total: bool,
}

struct Stage {
    label: &'static str,
    lane: &'static str,
    paper: &'static str,
    is_total: bool,
    seconds: fn(&StageSeconds) -> Option<f64>,
}

const fn stage(
    label: &'static str,
    lane: &'static str,
    paper: &'static str,
    seconds: fn(&StageSeconds) -> Option<f64>,
) -> Stage {
    Stage { label, lane, paper, is_total: false, seconds }
}

const fn total(
    label: &'static str,
    lane: &'static str,
    paper: &'static str,
    seconds: fn(&StageSeconds) -> Option<f64>,
) -> Stage {
    Stage { label, lane, paper, is_total: true, seconds }
}

/// Seconds of the paper: its table for Monaco4D, one GPU per lane.
const STAGES: [Stage; 12] = [
    stage("Load", "dynamic", "< 0.1", |s| s.load),
    stage("Voronoi densification", "dynamic", "0.5", |s| s.voronoi),
    stage("Agreement", "dynamic", "< 0.1", |s| s.agreement),
    stage("Association", "dynamic", "–", |s| s.association),
    stage("Triangulation", "dynamic", "0.2", |s| s.triangulation),
    stage("Fusion", "dynamic", "0.15", |s| s.fusion),
    stage("Validation", "dynamic", "–", |s| s.validation),
    stage("Finetuning", "dynamic", "~ 9.5", |s| s.dynamic),
    total("Dynamic lane", "dynamic", "~ 10.5", dynamic_total),
    total("Static lane (SH only)", "static", "~ 25", |s| s.static_lane),
    total("Sky lane", "sky", "~ 1", |s| s.sky),
    total("Wall clock", "all", "~ 25", |s| s.wall),
];

fn dynamic_total(s: &StageSeconds) -> Option<f64> {
    let stages =
        [s.load, s.voronoi, s.agreement, s.association, s.triangulation, s.fusion, s.validation, s.dynamic];
    stages.into_iter().flatten().reduce(|a, b| a + b)
}

/// One row per stage: mean over the frames after the first (which is trained from scratch), least and most.
pub fn rows(frames: &[FrameReport]) -> Vec<Row> {
    let later = frames.get(1..).filter(|f| !f.is_empty()).unwrap_or(frames);
    let columns = STAGES.map(|stage| later.iter().filter_map(|f| (stage.seconds)(&f.seconds)).collect());
    let means = columns.each_ref().map(|column: &Vec<f64>| mean(column));
    let longest = means.iter().flatten().copied().fold(1e-9, f64::max);
    let row = |((stage, column), mean): ((&Stage, &Vec<f64>), &Option<f64>)| Row {
        label: stage.label,
        lane: stage.lane,
        mean: mean.map_or_else(|| "–".to_owned(), seconds_text),
        range: range_text(column),
        paper: stage.paper,
        bar: mean.map_or(0.0, |m| 100.0 * m / longest),
        is_total: stage.is_total,
    };
    STAGES.iter().zip(&columns).zip(&means).map(row).collect()
}

/// Mean of the values; `None` without any.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn range_text(column: &[f64]) -> String {
    let least = column.iter().copied().reduce(f64::min);
    let most = column.iter().copied().reduce(f64::max);
    match (least, most) {
        (Some(least), Some(most)) => format!("{} – {}", seconds_text(least), seconds_text(most)),
        _ => String::new(),
    }
}

/// Three significant digits, as far as a second's thousandths go.
fn seconds_text(seconds: f64) -> String {
    match seconds {
        s if s < 1.0 => format!("{s:.3}"),
        s if s < 10.0 => format!("{s:.2}"),
        s => format!("{s:.1}"),
    }
}
