//! Faults of a device on purpose, to test what a program does about them.

use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use ash::vk;

use crate::GpuError;

/// A fault that a device has on purpose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drill {
    /// The device is lost: each submission fails but the first ones, which are this many.
    Lost(u64),
    /// The memory of the device is used up: no buffer can be made after this many submissions.
    Full(u64),
    /// One call of a Vulkan function says that the device is lost, after this many calls; the
    /// others go on.
    CallLost(u64),
    /// One call of a Vulkan function says that memory is used up, after this many calls; the others
    /// go on.
    CallFull(u64),
    /// The device has this much memory, bytes, or less.
    Heap(u64),
}

impl FromStr for Drill {
    type Err = String;

    /// A drill from `lost:N`, `full:N`, `call-lost:N`, `call-full:N` or `heap:BYTES`, N what
    /// succeeds before it.
    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once(':').and_then(|(fault, count)| {
            let count = count.parse().ok()?;
            match fault {
                "lost" => Some(Self::Lost(count)),
                "full" => Some(Self::Full(count)),
                "call-lost" => Some(Self::CallLost(count)),
                "call-full" => Some(Self::CallFull(count)),
                "heap" => Some(Self::Heap(count)),
                _ => None,
            }
        });
        parsed.ok_or_else(|| {
            format!(
                "expected lost:N or full:N, N a number of submissions, call-lost:N or call-full:N, N a number of calls, or heap:BYTES, found {text:?}"
            )
        })
    }
}

/// A drill under way.
pub(crate) struct DrillState {
    drill: Drill,
    /// Submissions that were asked for.
    submissions: AtomicU64,
    /// Names of the calls that were asked for, where calls fail.
    calls: Mutex<Vec<&'static str>>,
}

impl DrillState {
    pub(crate) fn new(drill: Drill) -> Self {
        Self {
            drill,
            submissions: AtomicU64::new(0),
            calls: Mutex::default(),
        }
    }

    /// Counts a submission before it is made. Fails if the device is lost by then. Earlier
    /// submissions are carried out, so that their memory can be freed safely.
    pub(crate) fn submission(&self) -> Result<(), GpuError> {
        let before = self.submissions.fetch_add(1, Ordering::Relaxed);
        match self.drill {
            Drill::Lost(count) if before >= count => Err(GpuError::DeviceLost {
                during: "vkQueueSubmit2",
                progress: "a drill asked for it".into(),
            }),
            _ => Ok(()),
        }
    }

    /// True if no memory is to be had by now.
    pub(crate) fn is_full(&self) -> bool {
        matches!(self.drill, Drill::Full(count) if self.submissions.load(Ordering::Relaxed) >= count)
    }

    /// Counts a call of the Vulkan function `name` before it is made; its result if it is the one
    /// that fails.
    pub(crate) fn call(&self, name: &'static str) -> Option<vk::Result> {
        let (count, code) = match self.drill {
            Drill::CallLost(count) => (count, vk::Result::ERROR_DEVICE_LOST),
            Drill::CallFull(count) => (count, vk::Result::ERROR_OUT_OF_DEVICE_MEMORY),
            Drill::Lost(_) | Drill::Full(_) | Drill::Heap(_) => return None,
        };
        let mut calls = self.calls.lock().unwrap_or_else(PoisonError::into_inner);
        calls.push(name);
        (calls.len() as u64 == count.saturating_add(1)).then_some(code)
    }

    /// Names of the calls so far.
    pub(crate) fn calls(&self) -> Vec<&'static str> {
        let calls = self.calls.lock();
        calls.unwrap_or_else(PoisonError::into_inner).clone()
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
        for text in [
            "", "lost", "lost:", "lost:-1", "gone:1", "full:1:2", "heap:1G",
        ] {
            assert!(text.parse::<Drill>().unwrap_err().contains(text), "{text}");
        }
    }
    #[test]
    fn one_call_fails_and_no_other() {
        for (drill, code) in [
            ("call-lost:2", vk::Result::ERROR_DEVICE_LOST),
            ("call-full:2", vk::Result::ERROR_OUT_OF_DEVICE_MEMORY),
        ] {
            let state = DrillState::new(drill.parse().unwrap());
            let codes = ["a", "b", "c", "d"].map(|name| state.call(name));
            assert_eq!(codes, [None, None, Some(code), None]);
            assert_eq!(state.calls(), ["a", "b", "c", "d"]);
            assert!(state.submission().is_ok() && !state.is_full());
        }
        assert_eq!("heap:1024".parse(), Ok(Drill::Heap(1024)));
    }
}
