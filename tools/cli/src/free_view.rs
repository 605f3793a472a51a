//! One pinhole as numbers, on the command line and in files of camera paths.

use std::fmt;
use std::str::FromStr;

use decouplegs_scene::{Camera, Intrinsics, Lens, Motion, Photometry, Pose};
use glam::{DQuat, DVec3};

/// Largest coordinate of a position, meters.
pub const PLACE_MAX_M: f64 = 1e9;
/// Vertical fields of view, degrees.
pub const FOVS_DEG: [f64; 2] = [0.1, 160.0];
/// Focal lengths, pixels.
const FOCALS_PX: [f64; 2] = [1e-3, 1e9];
/// A quaternion whose squared length is this near to 1 is a rotation as it stands: to divide it by
/// its length would change its last bits.
const UNIT_TOLERANCE: f64 = 1e-12;

const EXPECTED: &str = "expected X,Y,Z,QX,QY,QZ,QW,FOV: a position, a rotation as a quaternion of length above 0, and a vertical field of view of 0.1 to 160 degrees (or FX,FY,CX,CY instead of FOV, pixels)";

/// A pinhole: x right, y down, z forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeView {
    /// Position, meters.
    pub position_m: [f64; 3],
    /// Rotation, a quaternion x, y, z, w of any length above 0.
    pub rotation: [f64; 4],
    /// Field of view or focal lengths.
    pub lens: FreeLens,
}

/// Field of view or focal lengths of a pinhole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FreeLens {
    /// Vertical field of view, degrees, with the principal point in the middle of the image.
    Fov(f64),
    /// Focal lengths and principal point along x and y, pixels.
    Pixels {
        /// Focal lengths.
        focal: [f64; 2],
        /// Principal point.
        center: [f64; 2],
    },
}

impl FreeView {
    /// The view of `camera`, if that is a plain pinhole: no lens, no windshield, no calibration of
    /// colors, a global shutter.
    #[must_use]
    pub fn from_camera(camera: &Camera) -> Option<Self> {
        let k = &camera.intrinsics;
        let is_plain = k.lens == Lens::Pinhole
            && k.windshield.is_none()
            && k.photometry == Photometry::IDENTITY
            && k.shutter.is_global();
        is_plain.then(|| Self {
            position_m: camera.world_from_camera.translation.to_array(),
            rotation: camera.world_from_camera.rotation.to_array(),
            lens: FreeLens::Pixels {
                focal: [k.fx_px, k.fy_px],
                center: [k.cx_px, k.cy_px],
            },
        })
    }

    /// Checks that it makes an image.
    ///
    /// # Errors
    /// A sentence about what was expected.
    pub fn check(&self) -> Result<(), String> {
        let numbers = self.position_m.iter().chain(&self.rotation);
        let in_range = numbers
            .into_iter()
            .all(|number| number.abs() <= PLACE_MAX_M);
        let squared: f64 = self.rotation.iter().map(|number| number * number).sum();
        let within = |value: f64, [least, most]: [f64; 2]| (least..=most).contains(&value);
        let has_lens = match self.lens {
            FreeLens::Fov(fov_deg) => within(fov_deg, FOVS_DEG),
            FreeLens::Pixels { focal, center } => {
                let center = center.iter().all(|at_px| at_px.abs() <= PLACE_MAX_M);
                focal.iter().all(|&focal_px| within(focal_px, FOCALS_PX)) && center
            }
        };
        match in_range && squared.is_finite() && squared > 1e-12 && has_lens {
            true => Ok(()),
            false => Err(EXPECTED.into()),
        }
    }

    /// Pose of the camera.
    #[must_use]
    pub fn pose(&self) -> Pose {
        let rotation = DQuat::from_array(self.rotation);
        let translation = DVec3::from_array(self.position_m);
        match (rotation.length_squared() - 1.0).abs() < UNIT_TOLERANCE {
            true => Pose {
                rotation,
                translation,
            },
            false => Pose::new(rotation.normalize(), translation),
        }
    }

    /// Intrinsics of an image of `size_px`.
    #[must_use]
    pub fn intrinsics(&self, size_px: [u32; 2]) -> Intrinsics {
        let [width_px, height_px] = size_px;
        match self.lens {
            FreeLens::Fov(fov_deg) => {
                let aspect = f64::from(width_px) / f64::from(height_px);
                let half = (0.5 * fov_deg.to_radians()).tan();
                Intrinsics::from_horizontal_fov(width_px, height_px, 2.0 * (half * aspect).atan())
            }
            FreeLens::Pixels { focal, center } => Intrinsics::pinhole(size_px, focal, center),
        }
    }

    /// The camera called `name`, at rest, with an image of `size_px`.
    #[must_use]
    pub fn camera(&self, name: &str, size_px: [u32; 2]) -> Camera {
        Camera {
            name: name.into(),
            intrinsics: self.intrinsics(size_px),
            world_from_camera: self.pose(),
            motion: Motion::REST,
        }
    }
}

/// Numbers with commas between them, as [`FreeView::from_str`] reads them, to the last bit.
impl fmt::Display for FreeView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for number in self.position_m.iter().chain(&self.rotation) {
            write!(f, "{number:?},")?;
        }
        match self.lens {
            FreeLens::Fov(fov_deg) => write!(f, "{fov_deg:?}"),
            FreeLens::Pixels { focal, center } => {
                let ([fx, fy], [cx, cy]) = (focal, center);
                write!(f, "{fx:?},{fy:?},{cx:?},{cy:?}")
            }
        }
    }
}

impl FromStr for FreeView {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let fault = || format!("{EXPECTED}, found {text:?}");
        let numbers = text.split(',').map(|part| part.trim().parse());
        let numbers: Vec<f64> = numbers.collect::<Result<_, _>>().map_err(|_| fault())?;
        let lens = match numbers[..] {
            [_, _, _, _, _, _, _, fov_deg] => FreeLens::Fov(fov_deg),
            [_, _, _, _, _, _, _, fx, fy, cx, cy] => FreeLens::Pixels {
                focal: [fx, fy],
                center: [cx, cy],
            },
            _ => return Err(fault()),
        };
        let view = Self {
            position_m: [numbers[0], numbers[1], numbers[2]],
            rotation: [numbers[3], numbers[4], numbers[5], numbers[6]],
            lens,
        };
        view.check().map_err(|_| fault())?;
        Ok(view)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_read_as_it_was_written_to_the_last_bit() {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.2, 2.5).to_array();
        for lens in [
            FreeLens::Fov(60.000_000_000_000_01),
            FreeLens::Pixels {
                focal: [1266.3, 1e3 / 3.0],
                center: [24.5, 1e-300],
            },
        ] {
            let view = FreeView {
                position_m: [0.1 + 0.2, -1e-17, 4.5e6 / 7.0],
                rotation,
                lens,
            };
            let read: FreeView = view.to_string().parse().unwrap();
            assert_eq!(read, view);
            let camera = read.camera("view", [48, 27]);
            assert_eq!(camera.world_from_camera.rotation.to_array(), rotation);
            let again = FreeView::from_camera(&camera).unwrap();
            assert_eq!(again.camera("view", [48, 27]), camera);
        }
    }

    #[test]
    fn numbers_that_make_no_view_are_refused() {
        for text in [
            "",
            "1,2,3",
            "0,0,0,0,0,0,1,60,1",
            "0,0,0,0,0,0,0,60",
            "0,0,0,0,0,0,1,0",
            "0,0,0,0,0,0,1,180",
            "0,0,1e12,0,0,0,1,60",
            "0,0,nan,0,0,0,1,60",
            "0,0,0,0,0,inf,1,60",
            "0,0,0,0,0,0,1,0,5,1,1",
            "0,0,0,0,0,0,1,x",
        ] {
            let refused = text.parse::<FreeView>().unwrap_err();
            assert!(refused.contains(&format!("{text:?}")), "{refused}");
        }
        assert!("0,0,0,0,0,0,2,60".parse::<FreeView>().is_ok());
    }
}
