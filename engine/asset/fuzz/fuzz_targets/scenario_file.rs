//! Any text as a scenario file: an error, or a scenario that survives being written and read.
#![no_main]

use decouplegs_logs::scenario_file;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let Ok(scenario) = scenario_file::parse(text) else {
        return;
    };
    let written =
        scenario_file::to_toml(&scenario).expect("a scenario that was read can be written");
    assert_eq!(
        scenario_file::parse(&written).expect("what was written can be read"),
        scenario
    );
});
