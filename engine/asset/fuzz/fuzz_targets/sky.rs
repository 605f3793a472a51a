//! Any bytes as an image of a sky, of both kinds: an error, or a sky with finite colors.
#![no_main]

use decouplegs_asset::{SkyKind, sky_file};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    for kind in SkyKind::ALL {
        if let Ok(sky) = sky_file::decode(bytes, kind, Default::default()) {
            let values = sky.bordered_texels().as_flattened();
            assert!(values.iter().all(|value| value.is_finite()));
        }
    }
});
