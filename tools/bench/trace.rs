//! Frames as a trace in Chrome's format: what host and queues did when.

use std::time::Instant;

use decouplegs::gpu::DeviceClock;
use decouplegs::render::FrameStatistics;
use serde_json::{Value, json};

/// Rows of the trace, by number.
const TRACKS: [(u32, &str); 4] = [(1, "host: submit"), (2, "host: wait"), (3, "main queue"), (4, "update queue")];

/// The trace of `frames`, whose device stood to the host as `clock` says. Times are microseconds from the first frame on.
pub fn chrome_trace(frames: &[FrameStatistics], clock: DeviceClock) -> Value {
    let origin = frames.first().map_or(clock.host, |frame| frame.submitted.0);
    let host_us = |at: Instant| signed_us(at, origin);
    let device_us = |ns: u64| (ns as f64 - clock.device_ns as f64) / 1e3 + signed_us(clock.host, origin);
    let named = |(track, name): &(u32, &str)| json!({ "ph": "M", "name": "thread_name", "pid": 1, "tid": track, "args": { "name": name } });
    let mut events: Vec<Value> = TRACKS.iter().map(named).collect();
    let mut add = |track: u32, name: &str, start_us: f64, duration_us: f64, frame: usize| {
        let args = json!({ "frame": frame });
        events.push(json!({
            "ph": "X", "name": name, "pid": 1, "tid": track, "ts": start_us, "dur": duration_us, "args": args,
        }));
    };
    for (index, frame) in frames.iter().enumerate() {
        for (track, name, (from, to)) in [(1, "submit", frame.submitted), (2, "wait", frame.awaited)] {
            add(track, &format!("{name} {index}"), host_us(from), host_us(to) - host_us(from), index);
        }
        for queue in &frame.queues {
            let track = if queue.queue == "main" { 3 } else { 4 };
            let begin_us = device_us(queue.begin_ns);
            add(track, &format!("frame {index}"), begin_us, queue.total_ns as f64 / 1e3, index);
            for stage in &queue.stages {
                add(track, stage.name, begin_us + stage.start_ns as f64 / 1e3, stage.duration_ns as f64 / 1e3, index);
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
