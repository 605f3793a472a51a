//! Pinhole cameras in the words of the f-theta model, which is the one that readers of packages know.

use decouplegs_scene::{Intrinsics, Lens};
use serde_json::{Value, json};

/// Coefficients of a polynomial, the constant first.
const COEFFICIENTS: usize = 6;
/// Angles at which the polynomial is fitted.
const SAMPLES: usize = 64;

/// The model of a camera: f-theta for a pinhole. A lens has none here, and what cannot be told is not told wrongly.
pub(super) fn model(intrinsics: &Intrinsics) -> Value {
    if intrinsics.lens == Lens::default() {
        json!({"type": "ftheta", "parameters": f_theta(intrinsics)})
    } else {
        json!({"type": "other", "parameters": {"resolution": [intrinsics.width_px, intrinsics.height_px]}})
    }
}

/// The parameters of `intrinsics` as f-theta: distance from the principal point against the angle from the axis, and back, as
/// polynomials of the fifth degree up to the farthest corner.
fn f_theta(intrinsics: &Intrinsics) -> Value {
    let Intrinsics { width_px, height_px, fx_px, fy_px, cx_px, cy_px, .. } = *intrinsics;
    let reach = |centre: f64, size: u32| centre.abs().max((f64::from(size) - centre).abs());
    let (x, y) = (reach(cx_px, width_px) / fx_px, reach(cy_px, height_px) / fy_px);
    let angle_max = x.hypot(y).atan();
    let angles: Vec<f64> = (0..SAMPLES).map(|i| angle_max * (i as f64 + 0.5) / SAMPLES as f64).collect();
    let distances: Vec<f64> = angles.iter().map(|angle| fy_px * angle.tan()).collect();
    json!({
        "resolution": [width_px, height_px],
        "shutter_type": "GLOBAL",
        "external_distortion_parameters": null,
        "principal_point": [cx_px, cy_px],
        "reference_poly": "ANGLE_TO_PIXELDIST",
        "pixeldist_to_angle_poly": fit(&distances, &angles),
        "angle_to_pixeldist_poly": fit(&angles, &distances),
        "max_angle": angle_max,
        // Pixels are as wide as fx says where the polynomial says fy.
        "linear_cde": [fx_px / fy_px, 0.0, 0.0],
    })
}

/// The polynomial without a constant that is nearest to `to` at `from`, least squares.
fn fit(from: &[f64], to: &[f64]) -> [f64; COEFFICIENTS] {
    const UNKNOWNS: usize = COEFFICIENTS - 1;
    // Between 0 and 1, where powers are of a size.
    let scale = from.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let mut normal = [[0.0; UNKNOWNS + 1]; UNKNOWNS];
    for (&x, &y) in from.iter().zip(to) {
        let powers: [f64; UNKNOWNS] = std::array::from_fn(|k| (x / scale).powi(k as i32 + 1));
        for (row, power) in normal.iter_mut().zip(powers) {
            for (cell, other) in row.iter_mut().zip(powers.into_iter().chain([y])) {
                *cell += power * other;
            }
        }
    }
    for pivot in 0..UNKNOWNS {
        let best = (pivot..UNKNOWNS).max_by(|&a, &b| normal[a][pivot].abs().total_cmp(&normal[b][pivot].abs())).unwrap_or(pivot);
        normal.swap(pivot, best);
        let head = normal[pivot];
        for (row, values) in normal.iter_mut().enumerate() {
            if row != pivot {
                let factor = values[pivot] / head[pivot];
                values.iter_mut().zip(head).for_each(|(value, head)| *value -= factor * head);
            }
        }
    }
    let mut coefficients = [0.0; COEFFICIENTS];
    for (k, row) in normal.iter().enumerate() {
        coefficients[k + 1] = row[UNKNOWNS] / row[k] / scale.powi(k as i32 + 1);
    }
    coefficients
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_usual_camera_is_told_to_a_fraction_of_a_pixel() {
        let square = Intrinsics::from_horizontal_fov(1600, 900, 1.0);
        let intrinsics = Intrinsics { fx_px: 1266.4, fy_px: 1266.4, cx_px: 816.3, cy_px: 491.5, ..square };
        let model = f_theta(&intrinsics);
        let polynomial = |name: &str, x: f64| -> f64 {
            model[name].as_array().unwrap().iter().rev().fold(0.0, |sum, c| sum * x + c.as_f64().unwrap())
        };
        let angle_max = model["max_angle"].as_f64().unwrap();
        for step in 0..=100 {
            let angle = angle_max * f64::from(step) / 100.0;
            let distance_px = 1266.4 * angle.tan();
            assert!((polynomial("angle_to_pixeldist_poly", angle) - distance_px).abs() < 0.05, "{angle}");
            assert!((polynomial("pixeldist_to_angle_poly", distance_px) - angle).abs() < 5e-5, "{angle}");
        }
    }
}
