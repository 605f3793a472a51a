//! The page's drawing: angles by weather and arm.

use super::figures::Report;
use super::reinsert::Arm;
use crate::page::Figure;
use crate::plot::Bars;

/// The angle that 95 of 100 pixels of vehicles are not farther off, a bar for each weather and arm.
pub fn angles(report: &Report) -> Figure {
    let shown = [
        Arm::NoRelighting,
        Arm::Transfer,
        Arm::Ours,
        Arm::BestAffine,
        Arm::TruthCompressed,
    ];
    let rows = report.reinsertions.iter().flat_map(|found| {
        shown.iter().enumerate().filter_map(|(at, arm)| {
            let figures = found.arms.iter().find(|figures| figures.arm == *arm)?;
            let mut values = vec![0.0; shown.len()];
            values[at] = figures.vehicles.angle_deg?.p95;
            Some((
                if at == 0 {
                    found.weather.name().to_owned()
                } else {
                    String::new()
                },
                values,
            ))
        })
    });
    let bars = Bars {
        title: "Angle between colors of vehicles and the truth, p95",
        x_label: "degrees",
        rows: rows.collect(),
        parts: [
            "no relighting",
            "light transfer",
            "ours",
            "best affine on DC",
            "truth, compressed",
        ]
        .map(str::to_owned)
        .into(),
    };
    Figure::svg(&bars.to_svg())
}
