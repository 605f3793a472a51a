//! Shares of agents that are hidden, or beyond the edges of an image.

use anyhow::{Context, Result};
use decouplegs_gpu::Gpu;
use decouplegs_render::reference::geometry;
use decouplegs_render::{Image, Outputs, Plane, RenderOptions, Renderer};
use decouplegs_scene::{Camera, SplatScene};

use crate::scene_source::DrawInput;

/// Width of the image in which an agent is counted, pixels, where the camera's is wider than that.
const COUNTED_WIDTH_PX: u32 = 400;

/// Largest reduction of an image in which an agent is counted.
const REDUCTION_MAX: u32 = 4;

/// An agent is hidden where something else is nearer by more than this, meters, and by more than
/// this share of its distance: splats of the ground before it reach over its edge.
const NEARER_M: f32 = 0.25;
const NEARER_SHARE: f32 = 0.03;

/// Pixels of which an agent would take half of the light or more if nothing else were there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coverage {
    /// Pixels inside the image.
    inside: u32,
    /// Pixels inside the image that nothing hides.
    visible: u32,
    /// Pixels in an image twice as wide and high around it; `None` if the lens ends before.
    around: Option<u32>,
}

impl Coverage {
    /// Share of the part inside the image that is visible, 0 to 1; `None` where nothing is inside.
    pub fn visible_fraction(&self) -> Option<f64> {
        (self.inside > 0).then(|| f64::from(self.visible) / f64::from(self.inside))
    }

    /// Share of the agent beyond the edges of the image, 0 to 1.
    pub fn truncated_fraction(&self) -> Option<f64> {
        let around = self.around.filter(|pixels| *pixels > 0)?;
        Some(1.0 - f64::from(self.inside) / f64::from(around))
    }
}

/// Renderer of agents alone.
pub enum Counter {
    /// The device's.
    Device(Box<Renderer>),
    /// The reference.
    Reference,
}

impl Counter {
    /// A counter on `gpu`.
    pub fn on(gpu: &Gpu, input: &DrawInput) -> Self {
        let options = RenderOptions {
            rules: input.rules(),
            outputs: Outputs {
                planes: [Plane::DepthMedian].into(),
                ..Outputs::default()
            },
            ..RenderOptions::default()
        };
        Self::Device(Box::new(Renderer::new(gpu, options)))
    }

    /// Median depth of each pixel, meters; 0 where more than half of the light is left.
    fn depths_m(&mut self, splat_scene: &SplatScene, camera: &Camera) -> Result<Vec<f32>> {
        match self {
            Self::Device(renderer) => {
                let scene = renderer.upload(splat_scene)?;
                renderer.render(&scene, std::slice::from_ref(camera))?;
                let image = renderer.read_images()?.pop();
                let depths_m = image.as_ref().and_then(Image::depth_median);
                Ok(depths_m.context("a camera has no median depth")?.to_vec())
            }
            Self::Reference => Ok(geometry::depth_median(
                splat_scene,
                camera,
                &splat_scene.rules,
            )),
        }
    }

    /// Coverage by `agent`, a world of one agent alone, in the image of `camera`, whose pixels show
    /// `instances` and have the median depths `scene_m`. The agent and the camera are at rest in
    /// it.
    pub fn coverage(
        &mut self,
        (agent, instance): (&SplatScene, u16),
        camera: &Camera,
        (instances, scene_m): (&[u16], &[f32]),
    ) -> Result<Coverage> {
        let own = &camera.intrinsics;
        let padded = own.padded(own.width_px / 2, own.height_px / 2);
        let is_padded = padded.check().is_ok();
        let shown = if is_padded { padded } else { *own };
        let reduction = (own.width_px / COUNTED_WIDTH_PX).clamp(1, REDUCTION_MAX);
        let counted = shown.resized(
            shown.width_px.div_ceil(reduction),
            shown.height_px.div_ceil(reduction),
        );
        let alone = Camera {
            intrinsics: counted,
            ..camera.at_rest(0.0)
        };
        let agent_m = self.depths_m(agent, &alone)?;
        // Place of a counted pixel in the camera's image; `None` beyond its edges.
        let within = |index: u32, counted_px: u32, shown_px: u32, own_px: u32| {
            let center_px = (f64::from(index) + 0.5) * f64::from(shown_px) / f64::from(counted_px);
            let place_px = center_px - f64::from((shown_px - own_px) / 2);
            let is_inside = place_px >= 0.0 && place_px < f64::from(own_px);
            is_inside.then_some(place_px as usize)
        };
        let (mut coverage, mut around) = (Coverage::default(), 0);
        let covered = agent_m
            .iter()
            .zip(0..)
            .filter(|(agent_m, _)| **agent_m > 0.0);
        for (agent_m, pixel) in covered {
            around += 1;
            let (x, y) = (pixel % counted.width_px, pixel / counted.width_px);
            let x = within(x, counted.width_px, shown.width_px, own.width_px);
            let y = within(y, counted.height_px, shown.height_px, own.height_px);
            if let (Some(x), Some(y)) = (x, y) {
                coverage.inside += 1;
                let pixel = y * own.width_px as usize + x;
                let nearest_m = agent_m * (1.0 - NEARER_SHARE) - NEARER_M;
                let is_behind = scene_m[pixel] > 0.0 && scene_m[pixel] < nearest_m;
                let is_visible = instances[pixel] == instance || !is_behind;
                coverage.visible += u32::from(is_visible);
            }
        }
        coverage.around = is_padded.then_some(around);
        Ok(coverage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::{Intrinsics, Motion, Pose, SplatCloud};

    /// Opaque splats 5 cm apart on a plate from `left_m` to `right_m`, 2 m high, `ahead_m` away.
    fn plate(left_m: f32, right_m: f32, ahead_m: f32) -> SplatCloud {
        let columns = ((right_m - left_m) / 0.05).round() as usize;
        let means: Vec<[f32; 3]> = (0..columns * 40)
            .map(|index| {
                let (column, row) = ((index / 40) as f32, (index % 40) as f32);
                [
                    left_m + 0.05 * (column + 0.5),
                    0.05 * (row + 0.5) - 1.0,
                    ahead_m,
                ]
            })
            .collect();
        SplatCloud {
            scales: vec![[0.025, 0.025, 0.001]; means.len()],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; means.len()],
            opacities: vec![0.99; means.len()],
            sh_dc: vec![[0.0; 3]; means.len()],
            means,
            ..SplatCloud::default()
        }
    }

    /// No pixel shows the agent.
    static HIDDEN: [u16; 400 * 300] = [0; 400 * 300];

    fn camera() -> Camera {
        Camera {
            name: "front".into(),
            // 100 px per meter at 4 m.
            intrinsics: Intrinsics {
                fx_px: 400.0,
                fy_px: 400.0,
                ..Intrinsics::from_horizontal_fov(400, 300, 1.0)
            },
            world_from_camera: Pose::IDENTITY,
            motion: Motion::REST,
        }
    }

    #[test]
    fn half_of_a_half_hidden_plate_is_visible() {
        let agent = SplatScene::from_splats(plate(-1.0, 1.0, 4.0));
        // A wall 1 m nearer covers what is left of the middle.
        let mut scene = SplatScene::from_splats(plate(-2.0, 0.0, 3.0));
        let at = Pose::IDENTITY;
        scene.bake_instance(&agent.splats, &at, decouplegs_scene::ShFrame::World, 1);
        let of = |scene: &SplatScene| {
            let depths_m = geometry::depth_median(scene, &camera(), &scene.rules);
            let coverage =
                Counter::Reference.coverage((&agent, 1), &camera(), (&HIDDEN, &depths_m));
            coverage.unwrap()
        };
        let hidden = of(&scene);
        let visible = hidden.visible_fraction().unwrap();
        assert!((visible - 0.5).abs() < 0.02, "{visible}");
        assert_eq!(hidden.truncated_fraction(), Some(0.0));
        assert_eq!(of(&agent).visible_fraction(), Some(1.0));
        let shown = vec![1; HIDDEN.len()];
        let wall_m = vec![1.0; HIDDEN.len()];
        let shown = Counter::Reference.coverage((&agent, 1), &camera(), (&shown, &wall_m));
        assert_eq!(shown.unwrap().visible_fraction(), Some(1.0));
    }

    #[test]
    fn half_of_a_plate_across_the_edge_is_truncated() {
        // The right edge of the image is 2 m to the right at 4 m.
        let agent = SplatScene::from_splats(plate(1.0, 3.0, 4.0));
        let wall_m = [1.0; 400 * 300];
        let of = |splat_scene: &SplatScene| {
            let coverage =
                Counter::Reference.coverage((splat_scene, 1), &camera(), (&HIDDEN, &wall_m));
            coverage.unwrap()
        };
        let coverage = of(&agent);
        assert_eq!(coverage.visible_fraction(), Some(0.0));
        let truncated = coverage.truncated_fraction().unwrap();
        assert!((truncated - 0.5).abs() < 0.02, "{truncated}");
        let behind = SplatScene::from_splats(plate(-1.0, 1.0, -4.0));
        let none = of(&behind);
        assert_eq!(
            (none.visible_fraction(), none.truncated_fraction()),
            (None, None)
        );
    }
}
