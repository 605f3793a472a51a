//! `decouplegs bench --lidar`: how long a sweep takes on the device, stage by stage, and how wrong
//! it is.

use std::io::Write;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use decouplegs::asset::write_atomically;
use decouplegs::episode::chosen_lidars;
use decouplegs::gpu::{Gpu, KernelTrial, MemoryReport};
use decouplegs::render::layout::BeamState;
use decouplegs::render::reference::lidar::{BeamHit64, LidarSplats64, SplatGroup};
use decouplegs::render::{LidarOptions, LidarRenderer, TracedSweep};
use decouplegs::scene::lidar::{Beam, ReturnMode};
use decouplegs::scene::{Lidar, Motion, Pose};
use decouplegs::{Session, World};
use serde_json::{Value, json};

use super::trial::PROGRAM;
use super::{Arguments, kernels};
use crate::arguments::print;
use crate::device::check_validation;
use crate::progress;
use crate::scene_source::DrawInput;
use crate::spread::Spread;

/// A median range counts as right within this distance of the f64 definition's, meters.
const RIGHT_M: f64 = 1e-3;

/// A LiDAR on the ego, and the moments at which it sweeps.
struct Subject {
    lidar: Lidar,
    time_s: f64,
    mode: ReturnMode,
}

/// Sweeps that were timed.
struct Timed {
    gpu_ms: Vec<f64>,
    wall_ms: Vec<f64>,
    /// Name and time of the stages of each sweep that was traced once more for them.
    stages: Vec<Vec<(&'static str, f64)>>,
    /// The last sweep.
    last: TracedSweep,
    memory: MemoryReport,
}

/// Times sweeps of the LiDAR `name`, by the program's kernels and by those of each trial.
pub fn run(name: &str, input: &DrawInput, arguments: &Arguments) -> Result<()> {
    let subject = subject(name, input)?;
    let mut candidates = vec![(PROGRAM.to_owned(), KernelTrial::default())];
    for trial in &arguments.trial {
        candidates.push((trial.label().to_owned(), trial.kernels()?));
    }
    let rounds = match arguments.trial[..] {
        [] => 1,
        _ => arguments.trial_rounds,
    };
    let mut program: Option<Vec<BeamState>> = None;
    let mut rows = Vec::new();
    for round in 0..rounds {
        for (label, trial) in &candidates {
            let gpu = arguments.open(trial.clone())?;
            let timed = time_sweeps(&gpu, input, arguments, &subject)
                .with_context(|| format!("with the kernels of {label}"))?;
            check_validation(&gpu)?;
            let mut figures = figures(&timed, &gpu, input, arguments);
            let states = program.get_or_insert_with(|| timed.last.states.clone());
            figures["same_as_program"] = json!(*states == timed.last.states);
            figures["label"] = json!(label);
            figures["round"] = json!(round);
            if round == 0 {
                figures["kernels"] = kernels::figures(&gpu.kernel_reports());
                figures["error"] = error(&timed.last, input, &subject, arguments.error_beams);
            }
            print(&row(&figures))?;
            if arguments.kernels && round == 0 {
                print(&kernels::to_text(&figures["kernels"]))?;
            }
            rows.push(figures);
        }
    }
    match &arguments.json {
        Some(path) => Ok(write_atomically(path, |file| {
            writeln!(file, "{:#}", json!(rows))
        })?),
        None => Ok(()),
    }
}

/// The LiDAR called `name`, of the scene or of the program, where the ego is.
fn subject(name: &str, input: &DrawInput) -> Result<Subject> {
    let loaded = &input.loaded;
    let mounted = chosen_lidars(&loaded.rig, false, &[name.to_owned()])?.remove(0);
    let sweep_s = mounted.model.sweep_s;
    let start = loaded.ego.at(input.time_s);
    let motion = Motion::between(&start, &loaded.ego.at(input.time_s + sweep_s), sweep_s);
    let lidar = mounted.sweep_from(&start, &motion);
    ensure!(
        !lidar.model.beams().is_empty(),
        "the LiDAR {name} has no beams"
    );
    Ok(Subject {
        mode: lidar.model.returns,
        lidar,
        time_s: input.time_s,
    })
}

/// The sweeps after the warm-up, then as many as are timed by stage.
fn time_sweeps(
    gpu: &Gpu,
    input: &DrawInput,
    arguments: &Arguments,
    subject: &Subject,
) -> Result<Timed> {
    let session = Session::on(gpu, &arguments.options(input.rules()).into());
    let copying = progress::spinner("copying the scene to the device".into());
    let mut world = World::new(&session.add_scene(&input.loaded)?);
    copying.finish_and_clear();
    let options = LidarOptions {
        rules: input.rules(),
        ..LidarOptions::default()
    };
    let mut lidars = LidarRenderer::new(gpu, options);
    world.set_time(subject.time_s);
    let agents = world.frame_agents();
    let scene = world.scene();
    let trace = |lidars: &mut LidarRenderer| {
        scene.lend(&agents, |splats| {
            lidars.trace(splats, &subject.lidar, subject.mode)
        })
    };
    let by_stage = arguments.frames.min(super::FRAMES_BY_STAGE_MAX);
    let count = arguments.warm_up + arguments.frames;
    let bar = progress::bar("sweeps", (count + by_stage) as usize);
    let (mut gpu_ms, mut wall_ms) = (Vec::new(), Vec::new());
    let mut last = trace(&mut lidars)?;
    for index in 0..count {
        let begun = Instant::now();
        last = trace(&mut lidars)?;
        if index >= arguments.warm_up {
            wall_ms.push(begun.elapsed().as_secs_f64() * 1e3);
            gpu_ms.push(last.gpu_time_ns as f64 * 1e-6);
        }
        bar.inc(1);
    }
    lidars.time_stages(true);
    let mut stages = Vec::new();
    for _ in 0..by_stage {
        let traced = trace(&mut lidars)?;
        let times = traced.stages.iter();
        stages.push(
            times
                .map(|stage| (stage.name, stage.duration_ns as f64 * 1e-6))
                .collect(),
        );
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Timed {
        gpu_ms,
        wall_ms,
        stages,
        last,
        memory: gpu.memory(),
    })
}

/// Results, with the conditions of the measurement.
fn figures(timed: &Timed, gpu: &Gpu, input: &DrawInput, arguments: &Arguments) -> Value {
    let model = &timed.last.lidar.model;
    let spread = |values: &[f64]| Spread::from_values(values.iter().copied()).to_json();
    let first = timed.stages.first().map_or(&[][..], |stages| &stages[..]);
    let stage = |(place, (name, _)): (usize, &(&str, f64))| {
        let times = timed.stages.iter().map(|stages| stages[place].1);
        json!({ "name": name, "gpu_ms": Spread::from_values(times).to_json() })
    };
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "device": gpu.info().name,
        "driver": gpu.info().driver,
        "splats": input.loaded.splat_scene.splats.len(),
        "agents": input.loaded.agents.len(),
        "lidar": model.name,
        "beams": timed.last.beams.len(),
        "warm_up": arguments.warm_up,
        "sweeps": timed.gpu_ms.len(),
        "sweep_gpu_ms": spread(&timed.gpu_ms),
        "sweep_wall_ms": spread(&timed.wall_ms),
        "stages": first.iter().enumerate().map(stage).collect::<Vec<_>>(),
        "required": timed.last.required,
        "memory_bytes": timed.memory.total_bytes,
    })
}

/// Difference of `count` beams, evenly chosen, from the f64 definition.
fn error(traced: &TracedSweep, input: &DrawInput, subject: &Subject, count: usize) -> Value {
    let beams = traced.beams.len();
    let count = count.min(beams);
    if count == 0 {
        return Value::Null;
    }
    let chosen: Vec<usize> = (0..count)
        .map(|place| (2 * place + 1) * beams / (2 * count))
        .collect();
    let directions: Vec<Beam> = chosen.iter().map(|&beam| traced.beams[beam]).collect();
    let working = progress::spinner(format!("{count} beams by the f64 definition"));
    let hits = truth(input, subject, &directions);
    working.finish_and_clear();
    let (mut right, mut returns, mut other, mut worst_m, mut transmittance) = (0, 0, 0, 0.0, 0.0);
    for (&beam, hit) in chosen.iter().zip(&hits) {
        let state = &traced.states[beam];
        let left = (f64::from(state.transmittance) - hit.transmittance).abs();
        transmittance = f64::max(transmittance, left);
        match (state.median_m > 0.0, hit.median) {
            (true, Some((range_m, _))) => {
                let off_m = (f64::from(state.median_m) - range_m).abs();
                returns += 1;
                right += usize::from(off_m <= RIGHT_M);
                worst_m = f64::max(worst_m, off_m);
            }
            (false, None) => {}
            _ => other += 1,
        }
    }
    json!({
        "beams": count,
        "returns": returns,
        "medians_right": right,
        "right_m": RIGHT_M,
        "other_returns": other,
        "median_max_m": worst_m,
        "transmittance_max": transmittance,
    })
}

/// Hits of `beams`, by the f64 definition.
fn truth(input: &DrawInput, subject: &Subject, beams: &[Beam]) -> Vec<BeamHit64> {
    let (loaded, time_s) = (&input.loaded, subject.time_s);
    let met = loaded.splat_scene.without_sky_splats();
    let background = SplatGroup {
        splats: &met.splats,
        instances: &met.instance_from_splat,
        instance: 0,
        world_from_splats: Pose {
            translation: met.origin,
            ..Pose::IDENTITY
        },
        motion: Motion::REST,
    };
    let decoded: Vec<_> = loaded.assets.iter().map(|asset| asset.decoded(0)).collect();
    let agents = loaded.agents.iter().filter_map(|agent| {
        Some(SplatGroup {
            splats: &decoded[agent.asset],
            instances: &[],
            instance: agent.instance,
            world_from_splats: agent.pose_at(time_s)?,
            motion: agent.trajectory.motion_at(time_s),
        })
    });
    let reference = LidarSplats64 {
        groups: std::iter::once(background).chain(agents).collect(),
        rules: input.rules(),
    };
    reference.hits(&subject.lidar, beams)
}

/// A line of the table: name, sweep, stages, error, and whether the states are the program's.
fn row(figures: &Value) -> String {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let stages = figures["stages"].as_array().into_iter().flatten();
    let stages: Vec<String> = stages
        .map(|stage| {
            let name = stage["name"].as_str().unwrap_or_default();
            format!("{name} {:.3}", number(&stage["gpu_ms"]["median"]))
        })
        .collect();
    let (sweep, wall) = (&figures["sweep_gpu_ms"], &figures["sweep_wall_ms"]);
    let same = match figures["same_as_program"].as_bool() {
        Some(true) => "same states",
        _ => "OTHER STATES",
    };
    let error = &figures["error"];
    let error = match error {
        Value::Null => String::new(),
        error => format!(
            "; of {} beams {} of {} medians are within 1 mm of f64, {} return otherwise",
            error["beams"], error["medians_right"], error["returns"], error["other_returns"]
        ),
    };
    format!(
        "{:<20} {:.3} ms (p99 {:.3}; wall {:.3}): {}, {same}{error}\n",
        figures["label"].as_str().unwrap_or_default(),
        number(&sweep["median"]),
        number(&sweep["p99"]),
        number(&wall["median"]),
        stages.join(", "),
    )
}
