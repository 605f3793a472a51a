//! Loss of a conversion, as text and as JSON.

use std::io::Write;
use std::path::Path;

use anyhow::Result;
use decouplegs_asset::{AttributeLoss, LossReport, write_atomically};
use serde_json::json;

/// One conversion.
pub struct Report<'a> {
    pub input: &'a Path,
    pub output: &'a Path,
    pub format: &'static str,
    pub splats_in: usize,
    pub splats_out: usize,
    pub bytes_in: u64,
    pub bytes_out: u64,
    /// None where splats cannot be told from one another.
    pub loss: Option<LossReport>,
    /// Limits of the format, and omissions.
    pub notes: Vec<String>,
}

impl Report<'_> {
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{}: {}, {} of {} splats, {} bytes where {} were\n",
            self.output.display(),
            self.format,
            self.splats_out,
            self.splats_in,
            self.bytes_out,
            self.bytes_in
        );
        if let Some(loss) = &self.loss {
            text.push_str(&format!(
                "  {:<20}{:>12}{:>12}{:>12}\n",
                "lost", "mean", "99 %", "largest"
            ));
            for (name, loss) in rows(loss) {
                text.push_str(&format!(
                    "  {name:<20}{:>12}{:>12}{:>12}\n",
                    shown(loss.mean),
                    shown(loss.p99),
                    shown(loss.max)
                ));
            }
            if loss.sh_degree_after != loss.sh_degree_before {
                let (before, after) = (loss.sh_degree_before, loss.sh_degree_after);
                text.push_str(&format!(
                    "  spherical harmonics of degree {after} where {before} was\n"
                ));
            }
        }
        for note in &self.notes {
            text.push_str(&format!("  {note}\n"));
        }
        text
    }

    /// Writes the report as JSON; the file is there whole or not at all.
    pub fn write(&self, path: &Path) -> Result<()> {
        let value = json!({
            "input": self.input.to_string_lossy(),
            "output": self.output.to_string_lossy(),
            "format": self.format,
            "splats_in": self.splats_in,
            "splats_out": self.splats_out,
            "bytes_in": self.bytes_in,
            "bytes_out": self.bytes_out,
            "loss": serde_json::to_value(&self.loss)?,
            "notes": self.notes,
        });
        Ok(write_atomically(path, |file| writeln!(file, "{value:#}"))?)
    }
}

/// Names with units, and what was lost of each.
fn rows(loss: &LossReport) -> Vec<(&'static str, AttributeLoss)> {
    let mut rows = vec![
        ("position, m", loss.position_m),
        ("scale, relative", loss.scale_relative),
    ];
    rows.extend(loss.rotation_rad.map(|loss| ("rotation, rad", loss)));
    rows.extend([("opacity", loss.opacity), ("color, DC", loss.sh_dc)]);
    rows.extend(loss.sh_rest.map(|loss| ("color, further", loss)));
    rows
}

/// A loss in three digits.
pub fn shown(value: f64) -> String {
    if value == 0.0 {
        "0".to_owned()
    } else {
        format!("{value:.2e}")
    }
}
