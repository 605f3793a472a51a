//! Files that other programs wrote. Skipped, aloud, where the test data are not there.

use decouplegs_asset::{SplatSummary, read_splats};
use decouplegs_scene::SplatCloud;

use crate::data::data;

/// The captured object that exists as `.ply` and as `.splat`, both.
fn object() -> Option<(SplatCloud, SplatCloud)> {
    let (ply, splat) = (data("splats/hfk_keys.ply")?, data("splats/hfk_keys.splat")?);
    Some((read_splats(&ply).unwrap(), read_splats(&splat).unwrap()))
}

fn largest(differences: impl Iterator<Item = f32>) -> f32 {
    differences.fold(0.0, f32::max)
}

#[test]
fn one_object_as_ply_and_as_splat_agrees_to_quantization() {
    let Some((ply, splat)) = object() else { return };
    assert_eq!(
        (ply.len(), splat.len(), ply.sh_degree, splat.sh_degree),
        (13_536, 13_536, 3, 0)
    );
    assert_eq!(ply.means, splat.means, "both hold 32-bit floats");
    let scale = largest(
        (0..ply.len())
            .flat_map(|i| (0..3).map(move |k| (i, k)))
            .map(|(i, k)| (ply.scales[i][k] / splat.scales[i][k] - 1.0).abs()),
    );
    let opacity = largest(
        ply.opacities
            .iter()
            .zip(&splat.opacities)
            .map(|(a, b)| (a - b).abs()),
    );
    let y0 = decouplegs_scene::sh::Y0 as f32;
    let color = largest(
        ply.sh_dc
            .as_flattened()
            .iter()
            .zip(splat.sh_dc.as_flattened())
            .map(|(a, b)| {
                // A byte holds 0 to 1; colors outside were clamped by the writer.
                ((a * y0 + 0.5).clamp(0.0, 1.0) - (b * y0 + 0.5)).abs()
            }),
    );
    let angle_rad = largest(ply.rotations.iter().zip(&splat.rotations).map(|(a, b)| {
        let dot: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
        2.0 * dot.abs().min(1.0).acos()
    }));
    println!(
        "hfk_keys .ply against .splat: scale {scale:.2e} relative, opacity {opacity:.4}, color {color:.4}, angle {angle_rad:.4} rad"
    );
    assert!(scale < 2e-7, "{scale}");
    // This writer truncates: colors, opacities and the four components of a rotation are off by up
    // to a whole step.
    assert!(
        opacity <= 1.001 / 255.0 && color <= 1.001 / 255.0,
        "{opacity} {color}"
    );
    assert!(angle_rad <= 4.0 / 128.0, "{angle_rad}");
}

#[test]
fn infinite_logits_are_full_opacity_and_nothing_is_defective() {
    let Some((ply, _)) = object() else { return };
    let bytes = std::fs::read(data("splats/hfk_keys.ply").unwrap()).unwrap();
    let infinite = bytes
        .windows(4)
        .filter(|window| *window == f32::INFINITY.to_le_bytes())
        .count();
    let full = ply
        .opacities
        .iter()
        .filter(|&&opacity| opacity == 1.0)
        .count();
    println!("hfk_keys.ply: {infinite} infinite logits, {full} splats of opacity exactly 1");
    assert!(infinite >= 75 && full >= 75);
    let summary = SplatSummary::new(&ply);
    assert_eq!(summary.defects.total, 0, "{:?}", summary.defects);
    assert_eq!(summary.opacity.counts.iter().sum::<u64>(), 13_536);
}

#[test]
fn a_compressed_ply_of_playcanvas_is_a_guitar() {
    let Some(path) = data("splats/guitar.compressed.ply") else {
        return;
    };
    let cloud = read_splats(&path).unwrap();
    let summary = SplatSummary::new(&cloud);
    println!(
        "guitar.compressed.ply: {}",
        serde_json::to_string(&summary).unwrap()
    );
    assert_eq!(
        (cloud.len(), cloud.sh_degree, summary.defects.total),
        (90_854, 0, 0)
    );
    let bounds = summary.bounds.unwrap();
    let size: Vec<f32> = (0..3)
        .map(|axis| bounds.max[axis] - bounds.min[axis])
        .collect();
    assert!(
        size.iter().all(|&side| side > 0.05 && side < 20.0),
        "{size:?}"
    );
    // Splats of a trained object are mostly thin and far smaller than the object.
    let mut largest_scales: Vec<f32> = cloud
        .scales
        .iter()
        .map(|scale| scale.iter().copied().fold(0.0, f32::max))
        .collect();
    largest_scales.sort_unstable_by(f32::total_cmp);
    assert!(largest_scales[cloud.len() / 2] < 0.05 * size.iter().copied().fold(0.0, f32::max));
}
