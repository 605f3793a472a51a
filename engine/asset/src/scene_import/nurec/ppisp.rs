//! PPISP: what cameras and their images did to the colors of a recording (arXiv 2601.18336,
//! nv-tlabs/ppisp, `tests/torch_reference.py`), as photometry of the cameras.
//!
//! Vignetting and response belong to a camera. Exposure and color belong to a image: a camera
//! gets their means over its images.

use decouplegs_scene::photometry::{ColorCurve, Photometry, Response, Vignetting};
use decouplegs_scene::{Intrinsics, Rig};
use glam::{DMat2, DMat3, DVec2, DVec3};

use super::state::{Array, State};
use crate::DecodeError;

/// Part of the names of the arrays.
const PART: &str = ".ppisp.";
/// Offsets of chromaticity from the stored numbers of blue, red, green and gray, by columns.
const OFFSETS: [DMat2; 4] = [
    DMat2::from_cols_array(&[0.0480542, -0.0043631, -0.0043631, 0.0481283]),
    DMat2::from_cols_array(&[0.0580570, -0.0179872, -0.0179872, 0.0431061]),
    DMat2::from_cols_array(&[0.0433336, -0.0180537, -0.0180537, 0.0580500]),
    DMat2::from_cols_array(&[0.0128369, -0.0034654, -0.0034654, 0.0128158]),
];

/// Gives the cameras of `rig` the calibration that `state` holds. `order` names the cameras in the
/// order of the arrays, and `images` counts those of each camera there, if they are known.
///
/// # Errors
/// A sentence that names the array of a wrong shape, or the camera whose numbers cannot be used.
pub(super) fn calibrate(
    rig: &mut Rig,
    state: &State<'_>,
    order: &[String],
    images: &[usize],
) -> Result<Vec<String>, DecodeError> {
    let find = |end: &str| {
        let name = state
            .names()
            .find(|name| name.contains(PART) && name.ends_with(end))?
            .to_owned();
        Some((state.get(&name)?, name))
    };
    let mut notes = Vec::new();
    if !state.names().any(|name| name.contains(PART)) {
        return Ok(notes);
    }
    let vignetting = find("vignetting_params").map(|(array, name)| rows::<15>(array, &name));
    let response = find("crf_params").map(|(array, name)| rows::<12>(array, &name));
    let exposure = find("exposure_params").map(|(array, name)| rows::<1>(array, &name));
    let color = find("color_params").map(|(array, name)| rows::<8>(array, &name));
    let (vignetting, response) = (vignetting.transpose()?, response.transpose()?);
    let (exposure, color) = (exposure.transpose()?, color.transpose()?);
    let counts = [
        vignetting.as_ref().map(Vec::len),
        response.as_ref().map(Vec::len),
    ];
    let wrong = counts.iter().flatten().find(|count| **count != order.len());
    if let Some(count) = wrong {
        notes.push(format!(
            "the photometry of the cameras (PPISP) is for {count} cameras, and the package has {}: images have the colors of the splats",
            order.len()
        ));
        return Ok(notes);
    }
    for camera in rig.cameras_mut() {
        let Some(index) = order.iter().position(|name| *name == camera.name) else {
            notes.push(format!(
                "camera {} has no photometry (PPISP): its images have the colors of the splats",
                camera.name
            ));
            continue;
        };
        let mut photometry = Photometry {
            exposure_ev: exposure
                .as_deref()
                .map_or(0.0, |of| mean(of, images, index)[0]),
            curve: ColorCurve::Linear,
            ..Photometry::IDENTITY
        };
        photometry.vignetting = vignetting
            .as_ref()
            .map(|of| vignetting_of(&of[index], &camera.intrinsics));
        photometry.balance = color
            .as_deref()
            .map(|of| balance_of(&mean(of, images, index)));
        photometry.response = response.as_ref().map(|of| response_of(&of[index]));
        photometry.check().map_err(|reason| {
            DecodeError::Malformed(format!(
                "photometry (PPISP) of camera {}: {reason}",
                camera.name
            ))
        })?;
        camera.intrinsics.photometry = photometry;
    }
    Ok(notes)
}

/// Rows of `N` numbers, whatever the dimensions behind the first.
fn rows<const N: usize>(array: &Array<'_>, name: &str) -> Result<Vec<[f64; N]>, DecodeError> {
    let rows = if array.shape().len() == 1 && N == 1 {
        array.columns(array.len(), 1, 0)
    } else {
        array.rows::<N>(name)?
    };
    Ok(rows.into_iter().map(|row| row.map(f64::from)).collect())
}

/// Mean of those `rows` that are of the images of `camera`. All are where `images`, the counts
/// of the cameras, do not add up to the rows, or the camera has none.
fn mean<const N: usize>(rows: &[[f64; N]], images: &[usize], camera: usize) -> [f64; N] {
    let own = || {
        let is_known = images.iter().sum::<usize>() == rows.len();
        let first = images.get(..camera)?.iter().sum::<usize>();
        let own = rows.get(first..first + images.get(camera)?)?;
        (is_known && !own.is_empty()).then_some(own)
    };
    let rows = own().unwrap_or(rows);
    let mut sum = [0.0; N];
    for row in rows {
        sum.iter_mut()
            .zip(row)
            .for_each(|(sum, value)| *sum += value);
    }
    sum.map(|sum| sum / rows.len().max(1) as f64)
}

/// Vignetting whose lengths are in the longer side of the image, from its middle.
fn vignetting_of(of: &[f64; 15], intrinsics: &Intrinsics) -> Vignetting {
    let size_px = [intrinsics.width_px, intrinsics.height_px].map(f64::from);
    let unit_px = size_px[0].max(size_px[1]);
    let channel = |channel: usize| &of[5 * channel..5 * channel + 5];
    Vignetting {
        center_px: [0, 1, 2].map(|of| {
            let center = channel(of);
            [0, 1].map(|axis| 0.5 * size_px[axis] + unit_px * center[axis])
        }),
        radius_px: [unit_px; 2],
        rgb: [0, 1, 2].map(|of| [2, 3, 4].map(|power| channel(of)[power])),
    }
}

fn response_of(of: &[f64; 12]) -> Response {
    let soft_plus = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
    let each = |at: usize| [0, 1, 2].map(|channel| of[4 * channel + at]);
    Response {
        toe: each(0).map(|raw| 0.3 + soft_plus(raw)),
        shoulder: each(1).map(|raw| 0.3 + soft_plus(raw)),
        gamma: each(2).map(|raw| 0.1 + soft_plus(raw)),
        center: each(3).map(|raw| 1.0 / (1.0 + (-raw).exp())),
    }
}

/// The homography that puts blue, red, green and gray where the stored numbers say.
fn balance_of(of: &[f64; 8]) -> [[f64; 3]; 3] {
    let target = |at: usize, source: DVec2| {
        let stored = DVec2::new(of[2 * at], of[2 * at + 1]);
        (source + OFFSETS[at] * stored).extend(1.0)
    };
    let gray = target(3, DVec2::splat(1.0 / 3.0));
    let targets = DMat3::from_cols(
        target(0, DVec2::ZERO),
        target(1, DVec2::X),
        target(2, DVec2::Y),
    );
    // Weights of the three, with which their sum points to gray: the null space of this product.
    let cross = DMat3::from_cols(
        DVec3::new(0.0, gray.z, -gray.y),
        DVec3::new(-gray.z, 0.0, gray.x),
        DVec3::new(gray.y, -gray.x, 0.0),
    );
    let product = cross * targets;
    let [a, b, c] = [0, 1, 2].map(|row| product.row(row));
    let weights =
        [a.cross(b), a.cross(c), b.cross(c)]
            .into_iter()
            .fold(DVec3::ZERO, |best, found| {
                if found.length_squared() > best.length_squared() {
                    found
                } else {
                    best
                }
            });
    let source_inverse = DMat3::from_cols_array(&[-1.0, 1.0, 0.0, -1.0, 0.0, 1.0, 1.0, 0.0, 0.0]);
    let turned = targets * DMat3::from_diagonal(weights) * source_inverse;
    let turned = turned * (1.0 / (turned.z_axis.z + 1e-10));
    [0, 1, 2].map(|row| turned.row(row).to_array())
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLOR: [f64; 8] = [0.5, -0.25, 0.75, 0.5, -0.5, 0.25, 1.0, -0.5];

    /// A color, where it is in the image, and what becomes of it.
    const EXPECTED: [([f64; 3], [f64; 2], [f64; 3]); 3] = [
        (
            [0.2, 0.5, 0.3],
            [10.5, 8.5],
            [0.3682885868632145, 0.657282918365456, 0.5190173690622994],
        ),
        (
            [0.05, 0.6, 0.9],
            [60.5, 40.5],
            [0.1468212464080631, 0.7393773535614202, 0.9999999994878522],
        ),
        (
            [0.0; 3],
            [32.0, 24.0],
            [
                0.0003593669178866077,
                2.7820407095585305e-6,
                5.286032855323854e-5,
            ],
        ),
    ];

    /// Values of `ppisp_apply_torch` of nv-tlabs/ppisp (`tests/torch_reference.py`) in f64.
    #[test]
    fn colors_are_those_of_the_public_reference() {
        let vignetting = [
            [0.01, -0.02, -0.3, 0.1, -0.05],
            [0.0, 0.03, -0.2, 0.0, 0.0],
            [-0.02, 0.01, -0.25, 0.05, 0.0],
        ];
        let response = [
            [0.5, 0.25, -0.5, 0.1],
            [0.0, 0.5, 0.25, -0.25],
            [-0.25, 0.75, 0.0, 0.5],
        ];
        let intrinsics = Intrinsics::centered([64, 48], 50.0);
        let photometry = Photometry {
            exposure_ev: 0.25,
            curve: ColorCurve::Linear,
            vignetting: Some(vignetting_of(
                vignetting.as_flattened().try_into().unwrap(),
                &intrinsics,
            )),
            balance: Some(balance_of(&COLOR)),
            response: Some(response_of(response.as_flattened().try_into().unwrap())),
            ..Photometry::IDENTITY
        };
        for (rgb, at_px, expected) in EXPECTED {
            let found = photometry.color(rgb, at_px);
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-7, "{found} {expected}");
            }
        }
    }

    #[test]
    fn numbers_of_zero_balance_nothing() {
        let identity = balance_of(&[0.0; 8]);
        for (row, expected) in identity.iter().zip(DMat3::IDENTITY.to_cols_array_2d()) {
            for (found, expected) in row.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-9, "{identity:?}");
            }
        }
    }

    #[test]
    fn a_camera_has_the_mean_of_its_own_images() {
        let rows = [[1.0], [3.0], [8.0]];
        let of = |images: &[usize], camera| mean(&rows, images, camera)[0];
        assert_eq!((of(&[2, 1], 0), of(&[2, 1], 1)), (2.0, 8.0));
        // Unknown, none of its own, and more or fewer than there are: the mean of all.
        for (images, camera) in [
            (&[][..], 0),
            (&[0, 3][..], 0),
            (&[2, 9][..], 1),
            (&[1, 1][..], 0),
        ] {
            assert_eq!(of(images, camera), 4.0);
        }
    }
}
