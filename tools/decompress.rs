//! `decouplegs decompress`: a compressed asset as ordinary splats.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use decouplegs_asset::{inria_ply, read_coded};

use crate::arguments::print;
use crate::outputs::Force;

/// Convert a compressed asset back to a PLY of splats
#[derive(clap::Args)]
pub struct Arguments {
    /// Compressed asset (.safetensors)
    file: PathBuf,
    /// INRIA PLY to write
    #[arg(long, value_name = "FILE", value_parser = ply_path)]
    out: PathBuf,
    #[command(flatten)]
    force: Force,
    /// Level of detail; 0 is the finest
    #[arg(long, default_value_t = 0)]
    level: usize,
}

fn ply_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_ply = path
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("ply"));
    if is_ply {
        Ok(path)
    } else {
        Err(format!(
            "expected a name that ends with .ply, found {text:?}"
        ))
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let mut outputs = arguments.force.outputs(&[&arguments.file]);
    outputs.file(&arguments.out)?;
    let cloud = read_coded(&arguments.file)?.cloud;
    let levels = cloud.levels.len();
    ensure!(
        arguments.level < levels,
        "{} has {levels} levels of detail, 0 to {}; --level is {}",
        arguments.file.display(),
        levels - 1,
        arguments.level
    );
    let splats = cloud.decoded(arguments.level);
    inria_ply::write(&arguments.out, &splats)?;
    print(&format!(
        "{}: {} splats of degree {}\n",
        arguments.out.display(),
        splats.len(),
        splats.sh_degree
    ))
}
