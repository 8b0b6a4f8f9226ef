//! The tables and the curves of quality against seconds, as one page.

use super::results::{Compared, Outcome};
use super::table::{Table, html as table_html};
use ffgs_pipeline::outputs::record::Mean;
use ffgs_report::{Curve, curves, document};

type Score = fn(&Mean) -> Option<f64>;

const PLOTS: [(&str, Score); 4] = [
    ("PSNR (dB)", |mean| mean.psnr),
    ("MPSNR (dB)", |mean| mean.mpsnr),
    ("SSIM", |mean| mean.ssim),
    ("VMAF", |mean| mean.vmaf),
];

/// A self-contained page.
pub(super) fn html(tables: &[Table], all: &[Compared]) -> String {
    let mut body = String::from("<h1>Comparison of methods</h1>");
    for compared in all {
        body += &plots(compared);
    }
    tables.iter().for_each(|table| body += &table_html(table));
    document("Comparison of methods", &body)
}

fn plots(compared: &Compared) -> String {
    let mut out = format!("<h2>{}: quality against seconds</h2>", compared.capture.replace('<', "&lt;"));
    out += "<p class=\"note\">A point per budget; means over the frames after the first.</p><div class=\"plots\">";
    for (y, score) in PLOTS {
        let drawn = methods(compared).map(|(name, runs)| Curve {
            name: name.to_owned(),
            bold: name == "trackers",
            points: points(&runs, score),
        });
        let drawn: Vec<Curve> = drawn.filter(|curve| !curve.points.is_empty()).collect();
        if !drawn.is_empty() {
            out = out + "<div>" + &curves("s per frame", y, &drawn) + "</div>";
        }
    }
    out + "</div>"
}

/// The runs of each method, in the order of the tables.
fn methods(compared: &Compared) -> impl Iterator<Item = (&str, Vec<&Outcome>)> {
    let all = &compared.outcomes;
    let first = all.iter().enumerate().filter(|(i, run)| all[..*i].iter().all(|o| o.name != run.name));
    first.map(|(_, run)| (run.name.as_str(), all.iter().filter(|other| other.name == run.name).collect()))
}

fn points(runs: &[&Outcome], score: Score) -> Vec<(f64, f64)> {
    let point = |run: &&Outcome| Some((run.seconds()?, score(&run.metrics.mean)?));
    let mut points: Vec<(f64, f64)> = runs.iter().filter_map(point).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

#[cfg(test)]
mod tests {
    use super::super::results::tests::outcome;
    use super::*;

    #[test]
    fn a_curve_per_method_in_the_order_of_seconds_and_none_for_what_was_not_measured() {
        let outcomes = vec![
            outcome("queen", 1.0, 25.0, 4.0),
            outcome("hicom", 1.0, 20.0, 3.0),
            outcome("queen", 0.1, 21.0, 1.0),
        ];
        let compared = Compared { capture: "a < b".into(), first: None, outcomes };
        let runs: Vec<_> = methods(&compared).collect();
        assert_eq!((runs[0].0, runs[1].0, runs.len()), ("queen", "hicom", 2));
        assert_eq!(points(&runs[0].1, PLOTS[0].1), [(1.0, 21.0), (4.0, 25.0)]);
        let page = html(&[], &[compared]);
        assert!(page.contains("PSNR (dB)") && page.contains("a &lt; b") && !page.contains("VMAF"), "{page}");
    }
}
