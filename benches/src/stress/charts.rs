//! The page's drawings.

use super::figures::Outcome;
use super::report::{Report, mebibytes};
use crate::page::Figure;
use crate::plot::{Axis, Bars, Plot, Series};

/// A curve for each mode over the number of agents; one that ends says why.
fn over_agents(report: &Report, of: &dyn Fn(&super::figures::Measured) -> f64) -> Vec<Series> {
    let series = |(at, mode): (usize, &super::mode::Mode)| {
        let lost = report
            .points_of(mode)
            .find(|point| point.measured().is_none());
        let reason = |outcome: &Outcome| match outcome {
            Outcome::OutOfMemory { .. } => format!("{} out of memory", mode.name),
            _ => format!("{} not drawn", mode.name),
        };
        let points = report
            .measured_of(mode)
            .map(|(point, measured)| (point.agents as f64, of(measured)));
        Series {
            end: lost.map(|point| (point.agents as f64, reason(&point.outcome))),
            ..Series::curve(mode.name.clone(), at, points.collect())
        }
    };
    report.modes.iter().enumerate().map(series).collect()
}

pub fn images_against_agents(report: &Report) -> Figure {
    let plot = Plot {
        title: "Images per second against agents",
        x: Axis::from_zero("agents"),
        y: Axis::from_zero("images/s"),
        series: over_agents(report, &|measured| measured.images_per_s()),
    };
    Figure::svg(&plot.to_svg())
}

pub fn memory_against_agents(report: &Report) -> Figure {
    let plot = Plot {
        title: "Device memory against agents",
        x: Axis::from_zero("agents"),
        y: Axis::from_zero("MiB"),
        series: over_agents(report, &|measured| mebibytes(measured.memory.total_bytes)),
    };
    Figure::svg(&plot.to_svg())
}

/// Median GPU time by stage, a bar for each mode, with the most agents.
pub fn stages(report: &Report) -> Figure {
    let largest = report.largest_count();
    let points: Vec<_> = report
        .points
        .iter()
        .filter(|point| point.agents == largest)
        .collect();
    let mut listed: Vec<_> = points
        .iter()
        .filter_map(|point| point.measured())
        .map(|measured| &measured.stages)
        .collect();
    // The mode of most stages says in which order they run.
    listed.sort_by_key(|stages| std::cmp::Reverse(stages.len()));
    let mut parts: Vec<&'static str> = Vec::new();
    for (name, _) in listed.into_iter().flatten() {
        if !parts.contains(name) {
            parts.push(name);
        }
    }
    let rows = points.iter().filter_map(|point| {
        let measured = point.measured()?;
        let time = |part: &&'static str| {
            measured
                .stages
                .iter()
                .find(|(name, _)| name == part)
                .map_or(0.0, |(_, times)| times.median)
        };
        Some((point.mode.name.clone(), parts.iter().map(time).collect()))
    });
    let bars = Bars {
        title: "GPU time by stage, both queues",
        x_label: "ms per frame, medians",
        rows: rows.collect(),
        parts: parts.iter().map(|part| (*part).to_owned()).collect(),
    };
    Figure::svg(&bars.to_svg())
}

/// Distance above the largest finite PSNR at which images without error are plotted, decibels.
const EQUAL_ABOVE_DB: f64 = 10.0;

/// Speed against error of every mode with the most agents.
pub fn speed_against_error(report: &Report) -> Figure {
    let largest = report.largest_count();
    let measured: Vec<_> = (report.modes.iter().enumerate())
        .filter_map(|(at, mode)| {
            let (_, measured) = report
                .measured_of(mode)
                .find(|(point, _)| point.agents == largest)?;
            let psnr_db = if mode.is_vanilla() {
                f64::INFINITY
            } else {
                measured.fidelity?.psnr_all_db
            };
            Some((at, mode, measured.images_per_s(), psnr_db))
        })
        .collect();
    let highest = measured
        .iter()
        .map(|(.., psnr_db)| *psnr_db)
        .filter(|psnr_db| psnr_db.is_finite())
        .fold(f64::NEG_INFINITY, f64::max);
    let equal = if highest.is_finite() {
        highest + EQUAL_ABOVE_DB
    } else {
        100.0
    };
    let places: Vec<(f64, f64)> = measured
        .iter()
        .map(|(_, _, images_per_s, psnr_db)| (*images_per_s, psnr_db.min(equal)))
        .collect();
    let named = measured
        .iter()
        .zip(&places)
        .map(|((at, mode, _, psnr_db), place)| {
            let name = if psnr_db.is_finite() {
                mode.name.clone()
            } else {
                format!("{} (no error)", mode.name)
            };
            Series::named(name, *at, *place)
        });
    let plot = Plot {
        title: "Speed against error: up and right is better",
        x: Axis::logarithmic("images/s, logarithmic"),
        y: Axis::linear("PSNR-All against vanilla, dB"),
        series: std::iter::once(Series::guide(0, front(&places)))
            .chain(named)
            .collect(),
    };
    Figure::svg(&plot.to_svg())
}

/// Pareto front of `places`: points without another one above and to the right, by rising x.
fn front(places: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let beaten = |a: &(f64, f64)| places.iter().any(|b| b.0 >= a.0 && b.1 >= a.1 && b != a);
    let mut front: Vec<(f64, f64)> = places
        .iter()
        .copied()
        .filter(|place| !beaten(place))
        .collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    front
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_what_nothing_beats_in_both() {
        let places = [
            (1.0, 9.0),
            (3.0, 5.0),
            (2.0, 5.0),
            (4.0, 1.0),
            (2.0, 7.0),
            (3.5, 0.5),
        ];
        assert_eq!(
            front(&places),
            [(1.0, 9.0), (2.0, 7.0), (3.0, 5.0), (4.0, 1.0)]
        );
        assert!(front(&[]).is_empty());
    }
}
