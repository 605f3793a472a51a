//! Planes of geometry in f64: weighted means of what each splat has.

use std::borrow::Cow;

use decouplegs_scene::{Camera, Rules, SplatCloud, SplatScene};
use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::blend::{Pixel64, alpha_at};
use super::{Window, front_to_back, render_band};

/// Half the time over which the velocity of a splat is measured, seconds.
const VELOCITY_HALF_S: f64 = 1e-3;

/// Planes of geometry of an image, row-major from the top left: means over the blended splats by
/// weight, 0 where nothing was blended.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry64 {
    /// Distance from the camera, meters.
    pub range: Vec<f64>,
    /// Mean of the unit normals towards the camera, world axes.
    pub normal: Vec<DVec3>,
    /// Displacement in the image during the interval, pixels.
    pub flow_forward: Vec<[f64; 2]>,
    /// Displacement in the image during the interval before, backwards in time, pixels.
    pub flow_backward: Vec<[f64; 2]>,
    /// Velocity, world axes, meters per second.
    pub scene_flow: Vec<DVec3>,
    /// Depth of the splat in which half of the light is gone, meters; 0 where more than half is
    /// left.
    pub depth_median: Vec<f64>,
    /// Distance of that splat from the camera, meters.
    pub range_median: Vec<f64>,
}

/// Renders the planes of geometry of a moving world. `world_at` gives the world at a time in
/// seconds after that of the camera's pose, always with the same splats; flow is over `interval_s`.
/// The shutter of the camera does not count: all pixels are of time 0.
///
/// # Panics
/// Panics if the camera's intrinsics fail [`decouplegs_scene::Intrinsics::check`].
#[must_use]
pub fn render_geometry<'a>(
    world_at: &(dyn Fn(f64) -> Cow<'a, SplatScene> + Sync),
    camera: &Camera,
    rules: &Rules,
    interval_s: f64,
) -> Geometry64 {
    let now = world_at(0.0);
    let here = camera.at_rest(0.0);
    let center = here.world_from_camera.translation - now.origin;
    let means = |shade: &(dyn Fn(usize) -> DVec3 + Sync)| mean_of(&now, &here, rules, shade);
    let flow = |time_s: f64| {
        let (then, there) = (world_at(time_s), camera.at_rest(time_s));
        let of_splat = |splat: usize| {
            let from = position(&now, &here, rules, splat);
            let to = position(&then, &there, rules, splat);
            match (from, to) {
                (Some(from), Some(to)) => (to - from).extend(0.0),
                _ => DVec3::ZERO,
            }
        };
        let flow = means(&of_splat);
        flow.into_iter().map(|mean| [mean.x, mean.y]).collect()
    };
    let (before, after) = (world_at(-VELOCITY_HALF_S), world_at(VELOCITY_HALF_S));
    let range = |splat: usize| DVec3::X * (now.splats.mean_m(splat) - center).length();
    let (depth_median, range_median) = medians(&now, &here, rules, &range);
    Geometry64 {
        depth_median,
        range_median,
        range: means(&range).into_iter().map(|mean| mean.x).collect(),
        normal: means(&|splat| normal(&now.splats, splat, center)),
        flow_forward: flow(interval_s),
        flow_backward: flow(-interval_s),
        scene_flow: means(&|splat| {
            let way_m = after.splats.mean_m(splat) - before.splats.mean_m(splat);
            way_m / (2.0 * VELOCITY_HALF_S)
        }),
    }
}

/// Mean of `shade` over the blended splats of each pixel.
fn mean_of(
    splat_scene: &SplatScene,
    camera: &Camera,
    rules: &Rules,
    shade: &(dyn Fn(usize) -> DVec3 + Sync),
) -> Vec<DVec3> {
    let window = Window::whole(&camera.intrinsics);
    let color = |splat: usize, _: DVec3| shade(splat).to_array();
    let splats = front_to_back(splat_scene, camera, rules, &window, &color);
    let pixels = render_band(&splats, &window, rules, [0.0; 3]);
    let mean = |pixel: &Pixel64| match pixel.alpha {
        0.0 => DVec3::ZERO,
        alpha => DVec3::from_array(pixel.rgb) / alpha,
    };
    pixels.iter().map(mean).collect()
}

/// Depth of the splat in which half of the light of each pixel is gone, meters, row-major from the
/// top left; 0 where more than half is left.
///
/// # Panics
/// Panics if the camera's intrinsics fail [`decouplegs_scene::Intrinsics::check`].
#[must_use]
pub fn depth_median(splat_scene: &SplatScene, camera: &Camera, rules: &Rules) -> Vec<f32> {
    let (depths_m, _) = medians(splat_scene, camera, rules, &|_| DVec3::ZERO);
    depths_m.into_iter().map(|depth_m| depth_m as f32).collect()
}

/// Depth of the splat in which half of the light of each pixel is gone, and its `range` along x.
fn medians(
    splat_scene: &SplatScene,
    camera: &Camera,
    rules: &Rules,
    range: &(dyn Fn(usize) -> DVec3 + Sync),
) -> (Vec<f64>, Vec<f64>) {
    let window = Window::whole(&camera.intrinsics);
    let color = |splat: usize, _: DVec3| range(splat).to_array();
    let splats = front_to_back(splat_scene, camera, rules, &window, &color);
    let median = |pixel: usize| {
        let center_px = window.center_px(pixel);
        let mut transmittance = 1.0;
        for splat in &splats {
            let alpha = alpha_at(&splat.projected, center_px, rules).unwrap_or(0.0);
            transmittance *= 1.0 - alpha;
            if transmittance <= 0.5 {
                return (splat.projected.depth_m, splat.color[0]);
            }
        }
        (0.0, 0.0)
    };
    let pixels = camera.intrinsics.pixels() as usize;
    (0..pixels).into_par_iter().map(median).unzip()
}

/// Position of a splat's mean in the image, pixels; `None` behind the near plane.
fn position(
    splat_scene: &SplatScene,
    camera: &Camera,
    rules: &Rules,
    splat: usize,
) -> Option<DVec2> {
    let pose = &camera.world_from_camera;
    let from_camera = splat_scene.splats.mean_m(splat) - (pose.translation - splat_scene.origin);
    let ray = pose.rotation.conjugate() * from_camera;
    if ray.z < rules.near_m {
        return None;
    }
    camera.intrinsics.project(ray)
}

/// The thinnest axis of a splat, towards the camera.
fn normal(splats: &SplatCloud, splat: usize, center: DVec3) -> DVec3 {
    let scales = splats.scales[splat];
    let thinnest = (0..3).min_by(|&a, &b| scales[a].total_cmp(&scales[b]));
    let [w, x, y, z] = splats.rotations[splat].map(f64::from);
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let axis = axes.col(thinnest.unwrap_or(0));
    if axis.dot(splats.mean_m(splat) - center) > 0.0 {
        -axis
    } else {
        axis
    }
}
