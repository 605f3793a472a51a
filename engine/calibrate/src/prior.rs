//! Prior of the fit: light acts on red as on green and blue.
//!
//! A few probes have few hues, and 27 weights a row would learn them by heart. The prior has 9 and
//! a constant, the same for all channels, each looking at its own channel of L: every probe tells
//! it three times what light does, and hues mix in no way that was not seen. The ridge decides how
//! far the fit of all 27 may leave it.

use decouplegs_scene::AmbientDescriptor;
use nalgebra::{DMatrix, DVector};

use super::moments::{LightMoments, Moments};
use super::ridge::{COLUMNS, Theta, weights_of};
use super::standard::Standard;

/// Weights and a constant of each row.
const OWN_COLUMNS: usize = AmbientDescriptor::COEFFICIENTS + 1;

/// The prior of fits to `lights`, its weights themselves drawn by `ridge`, which counts against
/// standardized columns.
///
/// Its own prior is that light multiplies every coefficient as it multiplies DC in a fit of DC
/// alone, and adds nothing: bands 1 to 3 of an asset hardly show, and their gains would be
/// arbitrary without.
pub(super) fn prior(moments: &Moments, lights: &[&LightMoments], ridge: f64) -> Theta {
    let count = moments.coefficients;
    let of_direct = direct(moments, lights);
    let direct_lights: Vec<&LightMoments> = of_direct.lights.iter().collect();
    let fitted = fit(
        &of_direct,
        &direct_lights,
        &vec![vec![0.0; OWN_COLUMNS]; 2],
        ridge,
    );
    let drawn_to: Vec<Vec<f64>> = (0..2 * count)
        .map(|row| {
            if row < count {
                fitted[0].clone()
            } else {
                vec![0.0; OWN_COLUMNS]
            }
        })
        .collect();
    let own = fit(moments, lights, &drawn_to, ridge);
    Theta(std::array::from_fn(|channel| {
        DMatrix::from_fn(2 * count, COLUMNS, |row, column| match column {
            AmbientDescriptor::LEN => own[row][OWN_COLUMNS - 1],
            column if column % 3 == channel => own[row][column / 3],
            _ => 0.0,
        })
    }))
}

/// The moments of DC alone.
fn direct(moments: &Moments, lights: &[&LightMoments]) -> Moments {
    let count = moments.coefficients;
    let of_light = |light: &&LightMoments| LightMoments {
        cross: std::array::from_fn(|channel| {
            vec![light.cross[channel][0], light.cross[channel][count]]
        }),
        ..(*light).clone()
    };
    let corner = |channel: usize| {
        DMatrix::from_fn(2, 2, |i, j| moments.gram[channel][(i * count, j * count)])
    };
    Moments {
        coefficients: 1,
        gram: std::array::from_fn(corner),
        lights: lights.iter().map(of_light).collect(),
    }
}

/// Descriptor of one channel of a light.
fn own_descriptor(light: &LightMoments, channel: usize) -> [f64; AmbientDescriptor::COEFFICIENTS] {
    std::array::from_fn(|k| light.descriptor[3 * k + channel])
}

/// The weights of each of the 2K rows, shared by the channels.
fn fit(
    moments: &Moments,
    lights: &[&LightMoments],
    drawn_to: &[Vec<f64>],
    ridge: f64,
) -> Vec<Vec<f64>> {
    let rows = 2 * moments.coefficients;
    let own: Vec<[f64; 9]> = lights
        .iter()
        .flat_map(|light| (0..3).map(|channel| own_descriptor(light, channel)))
        .collect();
    let standard = Standard::from_rows(own.iter().map(<[f64; 9]>::as_slice));
    let mean_square = |row: usize| {
        moments
            .gram
            .iter()
            .map(|gram| gram[(row, row)])
            .sum::<f64>()
            / 3.0
    };
    // A coefficient that no sample has: nothing is known of its gain, and what it is drawn to
    // stands.
    let scales: Vec<f64> = (0..rows)
        .map(|row| mean_square(row).sqrt())
        .map(|scale| if scale > 0.0 { scale } else { 1.0 })
        .collect();

    let mut normal = DMatrix::<f64>::zeros(rows * OWN_COLUMNS, rows * OWN_COLUMNS);
    let mut right = DVector::<f64>::zeros(rows * OWN_COLUMNS);
    let weights = weights_of(lights);
    for channel in 0..3 {
        let mut design = [[0.0; OWN_COLUMNS]; OWN_COLUMNS];
        for ((light, weight), own) in lights
            .iter()
            .zip(&weights)
            .zip(own.iter().skip(channel).step_by(3))
        {
            let columns = standard.row(own);
            for (i, value) in columns.iter().enumerate() {
                let value = value * weight / 3.0;
                design[i]
                    .iter_mut()
                    .zip(&columns)
                    .for_each(|(sum, other)| *sum += value * other);
                for row in 0..rows {
                    right[row * OWN_COLUMNS + i] += value * light.cross[channel][row] / scales[row];
                }
            }
        }
        for (a, b) in (0..rows).flat_map(|a| (0..rows).map(move |b| (a, b))) {
            let gram = moments.gram[channel][(a, b)] / (scales[a] * scales[b]);
            for (i, j) in (0..OWN_COLUMNS).flat_map(|i| (0..OWN_COLUMNS).map(move |j| (i, j))) {
                normal[(a * OWN_COLUMNS + i, b * OWN_COLUMNS + j)] += gram * design[i][j];
            }
        }
    }
    for row in 0..rows {
        for (i, value) in standard.to_standardized(&drawn_to[row]).iter().enumerate() {
            normal[(row * OWN_COLUMNS + i, row * OWN_COLUMNS + i)] += ridge;
            right[row * OWN_COLUMNS + i] += ridge * value * scales[row];
        }
    }
    // A Gram matrix plus a multiple of the identity.
    let solved = normal
        .cholesky()
        .expect("a positive definite matrix has a Cholesky factor")
        .solve(&right);
    let plain = |row: usize| {
        let weights: Vec<f64> = (0..OWN_COLUMNS)
            .map(|i| solved[row * OWN_COLUMNS + i] / scales[row])
            .collect();
        standard.to_plain(&weights)
    };
    (0..rows).map(plain).collect()
}
