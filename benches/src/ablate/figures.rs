//! Results as JSON and as text.

use std::fmt::Write;

use serde_json::{Value, json};

use super::reinsert::{ArmFigures, Reinserted};
use super::system::{System, SystemRow};
use crate::plot::number;

/// Results of one run.
pub struct Report {
    pub conditions: Value,
    pub reinsertions: Vec<Reinserted>,
    pub system: System,
}

impl Report {
    pub fn to_json(&self) -> Value {
        let mut report = self.conditions.clone();
        report["reinsertion"] = self.reinsertions.iter().map(reinserted_json).collect();
        report["system"] = json!({
            "weather": self.system.weather.name(),
            "background_splats": self.system.splats[0],
            "splats_with_whole_cars": self.system.splats[1],
            "start_s": self.system.start_s,
            "rows": self.system.rows.iter().map(row_json).collect::<Vec<_>>(),
        });
        report
    }

    /// The tables, for a terminal.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for found in &self.reinsertions {
            let _ = writeln!(
                text,
                "{}: {} px of vehicles; ground about them {} darker in truth, I_dom {:.2}",
                found.weather.name(),
                found.arms[0].vehicles.pixels,
                percent(found.truth_darkness),
                found.starkness
            );
            let _ = writeln!(
                text,
                "  {:<27} PSNR dB   PIE max/p99/p95/mean      PAE max/p99/p95/mean deg   ground dB  darker",
                ""
            );
            for arm in &found.arms {
                let _ = writeln!(
                    text,
                    "  {:<27}{}",
                    arm.arm.name(),
                    arm_cells(arm).join("  ")
                );
            }
        }
        let _ = writeln!(
            text,
            "{}: system                             images/s  p50/p99 ms  ADE m (lane)  PAE max/p95 deg at truth, as placed",
            self.system.weather.name()
        );
        for row in &self.system.rows {
            let _ = writeln!(
                text,
                "  {:<40}{}",
                row.without.name(),
                row_cells(row).join("  ")
            );
        }
        text
    }
}

/// PSNR, PIE, PAE, PSNR of the ground, its darkness.
pub fn arm_cells(arm: &ArmFigures) -> Vec<String> {
    let peak = |peak: &decouplegs::render::metrics::Peak, digits: usize| {
        format!(
            "{:.digits$} / {:.digits$} / {:.digits$} / {:.digits$}",
            peak.max, peak.p99, peak.p95, peak.mean
        )
    };
    vec![
        decibels(arm.vehicles.psnr_db),
        peak(&arm.vehicles.intensity, 3),
        arm.vehicles
            .angle_deg
            .as_ref()
            .map_or("-".into(), |angle| peak(angle, 1)),
        arm.ground
            .as_ref()
            .map_or("-".into(), |ground| decibels(ground.psnr_db)),
        percent(arm.darkness),
    ]
}

/// Images/s, times of steps, ADE, PAE at true poses and as placed.
pub fn row_cells(row: &SystemRow) -> Vec<String> {
    let angle = |found: &decouplegs::render::metrics::MaskedDifference| {
        found.angle_deg.map_or("-".into(), |angle| {
            format!("{:.1} / {:.1}", angle.max, angle.p95)
        })
    };
    vec![
        number(round(row.speed.images_per_s(), 2)),
        format!(
            "{:.1} / {:.1}",
            row.speed.step_ms.median, row.speed.step_ms.p99
        ),
        format!(
            "{:.3} ({:.3})",
            row.placing.ade_truth_m, row.placing.ade_lane_m
        ),
        angle(&row.at_truth),
        angle(&row.as_placed),
    ]
}

fn round(value: f64, digits: i32) -> f64 {
    let unit = 10f64.powi(digits);
    (value * unit).round() / unit
}

pub fn decibels(psnr_db: f64) -> String {
    if psnr_db.is_finite() {
        format!("{psnr_db:.2}")
    } else {
        "equal".into()
    }
}

pub fn percent(share: Option<f64>) -> String {
    share.map_or("-".into(), |share| format!("{:.1} %", 100.0 * share))
}

fn reinserted_json(found: &Reinserted) -> Value {
    let arms = found.arms.iter().map(|arm| {
        json!({
            "arm": arm.arm.name(),
            "vehicles": arm.vehicles,
            "ground": arm.ground,
            "darkness": arm.darkness,
        })
    });
    json!({
        "weather": found.weather.name(),
        "arms": arms.collect::<Vec<_>>(),
        "truth_darkness": found.truth_darkness,
        "starkness": found.starkness,
        "directionality": found.directionality,
        "unlit": found.unlit,
    })
}

fn row_json(row: &SystemRow) -> Value {
    json!({
        "row": row.without.name(),
        "images_per_s": row.speed.images_per_s(),
        "rig_steps_per_s": row.speed.rig_steps_per_s(),
        "step_ms": { "p50": row.speed.step_ms.median, "p99": row.speed.step_ms.p99, "mean": row.speed.step_ms.mean },
        "gpu_ms": { "p50": row.speed.gpu_ms.median, "p99": row.speed.gpu_ms.p99 },
        "memory_bytes": row.speed.memory.total_bytes,
        "placing": row.placing.to_json(),
        "at_truth": row.at_truth,
        "as_placed": row.as_placed,
        "paper": row.without.paper().map(|[fps, ade_m, pae_deg]| json!({ "fps": fps, "ade_m": ade_m, "pae_deg": pae_deg })),
    })
}
