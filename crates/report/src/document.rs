//! Pages and curves beside those of a run.

use crate::page::STYLE;
use crate::plot::{Labels, Series, svg};

/// A line through points.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// In the legend.
    pub name: String,
    /// Drawn thicker.
    pub bold: bool,
    /// (x, y), in the order of drawing.
    pub points: Vec<(f64, f64)>,
}

/// Curves over one pair of axes, as inline SVG with a legend.
pub fn curves(x: &str, y: &str, curves: &[Curve]) -> String {
    let series = |curve: &Curve| Series {
        name: curve.name.clone(),
        bold: curve.bold,
        points: curve.points.iter().map(|&(x, y)| (x, Some(y))).collect(),
    };
    svg(&Labels { x, y, ticks: None }, &curves.iter().map(series).collect::<Vec<_>>())
}

/// A page of one file in the style of the report, which needs no network. `body` is HTML.
pub fn document(title: &str, body: &str) -> String {
    let title = title.replace('&', "&amp;").replace('<', "&lt;");
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_holds_its_curves() {
        let curve = Curve { name: "one".into(), bold: true, points: vec![(0.5, 20.0), (2.0, 25.0)] };
        let page = document("a < b", &curves("s", "PSNR (dB)", &[curve]));
        assert!(page.contains("<title>a &lt; b</title>") && page.contains("<svg") && page.contains("one"));
        assert!(page.contains("s 0.5: 20.000"), "points say their values: {page}");
    }
}
