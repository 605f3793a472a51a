//! Ticket of submitted work: waits for it and reads its times.

use std::sync::{
    Arc, OnceLock,
    atomic::{AtomicUsize, Ordering},
};

use crate::{GpuError, queue::Queue, slot::CommandSlot};

/// Duration of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageTime {
    /// The stage's name.
    pub name: &'static str,
    /// Time from the start of its command buffer, nanoseconds.
    pub start_ns: u64,
    /// Time from its start until its last command was done, nanoseconds.
    pub duration_ns: u64,
}

/// Submitted work. Clones stand for the same work.
#[derive(Clone)]
pub struct Ticket {
    pub(crate) queue: Arc<Queue>,
    /// Value of the queue's timeline when the work is done.
    pub(crate) value: u64,
    pub(crate) submission: Arc<Submission>,
}

impl std::fmt::Debug for Ticket {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "submission {}", self.value)
    }
}

impl Ticket {
    /// Waits until the work is done. What it wrote to readback buffers can be read then.
    ///
    /// # Errors
    /// Returns an error if the device is lost, or did not finish in minutes; both name the last
    /// stage known to have finished.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.queue.wait(self.value, &self.submission)
    }

    /// True if it was submitted as it had been recorded for earlier work.
    #[must_use]
    pub fn is_repeated(&self) -> bool {
        self.submission.repeated
    }

    /// Value of the queue's timeline ([`crate::Gpu::export_timeline`]) when the work is done.
    #[must_use]
    pub fn value(&self) -> u64 {
        self.value
    }

    /// True if the work is done, without waiting.
    ///
    /// # Errors
    /// Returns an error if the device is lost.
    pub fn is_done(&self) -> Result<bool, GpuError> {
        self.queue.is_done(self.value)
    }

    /// Start and end of each stage, in the order recorded; empty unless
    /// [`crate::Recorder::time_stages`] asked for them. Waits for the work.
    ///
    /// # Errors
    /// Returns the errors of [`Ticket::wait`], and [`GpuError::MissingFeature`] without timestamps.
    pub fn stage_times(&self) -> Result<Vec<StageTime>, GpuError> {
        self.times().map(|times| times.stages.clone())
    }

    /// Duration of the whole command buffer, nanoseconds; waits for the work.
    ///
    /// # Errors
    /// Returns the errors of [`Ticket::wait`], and [`GpuError::MissingFeature`] without timestamps.
    pub fn gpu_time_ns(&self) -> Result<u64, GpuError> {
        self.times().map(|times| times.total_ns)
    }

    /// Start of the command buffer, in nanoseconds of the device's clock, which all queues share;
    /// waits for the work.
    ///
    /// # Errors
    /// Returns the errors of [`Ticket::wait`], and [`GpuError::MissingFeature`] without timestamps.
    pub fn begin_ns(&self) -> Result<u64, GpuError> {
        self.times().map(|times| times.begin_ns)
    }

    fn times(&self) -> Result<&Times, GpuError> {
        self.wait()?;
        let times = self.submission.times.get().and_then(Option::as_ref);
        times.ok_or_else(|| GpuError::MissingFeature {
            device: self.queue.context.info.name.clone(),
            feature: "timestamps on this queue (timestampValidBits)".into(),
            needed_by: "timing of stages".into(),
        })
    }
}

/// Progress of work whose stages are not timed.
const NOT_TIMED: &str = "which stage ran is not known, as stages were not timed (`decouplegs bench` times them, and RenderOptions::stage_times)";

/// Submission record that outlives its command buffer.
pub(crate) struct Submission {
    stages: Arc<[&'static str]>,
    /// True if they are timed.
    timed: bool,
    /// True if it was recorded for earlier work.
    repeated: bool,
    /// Stages known to have finished.
    finished: AtomicUsize,
    /// Set once the work is done; `None` inside where there are no timestamps.
    times: OnceLock<Option<Times>>,
}

struct Times {
    begin_ns: u64,
    total_ns: u64,
    stages: Vec<StageTime>,
}

impl Submission {
    pub(crate) fn new(stages: Arc<[&'static str]>, timed: bool, repeated: bool) -> Self {
        Self {
            stages,
            timed,
            repeated,
            finished: AtomicUsize::new(0),
            times: OnceLock::new(),
        }
    }

    /// Takes the times over from `slot`, whose work is done. `valid_bits` of a timestamp count, a
    /// tick takes `period_ns`.
    pub(crate) fn finish(&self, slot: &CommandSlot, valid_bits: u32, period_ns: f32) {
        let timed = if self.timed { &self.stages[..] } else { &[] };
        let times = times(timed, &slot.ticks(), valid_bits, period_ns);
        self.finished.store(self.stages.len(), Ordering::Relaxed);
        // Set once: the thread that retires the slot has taken it out of the queue.
        let _ = self.times.set(times);
    }

    /// Looks how far the device is with `slot`, whose work may still run.
    pub(crate) fn look(&self, slot: &CommandSlot) {
        let ticks = slot.ticks();
        let finished = (0..self.stages.len())
            .take_while(|stage| ticks.get(3 + 2 * stage).is_some_and(Option::is_some))
            .count();
        self.finished.fetch_max(finished, Ordering::Relaxed);
    }

    /// Known progress of the work, as a clause.
    pub(crate) fn progress(&self) -> String {
        if !self.timed {
            return NOT_TIMED.into();
        }
        let finished = self.finished.load(Ordering::Relaxed);
        let next = self
            .stages
            .get(finished)
            .map_or_else(String::new, |next| format!(", the next is '{next}'"));
        match finished
            .checked_sub(1)
            .and_then(|last| self.stages.get(last))
        {
            Some(last) => format!("the last stage known to have finished is '{last}'{next}"),
            None => format!("no stage is known to have finished{next}"),
        }
    }
}

/// Ticks count in `valid_bits` bits and start anywhere, so only differences mean something, and
/// they wrap.
fn times(
    names: &[&'static str],
    ticks: &[Option<u64>],
    valid_bits: u32,
    period_ns: f32,
) -> Option<Times> {
    let start = (*ticks.first()?)?;
    let mask = if valid_bits >= 64 {
        u64::MAX
    } else {
        (1 << valid_bits) - 1
    };
    let since = |from: u64, tick: u64| {
        ((tick.wrapping_sub(from) & mask) as f64 * f64::from(period_ns)) as u64
    };
    let stage = |(i, &name): (usize, &&'static str)| {
        let (from, to) = (ticks[2 + 2 * i]?, ticks[3 + 2 * i]?);
        Some(StageTime {
            name,
            start_ns: since(start, from),
            duration_ns: since(from, to),
        })
    };
    let stages = names
        .iter()
        .enumerate()
        .map(stage)
        .collect::<Option<Vec<_>>>()?;
    let begin_ns = ((start & mask) as f64 * f64::from(period_ns)) as u64;
    Some(Times {
        begin_ns,
        total_ns: since(start, ticks[1]?),
        stages,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_wraps_gives_the_same_times() {
        let expected = [
            StageTime {
                name: "project",
                start_ns: 20,
                duration_ns: 40,
            },
            StageTime {
                name: "blend",
                start_ns: 60,
                duration_ns: 200,
            },
        ];
        for (start, bits) in [(100, 64), ((1 << 36) - 15, 36), (u64::MAX - 3, 64)] {
            let mask = if bits == 64 {
                u64::MAX
            } else {
                (1 << bits) - 1
            };
            // Bits above the valid ones mean nothing: set them.
            let tick = |ticks: u64| Some(u64::wrapping_add(start, ticks) & mask | !mask);
            let ticks = [tick(0), tick(140), tick(10), tick(30), tick(30), tick(130)];
            let times = times(&["project", "blend"], &ticks, bits, 2.0).unwrap();
            assert_eq!(
                (times.total_ns, times.stages.as_slice()),
                (280, &expected[..]),
                "{bits} bits from {start}"
            );
        }
    }

    #[test]
    fn no_timestamps_are_no_times() {
        assert!(times(&["project"], &[], 0, 1.0).is_none());
        assert!(times(&["project"], &[Some(0), None, Some(1), Some(2)], 64, 1.0).is_none());
    }

    #[test]
    fn progress_of_stages_that_are_not_timed_is_not_claimed() {
        let submission = Submission::new(Arc::new(["project"]), false, false);
        assert_eq!(submission.progress(), NOT_TIMED);
    }

    #[test]
    fn progress_names_the_last_stage_and_the_next() {
        let submission = Submission::new(Arc::new(["project", "sort", "blend"]), true, false);
        assert_eq!(
            submission.progress(),
            "no stage is known to have finished, the next is 'project'"
        );
        submission.finished.store(2, Ordering::Relaxed);
        assert_eq!(
            submission.progress(),
            "the last stage known to have finished is 'sort', the next is 'blend'"
        );
        submission.finished.store(3, Ordering::Relaxed);
        assert_eq!(
            submission.progress(),
            "the last stage known to have finished is 'blend'"
        );
    }
}
