//! Loss in images: every version of an asset against the original, from the same cameras.

use std::thread;

use anyhow::Result;
use decouplegs_gpu::Gpu;
use decouplegs_render::metrics::Difference;
use decouplegs_render::{Image, RenderOptions, Renderer};
use decouplegs_scene::{Camera, SplatCloud, SplatScene};
use serde_json::{Value, json};

/// Color behind the asset: neither black nor white, so that what is missing shows on both dark and
/// light parts.
const SKY_RGB: [f32; 3] = [0.6, 0.7, 0.8];

/// Similarity of images to the original's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Signal-to-noise ratio from the mean squared error over all images, decibels; infinite for
    /// equal images.
    pub psnr_db: f64,
    /// Mean over images; `None` where they are too small for a window.
    pub ssim: Option<f64>,
}

impl Score {
    pub fn to_json(self) -> Value {
        json!({ "psnr_db": self.psnr_db.is_finite().then_some(self.psnr_db), "ssim": self.ssim })
    }

    fn between(found: &[Image], expected: &[Image]) -> Result<Self> {
        let (mut square_sum, mut ssims) = (0.0, Vec::new());
        for difference in differences(found, expected)? {
            square_sum += difference.rmse * difference.rmse;
            ssims.extend(difference.ssim);
        }
        let ssim = (!ssims.is_empty()).then(|| ssims.iter().sum::<f64>() / ssims.len() as f64);
        Ok(Self {
            psnr_db: -10.0 * (square_sum / found.len() as f64).log10(),
            ssim,
        })
    }
}

/// Difference of each of `found` from its counterpart in `expected`; several are compared at once.
pub fn differences(found: &[Image], expected: &[Image]) -> Result<Vec<Difference>> {
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let pairs: Vec<(&Image, &Image)> = found.iter().zip(expected).collect();
    let mut differences = Vec::new();
    for pairs in pairs.chunks(threads) {
        thread::scope(|scope| {
            let running: Vec<_> = pairs
                .iter()
                .map(|(found, expected)| scope.spawn(|| Difference::between(found, expected)))
                .collect();
            differences.extend(
                running
                    .into_iter()
                    .map(|thread| thread.join().expect("metrics do not panic")),
            );
        });
    }
    Ok(differences.into_iter().collect::<Result<_, _>>()?)
}

/// Cameras under one name, and what they see of the original.
pub struct Views {
    pub name: &'static str,
    pub what: String,
    pub cameras: Vec<Camera>,
    pub original: Vec<Image>,
}

/// Draws versions of an asset and scores them.
pub struct QualityMeter {
    renderer: Renderer,
    pub views: Vec<Views>,
}

impl QualityMeter {
    /// Scores against `original` from the `cameras` of each name; the second of each is what the
    /// cameras are, for the reader.
    pub fn new(
        gpu: &Gpu,
        original: &SplatCloud,
        cameras: Vec<(&'static str, String, Vec<Camera>)>,
    ) -> Result<Self> {
        let mut quality_meter = Self {
            renderer: Renderer::new(gpu, RenderOptions::default()),
            views: Vec::new(),
        };
        for (name, what, cameras) in cameras {
            let original = quality_meter.draw(original, &cameras)?;
            quality_meter.views.push(Views {
                name,
                what,
                cameras,
                original,
            });
        }
        Ok(quality_meter)
    }

    pub fn draw(&mut self, cloud: &SplatCloud, cameras: &[Camera]) -> Result<Vec<Image>> {
        let splat_scene = SplatScene {
            sky: SKY_RGB,
            ..SplatScene::from_splats(cloud.in_spatial_order())
        };
        let resident = self.renderer.upload(&splat_scene)?;
        self.renderer.render(&resident, cameras)?;
        Ok(self.renderer.read_images()?)
    }

    /// Similarity of `cloud` to the original, one score per view.
    pub fn score(&mut self, cloud: &SplatCloud) -> Result<Vec<Score>> {
        let mut scores = Vec::new();
        for at in 0..self.views.len() {
            let cameras = self.views[at].cameras.clone();
            let found = self.draw(cloud, &cameras)?;
            scores.push(Score::between(&found, &self.views[at].original)?);
        }
        Ok(scores)
    }

    /// Similarity of `found` to `expected`, both rendered for `cameras`.
    pub fn compare(
        &mut self,
        found: &SplatCloud,
        expected: &SplatCloud,
        cameras: &[Camera],
    ) -> Result<Score> {
        let expected = self.draw(expected, cameras)?;
        Score::between(&self.draw(found, cameras)?, &expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_averaged_before_the_logarithm() {
        let gray = |value: f32| Image::filled(16, 16, [value; 3]);
        let score = Score::between(&[gray(0.5), gray(0.5)], &[gray(0.5), gray(0.6)]).unwrap();
        // Squared errors 0 and 0.01.
        assert!((score.psnr_db - 23.0103).abs() < 1e-3, "{score:?}");
        let equal = Score::between(&[gray(0.5)], &[gray(0.5)]).unwrap();
        assert_eq!(
            (equal.psnr_db, equal.to_json()["psnr_db"].is_null()),
            (f64::INFINITY, true)
        );
        assert!((equal.ssim.unwrap() - 1.0).abs() < 1e-9);
    }
}
