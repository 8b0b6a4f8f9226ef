//! The paper's timing table.

use crate::FrameReport;
use ffgs_core::stage;
use serde::Serialize;
use std::collections::BTreeSet;

#[derive(Debug, Serialize)]
pub(crate) struct Row {
    pub label: String,
    pub lane: &'static str,
    pub mean: String,
    pub range: String,
    pub paper: &'static str,
    /// Share of the longest row, percent: the bar's width.
    pub bar: f64,
    pub is_total: bool,
}

/// A row, and the stages that it sums.
struct Stage {
    label: &'static str,
    lane: &'static str,
    paper: &'static str,
    is_total: bool,
    names: &'static [&'static str],
}

const fn row_of(label: &'static str, paper: &'static str, names: &'static [&'static str]) -> Stage {
    Stage { label, lane: "dynamic", paper, is_total: false, names }
}

const fn total(
    label: &'static str,
    lane: &'static str,
    paper: &'static str,
    names: &'static [&'static str],
) -> Stage {
    Stage { label, lane, paper, is_total: true, names }
}

/// The stages of the dynamic lane.
const DYNAMIC: [&str; 12] = [
    stage::LOAD,
    stage::VORONOI,
    stage::AGREEMENT,
    stage::ASSOCIATION,
    stage::TRIANGULATION,
    stage::ALIGNMENT,
    stage::FUSION,
    stage::VALIDATION,
    stage::GROWTH,
    stage::BIRTH,
    stage::DYNAMIC,
    stage::INFORMATION,
];

/// Seconds of the paper: its table for Monaco4D, one GPU per lane.
const STAGES: [Stage; 17] = [
    row_of("Load", "< 0.1", &[stage::LOAD]),
    row_of("Voronoi densification", "0.5", &[stage::VORONOI]),
    row_of("Agreement", "< 0.1", &[stage::AGREEMENT]),
    row_of("Association", "–", &[stage::ASSOCIATION]),
    row_of("Triangulation", "0.2", &[stage::TRIANGULATION]),
    row_of("Alignment", "–", &[stage::ALIGNMENT]),
    row_of("Fusion", "0.15", &[stage::FUSION]),
    row_of("Validation", "–", &[stage::VALIDATION]),
    row_of("Growth", "–", &[stage::GROWTH]),
    row_of("Birth", "–", &[stage::BIRTH]),
    row_of("Finetuning", "~ 9.5", &[stage::DYNAMIC]),
    row_of("Information", "–", &[stage::INFORMATION]),
    total("Dynamic lane", "dynamic", "~ 10.5", &DYNAMIC),
    total("Static lane (SH only)", "static", "~ 25", &[stage::STATIC]),
    row_of("Disocclusion", "–", &[stage::DISOCCLUSION]),
    total("Sky lane", "sky", "~ 1", &[stage::SKY]),
    total("Wall clock", "all", "~ 25", &[stage::WALL]),
];

/// Seconds of each frame in these stages, for frames that have any.
fn column(frames: &[FrameReport], names: &[&str]) -> Vec<f64> {
    let of =
        |f: &FrameReport| names.iter().filter_map(|name| f.seconds.get(*name).copied()).reduce(|a, b| a + b);
    frames.iter().filter_map(of).collect()
}

/// One row per stage: mean over the frames after the first (which is trained from scratch), least and most. Stages that
/// the paper does not have follow by name.
pub(crate) fn rows(frames: &[FrameReport]) -> Vec<Row> {
    let later = frames.get(1..).filter(|f| !f.is_empty()).unwrap_or(frames);
    let known = |name: &&str| STAGES.iter().any(|stage| stage.names.contains(name));
    let others: BTreeSet<&str> = later.iter().flat_map(|f| f.seconds.keys().map(String::as_str)).collect();
    let others = others.into_iter().filter(|name| !known(name));
    let mut rows: Vec<Row> = STAGES.iter().map(|stage| row(stage, &column(later, stage.names))).collect();
    rows.extend(others.map(|name| own_row(name, &column(later, &[name]))));
    let longest = rows.iter().map(|row| row.bar).fold(1e-9, f64::max);
    rows.iter_mut().for_each(|row| row.bar *= 100.0 / longest);
    rows
}

/// The bar is as long as the mean (s).
fn row(stage: &Stage, column: &[f64]) -> Row {
    let mean = mean(column);
    Row {
        label: stage.label.to_owned(),
        lane: stage.lane,
        mean: mean.map_or_else(|| "–".to_owned(), seconds_text),
        range: range_text(column),
        paper: stage.paper,
        bar: mean.unwrap_or(0.0),
        is_total: stage.is_total,
    }
}

/// A stage of the method's own.
fn own_row(name: &str, column: &[f64]) -> Row {
    Row { label: name.to_owned(), ..row(&row_of("", "–", &[]), column) }
}

/// Mean of the values; `None` without any.
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
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
