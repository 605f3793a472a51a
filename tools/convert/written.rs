//! Splats as a file, and what was lost in it.

use std::path::Path;

use anyhow::{Result, ensure};
use decouplegs_asset::LossReport;
use decouplegs_scene::SplatCloud;

use super::bytes_of;
use super::format::Format;
use super::report::Report;
use crate::progress;

/// Writes splats to a file and reads them back.
pub struct Writing<'a> {
    /// File that the splats are from.
    pub input: &'a Path,
    pub output: &'a Path,
    pub format: Format,
    /// Highest degree of spherical harmonics to write; `None`: all.
    pub degree: Option<u8>,
}

impl<'a> Writing<'a> {
    /// Writes `cloud`, of which the input holds `splats_in`. The report's notes begin with `notes`.
    ///
    /// # Errors
    /// A sentence if no splat can be drawn or a file cannot be written or read back.
    pub fn write(
        &self,
        cloud: SplatCloud,
        splats_in: usize,
        mut notes: Vec<String>,
    ) -> Result<Report<'a>> {
        let Self { input, output, .. } = *self;
        let (mut wanted, dropped) = if self.format.holds_defects() {
            (cloud, 0)
        } else {
            without_defects(cloud)
        };
        if dropped > 0 {
            notes.push(format!(
                "{dropped} splats that cannot be drawn are left out: {} has no code for them",
                self.format.name()
            ));
        }
        ensure!(
            !wanted.is_empty(),
            "{} has no splat that can be drawn",
            input.display()
        );
        let original = wanted.clone();
        let degree = self.degree.unwrap_or(wanted.sh_degree);
        wanted.set_degree(degree.min(wanted.sh_degree));
        notes.extend(self.format.limits(&wanted));
        let writing = progress::spinner(format!("writing {}", output.display()));
        let order = self.format.write(output, input, &wanted)?;
        let compared = order.map_or_else(|| original.clone(), |order| original.select(&order));
        if compared.len() < original.len() {
            let count = original.len() - compared.len();
            notes.push(format!(
                "{count} splats with an opacity below 1/255, which are never drawn, are left out"
            ));
        }
        // A device or FIFO cannot be read back.
        let is_file = output.is_file();
        let after = is_file.then(|| self.format.read(output)).transpose()?;
        writing.finish_and_clear();
        let loss =
            after.map(|after| LossReport::between(&compared, &after, self.format.keeps_axes()));
        if loss.is_none() {
            notes.push(format!(
                "{} is no regular file: it was not read back",
                output.display()
            ));
        }
        Ok(Report {
            input,
            output,
            format: self.format.name(),
            splats_in,
            splats_out: compared.len(),
            bytes_in: bytes_of(input)?,
            bytes_out: bytes_of(output)?,
            loss,
            notes,
        })
    }
}

/// The splats that can be drawn, and how many cannot.
fn without_defects(cloud: SplatCloud) -> (SplatCloud, usize) {
    let drawn: Vec<u32> = (0..cloud.len() as u32)
        .filter(|&splat| cloud.defect_of(splat as usize).is_none())
        .collect();
    let dropped = cloud.len() - drawn.len();
    if dropped == 0 {
        (cloud, 0)
    } else {
        (cloud.select(&drawn), dropped)
    }
}
