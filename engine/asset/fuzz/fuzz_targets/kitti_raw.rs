//! Any bytes as each file of a drive of KITTI's raw data.
#![no_main]

use decouplegs_asset::kitti_raw::{
    decode_calibration, decode_packet, decode_times, decode_tracklets,
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = decode_packet(bytes);
    if let Ok(times_s) = decode_times(bytes) {
        assert!(times_s.windows(2).all(|pair| pair[0] < pair[1]));
    }
    if let Ok(tracklets) = decode_tracklets(bytes) {
        assert!(tracklets.iter().all(|one| one.dims_m.iter().all(|side_m| *side_m > 0.0)));
    }
    if let Ok(calibration) = decode_calibration(bytes, bytes, bytes) {
        let _ = calibration.camera(2);
    }
});
