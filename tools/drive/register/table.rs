//! The figures as text, one line a track.

use decouplegs::drive::Treatment;
use decouplegs::drive::alignment::{penetration_rate, size_quantile};
use glam::DVec2;

use super::measure::{BeforeAfter, Measured, MeasuredTrack};

/// Names of the columns and what stands below them, for text and page alike.
pub fn columns(measured: &Measured) -> Vec<&'static str> {
    let mut columns = vec![
        "track",
        "outcome",
        "shift m",
        "yaw deg",
        "known to m",
        "ADE lane m",
    ];
    if measured.has_truth {
        columns.extend(["ADE truth m", "across m", "along m"]);
    }
    if measured.has_ground {
        columns.extend(["GPR %", "p95 cm"]);
    }
    columns.push("notes");
    columns
}

/// One cell for each column.
pub fn cells(measured: &Measured, track: &MeasuredTrack) -> Vec<String> {
    let outcome = track
        .fit
        .map_or("refused", |(_, treatment)| treatment.name());
    let mut cells = vec![
        format!("{} ({})", track.id, track.class),
        outcome.to_owned(),
    ];
    match track.fit {
        Some((_, treatment)) if treatment.is_kept() => {
            cells.extend(["-".into(), "-".into(), "-".into()]);
        }
        Some((fit, _)) => {
            // Plus nothing, not minus.
            let shift = fit.motion.shift_m + DVec2::ZERO;
            cells.push(format!("{:+.2} {:+.2}", shift.x, shift.y));
            cells.push(format!("{:+.2}", fit.motion.yaw_rad.to_degrees()));
            cells.push(format!("{:.2}, {:.2}", fit.across_m, fit.along_m));
        }
        None => cells.extend(["-".into(), "-".into(), "-".into()]),
    }
    cells.push(change(&track.to_lane_m));
    if measured.has_truth {
        let of = |pick: fn(&decouplegs::drive::alignment::TruthError) -> f64| BeforeAfter {
            before: track.to_truth.before.as_ref().map(pick),
            after: track.to_truth.after.as_ref().map(pick),
        };
        cells.extend([
            change(&of(|e| e.ade_m)),
            change(&of(|e| e.lateral_m)),
            change(&of(|e| e.longitudinal_m)),
        ]);
    }
    if measured.has_ground {
        cells.extend(ground_cells(&track.clearances_m, measured.tolerance_m));
    }
    let flags: Vec<String> = track
        .flags
        .iter()
        .map(|(name, count)| format!("{count} {name}"))
        .collect();
    cells.push(track.refused.clone().unwrap_or_else(|| flags.join(", ")));
    cells
}

fn ground_cells(clearances_m: &[f64], tolerance_m: f64) -> [String; 2] {
    let rate = penetration_rate(clearances_m, tolerance_m)
        .map_or("-".into(), |rate| format!("{:.2}", 100.0 * rate));
    let p95 = size_quantile(clearances_m, 0.95)
        .map_or("-".into(), |p95_m| format!("{:.2}", 100.0 * p95_m));
    [rate, p95]
}

fn change(values: &BeforeAfter<Option<f64>>) -> String {
    let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.3}"));
    match (values.before, values.after) {
        (None, None) => "-".into(),
        (before, after) => format!("{} -> {}", number(before), number(after)),
    }
}

/// Totals over all tracks, in sentences.
pub fn totals(measured: &Measured) -> Vec<String> {
    let mut lines = vec![verdict(measured)];
    if let Some(mean) = measured.mean(|track| track.to_lane_m.clone()) {
        lines.push(format!(
            "Average displacement error (ADE) to the nearest centerline: {:.3} m as logged, {:.3} m registered",
            mean.before, mean.after
        ));
    }
    let to_truth = |pick: fn(&decouplegs::drive::alignment::TruthError) -> f64| {
        measured.mean(|track| BeforeAfter {
            before: track.to_truth.before.as_ref().map(pick),
            after: track.to_truth.after.as_ref().map(pick),
        })
    };
    if let (Some(all), Some(across), Some(along)) = (
        to_truth(|e| e.ade_m),
        to_truth(|e| e.lateral_m),
        to_truth(|e| e.longitudinal_m),
    ) {
        lines.push(format!(
            "ADE to the truth: {:.3} m as logged, {:.3} m registered; across lanes {:.3} and {:.3} m, along them {:.3} and {:.3} m",
            all.before, all.after, across.before, across.after, along.before, along.after
        ));
    }
    let clearances_m = measured.clearances_m();
    if let (Some(rate), Some(p95_m)) = (
        penetration_rate(&clearances_m, measured.tolerance_m),
        size_quantile(&clearances_m, 0.95),
    ) {
        lines.push(format!(
            "Ground penetration rate (GPR): {:.2} % of {} bottom corners are more than {:.1} cm below the ground; 95 % are within {:.2} cm \
             of it, above or below",
            100.0 * rate,
            clearances_m.len(),
            100.0 * measured.tolerance_m,
            100.0 * p95_m
        ));
    }
    lines
}

/// Verdict on the need for registration, and the number of tracks by treatment.
fn verdict(measured: &Measured) -> String {
    let treatments: Vec<Treatment> = measured
        .tracks
        .iter()
        .filter_map(|track| track.fit.map(|(_, treatment)| treatment))
        .collect();
    let count = |holds: fn(Treatment) -> bool| {
        treatments
            .iter()
            .filter(|treatment| holds(**treatment))
            .count()
    };
    let moved = count(|treatment| !treatment.is_kept());
    let with_log = count(|treatment| matches!(treatment, Treatment::Log | Treatment::LogParked));
    let need = match (moved, with_log) {
        (0, _) => {
            "The log needs no registration: lanes show no drift beyond the habits of drivers."
        }
        (_, 0) => "Single tracks drifted; the log as a whole did not.",
        _ => "The log drifted as a whole.",
    };
    let changes: usize = measured.tracks.iter().map(|track| track.lane_changes).sum();
    format!(
        "{need} {} of {} tracks registered: {moved} moved, {} kept as logged ({} parked, {} unsure of their lane); {changes} lane changes",
        treatments.len(),
        measured.tracks.len(),
        treatments.len() - moved,
        count(|treatment| treatment == Treatment::KeptParked),
        count(|treatment| treatment == Treatment::KeptLaneUnsure),
    )
}

/// The table, each column as wide as it needs, and the totals below.
pub fn table(measured: &Measured) -> String {
    let header: Vec<String> = columns(measured).into_iter().map(str::to_owned).collect();
    let rows: Vec<Vec<String>> = std::iter::once(header)
        .chain(measured.tracks.iter().map(|track| cells(measured, track)))
        .collect();
    let widths: Vec<usize> = (0..rows[0].len())
        .map(|column| {
            rows.iter()
                .map(|row| row[column].chars().count())
                .max()
                .unwrap_or(0)
        })
        .collect();
    let mut text = String::new();
    for row in &rows {
        let padded: Vec<String> = row
            .iter()
            .zip(&widths)
            .map(|(cell, width)| format!("{cell:<width$}"))
            .collect();
        text.push_str(padded.join("  ").trim_end());
        text.push('\n');
    }
    totals(measured).iter().for_each(|line| {
        text.push_str(line);
        text.push('\n');
    });
    text
}
