//! Values that several subcommands take, and what they all print with.

use std::io::{ErrorKind, Write};
use std::ops::RangeInclusive;
use std::path::Path;
use std::str::FromStr;

use anyhow::{Context, Result};
use clap::ValueEnum;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use decouplegs_asset::{read_light_transfer, write_atomically};
use decouplegs_render::Plane;
use decouplegs_render::rendered_image::{Image, ImageFileFormat};
use decouplegs_scene::explain::one_line;
use decouplegs_scene::{LightTransfer, Rules};

/// The size of an image, written `1600x900`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    pub width_px: u32,
    pub height_px: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once('x').and_then(|(width, height)| {
            let side = |text: &str| text.parse().ok().filter(|side| (1..=65_536).contains(side));
            Some(Self {
                width_px: side(width)?,
                height_px: side(height)?,
            })
        });
        parsed.ok_or_else(|| {
            format!(
                "expected WIDTHxHEIGHT in pixels, 1x1 to 65536x65536, like 1600x900, found {text:?}"
            )
        })
    }
}

/// A finite number, for options where NaN and infinity mean nothing.
pub fn finite(text: &str) -> Result<f64, String> {
    let parsed = text
        .parse()
        .ok()
        .filter(|number: &f64| number.is_finite() && number.abs() <= 1e12);
    parsed.ok_or_else(|| format!("expected a number of at most 1e12, found {text:?}"))
}

/// Three numbers of at most `most` with commas between them. None for any other text.
pub fn three_numbers(text: &str, most: f64) -> Option<[f64; 3]> {
    let number = |part: &str| {
        part.trim()
            .parse()
            .ok()
            .filter(|number: &f64| number.abs() <= most)
    };
    text.split(',')
        .map(number)
        .collect::<Option<Vec<f64>>>()?
        .try_into()
        .ok()
}

/// Parser of the names of planes.
pub fn plane_names() -> impl TypedValueParser<Value = Plane> {
    let names = PossibleValuesParser::new(Plane::ALL.map(Plane::name));
    names.map(|name| Plane::by_name(&name).expect("it is one of the names"))
}

pub fn seconds_above_zero(text: &str) -> Result<f64, String> {
    finite(text)
        .ok()
        .filter(|seconds| *seconds > 0.0)
        .ok_or_else(|| format!("expected seconds above 0, found {text:?}"))
}

/// Seconds within `range`.
pub fn seconds_within(text: &str, range: &RangeInclusive<f64>) -> Result<f64, String> {
    let parsed = text.parse().ok().filter(|seconds| range.contains(seconds));
    parsed.ok_or_else(|| {
        let (least, most) = (range.start(), range.end());
        format!("expected seconds from {least} to {most}, found {text:?}")
    })
}

/// A number of pixels, 0 or more.
pub fn pixels(text: &str) -> Result<f64, String> {
    finite(text)
        .ok()
        .filter(|pixels| *pixels >= 0.0)
        .ok_or_else(|| format!("expected pixels, 0 or more, found {text:?}"))
}

/// Image formation rules of a renderer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RulesName {
    /// Alpha at most 0.99, no early termination by the rules, near plane at 0.01 m
    Default,
    /// gsplat 1.5: alpha at most 0.999, stops before the splat that would saturate the pixel
    Gsplat15,
    /// gsplat 1.6: alpha at most 0.99, the same stop
    Gsplat16,
    /// The INRIA rasterizer: alpha at most 0.99, the same stop, near plane at 0.2 m
    Inria,
    /// NuRec and 3DGUT, by footprints: no response below 0.0113, stops behind the splat that takes
    /// the transmittance to 0.001, near plane at 0.2 m
    Nurec,
}

impl RulesName {
    pub fn rules(self) -> Rules {
        match self {
            Self::Default => Rules::DEFAULT,
            Self::Gsplat15 => Rules::GSPLAT15,
            Self::Gsplat16 => Rules::GSPLAT16,
            Self::Inria => Rules::INRIA,
            Self::Nurec => Rules::NUREC,
        }
    }
}

/// Writes a report to standard output. A reader that has seen enough (`| head`) is no failure.
pub fn print(report: &str) -> Result<()> {
    match std::io::stdout().write_all(report.as_bytes()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result.context("standard output cannot be written"),
    }
}

/// Writes a warning to standard error. One that cannot be written is lost.
pub fn warn(sentence: &str) {
    let _ = writeln!(std::io::stderr(), "warning: {}", one_line(sentence));
}

/// `word` as a POSIX shell takes it for one word.
#[must_use]
pub fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:+=@%".contains(c);
    match !word.is_empty() && word.chars().all(is_plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

/// Writes an image; the file is there whole or not at all.
pub fn write_image(path: &Path, image: &Image, format: ImageFileFormat) -> Result<()> {
    let bytes = image
        .encode(format)
        .with_context(|| format!("{} was not written", path.display()))?;
    Ok(write_atomically(path, |file| file.write_all(&bytes))?)
}

/// [`write_image`], for one to be laid over another: PNG holds its alpha too.
pub fn write_image_with_alpha(path: &Path, image: &Image, format: ImageFileFormat) -> Result<()> {
    let bytes = image
        .encode_with_alpha(format)
        .with_context(|| format!("{} was not written", path.display()))?;
    Ok(write_atomically(path, |file| file.write_all(&bytes))?)
}

/// The light transfer in the file `--light`, if that is given.
///
/// # Errors
/// Returns an error if it is no such file.
pub fn transfer_in(light: Option<&Path>) -> Result<Option<LightTransfer>> {
    let file = light.map(read_light_transfer).transpose()?;
    Ok(file.map(|file| file.transfer))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_and_nonsense_is_refused() {
        assert_eq!(
            "1600x900".parse(),
            Ok(Size {
                width_px: 1600,
                height_px: 900
            })
        );
        for nonsense in [
            "",
            "1600",
            "1600x",
            "x900",
            "0x900",
            "-1x5",
            "1600x900x3",
            "70000x1",
            "1600 x 900",
            "1e3x5",
        ] {
            let refused = nonsense.parse::<Size>().unwrap_err();
            assert!(refused.contains(&format!("{nonsense:?}")), "{refused}");
        }
    }

    #[test]
    fn a_shell_reads_every_word_back() {
        for word in [
            "plain.ply",
            "with space.ply",
            "it's $HOME",
            "",
            "a;rm *",
            "--view",
            "-1.5,0,1e-7",
            "größe",
        ] {
            let script = format!("printf %s {}", quoted(word));
            let output = std::process::Command::new("sh")
                .args(["-c", &script])
                .output();
            assert_eq!(output.unwrap().stdout, word.as_bytes(), "{script}");
        }
        assert_eq!(quoted("-1.5,0,1e-7"), "-1.5,0,1e-7");
    }

    #[test]
    fn every_rule_of_the_engine_can_be_asked_for() {
        let offered: Vec<_> = RulesName::value_variants()
            .iter()
            .map(|name| name.to_possible_value().unwrap())
            .collect();
        assert_eq!(
            offered
                .iter()
                .map(|value| value.get_name())
                .collect::<Vec<_>>(),
            Rules::NAMES
        );
        for name in RulesName::value_variants() {
            let value = name.to_possible_value().unwrap();
            assert_eq!(Rules::by_name(value.get_name()), Some(name.rules()));
        }
    }
}
