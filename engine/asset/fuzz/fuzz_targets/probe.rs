//! Any bytes as a light probe: an error, or radiance that can be integrated.
#![no_main]

use decouplegs_asset::calibrate::Probe;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(probe) = Probe::decode("probe", bytes) else {
        return;
    };
    assert_eq!(probe.pixels().len(), probe.width() * probe.height());
    assert!(
        probe
            .pixels()
            .as_flattened()
            .iter()
            .all(|value| value.is_finite() && *value >= 0.0)
    );
});
