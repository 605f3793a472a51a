//! Results of a benchmark, as JSON and as text.

use std::collections::BTreeMap;

use decouplegs::render::FrameStatistics;
use decouplegs::render::metrics::{FLIP_MIN, WORST_PIXELS};
use decouplegs::scene::{Camera, Rules};
use serde_json::{Value, json};

use super::{ImageError, Measured, Timed};
use crate::scene_source::DrawInput;
use crate::spread::Spread;
use crate::stage_times::stage_times_ms;

/// Results, with the conditions of the measurement.
pub fn figures<'a>(input: &DrawInput, measured: &'a Measured) -> Value {
    let Measured {
        device,
        options,
        step_s,
        warm_up,
        timed,
        window,
        difference,
        images,
        kernels: _,
    } = measured;
    let Timed {
        frames,
        by_stage,
        steps_ms,
        memory,
    } = timed;
    let last = frames.last().expect("at least one frame was timed");
    let milliseconds =
        |of: &dyn Fn(&FrameStatistics) -> f64| Spread::from_values(frames.iter().map(of)).to_json();
    let wall_ms = milliseconds(&|frame| frame.wall_time.as_secs_f64() * 1e3);
    let step_wall_ms = Spread::from_values(steps_ms.iter().copied()).to_json();
    // Not from the median: with frames in flight, their ends may come in bursts.
    let rig_steps_per_s = 1e3 * steps_ms.len() as f64 / steps_ms.iter().sum::<f64>();
    let stages_of = |frame: &'a FrameStatistics| {
        let stages = frame.stages.iter();
        stages.map(|stage| (stage.name, stage.duration_ns))
    };
    let stages: Vec<Value> = stage_times_ms(by_stage, stages_of)
        .into_iter()
        .map(
            |(name, times)| json!({ "name": name, "gpu_ms": Spread::from_values(times).to_json() }),
        )
        .collect();
    let size = |camera: &Camera| json!([camera.intrinsics.width_px, camera.intrinsics.height_px]);
    let image_error = |image: &ImageError| json!({ "camera": image.camera, "difference": image.difference, "flips": image.flips });
    let splat_bytes = options
        .storage
        .splat_bytes(input.loaded.splat_scene.splats.sh_degree);
    let mut figures = json!({
        "version": env!("CARGO_PKG_VERSION"),
        "device": device.name,
        "driver": device.driver,
        "splats": input.loaded.splat_scene.splats.len(),
        "sh_degree": input.loaded.splat_scene.splats.sh_degree,
        "agents": { "in_scene": input.loaded.agents.len(), "drawn": last.agents, "splats": last.agent_splats },
        "storage": { "name": options.storage.name(), "splat_bytes": splat_bytes },
        "keep_keys": options.keep_keys,
        "level_pitch_px": options.level_pitch_px,
        "background_pitch_px": options.background_pitch_px,
        "frames_in_flight": options.frames_in_flight,
        "step_s": step_s,
        "cameras": input.cameras.len(),
        "width_px": input.cameras[0].intrinsics.width_px,
        "height_px": input.cameras[0].intrinsics.height_px,
        "sizes_px": input.cameras.iter().map(size).collect::<Vec<_>>(),
        "rules": rules_text(&options.rules),
        "outputs": options.outputs,
        "warm_up": warm_up,
        "frames": frames.len(),
        "frames_redrawn": frames.iter().filter(|frame| frame.redrawn > 0).count(),
        "frames_repeated": frames.iter().filter(|frame| frame.repeated).count(),
        "frame_gpu_ms": milliseconds(&|frame| frame.gpu_time.as_secs_f64() * 1e3),
        "frame_wall_ms": wall_ms,
        "step_wall_ms": step_wall_ms,
        "keys": by_key_source(frames),
        "update_gpu_ms": milliseconds(&|frame| frame.update_time.map_or(0.0, |time| time.as_secs_f64() * 1e3)),
        "record_ms": milliseconds(&|frame| frame.record_time.as_secs_f64() * 1e3),
        "rig_steps_per_s": rig_steps_per_s,
        "images_per_s": rig_steps_per_s * input.cameras.len() as f64,
        "frames_by_stage": by_stage.len(),
        "stages": stages,
        "required": last.required,
        "capacity": last.capacity,
        "memory_bytes": {
            "total": memory.total_bytes,
            "by_purpose": memory.bytes_by_purpose,
            "driver_usage": memory.driver_usage_bytes,
        },
        "error": {
            "camera": input.cameras[0].name,
            "window_px": [window.left_px, window.top_px, window.width_px, window.height_px],
            "difference": difference,
            "flip_min": FLIP_MIN,
            "images": images.iter().map(image_error).collect::<Vec<_>>(),
        },
    });
    figures["keep_lists"] = json!(options.keep_lists);
    figures["frame_gpu_ms_by_lists"] = by_lists(frames);
    figures
}

/// Name of `rules`, or all of their values if they have no name.
fn rules_text(rules: &Rules) -> String {
    let named = Rules::NAMES.iter().find(|name| {
        Rules::by_name(name).map(|known| Rules {
            antialias: rules.antialias,
            ..known
        }) == Some(*rules)
    });
    let name = named.map_or_else(|| format!("{rules:?}"), |name| (*name).to_owned());
    if rules.antialias && named.is_some() {
        format!("{name}, antialiased")
    } else {
        name
    }
}

fn outputs_text(outputs: &Value) -> String {
    let color = if outputs["color"] == "U8" {
        "rgba8"
    } else {
        "f32"
    };
    let planes = outputs["planes"].as_array().into_iter().flatten();
    std::iter::once(color)
        .chain(planes.filter_map(Value::as_str))
        .collect::<Vec<_>>()
        .join(", ")
}

/// Widest bar of the chart, characters.
const BAR_CHARS: f64 = 30.0;

/// Report for people: conditions, then the stages as a chart, the frame, memory and error.
pub fn to_text(figures: &Value) -> String {
    format!(
        "{}\n{}\n{}{}{}",
        heading(figures),
        chart(figures),
        rates(figures),
        memory(figures),
        error(figures)
    )
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

/// Numbers of views by the source of their depth keys.
fn by_key_source(frames: &[FrameStatistics]) -> BTreeMap<String, usize> {
    let mut views = BTreeMap::new();
    for source in frames.iter().flat_map(|frame| &frame.keys) {
        *views
            .entry(format!("{source:?}").to_lowercase())
            .or_default() += 1;
    }
    views
}

/// GPU times of frames, milliseconds, by the source of their lists.
fn by_lists(frames: &[FrameStatistics]) -> Value {
    let mut times_ms = BTreeMap::<String, Vec<f64>>::new();
    for frame in frames {
        let source = format!("{:?}", frame.lists).to_lowercase();
        let frame_ms = frame.gpu_time.as_secs_f64() * 1e3;
        times_ms.entry(source).or_default().push(frame_ms);
    }
    let rows = times_ms.into_iter().map(|(source, times_ms)| {
        let mut row = Spread::from_values(times_ms.iter().copied()).to_json();
        row["frames"] = json!(times_ms.len());
        (source, row)
    });
    Value::Object(rows.collect())
}

/// A line of [`by_lists`] where lists may be kept.
fn lists_text(figures: &Value) -> String {
    if figures["keep_lists"] != true {
        return String::new();
    }
    let rows = figures["frame_gpu_ms_by_lists"].as_object();
    let rows: Vec<String> = rows
        .into_iter()
        .flatten()
        .map(|(source, times)| {
            format!(
                "{source} {} frames, median {:.3} ms",
                times["frames"],
                number(&times["median"])
            )
        })
        .collect();
    format!("by the source of their lists: {}\n", rows.join("; "))
}

fn heading(figures: &Value) -> String {
    format!(
        "{} ({})\n{} splats of degree {} in {} storage ({} bytes each){} and {} agents of {} splats, rules {}\nviews by the source of their background's depth keys: {}\n{} cameras, the first of {}x{}, {}\n{} frames after {} to warm up: {} redrawn, {} with the commands of an earlier frame; times of stages are of {} more frames\n{}",
        text(&figures["device"]),
        text(&figures["driver"]),
        figures["splats"],
        figures["sh_degree"],
        text(&figures["storage"]["name"]),
        figures["storage"]["splat_bytes"],
        match figures["background_pitch_px"].as_f64() {
            Some(pitch_px) => format!(", fewer where they lie at most {pitch_px} px apart,"),
            None => String::new(),
        },
        figures["agents"]["drawn"],
        figures["agents"]["splats"],
        text(&figures["rules"]),
        figures["keys"],
        figures["cameras"],
        figures["width_px"],
        figures["height_px"],
        outputs_text(&figures["outputs"]),
        figures["frames"],
        figures["warm_up"],
        figures["frames_redrawn"],
        figures["frames_repeated"],
        figures["frames_by_stage"],
        lists_text(figures),
    )
}

/// A line for each stage with a bar as long as its median, then the frame.
fn chart(figures: &Value) -> String {
    let stages: Vec<(&str, &Value)> = figures["stages"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|stage| (text(&stage["name"]), &stage["gpu_ms"]))
        .collect();
    let longest_ms = stages
        .iter()
        .map(|(_, times)| number(&times["median"]))
        .fold(f64::MIN_POSITIVE, f64::max);
    let row = |name: &str, times: &Value, bar: &str| {
        // The clock's steps may make a time of nothing a little negative.
        let ms = |key: &str| number(&times[key]).max(0.0);
        format!(
            "  {name:<16} {:>9.3} {:>9.3}  {bar}",
            ms("median"),
            ms("p99")
        )
        .trim_end()
        .to_owned()
            + "\n"
    };
    let mut lines = format!("  {:<16} {:>9} {:>9}\n", "ms", "median", "p99");
    for (name, times) in &stages {
        let bar = "#".repeat((number(&times["median"]) / longest_ms * BAR_CHARS).round() as usize);
        lines.push_str(&row(name, times, &bar));
    }
    lines.push_str(&row("frame, GPU", &figures["frame_gpu_ms"], ""));
    // With several frames in flight this is how long one takes from submission to image, and not
    // the time between two.
    lines.push_str(&row("frame, latency", &figures["frame_wall_ms"], ""));
    lines
}

fn rates(figures: &Value) -> String {
    let (images, steps) = (
        number(&figures["images_per_s"]),
        number(&figures["rig_steps_per_s"]),
    );
    let required = &figures["required"];
    format!(
        "  {images:.1} images/s, {steps:.1} rig steps/s by the wall clock; {} visible splats in {} tile entries\n",
        required["records"], required["pairs"]
    )
}

fn memory(figures: &Value) -> String {
    let mebibytes = |value: &Value| number(value) / f64::from(1 << 20);
    let by_purpose = figures["memory_bytes"]["by_purpose"]
        .as_object()
        .into_iter()
        .flatten();
    let purposes: Vec<String> = by_purpose
        .map(|(purpose, bytes)| format!("{purpose} {:.1}", mebibytes(bytes)))
        .collect();
    format!(
        "  {:.1} MiB on the device: {}\n",
        mebibytes(&figures["memory_bytes"]["total"]),
        purposes.join(", ")
    )
}

/// A PSNR, which is null where two images are equal.
fn psnr_text(psnr_db: &Value) -> String {
    psnr_db
        .as_f64()
        .map_or("no error".to_owned(), |psnr| format!("{psnr:.2} dB"))
}

fn error(figures: &Value) -> String {
    let (error, difference) = (&figures["error"], &figures["error"]["difference"]);
    let mut lines = format!(
        "  against f64, {}x{} in the middle of {}: PSNR {}, max {:.6}\n",
        error["window_px"][2],
        error["window_px"][3],
        text(&error["camera"]),
        psnr_text(&difference["psnr_db"]),
        number(&difference["max_abs"])
    );
    for image in error["images"].as_array().into_iter().flatten() {
        let (difference, flips) = (&image["difference"], &image["flips"]);
        lines.push_str(&format!(
            "  against f64, all of {}: PSNR {}, max {:.6}; {} pixels ({:.1e}) off by more than {:.0e}, PSNR {} without them, {} without the worst {WORST_PIXELS}\n",
            text(&image["camera"]),
            psnr_text(&difference["psnr_db"]),
            number(&difference["max_abs"]),
            flips["pixels"],
            number(&flips["share"]),
            number(&error["flip_min"]),
            psnr_text(&flips["psnr_without_db"]),
            psnr_text(&flips["psnr_without_worst_db"]),
        ));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_are_called_by_their_names() {
        assert_eq!(rules_text(&Rules::INRIA), "inria");
        assert_eq!(
            rules_text(&Rules {
                antialias: true,
                ..Rules::DEFAULT
            }),
            "default, antialiased"
        );
        assert!(
            rules_text(&Rules {
                near_m: 3.5,
                ..Rules::DEFAULT
            })
            .contains("3.5")
        );
    }

    #[test]
    fn the_longest_stage_has_the_longest_bar() {
        let times = |median: f64| json!({ "median": median, "p99": 2.0 * median });
        let stages = json!([{ "name": "cull", "gpu_ms": times(0.5) }, { "name": "blend", "gpu_ms": times(1.5) }]);
        let chart = chart(
            &json!({ "stages": stages, "frame_gpu_ms": times(2.0), "frame_wall_ms": times(2.25) }),
        );
        let lines: Vec<Vec<&str>> = chart
            .lines()
            .map(|line| line.split_whitespace().collect())
            .collect();
        assert_eq!(
            lines[1],
            ["cull", "0.500", "1.000", "#".repeat(10).as_str()]
        );
        assert_eq!(
            lines[2],
            ["blend", "1.500", "3.000", "#".repeat(30).as_str()]
        );
        assert_eq!(lines[4], ["frame,", "latency", "2.250", "4.500"]);
    }
}
