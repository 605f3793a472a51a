//! Live episodes that are driven on, and the steps of clients that wait for it.

use serde_json::{Value, json};

use super::Viewer;
use crate::drive_thread::{Driven, Lent};
use crate::source::Source;

/// Steps that wait until they are driven.
const STEPS_MAX: usize = 64;

/// Step that a client waits for.
pub(super) struct WaitingStep {
    client: u64,
    /// Number of its command.
    sequence: u64,
    /// Time that is to be shown, seconds.
    time_s: f64,
}

impl Viewer {
    /// Drives the episodes that go on and are least far by one more step, unless that is under way.
    pub(super) fn begin_driving(&mut self) {
        if self.driving > 0 {
            return;
        }
        let reached_s = self.reached_s();
        for (index, source) in self.sources.iter_mut().enumerate() {
            if !source.goes_on() || source.span_s()[1] > reached_s {
                continue;
            }
            if let Some((number, live)) = source.lend() {
                self.driving += 1;
                self.drives.give(Lent {
                    source: index,
                    number,
                    live,
                });
            }
        }
    }

    /// Takes an episode back that was driven on.
    pub(super) fn take_driven(&mut self, driven: Driven) {
        let Driven { lent, result } = driven;
        self.driving -= 1;
        let has_step = result == Ok(true);
        // What is shown may have another source in its place by now.
        let source = self.sources.get_mut(lent.source);
        let Some(source) = source.filter(|source| source.episode().is_some()) else {
            return;
        };
        let taken = source.take_back(lent.number, lent.live, has_step);
        if let Err(error) = result.and(taken) {
            self.clock.playing = false;
            self.tell(&json!({"type": "error", "text": error}));
            self.end_steps(&Err(error));
        }
        if self.driving == 0 {
            self.tell_changes();
            // The moment before the step has a plan now, and its images have hashes.
            self.set_time(self.clock.time_s);
            self.serve_steps();
        }
    }

    /// Moves by steps and pauses. It is answered when the time is reached.
    pub(super) fn step(&mut self, client: u64, sequence: u64, by: i32) {
        self.clock.playing = false;
        let step_s = self.sources[0].step_s();
        let begin_s = self.span_s()[0];
        // Steps that follow each other add up, also those that wait.
        let waiting = self.steps.back().map(|step| step.time_s);
        let from_s = waiting.unwrap_or(self.clock.time_s);
        let step = ((from_s - begin_s) / step_s).round() + f64::from(by);
        let time_s = begin_s + step * step_s;
        let waits = time_s > self.reached_s() && self.sources.iter().any(Source::goes_on);
        if by > 0 && waits {
            if self.steps.len() >= STEPS_MAX {
                let reason = "too many steps wait for the planner: wait for it";
                self.answer(client, sequence, Err(reason.into()));
                return;
            }
            self.steps.push_back(WaitingStep {
                client,
                sequence,
                time_s,
            });
            self.begin_driving();
        } else {
            self.end_steps(&Ok(()));
            self.set_time(time_s);
            self.answer(client, sequence, Ok(Value::Null));
        }
    }

    /// Shows the steps that are reached, and drives on for those that are not.
    fn serve_steps(&mut self) {
        while let Some(step) = self.steps.pop_front() {
            if step.time_s > self.reached_s() && self.sources.iter().any(Source::goes_on) {
                self.steps.push_front(step);
                self.begin_driving();
                return;
            }
            self.set_time(step.time_s);
            self.answer(step.client, step.sequence, Ok(Value::Null));
        }
    }

    /// Answers the steps that wait: something else is shown, or they failed.
    pub(super) fn end_steps(&mut self, result: &Result<(), String>) {
        while let Some(step) = self.steps.pop_front() {
            let answer = result.clone().map(|()| Value::Null);
            self.answer(step.client, step.sequence, answer);
        }
    }
}
