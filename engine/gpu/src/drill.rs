//! Faults of a device on purpose, to test what a program does about them.

use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::GpuError;

/// A fault that a device has from a submission on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drill {
    /// Kind of the fault.
    pub fault: DeviceFault,
    /// Submissions of the device that succeed before it.
    pub submissions: u64,
}

/// Kind of a fault after which a device cannot go on with its work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceFault {
    /// The device is lost: each submission fails.
    Lost,
    /// The memory of the device is used up: no buffer can be made.
    Full,
}

impl FromStr for Drill {
    type Err = String;

    /// A drill from `lost:N` or `full:N`, N the submissions before it.
    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once(':').and_then(|(fault, submissions)| {
            let fault = match fault {
                "lost" => DeviceFault::Lost,
                "full" => DeviceFault::Full,
                _ => return None,
            };
            Some(Self {
                fault,
                submissions: submissions.parse().ok()?,
            })
        });
        parsed.ok_or_else(|| {
            format!("expected lost:N or full:N, N a number of submissions, found {text:?}")
        })
    }
}

/// A drill under way.
pub(crate) struct DrillState {
    drill: Drill,
    /// Submissions that were asked for.
    asked: AtomicU64,
}

impl DrillState {
    pub(crate) fn new(drill: Drill) -> Self {
        Self {
            drill,
            asked: AtomicU64::new(0),
        }
    }

    /// Counts a submission before it is made. Fails if the device is lost by then. Earlier
    /// submissions are carried out, so that their memory can be freed safely.
    pub(crate) fn submission(&self) -> Result<(), GpuError> {
        let before = self.asked.fetch_add(1, Ordering::Relaxed);
        if self.drill.fault == DeviceFault::Lost && before >= self.drill.submissions {
            return Err(GpuError::DeviceLost {
                during: "vkQueueSubmit2",
                progress: "a drill asked for it".into(),
            });
        }
        Ok(())
    }

    /// True if no memory is to be had by now.
    pub(crate) fn is_full(&self) -> bool {
        self.drill.fault == DeviceFault::Full
            && self.asked.load(Ordering::Relaxed) >= self.drill.submissions
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drill_begins_after_its_submissions() {
        let lost = DrillState::new("lost:2".parse().unwrap());
        let submitted: Vec<bool> = (0..4).map(|_| lost.submission().is_ok()).collect();
        assert_eq!(submitted, [true, true, false, false]);
        assert!(!lost.is_full());
        let full = DrillState::new("full:1".parse().unwrap());
        assert!(!full.is_full());
        assert!(full.submission().is_ok() && full.is_full() && full.submission().is_ok());
        for text in ["", "lost", "lost:", "lost:-1", "gone:1", "full:1:2"] {
            assert!(text.parse::<Drill>().unwrap_err().contains(text), "{text}");
        }
    }
}
