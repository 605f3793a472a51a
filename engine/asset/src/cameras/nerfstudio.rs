//! nerfstudio (and instant-ngp) `transforms.json`.
//!
//! `transform_matrix` is world from camera with OpenGL axes (x right, y up, z backward); y and z
//! are turned here. Intrinsics stand at the top or in a frame, which wins. `applied_transform` and
//! scale factors are not undone: cameras stay in the coordinates of the file. A scene that
//! nerfstudio trained has other ones, see [`super::dataparser`]. NeRF-synthetic files have an angle
//! of view and no size: it is given, or read from the first image.

use std::path::Path;

use decouplegs_scene::lens::{Fisheye, OpenCv};
use decouplegs_scene::{Camera, Intrinsics, Lens as Distortion, Motion};
use glam::{DMat3, DVec3};
use serde::Deserialize;

use super::dataparser::Applied;
use super::{json_error, pose_of};
use crate::DecodeError;

#[derive(Deserialize)]
struct File {
    frames: Vec<Frame>,
    applied_transform: Option<Vec<[f64; 4]>>,
    applied_scale: Option<f64>,
    #[serde(flatten)]
    shared: Lens,
}

#[derive(Deserialize)]
struct Frame {
    #[serde(default)]
    file_path: String,
    transform_matrix: Vec<[f64; 4]>,
    #[serde(flatten)]
    own: Lens,
}

/// Lens fields at the top of the file and in each frame.
#[derive(Clone, Default, Deserialize)]
struct Lens {
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    camera_model: Option<String>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

impl Lens {
    /// Values of this lens where given, else those of `shared`.
    fn or(&self, shared: &Self) -> Self {
        Self {
            w: self.w.or(shared.w),
            h: self.h.or(shared.h),
            fl_x: self.fl_x.or(shared.fl_x),
            fl_y: self.fl_y.or(shared.fl_y),
            cx: self.cx.or(shared.cx),
            cy: self.cy.or(shared.cy),
            camera_angle_x: self.camera_angle_x.or(shared.camera_angle_x),
            camera_angle_y: self.camera_angle_y.or(shared.camera_angle_y),
            camera_model: self
                .camera_model
                .clone()
                .or_else(|| shared.camera_model.clone()),
            k1: self.k1.or(shared.k1),
            k2: self.k2.or(shared.k2),
            k3: self.k3.or(shared.k3),
            k4: self.k4.or(shared.k4),
            k5: self.k5.or(shared.k5),
            k6: self.k6.or(shared.k6),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
        }
    }

    /// Distortion of the lens. `Err` names a camera model that is none of those that are drawn.
    ///
    /// nerfstudio distorts by k1 to k4 as one polynomial of r2 and undistorts its cameras so;
    /// OpenCV's k4 is another number, the first of a denominator, which files of `FULL_OPENCV`
    /// mean.
    fn lens(&self) -> Result<Distortion, String> {
        let of = |value: Option<f64>| value.unwrap_or(0.0);
        let [k1, k2, k3, k4, k5, k6] =
            [self.k1, self.k2, self.k3, self.k4, self.k5, self.k6].map(of);
        let tangential = [of(self.p1), of(self.p2)];
        match self.camera_model.as_deref() {
            Some("OPENCV_FISHEYE") => {
                let radial = [k1, k2, k3, k4];
                return Ok(Distortion::Fisheye(Fisheye {
                    radial,
                    ..Fisheye::default()
                }));
            }
            Some("FULL_OPENCV") => {}
            None
            | Some(
                "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL"
                | "perspective",
            ) if [k4, k5, k6] == [0.0; 3] => {}
            None
            | Some(
                "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL"
                | "perspective",
            ) => {
                return Err(format!(
                    "distortion k4 = {k4}, k5 = {k5}, k6 = {k6} of a model that has none of these"
                ));
            }
            Some(model) => return Err(format!("camera model {model}")),
        }
        let lens = Distortion::OpenCv(OpenCv {
            radial: [k1, k2, k3, k4, k5, k6],
            tangential,
            ..OpenCv::default()
        });
        Ok(if lens.is_pinhole() {
            Distortion::Pinhole
        } else {
            lens
        })
    }

    fn intrinsics(&self) -> Result<Intrinsics, String> {
        let size = |value: Option<f64>, key: &str| match value {
            Some(value) if value.fract() == 0.0 && (1.0..=65_536.0).contains(&value) => {
                Ok(value as u32)
            }
            Some(value) => Err(format!(
                "{key} = {value}; an image has 1 to 65536 whole pixels a side"
            )),
            None => Err(format!(
                "'{key}' is missing; add the size of the images as 'w' and 'h', or give it with --size"
            )),
        };
        let (width_px, height_px) = (size(self.w, "w")?, size(self.h, "h")?);
        let focal_px = |length: Option<f64>, angle_rad: Option<f64>, side_px: u32| {
            length.or_else(|| {
                angle_rad.map(|angle_rad| 0.5 * f64::from(side_px) / (0.5 * angle_rad).tan())
            })
        };
        let fx_px = focal_px(self.fl_x, self.camera_angle_x, width_px)
            .ok_or("neither 'fl_x' nor 'camera_angle_x' is given")?;
        let fy_px = focal_px(self.fl_y, self.camera_angle_y, height_px).unwrap_or(fx_px);
        let center_px = [
            self.cx.unwrap_or(0.5 * f64::from(width_px)),
            self.cy.unwrap_or(0.5 * f64::from(height_px)),
        ];
        Ok(Intrinsics::pinhole(
            [width_px, height_px],
            [fx_px, fy_px],
            center_px,
        ))
    }
}

/// Reads the cameras. `size_px` is the size of images where neither the top nor the frame has one.
pub(super) fn decode(bytes: &[u8], size_px: Option<[u32; 2]>) -> Result<Vec<Camera>, DecodeError> {
    let File {
        frames, mut shared, ..
    } = serde_json::from_slice(bytes).map_err(|error| json_error(&error))?;
    if let (None, None, Some([width_px, height_px])) = (shared.w, shared.h, size_px) {
        (shared.w, shared.h) = (Some(width_px.into()), Some(height_px.into()));
    }
    frames
        .into_iter()
        .enumerate()
        .map(|(index, frame)| camera(index, frame, &shared))
        .collect()
}

/// Size of the first frame's image, a PNG beside the file in `folder`. None where there is none.
pub(super) fn size_of_first_image(bytes: &[u8], folder: &Path) -> Option<[u32; 2]> {
    let file: File = serde_json::from_slice(bytes).ok()?;
    let named = folder.join(&file.frames.first()?.file_path);
    // NeRF-synthetic leaves the ending out.
    let path = [named.clone(), named.with_extension("png")]
        .into_iter()
        .find(|path| path.is_file())?;
    image::image_dimensions(path).ok().map(<[u32; 2]>::from)
}

/// The motion that was applied to the dataset before its cameras were written.
pub(super) fn applied(bytes: &[u8]) -> Result<Applied, DecodeError> {
    let Ok(file) = serde_json::from_slice::<File>(bytes) else {
        return Ok(Applied::NONE);
    };
    let scale = file.applied_scale.unwrap_or(1.0);
    let Some(rows) = file.applied_transform else {
        return Ok(Applied {
            scale,
            ..Applied::NONE
        });
    };
    let [x, y, z, ..] = rows.as_slice() else {
        return Err(DecodeError::Malformed(format!(
            "applied_transform has {} rows, expected 3",
            rows.len()
        )));
    };
    let column = |axis: usize| DVec3::new(x[axis], y[axis], z[axis]);
    let axes = DMat3::from_cols(column(0), column(1), column(2));
    pose_of(axes, column(3), "applied_transform")?;
    Ok(Applied {
        axes,
        offset: column(3),
        scale,
    })
}

fn camera(index: usize, frame: Frame, shared: &Lens) -> Result<Camera, DecodeError> {
    let name = if frame.file_path.is_empty() {
        format!("frame_{index}")
    } else {
        frame.file_path
    };
    let lens = frame.own.or(shared);
    let distortion = lens.lens().map_err(|reason| {
        DecodeError::Unsupported(format!(
            "camera '{name}': {reason}; drawn are pinholes, OPENCV, FULL_OPENCV and OPENCV_FISHEYE: undistort first (for example \
             with 'colmap image_undistorter') and train and render with the undistorted cameras"
        ))
    })?;
    let intrinsics = lens.intrinsics().map(|plain| Intrinsics {
        lens: distortion,
        ..plain
    });
    let intrinsics = intrinsics
        .map_err(|reason| DecodeError::Malformed(format!("camera '{name}': {reason}")))?;
    let rows = &frame.transform_matrix;
    if !(3..=4).contains(&rows.len()) {
        return Err(DecodeError::Malformed(format!(
            "camera '{name}': transform_matrix has {} rows, expected 4",
            rows.len()
        )));
    }
    let column = |axis: usize| DVec3::new(rows[0][axis], rows[1][axis], rows[2][axis]);
    let axes = DMat3::from_cols(column(0), -column(1), -column(2));
    Ok(Camera {
        intrinsics,
        world_from_camera: pose_of(axes, column(3), &name)?,
        name,
        motion: Motion::REST,
    })
}

#[cfg(test)]
mod tests {
    use super::super::decode;
    use decouplegs_scene::Lens;
    use decouplegs_scene::lens::{Fisheye, OpenCv};
    use glam::DVec3;

    const FILE: &str = r#"{"camera_model": "OPENCV", "w": 640, "h": 480.0, "fl_x": 500, "fl_y": 510, "cx": 321, "cy": 239, "k1": 0.0,
        "frames": [
        {"file_path": "./images/frame_00001.png", "transform_matrix": [[1,0,0,4],[0,1,0,5],[0,0,1,6],[0,0,0,1]]},
        {"file_path": "images/frame_00001.jpg", "fl_x": 250, "k2": 0, "transform_matrix": [[1,0,0,4],[0,1,0,5],[0,0,1,6],[0,0,0,1]]}]}"#;

    #[test]
    fn opengl_axes_become_opencv_axes() {
        let cameras = decode(FILE.as_bytes(), None).unwrap();
        let position = cameras[0].world_from_camera;
        assert!((position.transform(DVec3::ZERO) - DVec3::new(4.0, 5.0, 6.0)).length() < 1e-12);
        assert!((position.rotation * DVec3::X - DVec3::X).length() < 1e-12);
        assert!((position.rotation * DVec3::Y + DVec3::Y).length() < 1e-12);
        assert!(
            (position.rotation * DVec3::Z + DVec3::Z).length() < 1e-12,
            "an OpenGL camera looks along -z"
        );
    }

    #[test]
    fn a_frames_own_intrinsics_win_and_names_are_unique() {
        let cameras = decode(FILE.as_bytes(), None).unwrap();
        let focal_px: Vec<_> = cameras
            .iter()
            .map(|camera| (camera.intrinsics.fx_px, camera.intrinsics.fy_px))
            .collect();
        assert_eq!(focal_px, [(500.0, 510.0), (250.0, 510.0)]);
        assert_eq!(
            [cameras[0].name.as_str(), cameras[1].name.as_str()],
            ["images_frame_00001", "images_frame_00001_2"]
        );
        assert_eq!(
            (cameras[0].intrinsics.cx_px, cameras[0].intrinsics.height_px),
            (321.0, 480)
        );
    }

    #[test]
    fn the_angle_stands_in_for_the_focal_length() {
        let file = FILE.replace(
            "\"fl_x\": 500, \"fl_y\": 510, \"cx\": 321, \"cy\": 239,",
            "\"camera_angle_x\": 1.5707963267948966,",
        );
        let camera = &decode(file.as_bytes(), None).unwrap()[0];
        assert!(
            (camera.intrinsics.fx_px - 320.0).abs() < 1e-9
                && (camera.intrinsics.fy_px - 320.0).abs() < 1e-9
        );
        assert_eq!(
            (camera.intrinsics.cx_px, camera.intrinsics.cy_px),
            (320.0, 240.0)
        );
    }

    #[test]
    fn a_size_that_the_file_has_not_is_given_or_read_from_an_image() {
        let file = FILE.replace("\"w\": 640, \"h\": 480.0, ", "").replace(
            "\"fl_x\": 500, \"fl_y\": 510, \"cx\": 321, \"cy\": 239,",
            "\"camera_angle_x\": 0.8,",
        );
        assert!(
            decode(file.as_bytes(), None)
                .unwrap_err()
                .to_string()
                .contains("--size")
        );
        let camera = &decode(file.as_bytes(), Some([160, 90])).unwrap()[0];
        assert_eq!(
            (camera.intrinsics.width_px, camera.intrinsics.cy_px),
            (160, 45.0)
        );
        assert_eq!(
            decode(FILE.as_bytes(), Some([160, 90])).unwrap()[0]
                .intrinsics
                .width_px,
            640,
            "the file's own size wins"
        );
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("images")).unwrap();
        image::RgbImage::new(12, 7)
            .save(folder.path().join("images/frame_00001.png"))
            .unwrap();
        assert_eq!(
            super::size_of_first_image(file.as_bytes(), folder.path()),
            Some([12, 7])
        );
        assert_eq!(
            super::size_of_first_image(file.as_bytes(), &folder.path().join("images")),
            None
        );
    }

    #[test]
    fn distortion_becomes_a_lens() {
        let decoded =
            |from: &str, to: &str| decode(FILE.replacen(from, to, 1).as_bytes(), None).unwrap();
        assert!(
            decoded("", "")
                .iter()
                .all(|camera| camera.intrinsics.lens == Lens::Pinhole),
            "zeros are none"
        );
        let file = decoded("\"k1\": 0.0", "\"k1\": 0.01, \"p2\": -0.001");
        let expected = OpenCv {
            radial: [0.01, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.0, -0.001],
            ..OpenCv::default()
        };
        assert_eq!(file[0].intrinsics.lens, Lens::OpenCv(expected));
        let file = decoded(
            "\"OPENCV\", \"w\": 640",
            "\"OPENCV_FISHEYE\", \"k4\": 0.002, \"w\": 640",
        );
        let expected = Fisheye {
            radial: [0.0, 0.0, 0.0, 0.002],
            ..Fisheye::default()
        };
        assert_eq!(file[1].intrinsics.lens, Lens::Fisheye(expected));
        let file = decoded(
            "\"OPENCV\", \"w\": 640",
            "\"FULL_OPENCV\", \"k4\": 0.002, \"w\": 640",
        );
        assert!(matches!(file[0].intrinsics.lens, Lens::OpenCv(lens) if lens.radial[3] == 0.002));
    }

    #[test]
    fn distortion_and_missing_sizes_are_refused_with_advice() {
        for (from, to, part) in [
            ("\"k1\": 0.0", "\"k4\": 0.01", "undistort"),
            ("\"k2\": 0", "\"k2\": -200", "folds"),
            ("OPENCV", "FOV", "FOV"),
            ("\"w\": 640,", "", "'w' is missing"),
            ("480.0", "480.5", "whole"),
            ("[[1,0,0,4],[0,1,0,5]", "[[2,0,0,4],[0,2,0,5]", "rigid"),
            (",[0,0,1,6],[0,0,0,1]]", "]", "2 rows"),
        ] {
            let error = decode(FILE.replacen(from, to, 1).as_bytes(), None)
                .unwrap_err()
                .to_string();
            assert!(error.contains(part), "{to}: {error}");
        }
    }
}
