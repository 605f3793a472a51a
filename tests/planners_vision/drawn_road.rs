//! A road drawn pixel by pixel: asphalt, markings, shade, paint across the road and a car. What is
//! seen is known exactly.

use decouplegs::scene::{Intrinsics, Lens, Photometry, Pose, RigCamera, Shutter, VehicleSize};
use glam::{DMat3, DQuat, DVec2, DVec3};

/// The ego that looks.
pub const EGO: VehicleSize = VehicleSize {
    length_m: 4.5,
    width_m: 1.8,
    height_m: 1.7,
};
/// The car that is examined: width and height, meters.
const CAR_M: [f64; 2] = [1.8, 1.5];
/// Width of a marking, meters.
const MARKING_M: f64 = 0.14;
/// Rays a pixel and axis.
const RAYS: u32 = 2;

/// A road as a vehicle on it sees it.
#[derive(Clone, Copy, Debug)]
pub struct DrawnRoad {
    /// Middle of the lane beside the vehicle, to the left where above zero, meters.
    pub offset_m: f64,
    /// Heading of the lane in the vehicle's frame.
    pub heading_rad: f64,
    /// Curvature of the lane, 1/m.
    pub curvature: f64,
    pub width_m: f64,
    /// Start of the dashes of the left line.
    pub dashes_m: f64,
    /// Distance from the vehicle's front to the rear of a car in the lane.
    pub gap_m: Option<f64>,
    /// Shade over the road between two distances ahead.
    pub shade_m: Option<[f64; 2]>,
    /// Bars along the road, as those of a crosswalk, between two distances ahead.
    pub bars_m: Option<[f64; 2]>,
    /// Brightness of everything.
    pub light: f64,
}

impl Default for DrawnRoad {
    fn default() -> Self {
        Self {
            offset_m: 0.0,
            heading_rad: 0.0,
            curvature: 0.0,
            width_m: 3.3,
            dashes_m: 0.0,
            gap_m: None,
            shade_m: None,
            bars_m: None,
            light: 1.0,
        }
    }
}

/// A camera on the roof, as the street's rig has it, its image 320 by 180 pixels.
pub fn camera() -> RigCamera {
    let rotation = DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X));
    RigCamera {
        name: "front".into(),
        intrinsics: Intrinsics {
            width_px: 320,
            height_px: 180,
            fx_px: 253.28,
            fy_px: 253.28,
            cx_px: 160.0,
            cy_px: 90.0,
            lens: Lens::Pinhole,
            photometry: Photometry::IDENTITY,
            windshield: None,
            shutter: Shutter::GLOBAL,
        },
        rig_from_camera: Pose::new(rotation, DVec3::new(0.4, 0.0, 1.6 - 0.5 * EGO.height_m)),
    }
}

impl DrawnRoad {
    /// The road as `camera` sees it, four bytes per pixel.
    pub fn image(&self, camera: &RigCamera) -> Vec<u8> {
        let at = &camera.intrinsics;
        let mut rgba = Vec::with_capacity(at.pixels() as usize * 4);
        for row in 0..at.height_px {
            for column in 0..at.width_px {
                let mut sum = DVec3::ZERO;
                for ray in 0..RAYS * RAYS {
                    let part = |of: u32| (f64::from(of) + 0.5) / f64::from(RAYS);
                    let pixel = DVec2::new(
                        f64::from(column) + part(ray % RAYS),
                        f64::from(row) + part(ray / RAYS),
                    );
                    let seen = DVec3::new(
                        (pixel.x - at.cx_px) / at.fx_px,
                        (pixel.y - at.cy_px) / at.fy_px,
                        1.0,
                    );
                    sum += self.color(
                        camera.rig_from_camera.translation,
                        camera.rig_from_camera.rotation * seen,
                    );
                }
                let mean = sum / f64::from(RAYS * RAYS) * self.light;
                rgba.extend(
                    (mean * 255.0)
                        .round()
                        .to_array()
                        .map(|channel| channel.clamp(0.0, 255.0) as u8),
                );
                rgba.push(255);
            }
        }
        rgba
    }

    fn color(&self, eye: DVec3, ray: DVec3) -> DVec3 {
        let ground_z_m = -0.5 * EGO.height_m;
        let to_ground = if ray.z < -1e-9 {
            (ground_z_m - eye.z) / ray.z
        } else {
            f64::INFINITY
        };
        if let Some(gap_m) = self.gap_m {
            let rear_m = 0.5 * EGO.length_m + gap_m;
            let to_rear = (rear_m - eye.x) / ray.x;
            let at = eye + ray * to_rear;
            let (across_m, height_m) = (at.y - self.middle_m(rear_m), at.z - ground_z_m);
            if to_rear > 0.0
                && to_rear < to_ground
                && across_m.abs() < 0.5 * CAR_M[0]
                && (0.0..CAR_M[1]).contains(&height_m)
            {
                return car(across_m, height_m);
            }
        }
        if to_ground.is_finite() {
            self.ground((eye + ray * to_ground).truncate())
        } else {
            DVec3::new(0.6, 0.7, 0.85)
        }
    }

    /// Center of the lane `ahead_m` meters ahead.
    fn middle_m(&self, ahead_m: f64) -> f64 {
        self.offset_m + self.heading_rad.tan() * ahead_m + 0.5 * self.curvature * ahead_m * ahead_m
    }

    fn ground(&self, at: DVec2) -> DVec3 {
        let within =
            |span: Option<[f64; 2]>| span.is_some_and(|[from, to]| (from..to).contains(&at.x));
        let across_m = at.y - self.middle_m(at.x);
        let on_line = |middle_m: f64| (across_m - middle_m).abs() < 0.5 * MARKING_M;
        let dash = (at.x - self.dashes_m).rem_euclid(9.0) < 3.0;
        let bar = within(self.bars_m) && (across_m / 1.05).rem_euclid(1.0) < 0.48;
        let painted = (on_line(0.5 * self.width_m) && dash) || on_line(-0.5 * self.width_m) || bar;
        let albedo = if painted {
            DVec3::splat(0.8)
        } else {
            asphalt(at)
        };
        // Light of the sky is bluer than that of the sun.
        if within(self.shade_m) {
            albedo * DVec3::new(0.48, 0.5, 0.55)
        } else {
            albedo
        }
    }
}

/// Asphalt in patches a quarter of a meter wide.
fn asphalt(at: DVec2) -> DVec3 {
    let cell = (at * 4.0).floor();
    let mixed = (cell.x as i64)
        .wrapping_mul(0x9e37_79b9)
        .wrapping_add((cell.y as i64).wrapping_mul(0x85eb_ca6b)) as u64;
    let unit = (mixed.wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f64 / 16_777_216.0;
    DVec3::new(0.42, 0.415, 0.41) * (0.97 + 0.06 * unit)
}

/// The rear of a car, from the dark below its bumper to its roof.
fn car(across_m: f64, height_m: f64) -> DVec3 {
    let paint = DVec3::new(0.2, 0.3, 0.6);
    if height_m < 0.28 {
        DVec3::splat(0.07)
    } else if height_m > 0.95 && height_m < 1.38 && across_m.abs() < 0.7 {
        DVec3::new(0.1, 0.12, 0.14)
    } else if (0.65..0.85).contains(&height_m) && across_m.abs() > 0.6 {
        DVec3::new(0.7, 0.05, 0.05)
    } else {
        paint
    }
}
