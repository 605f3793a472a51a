//! A limit on the lines that clients can cause in the log.

use std::time::{Duration, Instant};

/// Length of the window in which lines are counted.
const WINDOW: Duration = Duration::from_secs(10);
/// Lines per window.
const LINES_MAX: u32 = 20;

/// Counts lines per window of 10 s. The first 20 are written, the others only counted.
#[derive(Default)]
pub struct LogLimit {
    since: Option<Instant>,
    lines: u32,
    suppressed: u64,
}

impl LogLimit {
    /// Number of lines suppressed since the last one, if one more line may be written now; else
    /// `None`.
    pub fn admit(&mut self) -> Option<u64> {
        self.admit_at(Instant::now())
    }

    fn admit_at(&mut self, now: Instant) -> Option<u64> {
        if self
            .since
            .is_none_or(|since| now.duration_since(since) >= WINDOW)
        {
            (self.since, self.lines) = (Some(now), 0);
        }
        if self.lines == LINES_MAX {
            self.suppressed += 1;
            return None;
        }
        self.lines += 1;
        Some(std::mem::take(&mut self.suppressed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_is_cut_and_counted() {
        let (mut limit, start) = (LogLimit::default(), Instant::now());
        let written = (0..1000)
            .filter(|_| limit.admit_at(start).is_some())
            .count();
        assert_eq!(written, 20);
        assert_eq!(limit.admit_at(start + WINDOW), Some(980));
        assert_eq!(limit.admit_at(start + WINDOW), Some(0));
    }
}
