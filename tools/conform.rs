//! `decouplegs conform`: judges a render server of the sensorsim contract.

use std::io::Write;

use anyhow::{Result, bail};
use decouplegs::asset::write_atomically;
use decouplegs_server::conform::{self, Report};

use crate::arguments::print;

pub use decouplegs_server::conform::ConformOptions as Arguments;

pub fn run(arguments: &Arguments) -> Result<()> {
    let mut printed = Ok(());
    let report = conform::run(arguments, &mut |check, outcome| {
        if printed.is_ok() {
            printed = print(&Report::line(check, outcome));
        }
    })?;
    printed?;
    print(&report.summary())?;
    if let Some(path) = &arguments.json {
        write_atomically(path, |file| writeln!(file, "{:#}", report.to_json()))?;
    }
    let failed = report.failed().len();
    if failed > 0 {
        bail!("{failed} checks failed");
    }
    Ok(())
}
