//! Properties over generated coded assets, and over damaged ones.

use decouplegs_asset::{CodedAsset, Provenance, coded_asset};
use decouplegs_scene::codebook::{COLORS_MAX, LEVELS_MAX, SHAPES_MAX};
use decouplegs_scene::{Bounds, CodedCloud, ShFrame, SplatCodes, sh};
use proptest::collection::{btree_map, vec};
use proptest::prelude::*;

use crate::sample;

/// Entries of the codebooks, degree and splats of each level.
fn sizes() -> impl Strategy<Value = (usize, usize, u8, Vec<usize>)> {
    (
        1usize..=SHAPES_MAX,
        1usize..=COLORS_MAX,
        0u8..=3,
        vec(0usize..20, 1..=LEVELS_MAX),
    )
}

fn provenances() -> impl Strategy<Value = Provenance> {
    (
        ".{0,12}",
        "[a-z_]{1,8}\\.ply",
        "[0-9a-f]{64}",
        btree_map(".{0,8}", ".{0,8}", 0..4),
    )
        .prop_map(
            |(tool_version, source, source_sha256, settings)| Provenance {
                tool_version,
                source,
                source_sha256,
                settings,
            },
        )
}

/// Assets with every number anywhere in its range. Books repeat a few values, of which there are
/// enough.
fn assets() -> impl Strategy<Value = CodedAsset> {
    (sizes(), provenances()).prop_flat_map(|((shapes, colors, sh_degree, levels), provenance)| {
        let codes = (
            any::<([u16; 3], u8, u8)>(),
            0..shapes as u16,
            0..colors as u16,
            -16i8..16,
            -8i8..8,
            -8i8..8,
        );
        let codes = codes.prop_map(
            |((position, opacity, size), shape, color, luma, orange, green)| SplatCodes {
                position,
                opacity,
                size,
                shape,
                color,
                dc_residual: [luma, orange, green],
            },
        );
        let boxes = (
            prop::array::uniform3(-1e9f32..1e9),
            prop::array::uniform3(0f32..1.0),
        );
        let steps = (
            -100f32..10.0,
            0f32..0.05,
            prop::array::uniform3(-1e4f32..1e4),
        );
        let values = (
            vec(prop::array::uniform6(-1e5f32..1e5), 1..9),
            vec(prop::array::uniform3(-65_519f32..65_519.0), 1..9),
        );
        let splats = vec(codes, levels.iter().sum::<usize>());
        (
            splats,
            boxes,
            steps,
            values,
            prop::array::uniform3(0f32..100.0),
            any::<bool>(),
        )
            .prop_map(
                move |(
                    splats,
                    (min, share),
                    (log2_size_min, log2_size_step, dc_residual_step),
                    values,
                    dims_m,
                    canonical,
                )| {
                    let coefficients = colors * sh::coefficient_count(sh_degree);
                    let cloud = CodedCloud {
                        bounds: Bounds {
                            min,
                            max: std::array::from_fn(|axis| {
                                min[axis] + share[axis] * (1e9 - min[axis])
                            }),
                        },
                        log2_size_min,
                        log2_size_step: log2_size_step.min((13.0 - log2_size_min) / 255.0),
                        dc_residual_step,
                        splats: splats.into_iter().map(Into::into).collect(),
                        levels: levels.clone(),
                        shapes: values.0.iter().copied().cycle().take(shapes).collect(),
                        sh_degree,
                        colors: values
                            .1
                            .iter()
                            .copied()
                            .cycle()
                            .take(coefficients)
                            .collect(),
                        sh_frame: if canonical {
                            ShFrame::Canonical
                        } else {
                            ShFrame::World
                        },
                        dims_m,
                    };
                    CodedAsset {
                        cloud,
                        provenance: provenance.clone(),
                    }
                },
            )
    })
}

/// True if every splat of every level can be drawn.
fn can_be_drawn(cloud: &CodedCloud) -> bool {
    (0..cloud.levels.len()).all(|level| {
        let decoded = cloud.decoded(level);
        (0..decoded.len()).all(|splat| decoded.defect_of(splat).is_none())
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_is_rounded_reads_back_to_the_bit(asset in assets()) {
        let bytes = coded_asset::encode(&asset).unwrap();
        prop_assert_eq!(&bytes, &coded_asset::encode(&asset).unwrap());
        let back = coded_asset::decode(&bytes).unwrap();
        let mut rounded = asset;
        coded_asset::round_to_stored(&mut rounded.cloud);
        prop_assert_eq!(&back, &rounded);
        coded_asset::round_to_stored(&mut rounded.cloud);
        prop_assert_eq!(&back, &rounded);
        prop_assert!(can_be_drawn(&back.cloud));
    }

    #[test]
    fn damaged_tensors_are_refused_or_can_be_drawn(
        edits in vec((any::<prop::sample::Index>(), any::<u8>()), 1..20),
    ) {
        let mut bytes = std::fs::read(sample::seed("coded_asset/cone.safetensors")).unwrap();
        let data_at = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        for (at, value) in edits {
            let at = data_at + at.index(bytes.len() - data_at);
            bytes[at] = value;
        }
        if let Ok(asset) = coded_asset::decode(&bytes) {
            prop_assert!(can_be_drawn(&asset.cloud));
        }
    }

    #[test]
    fn noise_behind_a_true_length_never_panics(noise in vec(any::<u8>(), 0..200), json in "[\\[\\]{}\":,a0U8dtypeshape_]{0,80}") {
        for header in [noise, json.into_bytes()] {
            let file = [&(header.len() as u64).to_le_bytes(), header.as_slice()].concat();
            prop_assert!(coded_asset::decode(&file).is_err());
        }
    }
}
