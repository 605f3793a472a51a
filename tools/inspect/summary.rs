//! Splats as text: labeled lines and histograms.

use std::fmt::Write;

use decouplegs_asset::{Histogram, SplatSummary, SummaryBounds};

/// Lines of a label and a value each.
#[derive(Default)]
pub struct Lines(String);

impl Lines {
    /// Adds a line. Control characters, which a file's strings may hold, are written out: they
    /// could steer the terminal.
    pub fn line(&mut self, label: &str, value: &str) {
        let shown: String = value
            .chars()
            .map(|c| {
                if c.is_control() {
                    c.escape_default().to_string()
                } else {
                    c.into()
                }
            })
            .collect();
        let _ = writeln!(self.0, "  {label:<16} {shown}");
    }

    pub fn into_text(self) -> String {
        self.0
    }
}

/// Counts, bounds, defects and histograms.
pub fn splats_to_text(summary: &SplatSummary) -> String {
    let mut lines = Lines::default();
    lines.line("splats", &summary.splats.to_string());
    lines.line("SH degree", &summary.sh_degree.to_string());
    lines.line(
        "in memory",
        &format!(
            "{:.1} MiB",
            summary.memory_bytes as f64 / f64::from(1 << 20)
        ),
    );
    match &summary.bounds {
        None => lines.line("bounds", "none: no splat has a finite mean"),
        Some(bounds) => {
            for (axis, name) in ["bounds x", "bounds y", "bounds z"].iter().enumerate() {
                lines.line(
                    name,
                    &format!("{:.3} to {:.3} m", bounds.min[axis], bounds.max[axis]),
                );
            }
        }
    }
    if let Some(extent) = &summary.extent {
        let SummaryBounds { min, max } = extent.middle;
        let along = |axis: usize| format!("{:.3} to {:.3}", min[axis], max[axis]);
        lines.line(
            "98 % of them",
            &format!("x {}, y {}, z {} m", along(0), along(1), along(2)),
        );
        lines.line("far away", &format!("{}, a sky or astray", extent.far));
        lines.line("floaters", &format!("{}, opaque and alone", extent.lonely));
    }
    let kinds: Vec<String> = summary
        .defects
        .by_kind
        .iter()
        .map(|(kind, count)| format!("{count} by {kind}"))
        .collect();
    let kinds = if kinds.is_empty() {
        String::new()
    } else {
        format!(" ({})", kinds.join(", "))
    };
    lines.line(
        "cannot be drawn",
        &format!("{}{kinds}", summary.defects.total),
    );
    let mut text = lines.into_text();
    for (title, histogram) in [
        (
            "standard deviation, log10 of meters, three a splat",
            &summary.scale_log10_m,
        ),
        (
            "longest over shortest axis, log10",
            &summary.anisotropy_log10,
        ),
        ("opacity", &summary.opacity),
    ] {
        let _ = write!(text, "\n  {title}\n{}", histogram_to_text(histogram));
    }
    text
}

/// Widest bar of a histogram, characters.
const BAR_CHARS: u64 = 40;

/// One line a bin from the first to the last that holds something.
fn histogram_to_text(histogram: &Histogram) -> String {
    let most = histogram
        .counts
        .iter()
        .copied()
        .chain([histogram.below, histogram.above, 1])
        .max()
        .unwrap_or(1);
    let row = |label: String, count: u64| {
        let bar = "#".repeat((count * BAR_CHARS).div_ceil(most) as usize);
        format!("  {label:>10}  {bar:<40} {count}\n")
    };
    let first = histogram
        .counts
        .iter()
        .position(|&count| count > 0)
        .unwrap_or(histogram.counts.len());
    let end = histogram
        .counts
        .iter()
        .rposition(|&count| count > 0)
        .map_or(first, |last| last + 1);
    let mut text = String::new();
    if histogram.below > 0 {
        text.push_str(&row(
            format!("< {:.2}", histogram.edges[0]),
            histogram.below,
        ));
    }
    for (edge, &count) in histogram.edges[first..end]
        .iter()
        .zip(&histogram.counts[first..end])
    {
        text.push_str(&row(format!("{edge:.2}"), count));
    }
    if histogram.above > 0 {
        text.push_str(&row(
            format!("> {:.2}", histogram.edges[histogram.edges.len() - 1]),
            histogram.above,
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_histogram_shows_the_bins_that_hold_something() {
        let histogram = Histogram {
            edges: vec![0.0, 1.0, 2.0, 3.0, 4.0],
            counts: vec![0, 80, 0, 1],
            below: 0,
            above: 2,
        };
        let text = histogram_to_text(&histogram);
        let lines: Vec<Vec<&str>> = text
            .lines()
            .map(|line| line.split_whitespace().collect())
            .collect();
        assert_eq!(lines[0], ["1.00", "#".repeat(40).as_str(), "80"]);
        assert_eq!(lines[1], ["2.00", "0"]);
        assert_eq!(
            lines[2],
            ["3.00", "#", "1"],
            "a bin that holds something shows something"
        );
        assert_eq!(lines[3], [">", "4.00", "#", "2"]);
        let empty = Histogram {
            edges: vec![0.0, 1.0],
            counts: vec![0],
            below: 0,
            above: 0,
        };
        assert_eq!(histogram_to_text(&empty), "");
    }

    #[test]
    fn no_value_steers_the_terminal() {
        let mut lines = Lines::default();
        lines.line("made from", "a\u{1b}[2Jb\nc é");
        assert_eq!(
            lines.into_text(),
            format!("  {:<16} a\\u{{1b}}[2Jb\\nc é\n", "made from")
        );
    }
}
