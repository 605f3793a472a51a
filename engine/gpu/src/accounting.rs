//! Bytes that buffers hold, by purpose.

use std::collections::BTreeMap;

use crate::MemoryReport;

/// Memory in use, by allocation tag.
#[derive(Debug, Default)]
pub(crate) struct Accounting {
    /// Bytes of each tag; tags that hold nothing are left out.
    bytes_by_purpose: BTreeMap<&'static str, u64>,
    /// Device-local share of the total.
    pub(crate) device_local_bytes: u64,
}

impl Accounting {
    pub(crate) fn report(&self) -> MemoryReport {
        let bytes_by_purpose = self.bytes_by_purpose.clone();
        let total_bytes = bytes_by_purpose.values().sum();
        MemoryReport {
            bytes_by_purpose,
            total_bytes,
            budget_bytes: None,
            driver_usage_bytes: None,
        }
    }

    pub(crate) fn add(&mut self, purpose: &'static str, bytes: u64, device_local: bool) {
        *self.bytes_by_purpose.entry(purpose).or_default() += bytes;
        self.device_local_bytes += if device_local { bytes } else { 0 };
    }

    pub(crate) fn remove(&mut self, purpose: &'static str, bytes: u64, device_local: bool) {
        self.device_local_bytes -= if device_local { bytes } else { 0 };
        let held = self.bytes_by_purpose.entry(purpose).or_default();
        *held -= bytes;
        if *held == 0 {
            self.bytes_by_purpose.remove(purpose);
        }
    }

    /// Sizes as a sentence lists them.
    pub(crate) fn used_by_purpose(&self) -> String {
        if self.bytes_by_purpose.is_empty() {
            return "nothing yet".into();
        }
        let texts: Vec<String> = self
            .bytes_by_purpose
            .iter()
            .map(|(purpose, bytes)| format!("{purpose} {bytes}"))
            .collect();
        texts.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn purposes_that_hold_nothing_are_left_out() {
        let mut accounting = Accounting::default();
        accounting.add("splats", 100, true);
        accounting.add("splats", 20, false);
        accounting.add("images", 3, true);
        assert_eq!(accounting.device_local_bytes, 103);
        assert_eq!(accounting.used_by_purpose(), "images 3, splats 120");
        accounting.remove("images", 3, true);
        assert_eq!(
            accounting.report().bytes_by_purpose,
            BTreeMap::from([("splats", 120)])
        );
        assert_eq!(accounting.report().total_bytes, 120);
    }
}
