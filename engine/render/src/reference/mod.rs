//! The definition of an image: every pixel by brute force in f64, from the stored f32 parameters.
//!
//! What 'error' means anywhere in the engine is the distance to this. There are no tiles, no
//! approximations and no capacities. Splats are passed over only where they add exactly nothing:
//! outside the box of [`project::Projected64`] alpha is below `ALPHA_MIN`. Projection after Zwicker
//! et al., EWA Splatting, 2001, in the form of Kerbl et al., 2023; the clamp of the Jacobian is
//! gsplat's. Through a lens that is no pinhole, by the unscented transform.

pub mod blend;
pub mod color;
pub mod geometry;
pub mod lidar;
mod moving;
pub mod project;
pub mod rays;
pub mod unscented;

#[cfg(test)]
mod truths;

pub use moving::{render_moving, render_moving_window};

use std::borrow::Cow;

use decouplegs_scene::{Camera, Intrinsics, Photometry, RayMap, Rules, SplatScene};
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use crate::rendered_image::Image;
use crate::{Plane, PlaneMap, PlaneValues};
use blend::{Pixel64, Splat64};
use project::View;

/// Pixels along each side of the blocks for which candidates are gathered once. Only speed depends
/// on it.
const BLOCK_PX: u32 = 8;

/// An image in f64, row-major from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Image64 {
    /// Pixels a row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Color as blended, background color included, unclamped.
    pub rgb: Vec<[f64; 3]>,
    /// 1 - transmittance.
    pub alpha: Vec<f64>,
    /// Expected depth: z (distance, where the order is radial) of the blended splats averaged by
    /// weight, meters; 0 where nothing was blended.
    pub depth: Vec<f64>,
    /// Instance of the splat with the largest weight; 0 where nothing was blended.
    pub instance: Vec<u16>,
}

impl Image64 {
    /// The same image rounded to f32, with depth and instance.
    #[must_use]
    pub fn to_image(&self) -> Image {
        Image {
            width: self.width,
            height: self.height,
            rgb: self
                .rgb
                .iter()
                .map(|rgb| rgb.map(|value| value as f32))
                .collect(),
            alpha: self.alpha.iter().map(|&alpha| alpha as f32).collect(),
            planes: PlaneMap::from([
                (
                    Plane::Depth,
                    PlaneValues::F32(self.depth.iter().map(|&depth| depth as f32).collect()),
                ),
                (Plane::Instance, PlaneValues::U16(self.instance.clone())),
            ]),
        }
    }
}

/// A rectangle of pixels of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub left_px: u32,
    /// First row.
    pub top_px: u32,
    /// Columns, at least 1.
    pub width_px: u32,
    /// Rows, at least 1.
    pub height_px: u32,
}

impl Window {
    /// The whole image of a camera.
    #[must_use]
    pub fn whole(intrinsics: &Intrinsics) -> Self {
        Self {
            left_px: 0,
            top_px: 0,
            width_px: intrinsics.width_px,
            height_px: intrinsics.height_px,
        }
    }

    /// Center of a pixel, counted row by row, in the whole image.
    fn center_px(&self, index: usize) -> DVec2 {
        let (column, row) = (index as u32 % self.width_px, index as u32 / self.width_px);
        DVec2::new(
            f64::from(self.left_px + column) + 0.5,
            f64::from(self.top_px + row) + 0.5,
        )
    }

    /// True if the bounding box of `splat` contains the center of a pixel of this window.
    fn is_reached_by(&self, splat: &Splat64) -> bool {
        let reaches = |mean_px: f64, half_extent_px: f64, first_px: u32, count_px: u32| {
            let first_center_px = f64::from(first_px) + 0.5;
            mean_px + half_extent_px >= first_center_px
                && mean_px - half_extent_px <= first_center_px + f64::from(count_px) - 1.0
        };
        let (mean, half) = (splat.projected.mean_px, splat.projected.half_extent_px);
        reaches(mean.x, half.x, self.left_px, self.width_px)
            && reaches(mean.y, half.y, self.top_px, self.height_px)
    }
}

/// Renders `splat_scene` as seen by `camera` under `rules` (which replace the world's own). If the
/// camera moves and has a rolling shutter, by [`render_moving`].
///
/// # Panics
/// Panics if the camera's intrinsics fail [`Intrinsics::check`]: readers refuse such cameras.
#[must_use]
pub fn render(splat_scene: &SplatScene, camera: &Camera, rules: &Rules) -> Image64 {
    if camera.motion.is_rest() || camera.intrinsics.shutter.is_global() {
        return render_window(
            splat_scene,
            camera,
            rules,
            Window::whole(&camera.intrinsics),
        );
    }
    render_moving(&|_| Cow::Borrowed(splat_scene), camera, rules)
}

/// The pixels of [`render`] that lie in `window`, bit for bit, in the time that the window takes,
/// with all of them exposed at the time of the camera's pose.
///
/// A camera cropped by [`Intrinsics::cropped`] is not the same thing: where the Jacobian is clamped
/// depends on the image's size, so splats beyond a crop's edges spread otherwise.
///
/// # Panics
/// Panics if the camera's intrinsics fail [`Intrinsics::check`] or the window does not lie in its
/// image.
#[must_use]
pub fn render_window(
    splat_scene: &SplatScene,
    camera: &Camera,
    rules: &Rules,
    window: Window,
) -> Image64 {
    let intrinsics = &camera.intrinsics;
    if let Err(fault) = intrinsics.check() {
        panic!("camera {}: {fault}", camera.name);
    }
    let inside = |first: u32, count: u32, size: u32| {
        count >= 1 && u64::from(first) + u64::from(count) <= u64::from(size)
    };
    assert!(
        inside(window.left_px, window.width_px, intrinsics.width_px)
            && inside(window.top_px, window.height_px, intrinsics.height_px),
        "camera {}: {window:?} does not lie in its image of {}x{}",
        camera.name,
        intrinsics.width_px,
        intrinsics.height_px
    );
    let color = |splat: usize, center: DVec3| {
        let rgb = color::color(&splat_scene.splats, splat, center);
        color::blended(match &splat_scene.fog {
            Some(fog) => fog.seen(rgb, center.distance(splat_scene.splats.mean_m(splat))),
            None => rgb,
        })
    };
    let splats = front_to_back(splat_scene, camera, rules, &window, &color);
    let seen_sky = |rgb: [f64; 3]| match &splat_scene.fog {
        Some(fog) => fog.seen_sky(rgb),
        None => rgb,
    };
    let background = match splat_scene.sky_map {
        Some(_) => [0.0; 3],
        None => seen_sky(splat_scene.sky.map(f64::from)),
    };
    let rotation = DMat3::from_quat(camera.world_from_camera.rotation);
    let lens = (!intrinsics.is_pinhole()).then(|| RayMap::new(intrinsics));
    let rays = |center_px: DVec2| {
        let ray = match &lens {
            Some(lens) => lens.unproject(center_px)?,
            None => intrinsics.unproject(center_px)?,
        };
        Some(rotation * ray)
    };
    let bottom_px = window.top_px + window.height_px;
    let photometry = splat_scene.photometry_of(intrinsics);
    let bands: Vec<Vec<Pixel64>> = (window.top_px..bottom_px)
        .into_par_iter()
        .step_by(BLOCK_PX as usize)
        .map(|top_px| {
            let band = Window {
                top_px,
                height_px: BLOCK_PX.min(bottom_px - top_px),
                ..window
            };
            let mut pixels = render_band(&splats, &band, rules, background);
            if let Some(sky) = &splat_scene.sky_map {
                let behind =
                    |center_px| rays(center_px).map_or([0.0; 3], |ray| seen_sky(sky.color(ray)));
                add_sky(&mut pixels, &band, sky.clamps_splats, &behind);
            }
            if !photometry.is_identity() {
                calibrate(&mut pixels, &band, &photometry);
            }
            pixels
        })
        .collect();
    let pixels = || bands.iter().flatten();
    Image64 {
        width: window.width_px,
        height: window.height_px,
        rgb: pixels().map(|pixel| pixel.rgb).collect(),
        alpha: pixels().map(|pixel| pixel.alpha).collect(),
        depth: pixels().map(|pixel| pixel.depth_m).collect(),
        instance: pixels().map(|pixel| pixel.instance).collect(),
    }
}

/// The splats that reach a pixel of `window`, nearest first, equal depths by index. `shade` gives
/// the color of a splat, seen from the camera's center relative to the world's origin.
fn front_to_back(
    splat_scene: &SplatScene,
    camera: &Camera,
    rules: &Rules,
    window: &Window,
    shade: &(dyn Fn(usize, DVec3) -> [f64; 3] + Sync),
) -> Vec<Splat64> {
    let view = View::new(splat_scene.origin, camera, rules);
    let mut splats: Vec<Splat64> = (0..splat_scene.splats.len())
        .into_par_iter()
        .filter_map(|index| {
            let mut splat = Splat64 {
                projected: view.project(&splat_scene.splats, index)?,
                color: [0.0; 3],
                index: index as u32,
                instance: splat_scene
                    .instance_from_splat
                    .get(index)
                    .copied()
                    .unwrap_or(0),
            };
            if !window.is_reached_by(&splat) {
                return None;
            }
            splat.color = shade(index, view.center);
            Some(splat)
        })
        .collect();
    splats.par_sort_unstable_by(|a, b| {
        a.projected
            .depth_m
            .total_cmp(&b.projected.depth_m)
            .then(a.index.cmp(&b.index))
    });
    splats
}

/// Adds the sky behind the pixels of `band`. `behind` gives its color at a position in the image,
/// pixels.
fn add_sky(
    pixels: &mut [Pixel64],
    band: &Window,
    clamps_splats: bool,
    behind: &impl Fn(DVec2) -> [f64; 3],
) {
    for (index, pixel) in pixels.iter_mut().enumerate() {
        let behind = behind(band.center_px(index));
        for (value, behind) in pixel.rgb.iter_mut().zip(behind) {
            if clamps_splats {
                *value = value.min(1.0);
            }
            *value += (1.0 - pixel.alpha) * behind;
        }
    }
}

/// Colors of an image from those of the scene.
fn calibrate(pixels: &mut [Pixel64], band: &Window, photometry: &Photometry) {
    for (index, pixel) in pixels.iter_mut().enumerate() {
        pixel.rgb = photometry.color(pixel.rgb, band.center_px(index).to_array());
    }
}

/// A few rows of pixels, row-major.
fn render_band(splats: &[Splat64], band: &Window, rules: &Rules, sky: [f64; 3]) -> Vec<Pixel64> {
    let in_band: Vec<&Splat64> = splats
        .iter()
        .filter(|splat| band.is_reached_by(splat))
        .collect();
    let nothing = Pixel64 {
        rgb: [0.0; 3],
        alpha: 0.0,
        depth_m: 0.0,
        instance: 0,
    };
    let mut pixels = vec![nothing; band.width_px as usize * band.height_px as usize];
    for first_column in (0..band.width_px).step_by(BLOCK_PX as usize) {
        let width_px = BLOCK_PX.min(band.width_px - first_column);
        let block = Window {
            left_px: band.left_px + first_column,
            width_px,
            ..*band
        };
        let in_block: Vec<&Splat64> = in_band
            .iter()
            .copied()
            .filter(|splat| block.is_reached_by(splat))
            .collect();
        for row in 0..band.height_px {
            for column in first_column..first_column + width_px {
                let index = row as usize * band.width_px as usize + column as usize;
                let center_px = band.center_px(index);
                pixels[index] = blend::blend(in_block.iter().copied(), center_px, rules, sky);
            }
        }
    }
    pixels
}
