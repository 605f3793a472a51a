//! The whole scene pruned by one global importance, in LightGaussian's manner (Fan et al., 2024):
//! the blending weights of a splat over all views times a power of its volume. Nothing is trained
//! afterwards, which LightGaussian does.

use decouplegs::scene::SplatCloud;

/// Power of the volume.
const VOLUME_POWER: f64 = 0.1;
/// The share of splats whose volume is not above the one that counts as 1.
const VOLUME_SHARE: f64 = 0.9;

/// Importance of each splat of `cloud`: `weights` are the sums of its blending weights over all
/// views.
pub fn importance(cloud: &SplatCloud, weights: &[f64]) -> Vec<f64> {
    let volumes: Vec<f64> = cloud
        .scales
        .iter()
        .map(|scale| scale.iter().map(|&side_m| f64::from(side_m)).product())
        .collect();
    let mut sorted: Vec<f64> = volumes
        .iter()
        .copied()
        .filter(|volume| volume.is_finite())
        .collect();
    sorted.sort_by(f64::total_cmp);
    let place = (sorted.len() as f64 * VOLUME_SHARE) as usize;
    let full = sorted
        .get(place.min(sorted.len().saturating_sub(1)))
        .copied()
        .unwrap_or(0.0)
        .max(f64::MIN_POSITIVE);
    let factor = |volume: &f64| {
        if volume.is_finite() {
            (volume / full).clamp(0.0, 1.0).powf(VOLUME_POWER)
        } else {
            0.0
        }
    };
    volumes
        .iter()
        .zip(weights)
        .map(|(volume, weight)| factor(volume) * weight)
        .collect()
}

/// The share `keep` of the splats that matters most, in rising order; of equal ones the earlier
/// stay.
pub fn kept(importance: &[f64], keep: f64) -> Vec<u32> {
    let mut order: Vec<u32> = (0..importance.len() as u32).collect();
    let of = |splat: u32| importance[splat as usize];
    order.sort_by(|&a, &b| of(b).total_cmp(&of(a)).then(a.cmp(&b)));
    order.truncate((keep * importance.len() as f64).ceil() as usize);
    order.sort_unstable();
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(sides_m: &[f32]) -> SplatCloud {
        let count = sides_m.len();
        SplatCloud {
            means: vec![[0.0; 3]; count],
            scales: sides_m.iter().map(|&side_m| [side_m; 3]).collect(),
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.5; count],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; count],
            sh_rest: vec![],
        }
    }

    #[test]
    fn unseen_splats_go_first_and_large_ones_count_as_much_as_the_largest_tenth() {
        let found = importance(
            &cloud(&[0.1, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 50.0]),
            &[1.0; 11],
        );
        assert!(
            (found[0] - 1e-3f64.powf(0.1)).abs() < 1e-6 && found[10] == 1.0 && found[1] == 1.0,
            "{found:?}"
        );
        assert_eq!(
            importance(&cloud(&[1.0, f32::NAN]), &[0.0, 3.0]),
            [0.0, 0.0]
        );
        assert!(importance(&cloud(&[]), &[]).is_empty());
    }

    #[test]
    fn the_share_is_rounded_up_and_ties_go_to_the_earlier() {
        assert_eq!(kept(&[1.0, 3.0, 1.0, 2.0, 1.0], 0.5), [0, 1, 3]);
        assert_eq!(kept(&[1.0; 4], 1.0), [0, 1, 2, 3]);
        assert_eq!(kept(&[], 0.34), [0u32; 0]);
    }
}
