//! The clouds and files that tests read, write and break.

use std::path::{Path, PathBuf};

use decouplegs_asset::{
    CodedAsset, Provenance, checkpoint, coded_asset, compressed_ply, inria_ply, khr_glb, sog,
    splat, spz,
};
use decouplegs_scene::shape::{PrincipalAxes, triangular_factor};
use decouplegs_scene::{CodedCloud, ShFrame, SplatCloud, SplatCodes, sh};

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
        means: (0..count)
            .map(|i| std::array::from_fn(|k| 40.0 * wave(i, k)))
            .collect(),
        scales: (0..count)
            .map(|i| std::array::from_fn(|k| (3.0 * wave(i, 3 + k) - 3.0).exp()))
            .collect(),
        rotations: (0..count).map(rotation).collect(),
        opacities: (0..count).map(|i| 0.5 + 0.49 * wave(i, 13)).collect(),
        sh_degree: degree,
        sh_dc: (0..count)
            .map(|i| std::array::from_fn(|k| 1.5 * wave(i, 14 + k)))
            .collect(),
        sh_rest: (0..count * stride)
            .map(|i| std::array::from_fn(|k| 0.6 * wave(i, 20 + k)))
            .collect(),
    }
}

/// A traffic cone of three rings of four splats, of which every number is a small fraction: the
/// same bits on every machine.
///
/// `fuzz/seeds` holds it once per format and version.
pub fn cone() -> SplatCloud {
    let stride = sh::coefficient_count(3) - 1;
    let corners = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]];
    let of_each = |value: fn(usize, f32, [f32; 2]) -> [f32; 3]| -> Vec<[f32; 3]> {
        (0..12)
            .map(|i| value(i, (i / 4) as f32, corners[i % 4]))
            .collect()
    };
    let rotation = |i: usize| {
        let q: [f32; 4] = [
            3.0,
            1.0 - (i % 4) as f32,
            (i / 4) as f32,
            0.5 * i as f32 - 2.0,
        ];
        let length = q.iter().map(|x| x * x).sum::<f32>().sqrt();
        q.map(|x| x / length)
    };
    SplatCloud {
        means: of_each(|_, ring, [x, y]| {
            [
                2.5 + x * (3.0 - ring) / 16.0,
                y * (3.0 - ring) / 16.0 - 1.25,
                (5.0 * ring + 1.0) / 16.0,
            ]
        }),
        scales: of_each(|i, ring, _| {
            [
                (1.0 + ring) / 64.0,
                (4.0 - ring) / 32.0,
                (1 + i) as f32 / 512.0,
            ]
        }),
        rotations: (0..12).map(rotation).collect(),
        opacities: (0..12u8).map(|i| f32::from(3 + i) / 16.0).collect(),
        sh_degree: 3,
        sh_dc: of_each(|_, ring, _| {
            if ring == 1.0 {
                [1.25, 1.25, 1.1875]
            } else {
                [1.25, -0.25, -1.375]
            }
        }),
        sh_rest: (0..12 * stride)
            .map(|k| {
                std::array::from_fn(|channel| ((k * 7 + channel * 5) % 33) as f32 / 32.0 - 0.5)
            })
            .collect(),
    }
}

/// The cone as a coded asset of two levels: a shape and a color for each of its splats, and a
/// second level of every third.
///
/// Sizes are powers of two and DC residuals fractions of two, so that decoding it gives the same
/// bits on every machine.
pub fn coded_cone() -> CodedAsset {
    let (cone, bounds) = (cone(), cone().bounds());
    let code = |i: usize| {
        let position = std::array::from_fn(|axis| {
            let share =
                (cone.means[i][axis] - bounds.min[axis]) / (bounds.max[axis] - bounds.min[axis]);
            (share * 65_535.0).round() as u16
        });
        let opacity = (cone.opacities[i] * 255.0).round() as u8;
        let residual = [(i % 5) as i8 - 2, (i % 3) as i8 - 1, (i % 4) as i8 - 2];
        SplatCodes {
            position,
            opacity,
            size: 16 * (i % 4) as u8,
            shape: i as u16,
            color: i as u16,
            dc_residual: residual,
        }
    };
    let codes: Vec<SplatCodes> = (0..12).chain((0..12).step_by(3)).map(code).collect();
    let shape = |codes: &SplatCodes| {
        let (i, size) = (
            usize::from(codes.shape),
            f32::from(1u8 << (codes.size / 16)) / 256.0,
        );
        let axes = PrincipalAxes {
            scales: cone.scales[i].map(|scale| scale / size),
            rotation: cone.rotations[i],
        };
        triangular_factor(&axes).map(|entry| entry as f32)
    };
    let mut cloud = CodedCloud {
        bounds,
        log2_size_min: -8.0,
        log2_size_step: 1.0 / 16.0,
        dc_residual_step: [1.0 / 64.0, 1.0 / 32.0, 1.0 / 32.0],
        splats: codes.iter().map(|&codes| codes.into()).collect(),
        levels: vec![12, 4],
        shapes: codes[..12].iter().map(shape).collect(),
        sh_degree: 3,
        colors: Vec::new(),
        sh_frame: ShFrame::World,
        dims_m: [0.375, 0.375, 0.75],
    };
    for (i, codes) in codes[..12].iter().enumerate() {
        let residual = cloud.dc_residual(codes);
        cloud.colors.push(std::array::from_fn(|channel| {
            cone.sh_dc[i][channel] - residual[channel]
        }));
        cloud.colors.extend_from_slice(cone.rest_of(i));
    }
    let mut provenance = Provenance::of_source("cone.ply", b"the bytes of a cone");
    provenance.tool_version = "0.1.0".into();
    provenance.settings.insert("keep_ratio".into(), "1".into());
    CodedAsset { cloud, provenance }
}

/// The cone in every format and version that is read: name of the file, bytes and reader.
pub fn files() -> Vec<(&'static str, Vec<u8>, Reader)> {
    let readers: [(&'static str, Reader); 11] = [
        ("inria_ply/cone.ply", inria_ply::decode),
        ("compressed_ply/cone.compressed.ply", compressed_ply::decode),
        ("splat/cone.splat", splat::decode),
        ("spz/cone.v1.spz", spz::decode),
        ("spz/cone.v2.spz", spz::decode),
        ("spz/cone.v3.spz", spz::decode),
        ("spz/cone.v4.spz", spz::decode),
        ("sog/cone.sog", sog::decode),
        ("khr_glb/cone.glb", khr_glb::decode),
        ("checkpoint/cone.pt", checkpoint::decode),
        ("coded_asset/cone.safetensors", |bytes| {
            Ok(coded_asset::decode(bytes)?.cloud.decoded(0))
        }),
    ];
    readers
        .map(|(name, reader)| (name, std::fs::read(seed(name)).unwrap(), reader))
        .to_vec()
}

/// The path of a file that seeds the fuzz targets, by its target and name.
pub fn seed(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fuzz/seeds")
        .join(name)
}

/// A gzip SPZ of the given version over `streams`, the attribute streams one behind the other.
pub fn spz_gzip(
    version: u32,
    count: u32,
    degree: u8,
    fractional_bits: u8,
    streams: &[u8],
) -> Vec<u8> {
    spz_gzip_with_flags(version, count, degree, fractional_bits, 0, streams)
}

/// Like [`spz_gzip`], with flags.
pub fn spz_gzip_with_flags(
    version: u32,
    count: u32,
    degree: u8,
    fractional_bits: u8,
    flags: u8,
    streams: &[u8],
) -> Vec<u8> {
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
