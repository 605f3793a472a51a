//! The small image that the network sees: the same pinhole camera for every camera of a vehicle.

use decouplegs_scene::RigCamera;
use decouplegs_scene::lens::RayMap;
use glam::{DMat3, DVec3};

use crate::planner::Frame;

/// Size of the image, pixels.
pub(super) const WIDTH_PX: usize = 160;
pub(super) const HEIGHT_PX: usize = 96;
/// Focal length, pixels: 65 degrees from side to side.
const FOCAL_PX: f64 = 126.0;
/// Samples of the camera's image for each pixel, along one side, at most.
const SAMPLES_MAX: usize = 8;

/// Red, green and blue of each pixel, display-referred, rows from the top.
pub(super) type Small = Vec<u8>;

/// Positions of the pixels of the small image in the image of a camera.
///
/// The small image looks ahead, level with the vehicle, from the place of the camera. Each of its
/// pixels is the mean of samples of the camera's image. What the camera does not show is black.
pub(super) struct View {
    /// Size of the camera's image, pixels.
    size_px: [usize; 2],
    /// Pixels of the camera's image, as many for each small pixel as it has samples.
    sampled: Vec<Option<u32>>,
    samples: usize,
}

impl View {
    /// The view through `camera`; `None` where its numbers are not those of a camera.
    pub(super) fn new(camera: &RigCamera) -> Option<Self> {
        let lens = &camera.intrinsics;
        lens.check().ok()?;
        let camera_from_rig = DMat3::from_quat(camera.rig_from_camera.rotation).transpose();
        if !camera_from_rig.is_finite() {
            return None;
        }
        let size_px = [lens.width_px as usize, lens.height_px as usize];
        let rays = RayMap::new(lens);
        let projected = |x: f64, y: f64| {
            let left = (0.5 * WIDTH_PX as f64 - x) / FOCAL_PX;
            let up = (0.5 * HEIGHT_PX as f64 - y) / FOCAL_PX;
            rays.project(camera_from_rig * DVec3::new(1.0, left, up))
        };
        let middle = [0.5 * WIDTH_PX as f64, 0.5 * HEIGHT_PX as f64];
        let [left, right] = [-0.5, 0.5].map(|beside| projected(middle[0] + beside, middle[1]));
        // Pixels of the camera for one of the small image, side by side.
        let scale = left
            .zip(right)
            .map_or(1.0, |(left, right)| left.distance(right));
        let along = (scale.round() as usize).clamp(1, SAMPLES_MAX);
        let pixel_of = |x: f64, y: f64| {
            let pixel = projected(x, y)?;
            let inside = pixel.x >= 0.0
                && pixel.y >= 0.0
                && pixel.x < size_px[0] as f64
                && pixel.y < size_px[1] as f64;
            inside.then(|| (pixel.y as usize * size_px[0] + pixel.x as usize) as u32)
        };
        let mut sampled = Vec::with_capacity(WIDTH_PX * HEIGHT_PX * along * along);
        for y in 0..HEIGHT_PX {
            for x in 0..WIDTH_PX {
                for sample in 0..along * along {
                    let within = |at: usize| (at as f64 + 0.5) / along as f64;
                    sampled.push(pixel_of(
                        x as f64 + within(sample % along),
                        y as f64 + within(sample / along),
                    ));
                }
            }
        }
        Some(Self {
            size_px,
            sampled,
            samples: along * along,
        })
    }

    /// The small image of `frame`; `None` where its bytes are not those of the camera.
    pub(super) fn small(&self, frame: &Frame) -> Option<Small> {
        let pixels = self.size_px[0].checked_mul(self.size_px[1])?;
        if frame.rgba.len() != pixels.checked_mul(4)? {
            return None;
        }
        let count = self.samples as u32;
        let mean = |samples: &[Option<u32>]| {
            let mut sum = [0_u32; 3];
            for pixel in samples.iter().flatten() {
                let first = *pixel as usize * 4;
                for (sum, &channel) in sum.iter_mut().zip(&frame.rgba[first..first + 3]) {
                    *sum += u32::from(channel);
                }
            }
            sum.map(|sum| ((sum + count / 2) / count) as u8)
        };
        Some(
            self.sampled
                .chunks_exact(self.samples)
                .flat_map(mean)
                .collect(),
        )
    }
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::{Intrinsics, Pose};
    use glam::DQuat;

    use super::*;

    fn camera(size_px: [u32; 2], focal_px: f64) -> RigCamera {
        RigCamera {
            name: "front".into(),
            intrinsics: Intrinsics::centered(size_px, focal_px),
            rig_from_camera: Pose {
                rotation: DQuat::from_xyzw(-0.5, 0.5, -0.5, 0.5),
                translation: DVec3::new(1.5, 0.0, 0.8),
            },
        }
    }

    /// An image of that size with a red that follows columns and a green that follows rows.
    fn slanted([width, height]: [u32; 2]) -> Vec<u8> {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        pixels
            .flat_map(|(x, y)| [(x / 2) as u8, (y / 2) as u8, 200, 255])
            .collect()
    }

    #[test]
    fn an_image_of_twice_the_size_is_averaged_two_by_two() {
        let camera = camera([320, 180], 252.0);
        let rgba = slanted([320, 180]);
        let small = View::new(&camera)
            .unwrap()
            .small(&Frame {
                camera: &camera,
                rgba: &rgba,
            })
            .unwrap();
        assert_eq!(small.len(), WIDTH_PX * HEIGHT_PX * 3);
        for (at, pixel) in small.chunks_exact(3).enumerate() {
            let (x, y) = (at % WIDTH_PX, at / WIDTH_PX);
            // Three rows above and below are not seen.
            let expected = match (3..93).contains(&y) {
                true => [x as u8, (y - 3) as u8, 200],
                false => [0; 3],
            };
            assert_eq!(pixel, expected, "{x} {y}");
        }
    }

    #[test]
    fn other_cameras_show_the_same_directions() {
        let size_px = [640, 480];
        let camera = camera(size_px, 300.0);
        let rgba = slanted(size_px);
        let small = View::new(&camera)
            .unwrap()
            .small(&Frame {
                camera: &camera,
                rgba: &rgba,
            })
            .unwrap();
        for at in [0, 37 * WIDTH_PX + 120, WIDTH_PX * HEIGHT_PX - 1] {
            let offset = [(at % WIDTH_PX) as f64 - 79.5, (at / WIDTH_PX) as f64 - 47.5];
            let [column, row] = offset.map(|offset| offset * 300.0 / FOCAL_PX);
            let expected = [(column + 320.0) / 2.0, (row + 240.0) / 2.0];
            for (found, expected) in small[3 * at..].iter().zip(expected) {
                assert!(
                    (f64::from(*found) - expected).abs() <= 1.5,
                    "{found} {expected}"
                );
            }
        }
    }

    #[test]
    fn images_that_are_not_those_of_the_camera_are_no_images() {
        let camera = camera([320, 180], 252.0);
        let view = View::new(&camera).unwrap();
        for rgba in [&[][..], &[9; 3], &vec![0; 320 * 179 * 4]] {
            assert!(
                view.small(&Frame {
                    camera: &camera,
                    rgba
                })
                .is_none()
            );
        }
        let mut turned = camera.clone();
        turned.rig_from_camera.rotation.x = f64::NAN;
        assert!(View::new(&turned).is_none());
        let mut blind = camera;
        blind.intrinsics.fx_px = 0.0;
        assert!(View::new(&blind).is_none());
    }
}
