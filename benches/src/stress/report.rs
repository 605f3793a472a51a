//! All that a run found: as JSON and as text.

use decouplegs::render::Image;
use serde_json::{Value, json};

use super::figures::{Measured, Outcome, Point};
use super::fit::Line;
use super::mode::{Agents, Mode};

/// Results of a run.
pub struct Report {
    /// Conditions: device, scene, cameras, frames.
    pub conditions: Value,
    pub modes: Vec<Mode>,
    /// Numbers of agents, rising.
    pub counts: Vec<usize>,
    /// Counts in the order of `counts`, for each the modes in theirs.
    pub points: Vec<Point>,
    pub thumbnails: Option<Thumbnails>,
}

/// Images of one view by both renderers.
pub struct Thumbnails {
    pub agents: usize,
    pub time_s: f64,
    pub vanilla: Image,
    pub decoupled: Image,
}

/// Lines through what memory was counted with `decoupled`, bytes.
pub struct MemoryLines {
    /// Purpose `assets` against unique assets.
    pub assets: Option<Line>,
    /// Every other purpose against agents.
    pub rest: Option<Line>,
    /// All of it against agents.
    pub total: Option<Line>,
    /// All memory of vanilla against agents.
    pub vanilla_total: Option<Line>,
}

impl Report {
    /// The mode that stands for what this renderer is for: compressed agents, nothing else changed.
    pub fn decoupled(&self) -> Option<&Mode> {
        self.modes.iter().find(|mode| mode.is_decoupled())
    }

    pub fn vanilla(&self) -> Option<&Mode> {
        self.modes.iter().find(|mode| mode.is_vanilla())
    }

    pub fn pruned(&self) -> Option<&Mode> {
        self.modes
            .iter()
            .find(|mode| matches!(mode.agents, Agents::Copies { keep } if keep < 1.0))
    }

    /// The points of `mode`, by rising number of agents.
    pub fn points_of<'a>(&'a self, mode: &'a Mode) -> impl Iterator<Item = &'a Point> {
        self.points.iter().filter(move |point| point.mode == *mode)
    }

    pub fn measured_of<'a>(
        &'a self,
        mode: &'a Mode,
    ) -> impl Iterator<Item = (&'a Point, &'a Measured)> {
        self.points_of(mode)
            .filter_map(|point| Some((point, point.measured()?)))
    }

    pub fn largest_count(&self) -> usize {
        self.counts.last().copied().unwrap_or(0)
    }

    pub fn memory_lines(&self) -> MemoryLines {
        let line = |mode: Option<&Mode>, of: &dyn Fn(&Point, &Measured) -> (f64, f64)| {
            let points: Vec<(f64, f64)> = self
                .measured_of(mode?)
                .map(|(point, measured)| of(point, measured))
                .collect();
            Line::through(&points)
        };
        let assets = |measured: &Measured| {
            measured
                .memory
                .bytes_by_purpose
                .get("assets")
                .copied()
                .unwrap_or(0) as f64
        };
        let total = |point: &Point, measured: &Measured| {
            (point.agents as f64, measured.memory.total_bytes as f64)
        };
        MemoryLines {
            assets: line(self.decoupled(), &|point, measured| {
                (point.unique_assets as f64, assets(measured))
            }),
            rest: line(self.decoupled(), &|point, measured| {
                (
                    point.agents as f64,
                    measured.memory.total_bytes as f64 - assets(measured),
                )
            }),
            total: line(self.decoupled(), &total),
            vanilla_total: line(self.vanilla(), &total),
        }
    }

    pub fn to_json(&self) -> Value {
        let line = |line: Option<Line>| {
            line.map(|line| json!({ "offset_bytes": line.offset, "slope_bytes": line.slope, "r_squared": line.r_squared }))
        };
        let MemoryLines {
            assets,
            rest,
            total,
            vanilla_total,
        } = self.memory_lines();
        let mut report = self.conditions.clone();
        report["modes"] = self
            .modes
            .iter()
            .map(|mode| json!({ "name": mode.name, "what": mode.what }))
            .collect();
        report["agent_counts"] = json!(self.counts);
        report["points"] = self.points.iter().map(Point::to_json).collect();
        report["memory_lines"] = json!({
            "assets_by_unique_asset": line(assets),
            "rest_by_agent": line(rest),
            "total_by_agent": line(total),
            "vanilla_total_by_agent": line(vanilla_total),
        });
        report
    }

    /// A line for each point.
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{:<18} {:>6} {:>10} {:>9} {:>9} {:>9} {:>8} {:>8}\n",
            "mode", "agents", "images/s", "p50 ms", "p99 ms", "MiB", "all dB", "veh. dB"
        );
        for point in &self.points {
            let start = format!("{:<18} {:>6}", point.mode.name, point.agents);
            text.push_str(&match &point.outcome {
                Outcome::Measured(measured) => format!(
                    "{start} {}\n",
                    figures_text(measured, point.mode.is_vanilla())
                ),
                Outcome::OutOfMemory {
                    needed_bytes,
                    known,
                } => {
                    format!(
                        "{start} out of memory: {:.1} MiB, {known}\n",
                        mebibytes(*needed_bytes)
                    )
                }
                Outcome::Refused(reason) => format!("{start} not drawn: {reason}\n"),
            });
        }
        text
    }
}

fn figures_text(measured: &Measured, is_vanilla: bool) -> String {
    let (all, vehicles) = match (&measured.fidelity, is_vanilla) {
        (_, true) => ("reference".into(), String::new()),
        (None, false) => ("-".into(), "-".into()),
        (Some(fidelity), false) => (
            decibels(fidelity.psnr_all_db),
            fidelity.psnr_vehicles_db.map_or("-".into(), decibels),
        ),
    };
    format!(
        "{:>10.2} {:>9.2} {:>9.2} {:>9.1} {all:>8} {vehicles:>8}",
        measured.images_per_s(),
        measured.step_ms.median,
        measured.step_ms.p99,
        mebibytes(measured.memory.total_bytes)
    )
}

pub fn mebibytes(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

/// Text of a ratio in decibels, without the unit.
pub fn decibels(psnr_db: f64) -> String {
    if psnr_db.is_finite() {
        format!("{psnr_db:.2}")
    } else {
        "equal".into()
    }
}
