//! Any bytes as an episode log, and any lines as its records behind good checksums: an error, or an
//! episode whose log is these bytes.
#![no_main]

use decouplegs_logs::episode_log::{decode, encode};
use libfuzzer_sys::fuzz_target;
use xxhash_rust::xxh3::xxh3_64;

/// `records`, one a line, each with its checksum: what a fuzzer would never guess.
fn sealed(records: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut before = "0".repeat(16);
    for record in records
        .split(|&byte| byte == b'\n')
        .filter(|record| !record.is_empty())
    {
        let checksum = format!("{:016x}", xxh3_64(&[before.as_bytes(), record].concat()));
        bytes.extend([checksum.as_bytes(), b" ", record, b"\n"].concat());
        before = checksum;
    }
    bytes
}

fuzz_target!(|bytes: &[u8]| {
    for bytes in [bytes.to_vec(), sealed(bytes)] {
        let Ok(episode) = decode(&bytes) else {
            continue;
        };
        let written = encode(&episode).expect("an episode that was read can be written");
        assert_eq!(
            decode(&written).as_ref(),
            Ok(&episode),
            "what was written is read the same"
        );
        // The scenario's text is taken as it stands; all that follows from the episode alone is
        // written the same.
        assert_eq!(
            encode(&decode(&written).expect("read above")).as_ref(),
            Ok(&written)
        );
    }
});
