//! INRIA `cameras.json`: what the original 3DGS writes beside a trained model, and what its
//! descendants add: the principal point as `cx` and `cy`, as a matrix `K`, or as shares of the size
//! (`prcp`, `principal_point_ndc`).

use std::collections::BTreeMap;

use decouplegs_scene::{Camera, Intrinsics, Motion};
use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::Value;

use super::{json_error, pose_of};
use crate::DecodeError;
use crate::unknown_keys::UnknownKeys;

/// One entry. `position` is the camera's center, `rotation` the rows of world from camera.
#[derive(Deserialize)]
struct Entry {
    #[serde(default)]
    img_name: Option<Value>,
    #[serde(default)]
    id: Option<Value>,
    width: f64,
    height: f64,
    fx: f64,
    fy: f64,
    cx: Option<f64>,
    cy: Option<f64>,
    #[serde(rename = "K")]
    matrix: Option<[[f64; 3]; 3]>,
    prcp: Option<[f64; 2]>,
    principal_point_ndc: Option<[f64; 2]>,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    #[serde(flatten)]
    others: BTreeMap<String, Value>,
}

/// An object around the list, as some tools write it.
#[derive(Deserialize)]
struct Wrapped {
    cameras: Vec<Entry>,
}

/// Keys that tell nothing about where a camera looks: names, times, and the focal length again.
const HARMLESS: [&str; 22] = [
    "uid",
    "cam_id",
    "camera_id",
    "colmap_id",
    "image_id",
    "image_name",
    "image_path",
    "img_path",
    "file_path",
    "split",
    "timestamp",
    "time",
    "frame",
    "frame_id",
    "FoVx",
    "FoVy",
    "FovX",
    "FovY",
    "fov_x",
    "fov_y",
    "znear",
    "zfar",
];

/// Keys of the camera model.
const MODELS: [&str; 3] = ["model", "camera_model", "camera_type"];

/// Keys of another lens or shutter, refused unless they say that there is none.
const REFUSED: [&str; 20] = [
    "k1",
    "k2",
    "k3",
    "k4",
    "k5",
    "k6",
    "p1",
    "p2",
    "skew",
    "distortion",
    "distortion_params",
    "dist_coeffs",
    "dist",
    "D",
    "is_fisheye",
    "fisheye",
    "equirectangular",
    "panorama",
    "rolling_shutter",
    "scale",
];

pub(super) fn decode(bytes: &[u8]) -> Result<Vec<Camera>, DecodeError> {
    let entries: Vec<Entry> = serde_json::from_slice(bytes).map_err(|error| json_error(&error))?;
    cameras(entries)
}

/// Reads an object with the list as `cameras`; `None` if it is another object.
pub(super) fn decode_wrapped(bytes: &[u8]) -> Option<Result<Vec<Camera>, DecodeError>> {
    let wrapped: Wrapped = serde_json::from_slice(bytes).ok()?;
    Some(cameras(wrapped.cameras))
}

fn cameras(entries: Vec<Entry>) -> Result<Vec<Camera>, DecodeError> {
    let mut unknown = UnknownKeys::default();
    let cameras = entries
        .into_iter()
        .map(|entry| camera(entry, &mut unknown))
        .collect::<Result<_, _>>()?;
    unknown.warn("keys of cameras");
    Ok(cameras)
}

/// True if a value says that there is nothing: null, false, an empty text, zeros.
pub(super) fn is_nothing(value: &Value) -> bool {
    match value {
        Value::Null => true,
        Value::Bool(is_set) => !is_set,
        Value::Number(number) => number.as_f64() == Some(0.0),
        Value::String(text) => text.is_empty(),
        Value::Array(values) => values.iter().all(is_nothing),
        Value::Object(values) => values.values().all(is_nothing),
    }
}

fn camera(entry: Entry, unknown: &mut UnknownKeys) -> Result<Camera, DecodeError> {
    let name = match entry.img_name.filter(|name| !name.is_null()).or(entry.id) {
        Some(Value::String(name)) => name,
        Some(other) => other.to_string(),
        None => String::new(),
    };
    let fault = |reason: String| DecodeError::Malformed(format!("camera '{name}': {reason}"));
    for (key, value) in &entry.others {
        let is_default = is_nothing(value) || key == "scale" && value.as_f64() == Some(1.0);
        let is_pinhole = |value: &Value| {
            let model = value.as_str().unwrap_or_default().to_ascii_uppercase();
            matches!(model.as_str(), "PINHOLE" | "SIMPLE_PINHOLE" | "PERSPECTIVE")
        };
        let is_refused = match key.as_str() {
            key if MODELS.contains(&key) => !is_pinhole(value),
            key => REFUSED.contains(&key) && !is_default,
        };
        if is_refused {
            return Err(DecodeError::Unsupported(format!(
                "camera '{name}': '{key}' is {}: in cameras.json only pinholes are drawn; write a transforms.json or \
                 a COLMAP model with this lens, or undistort first",
                crate::xml::excerpt(&value.to_string())
            )));
        }
        let lists = [&HARMLESS[..], &REFUSED, &MODELS];
        if !lists.iter().any(|list| list.contains(&key.as_str())) {
            unknown.add(key);
        }
    }
    let side = |side_px: f64, key: &str| {
        let is_whole = side_px.fract() == 0.0 && (0.0..=65_536.0).contains(&side_px);
        is_whole.then_some(side_px as u32).ok_or_else(|| {
            fault(format!(
                "{key} = {side_px}; an image has 1 to 65536 whole pixels a side"
            ))
        })
    };
    let size_px = [side(entry.width, "width")?, side(entry.height, "height")?];
    let sides_px = size_px.map(f64::from);
    let mut center_px = sides_px.map(|side_px| 0.5 * side_px);
    let shares = entry.prcp.or(entry.principal_point_ndc);
    if let Some(shares) = shares {
        // Some write it from -1 to 1, whose sign alone tells them apart.
        if shares.iter().any(|share| !(0.0..=1.0).contains(share)) {
            return Err(fault(format!(
                "its principal point {shares:?} is no share of the image from 0 to 1; write it as cx and cy, in pixels"
            )));
        }
        center_px = [shares[0] * sides_px[0], shares[1] * sides_px[1]];
    }
    if let Some([[_, skew, cx], [_, _, cy], _]) = entry.matrix {
        if skew != 0.0 {
            return Err(fault(format!(
                "its matrix K has a skew of {skew}; expected none"
            )));
        }
        center_px = [cx, cy];
    }
    center_px = [
        entry.cx.unwrap_or(center_px[0]),
        entry.cy.unwrap_or(center_px[1]),
    ];
    let axes = DMat3::from_cols_array_2d(&entry.rotation).transpose();
    Ok(Camera {
        intrinsics: Intrinsics::pinhole(size_px, [entry.fx, entry.fy], center_px),
        world_from_camera: pose_of(axes, DVec3::from_array(entry.position), &name)?,
        name,
        motion: Motion::REST,
    })
}

#[cfg(test)]
mod tests {
    use super::super::decode;
    use glam::DVec3;

    const FILE: &str = r#"[{"id": 0, "img_name": "seq/00001.jpg", "width": 800, "height": 600, "position": [1, 2, 3],
        "rotation": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], "fx": 700.5, "fy": 690.0},
        {"id": 1, "width": 4, "height": 2, "position": [0, 0, 0], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 1, "fy": 1}]"#;

    #[test]
    fn position_is_the_center_and_rows_are_world_from_camera() {
        let cameras = decode(FILE.as_bytes(), None).unwrap();
        let camera = &cameras[0];
        assert_eq!(
            (
                camera.name.as_str(),
                camera.intrinsics.cx_px,
                camera.intrinsics.cy_px
            ),
            ("seq_00001", 400.0, 300.0)
        );
        let position = camera.world_from_camera;
        assert!((position.translation - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
        // z forward becomes +x of the world, x right becomes -y, y down becomes -z: a vehicle's
        // front camera.
        assert!((position.rotation * DVec3::Z - DVec3::X).length() < 1e-12);
        assert!((position.rotation * DVec3::X + DVec3::Y).length() < 1e-12);
        assert_eq!(cameras[1].name, "1");
    }

    #[test]
    fn a_bad_camera_is_named() {
        for (from, to, part) in [
            ("[0, 0, 1]", "[0, 0, 2]", "rigid"),
            ("[0, 0, 1]", "[0, 0, -1]", "rigid"),
            ("\"width\": 800", "\"width\": 0", "0x600"),
            ("700.5", "-1", "-1"),
            ("700.5", "1e999", "line"),
        ] {
            let error = decode(FILE.replacen(from, to, 1).as_bytes(), None)
                .unwrap_err()
                .to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn what_descendants_write_is_honored_or_refused() {
        let with = |more: &str| {
            decode(
                FILE.replacen("\"fx\": 700.5", &format!("{more}, \"fx\": 700.5"), 1)
                    .as_bytes(),
                None,
            )
        };
        for more in [
            "\"cx\": 100, \"cy\": 60.0",
            "\"K\": [[700.5, 0, 100], [0, 690, 60], [0, 0, 1]]",
            "\"prcp\": [0.125, 0.1]",
            "\"principal_point_ndc\": [0.125, 0.1], \"k1\": 0.0, \"camera_model\": \"PINHOLE\"",
        ] {
            let lens = with(more).unwrap()[0].intrinsics;
            assert_eq!((lens.cx_px, lens.cy_px), (100.0, 60.0), "{more}");
        }
        for (more, part) in [
            ("\"k1\": 0.1", "'k1' is 0.1"),
            ("\"camera_model\": \"OPENCV_FISHEYE\"", "OPENCV_FISHEYE"),
            ("\"rolling_shutter\": [0, 0, 0.03]", "rolling_shutter"),
            ("\"K\": [[1, 2, 0], [0, 1, 0], [0, 0, 1]]", "skew"),
            ("\"prcp\": [-0.5, 0]", "no share"),
            ("\"cx\": \"100\"", "line"),
        ] {
            let message = with(more).unwrap_err().to_string();
            assert!(message.contains(part), "{more}: {message}");
        }
        let numbers = FILE
            .replace("\"seq/00001.jpg\"", "7")
            .replace("800,", "800.0,");
        let cameras = decode(numbers.as_bytes(), None).unwrap();
        assert_eq!(
            (cameras[0].name.as_str(), cameras[0].intrinsics.width_px),
            ("7", 800)
        );
        let wrapped = format!("\u{feff}{{\"cameras\": {FILE}}}");
        assert_eq!(decode(wrapped.as_bytes(), None).unwrap().len(), 2);
    }
}
