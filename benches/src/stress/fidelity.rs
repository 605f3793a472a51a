//! Similarity of images to those of vanilla, over several moments and cameras.

use anyhow::Result;
use decouplegs::render::Image;
use serde_json::{Value, json};

use crate::image_quality::differences;

/// Errors of all images together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fidelity {
    /// Signal-to-noise ratio from the mean squared error over all pixels, decibels; infinite for
    /// equal images.
    pub psnr_all_db: f64,
    /// Signal-to-noise ratio over pixels that show an agent, decibels; `None` where none does.
    pub psnr_vehicles_db: Option<f64>,
    /// Mean over images; `None` where they are too small.
    pub ssim: Option<f64>,
    pub max_abs: f64,
    pub images: usize,
}

impl Fidelity {
    /// Similarity of `found` to `expected`, which also mark the pixels of agents. Both hold at
    /// least one image.
    pub fn between(found: &[Image], expected: &[Image]) -> Result<Self> {
        let pairs = || found.iter().zip(expected);
        let differences = differences(found, expected)?;
        let ssims: Vec<f64> = differences
            .iter()
            .filter_map(|difference| difference.ssim)
            .collect();
        Ok(Self {
            psnr_all_db: psnr_db(
                pairs().map(|(found, expected)| errors(found, expected, |_| true)),
            )
            .unwrap_or(f64::INFINITY),
            psnr_vehicles_db: psnr_db(
                pairs().map(|(found, expected)| errors(found, expected, |id| id != 0)),
            ),
            ssim: (!ssims.is_empty()).then(|| ssims.iter().sum::<f64>() / ssims.len() as f64),
            max_abs: differences
                .iter()
                .map(|difference| difference.max_abs)
                .fold(0.0, f64::max),
            images: differences.len(),
        })
    }

    pub fn to_json(self) -> Value {
        // JSON has no infinity: null stands for it, beside `equal`.
        let decibels = |psnr_db: f64| psnr_db.is_finite().then_some(psnr_db);
        json!({
            "equal": self.psnr_all_db.is_infinite(),
            "psnr_all_db": decibels(self.psnr_all_db),
            "psnr_vehicles_db": self.psnr_vehicles_db.and_then(decibels),
            "ssim": self.ssim,
            "max_abs": self.max_abs,
            "images": self.images,
        })
    }
}

/// Sum of the squared errors of the channels of those pixels whose instance `counts`, and how many
/// channels they are.
fn errors(found: &Image, expected: &Image, counts: impl Fn(u16) -> bool) -> (f64, usize) {
    let instances = expected.instance().unwrap_or(&[]);
    let mut sum = (0.0, 0);
    for (at, (found, expected)) in found.rgb.iter().zip(&expected.rgb).enumerate() {
        if counts(instances.get(at).copied().unwrap_or(0)) {
            sum.0 += found
                .iter()
                .zip(expected)
                .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
                .sum::<f64>();
            sum.1 += 3;
        }
    }
    sum
}

fn psnr_db(errors: impl Iterator<Item = (f64, usize)>) -> Option<f64> {
    let (sum, channels) = errors.fold((0.0, 0), |all, one| (all.0 + one.0, all.1 + one.1));
    (channels > 0).then(|| -10.0 * (sum / channels as f64).log10())
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::render::{Plane, PlaneMap, PlaneValues};

    #[test]
    fn vehicles_are_the_pixels_that_the_expected_image_says() {
        let gray = |value: f32| Image::filled(16, 16, [value; 3]);
        let mut instances = vec![0; 256];
        instances[..64].fill(3);
        let expected = Image {
            planes: PlaneMap::from([(Plane::Instance, PlaneValues::U16(instances))]),
            ..gray(0.5)
        };
        let mut found = gray(0.5);
        found.rgb[..64].fill([0.6; 3]);
        let fidelity = Fidelity::between(&[found], std::slice::from_ref(&expected)).unwrap();
        // 0.01 on vehicles, a quarter of the image.
        assert!(
            (fidelity.psnr_vehicles_db.unwrap() - 20.0).abs() < 1e-4,
            "{fidelity:?}"
        );
        assert!(
            (fidelity.psnr_all_db - 26.0206).abs() < 1e-3 && (fidelity.max_abs - 0.1).abs() < 1e-6
        );
        let equal = Fidelity::between(&[gray(0.5), gray(0.2)], &[gray(0.5), gray(0.2)]).unwrap();
        assert_eq!(
            (equal.psnr_all_db, equal.psnr_vehicles_db, equal.images),
            (f64::INFINITY, None, 2)
        );
        assert_eq!(equal.to_json()["equal"], true);
        assert!(Fidelity::between(&[gray(0.5)], &[Image::filled(8, 8, [0.5; 3])]).is_err());
    }
}
