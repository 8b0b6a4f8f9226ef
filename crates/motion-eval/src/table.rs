//! The table of scores as text.

use crate::score::Summary;
use std::fmt::Write as _;

/// One line of the table.
#[derive(Clone, Debug)]
pub struct Row {
    /// What was scored.
    pub name: String,
    /// Gaussians that could have been measured.
    pub candidates: usize,
    /// Its errors.
    pub summary: Summary,
}

/// Text with one line per row: share measured, errors, calibration.
pub fn table(rows: &[Row]) -> String {
    let mut out = format!(
        "{:<34} {:>7} {:>6} {:>8} {:>8} {:>9} {:>9} {:>6} {:>6} {:>6}\n",
        "", "count", "share", "med cm", "p95 cm", "NEES med", "NEES avg", "in 50%", "in 90%", "in 99%"
    );
    for row in rows {
        let s = &row.summary;
        let share = 100.0 * s.count as f64 / row.candidates.max(1) as f64;
        let inside = |p| format!("{:.0} %", 100.0 * s.coverage_at(p).unwrap_or(0.0));
        // Writing into a String cannot fail.
        let _ = writeln!(
            out,
            "{:<34} {:>7} {:>4.0} % {:>8.2} {:>8.2} {:>9.2} {:>9.1} {:>6} {:>6} {:>6}",
            row.name,
            s.count,
            share,
            s.median_cm,
            s.p95_cm,
            s.nees_median,
            s.nees_mean,
            inside(0.5),
            inside(0.9),
            inside(0.99)
        );
    }
    out
}
