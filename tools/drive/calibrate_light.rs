//! `decouplegs calibrate-light`: how light changes the colors of agents, from probes and assets.

mod page;
mod views;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use clap::ValueEnum;
use decouplegs::asset::{
    LightTransferFile, Provenance, SplatFormat, probe_paths, read_bytes, read_probe, read_splats,
    write_atomically, write_light_transfer,
};
use decouplegs::scene::SplatCloud;
use decouplegs::scene::light::{Probe, Surroundings};
use decouplegs_calibrate::{
    CalibrateOptions, Calibration, Comparison, LIGHTS_MIN, Objective, Progress, calibrate,
};

use crate::arguments::{print, warn};
use crate::outputs::Force;
use crate::progress;

/// Fit the effect of light on the colors of agents
///
/// Fits Theta, which turns the colors of a place into a factor and a summand for each color
/// coefficient of an agent that stands there, so that agents look as their surroundings are lit.
/// Truth are the given assets in the light of the given environment probes, each turned, mirrored
/// and exposed in several ways. Each probe is also left out in turn to see how far colors are off
/// in light that the fit was not shown.
#[derive(clap::Args)]
pub struct Arguments {
    #[arg(required = true, value_name = "ASSET", help = format!(
        "Assets in their own frame: meters, x forward, y left, z up ({})",
        SplatFormat::EXTENSIONS
    ))]
    assets: Vec<PathBuf>,
    /// Folder of lat-long images of linear radiance (.exr, .hdr), top row up
    #[arg(long, value_name = "DIR")]
    probes: PathBuf,
    /// Light transfer to write (.safetensors)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Degree of the spherical harmonics (default: the highest among the assets)
    #[arg(long, value_name = "DEGREE", allow_negative_numbers = true, value_parser = clap::value_parser!(u8).range(0..=3))]
    degree: Option<u8>,
    /// Ridge strength: pull of the weights to those of a pure brightness change, above 0 (default:
    /// the least error on probes left out)
    #[arg(long, value_name = "STRENGTH")]
    ridge: Option<f64>,
    /// Quantity that the fit minimizes
    #[arg(long, value_name = "QUANTITY", value_enum, default_value_t = ObjectiveName::Seen)]
    objective: ObjectiveName,
    /// Number of turns of each probe about the vertical
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 6, value_parser = clap::value_parser!(u64).range(1..=64))]
    rotations: u64,
    /// Number of sampled splats, shared by the assets
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 4096, value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    samples: u64,
    /// Linear albedo of the reference ground, above 0, at most 1
    #[arg(long, value_name = "ALBEDO", default_value_t = Surroundings::default().albedo)]
    ground_albedo: f64,
    /// Seed of all randomness: the same seed gives the same bytes
    #[arg(
        long,
        value_name = "SEED",
        allow_negative_numbers = true,
        default_value_t = 1
    )]
    seed: u64,
    /// Write an HTML page with the measurements and images of the first asset
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

/// Quantity that the fit minimizes, by its name on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ObjectiveName {
    /// Error of each coefficient by itself, as in the paper
    Coefficients,
    /// Error of colors in their visible directions
    Seen,
}

/// Inputs of the calibration.
pub struct Subject {
    /// Names and splats.
    pub assets: Vec<(String, SplatCloud)>,
    /// Probes as they were read.
    pub probes: Vec<Probe>,
    /// Options of the fit.
    pub options: CalibrateOptions,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let inputs: Vec<&Path> = arguments.assets.iter().map(PathBuf::as_path).collect();
    let written = [Some(&arguments.out), arguments.report.as_ref()];
    arguments
        .force
        .files(&inputs, written.into_iter().flatten())?;
    let mut sources = BTreeMap::new();
    let subject = read(arguments, &mut sources)?;
    for probe in subject.probes.iter().filter(|probe| probe.clamped > 0) {
        warn(&format!(
            "{}: {} pixels hold no radiance (NaN, infinite or negative) and were clamped",
            probe.name, probe.clamped
        ));
    }
    let bar = progress::bar("calibrating", 2 * subject.probes.len() + 1);
    let assets: Vec<(String, &SplatCloud)> = subject
        .assets
        .iter()
        .map(|(name, cloud)| (name.clone(), cloud))
        .collect();
    let calibration = calibrate(
        &assets,
        &subject.probes,
        &subject.options,
        &|step| match step {
            Progress::Sampling => {}
            Progress::Probes(done) => bar.set_position(done as u64),
            Progress::Moments => bar.set_position(subject.probes.len() as u64),
            Progress::HeldOut(done) => bar.set_position((subject.probes.len() + 1 + done) as u64),
        },
    );
    bar.finish_and_clear();
    let calibration = calibration?;
    let file = LightTransferFile {
        transfer: calibration.transfer.clone(),
        tool_version: env!("CARGO_PKG_VERSION").into(),
        sources,
        settings: settings(&subject.options, &calibration),
    };
    write_light_transfer(&arguments.out, &file)?;
    print(&summary(&arguments.out, &subject, &calibration))?;
    if let Some(path) = &arguments.report {
        let html = page::page(&subject, &calibration)?;
        write_atomically(path, |file| {
            std::io::Write::write_all(file, html.as_bytes())
        })?;
        print(&format!("{}\n", path.display()))?;
    }
    Ok(())
}

fn read(arguments: &Arguments, sources: &mut BTreeMap<String, String>) -> Result<Subject> {
    let mut hashed = |path: &Path| -> Result<String> {
        let bytes = read_bytes(path)?;
        let Provenance {
            source,
            source_sha256,
            ..
        } = Provenance::of_source(
            path.file_name().unwrap_or_default().to_string_lossy(),
            &bytes,
        );
        sources.insert(source.clone(), source_sha256);
        Ok(source)
    };
    let mut assets = Vec::new();
    for path in &arguments.assets {
        assets.push((hashed(path)?, read_splats(path)?));
    }
    let mut probes = Vec::new();
    for path in probe_paths(&arguments.probes)? {
        hashed(&path)?;
        probes.push(read_probe(&path)?);
    }
    ensure!(
        !probes.is_empty(),
        "{} holds no probe: expected .exr or .hdr files",
        arguments.probes.display()
    );
    let options = CalibrateOptions {
        sh_degree: arguments.degree,
        ridge: arguments.ridge,
        objective: match arguments.objective {
            ObjectiveName::Coefficients => Objective::Coefficients,
            ObjectiveName::Seen => Objective::Seen,
        },
        rotations: arguments.rotations as usize,
        samples: arguments.samples as usize,
        ground: Surroundings {
            albedo: arguments.ground_albedo,
            ..Surroundings::default()
        },
        seed: arguments.seed,
    };
    Ok(Subject {
        assets,
        probes,
        options,
    })
}

fn settings(options: &CalibrateOptions, calibration: &Calibration) -> BTreeMap<String, String> {
    let settings = [
        ("objective", options.objective.to_string()),
        ("ridge", calibration.ridge.to_string()),
        ("rotations", options.rotations.to_string()),
        ("samples", options.samples.to_string()),
        ("ground_albedo", options.ground.albedo.to_string()),
        ("ground_gloss", options.ground.gloss.to_string()),
        ("seed", options.seed.to_string()),
    ];
    settings.map(|(key, value)| (key.to_owned(), value)).into()
}

fn summary(out: &Path, subject: &Subject, calibration: &Calibration) -> String {
    let mut text = format!(
        "{}: degree {}, {} splats of {} asset(s) in {} lights from {} probes, objective {}, ridge {:.1e}\n\
         rank {} of {LIGHTS_MIN}, condition number {:.0}; neutral light changes colors by {:.4} (RMSE)\n",
        out.display(),
        calibration.transfer.sh_degree,
        calibration.samples,
        subject.assets.len(),
        calibration.lights,
        subject.probes.len(),
        subject.options.objective,
        calibration.ridge,
        calibration.rank,
        calibration.smallest_over_largest.recip(),
        calibration.neutral.relit.rmse(),
    );
    if calibration.held_out.is_empty() {
        text.push_str(
            "no probe could be left out: the others do not determine a fit without it; give more\n",
        );
    } else {
        text.push_str(&format!("probe left out     {ROW_HEADER}"));
        for held_out in &calibration.held_out {
            text.push_str(&row(
                &subject.probes[held_out.probe].name,
                &held_out.comparison,
            ));
        }
        text.push_str(&row("all", &calibration.total()));
    }
    if !calibration.held_out_assets.is_empty() {
        text.push_str(&format!("asset left out     {ROW_HEADER}"));
    }
    for held_out in &calibration.held_out_assets {
        let name = &subject.assets[held_out.asset].0;
        text.push_str(&row(name, &held_out.comparison));
    }
    text
}

/// Columns of [`row`] behind the name.
const ROW_HEADER: &str =
    "RMSE none  relit  best affine   angle none mean/p95    relit mean/p95    affine mean/p95\n";

fn row(name: &str, comparison: &Comparison) -> String {
    let Comparison {
        none,
        relit,
        affine,
    } = comparison;
    let angle = |error: &decouplegs_calibrate::ColorError| {
        format!(
            "{:6.2} / {:5.2} deg",
            error.angle_mean_deg(),
            error.angle_p95_deg()
        )
    };
    format!(
        "{name:<18} {:9.4} {:6.4} {:12.4}   {} {} {}\n",
        none.rmse(),
        relit.rmse(),
        affine.rmse(),
        angle(none),
        angle(relit),
        angle(affine)
    )
}
