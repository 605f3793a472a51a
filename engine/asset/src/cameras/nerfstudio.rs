//! nerfstudio (and instant-ngp) `transforms.json`.
//!
//! `transform_matrix` is world from camera with OpenGL axes (x right, y up, z backward); y and z
//! are turned here. Intrinsics stand at the top or in a frame, which wins. `applied_transform` and
//! scale factors are not undone: cameras stay in the coordinates of the file. A scene that
//! nerfstudio trained has other ones, see [`super::dataparser`]. NeRF-synthetic files have an angle
//! of view and no size: it is given, or read from the first image. Lenses that nerfstudio does not
//! have are read as [`super::transforms`] writes them.

use std::collections::BTreeMap;
use std::path::Path;

use decouplegs_scene::lens::{Fisheye, OpenCv};
use decouplegs_scene::{Camera, Intrinsics, Lens as Distortion, Motion, RigCamera};
use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::Value;

use super::dataparser::Applied;
use super::inria::is_nothing;
use super::transforms::rig_cameras;
use super::{json_error, pose_of};
use crate::DecodeError;
use crate::unknown_keys::UnknownKeys;

#[derive(Deserialize)]
struct File {
    frames: Vec<Frame>,
    /// Lenses that frames name, see [`super::transforms`].
    rig: Option<Value>,
    applied_transform: Option<Vec<[f64; 4]>>,
    applied_scale: Option<f64>,
    #[serde(flatten)]
    shared: Lens,
    #[serde(flatten)]
    others: BTreeMap<String, Value>,
}

#[derive(Deserialize)]
struct Frame {
    #[serde(default)]
    file_path: String,
    transform_matrix: Vec<[f64; 4]>,
    rig_camera: Option<String>,
    #[serde(default)]
    velocity_mps: [f64; 3],
    #[serde(default)]
    turn_rad_per_s: [f64; 3],
    #[serde(flatten)]
    own: Lens,
    #[serde(flatten)]
    others: BTreeMap<String, Value>,
}

/// Keys of the top and of frames that change no camera here: scales and boxes of a radiance field,
/// which are not undone, names of other files, and the focal length again.
const HARMLESS: [&str; 48] = [
    "aabb",
    "aabb_scale",
    "scale",
    "offset",
    "up",
    "from_na",
    "sharpness",
    "sharpen",
    "white_transparent",
    "black_transparent",
    "mask_color",
    "enable_depth_loading",
    "integer_depth_scale",
    "ply_file_path",
    "orientation_override",
    "auto_scale_poses_override",
    "train_filenames",
    "val_filenames",
    "test_filenames",
    "applied_transform",
    "applied_scale",
    "coordinates",
    "frames",
    "file_path",
    "transform_matrix",
    "mask_path",
    "depth_file_path",
    "depth_path",
    "normal_file_path",
    "semantic_path",
    "timestamp",
    "time",
    "colmap_im_id",
    "camera_id",
    "cam_id",
    "camera_index",
    "frame_index",
    "frame_id",
    "sequence",
    "split",
    "rotation",
    "name",
    "id",
    "url",
    "bounds",
    "near",
    "far",
    "n_images",
];

/// Keys of another lens, shutter or image, refused unless they say that there is none.
const REFUSED: [&str; 15] = [
    "is_latlong",
    "latlong",
    "is_equirectangular",
    "equirectangular",
    "lens",
    "lens_mode",
    "rolling_shutter",
    "rolling_shutter_time",
    "skew",
    "flip_x",
    "flip_y",
    "fisheye_mask_radius",
    "s1",
    "s2",
    "s3",
];

/// Largest component of a camera's motion, meters and radians per second.
const MOTION_MAX: f64 = 1e3;

/// Refuses keys of lens models that are not drawn, and counts unknown keys.
fn check_keys(
    others: &BTreeMap<String, Value>,
    unknown: &mut UnknownKeys,
) -> Result<(), DecodeError> {
    for (key, value) in others {
        let is_refused = REFUSED.contains(&key.as_str()) || key.starts_with("ftheta");
        if is_refused && !is_nothing(value) {
            return Err(DecodeError::Unsupported(format!(
                "'{key}' is {}: this lens or shutter is not drawn from transforms.json; undistort first, or \
                 write the camera as a scene file, which has f-theta lenses and rolling shutters",
                crate::xml::excerpt(&value.to_string())
            )));
        }
        if !is_refused && !HARMLESS.contains(&key.as_str()) {
            unknown.add(key);
        }
    }
    Ok(())
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
    x_fov: Option<f64>,
    y_fov: Option<f64>,
    is_fisheye: Option<bool>,
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
            x_fov: self.x_fov.or(shared.x_fov),
            y_fov: self.y_fov.or(shared.y_fov),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
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
        // instant-ngp names no model, and some write it in lower case.
        let model = self
            .camera_model
            .as_ref()
            .map(|name| name.to_ascii_uppercase());
        let model = match (model.as_deref(), self.is_fisheye) {
            (None | Some("OPENCV" | "PINHOLE"), Some(true)) => Some("OPENCV_FISHEYE"),
            (model, _) => model,
        };
        match model {
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
                | "PERSPECTIVE",
            ) if [k4, k5, k6] == [0.0; 3] => {}
            None
            | Some(
                "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL"
                | "PERSPECTIVE",
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
        // Lengths win over angles in radians, and those over angles in degrees, as in instant-ngp;
        // where one axis has none, pixels are square.
        let focal_px =
            |length: Option<f64>, rad: Option<f64>, degrees: Option<f64>, side_px: u32| {
                let angle_rad = rad.or(degrees.map(f64::to_radians));
                length.or_else(|| {
                    angle_rad.map(|angle_rad| 0.5 * f64::from(side_px) / (0.5 * angle_rad).tan())
                })
            };
        let along_x = focal_px(self.fl_x, self.camera_angle_x, self.x_fov, width_px);
        let along_y = focal_px(self.fl_y, self.camera_angle_y, self.y_fov, height_px);
        let (fx_px, fy_px) = match (along_x, along_y) {
            (Some(fx_px), Some(fy_px)) => (fx_px, fy_px),
            (Some(focal_px), None) | (None, Some(focal_px)) => (focal_px, focal_px),
            (None, None) => {
                return Err(
                    "no focal length is given; expected 'fl_x', 'camera_angle_x' or 'x_fov', or one of y".into(),
                );
            }
        };
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
        frames,
        rig,
        mut shared,
        others,
        ..
    } = serde_json::from_slice(bytes).map_err(|error| json_error(&error))?;
    let mut unknown = UnknownKeys::default();
    check_keys(&others, &mut unknown)?;
    for frame in &frames {
        check_keys(&frame.others, &mut unknown)?;
    }
    unknown.warn("keys of transforms.json");
    if let (None, None, Some([width_px, height_px])) = (shared.w, shared.h, size_px) {
        (shared.w, shared.h) = (Some(width_px.into()), Some(height_px.into()));
    }
    let rig = match rig {
        Some(rig) if frames.iter().any(|frame| frame.rig_camera.is_some()) => rig_cameras(&rig)
            .map_err(|reason| DecodeError::Malformed(format!("its list 'rig': {reason}")))?,
        _ => Vec::new(),
    };
    frames
        .into_iter()
        .enumerate()
        .map(|(index, frame)| camera(index, frame, &shared, &rig))
        .collect()
}

/// Size of the first frame's image, a PNG or JPEG beside the file in `folder`. None where there is
/// none.
pub(super) fn size_of_first_image(bytes: &[u8], folder: &Path) -> Option<[u32; 2]> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let file: File = serde_json::from_slice(bytes).ok()?;
    let named = folder.join(file.frames.first()?.file_path.replace('\\', "/"));
    // NeRF-synthetic leaves the ending out.
    let path = [named.clone(), named.with_extension("png")]
        .into_iter()
        .find(|path| path.is_file())?;
    match image::image_dimensions(&path) {
        Ok(size_px) => Some(size_px.into()),
        Err(_) => jpeg_size(&std::fs::read(path).ok()?),
    }
}

/// Width and height in the header of a JPEG.
fn jpeg_size(bytes: &[u8]) -> Option<[u32; 2]> {
    let mut rest = bytes.strip_prefix(&[0xff, 0xd8])?;
    loop {
        let [0xff, marker, more @ ..] = rest else {
            return None;
        };
        match marker {
            // Fill, and markers without a segment.
            0xff => rest = &rest[1..],
            0x01 | 0xd0..=0xd7 => rest = more,
            // Starts of frames; the others in the range are tables.
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                let [_, _, _, h1, h0, w1, w0, ..] = more else {
                    return None;
                };
                let side = |high: u8, low: u8| u32::from(u16::from_be_bytes([high, low]));
                return Some([side(*w1, *w0), side(*h1, *h0)]);
            }
            _ => {
                let [high, low, ..] = more else {
                    return None;
                };
                rest = more.get(usize::from(u16::from_be_bytes([*high, *low])).max(2)..)?;
            }
        }
    }
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

/// Intrinsics of a frame: those of the camera of `rig` that it names, else its own.
fn intrinsics(
    name: &str,
    frame: &Frame,
    shared: &Lens,
    rig: &[RigCamera],
) -> Result<Intrinsics, DecodeError> {
    if let Some(own) = &frame.rig_camera {
        let found = rig.iter().find(|camera| camera.name == *own);
        let found = found.ok_or_else(|| {
            DecodeError::Malformed(format!(
                "camera '{name}': its rig_camera '{}' is not in the list 'rig', which has {} cameras",
                crate::xml::excerpt(own),
                rig.len()
            ))
        })?;
        return Ok(found.intrinsics);
    }
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
    intrinsics.map_err(|reason| DecodeError::Malformed(format!("camera '{name}': {reason}")))
}

/// Motion of a frame's camera during its readout.
fn motion(name: &str, frame: &Frame) -> Result<Motion, DecodeError> {
    let motion = Motion {
        velocity_mps: DVec3::from_array(frame.velocity_mps),
        turn_rad_per_s: DVec3::from_array(frame.turn_rad_per_s),
    };
    let numbers = [frame.velocity_mps, frame.turn_rad_per_s];
    let most = numbers.as_flattened().iter().map(|x| x.abs());
    match most.fold(0.0, f64::max) <= MOTION_MAX {
        true => Ok(motion),
        false => Err(DecodeError::Malformed(format!(
            "camera '{name}': it moves by {} m/s and {} rad/s; expected at most {MOTION_MAX} of each",
            motion.velocity_mps, motion.turn_rad_per_s
        ))),
    }
}

fn camera(
    index: usize,
    frame: Frame,
    shared: &Lens,
    rig: &[RigCamera],
) -> Result<Camera, DecodeError> {
    let name = if frame.file_path.is_empty() {
        format!("frame_{index}")
    } else {
        frame.file_path.clone()
    };
    let intrinsics = intrinsics(&name, &frame, shared, rig)?;
    let motion = motion(&name, &frame)?;
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
        motion,
    })
}

#[cfg(test)]
mod tests;
