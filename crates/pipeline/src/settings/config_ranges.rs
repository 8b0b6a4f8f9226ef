//! What each setting may be. One table; a key that it does not list is a finite number of at least 0.

use serde::Serialize;
use serde_json::Value;
use std::fmt;
use std::ops::Bound::{self, Excluded, Included, Unbounded};

/// Bounds of a number.
#[derive(Clone, Copy)]
struct Range(Bound<f64>, Bound<f64>);

const fn closed(least: f64, most: f64) -> Range {
    Range(Included(least), Included(most))
}
/// A logarithm or a divisor.
const POSITIVE: Range = Range(Excluded(0.0), Unbounded);
/// Where the table says nothing.
const NOT_NEGATIVE: Range = Range(Included(0.0), Unbounded);
const SHARE: Range = closed(0.0, 1.0);
/// Steps of Adam: beyond 1 a single step leaves every scene.
const RATE: Range = closed(0.0, 1.0);
/// A rate that decays geometrically, so that neither end may be 0.
const DECAYING_RATE: Range = Range(Excluded(0.0), Included(1.0));
/// Degrees of the spherical harmonics that are implemented.
const DEGREE: Range = closed(0.0, 3.0);
/// Pixels by which a mask is grown; the cost grows with them.
const DILATION: Range = closed(0.0, 1024.0);
/// Counts that take memory or time each.
const COUNT: Range = closed(1.0, 1e6);

/// Keys in the order of CONFIGURATION.md.
const RANGES: &[(&str, Range)] = &[
    // TOML holds whole numbers up to 2^63.
    ("seed", closed(0.0, (1_u64 << 62) as f64)),
    ("sky_face_size", closed(1.0, 2048.0)),
    ("first_frame.sh_degree", DEGREE),
    ("first_frame.position_rate", DECAYING_RATE),
    ("first_frame.position_rate_end", DECAYING_RATE),
    ("first_frame.scale_rate", RATE),
    ("first_frame.opacity_rate", RATE),
    ("first_frame.sh_rest_rate", RATE),
    ("first_frame.densify_span", SHARE),
    ("first_frame.coarse_until", SHARE),
    ("first_frame.cool_down", SHARE),
    ("first_frame.max_gaussians", closed(1.0, (1_u64 << 31) as f64)),
    ("first_frame.gaussians_per_pixel", POSITIVE),
    ("first_frame.floater_opacity", SHARE),
    ("first_frame.opacity_reset", SHARE),
    ("first_frame.sky_rate", RATE),
    ("first_frame.hidden_sky", SHARE),
    ("first_frame.dropout", closed(0.0, 0.9)),
    ("marking.dilation", DILATION),
    ("marking.slack_share", SHARE),
    ("marking.validation_share", SHARE),
    ("marking.shown_share", SHARE),
    ("marking.covering_alpha", SHARE),
    ("marking.loss_warning", SHARE),
    ("voronoi.k", closed(1.0, 1024.0)),
    ("voronoi.sigma", POSITIVE),
    ("association.min_transmittance", Range(Included(0.0), Excluded(1.0))),
    ("association.contributors", closed(0.0, 64.0)),
    ("triangulation.collinear_degrees", closed(0.0, 90.0)),
    ("triangulation.outlier_soft_px", POSITIVE),
    ("triangulation.outlier_cut_px", POSITIVE),
    ("triangulation.min_noise_px", POSITIVE),
    ("triangulation.max_residual_px", POSITIVE),
    ("triangulation.max_step", POSITIVE),
    ("fusion.correlation_inflation", POSITIVE),
    ("fusion.rigid.neighbours", COUNT),
    ("fusion.rigid.min_measured", COUNT),
    ("fusion.rigid.max_seeds", COUNT),
    ("fusion.rigid.blend", COUNT),
    ("fusion.rigid.correlated", POSITIVE),
    ("fusion.rigid.leave", POSITIVE),
    ("fusion.groups.cell", COUNT),
    ("fusion.groups.max_cells", COUNT),
    ("fusion.groups.min_cells", COUNT),
    ("fusion.groups.max_groups", COUNT),
    ("fusion.groups.sample", COUNT),
    ("fusion.groups.leave", POSITIVE),
    ("fusion.groups.reach", POSITIVE),
    ("fusion.groups.apart", POSITIVE),
    ("fusion.groups.patches", POSITIVE),
    ("alignment.pixels", COUNT),
    ("alignment.trackers", POSITIVE),
    ("densification.fraction", SHARE),
    ("densification.min_opacity", SHARE),
    ("birth.position_rate", DECAYING_RATE),
    ("birth.position_rate_end", DECAYING_RATE),
    ("birth.scale_rate", RATE),
    ("birth.opacity_rate", RATE),
    ("birth.sh0_rate", RATE),
    ("birth.sh_rest_rate", RATE),
    ("dynamic.settled", NOT_NEGATIVE),
    ("dynamic.natural_step", closed(0.0, 1.0)),
    ("dynamic.natural_step_end", DECAYING_RATE),
    ("dynamic.position_rate_px", DECAYING_RATE),
    ("dynamic.position_rate_end_px", DECAYING_RATE),
    ("dynamic.quat_rate", RATE),
    ("dynamic.scale_rate", RATE),
    ("dynamic.opacity_rate", RATE),
    ("dynamic.sh0_rate", RATE),
    ("dynamic.sh_rest_rate", RATE),
    ("dynamic.loss_dilation", DILATION),
    ("dynamic.outside_alpha", closed(0.0, 1e6)),
    ("background.every", COUNT),
    ("background.solve_degree", DEGREE),
    ("background.solve_noise", DECAYING_RATE),
    ("background.solve_sh0_change", POSITIVE),
    ("background.solve_sh_rest_change", POSITIVE),
    ("background.solve_in_view", SHARE),
    ("background.sh0_rate", RATE),
    ("background.sh_rest_rate", RATE),
    ("background.sky_rate", RATE),
    ("background.exposure_change", closed(0.0, 5.0)),
    ("background.mask_dilation", DILATION),
    ("disocclusion.every", COUNT),
    ("disocclusion.rounds", closed(0.0, 255.0)),
    ("disocclusion.position_rate", DECAYING_RATE),
    ("disocclusion.position_rate_end", DECAYING_RATE),
    ("disocclusion.scale_rate", RATE),
    ("disocclusion.opacity_rate", RATE),
    ("disocclusion.sh0_rate", RATE),
    ("disocclusion.sh_rest_rate", RATE),
    ("method.dynamic3dgs.position_rate", RATE),
    ("method.dynamic3dgs.quat_rate", RATE),
    ("method.dynamic3dgs.colour_rate", RATE),
    ("method.dynamic3dgs.neighbours", closed(0.0, 1024.0)),
    ("method.hicom.gaussians_per_cell", COUNT),
    ("method.hicom.levels", closed(1.0, 16.0)),
    ("method.hicom.level_ratio", closed(2.0, 1e6)),
    ("method.hicom.quantile", closed(0.0, 0.5)),
    ("method.hicom.motion.rate", RATE),
    ("method.hicom.motion.momentum", SHARE),
    ("method.hicom.added.prune_opacity", SHARE),
    ("method.hicom.added.position_rate", DECAYING_RATE),
    ("method.hicom.added.position_rate_end", DECAYING_RATE),
    ("method.hicom.added.quat_rate", RATE),
    ("method.hicom.added.scale_rate", RATE),
    ("method.hicom.added.opacity_rate", RATE),
    ("method.hicom.added.sh0_rate", RATE),
    ("method.queen.masked", SHARE),
    ("method.queen.mask_cell", COUNT),
    ("method.queen.gate_rate", RATE),
    ("method.queen.position_rate", DECAYING_RATE),
    ("method.queen.position_rate_end", DECAYING_RATE),
    ("method.queen.colour_rate", RATE),
    ("method.queen.colour_decoder_rate", RATE),
    ("method.queen.scale_rate", RATE),
    ("method.queen.scale_decoder_rate", RATE),
    ("method.queen.rotation_rate", RATE),
    ("method.queen.rotation_decoder_rate", RATE),
    ("method.queen.opacity_rate", RATE),
    ("method.queen.opacity_decoder_rate", RATE),
    ("method.queen.prune_opacity", SHARE),
    ("method.recongs.gaussians_per_anchor", COUNT),
    ("method.recongs.levels", closed(1.0, 16.0)),
    ("method.recongs.level_ratio", closed(2.0, 1e6)),
    ("method.recongs.renew_every", COUNT),
    ("method.recongs.motion.rate", RATE),
    ("method.recongs.motion.momentum", SHARE),
    ("method.recongs.added.prune_opacity", SHARE),
    ("method.recongs.added.position_rate", DECAYING_RATE),
    ("method.recongs.added.position_rate_end", DECAYING_RATE),
    ("method.recongs.added.quat_rate", RATE),
    ("method.recongs.added.scale_rate", RATE),
    ("method.recongs.added.opacity_rate", RATE),
    ("method.recongs.added.sh0_rate", RATE),
    ("method.trackersplat.position_rate", DECAYING_RATE),
    ("method.trackersplat.position_rate_end", DECAYING_RATE),
    ("method.trackersplat.quat_rate", RATE),
    ("method.trackersplat.scale_rate", RATE),
    ("method.trackersplat.opacity_rate", RATE),
    ("method.trackersplat.sh0_rate", RATE),
];

/// The settings outside their ranges, each with its key, value and range; none for a configuration that can be run.
pub(crate) fn faults(settings: &impl Serialize) -> Vec<String> {
    // Only maps of texts, numbers and lists: nothing that JSON cannot hold but NaN and infinity, which become null.
    let values = serde_json::to_value(settings).unwrap_or_default();
    let mut faults = Vec::new();
    leaves("", &values, &mut |key, value| faults.extend(fault(key, value)));
    faults
}

/// Calls `visit` with the dotted key of every value that is no map.
pub(crate) fn leaves<'a>(at: &str, value: &'a Value, visit: &mut dyn FnMut(&str, &'a Value)) {
    match value {
        Value::Object(map) => map.iter().for_each(|(key, value)| {
            let key = if at.is_empty() { key.clone() } else { format!("{at}.{key}") };
            leaves(&key, value, visit);
        }),
        leaf => visit(at, leaf),
    }
}

fn fault(key: &str, value: &Value) -> Option<String> {
    match value {
        Value::Array(items) => items.iter().find_map(|item| fault(key, item)),
        Value::Null => {
            let way_out = "a number so large that it never matters, such as 1e9, stands for no limit";
            Some(format!("{key}: NaN and infinity are no settings; {way_out}"))
        }
        number => {
            let range = RANGES.iter().find(|(k, _)| *k == key).map_or(NOT_NEGATIVE, |(_, range)| *range);
            number.as_f64().filter(|n| !range.holds(*n)).map(|_| format!("{key} = {number}: must be {range}"))
        }
    }
}

impl Range {
    fn holds(&self, value: f64) -> bool {
        std::ops::RangeBounds::contains(&(self.0, self.1), &value)
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Included(least) => write!(f, "at least {least}")?,
            Excluded(least) => write!(f, "above {least}")?,
            Unbounded => {}
        }
        match self.1 {
            Included(most) => write!(f, " and at most {most}"),
            Excluded(most) => write!(f, " and below {most}"),
            Unbounded => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::config::Config;
    use std::collections::BTreeSet;

    fn of(text: &str) -> Vec<String> {
        faults(&toml::from_str::<Config>(text).unwrap())
    }

    #[test]
    fn the_defaults_are_in_range_and_every_range_is_of_a_key() {
        assert_eq!(faults(&Config::default()), [""; 0]);
        assert_eq!(faults(&Config::literal()), [""; 0]);
        let values = serde_json::to_value(Config::default()).unwrap();
        let mut keys = BTreeSet::new();
        leaves("", &values, &mut |key, _| {
            keys.insert(key.to_owned());
        });
        let unknown: Vec<_> = RANGES.iter().filter(|(key, _)| !keys.contains(*key)).map(|r| r.0).collect();
        assert_eq!(unknown, [""; 0]);
    }

    /// Each of these made a run panic, abort or write NaN, or was found only after the first frame had been trained.
    #[test]
    fn what_cannot_be_run_is_refused_with_key_value_and_range() {
        for (text, fault) in [
            ("sky_face_size = 0", "sky_face_size = 0: must be at least 1 and at most 2048"),
            ("sky_face_size = 4294967296", "sky_face_size = 4294967296: must"),
            ("first_frame.sh_degree = 4", "first_frame.sh_degree = 4: must be at least 0 and at most 3"),
            ("first_frame.position_rate_end = 0.0", "first_frame.position_rate_end = 0.0: must be above 0"),
            ("dynamic.position_rate_end_px = 0", "dynamic.position_rate_end_px = 0.0: must be above 0"),
            ("dynamic.position_rate_px = -1", "dynamic.position_rate_px = -1.0: must"),
            ("dynamic.sh0_rate = inf", "dynamic.sh0_rate: NaN and infinity"),
            ("dynamic.outside_alpha = nan", "dynamic.outside_alpha: NaN and infinity"),
            ("background.sky_rate = nan", "background.sky_rate: NaN and infinity"),
            ("triangulation.max_step = inf", "triangulation.max_step: NaN and infinity"),
            ("voronoi.k = 0", "voronoi.k = 0: must be at least 1"),
            ("voronoi.sigma = 0.0", "voronoi.sigma = 0.0: must be above 0"),
            ("background.solve_degree = 1000000", "background.solve_degree = 1000000: must"),
            ("densification.fraction = -1.0", "densification.fraction = -1.0: must"),
            ("densification.fraction = nan", "densification.fraction: NaN"),
            ("first_frame.densify_span = [0.1, 7.0]", "first_frame.densify_span = 7.0: must"),
            (
                "association.contributors = 65",
                "association.contributors = 65: must be at least 0 and at most 64",
            ),
            ("association.min_transmittance = 1.0", "at least 0 and below 1"),
            ("fusion.gate = -1.0", "fusion.gate = -1.0: must be at least 0"),
        ] {
            let found = of(text);
            assert!(found.len() == 1 && found[0].contains(fault), "{text}: {found:?}");
        }
    }
}
