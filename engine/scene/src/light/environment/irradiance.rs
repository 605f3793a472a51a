//! Irradiance: the light of a probe that falls on surfaces, by the way they face.

use std::f64::consts::PI;

use crate::sh;
use glam::DVec3;
use rayon::prelude::*;

use super::probe::Probe;

/// Columns of the map; between its points 2.8 degrees apart irradiance is taken as linear.
const WIDTH: usize = 128;
/// Rows; the first is the zenith, the last the nadir.
const HEIGHT: usize = 65;

/// E(n) / pi of a probe for every unit vector n, linear RGB: what a white surface that faces n
/// reflects.
#[derive(Clone, Debug)]
pub struct IrradianceMap {
    /// Row-major; columns as in [`Probe`], their values at their left edges.
    values: Vec<[f64; 3]>,
}

/// E(n) / pi by integration over all pixels of `probe`.
#[must_use]
pub fn reflected_by_white(probe: &Probe, normal: DVec3) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (direction, steradians, rgb) in probe.rays() {
        let weight = steradians * normal.dot(direction).max(0.0) / PI;
        (0..3).for_each(|channel| sum[channel] += weight * rgb[channel]);
    }
    sum
}

impl IrradianceMap {
    /// The map of `probe`, by integration over its pixels at each point of the map.
    #[must_use]
    pub fn new(probe: &Probe) -> Self {
        let rays: Vec<(DVec3, [f64; 3])> = probe
            .rays()
            .map(|(direction, steradians, rgb)| {
                (direction, rgb.map(|value| value * steradians / PI))
            })
            .filter(|(_, rgb)| *rgb != [0.0; 3])
            .collect();
        let at = |point: usize| {
            let from_zenith = PI * (point / WIDTH) as f64 / (HEIGHT - 1) as f64;
            let azimuth = PI * (1.0 - 2.0 * (point % WIDTH) as f64 / WIDTH as f64);
            let (radius, z) = from_zenith.sin_cos();
            let normal = DVec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z);
            rays.iter()
                .fold([0.0; 3], |sum: [f64; 3], (direction, rgb)| {
                    let cosine = normal.dot(*direction).max(0.0);
                    std::array::from_fn(|channel| sum[channel] + cosine * rgb[channel])
                })
        };
        Self {
            values: (0..WIDTH * HEIGHT).into_par_iter().map(at).collect(),
        }
    }

    /// E(n) / pi, linear RGB, for a unit vector.
    #[must_use]
    pub fn reflected_by_white(&self, normal: DVec3) -> [f64; 3] {
        let x = 0.5 * (1.0 - normal.y.atan2(normal.x) / PI) * WIDTH as f64;
        let y = normal.z.clamp(-1.0, 1.0).acos() / PI * (HEIGHT - 1) as f64;
        let row = (y as usize).min(HEIGHT - 2);
        let column = (x as usize).min(WIDTH - 1);
        let (across, down) = (x - column as f64, y - row as f64);
        let value = |row: usize, column: usize| self.values[row * WIDTH + column % WIDTH];
        let corners = [
            value(row, column),
            value(row, column + 1),
            value(row + 1, column),
            value(row + 1, column + 1),
        ];
        let weights = [
            (1.0 - across) * (1.0 - down),
            across * (1.0 - down),
            (1.0 - across) * down,
            across * down,
        ];
        std::array::from_fn(|channel| {
            corners
                .iter()
                .zip(weights)
                .map(|(corner, weight)| weight * corner[channel])
                .sum()
        })
    }
}

/// E(n) / pi from bands 0 to 2 of the probe's radiance alone (Ramamoorthi and Hanrahan, An
/// Efficient Representation for Irradiance Environment Maps, 2001): the reading of
/// [`IrradianceMap`] that shares no code with it.
#[must_use]
pub fn reflected_by_white_of_nine(probe: &Probe, normal: DVec3) -> [f64; 3] {
    /// A_l / pi of bands 0, 1 and 2.
    const COSINE_LOBE: [f64; 3] = [1.0, 2.0 / 3.0, 0.25];
    let mut coefficients = [[0.0; 3]; 9];
    for (direction, steradians, rgb) in probe.rays() {
        let basis = sh::basis(direction);
        for (coefficient, y) in coefficients.iter_mut().zip(basis) {
            (0..3).for_each(|channel| coefficient[channel] += steradians * y * rgb[channel]);
        }
    }
    let basis = sh::basis(normal);
    let weight = |k: usize| COSINE_LOBE[k.isqrt()] * basis[k];
    std::array::from_fn(|channel| (0..9).map(|k| weight(k) * coefficients[k][channel]).sum())
}
