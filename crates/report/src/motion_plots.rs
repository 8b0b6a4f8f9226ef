//! The motion initialisation against ground truth: its errors, and the calibration of its covariances.

use crate::MotionAccuracy;
use crate::plot::{Labels, Series, svg};

/// Error histogram and calibration curve; nothing without estimates.
pub(crate) fn motion_plots(motion: &[MotionAccuracy]) -> Vec<String> {
    let Some(first) = motion.first() else { return Vec::new() };
    vec![histogram(motion, &bin_names(&first.bins_cm)), calibration(motion)]
}

fn series(m: &MotionAccuracy, points: impl Iterator<Item = (f64, f64)>) -> Series {
    let points = points.map(|(x, y)| (x, Some(100.0 * y))).collect();
    Series { name: m.name.clone(), bold: m.name == "fused", points }
}

fn histogram(motion: &[MotionAccuracy], names: &[String]) -> String {
    let of = |m: &MotionAccuracy| series(m, m.shares.iter().enumerate().map(|(i, &s)| (i as f64, s)));
    let all: Vec<Series> = motion.iter().map(of).collect();
    svg(&Labels { x: "3D end-point error (cm)", y: "share of estimates (%)", ticks: Some(names) }, &all)
}

/// On the diagonal when covariances say how large the errors are; below it when they are too sure.
fn calibration(motion: &[MotionAccuracy]) -> String {
    let diagonal = Series {
        name: "calibrated".into(),
        bold: false,
        points: vec![(0.0, Some(0.0)), (100.0, Some(100.0))],
    };
    let of = |m: &MotionAccuracy| series(m, m.calibration.iter().map(|&(p, share)| (100.0 * p, share)));
    let all: Vec<Series> = motion.iter().map(of).chain([diagonal]).collect();
    let labels =
        Labels { x: "ellipsoid's nominal probability (%)", y: "truth inside the ellipsoid (%)", ticks: None };
    svg(&labels, &all)
}

/// `0-1`, `1-2`, ..., `> 64`.
fn bin_names(ends: &[f64]) -> Vec<String> {
    let mut low = 0.0;
    let mut names: Vec<String> = Vec::new();
    for &end in ends {
        names.push(format!("{low}-{end}"));
        low = end;
    }
    names.push(format!("> {low}"));
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accuracy(name: &str) -> MotionAccuracy {
        MotionAccuracy {
            name: name.into(),
            bins_cm: vec![1.0],
            shares: vec![0.75, 0.25],
            calibration: vec![(0.5, 0.4), (0.9, 0.8)],
            ..MotionAccuracy::default()
        }
    }

    #[test]
    fn bins_are_named_and_every_estimate_has_a_curve() {
        assert_eq!(bin_names(&[1.0, 2.5]), ["0-1", "1-2.5", "> 2.5"]);
        let plots = motion_plots(&[accuracy("a"), accuracy("fused")]);
        assert_eq!(plots.len(), 2);
        assert!(plots[0].contains("fused") && plots[0].contains("&gt; 1") && plots[1].contains("calibrated"));
        assert!(motion_plots(&[]).is_empty());
    }

    /// The axes lie from 62 to 546 px and, upwards, from 206 to 14 px.
    #[test]
    fn curves_go_through_the_values() {
        let plots = motion_plots(&[accuracy("fused")]);
        // Shares of 75 and 25 % between ticks at 20 and 80 %.
        assert!(plots[0].contains("d=\"M62.0 30.0L546.0 190.0\""), "{}", plots[0]);
        // The diagonal spans both axes from 0 to 100 %; (50, 40) and (90, 80) lie below it.
        assert!(plots[1].contains("d=\"M62.0 206.0L546.0 14.0\""), "{}", plots[1]);
        assert!(plots[1].contains("d=\"M304.0 129.2L497.6 52.4\""), "{}", plots[1]);
    }
}
