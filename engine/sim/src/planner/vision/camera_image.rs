//! The front image as brightness and color, and where a position on the road is in it.

use decouplegs_scene::Pose;
use decouplegs_scene::camera::Intrinsics;
use decouplegs_scene::lens::RayMap;
use glam::{DMat3, DVec2, DVec3};

use crate::planner::Frame;

/// An image wider than this is halved until it is not, pixels: finer detail than that shows no more
/// of markings.
const WIDTH_PX_MAX: usize = 800;
/// Added to brightness before it is compared, display-referred: so dark a pixel tells nothing.
const BLACK: f32 = 0.02;
/// Distance to the plane of the lens below which pixels are ignored, meters.
const NEAR_M: f64 = 0.3;

/// Brightness and color of one position in an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Color {
    /// Mean of the three channels, display-referred, 0 to 1, and a little above zero.
    pub luma: f32,
    /// Share of red in the sum of channels.
    pub red: f32,
    /// Share of blue in it.
    pub blue: f32,
}

impl Color {
    /// The color between two, `share` of the way to `other`.
    fn lerp(self, other: Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + (b - a) * share;
        Self {
            luma: mix(self.luma, other.luma),
            red: mix(self.red, other.red),
            blue: mix(self.blue, other.blue),
        }
    }
}

/// An image of the road, and the camera that made it over flat ground.
pub(super) struct Image {
    width: usize,
    height: usize,
    colors: Vec<Color>,
    /// Camera from the ego's frame: rotation and translation.
    rotation: DMat3,
    translation: DVec3,
    /// Intrinsics of the stored image.
    intrinsics: Intrinsics,
    /// Lens model, if other than a pinhole.
    lens: Option<RayMap>,
    /// Height of the ground in the ego's frame, meters: wheels touch it half a height below the
    /// middle of the box.
    ground_z_m: f64,
}

impl Image {
    /// Image of `frame` for an ego of height `ego_height_m`; `None` where its bytes are not those
    /// of its camera.
    pub(super) fn from_frame(frame: &Frame, ego_height_m: f64) -> Option<Self> {
        let camera = frame.camera;
        camera.intrinsics.check().ok()?;
        let (width, height) = (
            camera.intrinsics.width_px as usize,
            camera.intrinsics.height_px as usize,
        );
        if frame.rgba.len() != width.checked_mul(height)?.checked_mul(4)? {
            return None;
        }
        let mut halvings = 0_u32;
        while width >> halvings > WIDTH_PX_MAX && height >> halvings > 1 {
            halvings += 1;
        }
        let (kept_width, kept_height) = (width >> halvings, height >> halvings);
        let Pose {
            rotation,
            translation,
        } = camera.rig_from_camera.inverse();
        // Cropped to whole blocks of pixels first, so that the principal point keeps its position.
        let intrinsics = scaled(&camera.intrinsics, 1.0 / f64::from(1_u32 << halvings));
        let kept = Self {
            width: kept_width,
            height: kept_height,
            colors: halved(frame.rgba, width, (kept_width, kept_height), 1 << halvings),
            rotation: DMat3::from_quat(rotation),
            translation,
            lens: (!intrinsics.is_pinhole()).then(|| RayMap::new(&intrinsics)),
            intrinsics,
            ground_z_m: -0.5 * ego_height_m,
        };
        (rotation.is_finite() && translation.is_finite() && ego_height_m.is_finite())
            .then_some(kept)
    }

    /// Projection of a point into the image: `at_m` in the ego's frame, `height_m` over the ground.
    /// `None` behind the lens or outside.
    pub(super) fn pixel_of(&self, at_m: DVec2, height_m: f64) -> Option<DVec2> {
        let seen = self.rotation * at_m.extend(self.ground_z_m + height_m) + self.translation;
        if seen.z.is_nan() || seen.z < NEAR_M {
            return None;
        }
        let at = &self.intrinsics;
        let pixel = match &self.lens {
            Some(lens) => lens.project(seen)?,
            None => DVec2::new(
                at.fx_px * seen.x / seen.z + at.cx_px,
                at.fy_px * seen.y / seen.z + at.cy_px,
            ),
        };
        let inside = pixel.x >= 0.0
            && pixel.y >= 0.0
            && pixel.x <= self.width as f64
            && pixel.y <= self.height as f64;
        inside.then_some(pixel)
    }

    /// Color of a position, between pixels.
    pub(super) fn color_of(&self, at_m: DVec2, height_m: f64) -> Option<Color> {
        self.pixel_of(at_m, height_m)
            .map(|pixel| self.color_at(pixel))
    }

    /// Meters across the road that one pixel shows at a distance ahead.
    pub(super) fn pixel_m(&self, distance_m: f64) -> f64 {
        let from_camera_m =
            (self.rotation * DVec3::new(distance_m, 0.0, self.ground_z_m) + self.translation).z;
        from_camera_m.max(NEAR_M) / self.intrinsics.fx_px
    }

    /// Pixels of the image that a meter along the road fills at a distance ahead.
    pub(super) fn pixels_along(&self, distance_m: f64) -> f64 {
        let row = |distance_m: f64| {
            let seen =
                self.rotation * DVec3::new(distance_m, 0.0, self.ground_z_m) + self.translation;
            self.intrinsics.fy_px * seen.y / seen.z.max(NEAR_M)
        };
        (row(distance_m - 0.5) - row(distance_m + 0.5)).abs()
    }

    fn color_at(&self, pixel: DVec2) -> Color {
        let clamped = |at: f64, count: usize| (at - 0.5).clamp(0.0, (count - 1) as f64);
        let (x, y) = (clamped(pixel.x, self.width), clamped(pixel.y, self.height));
        let (left, top) = (x as usize, y as usize);
        let (right, below) = (
            (left + 1).min(self.width - 1),
            (top + 1).min(self.height - 1),
        );
        let (share_x, share_y) = ((x - left as f64) as f32, (y - top as f64) as f32);
        let of = |x: usize, y: usize| self.colors[y * self.width + x];
        let upper = of(left, top).lerp(of(right, top), share_x);
        upper.lerp(of(left, below).lerp(of(right, below), share_x), share_y)
    }
}

/// A camera whose image is `scale` times as large.
fn scaled(intrinsics: &Intrinsics, scale: f64) -> Intrinsics {
    Intrinsics {
        fx_px: intrinsics.fx_px * scale,
        fy_px: intrinsics.fy_px * scale,
        cx_px: intrinsics.cx_px * scale,
        cy_px: intrinsics.cy_px * scale,
        lens: intrinsics.lens.scaled(scale, scale),
        ..*intrinsics
    }
}

/// Colors of an image of `size` (width, height), each the mean of `block` by `block` pixels of
/// `rgba`.
fn halved(rgba: &[u8], width: usize, size: (usize, usize), block: usize) -> Vec<Color> {
    let mut colors = Vec::with_capacity(size.0 * size.1);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let mut sum = [0_u32; 3];
            for row in 0..block {
                let first = ((y * block + row) * width + x * block) * 4;
                for pixel in rgba[first..first + 4 * block].chunks_exact(4) {
                    for (sum, &channel) in sum.iter_mut().zip(pixel) {
                        *sum += u32::from(channel);
                    }
                }
            }
            let scale = 1.0 / (255.0 * (block * block) as f32);
            let [red, green, blue] = sum.map(|sum| sum as f32 * scale + BLACK);
            let all = red + green + blue;
            colors.push(Color {
                luma: all / 3.0,
                red: red / all,
                blue: blue / all,
            });
        }
    }
    colors
}
