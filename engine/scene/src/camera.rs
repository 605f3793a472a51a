//! Cameras and rigs of them.

use crate::{Invalid, Motion, Photometry, Pose, Shutter, Trajectory};
use glam::{DVec2, DVec3};

use crate::lens::{ANGLE_LIMIT_RAD, FTheta, FThetaReference, Lens, RayMap, Windshield};
use crate::lidar::{Lidar, RigLidar};

/// Intrinsics of a camera. Pixel `(i, j)` has its center at `(i + 0.5, j + 0.5)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Image width in pixels, at least 1.
    pub width_px: u32,
    /// Image height in pixels, at least 1.
    pub height_px: u32,
    /// Focal length along x, pixels.
    pub fx_px: f64,
    /// Focal length along y, pixels.
    pub fy_px: f64,
    /// Principal point, pixels from the left edge of the image.
    pub cx_px: f64,
    /// Principal point, pixels from the top edge of the image.
    pub cy_px: f64,
    /// Lens: the deviation from a pinhole.
    pub lens: Lens,
    /// Windshield before the lens.
    pub windshield: Option<Windshield>,
    /// Photometric calibration.
    pub photometry: Photometry,
    /// Time of exposure of each pixel.
    pub shutter: Shutter,
}

impl Intrinsics {
    /// A pinhole with square pixels, a centered principal point and the given horizontal field of
    /// view.
    #[must_use]
    pub fn from_horizontal_fov(width_px: u32, height_px: u32, fov_rad: f64) -> Self {
        let focal_px = 0.5 * f64::from(width_px) / (0.5 * fov_rad).tan();
        Self::centered([width_px, height_px], focal_px)
    }

    /// A pinhole with square pixels and a centered principal point. `size_px` is width and height.
    #[must_use]
    pub fn centered(size_px: [u32; 2], focal_px: f64) -> Self {
        let center_px = size_px.map(|side_px| 0.5 * f64::from(side_px));
        Self::pinhole(size_px, [focal_px; 2], center_px)
    }

    /// A pinhole with focal lengths and principal point along x and y. Colors are not calibrated,
    /// there is no windshield, and the shutter is global.
    #[must_use]
    pub const fn pinhole(
        [width_px, height_px]: [u32; 2],
        [fx_px, fy_px]: [f64; 2],
        [cx_px, cy_px]: [f64; 2],
    ) -> Self {
        Self {
            width_px,
            height_px,
            fx_px,
            fy_px,
            cx_px,
            cy_px,
            lens: Lens::Pinhole,
            photometry: Photometry::IDENTITY,
            windshield: None,
            shutter: Shutter::GLOBAL,
        }
    }

    /// The same view sampled at another size; the field of view stays, pixels may become
    /// non-square.
    #[must_use]
    pub fn resized(&self, width_px: u32, height_px: u32) -> Self {
        let sx = f64::from(width_px) / f64::from(self.width_px);
        let sy = f64::from(height_px) / f64::from(self.height_px);
        Self {
            width_px,
            height_px,
            fx_px: self.fx_px * sx,
            fy_px: self.fy_px * sy,
            cx_px: self.cx_px * sx,
            cy_px: self.cy_px * sy,
            lens: self.lens.scaled(sx, sy),
            windshield: self.windshield,
            photometry: self.photometry.scaled(sx, sy),
            shutter: self.shutter.scaled(sx, sy),
        }
    }

    /// The window of `width_px` by `height_px` pixels whose top left pixel is `(left_px, top_px)`,
    /// as a camera of its own.
    #[must_use]
    pub fn cropped(&self, left_px: u32, top_px: u32, width_px: u32, height_px: u32) -> Self {
        let corner_px = [f64::from(left_px), f64::from(top_px)];
        self.window(corner_px, [width_px, height_px])
    }

    /// The same camera with a wider image: `x_px` more pixels to the left and right, `y_px` more
    /// above and below.
    #[must_use]
    pub fn padded(&self, x_px: u32, y_px: u32) -> Self {
        let corner_px = [-f64::from(x_px), -f64::from(y_px)];
        self.window(
            corner_px,
            [self.width_px + 2 * x_px, self.height_px + 2 * y_px],
        )
    }

    /// The window of `size_px` whose top left corner is `corner_px`, inside the image or around it.
    fn window(&self, [left_px, top_px]: [f64; 2], [width_px, height_px]: [u32; 2]) -> Self {
        Self {
            width_px,
            height_px,
            cx_px: self.cx_px - left_px,
            cy_px: self.cy_px - top_px,
            photometry: self.photometry.cropped(left_px, top_px),
            shutter: self.shutter.cropped(left_px, top_px),
            ..*self
        }
    }

    /// The view through an f-theta lens whose distance from the principal point grows in proportion
    /// to the angle: the left or right edge, the one farther from the principal point, shows the
    /// same angle as before. Intrinsics with an f-theta lens stay as they are; `None` where no ray
    /// falls on that edge.
    #[must_use]
    pub fn through_f_theta(&self) -> Option<Self> {
        if matches!(self.lens, Lens::FTheta(_)) {
            return Some(*self);
        }
        let [width_px, height_px] = [self.width_px, self.height_px].map(f64::from);
        let edge_px = if self.cx_px < 0.5 * width_px {
            width_px
        } else {
            0.0
        };
        let ray = self.unproject(DVec2::new(edge_px, self.cy_px))?;
        // Pixels need not be square.
        let aspect = self.fx_px / self.fy_px;
        let focal_px = (edge_px - self.cx_px).abs() / (aspect * ray.angle_between(DVec3::Z));
        let reach_px = DVec2::new(
            self.cx_px.max(width_px - self.cx_px) / aspect,
            self.cy_px.max(height_px - self.cy_px),
        );
        let lens = FTheta {
            reference: FThetaReference::AngleToPixelDistance,
            pixel_distance_to_angle: [0.0, focal_px.recip(), 0.0, 0.0, 0.0, 0.0],
            angle_to_pixel_distance: [0.0, focal_px, 0.0, 0.0, 0.0, 0.0],
            max_angle_rad: (1.01 * reach_px.length() / focal_px).min(ANGLE_LIMIT_RAD),
            linear_cde: [aspect, 0.0, 0.0],
        };
        Some(Self {
            fx_px: aspect * focal_px,
            fy_px: focal_px,
            lens: Lens::FTheta(lens),
            ..*self
        })
    }

    /// True if the camera is equal to a pinhole: by its lens, and without a windshield.
    #[must_use]
    pub fn is_pinhole(&self) -> bool {
        self.lens.is_pinhole() && self.windshield.is_none()
    }

    /// Pixels in the image.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        u64::from(self.width_px) * u64::from(self.height_px)
    }

    /// Checks that these intrinsics can form an image, and gives the reason if not.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.width_px == 0
            || self.height_px == 0
            || self.width_px > 65_536
            || self.height_px > 65_536
        {
            return Err(Invalid::new(format!(
                "image size {}x{} is outside 1x1 to 65536x65536",
                self.width_px, self.height_px
            )));
        }
        if !(self.fx_px.is_finite()
            && self.fx_px > 0.0
            && self.fy_px.is_finite()
            && self.fy_px > 0.0)
        {
            return Err(Invalid::new(format!(
                "focal lengths {} and {} must be finite and positive",
                self.fx_px, self.fy_px
            )));
        }
        if !(self.cx_px.is_finite() && self.cy_px.is_finite()) {
            return Err(Invalid::new(format!(
                "principal point ({}, {}) must be finite",
                self.cx_px, self.cy_px
            )));
        }
        self.photometry.check()?;
        self.shutter.check([self.width_px, self.height_px])?;
        self.lens.check()?;
        if let Some(windshield) = &self.windshield {
            windshield.check()?;
        }
        if self.lens == Lens::Pinhole && self.windshield.is_none() {
            Ok(())
        } else {
            Ok(RayMap::new(self).check(self)?)
        }
    }

    /// Projection of `ray` (x right, y down, z forward, of any length), pixels, in the image or
    /// beside it; `None` for a ray outside of the lens's field. For many rays, make a [`RayMap`]
    /// once.
    #[must_use]
    pub fn project(&self, ray: DVec3) -> Option<DVec2> {
        if self.is_pinhole() {
            let on_plane = DVec2::new(self.fx_px, self.fy_px) * (ray.truncate() / ray.z)
                + DVec2::new(self.cx_px, self.cy_px);
            return (ray.z > 0.0).then_some(on_plane);
        }
        RayMap::new(self).project(ray)
    }

    /// The ray of unit length that falls on `pixel`; `None` where there is none.
    #[must_use]
    pub fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        if self.is_pinhole() {
            let slope =
                (pixel - DVec2::new(self.cx_px, self.cy_px)) / DVec2::new(self.fx_px, self.fy_px);
            return slope.is_finite().then(|| slope.extend(1.0).normalize());
        }
        RayMap::new(self).unproject(pixel)
    }

    /// Horizontal field of view at half the height of the image, radians: the angle between the
    /// rays of its left and its right edge, each counted from the middle, or of the outermost
    /// columns that a ray falls on. 0 if there is none.
    #[must_use]
    pub fn horizontal_fov_rad(&self) -> f64 {
        let map = RayMap::new(self);
        let (width_px, middle_px) = (self.width_px, 0.5 * f64::from(self.height_px));
        let ray = |column: u32| map.unproject(DVec2::new(f64::from(column), middle_px));
        let middle = ray(width_px / 2);
        let from_middle = |outermost: Option<DVec3>| match (middle, outermost) {
            (Some(middle), Some(ray)) => middle.angle_between(ray),
            _ => 0.0,
        };
        from_middle((0..=width_px).find_map(ray)) + from_middle((0..=width_px).rev().find_map(ray))
    }
}

/// A camera placed in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Names the image; unique in a rig.
    pub name: String,
    /// Intrinsics, in pixels.
    pub intrinsics: Intrinsics,
    /// Pose, f64 world coordinates, at the time 0 of the shutter.
    pub world_from_camera: Pose,
    /// Motion while the image is exposed.
    pub motion: Motion,
}

impl Camera {
    /// A camera at rest. `world_from_camera` has OpenCV axes: x right, y down, z forward.
    #[must_use]
    pub fn new(name: impl Into<String>, intrinsics: Intrinsics, world_from_camera: Pose) -> Self {
        Self {
            name: name.into(),
            intrinsics,
            world_from_camera,
            motion: Motion::REST,
        }
    }

    /// The camera at the time `time_s` of its shutter, at rest, with all pixels exposed at once.
    #[must_use]
    pub fn at_rest(&self, time_s: f64) -> Self {
        Self {
            intrinsics: Intrinsics {
                shutter: Shutter::GLOBAL,
                ..self.intrinsics
            },
            motion: Motion::REST,
            ..self.later(time_s)
        }
    }

    /// The camera `time_s` later: it has gone on with its motion.
    #[must_use]
    pub fn later(&self, time_s: f64) -> Self {
        Self {
            world_from_camera: self.world_from_camera.moved(&self.motion, time_s),
            ..self.clone()
        }
    }
}

/// A camera fixed to a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct RigCamera {
    /// Names the image; unique in the rig.
    pub name: String,
    /// Intrinsics, in pixels.
    pub intrinsics: Intrinsics,
    /// Pose on the vehicle.
    pub rig_from_camera: Pose,
}

/// A sensor fixed to a vehicle. Every place that depends on the kind of sensor matches on it.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "a rig has a handful of sensors")]
pub enum Sensor {
    /// Camera; its reading is an image.
    Camera(RigCamera),
    /// LiDAR; its reading is a sweep.
    Lidar(RigLidar),
}

impl Sensor {
    /// Name, unique in the rig.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Camera(camera) => &camera.name,
            Self::Lidar(lidar) => &lidar.name,
        }
    }
}

/// The sensors of one vehicle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    /// Sensors. Readings are returned in this order, those of cameras before those of LiDARs.
    pub sensors: Vec<Sensor>,
}

impl FromIterator<RigCamera> for Rig {
    fn from_iter<I: IntoIterator<Item = RigCamera>>(cameras: I) -> Self {
        Self {
            sensors: cameras.into_iter().map(Sensor::Camera).collect(),
        }
    }
}

impl Rig {
    /// The cameras among the sensors, in order.
    pub fn cameras(&self) -> impl Iterator<Item = &RigCamera> + Clone {
        self.sensors.iter().filter_map(|sensor| match sensor {
            Sensor::Camera(camera) => Some(camera),
            Sensor::Lidar(_) => None,
        })
    }

    /// The LiDARs among the sensors, in order.
    pub fn lidars(&self) -> impl Iterator<Item = &RigLidar> + Clone {
        self.sensors.iter().filter_map(|sensor| match sensor {
            Sensor::Camera(_) => None,
            Sensor::Lidar(lidar) => Some(lidar),
        })
    }

    /// [`Rig::cameras`], to be changed.
    pub fn cameras_mut(&mut self) -> impl Iterator<Item = &mut RigCamera> {
        self.sensors.iter_mut().filter_map(|sensor| match sensor {
            Sensor::Camera(camera) => Some(camera),
            Sensor::Lidar(_) => None,
        })
    }

    /// The rig's cameras in the world when the vehicle stands at `world_from_rig`.
    #[must_use]
    pub fn at(&self, world_from_rig: &Pose) -> Vec<Camera> {
        self.moving_at(world_from_rig, &Motion::REST)
    }

    /// The rig's cameras in the world when the vehicle passes `world_from_rig` with `motion`. The
    /// motion of a camera with a rolling shutter is that between its poses at the start and at the
    /// end of its readout; of others, the one at the moment.
    #[must_use]
    pub fn moving_at(&self, world_from_rig: &Pose, motion: &Motion) -> Vec<Camera> {
        let moving = |camera: &RigCamera| {
            let k = &camera.intrinsics;
            let half_s = match k.shutter.readout_s([k.width_px, k.height_px]) {
                0.0 => 1e-3,
                readout_s => 0.5 * readout_s,
            };
            let at = |time_s: f64| {
                let rig = world_from_rig.moved(motion, time_s);
                rig.then(&camera.rig_from_camera)
            };
            Motion::between(&at(-half_s), &at(half_s), 2.0 * half_s)
        };
        self.cameras()
            .map(|camera| Camera {
                name: camera.name.clone(),
                intrinsics: camera.intrinsics,
                world_from_camera: world_from_rig.then(&camera.rig_from_camera),
                motion: if motion.is_rest() {
                    Motion::REST
                } else {
                    moving(camera)
                },
            })
            .collect()
    }

    /// Sweeps of the rig's LiDARs that end when the vehicle passes `world_from_rig` with `motion`.
    #[must_use]
    pub fn sweeps_until(&self, world_from_rig: &Pose, motion: &Motion) -> Vec<Lidar> {
        self.lidars()
            .map(|lidar| lidar.sweep_until(world_from_rig, motion))
            .collect()
    }

    /// The rig's cameras in the world at `time_s` of the vehicle's trajectory.
    #[must_use]
    pub fn driving(&self, ego: &Trajectory, time_s: f64) -> Vec<Camera> {
        self.moving_at(&ego.at(time_s), &ego.motion_at(time_s))
    }
}

#[cfg(test)]
mod tests {
    use crate::lens::Fisheye;

    use super::*;

    #[test]
    fn cropping_keeps_the_ray_of_a_pixel() {
        let full = Intrinsics::from_horizontal_fov(1600, 900, 1.2);
        let crop = full.cropped(300, 200, 64, 64);
        let x_of = |k: &Intrinsics, i: f64| (i + 0.5 - k.cx_px) / k.fx_px;
        assert!((x_of(&full, 310.0) - x_of(&crop, 10.0)).abs() < 1e-15);
    }

    #[test]
    fn an_f_theta_lens_shows_the_same_angle_at_the_edge() {
        let pinhole = Intrinsics {
            cx_px: 300.0,
            ..Intrinsics::from_horizontal_fov(640, 400, 2.0).resized(640, 360)
        };
        let fitted = pinhole.through_f_theta().unwrap();
        fitted.check().unwrap();
        let edge = DVec2::new(640.0, pinhole.cy_px);
        let [before, after] = [pinhole, fitted].map(|k| k.unproject(edge).unwrap());
        assert!(before.angle_between(after) < 1e-9, "{before} {after}");
        // Angles are in proportion to distances, along both axes.
        let half = fitted.unproject(DVec2::new(470.0, pinhole.cy_px)).unwrap();
        let angle = |ray: DVec3| ray.angle_between(DVec3::Z);
        assert!((2.0 * angle(half) - angle(after)).abs() < 1e-9);
        let down = fitted.unproject(DVec2::new(300.0, 280.0)).unwrap();
        assert!((down.y.atan2(down.z) - 100.0 / fitted.fy_px).abs() < 1e-9);
        assert!((fitted.fx_px / fitted.fy_px - pinhole.fx_px / pinhole.fy_px).abs() < 1e-12);
        // Every corner is shown, and an f-theta lens stays.
        assert!(fitted.unproject(DVec2::ZERO).is_some());
        assert_eq!(fitted.through_f_theta(), Some(fitted));
    }

    #[test]
    fn the_field_of_view_is_that_of_the_lens() {
        let pinhole = Intrinsics::from_horizontal_fov(480, 270, 1.2);
        assert!((pinhole.horizontal_fov_rad() - 1.2).abs() < 1e-12);
        let beside = pinhole.cropped(0, 0, 240, 270);
        assert!((beside.horizontal_fov_rad() - 0.6).abs() < 1e-12);
        let wide = Intrinsics::from_horizontal_fov(480, 270, 2.0);
        let f_theta = wide.through_f_theta().unwrap();
        assert!((f_theta.horizontal_fov_rad() - 2.0).abs() < 1e-9);
        // 1.92 focal lengths on each side, of which the lens shows 1.4.
        let fisheye = Intrinsics {
            lens: Lens::Fisheye(Fisheye {
                max_angle_rad: 1.4,
                ..Fisheye::default()
            }),
            ..Intrinsics::centered([480, 270], 125.0)
        };
        let shown = fisheye.horizontal_fov_rad();
        assert!(shown <= 2.8 && shown > 2.8 - 2.0 / 125.0, "{shown}");
    }

    #[test]
    fn nonsense_is_refused_with_its_value() {
        let good = Intrinsics::from_horizontal_fov(4, 4, 1.0);
        assert!(good.check().is_ok());
        assert!(
            Intrinsics {
                width_px: 0,
                ..good
            }
            .check()
            .unwrap_err()
            .reason()
            .contains("0x4")
        );
        assert!(
            Intrinsics {
                fx_px: f64::NAN,
                ..good
            }
            .check()
            .unwrap_err()
            .reason()
            .contains("NaN")
        );
    }
}
