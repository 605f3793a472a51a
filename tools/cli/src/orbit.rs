//! Cameras around splats that have none of their own.

use std::f64::consts::TAU;
use std::path::Path;
use std::str::FromStr;

use decouplegs_asset::usual_up;
use decouplegs_scene::{Camera, Framing, Pose, SplatCloud};
use glam::DVec3;

use crate::arguments::three_numbers;

/// Views where nothing is said.
const VIEWS: u32 = 8;
/// Size of the images where nothing is said, pixels.
pub const SIZE_PX: [u32; 2] = [1280, 720];
/// Largest coordinate of a position that cameras look at.
const PLACE_MAX: f64 = 1e9;

/// Placement of cameras around a scene that has none.
#[derive(clap::Args)]
pub struct OrbitArguments {
    /// Place N cameras in a circle around the scene (default: 8, if the scene has no cameras and no
    /// file names some)
    #[arg(long, value_name = "N", allow_negative_numbers = true, conflicts_with = "cameras", value_parser = clap::value_parser!(u32).range(1..=3600))]
    orbit: Option<u32>,
    /// Target of the circle's cameras, in the scene's coordinates (default: the middle of the
    /// splats)
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    look_at: Option<Place>,
    /// Distance of the circle's cameras from the target (default: the splats fill the image)
    #[arg(long, value_name = "METERS", allow_negative_numbers = true, value_parser = positive)]
    distance: Option<f64>,
    /// Up direction in the images of the circle: x, y, z, -x, -y or -z (default: z for
    /// scenes, -y for splat files, which are mostly trained from COLMAP's coordinates; a .glb is
    /// turned to these when it is read)
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Axis>,
}

/// Three coordinates, written `1,2,-3`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place(DVec3);

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed =
            three_numbers(text, PLACE_MAX).map(|position| Self(DVec3::from_array(position)));
        parsed.ok_or_else(|| format!("expected three numbers like 1.5,0,-2, found {text:?}"))
    }
}

/// An axis with its sign.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Axis(DVec3);

impl FromStr for Axis {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (sign, name) = text
            .strip_prefix('-')
            .map_or((1.0, text), |name| (-1.0, name));
        let axis = [("x", DVec3::X), ("y", DVec3::Y), ("z", DVec3::Z)]
            .into_iter()
            .find(|(known, _)| *known == name);
        axis.map(|(_, axis)| Self(axis * sign))
            .ok_or_else(|| format!("expected x, y, z, -x, -y or -z, found {text:?}"))
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let parsed = text
        .parse()
        .ok()
        .filter(|value: &f64| *value > 0.0 && *value <= 1e9);
    parsed.ok_or_else(|| format!("expected a distance above 0, found {text:?}"))
}

impl OrbitArguments {
    /// True if cameras are requested that the scene does not have.
    pub fn is_asked(&self) -> bool {
        self.orbit.is_some()
    }

    /// The cameras around `splats`, whose coordinates are relative to `origin`, of the scene at
    /// `path`. None where no splat can be seen.
    pub fn cameras(
        &self,
        splats: &SplatCloud,
        origin: DVec3,
        path: &Path,
        size_px: Option<[u32; 2]>,
    ) -> Option<Vec<Camera>> {
        let core = Framing::from_splats(splats, origin)?;
        let target = self.look_at.map_or(core.center, |Place(position)| position);
        let up = self.up.map_or_else(|| usual_up(path), |Axis(axis)| axis);
        let size_px = size_px.unwrap_or(SIZE_PX);
        let distance_m = self.distance.unwrap_or(core.distance_m(size_px));
        let count = self.orbit.unwrap_or(VIEWS);
        let camera = |index: u32| {
            let turn_rad = TAU * f64::from(index) / f64::from(count);
            let away = Framing::direction_above(up, turn_rad);
            let name = format!("orbit_{index:03}");
            let camera = core.camera(name, size_px, away, up)?;
            let world_from_camera = Pose::look_at(target + away * distance_m, target, up)?;
            Some(Camera {
                world_from_camera,
                ..camera
            })
        };
        (0..count).map(camera).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(middle: DVec3, stray: bool) -> SplatCloud {
        let mut means: Vec<[f32; 3]> = Vec::new();
        for step in 0..200 {
            let angle = f64::from(step) * 0.7;
            let position =
                middle + DVec3::new(angle.cos(), angle.sin(), f64::from(step % 21) / 10.0 - 1.0);
            means.push(position.as_vec3().to_array());
        }
        if stray {
            means.push([1e6; 3]);
        }
        let count = means.len();
        SplatCloud {
            means,
            scales: vec![[0.1; 3]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.9; count],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; count],
            sh_rest: vec![],
        }
    }

    fn arguments(words: &[&str]) -> OrbitArguments {
        #[derive(clap::Parser)]
        struct Only {
            #[command(flatten)]
            orbit: OrbitArguments,
            #[arg(long)]
            cameras: Option<String>,
        }
        let parsed = <Only as clap::Parser>::parse_from([&["render"], words].concat());
        assert!(parsed.cameras.is_none());
        parsed.orbit
    }

    #[test]
    fn a_circle_shows_the_whole_core_from_all_sides() {
        let origin = DVec3::new(4.5e6, 0.0, 0.0);
        let splats = ball(DVec3::new(5.0, 6.0, 7.0), true);
        for path in ["a.ply", "a.glb", "a.toml"] {
            let cameras = arguments(&["--orbit", "6"])
                .cameras(&splats, origin, Path::new(path), Some([200, 100]))
                .unwrap();
            assert_eq!(cameras.len(), 6);
            let up = usual_up(Path::new(path));
            for camera in &cameras {
                let to_camera = camera.world_from_camera.inverse();
                for mean in &splats.means[..200] {
                    let seen = to_camera.transform(DVec3::from_array(mean.map(f64::from)) + origin);
                    let (x, y) = (
                        seen.x / seen.z * camera.intrinsics.fx_px + 100.0,
                        seen.y / seen.z * camera.intrinsics.fy_px + 50.0,
                    );
                    assert!(
                        seen.z > 0.0 && (0.0..200.0).contains(&x) && (0.0..100.0).contains(&y),
                        "{path}: {x} {y}"
                    );
                }
                assert!(
                    (camera.world_from_camera.rotation * DVec3::NEG_Y).dot(up) > 0.8,
                    "up is up"
                );
            }
        }
        assert!(
            arguments(&[])
                .cameras(&SplatCloud::default(), origin, Path::new("a.ply"), None)
                .is_none()
        );
    }

    #[test]
    fn target_distance_and_up_are_obeyed() {
        let asked = arguments(&["--look-at", "1,2,-3", "--distance", "9", "--up", "-x"]);
        let cameras = asked
            .cameras(
                &ball(DVec3::ZERO, false),
                DVec3::ZERO,
                Path::new("a.ply"),
                None,
            )
            .unwrap();
        assert_eq!((cameras.len(), cameras[0].intrinsics.width_px), (8, 1280));
        for camera in &cameras {
            let eye = camera.world_from_camera.translation;
            assert!(
                (eye.distance(DVec3::new(1.0, 2.0, -3.0)) - 9.0).abs() < 1e-9 && eye.x < 1.0,
                "{eye}"
            );
        }
        for wrong in ["1,2", "a,b,c", "1,2,1e12", "1,x,2,3"] {
            assert!(wrong.parse::<Place>().is_err());
        }
        assert!("w".parse::<Axis>().is_err() && positive("0").is_err() && positive("inf").is_err());
    }
}
