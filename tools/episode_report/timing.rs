//! What steps took by the clock on the wall.

use decouplegs::episode::StepTime;
use serde_json::{Value, json};

use super::Scored;
use crate::drive::to_ms;

/// Parts of a step, as reports call them.
const PARTS: [(&str, fn(&StepTime) -> f64); 7] = [
    ("draw", |time| to_ms(time.draw)),
    ("read", |time| to_ms(time.read)),
    ("hash", |time| to_ms(time.hash)),
    ("advance", |time| to_ms(time.advance)),
    ("keep", |time| to_ms(time.witness)),
    ("simulator", |time| to_ms(time.simulator())),
    ("planner", |time| to_ms(time.plan)),
];

/// Steps of an episode that are not counted: kernels are built and buffers grow.
const WARM_UP: usize = 2;

/// The median and the 99th percentile of each part, milliseconds, over the steps that were driven in this run.
fn parts(scored: &[Scored]) -> Option<(usize, Vec<(&'static str, f64, f64)>)> {
    let times: Vec<&StepTime> =
        scored.iter().filter_map(|scored| scored.times.as_ref()).flat_map(|times| times.iter().skip(WARM_UP)).collect();
    if times.is_empty() {
        return None;
    }
    let of = |(name, part): (&'static str, fn(&StepTime) -> f64)| {
        let mut values: Vec<f64> = times.iter().map(|time| part(time)).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[((values.len() - 1) as f64 * share).ceil() as usize];
        (name, at(0.5), at(0.99))
    };
    Some((times.len(), PARTS.into_iter().map(of).collect()))
}

pub fn to_json(scored: &[Scored]) -> Value {
    parts(scored).map_or(Value::Null, |(steps, parts)| {
        let parts: serde_json::Map<String, Value> =
            parts.into_iter().map(|(name, p50, p99)| (name.into(), json!({ "p50_ms": p50, "p99_ms": p99 }))).collect();
        json!({ "steps": steps, "parts": parts })
    })
}

/// A line of it.
pub fn text(scored: &[Scored]) -> String {
    let Some((steps, parts)) = parts(scored) else { return String::new() };
    let parts: Vec<String> = parts.iter().map(|(name, p50, p99)| format!("{name} {p50:.2}/{p99:.2}")).collect();
    format!("ms a step, median/p99 over {steps}: {}\n", parts.join(", "))
}

/// The same as a table of a page.
pub fn table(scored: &[Scored]) -> String {
    let Some((steps, parts)) = parts(scored) else { return String::new() };
    let rows: String = parts.iter().map(|(name, p50, p99)| format!("<tr><td>{name}<td>{p50:.2}<td>{p99:.2}")).collect();
    format!(
        "<h2>Time</h2><p>Over {steps} steps, the first {WARM_UP} of each episode left out. The simulator is all but the planner: poses, light and \
         the frame (draw); its pictures, back on the host (read); what is left of hashing them when the planner is done (hash); ego and traffic \
         (advance); logs and pictures that are kept (keep).</p>\
         <table><tr><th>part<th>median, ms<th>p99, ms{rows}</table>"
    )
}
