//! `cull_shadows.comp`: which shadows may lie on which cluster, and what projection makes of them.

use decouplegs::render::layout::{ClusterRecord, ShadowRecord};
use decouplegs::render::stages::{CullShadows, ProjectVariant, ShadowBuffers, words_for};
use decouplegs::render::twins::{self, shadow::shadow_factor, shadow::shadow_overlaps};
use decouplegs::scene::{GroundShadow, Pose, Rules};
use glam::{DQuat, DVec3};

use super::project::{Case, PLAIN};
use super::scenes::{Scene, rig};
use super::{Random, UNTOUCHED, open, run};
use crate::device::Validated;
use crate::frames::background;

/// Shadows of all sizes and ways to lie, within `spread_m` of `center_m`, and some far away.
fn hard_shadows(count: usize, center_m: DVec3, spread_m: DVec3) -> Vec<ShadowRecord> {
    let mut random = Random(5);
    let shadow = |index: usize| {
        let mut unit = || f64::from(random.between(-1.0, 1.0));
        let rotation = DQuat::from_xyzw(unit(), unit(), unit(), unit() + 1.5).normalize();
        let far = if index % 8 == 7 { 1e5 } else { 0.0 };
        let center = center_m + spread_m * DVec3::new(unit(), unit(), unit()) + DVec3::Z * far;
        let shadow = GroundShadow {
            world_from_ground: Pose::new(rotation, center),
            half_size_m: [
                f64::from(random.across_scales(0.3, 9.0)),
                f64::from(random.across_scales(0.2, 5.0)),
            ],
            strength: f64::from(random.between(0.0, 1.0)),
            decay: f64::from(random.between(0.5, 6.0)),
            sharpness: random.below(4),
            slab_m: f64::from(random.across_scales(0.05, 3.0)),
        };
        shadow.check().unwrap();
        ShadowRecord::new(&shadow, DVec3::ZERO)
    };
    (0..count).map(shadow).collect()
}

fn kernel_words(gpu: &Validated, scene: &Scene) -> Vec<u32> {
    let buffers = ShadowBuffers::new(gpu, scene.shadows.len(), scene.clusters.len()).unwrap();
    gpu.write(&buffers.shadows, 0, &scene.shadows).unwrap();
    gpu.write(&buffers.words, 0, &vec![UNTOUCHED; buffers.words.len()])
        .unwrap();
    let cull = CullShadows::new(gpu).unwrap();
    run(gpu, |r| {
        cull.record(r, &scene.resident, &buffers, scene.shadows.len());
    });
    gpu.read(&buffers.words).unwrap()
}

fn with_shadows(gpu: &Validated, splats: usize, shadows: usize) -> Scene {
    let mut scene = Scene::new(gpu, &background(splats, 11), &rig());
    scene.shadows = hard_shadows(
        shadows,
        DVec3::new(20.0, 0.0, 0.0),
        DVec3::new(20.0, 12.0, 3.0),
    );
    scene
}

/// True if the shadow reaches the cluster; `None` if that depends on the rounding of f32.
fn settled(shadow: &ShadowRecord, cluster: &ClusterRecord) -> Option<bool> {
    let reaches = |share: f32| {
        let half_extent_m = cluster.half_extent_m.map(|half| half * (1.0 + share));
        shadow_overlaps(
            &ShadowRecord {
                cutoff: shadow.cutoff * (1.0 + share),
                ..*shadow
            },
            &ClusterRecord {
                half_extent_m,
                ..*cluster
            },
        )
    };
    (reaches(4e-6) == reaches(-4e-6)).then(|| reaches(0.0))
}

/// Holds the bits to the twin's wherever these survive rounding.
fn check(scene: &Scene, words: &[u32], twin: &[u32]) -> Result<(), String> {
    let count = words_for(scene.shadows.len());
    for (cluster, record) in scene.clusters.iter().enumerate() {
        for (index, shadow) in scene.shadows.iter().enumerate() {
            let bit = |words: &[u32]| words[cluster * count + index / 32] >> (index % 32) & 1 == 1;
            if settled(shadow, record).is_some() && bit(words) != bit(twin) {
                return Err(format!(
                    "shadow {index} on cluster {cluster}: the kernel says {}, the twin {}",
                    bit(words),
                    bit(twin)
                ));
            }
        }
    }
    Ok(())
}

#[test]
fn shadows_reach_the_clusters_that_the_twin_names() {
    let gpu = open();
    for shadows in [1, 31, 32, 33, 100] {
        let scene = with_shadows(&gpu, 3000, shadows);
        let (words, twin) = (kernel_words(&gpu, &scene), scene.shadow_words());
        check(&scene, &words, &twin).unwrap();
        let bits: u32 = twin.iter().map(|word| word.count_ones()).sum();
        let all = (scene.clusters.len() * shadows) as u32;
        assert!(
            shadows == 1 || (bits > 0 && bits < all),
            "{bits} of {all}: too few or too many to tell"
        );
    }
}

#[test]
fn no_splat_in_a_shadow_is_in_a_cluster_without_it() {
    let gpu = open();
    let scene = with_shadows(&gpu, 3000, 100);
    let (words, mut darkened) = (kernel_words(&gpu, &scene), 0);
    for (splat, mean_m) in scene
        .means_m
        .iter()
        .enumerate()
        .filter(|&(splat, _)| scene.shapes[splat][3] >= 1.0 / 255.0)
    {
        for (index, _) in scene
            .shadows
            .iter()
            .enumerate()
            .filter(|(_, shadow)| shadow_factor(shadow, *mean_m) < 1.0)
        {
            darkened += 1;
            assert!(
                words[splat / 256 * 4 + index / 32] >> (index % 32) & 1 == 1,
                "shadow {index} misses splat {splat}"
            );
        }
    }
    assert!(darkened > 1000, "{darkened}: too few to tell");
}

#[test]
fn one_flipped_bit_is_seen() {
    let gpu = open();
    let scene = with_shadows(&gpu, 700, 3);
    let (words, mut twin) = (kernel_words(&gpu, &scene), scene.shadow_words());
    check(&scene, &words, &twin).unwrap();
    let index = (0..3)
        .find(|&index| settled(&scene.shadows[index], &scene.clusters[1]).is_some())
        .unwrap();
    twin[1] ^= 1 << index;
    assert!(
        check(&scene, &words, &twin)
            .unwrap_err()
            .contains(&format!("shadow {index} on cluster 1"))
    );
}

#[test]
fn records_in_shadow() {
    let gpu = open();
    let variant = ProjectVariant {
        sh_degree: 3,
        shadows: true,
        ..PLAIN
    };
    let mut case = Case::new(&gpu, 3000, Rules::DEFAULT, variant);
    let lit = case.twin();
    case.scene.shadows = hard_shadows(40, DVec3::Z * 8.0, DVec3::new(3.0, 3.0, 8.0));
    let (kernel, twin) = (case.kernel(&gpu), case.twin());
    case.check(&kernel, &twin).unwrap();
    let records = lit.labels.len();
    let darker = (0..records)
        .filter(|&record| twin.color(record).x < 0.9 * lit.color(record).x)
        .count();
    assert!(
        darker > 300 && darker < records,
        "{darker} of {records} records are darker"
    );
    assert!(
        case.check(&kernel, &lit).unwrap_err().contains("value"),
        "light instead of shadow is seen"
    );
}

#[test]
fn without_shadows_nothing_is_read() {
    let gpu = open();
    let scene = with_shadows(&gpu, 300, 0);
    assert!(kernel_words(&gpu, &scene).is_empty() && twin_is_empty(&scene));
}

fn twin_is_empty(scene: &Scene) -> bool {
    let mut words: Vec<u32> = Vec::new();
    twins::cull_shadows(&scene.clusters, &[], &mut words);
    words.is_empty()
}
