//! Splats as a file, and what was lost in it.

use std::path::Path;

use anyhow::{Result, ensure};
use decouplegs_asset::{Comparison, LossReport, read_splat_pieces};
use decouplegs_scene::SplatCloud;
use rayon::prelude::*;

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
        // What is compared has all degrees. There is a copy only where fewer are written.
        let degree = self
            .degree
            .unwrap_or(wanted.sh_degree)
            .min(wanted.sh_degree);
        let original = (degree < wanted.sh_degree).then(|| wanted.clone());
        wanted.set_degree(degree);
        notes.extend(self.format.limits(&wanted));
        let writing = progress::spinner(format!("writing {}", output.display()));
        let order = self.format.write(output, input, &wanted)?;
        let original = original.as_ref().unwrap_or(&wanted);
        let splats_out = order.as_ref().map_or(original.len(), Vec::len);
        if splats_out < original.len() {
            let count = original.len() - splats_out;
            notes.push(format!(
                "{count} splats with an opacity below 1/255, which are never drawn, are left out"
            ));
        }
        // A device or FIFO cannot be read back.
        let is_file = output.is_file();
        let loss = is_file
            .then(|| self.compare(original, order.as_deref()))
            .transpose()?;
        writing.finish_and_clear();
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
            splats_out,
            bytes_in: bytes_of(input)?,
            bytes_out: bytes_of(output)?,
            loss,
            notes,
        })
    }

    /// Reads the written file and compares it with `original`, whose splats stand there in `order`.
    fn compare(&self, original: &SplatCloud, order: Option<&[u32]>) -> Result<LossReport> {
        let output = self.output;
        let mut comparison = Comparison::new(self.format.keeps_axes());
        let mut add = |_: usize, piece: SplatCloud| comparison.add(original, order, &piece);
        let as_many = match self.format.read(output)? {
            Some(after) => add(after.len(), after),
            None => read_splat_pieces(output, add)?,
        };
        let expected = order.map_or(original.len(), <[u32]>::len);
        ensure!(
            as_many && comparison.compared() == expected,
            "{} was read back with another number of splats than the {expected} that were written: it was changed meanwhile, convert again",
            output.display()
        );
        Ok(comparison.report())
    }
}

/// The splats that can be drawn, and how many cannot.
fn without_defects(cloud: SplatCloud) -> (SplatCloud, usize) {
    let drawn: Vec<u32> = (0..cloud.len() as u32)
        .into_par_iter()
        .filter(|&splat| cloud.defect_of(splat as usize).is_none())
        .collect();
    let dropped = cloud.len() - drawn.len();
    if dropped == 0 {
        (cloud, 0)
    } else {
        (cloud.select(&drawn), dropped)
    }
}
