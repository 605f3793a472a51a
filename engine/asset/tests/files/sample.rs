//! Small files of every format, made by hand where we have no writer.

use std::path::{Path, PathBuf};

use decouplegs_asset::{compressed_ply, inria_ply, splat, spz};
use decouplegs_scene::{SplatCloud, sh};

/// A way to read bytes, by the name of its format.
pub type Reader = fn(&[u8]) -> Result<SplatCloud, decouplegs_asset::DecodeError>;

/// A cloud in general position with the given number of splats.
pub fn cloud(count: usize, degree: u8) -> SplatCloud {
    let wave = |i: usize, k: usize| ((i * 31 + k * 17) as f32 * 0.618).sin();
    let stride = sh::coefficient_count(degree) - 1;
    let rotation = |i: usize| {
        let q = [1.1 + wave(i, 9), wave(i, 10), wave(i, 11), wave(i, 12)];
        let length = q.iter().map(|x| x * x).sum::<f32>().sqrt();
        q.map(|x| x / length)
    };
    SplatCloud {
        means: (0..count).map(|i| std::array::from_fn(|k| 40.0 * wave(i, k))).collect(),
        scales: (0..count).map(|i| std::array::from_fn(|k| (3.0 * wave(i, 3 + k) - 3.0).exp())).collect(),
        rotations: (0..count).map(rotation).collect(),
        opacities: (0..count).map(|i| 0.5 + 0.49 * wave(i, 13)).collect(),
        sh_degree: degree,
        sh_dc: (0..count).map(|i| std::array::from_fn(|k| 1.5 * wave(i, 14 + k))).collect(),
        sh_rest: (0..count * stride).map(|i| std::array::from_fn(|k| 0.6 * wave(i, 20 + k))).collect(),
    }
}

/// A small valid file of every kind that is read, with its name and reader.
pub fn files() -> Vec<(&'static str, Vec<u8>, Reader)> {
    vec![
        ("inria_ply", inria_ply::encode(&cloud(3, 1)), inria_ply::decode),
        ("compressed_ply", compressed(), compressed_ply::decode),
        ("splat", (0..96u8).map(|i| i.wrapping_mul(37)).collect(), splat::decode),
        ("spz_v4", spz::encode(&cloud(5, 2)).unwrap(), spz::decode),
        ("spz_v3", spz_gzip(3, 5, 1, 12, &[7; 5 * (9 + 1 + 3 + 3 + 4 + 9)]), spz::decode),
        ("spz_v2", spz_gzip(2, 4, 0, 12, &[9; 4 * (9 + 1 + 3 + 3 + 3)]), spz::decode),
        ("spz_v1", spz_gzip(1, 4, 0, 12, &[9; 4 * (6 + 1 + 3 + 3 + 3)]), spz::decode),
    ]
}

/// A gzip SPZ of the given version over `streams`, the attribute streams one behind the other.
pub fn spz_gzip(version: u32, count: u32, degree: u8, fractional_bits: u8, streams: &[u8]) -> Vec<u8> {
    spz_gzip_with_flags(version, count, degree, fractional_bits, 0, streams)
}

/// As [`spz_gzip`], with flags.
pub fn spz_gzip_with_flags(version: u32, count: u32, degree: u8, fractional_bits: u8, flags: u8, streams: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    let mut plain = b"NGSP".to_vec();
    plain.extend_from_slice(&version.to_le_bytes());
    plain.extend_from_slice(&count.to_le_bytes());
    plain.extend_from_slice(&[degree, fractional_bits, flags, 0]);
    plain.extend_from_slice(streams);
    encoder.write_all(&plain).unwrap();
    encoder.finish().unwrap()
}

/// Three splats in one chunk, with degree 1.
fn compressed() -> Vec<u8> {
    let mut header = "ply\nformat binary_little_endian 1.0\nelement chunk 1\n".to_owned();
    let extents = ["x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b"];
    for end in ["min", "max"] {
        for name in extents {
            header += &format!("property float {end}_{name}\n");
        }
    }
    header += "element vertex 3\n";
    for name in ["position", "rotation", "scale", "color"] {
        header += &format!("property uint packed_{name}\n");
    }
    header += "element sh 3\n";
    for i in 0..9 {
        header += &format!("property uchar f_rest_{i}\n");
    }
    let mut bytes = (header + "end_header\n").into_bytes();
    for value in [-1.0f32, -2.0, -3.0, -7.0, -7.0, -7.0, 0.0, 0.0, 0.0, 4.0, 5.0, 6.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0] {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes.extend((0..48u8).map(|i| i.wrapping_mul(53).wrapping_add(11)));
    bytes.extend((0..27u8).map(|i| i.wrapping_mul(29)));
    bytes
}

/// A file of the test data, or nothing and a line that says so where there is none.
pub fn data(name: &str) -> Option<PathBuf> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("DECOUPLEGS_DATA").map_or_else(default, PathBuf::from).join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there; set DECOUPLEGS_DATA to the folder of test data", path.display());
    None
}
