//! Accumulated blending weights of splats.

use decouplegs_scene::Camera;

use crate::output::Outputs;
use crate::{RenderError, RenderOptions, Renderer, ResidentSplats};

impl Renderer {
    /// The sum of each background splat's weights over all pixels of the frame that was finished
    /// last, in the order of splats. Empty where [`Outputs::contributions`](crate::Outputs) were
    /// not asked for.
    ///
    /// # Errors
    /// Returns an error if the device was lost.
    pub fn read_contributions(&self) -> Result<Vec<f32>, RenderError> {
        let Some((_, images)) = self.shown_images() else {
            return Ok(Vec::new());
        };
        let scale = images.contribution_scale();
        let steps = self.gpu().read(&images.contributions)?;
        Ok(steps.iter().map(|&steps| steps as f32 / scale).collect())
    }

    /// Sums the blending weights T alpha of each splat of `background` over all pixels of all
    /// `cameras`, by this renderer's rules.
    ///
    /// Cameras are drawn one after the other, with buffers of their own.
    ///
    /// # Errors
    /// Returns the errors of [`Renderer::render`].
    pub fn contribution_weights(
        &self,
        background: &ResidentSplats,
        cameras: &[Camera],
    ) -> Result<Vec<f32>, RenderError> {
        let outputs = Outputs {
            contributions: true,
            ..Outputs::default()
        };
        let options = RenderOptions {
            outputs,
            keep_keys: false,
            frames_in_flight: 1,
            ..*self.options()
        };
        let mut renderer = Self::new(self.gpu(), options);
        let mut sums = vec![0.0f64; background.splats];
        for camera in cameras {
            renderer.render(background, std::slice::from_ref(camera))?;
            for (sum, weight) in sums.iter_mut().zip(renderer.read_contributions()?) {
                *sum += f64::from(weight);
            }
        }
        Ok(sums.into_iter().map(|sum| sum as f32).collect())
    }
}
