//! `decouplegs compare`: how far two images are apart.

use std::path::PathBuf;

use anyhow::{Context, Result};
use decouplegs_render::metrics::{Difference, difference_image};
use decouplegs_render::rendered_image::{Image, ImageFileFormat};

use crate::arguments::{print, write_image};
use crate::outputs::Force;

/// Measure the difference between two images (.png, .exr, .npy) of one size
#[derive(clap::Args)]
pub struct Arguments {
    /// First image
    a: PathBuf,
    /// Second image
    b: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Write an image of the difference: false colors, black where equal
    #[arg(long, value_name = "FILE")]
    difference: Option<PathBuf>,
    /// Amplification of the difference in that image
    #[arg(long, default_value_t = 16.0, requires = "difference", value_parser = positive)]
    gain: f32,
    #[command(flatten)]
    force: Force,
}

fn positive(text: &str) -> Result<f32, String> {
    let value: f32 = text
        .parse()
        .map_err(|_| format!("expected a number, found {text:?}"))?;
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(format!("expected a number above zero, found {text}"))
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { a, b, force, .. } = arguments;
    let written = arguments.difference.as_deref().map(|path| {
        let unknown = || {
            format!(
                "{}: the image's name must end with .png, .exr or .npy",
                path.display()
            )
        };
        let format = ImageFileFormat::of_path(path).with_context(unknown)?;
        force.outputs(&[a, b]).file(path)?;
        anyhow::Ok((path, format))
    });
    let written = written.transpose()?;
    let (a, b) = (Image::read(a)?, Image::read(b)?);
    let names = || {
        format!(
            "{} and {} cannot be compared",
            arguments.a.display(),
            arguments.b.display()
        )
    };
    let difference = Difference::between(&a, &b).with_context(names)?;
    if let Some((path, format)) = written {
        let image = difference_image(&a, &b, arguments.gain).with_context(names)?;
        write_image(path, &image, format)?;
    }
    if arguments.json {
        return print(&format!("{:#}\n", serde_json::to_value(difference)?));
    }
    print(&to_text(&difference))
}

fn to_text(difference: &Difference) -> String {
    let Difference {
        max_abs,
        rmse,
        psnr_db,
        ssim,
        flip,
        share_off,
    } = difference;
    let ssim = ssim.map_or("none: a side is below 11 pixels".to_owned(), |ssim| {
        format!("{ssim:.6}")
    });
    format!(
        "max abs      {max_abs:.6}\nRMSE         {rmse:.3e}\nPSNR         {psnr_db:.2} dB\nSSIM         {ssim}\n\
         FLIP         {flip:.6}\nabove 1/255  {:.4} %\n",
        100.0 * share_off
    )
}
