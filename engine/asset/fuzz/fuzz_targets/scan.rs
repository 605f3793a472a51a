//! Any bytes as a sweep of a LiDAR, in each format.
#![no_main]

use decouplegs_asset::scan::{ScanFormat, decode};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    for format in [
        ScanFormat::Kitti,
        ScanFormat::NuScenes,
        ScanFormat::Npy,
        ScanFormat::Npz,
    ] {
        if let Ok(scan) = decode(format, bytes) {
            assert!(scan.points_m.iter().all(|point| point.is_finite()));
        }
    }
});
