//! Any bytes as a light transfer: an error, or one that makes finite colors and is written as it
//! was read.
#![no_main]

use decouplegs_asset::light_transfer_file;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(file) = light_transfer_file::decode(bytes) else {
        return;
    };
    let mut color = [[0.5; 3]; 16];
    file.transfer.at(&file.transfer.neutral).apply(&mut color);
    assert!(color.as_flattened().iter().all(|value| value.is_finite()));
    let written =
        light_transfer_file::encode(&file).expect("a transfer that was read can be written");
    assert_eq!(
        light_transfer_file::decode(&written).expect("what was written can be read"),
        file
    );
});
