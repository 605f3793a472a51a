//! Any bytes as an OpenSCENARIO file, which is also its own catalog, and as an expression in one.
#![no_main]

use decouplegs_logs::open_scenario;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(scenario) = open_scenario::decode(bytes, |_| Some(bytes.to_vec())) {
        assert!(scenario.entities.iter().all(|entity| entity.size.length_m >= 0.1));
    }
    if let Ok(text) = std::str::from_utf8(bytes)
        && !text.contains(['"', '<', '&'])
    {
        let file = include_str!("../seeds/open_scenario/cut_in.xosc");
        let with = file.replace("value=\"20\"", &format!("value=\"${{{text}}}\""));
        let _ = open_scenario::decode(with.as_bytes(), |_| None);
    }
});
