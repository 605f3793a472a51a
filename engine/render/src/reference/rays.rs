//! 3DGUT's definition of an image, in f64: every splat is evaluated along the ray of each pixel.
//!
//! After Wu et al., 3DGUT, 2025, and the public renderer (nv-tlabs/3dgrut at a37ef72). There the
//! unscented transform only bounds the pixels that a splat may reach; the response is that of the
//! Gaussian along the ray, so lenses and rolling shutters are exact, and no dilation is added. Here
//! nothing is bounded: a splat reaches all pixels whose response is large enough. Order is by z, at
//! the middle of the readout, and so is the color.

use decouplegs_scene::rules::{ALPHA_MIN, TRANSMITTANCE_MIN_INCLUSIVE};
use decouplegs_scene::{Camera, RayMap, Rules, SplatScene};
use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::blend::Pixel64;
use super::{Image64, Window, color};

/// Pixels along each side of the blocks for which candidates are gathered once. Only speed depends
/// on it.
const BLOCK_PX: u32 = 8;
/// Room of a block's cone for what lies between its corners.
const CONE_ROOM: f64 = 1.05;

/// Rules of a renderer that evaluates along rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayRules {
    /// Responses below this are none: 1 is that of a ray through the mean.
    pub response_min: f64,
    /// Upper bound of alpha.
    pub alpha_max: f64,
    /// Nothing is blended behind the splat that takes the transmittance below this.
    pub transmittance_min: f64,
    /// Splats whose means have a smaller z are dropped, meters.
    pub near_m: f64,
}

impl RayRules {
    /// Rules of NuRec.
    pub const NUREC: Self = Self {
        response_min: Rules::NUREC.response_min,
        alpha_max: Rules::NUREC.alpha_max,
        transmittance_min: TRANSMITTANCE_MIN_INCLUSIVE,
        near_m: Rules::NUREC.near_m,
    };
}

/// A splat as rays meet it.
struct RaySplat {
    mean: DVec3,
    /// Maps the splat to the unit ball.
    unit_from_world: DMat3,
    opacity: f64,
    color: [f64; 3],
    depth_m: f64,
    index: usize,
    /// No ray farther than this from the mean has a response.
    radius_m: f64,
}

impl RaySplat {
    /// Alpha along the ray from `origin` in the direction `ray`; `None` where it is none.
    fn alpha(&self, origin: DVec3, ray: DVec3, rules: &RayRules) -> Option<f64> {
        let from = self.unit_from_world * (origin - self.mean);
        let towards = (self.unit_from_world * ray).normalize();
        let response = (-0.5 * from.cross(towards).length_squared()).exp();
        let alpha = (self.opacity * response).min(rules.alpha_max);
        (response > rules.response_min && alpha > ALPHA_MIN).then_some(alpha)
    }
}

/// Rays of the pixels of a camera, relative to the origin of its world.
struct Rays<'a> {
    camera: &'a Camera,
    lens: Option<RayMap>,
    world_origin: DVec3,
}

impl Rays<'_> {
    /// Origin and direction of the ray of a pixel at the time of its exposure; `None` where no ray
    /// falls on it.
    fn at(&self, center_px: DVec2) -> Option<(DVec3, DVec3)> {
        let intrinsics = &self.camera.intrinsics;
        let ray = match &self.lens {
            Some(lens) => lens.unproject(center_px)?,
            None => intrinsics.unproject(center_px)?,
        };
        let time_s = intrinsics.shutter.time_s(center_px.to_array());
        let pose = self.camera.at_rest(time_s).world_from_camera;
        let origin = pose.translation - self.world_origin;
        Some((origin, (pose.rotation * ray).normalize()))
    }

    /// Splats, of `splats`, that a ray of `block` may meet.
    fn near<'s>(&self, splats: &'s [RaySplat], block: &Window) -> Vec<&'s RaySplat> {
        let corner = |x: u32, y: u32| {
            let [x_px, y_px] = [block.left_px + x, block.top_px + y].map(f64::from);
            self.at(DVec2::new(x_px + 0.5, y_px + 0.5))
        };
        let (right, bottom) = (block.width_px - 1, block.height_px - 1);
        let middle = corner(block.width_px / 2, block.height_px / 2);
        let corners = [(0, 0), (right, 0), (0, bottom), (right, bottom)];
        let corners = corners.map(|(x, y)| corner(x, y));
        let (Some((origin, axis)), [Some(a), Some(b), Some(c), Some(d)]) = (middle, corners) else {
            // At the rim of a lens.
            return splats.iter().collect();
        };
        let (mut half_rad, mut moved_m) = (0f64, 0f64);
        for (from, ray) in [a, b, c, d] {
            half_rad = half_rad.max(ray.angle_between(axis));
            moved_m = moved_m.max(from.distance(origin));
        }
        let is_near = |splat: &&RaySplat| {
            let (towards, radius_m) = (splat.mean - origin, splat.radius_m + CONE_ROOM * moved_m);
            let distance_m = towards.length();
            distance_m <= radius_m
                || towards.angle_between(axis)
                    <= CONE_ROOM * half_rad + (radius_m / distance_m).asin()
        };
        splats.iter().filter(is_near).collect()
    }
}

/// Renders `splat_scene` as seen by `camera`, whose agents stand still. Pixels that no ray falls on
/// are black.
///
/// # Panics
/// Panics if the camera's intrinsics fail [`decouplegs_scene::Intrinsics::check`].
#[must_use]
pub fn render_rays(splat_scene: &SplatScene, camera: &Camera, rules: &RayRules) -> Image64 {
    let intrinsics = &camera.intrinsics;
    if let Err(fault) = intrinsics.check() {
        panic!("camera {}: {fault}", camera.name);
    }
    let splats = splats_of(splat_scene, camera, rules);
    let rays = Rays {
        camera,
        lens: (!intrinsics.is_pinhole()).then(|| RayMap::new(intrinsics)),
        world_origin: splat_scene.origin,
    };
    let (width, height) = (intrinsics.width_px, intrinsics.height_px);
    let blocks = (0..height).step_by(BLOCK_PX as usize).flat_map(|top_px| {
        let lefts = (0..width).step_by(BLOCK_PX as usize);
        lefts.map(move |left_px| Window {
            left_px,
            top_px,
            width_px: BLOCK_PX.min(width - left_px),
            height_px: BLOCK_PX.min(height - top_px),
        })
    });
    let blocks: Vec<Window> = blocks.collect();
    let drawn: Vec<Vec<Pixel64>> = blocks
        .par_iter()
        .map(|block| {
            let near = rays.near(&splats, block);
            let pixels = 0..(block.width_px * block.height_px) as usize;
            let pixel = |index| {
                let center_px = block.center_px(index);
                let mut pixel = match rays.at(center_px) {
                    Some(ray) => blended(splat_scene, &near, ray, rules),
                    None => Pixel64 {
                        rgb: [0.0; 3],
                        alpha: 0.0,
                        depth_m: 0.0,
                        instance: 0,
                    },
                };
                let photometry = splat_scene.photometry_of(intrinsics);
                if !photometry.is_identity() {
                    pixel.rgb = photometry.color(pixel.rgb, center_px.to_array());
                }
                pixel
            };
            pixels.map(pixel).collect()
        })
        .collect();
    let place = |pixel: usize| {
        let (x, y) = (pixel as u32 % width, pixel as u32 / width);
        let across = width.div_ceil(BLOCK_PX);
        let block = (y / BLOCK_PX * across + x / BLOCK_PX) as usize;
        let own = &blocks[block];
        &drawn[block][((y - own.top_px) * own.width_px + x - own.left_px) as usize]
    };
    let pixels = || (0..(width * height) as usize).map(place);
    Image64 {
        width,
        height,
        rgb: pixels().map(|pixel| pixel.rgb).collect(),
        alpha: pixels().map(|pixel| pixel.alpha).collect(),
        depth: pixels().map(|pixel| pixel.depth_m).collect(),
        instance: pixels().map(|pixel| pixel.instance).collect(),
    }
}

/// Splats in front of the near plane, nearest first, equal depths by index.
fn splats_of(splat_scene: &SplatScene, camera: &Camera, rules: &RayRules) -> Vec<RaySplat> {
    let cloud = &splat_scene.splats;
    let pose = camera.world_from_camera;
    let center = pose.translation - splat_scene.origin;
    let axis = pose.rotation * DVec3::Z;
    let radius = (-2.0 * rules.response_min.ln()).sqrt();
    let splat = |index: usize| {
        let mean = cloud.mean_m(index);
        let depth_m = (mean - center).dot(axis);
        if cloud.defect_of(index).is_some() || depth_m < rules.near_m {
            return None;
        }
        let [w, x, y, z] = cloud.rotations[index].map(f64::from);
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let scales = DVec3::from_array(cloud.scales[index].map(f64::from));
        let scales = scales.max(DVec3::splat(f64::from(f32::MIN_POSITIVE)));
        let rgb = color::color(cloud, index, center);
        let distance_m = center.distance(mean);
        Some(RaySplat {
            mean,
            unit_from_world: DMat3::from_diagonal(scales.recip()) * rotation.transpose(),
            opacity: f64::from(cloud.opacities[index]),
            color: color::blended(match &splat_scene.fog {
                Some(fog) => fog.seen(rgb, distance_m),
                None => rgb,
            }),
            depth_m,
            index,
            radius_m: radius * scales.max_element(),
        })
    };
    let mut splats: Vec<RaySplat> = (0..cloud.len()).into_par_iter().filter_map(splat).collect();
    splats.par_sort_by(|a, b| {
        let order = a.depth_m.total_cmp(&b.depth_m);
        order.then(a.index.cmp(&b.index))
    });
    splats
}

/// Pixel of a ray, from origin and direction.
fn blended(
    splat_scene: &SplatScene,
    splats: &[&RaySplat],
    (origin, ray): (DVec3, DVec3),
    rules: &RayRules,
) -> Pixel64 {
    let (mut transmittance, mut rgb) = (1.0, [0.0; 3]);
    let (mut weighted_depth_m, mut weight_max, mut instance) = (0.0, 0.0, 0);
    for splat in splats {
        let Some(alpha) = splat.alpha(origin, ray, rules) else {
            continue;
        };
        let weight = transmittance * alpha;
        for (sum, color) in rgb.iter_mut().zip(splat.color) {
            *sum += weight * color;
        }
        weighted_depth_m += weight * splat.depth_m;
        if weight > weight_max {
            let instances = &splat_scene.instance_from_splat;
            (weight_max, instance) = (weight, instances.get(splat.index).copied().unwrap_or(0));
        }
        transmittance *= 1.0 - alpha;
        if transmittance < rules.transmittance_min {
            break;
        }
    }
    let sky = match &splat_scene.sky_map {
        Some(sky) => sky.color(ray),
        None => splat_scene.sky.map(f64::from),
    };
    let sky = match &splat_scene.fog {
        Some(fog) => fog.seen_sky(sky),
        None => sky,
    };
    let clamps = (splat_scene.sky_map.as_ref()).is_some_and(|sky| sky.clamps_splats);
    for (sum, sky) in rgb.iter_mut().zip(sky) {
        if clamps {
            *sum = sum.min(1.0);
        }
        *sum += transmittance * sky;
    }
    let alpha = 1.0 - transmittance;
    Pixel64 {
        rgb,
        alpha,
        depth_m: match alpha > 0.0 {
            true => weighted_depth_m / alpha,
            false => 0.0,
        },
        instance,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::render;
    use decouplegs_scene::lens::Fisheye;
    use decouplegs_scene::random::{next, unit};
    use decouplegs_scene::{Intrinsics, Lens, Motion, Pose, Shutter, ShutterDirection, SplatCloud};

    fn camera(lens: Lens) -> Camera {
        camera_of(1.4, lens)
    }

    fn camera_of(fov_rad: f64, lens: Lens) -> Camera {
        let intrinsics = Intrinsics {
            lens,
            ..Intrinsics::from_horizontal_fov(48, 36, fov_rad)
        };
        Camera {
            name: "rays".into(),
            intrinsics,
            world_from_camera: Pose::IDENTITY,
            motion: Motion::REST,
        }
    }

    fn fisheye() -> Lens {
        Lens::Fisheye(Fisheye {
            radial: [-0.02, 0.004, 0.0, 0.0],
            max_angle_rad: 1.5,
        })
    }

    /// Splats of scales up to `scale_m` meters, 2 to 12 m ahead and within `spread` of that to the
    /// sides.
    fn crowd(count: usize, scale_m: f64, spread: f64) -> SplatScene {
        let mut state = 5;
        let mut between =
            |low: f64, high: f64| (low + (high - low) * unit(next(&mut state))) as f32;
        let mut splats = SplatCloud::with_degree(0);
        for _ in 0..count {
            let z = between(2.0, 12.0);
            splats.means.push([
                between(-spread, spread) * z,
                between(-0.8 * spread, 0.8 * spread) * z,
                z,
            ]);
            let scale = || [0.2, 0.6, 1.0].map(|share| (share * scale_m) as f32);
            splats.scales.push(scale());
            let turn = [0; 4].map(|_| between(-1.0, 1.0));
            let length = turn.iter().map(|x| x * x).sum::<f32>().sqrt();
            splats.rotations.push(turn.map(|x| x / length));
            splats.opacities.push(between(0.1, 0.95));
            splats.sh_dc.push([0; 3].map(|_| between(-1.5, 1.5)));
        }
        SplatScene {
            sky: [0.1, 0.2, 0.3],
            ..SplatScene::from_splats(splats)
        }
    }

    fn psnr_db(a: &Image64, b: &Image64) -> f64 {
        let squares = a.rgb.iter().flatten().zip(b.rgb.iter().flatten());
        let mean = squares.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / (3 * a.rgb.len()) as f64;
        -10.0 * mean.log10()
    }

    #[test]
    fn a_ball_has_the_response_of_the_distance_of_each_ray() {
        let (scale_m, distance_m) = (0.3, 4.0);
        let mut scene = crowd(1, scale_m, 1.0);
        scene.splats.means[0] = [0.0, 0.0, distance_m as f32];
        scene.splats.scales[0] = [scale_m as f32; 3];
        scene.splats.opacities[0] = 0.5;
        let camera = camera(Lens::Pinhole);
        let image = render_rays(&scene, &camera, &RayRules::NUREC);
        for (pixel, alpha) in image.alpha.iter().enumerate() {
            let center_px = Window::whole(&camera.intrinsics).center_px(pixel);
            let ray = camera.intrinsics.unproject(center_px).unwrap().normalize();
            let off_m = distance_m * ray.angle_between(DVec3::Z).sin();
            let response = (-0.5 * (off_m / f64::from(scale_m as f32)).powi(2)).exp();
            let expected = match response > 0.0113 && 0.5 * response > ALPHA_MIN {
                true => 0.5 * response,
                false => 0.0,
            };
            assert!(
                (alpha - expected).abs() < 1e-9,
                "{pixel}: {alpha} {expected}"
            );
        }
    }

    #[test]
    fn blocks_leave_out_nothing_that_a_ray_meets() {
        let scene = crowd(200, 0.5, 1.0);
        let mut moving = camera(fisheye());
        moving.motion.velocity_mps = DVec3::new(9.0, 2.0, 20.0);
        let size_px = [moving.intrinsics.width_px, moving.intrinsics.height_px];
        moving.intrinsics.shutter = Shutter::new(ShutterDirection::TopToBottom, 0.03, size_px);
        for camera in [camera(Lens::Pinhole), moving] {
            let rules = RayRules::NUREC;
            let image = render_rays(&scene, &camera, &rules);
            let splats = splats_of(&scene, &camera, &rules);
            let all: Vec<&RaySplat> = splats.iter().collect();
            let rays = Rays {
                camera: &camera,
                lens: (!camera.intrinsics.is_pinhole()).then(|| RayMap::new(&camera.intrinsics)),
                world_origin: scene.origin,
            };
            for (pixel, rgb) in image.rgb.iter().enumerate() {
                let center_px = Window::whole(&camera.intrinsics).center_px(pixel);
                let ray = rays.at(center_px).unwrap();
                assert_eq!(*rgb, blended(&scene, &all, ray, &rules).rgb, "{pixel}");
            }
        }
    }

    /// Footprints of splats that are narrow as angles and many pixels wide are what rays see;
    /// others are not, which a comparison must tell.
    #[test]
    fn footprints_are_what_rays_see_where_splats_are_narrow_and_wide_in_pixels() {
        let rules = Rules::NUREC;
        let differ_db = |scene: &SplatScene, camera: &Camera| {
            let rays = render_rays(scene, camera, &RayRules::NUREC);
            psnr_db(&render(scene, camera, &rules), &rays)
        };
        for lens in [Lens::Pinhole, fisheye()] {
            let narrow_db = differ_db(&crowd(300, 0.05, 0.025), &camera_of(0.05, lens));
            let wide_db = differ_db(&crowd(300, 2.0, 1.0), &camera(lens));
            println!("{narrow_db:.1} dB, {wide_db:.1} dB");
            assert!(narrow_db > 50.0 && wide_db < 40.0, "{narrow_db} {wide_db}");
        }
    }
}
