//! Frames as a trace in Chrome's format: what host and queues did when.

use std::time::Instant;

use decouplegs::gpu::DeviceClock;
use decouplegs::render::FrameStatistics;
use serde_json::{Value, json};

/// Rows of the trace, by number.
const TRACKS: [(u32, &str); 4] = [
    (1, "host: submit"),
    (2, "host: wait"),
    (3, "main queue"),
    (4, "update queue"),
];

/// Frames that the image of a trace shows.
const FRAMES_SHOWN: usize = 3;

/// Colors of stages in the image, in turn: neighbors differ.
const COLORS: [&str; 6] = [
    "#4e79a7", "#f28e2b", "#59a14f", "#e15759", "#b07aa1", "#76b7b2",
];

/// A trace from [`chrome_trace`] as an image: [`FRAMES_SHOWN`] frames from its middle, a row for
/// the host and each queue.
pub fn image(trace: &Value) -> String {
    let events: Vec<&Value> = trace["traceEvents"]
        .as_array()
        .into_iter()
        .flatten()
        .filter(|event| event["ph"] == "X")
        .collect();
    let frame_of = |event: &Value| event["args"]["frame"].as_u64().unwrap_or(0) as usize;
    let frames = events
        .iter()
        .map(|event| frame_of(event) + 1)
        .max()
        .unwrap_or(0);
    let first = (frames.saturating_sub(FRAMES_SHOWN)) / 2;
    let shown: Vec<&Value> = events
        .into_iter()
        .filter(|event| (first..first + FRAMES_SHOWN).contains(&frame_of(event)))
        .collect();
    let start = |event: &Value| event["ts"].as_f64().unwrap_or(0.0);
    let length = |event: &Value| event["dur"].as_f64().unwrap_or(0.0);
    let from_us = shown
        .iter()
        .map(|event| start(event))
        .fold(f64::INFINITY, f64::min);
    let to_us = shown
        .iter()
        .map(|event| start(event) + length(event))
        .fold(from_us + 1.0, f64::max);
    let x = |us: f64| 130.0 + (us - from_us) / (to_us - from_us) * 1050.0;
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 1200 230\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"1200\" height=\"230\" fill=\"white\"/>\n",
    );
    for (track, name) in TRACKS {
        svg += &format!("<text x=\"8\" y=\"{}\">{name}</text>\n", 15 + 45 * track);
    }
    for (index, event) in shown.iter().enumerate() {
        let (name, track) = (
            event["name"].as_str().unwrap_or_default(),
            event["tid"].as_f64().unwrap_or(0.0),
        );
        // The frame as a whole is the thin line above its stages.
        let whole = name.starts_with("frame ");
        let (y, height, color) = if whole {
            (45.0 * track - 7.0, 4.0, "#444444")
        } else {
            (
                45.0 * track,
                24.0,
                COLORS[if track < 3.0 {
                    frame_of(event) % 2
                } else {
                    index % COLORS.len()
                }],
            )
        };
        let width = x(start(event) + length(event)) - x(start(event));
        svg += &format!(
            "<rect x=\"{:.1}\" y=\"{y}\" width=\"{width:.1}\" height=\"{height}\" fill=\"{color}\">",
            x(start(event))
        );
        svg += &format!("<title>{name}, {:.0} us</title></rect>\n", length(event));
        if !whole && width > 7.0 * name.len() as f64 {
            svg += &format!(
                "<text x=\"{:.1}\" y=\"{}\" fill=\"white\">{name}</text>\n",
                x(start(event)) + 3.0,
                y + 16.0
            );
        }
    }
    svg + &format!(
        "<text x=\"1180\" y=\"20\" text-anchor=\"end\">{:.2} ms</text>\n</svg>\n",
        (to_us - from_us) / 1e3
    )
}

/// The trace of `frames`, whose device stood to the host as `clock` says. Times are microseconds
/// from the first frame on.
pub fn chrome_trace(frames: &[FrameStatistics], clock: DeviceClock) -> Value {
    let origin = frames.first().map_or(clock.host, |frame| frame.submitted.0);
    let host_us = |at: Instant| signed_us(at, origin);
    let device_us =
        |ns: u64| (ns as f64 - clock.device_ns as f64) / 1e3 + signed_us(clock.host, origin);
    let named = |(track, name): &(u32, &str)| json!({ "ph": "M", "name": "thread_name", "pid": 1, "tid": track, "args": { "name": name } });
    let mut events: Vec<Value> = TRACKS.iter().map(named).collect();
    let mut add = |track: u32, name: &str, start_us: f64, duration_us: f64, frame: usize| {
        let args = json!({ "frame": frame });
        events.push(json!({
            "ph": "X", "name": name, "pid": 1, "tid": track, "ts": start_us, "dur": duration_us, "args": args,
        }));
    };
    for (index, frame) in frames.iter().enumerate() {
        for (track, name, (from, to)) in
            [(1, "submit", frame.submitted), (2, "wait", frame.awaited)]
        {
            add(
                track,
                &format!("{name} {index}"),
                host_us(from),
                host_us(to) - host_us(from),
                index,
            );
        }
        for queue in &frame.queues {
            let track = if queue.queue == "main" { 3 } else { 4 };
            let begin_us = device_us(queue.begin_ns);
            add(
                track,
                &format!("frame {index}"),
                begin_us,
                queue.total_ns as f64 / 1e3,
                index,
            );
            for stage in &queue.stages {
                add(
                    track,
                    stage.name,
                    begin_us + stage.start_ns as f64 / 1e3,
                    stage.duration_ns as f64 / 1e3,
                    index,
                );
            }
        }
    }
    json!({
        "traceEvents": events,
        "displayTimeUnit": "ms",
        "otherData": { "clock_uncertainty_us": clock.uncertainty.as_secs_f64() * 1e6 },
    })
}

fn signed_us(at: Instant, origin: Instant) -> f64 {
    let after = at.saturating_duration_since(origin).as_secs_f64();
    (after - origin.saturating_duration_since(at).as_secs_f64()) * 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_shows_the_frames_in_the_middle() {
        let event = |frame: usize, tid: u32, name: &str| {
            let args = json!({ "frame": frame });
            json!({ "ph": "X", "name": name, "pid": 1, "tid": tid, "ts": 100.0 * frame as f64, "dur": 90.0, "args": args })
        };
        let events: Vec<Value> = (0..7)
            .flat_map(|frame| {
                [
                    event(frame, 3, &format!("blend {frame}")),
                    event(frame, 4, "agents"),
                ]
            })
            .collect();
        let svg = image(&json!({ "traceEvents": events }));
        for (frame, shown) in [(1, false), (2, true), (4, true), (5, false)] {
            assert_eq!(
                svg.contains(&format!("blend {frame},")),
                shown,
                "frame {frame}"
            );
        }
        assert!(svg.contains("update queue") && svg.ends_with("</svg>\n"));
        assert!(
            image(&json!({})).ends_with("</svg>\n"),
            "a trace of nothing is an empty image"
        );
    }
}
