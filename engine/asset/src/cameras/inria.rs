//! INRIA `cameras.json`: what the original 3DGS writes beside a trained model.

use decouplegs_scene::{Camera, Intrinsics, Motion};
use glam::{DMat3, DVec3};
use serde::Deserialize;

use super::{json_error, pose_of};
use crate::DecodeError;

/// One entry. `position` is the camera's center, `rotation` the rows of world from camera; there is
/// no principal point.
#[derive(Deserialize)]
struct Entry {
    #[serde(default)]
    img_name: Option<String>,
    #[serde(default)]
    id: Option<serde_json::Value>,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
}

pub(super) fn decode(bytes: &[u8]) -> Result<Vec<Camera>, DecodeError> {
    let entries: Vec<Entry> = serde_json::from_slice(bytes).map_err(|error| json_error(&error))?;
    entries.into_iter().map(camera).collect()
}

fn camera(entry: Entry) -> Result<Camera, DecodeError> {
    let name = entry
        .img_name
        .or_else(|| entry.id.map(|id| id.to_string()))
        .unwrap_or_default();
    let axes = DMat3::from_cols_array_2d(&entry.rotation).transpose();
    Ok(Camera {
        intrinsics: Intrinsics {
            fy_px: entry.fy,
            ..Intrinsics::centered([entry.width, entry.height], entry.fx)
        },
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
}
