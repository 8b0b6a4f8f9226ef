//! Line plots as inline SVG.

use std::fmt::Write as _;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 250.0;
const LEFT: f64 = 62.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 44.0;
const TICKS: usize = 5;
/// Told apart by colour-blind readers too (Okabe and Ito).
const COLOURS: [&str; 8] =
    ["#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#666666"];

pub(crate) struct Series {
    pub name: String,
    /// Drawn thicker: what the eye should follow.
    pub bold: bool,
    /// (x, value); a gap where there is no value.
    pub points: Vec<(f64, Option<f64>)>,
}

/// What a plot says beside its axes.
pub(crate) struct Labels<'a> {
    pub x: &'a str,
    pub y: &'a str,
    /// Text at x = 0, 1, ... instead of numbers.
    pub ticks: Option<&'a [String]>,
}

/// Values over frames.
pub(crate) fn over_frames(y: &str, series: &[Series]) -> String {
    svg(&Labels { x: "frame", y, ticks: None }, series)
}

/// Inline SVG with axes, ticks, labels; the legend is HTML below it.
pub(crate) fn svg(labels: &Labels, series: &[Series]) -> String {
    let axes = Axes::around(series, labels.ticks.is_some() || labels.x == "frame");
    let mut out =
        format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">", escape(labels.y));
    axes.draw(&mut out, labels);
    for (i, s) in series.iter().enumerate() {
        axes.draw_series(&mut out, labels.x, s, COLOURS[i % COLOURS.len()]);
    }
    out += "</svg><div class=\"legend\">";
    for (i, s) in series.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        // Writing into a String cannot fail.
        let _ = write!(out, "<span><i style=\"background:{colour}\"></i>{}</span>", escape(&s.name));
    }
    out + "</div>"
}

struct Axes {
    x: [f64; 2],
    y: [f64; 2],
    y_step: f64,
    x_step: f64,
}

impl Axes {
    fn around(series: &[Series], whole: bool) -> Self {
        let points = || series.iter().flat_map(|s| &s.points);
        let [x_low, x_high] = bounds(points().map(|p| p.0));
        let [y_low, y_high] = bounds(points().filter_map(|p| p.1));
        let x_step = nice_step(x_high - x_low).max(if whole { 1.0 } else { 0.0 });
        let y_step = nice_step(y_high - y_low);
        let y = [(y_low / y_step).floor() * y_step, (y_high / y_step).ceil() * y_step];
        Self { x: [x_low, x_high], y, y_step, x_step }
    }

    fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let share = |v: f64, [low, high]: [f64; 2]| (v - low) / (high - low);
        (
            LEFT + share(x, self.x) * (WIDTH - LEFT - RIGHT),
            HEIGHT - BOTTOM - share(y, self.y) * (HEIGHT - TOP - BOTTOM),
        )
    }

    fn draw(&self, out: &mut String, labels: &Labels) {
        let right = WIDTH - RIGHT;
        for y in steps(self.y, self.y_step) {
            let at = self.at(self.x[0], y).1;
            let text = tick_text(y, self.y_step);
            let _ = write!(out, "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{right}\"/>");
            let _ = write!(
                out,
                "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>",
                LEFT - 6.0,
                at + 4.0
            );
        }
        let bottom = HEIGHT - BOTTOM;
        for (x, text) in self.x_ticks(labels.ticks) {
            let (at, text) = (self.at(x, self.y[0]).0, escape(&text));
            let y = bottom + 16.0;
            let _ = write!(out, "<text x=\"{at:.1}\" y=\"{y}\" text-anchor=\"middle\">{text}</text>");
        }
        let _ = write!(out, "<path class=\"axis\" d=\"M{LEFT} {TOP}V{bottom}H{right}\"/>");
        let middle = [f64::midpoint(LEFT, right), f64::midpoint(TOP, bottom)];
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            middle[0],
            HEIGHT - 8.0,
            escape(labels.x)
        );
        let _ = write!(
            out,
            "<text transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            middle[1],
            escape(labels.y)
        );
    }

    fn x_ticks(&self, named: Option<&[String]>) -> Vec<(f64, String)> {
        match named {
            Some(names) => names.iter().enumerate().map(|(i, name)| (i as f64, name.clone())).collect(),
            None => steps(self.x, self.x_step).map(|x| (x, tick_text(x, self.x_step))).collect(),
        }
    }

    fn draw_series(&self, out: &mut String, x_label: &str, series: &Series, colour: &str) {
        let mut path = String::new();
        let mut dots = String::new();
        let mut pen_down = false;
        for &(x, y) in &series.points {
            let Some(y) = y.filter(|y| y.is_finite()) else {
                pen_down = false;
                continue;
            };
            let (px, py) = self.at(x, y);
            let _ = write!(path, "{}{px:.1} {py:.1}", if pen_down { 'L' } else { 'M' });
            let title = format!("{}, {} {x}: {}", escape(&series.name), escape(x_label), significant(y));
            let _ = write!(
                dots,
                "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"2.6\"><title>{title}</title></circle>"
            );
            pen_down = true;
        }
        let class = if series.bold { "line bold" } else { "line" };
        let _ = write!(
            out,
            "<path class=\"{class}\" stroke=\"{colour}\" d=\"{path}\"/><g fill=\"{colour}\">{dots}</g>"
        );
    }
}

/// Range of the finite values, never empty.
fn bounds(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let grow = |b: Option<[f64; 2]>, v: f64| Some(b.map_or([v, v], |[l, h]| [l.min(v), h.max(v)]));
    match values.filter(|v| v.is_finite()).fold(None, grow) {
        None => [0.0, 1.0],
        Some([low, high]) if high - low > 1e-9 * high.abs() => [low, high],
        Some([low, _]) => {
            let pad = if low == 0.0 { 0.5 } else { 0.02 * low.abs() };
            [low - pad, low + pad]
        }
    }
}

/// 1, 2 or 5 times a power of ten: about [`TICKS`] of them in `range`.
fn nice_step(range: f64) -> f64 {
    let rough = range / TICKS as f64;
    let power = 10f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|f| f * power >= rough).unwrap_or(10.0);
    factor * power
}

fn steps([low, high]: [f64; 2], step: f64) -> impl Iterator<Item = f64> {
    let first = (low / step - 1e-6).ceil();
    let count = ((high / step + 1e-6).floor() - first).clamp(0.0, 100.0) as usize;
    (0..=count).map(move |i| (first + i as f64) * step)
}

fn tick_text(value: f64, step: f64) -> String {
    let thousands = step >= 1000.0;
    let (value, step) = if thousands { (value / 1000.0, step / 1000.0) } else { (value, step) };
    let decimals = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}{}", if thousands && value > 0.0 { "k" } else { "" })
}

fn significant(value: f64) -> String {
    if value.abs() >= 1000.0 { format!("{value:.0}") } else { format!("{value:.3}") }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_cover_the_range() {
        assert_eq!(nice_step(4.3), 1.0);
        assert_eq!(nice_step(0.09), 0.02);
        assert_eq!(steps([20.0, 24.0], 1.0).count(), 5);
        assert_eq!((tick_text(25000.0, 5000.0), tick_text(0.9, 0.05)), ("25k".into(), "0.90".into()));
    }

    #[test]
    fn nothing_constant_or_infinite_breaks_a_plot() {
        for values in
            [vec![], vec![None], vec![Some(3.0); 2], vec![Some(f64::INFINITY), Some(1.0), Some(f64::NAN)]]
        {
            let points = values.into_iter().enumerate().map(|(i, v)| (i as f64, v)).collect();
            let text = over_frames("a < b", &[Series { name: "x".into(), bold: false, points }]);
            assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
        }
    }
}
