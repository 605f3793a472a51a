//! The six attribute streams and their quantization, in the axes of the file.

use std::ops::Range;

use decouplegs_scene::{SplatCloud, sh};
use rayon::prelude::*;

use super::axes::{Signs, StoredAxes};
use crate::EncodeError;
use crate::activation::{log_of_scale, normalized, scale_of_log};

/// The streams in the order of the file.
pub(super) const STREAMS: [&str; 6] =
    ["positions", "alphas", "colors", "scales", "rotations", "sh"];

/// A DC coefficient of 1 moves a color byte by this share of its range: colors a little outside 0
/// to 1 are kept.
const COLOR_SCALE: f32 = 0.15;

/// Bits after the point that the reference writes: a quarter of a millimeter.
const FRACTIONAL_BITS: u8 = 12;

/// Parameters that determine the streams' sizes and codes.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    /// 1 to 4.
    pub(super) version: u32,
    /// Number of splats.
    pub(super) count: usize,
    /// Degree in the file, 0 to 4.
    pub(super) stored_degree: u8,
    /// Bits after the point in positions.
    pub(super) fractional_bits: u8,
}

impl Layout {
    fn position_bytes(&self) -> usize {
        if self.version == 1 { 6 } else { 9 }
    }

    fn rotation_bytes(&self) -> usize {
        if self.version < 3 { 3 } else { 4 }
    }

    /// Coefficients after DC of each splat in the file.
    fn stored_stride(&self) -> usize {
        sh::coefficient_count(self.stored_degree) - 1
    }

    /// Bytes of a splat in each stream.
    fn bytes_each(&self) -> [usize; 6] {
        [
            self.position_bytes(),
            1,
            3,
            3,
            self.rotation_bytes(),
            3 * self.stored_stride(),
        ]
    }

    /// Bytes of each stream.
    pub(super) fn stream_bytes(&self) -> [usize; 6] {
        self.bytes_each().map(|bytes| bytes * self.count)
    }
}

/// A file without its container. Each stream has the length that the layout gives it.
#[derive(Clone, Debug)]
pub(super) struct Packed {
    pub(super) layout: Layout,
    pub(super) streams: [Vec<u8>; 6],
    pub(super) axes: StoredAxes,
}

/// The splats in a range that the codes stand for, in the axes of the file.
pub(super) fn unpack(packed: &Packed, splats: Range<usize>) -> SplatCloud {
    let layout = &packed.layout;
    let of_each = layout.bytes_each();
    let [positions, alphas, colors, scales, rotations, rest]: [&[u8]; 6] =
        std::array::from_fn(|stream| {
            &packed.streams[stream][splats.start * of_each[stream]..splats.end * of_each[stream]]
        });
    let step = (-f64::from(layout.fractional_bits)).exp2() as f32;
    let means = positions.par_chunks_exact(layout.position_bytes());
    let rotations = rotations.par_chunks_exact(layout.rotation_bytes());
    let triples = |bytes: &[u8], value: fn(u8) -> f32| -> Vec<[f32; 3]> {
        bytes
            .par_chunks_exact(3)
            .map(|codes| [value(codes[0]), value(codes[1]), value(codes[2])])
            .collect()
    };
    let sh_degree = layout.stored_degree.min(sh::DEGREE_MAX);
    SplatCloud {
        means: if layout.version == 1 {
            means
                .map(|p| {
                    std::array::from_fn(|i| half(u16::from_le_bytes([p[2 * i], p[2 * i + 1]])))
                })
                .collect()
        } else {
            means
                .map(|p| {
                    std::array::from_fn(|i| {
                        signed_24([p[3 * i], p[3 * i + 1], p[3 * i + 2]]) as f32 * step
                    })
                })
                .collect()
        },
        scales: triples(scales, |code| scale_of_log(f32::from(code) / 16.0 - 10.0)),
        rotations: if layout.version < 3 {
            rotations
                .map(|codes| unpack_first_three([codes[0], codes[1], codes[2]]))
                .collect()
        } else {
            rotations
                .map(|r| unpack_smallest_three(u32::from_le_bytes([r[0], r[1], r[2], r[3]])))
                .collect()
        },
        opacities: alphas
            .par_iter()
            .map(|&code| f32::from(code) / 255.0)
            .collect(),
        sh_degree,
        sh_dc: triples(colors, |code| (f32::from(code) / 255.0 - 0.5) / COLOR_SCALE),
        sh_rest: unpack_rest(
            rest,
            layout.stored_stride(),
            sh::coefficient_count(sh_degree) - 1,
        ),
    }
}

fn unpack_rest(codes: &[u8], stored_stride: usize, stride: usize) -> Vec<[f32; 3]> {
    if stride == 0 {
        return Vec::new();
    }
    let mut rest = vec![[0.0; 3]; codes.len() / (3 * stored_stride) * stride];
    let splats = rest.par_chunks_exact_mut(stride);
    let splats = splats.zip(codes.par_chunks_exact(3 * stored_stride));
    splats.for_each(|(rest, codes)| {
        for (coefficient, codes) in rest.iter_mut().zip(codes.chunks_exact(3)) {
            *coefficient =
                [codes[0], codes[1], codes[2]].map(|code| (f32::from(code) - 128.0) / 128.0);
        }
    });
    rest
}

/// The codes of `cloud`, which `signs` turn to the axes of the file.
pub(super) fn pack(cloud: &SplatCloud, signs: &Signs) -> Result<Packed, EncodeError> {
    let defective = (0..cloud.len())
        .into_par_iter()
        .filter(|&splat| cloud.defect_of(splat).is_some());
    let defects = defective.clone().count();
    if let Some(first) = defective.min() {
        return Err(EncodeError(format!(
            "{defects} of {} splats are not finite or have no rotation, splat {first} first; drop them before writing",
            cloud.len()
        )));
    }
    let fractional_bits = fractional_bits_for(cloud)?;
    let steps = f64::from(fractional_bits).exp2();
    let positions = cloud.means.par_iter().map(|mean| -> [[u8; 3]; 3] {
        std::array::from_fn(|axis| {
            let x = f64::from(mean[axis] * signs.means[axis]);
            let [a, b, c, _] = ((x * steps).round() as i32).to_le_bytes();
            [a, b, c]
        })
    });
    let positions: Vec<[[u8; 3]; 3]> = positions.collect();
    let rotations = cloud.rotations.par_iter().map(|rotation| {
        let turned = std::array::from_fn(|i| rotation[i] * signs.rotations[i]);
        pack_smallest_three(turned).to_le_bytes()
    });
    let rotations: Vec<[u8; 4]> = rotations.collect();
    let layout = Layout {
        version: 4,
        count: cloud.len(),
        stored_degree: cloud.sh_degree,
        fractional_bits,
    };
    let streams = [
        positions.into_flattened().into_flattened(),
        cloud
            .opacities
            .par_iter()
            .map(|opacity| byte(opacity * 255.0))
            .collect(),
        flattened(&cloud.sh_dc, |dc| {
            byte(dc * (COLOR_SCALE * 255.0) + 0.5 * 255.0)
        }),
        flattened(&cloud.scales, |scale| {
            byte((log_of_scale(scale) + 10.0) * 16.0)
        }),
        rotations.into_flattened(),
        pack_rest(cloud, signs),
    ];
    Ok(Packed {
        layout,
        streams,
        axes: StoredAxes::RUB,
    })
}

fn pack_rest(cloud: &SplatCloud, signs: &Signs) -> Vec<u8> {
    let stride = cloud.rest_stride();
    let mut codes = vec![0; 3 * cloud.sh_rest.len()];
    if stride > 0 {
        let splats = codes.par_chunks_exact_mut(3 * stride);
        let splats = splats.zip(cloud.sh_rest.par_chunks_exact(stride));
        splats.for_each(|(codes, rest)| {
            for ((codes, coefficient), sign) in codes.chunks_exact_mut(3).zip(rest).zip(&signs.rest)
            {
                for (code, channel) in codes.iter_mut().zip(coefficient) {
                    *code = byte(channel * sign * 128.0 + 128.0);
                }
            }
        });
    }
    codes
}

fn flattened(values: &[[f32; 3]], code: impl Fn(f32) -> u8 + Sync) -> Vec<u8> {
    let codes: Vec<[u8; 3]> = values.par_iter().map(|triple| triple.map(&code)).collect();
    codes.into_flattened()
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// Number of fractional bits: as many as the reference writes, or as fit.
fn fractional_bits_for(cloud: &SplatCloud) -> Result<u8, EncodeError> {
    let largest = cloud
        .means
        .par_iter()
        .flat_map_iter(|mean| mean.iter().map(|x| f64::from(x.abs())))
        .reduce(|| 0.0, f64::max);
    let code_max = f64::from((1 << 23) - 1);
    (0..=FRACTIONAL_BITS)
        .rev()
        .find(|&bits| largest * f64::from(bits).exp2() <= code_max)
        .ok_or_else(|| {
            EncodeError(format!(
                "a mean lies {largest} m from the origin; 24-bit positions reach {code_max} m"
            ))
        })
}

fn signed_24([a, b, c]: [u8; 3]) -> i32 {
    i32::from_le_bytes([0, a, b, c]) >> 8
}

/// IEEE 754 binary16.
fn half(bits: u16) -> f32 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let (exponent, mantissa) = (i32::from(bits >> 10 & 0x1f), f32::from(bits & 0x3ff));
    match exponent {
        0 => sign * mantissa * (-24f32).exp2(),
        31 if mantissa == 0.0 => sign * f32::INFINITY,
        31 => f32::NAN,
        _ => sign * (1024.0 + mantissa) * (exponent as f32 - 25.0).exp2(),
    }
}

/// Versions 1 and 2: x, y, z around 127.5; w is positive and follows.
fn unpack_first_three(codes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = codes.map(|code| f32::from(code) / 127.5 - 1.0);
    normalized([(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z])
}

/// Largest value of a component that is not the largest of four.
const SMALL_MAX: f32 = std::f32::consts::FRAC_1_SQRT_2;
const SMALL_CODES: f32 = 511.0;

/// Rotation from version 3 on: of x, y, z, w, the index of the largest and 9 bits and a sign for
/// each other, the last one lowest.
fn unpack_smallest_three(mut codes: u32) -> [f32; 4] {
    let largest = (codes >> 30) as usize;
    let mut xyzw = [0.0f32; 4];
    let mut squares = 0.0;
    for i in (0..4).rev().filter(|&i| i != largest) {
        let magnitude = SMALL_MAX * (codes & 0x1ff) as f32 / SMALL_CODES;
        xyzw[i] = if codes & 0x200 == 0 {
            magnitude
        } else {
            -magnitude
        };
        squares += magnitude * magnitude;
        codes >>= 10;
    }
    xyzw[largest] = (1.0 - squares).max(0.0).sqrt();
    let [x, y, z, w] = xyzw;
    normalized([w, x, y, z])
}

fn pack_smallest_three(rotation: [f32; 4]) -> u32 {
    let [w, x, y, z] = normalized(rotation);
    let xyzw = [x, y, z, w];
    let largest = (1..4).fold(0, |best, i| {
        if xyzw[i].abs() > xyzw[best].abs() {
            i
        } else {
            best
        }
    });
    let mut codes = largest as u32;
    for i in (0..4).filter(|&i| i != largest) {
        // -q is the same rotation: the largest component is made positive.
        let negative = (xyzw[i] < 0.0) != (xyzw[largest] < 0.0);
        let magnitude = (xyzw[i].abs() / SMALL_MAX * SMALL_CODES)
            .round()
            .min(SMALL_CODES) as u32;
        codes = codes << 10 | u32::from(negative) << 9 | magnitude;
    }
    codes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_read() {
        let cases = [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65_504.0),
            (0x0001, 5.960_464_5e-8),
            (0x0400, 6.103_515_6e-5),
            (0x8000, 0.0),
        ];
        for (bits, value) in cases {
            assert_eq!(half(bits), value, "{bits:#06x}");
        }
        assert!(half(0x7c00).is_infinite() && half(0x7e00).is_nan());
    }

    #[test]
    fn positions_keep_their_sign() {
        assert_eq!(
            [
                signed_24([0xff; 3]),
                signed_24([0, 0, 0x80]),
                signed_24([1, 0, 0])
            ],
            [-1, -8_388_608, 1]
        );
    }

    #[test]
    fn rotations_survive_packing_to_ten_bits() {
        for i in 0..500 {
            let t = f64::from(i);
            let q = glam::DQuat::from_euler(glam::EulerRot::ZYX, t * 0.37, t * 0.71, t * 1.13);
            let rotation = [q.w, q.x, q.y, q.z].map(|value| value as f32);
            let [w, x, y, z] = unpack_smallest_three(pack_smallest_three(rotation)).map(f64::from);
            let angle_rad = q.angle_between(glam::DQuat::from_xyzw(x, y, z, w));
            assert!(angle_rad < 0.005, "{i}: {angle_rad}");
        }
    }

    #[test]
    fn larger_clouds_get_coarser_positions_until_none_fit() {
        let at = |x: f32| {
            fractional_bits_for(&SplatCloud {
                means: vec![[0.0, -x, 0.0]],
                ..SplatCloud::default()
            })
        };
        assert_eq!((at(2047.0), at(2049.0), at(8.0e6)), (Ok(12), Ok(11), Ok(0)));
        assert!(at(9.0e6).is_err());
    }
}
