//! Broken files: an error or another cloud, never a panic or a hang. What memory they take is
//! measured in `memory.rs`.

use decouplegs_asset::{DecodeError, inria_ply, splat, spz};
use decouplegs_scene::SplatCloud;

use crate::sample::{self, cloud};

/// Splats that a file may give: every one is paid for with a byte, beyond a floor.
fn within_means(cloud: &SplatCloud, file_bytes: usize) -> bool {
    cloud.len() <= 16_384 + file_bytes
}

#[test]
fn a_file_cut_anywhere_is_an_error() {
    for (name, bytes, read) in sample::files() {
        assert!(read(&bytes).is_ok(), "{name}: the whole file must be read");
        for length in 0..bytes.len() {
            let result = read(&bytes[..length]);
            // .splat has no count: whole splats that are left are a file.
            let is_whole = name.ends_with(".splat") && length > 0 && length % 32 == 0;
            assert_eq!(
                result.is_ok(),
                is_whole,
                "{name} cut to {length} of {} bytes: {result:?}",
                bytes.len()
            );
        }
    }
}

#[test]
fn a_flipped_bit_never_panics() {
    for (name, bytes, read) in sample::files() {
        let mut refused = 0;
        let mut bytes = bytes;
        for bit in 0..bytes.len() * 8 {
            bytes[bit / 8] ^= 1 << (bit % 8);
            match read(&bytes) {
                Ok(cloud) => assert!(
                    within_means(&cloud, bytes.len()),
                    "{name}, bit {bit}: {} splats",
                    cloud.len()
                ),
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().is_empty());
                }
            }
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        // Headers are checked, so some flips must be noticed; bits of a .splat are all data.
        assert_eq!(
            refused > 0,
            !name.ends_with(".splat"),
            "{name}: {refused} flips refused"
        );
    }
}

#[test]
fn trailing_bytes_are_refused_where_the_format_knows_its_end() {
    for (name, mut bytes, read) in sample::files()
        .into_iter()
        .filter(|(name, ..)| name.ends_with(".v4.spz"))
    {
        bytes.push(0);
        assert!(
            read(&bytes).unwrap_err().to_string().contains("follow"),
            "{name}"
        );
    }
    let long = sample::spz_gzip(3, 1, 0, 12, &[0; 21]);
    assert!(
        spz::decode(&long)
            .unwrap_err()
            .to_string()
            .contains("follow")
    );
}

#[test]
fn absurd_counts_are_refused() {
    for count in [20_000, 1 << 20, u32::MAX / 2, u32::MAX] {
        let gzip = sample::spz_gzip(3, count, 3, 12, &[0; 64]);
        assert!(
            matches!(
                spz::decode(&gzip),
                Err(DecodeError::Malformed(_) | DecodeError::Truncated { .. })
            ),
            "{count}"
        );
        let mut plain = spz::encode(&cloud(2, 3)).unwrap();
        plain[8..12].copy_from_slice(&count.to_le_bytes());
        assert!(spz::decode(&plain).is_err(), "{count}");
        let header = format!("element vertex {count}");
        let ply = inria_ply::encode(&cloud(2, 0));
        let text = String::from_utf8_lossy(&ply).replace("element vertex 2", &header);
        assert!(
            matches!(
                inria_ply::decode(text.as_bytes()),
                Err(DecodeError::Truncated { .. })
            ),
            "{count}"
        );
    }
}

#[test]
fn a_bomb_is_not_inflated() {
    // 64 MiB of zeros in 64 KiB, claimed as few splats: reading stops at the size of those splats.
    use std::io::Write;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder
        .write_all(b"NGSP\x03\0\0\0\x02\0\0\0\0\x0c\0\0")
        .unwrap();
    let zeros = vec![0; 1 << 20];
    for _ in 0..64 {
        encoder.write_all(&zeros).unwrap();
    }
    let bomb = encoder.finish().unwrap();
    assert!(
        spz::decode(&bomb)
            .unwrap_err()
            .to_string()
            .contains("follow the last stream")
    );
    // The same in a Zstandard stream, over a table of contents that tells the truth about two
    // splats.
    let mut plain = spz::encode(&cloud(2, 0)).unwrap();
    let stream = zstd::bulk::compress(&vec![0; 64 << 20], 3).unwrap();
    let contents = 32;
    let first_bytes =
        u64::from_le_bytes(plain[contents..contents + 8].try_into().unwrap()) as usize;
    plain[contents..contents + 8].copy_from_slice(&(stream.len() as u64).to_le_bytes());
    let data_at = contents + 5 * 16;
    plain.splice(data_at..data_at + first_bytes, stream);
    assert!(
        spz::decode(&plain)
            .unwrap_err()
            .to_string()
            .contains("positions")
    );
}

#[test]
fn a_table_of_contents_that_points_anywhere_is_refused() {
    let file = spz::encode(&cloud(3, 1)).unwrap();
    for offset in [0u32, 16, 31, 33, 1000, u32::MAX - 8, u32::MAX] {
        let mut bytes = file.clone();
        bytes[16..20].copy_from_slice(&offset.to_le_bytes());
        assert!(spz::decode(&bytes).is_err(), "{offset}");
    }
    for streams in [0u8, 5, 7, 255] {
        let mut bytes = file.clone();
        bytes[15] = streams;
        assert!(
            spz::decode(&bytes)
                .unwrap_err()
                .to_string()
                .contains("streams"),
            "{streams}"
        );
    }
    for (at, value) in [(32, u64::MAX), (40, u64::MAX), (48, u64::MAX / 2), (32, 0)] {
        let mut bytes = file.clone();
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        assert!(spz::decode(&bytes).is_err(), "{at}");
    }
}

#[test]
fn other_versions_and_empty_files_are_explained() {
    let mut bytes = spz::encode(&cloud(1, 0)).unwrap();
    bytes[4] = 9;
    assert!(
        spz::decode(&bytes)
            .unwrap_err()
            .to_string()
            .contains("version 9")
    );
    bytes[4] = 3;
    assert!(
        spz::decode(&bytes)
            .unwrap_err()
            .to_string()
            .contains("outside gzip")
    );
    assert!(
        spz::decode(&sample::spz_gzip(4, 1, 0, 12, &[0; 20]))
            .unwrap_err()
            .to_string()
            .contains("inside gzip")
    );
    assert!(
        spz::decode(&sample::spz_gzip(3, 1, 5, 12, &[0; 20]))
            .unwrap_err()
            .to_string()
            .contains("degree 5")
    );
    assert!(
        spz::decode(&sample::spz_gzip(3, 1, 0, 25, &[0; 20]))
            .unwrap_err()
            .to_string()
            .contains("25 fractional")
    );
    assert!(
        splat::decode(&[]).is_err() && spz::decode(&[]).is_err() && inria_ply::decode(&[]).is_err()
    );
}
