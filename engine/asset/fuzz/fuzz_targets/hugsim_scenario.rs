#![no_main]

//! A scenario of HUGSIM is read or refused.

use decouplegs_logs::hugsim_scenario;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = hugsim_scenario::decode(bytes);
});
