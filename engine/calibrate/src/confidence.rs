//! Errors of a fit, from lights that it was not shown.

use decouplegs_scene::light::TransferConfidence;
use decouplegs_scene::{AmbientDescriptor, LightTransfer};
use nalgebra::DMatrix;

use super::held_out::best_affine;
use super::moments::{LightMoments, Moments};
use super::ridge::standard_of;

/// Added to the variance of each standardized number of the descriptor: a direction that hardly any
/// light has differs by noise.
const VARIANCE_MIN: f64 = 1e-3;

/// Confidence of a fit to `fitted`, all lights. `judged` holds transfers, each with a light that
/// was left out of its fit: its descriptor and its moments.
pub(super) fn confidence(
    moments: &Moments,
    fitted: &[&LightMoments],
    judged: &[(&LightTransfer, &AmbientDescriptor, &LightMoments)],
) -> TransferConfidence {
    let count = moments.coefficients;
    let effect = |row: usize| {
        let (k, gram) = (row / 3, &moments.gram[row % 3]);
        [
            gram[(k, k)],
            gram[(k, count + k)],
            gram[(count + k, count + k)],
        ]
        .map(|value| value as f32)
    };
    let (light_mean, light_precision) = distribution(fitted);
    let mut confidence = TransferConfidence {
        effect: (0..3 * count).map(effect).collect(),
        residual: vec![0.0; count],
        light_mean,
        light_precision,
    };
    let mut residual = vec![0.0; count];
    let mut shown = 0.0;
    for &(transfer, descriptor, light) in judged {
        let (found, best) = (transfer.at(descriptor), best_affine(moments, light));
        for (k, sum) in residual.iter_mut().enumerate() {
            *sum += confidence.change(k, &best, &found);
        }
        shown += confidence.shown(0, &best);
    }
    if shown > 0.0 {
        confidence.residual = residual.iter().map(|sum| (sum / shown) as f32).collect();
    }
    confidence
}

/// Mean of the descriptors of `lights` and their inverse covariance.
fn distribution(
    lights: &[&LightMoments],
) -> (
    [f32; AmbientDescriptor::LEN],
    Vec<[f32; AmbientDescriptor::LEN]>,
) {
    const LEN: usize = AmbientDescriptor::LEN;
    let standard = standard_of(lights);
    let mut covariance = DMatrix::from_diagonal_element(LEN, LEN, VARIANCE_MIN);
    for light in lights {
        let row = standard.row(&light.descriptor);
        for i in 0..LEN {
            for j in 0..LEN {
                covariance[(i, j)] += row[i] * row[j] / lights.len() as f64;
            }
        }
    }
    let inverse = covariance
        .cholesky()
        .expect("a positive definite matrix has a Cholesky factor")
        .inverse();
    let (means, deviations) = standard.parts();
    let row = |i: usize| {
        std::array::from_fn(|j| (inverse[(i, j)] / (deviations[i] * deviations[j])) as f32)
    };
    (
        std::array::from_fn(|index| means[index] as f32),
        (0..LEN).map(row).collect(),
    )
}
