//! Plots as inline SVG: curves, scatters and stacked bars.

mod scale;

use std::fmt::Write;

use crate::page::escaped;
use scale::Scale;
pub use scale::{Axis, number};

/// Colors there are; series beyond take them again.
const COLORS: usize = 10;
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 340.0;
/// The frame of a plot within the drawing.
const FRAME: Frame = Frame {
    left: 70.0,
    right: 480.0,
    top: 34.0,
    bottom: 286.0,
};
const LEGEND_X: f64 = 494.0;
const LEGEND_STEP: f64 = 18.0;
/// Width of a letter of the plots' text, about.
const LETTER: f64 = 6.6;
/// Points of a longer curve are not marked: marks would cover the line.
const MARKED_MAX: usize = 40;

/// Points under one name.
pub struct Series {
    pub name: String,
    /// Index of the color.
    pub color: usize,
    pub points: Vec<(f64, f64)>,
    pub shape: Shape,
    /// End of the series: its x, and the reason.
    pub end: Option<(f64, String)>,
}

/// Marks of a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Joined, the series' name in the legend.
    Curve,
    /// Each with the series' name beside it.
    Named,
    /// A thin line, without points or name.
    Guide,
}

impl Series {
    /// A curve.
    pub fn curve(name: impl Into<String>, color: usize, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            color,
            points,
            shape: Shape::Curve,
            end: None,
        }
    }

    /// A point with its name.
    pub fn named(name: impl Into<String>, color: usize, point: (f64, f64)) -> Self {
        Self {
            shape: Shape::Named,
            ..Self::curve(name, color, vec![point])
        }
    }

    /// A thin line.
    pub fn guide(color: usize, points: Vec<(f64, f64)>) -> Self {
        Self {
            shape: Shape::Guide,
            ..Self::curve("", color, points)
        }
    }
}

/// Series over two axes.
pub struct Plot<'a> {
    pub title: &'a str,
    pub x: Axis<'a>,
    pub y: Axis<'a>,
    pub series: Vec<Series>,
}

/// Bars of parts, one below the other.
pub struct Bars<'a> {
    pub title: &'a str,
    pub x_label: &'a str,
    pub parts: Vec<String>,
    /// A name, and one value a part.
    pub rows: Vec<(String, Vec<f64>)>,
}

struct Frame {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

fn svg_of(title: &str, height: f64) -> String {
    let name = escaped(title);
    format!(
        "<svg viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" role=\"img\" aria-label=\"{name}\">\
         <text x=\"{}\" y=\"20\" class=\"title\">{name}</text>",
        FRAME.left
    )
}

fn legend(svg: &mut String, at: usize, color: usize, name: &str) {
    let y = FRAME.top + 8.0 + LEGEND_STEP * at as f64;
    let _ = write!(
        svg,
        "<rect x=\"{LEGEND_X}\" y=\"{}\" width=\"12\" height=\"8\" style=\"fill:var(--c{});opacity:{}\"/>\
         <text x=\"{}\" y=\"{}\" class=\"name\">{}</text>",
        y - 8.0,
        color % COLORS,
        opacity(color),
        LEGEND_X + 18.0,
        y,
        escaped(name)
    );
}

impl Plot<'_> {
    /// The drawing. Points that an axis cannot show are left out.
    pub fn to_svg(&self) -> String {
        let points = || self.series.iter().flat_map(|series| &series.points);
        let ends = self
            .series
            .iter()
            .filter_map(|series| Some(series.end.as_ref()?.0));
        let x = Scale::over(points().map(|point| point.0).chain(ends), self.x);
        let y = Scale::over(points().map(|point| point.1), self.y);
        let mut svg = svg_of(self.title, HEIGHT);
        self.draw_axes(&mut svg, &x, &y);
        // Names keep clear of marks, too.
        let named = self
            .series
            .iter()
            .filter(|series| series.shape == Shape::Named)
            .flat_map(|series| &series.points);
        let mark = |&(px, py): &(f64, f64)| {
            Some((
                x.place(px, FRAME.left, FRAME.right)?,
                y.place(py, FRAME.bottom, FRAME.top)?,
            ))
        };
        let mut labels: Vec<(f64, f64, f64)> = named
            .filter_map(mark)
            .map(|(x, y)| (x - 6.0, y + 4.0, 12.0))
            .collect();
        for series in &self.series {
            draw_series(&mut svg, series, &x, &y, &mut labels);
        }
        for (at, series) in self
            .series
            .iter()
            .filter(|series| series.shape == Shape::Curve)
            .enumerate()
        {
            legend(&mut svg, at, series.color, &series.name);
        }
        svg.push_str("</svg>");
        svg
    }

    fn draw_axes(&self, svg: &mut String, x: &Scale, y: &Scale) {
        let Frame {
            left,
            right,
            top,
            bottom,
        } = FRAME;
        for &tick in &y.ticks {
            if let Some(at) = y.place(tick, bottom, top) {
                let _ = write!(
                    svg,
                    "<line x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\" class=\"grid\"/>"
                );
                let _ = write!(
                    svg,
                    "<text x=\"{}\" y=\"{:.1}\" class=\"end\">{}</text>",
                    left - 8.0,
                    at + 4.0,
                    number(tick)
                );
            }
        }
        for &tick in &x.ticks {
            if let Some(at) = x.place(tick, left, right) {
                let _ = write!(
                    svg,
                    "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{bottom}\" y2=\"{}\" class=\"grid\"/>",
                    bottom + 5.0
                );
                let _ = write!(
                    svg,
                    "<text x=\"{at:.1}\" y=\"{}\" class=\"middle\">{}</text>",
                    bottom + 20.0,
                    number(tick)
                );
            }
        }
        let _ = write!(
            svg,
            "<text x=\"{}\" y=\"{}\" class=\"middle\">{}</text>",
            0.5 * (left + right),
            HEIGHT - 12.0,
            escaped(self.x.label)
        );
        let middle = 0.5 * (top + bottom);
        let _ = write!(
            svg,
            "<text transform=\"translate(16 {middle}) rotate(-90)\" class=\"middle\">{}</text>",
            escaped(self.y.label)
        );
    }
}

/// A curve or named points; `labels` are the positions of names that are written already.
fn draw_series(
    svg: &mut String,
    series: &Series,
    x: &Scale,
    y: &Scale,
    labels: &mut Vec<(f64, f64, f64)>,
) {
    let color = series.color % COLORS;
    let position = |&(px, py): &(f64, f64)| {
        Some((
            x.place(px, FRAME.left, FRAME.right)?,
            y.place(py, FRAME.bottom, FRAME.top)?,
        ))
    };
    let positions: Vec<(f64, f64)> = series.points.iter().filter_map(position).collect();
    let line = || {
        positions
            .iter()
            .map(|(x, y)| format!("{x:.1},{y:.1}"))
            .collect::<Vec<_>>()
            .join(" ")
    };
    if series.shape == Shape::Guide {
        let _ = write!(svg, "<polyline points=\"{}\" class=\"guide\"/>", line());
        return;
    }
    if series.shape == Shape::Curve {
        let _ = write!(
            svg,
            "<polyline points=\"{}\" class=\"curve\" style=\"stroke:var(--c{color})\"/>",
            line()
        );
    }
    let marked = if series.shape == Shape::Curve && positions.len() > MARKED_MAX {
        &[]
    } else {
        positions.as_slice()
    };
    for &(x, y) in marked {
        let _ = write!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" class=\"mark\" style=\"stroke:var(--c{color})\"/>"
        );
        if series.shape == Shape::Named {
            let width = LETTER * series.name.chars().count() as f64;
            let left = x + 9.0;
            // Down until no other name is in the way.
            let mut base = y + 4.0;
            while labels
                .iter()
                .any(|&(l, b, w)| (b - base).abs() < 13.0 && l < left + width && left < l + w)
            {
                base += 13.0;
            }
            labels.push((left, base, width));
            let _ = write!(
                svg,
                "<text x=\"{left:.1}\" y=\"{base:.1}\" class=\"name\">{}</text>",
                escaped(&series.name)
            );
        }
    }
    if let Some((end, reason)) = &series.end
        && let Some(at) = x.place(*end, FRAME.left, FRAME.right)
    {
        let base = FRAME.bottom - 8.0 - 13.0 * labels.len() as f64;
        labels.push((at, base, 0.0));
        let _ = write!(
            svg,
            "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{}\" y2=\"{}\" style=\"stroke:var(--c{color})\" stroke-dasharray=\"3 4\"/>\
             <text x=\"{:.1}\" y=\"{base:.1}\" class=\"end\">{}</text>",
            FRAME.top,
            FRAME.bottom,
            at - 6.0,
            escaped(reason)
        );
    }
}

impl Bars<'_> {
    /// The drawing, as high as its rows need.
    pub fn to_svg(&self) -> String {
        const ROW: f64 = 26.0;
        const LEFT: f64 = 130.0;
        let rows_height =
            (ROW * self.rows.len() as f64).max(LEGEND_STEP * self.parts.len() as f64 + 12.0);
        let (right, bottom) = (FRAME.right, FRAME.top + rows_height);
        let sum = |values: &[f64]| values.iter().sum::<f64>();
        let axis = Axis {
            from_zero: true,
            ..Axis::default()
        };
        let scale = Scale::over(self.rows.iter().map(|(_, values)| sum(values)), axis);
        let mut svg = svg_of(self.title, bottom + 54.0);
        for &tick in &scale.ticks {
            if let Some(at) = scale.place(tick, LEFT, right) {
                let _ = write!(
                    svg,
                    "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{}\" y2=\"{bottom}\" class=\"grid\"/>",
                    FRAME.top
                );
                let _ = write!(
                    svg,
                    "<text x=\"{at:.1}\" y=\"{}\" class=\"middle\">{}</text>",
                    bottom + 18.0,
                    number(tick)
                );
            }
        }
        for (row, (name, values)) in self.rows.iter().enumerate() {
            let y = FRAME.top + ROW * row as f64 + 4.0;
            let _ = write!(
                svg,
                "<text x=\"{}\" y=\"{:.1}\" class=\"end name\">{}</text>",
                LEFT - 8.0,
                y + 13.0,
                escaped(name)
            );
            let mut from = 0.0;
            for (part, value) in values.iter().enumerate() {
                if let (Some(a), Some(b)) = (
                    scale.place(from, LEFT, right),
                    scale.place(from + value, LEFT, right),
                ) {
                    let _ = write!(
                        svg,
                        "<rect x=\"{a:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"18\" \
                         style=\"fill:var(--c{});opacity:{}\"><title>{} {} {}</title></rect>",
                        (b - a).max(0.0),
                        part % COLORS,
                        opacity(part),
                        escaped(&self.parts[part]),
                        number(*value),
                        escaped(self.x_label)
                    );
                }
                from += value;
            }
        }
        for (at, part) in self.parts.iter().enumerate() {
            legend(&mut svg, at, at, part);
        }
        let _ = write!(
            svg,
            "<text x=\"{}\" y=\"{}\" class=\"middle\">{}</text></svg>",
            0.5 * (LEFT + right),
            bottom + 40.0,
            escaped(self.x_label)
        );
        svg
    }
}

/// Opacity of a series: repeated colors are paler.
fn opacity(color: usize) -> f64 {
    if color < COLORS { 1.0 } else { 0.55 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(points: &[(f64, f64)]) -> Series {
        Series::curve("a < b", 0, points.to_vec())
    }

    #[test]
    fn a_curve_lies_in_its_frame_and_what_is_no_number_is_left_out() {
        let points = [(0.0, 10.0), (1.0, 1000.0), (2.0, f64::NAN), (3.0, 0.0)];
        let plot = |log| {
            let y = Axis {
                label: "y",
                log,
                ..Axis::default()
            };
            Plot {
                title: "t",
                x: Axis::default(),
                y,
                series: vec![series(&points)],
            }
            .to_svg()
        };
        assert!(
            plot(true).contains("points=\"70.0,286.0 206.7,34.0\""),
            "{}",
            plot(true)
        );
        assert!(
            plot(false).contains(" 480.0,286.0\"") && plot(false).contains("a &lt; b"),
            "{}",
            plot(false)
        );
        let empty = Plot {
            title: "",
            x: Axis::default(),
            y: Axis::default(),
            series: vec![],
        }
        .to_svg();
        assert!(!empty.contains("NaN") && !empty.contains("inf"));
    }

    #[test]
    fn a_long_curve_is_a_line_without_marks() {
        let marks = |count: usize| {
            let points: Vec<(f64, f64)> = (0..count).map(|at| (at as f64, 1.0)).collect();
            let plot = Plot {
                title: "",
                x: Axis::default(),
                y: Axis::default(),
                series: vec![series(&points)],
            };
            plot.to_svg().matches("<circle").count()
        };
        assert_eq!((marks(MARKED_MAX), marks(MARKED_MAX + 1)), (MARKED_MAX, 0));
    }

    #[test]
    fn names_of_points_in_one_place_do_not_cover_each_other() {
        let named = |name: &str| Series::named(name, 0, (1.0, 1.0));
        let all = Plot {
            title: "",
            x: Axis::default(),
            y: Axis::default(),
            series: vec![named("first"), named("second")],
        };
        let svg = all.to_svg();
        let bases: Vec<&str> = svg.split("class=\"name\"").collect();
        assert_eq!(bases.len(), 3);
        let base = |text: &str| {
            text.rsplit("y=\"")
                .next()
                .unwrap()
                .split('"')
                .next()
                .unwrap()
                .parse::<f64>()
                .unwrap()
        };
        assert!((base(bases[0]) - base(bases[1])).abs() >= 13.0, "{svg}");
    }

    #[test]
    fn bars_are_as_long_as_their_parts() {
        let bars = Bars {
            title: "t",
            x_label: "ms",
            parts: vec!["a".into(), "b".into()],
            rows: vec![("m".into(), vec![1.0, 3.0])],
        };
        let svg = bars.to_svg();
        // The axis ends at 4, so 350 px are 4 ms.
        assert!(
            svg.contains("x=\"130.0\" y=\"38.0\" width=\"87.5\"")
                && svg.contains("width=\"262.5\""),
            "{svg}"
        );
    }
}
