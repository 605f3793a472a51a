//! `transforms.json` as it is written: nerfstudio's form, and lenses that it does not have.
//!
//! Frames of pinholes are nerfstudio's alone. Other lenses, windshields and rolling shutters stand
//! once in the list `rig`, in the form of a scene file's `[[rig]]`; frames name theirs as
//! `rig_camera`, and have the motion of the camera as `velocity_mps` (world) and `turn_rad_per_s`
//! (camera). A frame that OpenCV's models describe has these too, for other readers; another one
//! has a `camera_model` that they refuse.

use decouplegs_scene::{Camera, Intrinsics, Invalid, Lens, Motion, Pose, RigCamera};
use glam::DVec3;
use serde_json::{Map, Value, json};

use crate::{camera_json, cameras_from_text};

/// Model of frames whose lens is in `rig` alone.
const MODEL_OF_RIG: &str = "RIG_CAMERA";

/// `transforms.json` of `cameras`: world from camera in OpenGL axes (x right, y up, z back),
/// intrinsics for each frame. Read back, the cameras are the same.
///
/// # Errors
/// A sentence, where a number is not finite.
pub fn transforms(cameras: &[Camera]) -> Result<Value, Invalid> {
    let (mut lenses, mut frames): (Vec<Intrinsics>, Vec<Value>) = (Vec::new(), Vec::new());
    for camera in cameras {
        let mut frame = pinhole_frame(camera);
        if is_more_than_pinhole(&camera.intrinsics) {
            let known = lenses.iter().position(|own| *own == camera.intrinsics);
            let index = known.unwrap_or(lenses.len());
            if known.is_none() {
                lenses.push(camera.intrinsics);
            }
            frame.insert("rig_camera".into(), name_of(index).into());
            frame.extend(opencv_keys(&camera.intrinsics));
        }
        if camera.motion != Motion::REST {
            let Motion {
                velocity_mps,
                turn_rad_per_s,
            } = camera.motion;
            frame.insert("velocity_mps".into(), json!(velocity_mps.to_array()));
            frame.insert("turn_rad_per_s".into(), json!(turn_rad_per_s.to_array()));
        }
        frames.push(frame.into());
    }
    let mut file = json!({ "camera_model": "OPENCV", "frames": frames });
    if !lenses.is_empty() {
        let rig = lenses.iter().enumerate().map(|(index, intrinsics)| {
            let camera = RigCamera {
                name: name_of(index),
                intrinsics: *intrinsics,
                rig_from_camera: Pose::IDENTITY,
            };
            serde_json::from_str::<Value>(&camera_json(&camera)?)
                .map_err(|error| Invalid::new(error.to_string()))
        });
        file["rig"] = rig.collect::<Result<Vec<_>, _>>()?.into();
    }
    Ok(file)
}

fn name_of(index: usize) -> String {
    format!("lens_{index}")
}

fn is_more_than_pinhole(intrinsics: &Intrinsics) -> bool {
    let plain = Intrinsics::pinhole(
        [intrinsics.width_px, intrinsics.height_px],
        [intrinsics.fx_px, intrinsics.fy_px],
        [intrinsics.cx_px, intrinsics.cy_px],
    );
    *intrinsics != plain
}

fn pinhole_frame(camera: &Camera) -> Map<String, Value> {
    let Pose {
        rotation,
        translation,
    } = camera.world_from_camera;
    let axes = [DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z].map(|axis| rotation * axis);
    let row = |axis: usize| {
        json!([
            axes[0][axis],
            axes[1][axis],
            axes[2][axis],
            translation[axis]
        ])
    };
    let lens = &camera.intrinsics;
    Map::from_iter([
        (
            "file_path".to_owned(),
            format!("{}.png", camera.name).into(),
        ),
        ("w".to_owned(), lens.width_px.into()),
        ("h".to_owned(), lens.height_px.into()),
        ("fl_x".to_owned(), lens.fx_px.into()),
        ("fl_y".to_owned(), lens.fy_px.into()),
        ("cx".to_owned(), lens.cx_px.into()),
        ("cy".to_owned(), lens.cy_px.into()),
        (
            "transform_matrix".to_owned(),
            json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]),
        ),
    ])
}

/// Model and distortion of a lens as nerfstudio names them, for other readers.
fn opencv_keys(intrinsics: &Intrinsics) -> Vec<(String, Value)> {
    let (model, radial, tangential) = match intrinsics.lens {
        _ if intrinsics.windshield.is_some() => (MODEL_OF_RIG, [0.0; 6], [0.0; 2]),
        Lens::Pinhole => ("OPENCV", [0.0; 6], [0.0; 2]),
        Lens::Fisheye(lens) => {
            let [k1, k2, k3, k4] = lens.radial;
            ("OPENCV_FISHEYE", [k1, k2, k3, k4, 0.0, 0.0], [0.0; 2])
        }
        Lens::OpenCv(lens) if lens.thin_prism == [0.0; 4] => {
            let is_short = lens.radial[3..] == [0.0; 3];
            let model = if is_short { "OPENCV" } else { "FULL_OPENCV" };
            (model, lens.radial, lens.tangential)
        }
        Lens::OpenCv(_) | Lens::FTheta(_) => (MODEL_OF_RIG, [0.0; 6], [0.0; 2]),
    };
    let named = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];
    let numbers = radial.into_iter().chain(tangential);
    let given = named.into_iter().zip(numbers).filter(|(_, x)| *x != 0.0);
    let mut keys: Vec<(String, Value)> = given
        .map(|(name, number)| (name.to_owned(), number.into()))
        .collect();
    keys.push(("camera_model".into(), model.into()));
    keys
}

/// Cameras of the list `rig`, whose names frames have.
pub(super) fn rig_cameras(rig: &Value) -> Result<Vec<RigCamera>, Invalid> {
    cameras_from_text(&json!({ "rig": rig }).to_string())
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::lens::{
        FTheta, FThetaReference, Fisheye, OpenCv, Windshield, WindshieldDirection,
    };
    use decouplegs_scene::{Shutter, ShutterDirection};
    use glam::DQuat;

    use super::super::decode;
    use super::*;

    fn camera(name: &str, intrinsics: Intrinsics) -> Camera {
        Camera {
            name: name.into(),
            intrinsics,
            world_from_camera: Pose::new(
                DQuat::from_xyzw(0.1, -0.7, 0.3, 0.5),
                DVec3::new(1.0, -2.5, 4.5e6),
            ),
            motion: Motion::REST,
        }
    }

    /// A pinhole, OpenCV's lenses, and f-theta behind a windshield with a rolling shutter.
    fn cameras() -> Vec<Camera> {
        let plain = Intrinsics {
            cx_px: 310.5,
            ..Intrinsics::from_horizontal_fov(640, 360, 1.1)
        };
        let with = |lens: Lens| Intrinsics { lens, ..plain };
        let mut windshield = Windshield::straight();
        windshield.horizontal[0] = [0.003, 1.01, -0.004, 0.005, 0.0, -0.002];
        windshield.direction = WindshieldDirection::Backward;
        let ftheta = FTheta {
            reference: FThetaReference::AngleToPixelDistance,
            pixel_distance_to_angle: [0.0, 0.0018, 1e-9, 0.0, 0.0, 0.0],
            angle_to_pixel_distance: [0.0, 555.0, 4.0, -3.0, 0.5, 0.0],
            max_angle_rad: 1.2,
            linear_cde: [1.01, 0.002, -0.003],
        };
        let rolling = Intrinsics {
            windshield: Some(windshield),
            shutter: Shutter::new(ShutterDirection::TopToBottom, 0.03, [640, 360]),
            ..with(Lens::FTheta(ftheta))
        };
        let moving = Motion {
            velocity_mps: DVec3::new(9.0, -1.0, 0.1),
            turn_rad_per_s: DVec3::new(0.0, 0.3, 0.01),
        };
        let prism = OpenCv {
            radial: [0.1, -0.05, 0.01, 0.02, 0.01, -0.003],
            tangential: [0.001, -0.002],
            thin_prism: [0.001, -0.0005, 0.0007, 0.0003],
        };
        let fisheye = Fisheye {
            radial: [0.05, -0.02, 0.01, -0.004],
            max_angle_rad: 1.2,
        };
        vec![
            camera("plain", plain),
            camera("fisheye", with(Lens::Fisheye(fisheye))),
            camera("prism", with(Lens::OpenCv(prism))),
            Camera {
                motion: moving,
                ..camera("wide_1", rolling)
            },
            camera("wide_2", rolling),
        ]
    }

    #[test]
    fn cameras_that_are_written_are_read_back() {
        let written = cameras();
        let file = transforms(&written).unwrap();
        let read = decode(file.to_string().as_bytes(), None).unwrap();
        assert_eq!(read.len(), written.len());
        for (read, written) in read.iter().zip(&written) {
            assert_eq!(read.name, written.name);
            assert_eq!(read.intrinsics, written.intrinsics);
            assert_eq!(read.motion, written.motion);
            let [read, written] = [read, written].map(|camera| camera.world_from_camera);
            assert_eq!(read.translation, written.translation);
            assert!(read.rotation.dot(written.rotation).abs() > 1.0 - 1e-12);
        }
        // A lens that several frames have stands once, and a pinhole not at all.
        assert_eq!(file["rig"].as_array().unwrap().len(), 3);
        let models = file["frames"].as_array().unwrap().iter();
        let models: Vec<_> = models.map(|frame| frame["camera_model"].as_str()).collect();
        let (fisheye, own) = (Some("OPENCV_FISHEYE"), Some("RIG_CAMERA"));
        assert_eq!(models, [None, fisheye, own, own, own]);
    }

    #[test]
    fn pinholes_alone_are_nerfstudios_form() {
        let file = transforms(&cameras()[..1]).unwrap();
        let mut keys: Vec<_> = file["frames"][0].as_object().unwrap().keys().collect();
        keys.sort();
        let expected = "cx cy file_path fl_x fl_y h transform_matrix w";
        assert!(keys.iter().map(|key| key.as_str()).eq(expected.split(' ')));
        assert!(file.get("rig").is_none());
    }

    #[test]
    fn a_frame_without_its_lens_is_refused() {
        let good = transforms(&cameras()).unwrap();
        let refused = |file: &Value| {
            let error = decode(file.to_string().as_bytes(), None).unwrap_err();
            error.to_string()
        };
        let mut file = good.clone();
        file["rig"].as_array_mut().unwrap().pop();
        assert!(refused(&file).contains("'lens_2'"), "{}", refused(&file));
        file.as_object_mut().unwrap().remove("rig");
        assert!(refused(&file).contains("'rig'"), "{}", refused(&file));
        let mut file = good.clone();
        file["rig"][2]["lens"]["model"] = "f-gamma".into();
        assert!(refused(&file).contains("rig"), "{}", refused(&file));
        let mut file = good;
        file["frames"][3]["velocity_mps"] = json!([1e300, 0, 0]);
        assert!(refused(&file).contains("wide_1"), "{}", refused(&file));
    }
}
