//! Registers and shared memory of each kernel, by the driver, and how many of its workgroups fit a
//! multiprocessor.

use decouplegs::gpu::KernelReport;
use serde_json::{Value, json};

/// Limits of a streaming multiprocessor of NVIDIA's, for Vulkan: shared memory, bytes. CUDA gives
/// more. vendor-notes says how that was found.
const SHARED_BYTES: f64 = 49_152.0;
/// Registers of a multiprocessor.
const REGISTERS: f64 = 65_536.0;
/// Subgroups of 32 threads that it holds.
const SUBGROUPS: f64 = 64.0;
/// Workgroups that it holds.
const WORKGROUPS: f64 = 32.0;

/// Workgroups of `threads` that fit a multiprocessor, each thread with `registers`, each workgroup
/// with `shared_bytes`.
fn workgroups_that_fit(threads: f64, registers: f64, shared_bytes: f64) -> f64 {
    let subgroups = (threads / 32.0).ceil().max(1.0);
    // Registers are given to a subgroup in units of 256, and shared memory in units of 128 bytes.
    let by_registers = match registers {
        0.0 => f64::INFINITY,
        _ => (REGISTERS / ((registers * 32.0 / 256.0).ceil() * 256.0) / subgroups).floor(),
    };
    let by_memory = match shared_bytes {
        0.0 => f64::INFINITY,
        _ => (SHARED_BYTES / ((shared_bytes / 128.0).ceil() * 128.0)).floor(),
    };
    let by_threads = (SUBGROUPS / subgroups).floor();
    by_registers.min(by_memory).min(by_threads).min(WORKGROUPS)
}

/// Bytes per thread that found no register; `None` where the driver does not tell.
fn spilled_bytes(report: &KernelReport) -> Option<f64> {
    let told = report.figure(&["local"]);
    let told = told.or_else(|| report.figure(&["spill"]));
    // NVIDIA's driver 580 has another number in the upper 32 bits.
    told.map(|bytes| bytes % f64::from(1_u32 << 16).powi(2))
}

/// The reports as JSON.
pub fn figures(reports: &[KernelReport]) -> Value {
    let one = |report: &KernelReport| {
        let registers = report.figure(&["register"]);
        let shared_bytes = report.figure(&["shared"]);
        let fit = registers.map(|registers| {
            let shared_bytes = shared_bytes.unwrap_or(0.0);
            workgroups_that_fit(f64::from(report.workgroup_threads), registers, shared_bytes)
        });
        let constants = report.constants.iter();
        json!({
            "name": report.name,
            "workgroup_threads": report.workgroup_threads,
            "registers": registers,
            "shared_bytes": shared_bytes,
            "spilled_bytes": spilled_bytes(report),
            "workgroups_per_multiprocessor": fit,
            "constants": constants.map(|(name, value)| (name.clone(), json!(value.to_string()))).collect::<serde_json::Map<_, _>>(),
            "driver": report.figures.iter().map(|(name, value)| (name.clone(), json!(value))).collect::<serde_json::Map<_, _>>(),
        })
    };
    json!(reports.iter().map(one).collect::<Vec<_>>())
}

/// A table of the figures, a kernel a line.
pub fn to_text(figures: &Value) -> String {
    let kernels: Vec<&Value> = figures.as_array().into_iter().flatten().collect();
    if kernels.iter().all(|kernel| kernel["driver"] == json!({})) {
        return "  kernels: this driver does not tell registers and shared memory \
                (VK_KHR_pipeline_executable_properties)\n"
            .into();
    }
    let mut lines = format!(
        "  {:<22} {:>7} {:>9} {:>12} {:>13} {:>10}\n",
        "kernel", "threads", "registers", "shared bytes", "spilled bytes", "workgroups"
    );
    for kernel in kernels {
        let number = |key: &str| match kernel[key].as_f64() {
            Some(value) => format!("{value:.0}"),
            None => "-".into(),
        };
        lines.push_str(&format!(
            "  {:<22} {:>7} {:>9} {:>12} {:>13} {:>10}\n",
            kernel["name"].as_str().unwrap_or_default(),
            number("workgroup_threads"),
            number("registers"),
            number("shared_bytes"),
            number("spilled_bytes"),
            number("workgroups_per_multiprocessor"),
        ));
    }
    lines.push_str(
        "  workgroups: as many as fit one multiprocessor of 48 KB of shared memory, 64 K registers and 64 subgroups\n",
    );
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workgroups_are_limited_by_the_scarcest() {
        // Threads, registers, shared bytes.
        assert_eq!(workgroups_that_fit(256.0, 92.0, 47_440.0), 1.0);
        assert_eq!(workgroups_that_fit(256.0, 75.0, 13_600.0), 3.0);
        assert_eq!(workgroups_that_fit(256.0, 64.0, 10_496.0), 4.0);
        assert_eq!(workgroups_that_fit(256.0, 32.0, 0.0), 8.0);
        assert_eq!(workgroups_that_fit(32.0, 16.0, 0.0), 32.0);
        assert_eq!(workgroups_that_fit(256.0, 48.0, 24_844.0), 1.0);
    }

    #[test]
    fn a_driver_without_figures_is_named() {
        let report = KernelReport {
            name: "cull",
            workgroup_threads: 256,
            constants: Vec::new(),
            figures: Vec::new(),
        };
        assert!(to_text(&figures(std::slice::from_ref(&report))).contains("does not tell"));
        let report = KernelReport {
            figures: vec![
                ("Local Memory Size".into(), 68_719_476_768.0),
                ("Register Count".into(), 47.0),
                ("Shared Memory Size".into(), 1024.0),
            ],
            ..report
        };
        let text = to_text(&figures(&[report]));
        let line: Vec<&str> = text
            .lines()
            .nth(1)
            .unwrap_or_default()
            .split_whitespace()
            .collect();
        assert_eq!(line, ["cull", "256", "47", "1024", "32", "5"]);
    }
}
