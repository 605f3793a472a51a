//! The kernels that use subgroups, with subgroups of other sizes than this device's own.
//!
//! lavapipe's subgroups are as wide as its vectors, which `LP_NATIVE_VECTOR_WIDTH` sets for a
//! process: the tests run again, in children of this one.

use std::process::Command;

use decouplegs::gpu::DeviceKind;

use crate::device::Validated;

/// Tells a child which subgroup size to insist on.
pub const EXPECTED_LANES: &str = "DECOUPLEGS_EXPECTED_SUBGROUP_SIZE";

/// The tests that depend on the size, by the start of their names.
const TESTS: [&str; 4] = [
    "stages::scan::",
    "stages::tile_sort::",
    "stages::plan_segments::",
    "stages::blend::",
];
/// Least number of them.
const TESTS_MIN: usize = 20;

/// Output of a child process with `lanes` lanes, and true if it succeeded.
fn child(vector_bits: u32, lanes: u32, filters: &[&str]) -> (bool, String) {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(filters)
        .args(["--test-threads", "1"])
        .env("LP_NATIVE_VECTOR_WIDTH", vector_bits.to_string())
        .env(EXPECTED_LANES, lanes.to_string())
        .output()
        .unwrap();
    let text = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    (output.status.success(), text)
}

/// The number before ` passed` in a test runner's summary.
fn passed(text: &str) -> usize {
    let before = text.rsplit_once(" passed").map_or("", |(before, _)| before);
    before
        .rsplit(' ')
        .next()
        .and_then(|number| number.parse().ok())
        .unwrap_or(0)
}

/// Subgroup size of lavapipe. None: the device is another, which `test` says.
fn own_lanes(test: &str) -> Option<u32> {
    let gpu = Validated::open();
    let lavapipe = gpu.info().kind == DeviceKind::Cpu && gpu.info().name.contains("llvmpipe");
    if !lavapipe {
        println!(
            "SKIPPED {test}: the subgroups of {} cannot be set",
            gpu.info()
        );
    }
    lavapipe.then(|| gpu.limits().subgroup_size)
}

fn all_pass(test: &str, vector_bits: u32) {
    let lanes = vector_bits / 32;
    match own_lanes(test) {
        None => return,
        Some(own) if own == lanes => {
            println!("{test}: the size of this device, with which the tests run anyway");
            return;
        }
        Some(_) => {}
    }
    let (succeeded, text) = child(vector_bits, lanes, &TESTS);
    assert!(succeeded, "{vector_bits} bits:\n{text}");
    assert!(
        passed(&text) >= TESTS_MIN,
        "{vector_bits} bits ran too few tests:\n{text}"
    );
}

#[test]
fn four_lanes() {
    all_pass("four_lanes", 128);
}

#[test]
fn eight_lanes() {
    all_pass("eight_lanes", 256);
}

#[test]
fn sixteen_lanes() {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512f") {
        return all_pass("sixteen_lanes", 512);
    }
    println!("SKIPPED sixteen_lanes: this processor has no vectors of 512 bits");
}

#[test]
fn a_child_of_another_size_fails() {
    if own_lanes("a_child_of_another_size_fails").is_none() {
        return;
    }
    let (succeeded, text) = child(256, 4, &["stages::scan::counts_of_nothing"]);
    assert!(
        !succeeded && text.contains("subgroups of another size"),
        "{text}"
    );
    assert_eq!(
        (passed("test result: ok. 12 passed; 0 failed"), passed("")),
        (12, 0)
    );
}
