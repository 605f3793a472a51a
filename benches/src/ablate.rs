//! `decouplegs ablate`: cars put back where they were, and what each part of the system is worth.

mod affine;
mod cars;
mod charts;
mod example_crops;
mod figures;
#[cfg(test)]
mod geometry;
mod page;
mod placing;
mod reinsert;
mod reinsertion_street;
mod ring;
mod speed;
mod system;

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};
use decouplegs::asset::{read_light_transfer, write_atomically};
use decouplegs::gpu::Gpu;
use decouplegs::scene::light::{Lighting, RelightOptions};
use decouplegs::synth::street::{AssetLight, Capture, StreetOptions, Weather};
use serde_json::{Value, json};

use crate::arguments::{Size, print};
use crate::device::{DeviceArguments, check_validation};
use crate::outputs::Force;
use crate::progress;
use cars::Cars;
use figures::Report;
use placing::Drift;
use reinsert::Reinsertion;
use reinsertion_street::ReinsertionStreet;

/// Reinsert cars into streets that they were removed from, and leave out parts of the system one by
/// one
///
/// Streets are synthetic, so that the truth is known: what their cars look like in the light of the
/// place, and the dark about them. Cars captured in neutral light are put where the true ones
/// stand, lit by the street about them, and compared with the truth over the pixels of vehicles.
/// Then the system runs in full and without compression, registration and relighting.
#[derive(clap::Args)]
pub struct Arguments {
    /// Light transfer: the effect of light on colors, written by `calibrate-light` (.safetensors)
    #[arg(long, value_name = "FILE")]
    light: PathBuf,
    /// Mean albedo of the road that the scene gives (default: that of the calibration)
    #[arg(long, value_name = "ALBEDO", value_parser = albedo)]
    ground_albedo: Option<f64>,
    /// Weather of the streets, one street each: clear, overcast, dusk, night; the system is
    /// measured in the first
    #[arg(long, value_name = "WEATHER", value_delimiter = ',', default_value = "clear,overcast,dusk,night", value_parser = weather)]
    weather: Vec<Weather>,
    /// Splats of the street without its traffic
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 300_000, value_parser = at_least_one)]
    background: usize,
    /// Cars that drive
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 6, value_parser = at_least_one)]
    agents: usize,
    /// Splats of each car
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 20_000, value_parser = at_least_one)]
    agent_splats: usize,
    /// Number of the six cameras to render, from the first
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=6))]
    cameras_used: u32,
    /// Size of every image
    #[arg(
        long,
        value_name = "WxH",
        allow_hyphen_values = true,
        default_value = "800x450"
    )]
    size: Size,
    /// Number of moments at which images are compared with the ground truth: one per part of the
    /// drive, the one with most cars in sight
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    moments: u32,
    /// Number of timed frames, 0.1 s apart
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: u32,
    /// Seed of all randomness: the street, the codebooks, the drift of tracks
    #[arg(
        long,
        value_name = "SEED",
        allow_negative_numbers = true,
        default_value_t = 1
    )]
    seed: u64,
    /// Shift of each track, each in a random direction, meters
    #[arg(long, value_name = "METERS", allow_negative_numbers = true, default_value_t = 0.5, value_parser = not_negative)]
    drift_m: f64,
    /// Turn of each track about its middle, left or right, degrees
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, default_value_t = 0.4, value_parser = not_negative)]
    drift_deg: f64,
    /// Standard deviation of each position along each axis, meters
    #[arg(long, value_name = "METERS", allow_negative_numbers = true, default_value_t = 0.05, value_parser = not_negative)]
    noise_m: f64,
    /// Length of a color, as a vector of at most 1.73, below which hue is ignored
    #[arg(long, value_name = "LENGTH", default_value_t = 0.05, value_parser = not_negative)]
    floor: f64,
    /// Number of views around a car that measure the visibility of its splats for compression
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    views: u32,
    #[command(flatten)]
    device: DeviceArguments,
    /// Write all figures to this JSON file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// HTML page to write, with tables and images
    #[arg(long, value_name = "FILE.html")]
    out: PathBuf,
    #[command(flatten)]
    force: Force,
}

fn weather(text: &str) -> Result<Weather, String> {
    let names = Weather::ALL.map(Weather::name).join(", ");
    Weather::ALL
        .into_iter()
        .find(|weather| weather.name() == text)
        .ok_or_else(|| format!("expected one of {names}, found {text:?}"))
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|&count| count >= 1)
        .ok_or_else(|| format!("expected a number of at least 1, found {text:?}"))
}

fn albedo(text: &str) -> Result<f64, String> {
    let number = text.parse().ok();
    let number = number.filter(|value: &f64| *value > 0.0 && *value <= 1.0);
    number.ok_or_else(|| format!("expected a number above 0, at most 1, found {text:?}"))
}

fn not_negative(text: &str) -> Result<f64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|value: &f64| value.is_finite() && *value >= 0.0);
    number.ok_or_else(|| format!("expected a number of at least 0, found {text:?}"))
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let written = [Some(&arguments.out), arguments.json.as_ref()];
    arguments
        .force
        .files(&[&arguments.light], written.into_iter().flatten())?;
    let light = read_light_transfer(&arguments.light)?.transfer;
    let relighting = RelightOptions {
        ground_albedo: arguments.ground_albedo,
        by_normals: true,
        ..RelightOptions::default()
    };
    let mut weathers: Vec<Weather> = Vec::new();
    for &weather in &arguments.weather {
        if !weathers.contains(&weather) {
            weathers.push(weather);
        }
    }
    let gpu = arguments.device.open()?;
    let cars = Cars::captured(
        &gpu,
        &street_options(arguments, weathers[0]),
        arguments.views,
    )?;
    let bar = progress::bar("ablate", weathers.len() * arguments.moments as usize);
    let mut reinsertions = Vec::new();
    let mut system = None;
    for &weather in &weathers {
        let options = street_options(arguments, weather);
        let stage = ReinsertionStreet::set(
            &options,
            &cars,
            (&light, relighting),
            arguments.size,
            arguments.cameras_used as usize,
        )?;
        let moments_s = stage.moments_s(arguments.moments);
        let lighting = stage.loaded.lighting().context("the street has no light")?;
        let lighting = Lighting {
            relighting: RelightOptions {
                by_normals: false,
                ..relighting
            },
            ..lighting
        };
        let reinsertion = Reinsertion {
            gpu: &gpu,
            stage: &stage,
            cars: &cars,
            lighting: &lighting,
            floor: arguments.floor,
        };
        let (measured, truths) = reinsertion.measure(&moments_s, &|| bar.inc(1))?;
        if system.is_none() {
            bar.set_message("the system and its parts");
            let drift = Drift {
                shift_m: arguments.drift_m,
                turn_rad: arguments.drift_deg.to_radians(),
                noise_m: arguments.noise_m,
                seed: arguments.seed,
            };
            system = Some(reinsertion.system(&drift, &truths, &measured, arguments.frames)?);
        }
        reinsertions.push(measured);
    }
    bar.finish_and_clear();
    check_validation(&gpu)?;
    let Some(system) = system else { return Ok(()) };
    let report = Report {
        conditions: conditions(arguments, &gpu, &cars),
        reinsertions,
        system,
    };
    if let Some(path) = &arguments.json {
        write_atomically(path, |file| writeln!(file, "{:#}", report.to_json()))?;
    }
    let page = page::page(&report)?;
    write_atomically(&arguments.out, |file| file.write_all(page.as_bytes()))?;
    print(&report.to_text())
}

fn street_options(arguments: &Arguments, weather: Weather) -> StreetOptions {
    StreetOptions {
        background: arguments.background,
        agents: arguments.agents,
        agent_splats: arguments.agent_splats,
        seed: arguments.seed,
        weather,
        asset_light: AssetLight::Neutral,
        capture: Capture::Ego,
        ..StreetOptions::default()
    }
}

/// Conditions of the measurement, for later readers.
fn conditions(arguments: &Arguments, gpu: &Gpu, cars: &Cars) -> Value {
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "device": gpu.info().name,
        "driver": gpu.info().driver,
        "light": arguments.light.file_name().map(|name| name.to_string_lossy()),
        "ground_albedo": arguments.ground_albedo,
        "background_splats": arguments.background,
        "agents": arguments.agents,
        "agent_splats": arguments.agent_splats,
        "assets": cars.originals.len(),
        "coded_splats": cars.coded.iter().map(|coded| coded.levels[0]).collect::<Vec<_>>(),
        "cameras": arguments.cameras_used,
        "width_px": arguments.size.width_px,
        "height_px": arguments.size.height_px,
        "moments": arguments.moments,
        "frames": arguments.frames,
        "seed": arguments.seed,
        "drift_m": arguments.drift_m,
        "drift_deg": arguments.drift_deg,
        "noise_m": arguments.noise_m,
        "floor": arguments.floor,
        "views": arguments.views,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nonsense_is_refused_with_what_there_is() {
        assert_eq!(weather("dusk"), Ok(Weather::Dusk));
        assert!(
            weather("fog")
                .unwrap_err()
                .contains("clear, overcast, dusk, night")
        );
        assert_eq!(at_least_one("3"), Ok(3));
        for nonsense in ["0", "-1", "many"] {
            assert!(at_least_one(nonsense).unwrap_err().contains(nonsense));
        }
        for nonsense in ["-0.1", "NaN", "inf", "far"] {
            assert!(not_negative(nonsense).unwrap_err().contains(nonsense));
        }
        assert_eq!(albedo("0.18"), Ok(0.18));
        for nonsense in ["0", "1.2", "NaN", "gray"] {
            assert!(albedo(nonsense).unwrap_err().contains(nonsense));
        }
    }
}
