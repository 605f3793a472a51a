//! Wall-clock times of steps.

use std::time::Duration;

use decouplegs::episode::StepTime;
use serde_json::{Map, Value, json};

use super::Scored;
use crate::page::{Page, Table};
use crate::progress::to_ms;

/// A part of a step, as reports call it, and its milliseconds.
type Part = (&'static str, fn(&StepTime) -> f64);

const PARTS: [Part; 7] = [
    ("draw", |time| to_ms(time.draw)),
    ("device", |time| to_ms(time.device)),
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

/// Steps of one kind: how many there are, and the parts of them.
struct Steps {
    count: usize,
    parts: Vec<Spread>,
}

/// Times of the steps that were driven in this run.
struct Timing {
    /// Steps of a device at work.
    at_work: Steps,
    /// Steps of a device that was idle before: its clocks are still low.
    waking: Steps,
}

/// Steps of an episode that are not counted: kernels are built and buffers grow.
const WARM_UP: usize = 2;

/// Time without drawing after which a device counts as idle.
const IDLE: Duration = Duration::from_millis(100);

/// Time that a device takes to raise its clocks after it was idle.
const WAKING: Duration = Duration::from_millis(300);

/// Steps of an episode, each with whether its device was idle shortly before. It is idle before an
/// episode, and while a planner or an observer takes its time.
fn told_apart(times: &[StepTime]) -> impl Iterator<Item = (&StepTime, bool)> {
    let mut busy = Duration::ZERO;
    let steps = times.iter().map(move |time| {
        let is_waking = busy < WAKING;
        let since = time.simulator() + time.plan;
        busy = match since - time.draw >= IDLE {
            true => Duration::ZERO,
            false => busy + since,
        };
        (time, is_waking)
    });
    steps.skip(WARM_UP)
}

impl Timing {
    /// Times of `scored`; `None` where no step was driven.
    fn from_scored(scored: &[Scored]) -> Option<Self> {
        let driven = scored.iter().filter_map(|scored| scored.times.as_ref());
        let steps = driven.flat_map(|times| told_apart(times));
        let (waking, at_work): (Vec<_>, Vec<_>) = steps.partition(|(_, is_waking)| *is_waking);
        let times = |steps: Vec<(&StepTime, bool)>| {
            let times: Vec<_> = steps.into_iter().map(|(time, _)| *time).collect();
            Steps::from_times(&times)
        };
        let timing = Self {
            at_work: times(at_work),
            waking: times(waking),
        };
        (timing.at_work.count + timing.waking.count > 0).then_some(timing)
    }

    /// Kinds of steps that there are, as reports call them.
    fn kinds(&self) -> impl Iterator<Item = (&'static str, &Steps)> {
        let kinds = [
            ("of a device at work", &self.at_work),
            ("of a device that was idle before", &self.waking),
        ];
        kinds.into_iter().filter(|(_, steps)| steps.count > 0)
    }
}

impl Steps {
    fn from_times(times: &[StepTime]) -> Self {
        let spread = |(name, part): Part| {
            let mut values: Vec<f64> = times.iter().map(part).collect();
            values.sort_by(f64::total_cmp);
            let at = |share: f64| values[((values.len() - 1) as f64 * share).ceil() as usize];
            Spread {
                name,
                p50_ms: at(0.5),
                p99_ms: at(0.99),
            }
        };
        let parts = match times {
            [] => Vec::new(),
            _ => PARTS.into_iter().map(spread).collect(),
        };
        Self {
            count: times.len(),
            parts,
        }
    }

    /// Number of steps, and the parts of them; `null` without steps.
    fn to_json(&self) -> Value {
        if self.count == 0 {
            return Value::Null;
        }
        let part = |part: &Spread| {
            let times = json!({ "p50_ms": part.p50_ms, "p99_ms": part.p99_ms });
            (part.name.to_owned(), times)
        };
        json!({ "steps": self.count, "parts": self.parts.iter().map(part).collect::<Map<String, Value>>() })
    }
}

/// Times of the steps of a device at work, and of those `waking` from idleness; `null` where no
/// step was driven.
pub fn to_json(scored: &[Scored]) -> Value {
    let Some(timing) = Timing::from_scored(scored) else {
        return Value::Null;
    };
    let mut all = timing.at_work.to_json();
    match all.as_object_mut() {
        Some(fields) => {
            fields.insert("waking".to_owned(), timing.waking.to_json());
            all
        }
        None => json!({ "steps": 0, "parts": {}, "waking": timing.waking.to_json() }),
    }
}

/// A line for each kind of step.
pub fn text(scored: &[Scored]) -> String {
    let Some(timing) = Timing::from_scored(scored) else {
        return String::new();
    };
    let line = |(kind, steps): (&str, &Steps)| {
        let part = |part: &Spread| format!("{} {:.2}/{:.2}", part.name, part.p50_ms, part.p99_ms);
        let parts: Vec<String> = steps.parts.iter().map(part).collect();
        format!(
            "ms per step, median/p99 over {} {kind}: {}\n",
            steps.count,
            parts.join(", ")
        )
    };
    timing.kinds().map(line).collect()
}

/// Adds those figures to a page.
pub fn part(page: &mut Page, scored: &[Scored]) {
    let Some(timing) = Timing::from_scored(scored) else {
        return;
    };
    page.heading("Time");
    page.text(&format!(
        "The first {WARM_UP} steps of each episode are left out. The simulator is all but the planner: poses, light, the frame \
         and its images on the host, sweeps of LiDARs (draw), of which the device takes a part for the images alone (device); what is left of hashing them when the planner is done (hash); ego and \
         traffic (advance); logs and images that are kept (keep). A device that drew nothing for {} s lowers its clocks: its steps in the next {} s \
         are told apart.",
        IDLE.as_secs_f64(),
        WAKING.as_secs_f64()
    ));
    let mut table = Table::new(["part", "steps", "median, ms", "p99, ms"]);
    for (kind, steps) in timing.kinds() {
        for part in &steps.parts {
            let times = [part.p50_ms, part.p99_ms].map(|time_ms| format!("{time_ms:.2}"));
            let count = format!("{} {kind}", steps.count);
            table.row([part.name.to_owned(), count].into_iter().chain(times));
        }
    }
    page.table(&table);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_after_an_idle_device_are_told_apart() {
        let step = |draw_ms, plan_ms| StepTime {
            draw: Duration::from_millis(draw_ms),
            plan: Duration::from_millis(plan_ms),
            ..StepTime::default()
        };
        let waking = |times: &[StepTime]| -> Vec<bool> {
            told_apart(times).map(|(_, is_waking)| is_waking).collect()
        };
        // 300 ms of steps of 50 ms; the first two are not counted.
        let mut times = vec![step(40, 10); 10];
        let expected = [true, true, true, true, false, false, false, false];
        assert_eq!(waking(&times), expected);
        // A planner that thinks lets the device sleep; a long drawing does not.
        times[7] = step(40, 100);
        times[9] = step(400, 99);
        let expected = [true, true, true, true, false, false, true, true];
        assert_eq!(waking(&times), expected);
        assert!(waking(&times[..1]).is_empty());
    }
}
