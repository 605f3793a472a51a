//! `decouplegs compare`: how far two pictures are apart.

use std::path::PathBuf;

use anyhow::{Context, Result};
use decouplegs::render::metrics::{Difference, difference_picture};
use decouplegs::render::picture::{Picture, PictureFormat};

use crate::arguments::{print, write_picture};

/// Measure the difference between two pictures (.png, .exr, .npy) of one size
#[derive(clap::Args)]
pub struct Arguments {
    /// The first picture
    a: PathBuf,
    /// The second picture
    b: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Write a picture of the difference: false colors, black where equal
    #[arg(long, value_name = "FILE")]
    difference: Option<PathBuf>,
    /// Amplification of the difference in that image
    #[arg(long, default_value_t = 16.0, requires = "difference", value_parser = positive)]
    gain: f32,
}

fn positive(text: &str) -> Result<f32, String> {
    let value: f32 = text.parse().map_err(|_| format!("expected a number, found {text:?}"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(format!("expected a number above zero, found {text}")) }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let (a, b) = (Picture::read(&arguments.a)?, Picture::read(&arguments.b)?);
    let names = || format!("{} and {} cannot be compared", arguments.a.display(), arguments.b.display());
    let difference = Difference::between(&a, &b).with_context(names)?;
    if let Some(path) = &arguments.difference {
        let picture = difference_picture(&a, &b, arguments.gain).with_context(names)?;
        let unknown = || format!("{}: the picture's name must end with .png, .exr or .npy", path.display());
        write_picture(path, &picture, PictureFormat::of_path(path).with_context(unknown)?)?;
    }
    if arguments.json {
        return print(&format!("{:#}\n", serde_json::to_value(difference)?));
    }
    print(&to_text(&difference))
}

fn to_text(difference: &Difference) -> String {
    let Difference { max_abs, rmse, psnr_db, ssim, flip, share_off } = difference;
    let ssim = ssim.map_or("none: a side is below 11 pixels".to_owned(), |ssim| format!("{ssim:.6}"));
    format!(
        "max abs      {max_abs:.6}\nRMSE         {rmse:.3e}\nPSNR         {psnr_db:.2} dB\nSSIM         {ssim}\n\
         FLIP         {flip:.6}\nabove 1/255  {:.4} %\n",
        100.0 * share_off
    )
}
