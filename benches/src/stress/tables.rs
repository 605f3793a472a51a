//! The page's tables.

use std::ops::RangeInclusive;

use super::figures::{Measured, Outcome, Point};
use super::mode::Mode;
use super::report::{Report, decibels, mebibytes};
use crate::page::{Page, Table};

/// Traffic densities of the paper's table.
const DENSITIES: [(&str, RangeInclusive<usize>); 3] = [
    ("S (1 to 2)", 1..=2),
    ("M (3 to 5)", 3..=5),
    ("L (6 to 10)", 6..=10),
];

/// The paper's table: vanilla, the pruned scene and decoupled by traffic density, each the mean
/// over the counts measured.
pub fn compression(page: &mut Page, report: &Report) {
    let mut table = Table::new([
        "agents",
        "mode",
        "PSNR-Veh, dB",
        "PSNR-All, dB",
        "SSIM",
        "images/s",
        "MiB",
        "counts",
    ])
    .with_text_in(1);
    let modes = [report.vanilla(), report.pruned(), report.decoupled()];
    for (density, counts) in &DENSITIES {
        for mode in modes.iter().flatten() {
            let points: Vec<&Point> = report
                .points_of(mode)
                .filter(|point| counts.contains(&point.agents))
                .collect();
            let head = [(*density).to_owned(), mode.name.clone()];
            table.row_that_stands_out(
                report.decoupled() == Some(*mode),
                head.into_iter().chain(density_cells(mode, &points)),
            );
        }
    }
    page.table(&table);
    page.note(
        "Each figure is the mean over the agent counts of its row, PSNR that of the mean squared error. Vanilla is what the others are \
         compared with.",
    );
}

/// Figures of a row, or why there are none.
fn density_cells(mode: &Mode, points: &[&Point]) -> Vec<String> {
    if points.is_empty() {
        return vec!["no such count was measured".into()];
    }
    let measured: Vec<&Measured> = points.iter().filter_map(|point| point.measured()).collect();
    if measured.is_empty() {
        return vec![reason(&points[0].outcome)];
    }
    let mean = |values: Vec<f64>| {
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let fidelity = |of: &dyn Fn(&super::fidelity::Fidelity) -> Option<f64>| {
        mean(
            measured
                .iter()
                .filter_map(|measured| of(measured.fidelity.as_ref()?))
                .collect(),
        )
    };
    // Errors are averaged before the logarithm: images without error have no finite PSNR.
    let psnr = |of: &dyn Fn(&super::fidelity::Fidelity) -> Option<f64>| match fidelity(&|found| {
        Some(10f64.powf(of(found)? / -10.0))
    }) {
        _ if mode.is_vanilla() => "reference".to_owned(),
        square => square.map_or("-".into(), |square| decibels(-10.0 * square.log10())),
    };
    let counts: Vec<String> = points
        .iter()
        .filter(|point| point.measured().is_some())
        .map(|point| point.agents.to_string())
        .collect();
    let mean_of = |of: &dyn Fn(&Measured) -> f64| {
        let values = measured.iter().map(|measured| of(measured)).collect();
        format!("{:.1}", mean(values).unwrap_or(f64::NAN))
    };
    vec![
        psnr(&|fidelity| fidelity.psnr_vehicles_db),
        psnr(&|fidelity| Some(fidelity.psnr_all_db)),
        if mode.is_vanilla() {
            "reference".into()
        } else {
            ssim(fidelity(&|fidelity| fidelity.ssim))
        },
        mean_of(&|measured| measured.images_per_s()),
        mean_of(&|measured| mebibytes(measured.memory.total_bytes)),
        counts.join(", "),
    ]
}

fn ssim(value: Option<f64>) -> String {
    value.map_or("-".into(), |value| format!("{value:.4}"))
}

pub fn reason(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Measured(_) => String::new(),
        Outcome::OutOfMemory {
            needed_bytes,
            known,
        } => format!(
            "out of memory: {:.1} MiB, {known}",
            mebibytes(*needed_bytes)
        ),
        Outcome::Refused(reason) => format!("not drawn: {reason}"),
    }
}

pub fn modes(report: &Report) -> Table {
    let mut table = Table::new(["mode", "what it is"]).with_text_in(1);
    for mode in &report.modes {
        table.row([&mode.name, &mode.what]);
    }
    table
}

/// A row for each point: `head` and `cells` of what was measured, or why there is nothing.
fn table_of_points(
    report: &Report,
    head: &[&str],
    cells: &dyn Fn(&Point, &Measured) -> Vec<String>,
) -> Table {
    let mut table = Table::new(["mode", "agents"].iter().chain(head));
    for mode in &report.modes {
        for point in report.points_of(mode) {
            let cells = match point.measured() {
                Some(measured) => cells(point, measured),
                None => vec![reason(&point.outcome)],
            };
            let head = [mode.name.clone(), point.agents.to_string()];
            table.row(head.into_iter().chain(cells));
        }
    }
    table
}

pub fn all_times(report: &Report) -> Table {
    let head = [
        "images/s",
        "rig steps/s",
        "step p50, ms",
        "step p99",
        "GPU p50, ms",
        "GPU p99",
        "update p50, ms",
        "record p50, ms",
        "PSNR-All, dB",
        "PSNR-Veh, dB",
        "SSIM",
        "max",
        "views with kept keys",
    ];
    table_of_points(report, &head, &|point, measured| {
        let mut cells = vec![
            format!("{:.2}", measured.images_per_s()),
            format!("{:.2}", measured.rig_steps_per_s()),
            format!("{:.3}", measured.step_ms.median),
            format!("{:.3}", measured.step_ms.p99),
            format!("{:.3}", measured.gpu_ms.median),
            format!("{:.3}", measured.gpu_ms.p99),
            measured
                .update_ms
                .map_or("-".into(), |update| format!("{:.3}", update.median)),
            format!("{:.3}", measured.record_ms.median),
        ];
        cells.extend(match &measured.fidelity {
            _ if point.mode.is_vanilla() => vec![
                "reference".into(),
                "reference".into(),
                "-".into(),
                "-".into(),
            ],
            None => vec!["-".to_owned(); 4],
            Some(fidelity) => vec![
                decibels(fidelity.psnr_all_db),
                fidelity.psnr_vehicles_db.map_or("-".into(), decibels),
                ssim(fidelity.ssim),
                format!("{:.4}", fidelity.max_abs),
            ],
        });
        cells.push(format!("{:.0} %", 100.0 * measured.share_of_kept_keys()));
        cells
    })
}

pub fn all_memory(report: &Report) -> Table {
    let head = [
        "MiB in all",
        "by purpose, MiB",
        "driver, MiB",
        "unique assets",
        "splats of the cloud",
        "agents in sight",
        "their splats",
        "visible splats",
        "tile entries",
        "redrawn",
    ];
    table_of_points(report, &head, &|point, measured| {
        let purposes: Vec<String> = measured
            .memory
            .bytes_by_purpose
            .iter()
            .map(|(purpose, bytes)| format!("{purpose} {:.1}", mebibytes(*bytes)))
            .collect();
        vec![
            format!("{:.1}", mebibytes(measured.memory.total_bytes)),
            purposes.join(", "),
            measured
                .memory
                .driver_usage_bytes
                .map_or("-".into(), |bytes| format!("{:.1}", mebibytes(bytes))),
            point.unique_assets.to_string(),
            measured.world_splats.to_string(),
            format!("{:.0}", measured.agents_drawn),
            format!("{:.0}", measured.agent_splats),
            format!("{:.0}", measured.records),
            format!("{:.0}", measured.pairs),
            measured.redrawn.to_string(),
        ]
    })
}
