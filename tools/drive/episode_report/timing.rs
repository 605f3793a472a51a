//! Wall-clock times of steps.

use decouplegs::episode::StepTime;
use serde_json::{Value, json};

use super::Scored;
use crate::page::{Page, Table};
use crate::progress::to_ms;

/// A part of a step, as reports call it, and its milliseconds.
type Part = (&'static str, fn(&StepTime) -> f64);

const PARTS: [Part; 6] = [
    ("draw", |time| to_ms(time.draw)),
    ("hash", |time| to_ms(time.hash)),
    ("advance", |time| to_ms(time.advance)),
    ("keep", |time| to_ms(time.observer)),
    ("simulator", |time| to_ms(time.simulator())),
    ("planner", |time| to_ms(time.plan)),
];

/// A part over many steps, milliseconds.
struct Spread {
    name: &'static str,
    p50_ms: f64,
    p99_ms: f64,
}

/// Steps of an episode that are not counted: kernels are built and buffers grow.
const WARM_UP: usize = 2;

/// Each part over the steps that were driven in this run, and how many these are.
fn parts(scored: &[Scored]) -> Option<(usize, Vec<Spread>)> {
    let driven = scored.iter().filter_map(|scored| scored.times.as_ref());
    let times: Vec<&StepTime> = driven
        .flat_map(|times| times.iter().skip(WARM_UP))
        .collect();
    if times.is_empty() {
        return None;
    }
    let of = |(name, part): Part| {
        let mut values: Vec<f64> = times.iter().map(|time| part(time)).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[((values.len() - 1) as f64 * share).ceil() as usize];
        Spread {
            name,
            p50_ms: at(0.5),
            p99_ms: at(0.99),
        }
    };
    Some((times.len(), PARTS.into_iter().map(of).collect()))
}

pub fn to_json(scored: &[Scored]) -> Value {
    parts(scored).map_or(Value::Null, |(steps, parts)| {
        let part = |part: Spread| (part.name.to_owned(), json!({ "p50_ms": part.p50_ms, "p99_ms": part.p99_ms }));
        json!({ "steps": steps, "parts": parts.into_iter().map(part).collect::<serde_json::Map<String, Value>>() })
    })
}

/// A line of it.
pub fn text(scored: &[Scored]) -> String {
    let Some((steps, parts)) = parts(scored) else {
        return String::new();
    };
    let parts: Vec<String> = parts
        .iter()
        .map(
            |Spread {
                 name,
                 p50_ms,
                 p99_ms,
             }| format!("{name} {p50_ms:.2}/{p99_ms:.2}"),
        )
        .collect();
    format!(
        "ms per step, median/p99 over {steps}: {}\n",
        parts.join(", ")
    )
}

/// Adds those figures to a page.
pub fn part(page: &mut Page, scored: &[Scored]) {
    let Some((steps, parts)) = parts(scored) else {
        return;
    };
    page.heading("Time");
    page.text(&format!(
        "Over {steps} steps, the first {WARM_UP} of each episode left out. The simulator is all but the planner: poses, light, the frame \
         and its images on the host, sweeps of LiDARs (draw); what is left of hashing them when the planner is done (hash); ego and \
         traffic (advance); logs and images that are kept (keep)."
    ));
    let mut table = Table::new(["part", "median, ms", "p99, ms"]);
    for part in parts {
        let times = [part.p50_ms, part.p99_ms].map(|time_ms| format!("{time_ms:.2}"));
        table.row(std::iter::once(part.name.to_owned()).chain(times));
    }
    page.table(&table);
}
