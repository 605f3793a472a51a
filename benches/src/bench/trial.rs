//! Kernels on trial: frames with kernels from folders, in turn with the program's own.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result};
use decouplegs::gpu::{Gpu, KernelTrial};
use decouplegs::render::metrics::Difference;
use decouplegs::render::rendered_image::Image;
use decouplegs::render::{Outputs, RenderOptions, Renderer};
use decouplegs::{Session, World};
use serde_json::{Value, json};

use super::{Arguments, kernels, time_frames};
use crate::arguments::print;
use crate::scene_source::DrawInput;
use crate::spread::Spread;
use crate::stage_times::stage_times_ms;

/// A name for a table, and the folder of its kernels.
#[derive(Clone, Debug)]
pub struct Trial {
    label: String,
    folder: PathBuf,
}

impl Trial {
    /// Name for a table.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// The kernels of the folder.
    ///
    /// # Errors
    /// Returns an error if a file cannot be read or is no kernel.
    pub fn kernels(&self) -> Result<KernelTrial> {
        Ok(KernelTrial::from_folder(&self.folder)?)
    }
}

impl FromStr for Trial {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let folder = Path::new(text);
        let Some(label) = folder.file_name().filter(|_| folder.is_dir()) else {
            return Err(format!(
                "expected a folder of NAME.spv files, found '{text}'"
            ));
        };
        Ok(Self {
            label: label.to_string_lossy().into_owned(),
            folder: folder.to_owned(),
        })
    }
}

/// Name of the program's own kernels in tables.
pub const PROGRAM: &str = "program";

/// Times frames by the program's kernels and by those of each trial, in turn, and compares their
/// images.
pub fn run(input: &DrawInput, arguments: &Arguments) -> Result<Value> {
    let own = (PROGRAM.to_owned(), KernelTrial::default());
    let mut candidates = vec![own];
    for trial in &arguments.trial {
        candidates.push((trial.label.clone(), trial.kernels()?));
    }
    let mut program_image = None;
    let mut rows: Vec<Value> = Vec::new();
    for round in 0..arguments.trial_rounds {
        for (label, trial) in &candidates {
            let gpu = arguments.open(trial.clone())?;
            let mut figures = times(&gpu, input, arguments)
                .with_context(|| format!("with the kernels of {label}"))?;
            if round == 0 {
                figures["kernels"] = kernels::figures(&gpu.kernel_reports());
                let image = image(&gpu, input, arguments)?;
                let program = program_image.get_or_insert_with(|| image.clone());
                figures["difference"] = match Difference::between(&image, program) {
                    Ok(difference) => json!(difference),
                    Err(error) => json!({ "refused": error.to_string() }),
                };
            }
            figures["label"] = json!(label);
            figures["round"] = json!(round);
            print(&row(&figures))?;
            rows.push(figures);
        }
    }
    Ok(json!(rows))
}

/// Times of a frame and of its stages, milliseconds.
fn times(gpu: &Gpu, input: &DrawInput, arguments: &Arguments) -> Result<Value> {
    let timed = time_frames(gpu, input, arguments)?;
    let frame_ms = timed
        .frames
        .iter()
        .map(|frame| frame.gpu_time.as_secs_f64() * 1e3);
    let stages = stage_times_ms(&timed.by_stage, |frame| {
        let stages = frame.stages.iter();
        stages.map(|stage| (stage.name, stage.duration_ns))
    });
    let stages: Vec<Value> = stages
        .into_iter()
        .map(
            |(name, times)| json!({ "name": name, "gpu_ms": Spread::from_values(times).to_json() }),
        )
        .collect();
    Ok(json!({
        "device": gpu.info().name,
        "frame_gpu_ms": Spread::from_values(frame_ms).to_json(),
        "stages": stages,
        "memory_bytes": timed.memory.total_bytes,
    }))
}

/// The image of the scene's first camera, f32.
fn image(gpu: &Gpu, input: &DrawInput, arguments: &Arguments) -> Result<Image> {
    let options = RenderOptions {
        outputs: Outputs::default(),
        ..arguments.options(input.rules())
    };
    let mut renderer = Renderer::new(gpu, options);
    let session = Session::on(gpu, &options.into());
    let mut world = World::new(&session.add_scene(&input.loaded)?);
    world.set_time(input.time_s);
    world.lend(|splats| renderer.render(splats, &input.cameras[..1]))?;
    Ok(renderer.read_images()?.swap_remove(0))
}

/// A line of the table: name, frame, stages, and how the images differ from the program's.
fn row(figures: &Value) -> String {
    let median = |times: &Value| times["gpu_ms"]["median"].as_f64().unwrap_or(f64::NAN);
    let stages = figures["stages"].as_array().into_iter().flatten();
    let stages: Vec<String> = stages
        .map(|stage| {
            format!(
                "{} {:.3}",
                stage["name"].as_str().unwrap_or(""),
                median(stage)
            )
        })
        .collect();
    let difference = match &figures["difference"] {
        Value::Null => String::new(),
        found if found["refused"].is_string() => format!(", wrong: {}", found["refused"]),
        found if found["max_abs"] == 0.0 => ", same images".into(),
        found => format!(
            ", {:.1} dB from the program, max {:.1e}",
            found["psnr_db"].as_f64().unwrap_or(f64::NAN),
            found["max_abs"].as_f64().unwrap_or(f64::NAN)
        ),
    };
    let frame = &figures["frame_gpu_ms"];
    format!(
        "{:<20} {:.3} ms (p99 {:.3}): {}{difference}\n",
        figures["label"].as_str().unwrap_or_default(),
        frame["median"].as_f64().unwrap_or(f64::NAN),
        frame["p99"].as_f64().unwrap_or(f64::NAN),
        stages.join(", "),
    )
}
