//! The best that a factor and a summand for each channel could do, if the truth were known.

use decouplegs::scene::{ColorTransfer, SplatCloud, sh};

/// The change of DC terms that brings `canonical` nearest to `truth` in the mean square, each splat
/// counting by its weight. Bands above stay as they are. Both clouds hold the same splats.
pub fn best_on_dc(canonical: &SplatCloud, truth: &SplatCloud, weights: &[f32]) -> ColorTransfer {
    // As a plain expansion, which transfers act on.
    let shift = sh::DC_SHIFT;
    let mut transfer = ColorTransfer::IDENTITY;
    for channel in 0..3 {
        let plain =
            |cloud: &SplatCloud, splat: usize| f64::from(cloud.sh_dc[splat][channel]) + shift;
        let (mut sum, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (splat, weight) in weights.iter().enumerate() {
            let (weight, from, to) = (
                f64::from(*weight),
                plain(canonical, splat),
                plain(truth, splat),
            );
            sum += weight;
            x += weight * from;
            y += weight * to;
            xx += weight * from * from;
            xy += weight * from * to;
        }
        let variance = sum * xx - x * x;
        // Where all are of one color, its change alone is known.
        let gain = if variance > 1e-9 * sum * xx {
            (sum * xy - x * y) / variance
        } else {
            0.0
        };
        let offset = if sum > 0.0 { (y - gain * x) / sum } else { 0.0 };
        if sum > 0.0 {
            transfer.gain[0][channel] = gain as f32;
            transfer.offset[0][channel] = offset as f32;
        }
    }
    transfer
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(dc: &[[f32; 3]]) -> SplatCloud {
        SplatCloud {
            sh_dc: dc.to_vec(),
            ..SplatCloud::with_degree(0)
        }
    }

    #[test]
    fn a_change_of_brightness_and_hue_is_found_again() {
        let canonical = cloud(&[[0.1, 0.2, 0.3], [0.5, -0.4, 0.3], [-0.7, 0.8, 0.3]]);
        let shift = sh::DC_SHIFT as f32;
        let lit = |dc: &[f32; 3]| {
            [
                2.0 * (dc[0] + shift) - shift,
                0.5 * (dc[1] + shift) + 0.1 - shift,
                dc[2] - 0.2,
            ]
        };
        let truth = cloud(&canonical.sh_dc.iter().map(lit).collect::<Vec<_>>());
        let found = best_on_dc(&canonical, &truth, &[1.0, 0.5, 2.0]);
        for (found, expected) in [
            (found.gain[0][0], 2.0),
            (found.gain[0][1], 0.5),
            (found.offset[0][1], 0.1),
        ] {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
        // One color: it becomes the true one.
        assert!(
            (
                found.gain[0][2],
                (found.offset[0][2] - (0.1 + shift)).abs() < 1e-5
            ) == (0.0, true)
        );
        // Splats that are not seen do not count, and without any nothing changes.
        let mut stray = truth.clone();
        stray.sh_dc[1] = [9.0; 3];
        assert!((best_on_dc(&canonical, &stray, &[1.0, 0.0, 2.0]).gain[0][0] - 2.0).abs() < 1e-5);
        assert_eq!(
            best_on_dc(&canonical, &truth, &[0.0; 3]),
            ColorTransfer::IDENTITY
        );
    }
}
