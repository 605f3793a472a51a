//! `relight.comp`: codebooks in the light of their agents.

use decouplegs::gpu::Buffer;
use decouplegs::render::layout::RelightRecord;
use decouplegs::render::sh_codec::EXACT_BITS;
use decouplegs::render::stages::{Relight, RelightWork, RelitColors};
use decouplegs::render::{PoolBuffers, sh_codec, twins};
use decouplegs::scene::{AmbientDescriptor, ColorTransfer, sh};

use super::{ROUNDOFF, Random, UNTOUCHED, open, run, upload};
use crate::device::Validated;

/// Codebooks one behind the other in a pool, and what is to be made of them.
struct Case {
    dc: Vec<[f32; 3]>,
    bands: Vec<[u32; 24]>,
    relights: Vec<RelightRecord>,
    groups: usize,
    room: usize,
    sh_degree: u8,
}

/// Result of relighting: colors, and their bands.
type Relit = (Vec<[f32; 3]>, Vec<[u32; 24]>);

fn transfer(random: &mut Random) -> ColorTransfer {
    let mut numbers = |low: f32, high: f32| {
        std::array::from_fn(|_| std::array::from_fn(|_| random.between(low, high)))
    };
    ColorTransfer {
        gain: numbers(-0.5, 2.0),
        offset: numbers(-0.4, 0.4),
    }
}

impl Case {
    /// Codebooks of `counts` colors in a light each; the first two share theirs.
    fn new(counts: &[usize], sh_degree: u8) -> Self {
        let mut random = Random(77);
        let colors = 5 + counts.iter().sum::<usize>();
        let mut dc = Vec::new();
        let mut bands = Vec::new();
        for color in 0..colors {
            // Bands of no size, of an ordinary one, and near the ends of f16.
            let size = [0.0, 0.3, 1e-6, 300.0][color % 4];
            let mut number = || std::array::from_fn(|_| size * random.between(-1.0, 1.0));
            let coefficients: Vec<[f32; 3]> = (0..15).map(|_| number()).collect();
            dc.push(std::array::from_fn(|_| random.between(-2.0, 3.0)));
            let band = |band: usize| {
                let range = band * band - 1..(band + 1) * (band + 1) - 1;
                sh_codec::encode_band(&coefficients[range], EXACT_BITS)[..sh_codec::words_of(band)]
                    .to_vec()
            };
            bands.push([band(1), band(2), band(3)].concat().try_into().unwrap());
        }
        let (mut first, mut first_relit, mut groups) = (5, 3, 0);
        let shared = transfer(&mut random);
        let relights = counts.iter().enumerate().map(|(i, &count)| {
            let light = if i < 2 { shared } else { transfer(&mut random) };
            let record = RelightRecord {
                first_relit: first_relit as u32,
                first_group: groups as u32,
                ..RelightRecord::new(&light, 3, first, count)
            };
            (first, first_relit, groups) = (
                first + count,
                first_relit + count + 1,
                groups + count.div_ceil(256),
            );
            record
        });
        let relights = relights.collect();
        Self {
            dc,
            bands,
            relights,
            groups,
            room: first_relit + 2,
            sh_degree,
        }
    }

    fn kernel(&self, gpu: &Validated) -> Relit {
        let pool = PoolBuffers {
            splats: upload(gpu, &[]),
            clusters: upload(gpu, &[]),
            shapes: upload(gpu, &[]),
            color_dc: upload(gpu, &self.dc),
            color_bands: upload(gpu, &self.bands),
        };
        let relit = RelitColors::new(gpu, self.room).unwrap();
        gpu.write(
            &relit.dc,
            0,
            &vec![[f32::from_bits(UNTOUCHED); 3]; self.room],
        )
        .unwrap();
        gpu.write(&relit.bands, 0, &vec![[UNTOUCHED; 24]; self.room])
            .unwrap();
        let relights: Buffer<RelightRecord> = upload(gpu, &self.relights);
        let relight = Relight::new(gpu, self.sh_degree).unwrap();
        run(gpu, |r| {
            relight.record(
                r,
                &pool,
                RelightWork {
                    records: &relights,
                    count: self.relights.len(),
                    groups: self.groups,
                },
                &relit,
            );
        });
        (
            gpu.read(&relit.dc).unwrap(),
            gpu.read(&relit.bands).unwrap(),
        )
    }

    fn twin(&self) -> Relit {
        let (mut dc, mut bands) = (
            vec![[f32::from_bits(UNTOUCHED); 3]; self.room],
            vec![[UNTOUCHED; 24]; self.room],
        );
        twins::relight(
            &self.relights,
            &self.dc,
            &self.bands,
            &mut dc,
            &mut bands,
            self.sh_degree.into(),
        );
        (dc, bands)
    }

    /// Holds what was made to the twin: DC within rounding, bands within a step and a half of their
    /// scale, all else untouched.
    fn check(&self, (dc, bands): &Relit, (twin_dc, twin_bands): &Relit) -> Result<f64, String> {
        let mut worst = 0.0f64;
        for color in 0..self.room {
            for channel in 0..3 {
                let [a, b] = [dc[color][channel], twin_dc[color][channel]];
                let bound = 24.0 * ROUNDOFF * 16.0;
                if a.to_bits() != b.to_bits()
                    && (f64::from(a) - f64::from(b))
                        .abs()
                        .partial_cmp(&bound)
                        .is_none_or(|o| o.is_gt())
                {
                    return Err(format!(
                        "dc of {color}, channel {channel}: {a}, the twin has {b}"
                    ));
                }
            }
            let mut first = 0;
            for band in 1..=3usize {
                let words = first..first + sh_codec::words_of(band);
                first = words.end;
                let [kernel, twin] = [&bands[color][words.clone()], &twin_bands[color][words]];
                if kernel == twin {
                    continue;
                }
                let [a, b] = [kernel, twin]
                    .map(|words| sh_codec::decode_band(words, 2 * band + 1, EXACT_BITS));
                let largest = b
                    .as_flattened()
                    .iter()
                    .fold(6.2e-5f32, |largest, value| largest.max(value.abs()));
                let bound = f64::from(largest) * 1.5 * 1.002 / 32_767.0;
                for (k, (a, b)) in a.as_flattened().iter().zip(b.as_flattened()).enumerate() {
                    let error = (f64::from(*a) - f64::from(*b)).abs();
                    if error.partial_cmp(&bound).is_none_or(|order| order.is_gt()) {
                        return Err(format!(
                            "band {band} of {color}, number {k}: {a}, the twin has {b}"
                        ));
                    }
                    worst = worst.max(error / bound);
                }
            }
        }
        Ok(worst)
    }
}

#[test]
fn codebooks_are_relit_as_the_twin_says() {
    let gpu = open();
    for sh_degree in 0..=3 {
        let case = Case::new(&[300, 256, 1, 1024, 257], sh_degree);
        let worst = case.check(&case.kernel(&gpu), &case.twin()).unwrap();
        println!("degree {sh_degree}: {worst:.3} of the bound of bands");
    }
}

#[test]
fn one_changed_number_is_seen() {
    let gpu = open();
    let case = Case::new(&[10, 20], 3);
    let (kernel, twin) = (case.kernel(&gpu), case.twin());
    case.check(&kernel, &twin).unwrap();
    let failure = |change: &dyn Fn(&mut Relit)| {
        let mut changed = twin.clone();
        change(&mut changed);
        case.check(&kernel, &changed).unwrap_err()
    };
    assert!(failure(&|relit| relit.0[3][1] += 1e-3).contains("dc of 3, channel 1"));
    assert!(failure(&|relit| relit.1[4][6] += 4 << 16).contains("band 2 of 4"));
    assert!(
        failure(&|relit| relit.1[2][0] ^= 1).contains("band 1 of 2"),
        "what is not to be made is left alone"
    );
}

/// The same numbers as the transfer applied to coefficients that were never encoded.
#[test]
fn relit_codebooks_are_the_transfer_of_the_definition() {
    let gpu = open();
    let case = Case::new(&[300], 3);
    let (dc, bands) = case.kernel(&gpu);
    let mut random = Random(77 + 1);
    let light = AmbientDescriptor::uniform([random.between(0.0, 1.0), 0.5, 0.25]);
    assert!(light.directionality() == 0.0);
    let record = &case.relights[0];
    let numbers = |of: &[f32; 48]| {
        std::array::from_fn(|k| std::array::from_fn(|channel| of[3 * k + channel]))
    };
    let transfer = ColorTransfer {
        gain: numbers(&record.gain),
        offset: numbers(&record.summand),
    };
    for entry in 0..300usize {
        let mut color = vec![case.dc[5 + entry]];
        let decoded = |words: &[u32; 24], band: usize, first: usize| {
            sh_codec::decode_band(&words[first..], 2 * band + 1, EXACT_BITS)
        };
        for (band, first) in [(1, 0), (2, 5), (3, 13)] {
            color.extend(decoded(&case.bands[5 + entry], band, first));
        }
        assert_eq!(color.len(), sh::coefficient_count(3));
        transfer.apply(&mut color);
        for (band, first) in [(1usize, 0), (2, 5), (3, 13)] {
            let expected = &color[band * band..(band + 1) * (band + 1)];
            let largest = expected
                .as_flattened()
                .iter()
                .fold(6.2e-5f32, |largest, value| largest.max(value.abs()));
            for (a, b) in decoded(&bands[3 + entry], band, first)
                .as_flattened()
                .iter()
                .zip(expected.as_flattened())
            {
                assert!(
                    (a - b).abs() <= largest * 2.0 / 32_767.0,
                    "color {entry}, band {band}: {a}, expected {b}"
                );
            }
        }
        assert!(
            dc[3 + entry]
                .iter()
                .zip(color[0])
                .all(|(a, b)| (a - b).abs() < 1e-5)
        );
    }
}
