//! Any bytes as a light probe: an error, or radiance that can be integrated.
#![no_main]

use decouplegs_asset::probe;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(light) = probe::decode("probe", bytes) else {
        return;
    };
    assert_eq!(light.pixels().len(), light.width() * light.height());
    assert!(
        light
            .pixels()
            .as_flattened()
            .iter()
            .all(|value| value.is_finite() && *value >= 0.0)
    );
});
