//! Curves as inline SVG.

use std::fmt::Write;

/// Points under one name.
pub struct Series {
    pub name: String,
    pub points: Vec<(f64, f64)>,
}

/// What a plot shows.
pub struct Plot<'a> {
    pub title: &'a str,
    pub x_label: &'a str,
    pub y_label: &'a str,
    /// Whether y goes by its decimal logarithm.
    pub log_y: bool,
    pub series: Vec<Series>,
}

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 320.0;
/// Room for labels: left, right, top, bottom.
const MARGINS: [f64; 4] = [62.0, 16.0, 30.0, 44.0];
/// Told apart with most kinds of colour blindness (Okabe and Ito).
const COLOURS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const TICKS: usize = 5;

impl Plot<'_> {
    /// The drawing. Points that are not finite, or not above zero on a logarithmic axis, are left out.
    pub fn to_svg(&self) -> String {
        let value = |y: f64| if self.log_y { y.log10() } else { y };
        let lines: Vec<Vec<(f64, f64)>> = (self.series.iter())
            .map(|series| {
                series.points.iter().map(|&(x, y)| (x, value(y))).filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
            })
            .collect();
        let all = || lines.iter().flatten();
        let (x_min, x_max) = range(all().map(|point| point.0));
        let (y_min, y_max) = range(all().map(|point| point.1));
        let [left, right, top, bottom] = MARGINS;
        let at_x = |x: f64| left + (x - x_min) / (x_max - x_min) * (WIDTH - left - right);
        let at_y = |y: f64| HEIGHT - bottom - (y - y_min) / (y_max - y_min) * (HEIGHT - top - bottom);
        let mut svg = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" role=\"img\"><text x=\"{left}\" y=\"18\" class=\"title\">{}</text>",
            escaped(self.title)
        );
        for tick in 0..=TICKS {
            let share = tick as f64 / TICKS as f64;
            let (x, y) = (x_min + share * (x_max - x_min), y_min + share * (y_max - y_min));
            let shown_y = if self.log_y { 10f64.powf(y) } else { y };
            let (px, py, end) = (at_x(x), at_y(y), WIDTH - right);
            let _ = write!(svg, "<line x1=\"{left}\" x2=\"{end}\" y1=\"{py:.1}\" y2=\"{py:.1}\" class=\"grid\"/>");
            let _ = write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" class=\"y\">{}</text>", left - 6.0, py + 4.0, number(shown_y));
            let _ = write!(svg, "<text x=\"{px:.1}\" y=\"{:.1}\" class=\"x\">{}</text>", HEIGHT - bottom + 16.0, number(x));
        }
        for (at, (series, line)) in self.series.iter().zip(&lines).enumerate() {
            let colour = COLOURS[at % COLOURS.len()];
            let points: Vec<String> = line.iter().map(|&(x, y)| format!("{:.1},{:.1}", at_x(x), at_y(y))).collect();
            let _ = write!(svg, "<polyline points=\"{}\" stroke=\"{colour}\"/>", points.join(" "));
            if line.len() < 30 {
                line.iter().for_each(|&(x, y)| {
                    let _ = write!(svg, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"{colour}\"/>", at_x(x), at_y(y));
                });
            }
            let y = top + 14.0 + 15.0 * at as f64;
            let _ = write!(svg, "<text x=\"{}\" y=\"{y}\" fill=\"{colour}\">{}</text>", left + 10.0, escaped(&series.name));
        }
        let _ = write!(svg, "<text x=\"{}\" y=\"{}\" class=\"x\">{}</text>", 0.5 * WIDTH, HEIGHT - 8.0, escaped(self.x_label));
        let _ = write!(
            svg,
            "<text transform=\"translate(14 {}) rotate(-90)\" class=\"x\">{}</text>",
            0.5 * HEIGHT,
            escaped(self.y_label)
        );
        svg.push_str("</svg>");
        svg
    }
}

/// The range of `values`, never empty.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (min, max) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), value| (min.min(value), max.max(value)));
    match min < max {
        true => (min, max),
        false if min.is_finite() => (min - 0.5, min + 0.5),
        false => (0.0, 1.0),
    }
}

/// Three digits that count.
fn number(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-2..1e5).contains(&size) {
        return format!("{value:.1e}");
    }
    format!(
        "{value:.*}",
        if size >= 100.0 {
            0
        } else if size >= 10.0 {
            1
        } else {
            2
        }
    )
}

/// `text` as HTML shows it.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_fills_its_frame_and_what_is_no_number_is_left_out() {
        let points = vec![(0.0, 10.0), (1.0, 1000.0), (2.0, f64::NAN), (3.0, 0.0)];
        let plot = |log_y| {
            let series = vec![Series { name: "a < b".into(), points: points.clone() }];
            Plot { title: "t", x_label: "x", y_label: "y", log_y, series }.to_svg()
        };
        let svg = plot(true);
        assert!(svg.contains("points=\"62.0,276.0 544.0,30.0\"") && svg.contains("a &lt; b"), "{svg}");
        assert!(plot(false).contains("544.0"));
        let empty = Plot { title: "", x_label: "", y_label: "", log_y: false, series: vec![] }.to_svg();
        assert!(!empty.contains("NaN") && !empty.contains("inf"));
    }
}
