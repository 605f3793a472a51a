//! Cameras as text, in the form of the `[[rig]]` tables of a scene file.

use std::collections::HashSet;

use decouplegs_scene::{Invalid, RigCamera};
use serde::Deserialize;
use toml::{Spanned, Table, Value};

use super::form::{CameraForm, camera_form};
use crate::toml_text::Checker;

/// The table of cameras in a text.
const TABLE: &str = "rig";

#[derive(Deserialize)]
struct RigForm {
    rig: Vec<Spanned<CameraForm>>,
}

/// Reads cameras from text: TOML with `[[rig]]` tables, as a scene file has them, or with the keys
/// of one; or JSON: such a table as an object, an array of them, or an object whose `rig` is that
/// array. Other tables of a scene file are passed over.
///
/// Keys that may be left out, beside those that a scene file may leave out: `name` ("camera", and
/// a number where there are several), `position_m` (the origin), `rotation_wxyz` and `look` (no
/// turn), `cx_px` and `cy_px` (the middle of the image), and `fy_px` (the same as `fx_px`).
///
/// # Errors
/// A sentence that names the key at fault, what was expected and what was found.
pub fn cameras_from_text(text: &str) -> Result<Vec<RigCamera>, Invalid> {
    let mut tables = tables_of(text)?;
    if tables.is_empty() {
        return Err(Invalid::new(
            "no camera: expected at least one [[rig]] table",
        ));
    }
    let count = tables.len();
    for (index, table) in tables.iter_mut().enumerate() {
        let name = if count == 1 {
            "camera".to_owned()
        } else {
            format!("camera_{index}")
        };
        fill(table, name);
    }
    let rig = tables.into_iter().map(Value::Table).collect();
    let document = Table::from_iter([(TABLE.to_owned(), Value::Array(rig))]);
    // One text of all forms, so that all are checked alike. Its lines are not the caller's.
    let text = toml::to_string(&document).map_err(|error| Invalid::new(error.to_string()))?;
    let form: RigForm = toml::from_str(&text).map_err(|error| {
        let key = error.span().and_then(|span| key_at(&text, span.start));
        let message = error.message();
        Invalid::new(key.map_or(message.to_owned(), |key| format!("{key}: {message}")))
    })?;
    let checker = Checker { text: &text };
    let cameras = checker.cameras(&form.rig, &mut HashSet::new());
    cameras.map_err(|error| Invalid::new(format!("{}: {}", error.key, error.reason)))
}

/// The text of `camera` as one JSON object, from which [`cameras_from_text`] makes the same camera.
///
/// # Errors
/// A sentence, where a number is not finite.
pub fn camera_json(camera: &RigCamera) -> Result<String, Invalid> {
    let form = serde_json::to_value(camera_form(camera));
    let text = form.and_then(|form| serde_json::to_string(&form));
    text.map_err(|error| Invalid::new(error.to_string()))
}

/// The tables of cameras in a text.
fn tables_of(text: &str) -> Result<Vec<Table>, Invalid> {
    let is_json = text.trim_start().starts_with(['{', '[']) && !is_toml_table(text);
    let document = if is_json {
        let json: serde_json::Value = serde_json::from_str(text)
            .map_err(|error| Invalid::new(format!("this is no JSON: {error}")))?;
        Value::try_from(json)
            .map_err(|error| Invalid::new(format!("leave out keys without a value: {error}")))?
    } else {
        let table: Table = toml::from_str(text).map_err(|error| {
            let message = error.message();
            Invalid::new(format!("this is neither TOML nor JSON: {message}"))
        })?;
        Value::Table(table)
    };
    let cameras = match document {
        Value::Table(mut table) => match table.remove(TABLE) {
            Some(Value::Array(cameras)) => cameras,
            Some(_) => return Err(Invalid::new("rig: expected an array of cameras")),
            None => vec![Value::Table(table)],
        },
        Value::Array(cameras) => cameras,
        other => {
            let found = other.type_str();
            return Err(Invalid::new(format!("expected a camera, found a {found}")));
        }
    };
    let tables = cameras
        .into_iter()
        .enumerate()
        .map(|(index, camera)| match camera {
            Value::Table(table) => Ok(table),
            other => {
                let found = other.type_str();
                Err(Invalid::new(format!(
                    "rig[{index}]: expected a table of keys, found a {found}"
                )))
            }
        });
    tables.collect()
}

/// True if `text` begins with the header of a table, `[[rig]]` or `[name]`, and not with JSON.
fn is_toml_table(text: &str) -> bool {
    let line = text.trim_start().lines().next().unwrap_or_default();
    let name = line.trim_start_matches('[');
    line.starts_with('[') && name.starts_with(|letter: char| letter.is_ascii_alphabetic())
}

/// Fills in what `table` leaves out.
fn fill(table: &mut Table, name: String) {
    let number = |table: &Table, key: &str| {
        let value = table.get(key)?;
        value
            .as_float()
            .or(value.as_integer().map(|number| number as f64))
    };
    for (center, side) in [("cx_px", "width_px"), ("cy_px", "height_px")] {
        if let (None, Some(side_px)) = (table.get(center), number(table, side)) {
            table.insert(center.to_owned(), Value::Float(0.5 * side_px));
        }
    }
    if let (None, Some(focal)) = (table.get("fy_px"), table.get("fx_px").cloned()) {
        table.insert("fy_px".to_owned(), focal);
    }
    let numbers = |values: &[f64]| Value::Array(values.iter().copied().map(Value::Float).collect());
    table.entry("name").or_insert(Value::String(name));
    table.entry("position_m").or_insert(numbers(&[0.0; 3]));
    if !table.contains_key("look") {
        let none = numbers(&[1.0, 0.0, 0.0, 0.0]);
        table.entry("rotation_wxyz").or_insert(none);
    }
}

/// The key of the line at byte `start` of TOML.
fn key_at(text: &str, start: usize) -> Option<&str> {
    let begin = text.get(..start)?.rfind('\n').map_or(0, |at| at + 1);
    let (key, _) = text.get(begin..)?.lines().next()?.split_once('=')?;
    Some(key.trim())
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::{Intrinsics, Lens, Pose, Shutter, ShutterDirection};
    use glam::DVec3;

    const FISHEYE: &str = r#"{"width_px": 64, "height_px": 48, "fx_px": 30, "position_m": [1, 2, 3], "look": [1, 0, 0],
        "lens": {"model": "opencv-fisheye", "radial": [0.1, -0.02], "max_angle_rad": 1.4},
        "shutter": {"direction": "top_to_bottom", "readout_s": 0.03},
        "photometry": {"exposure_ev": 0.5}}"#;

    #[test]
    fn json_and_toml_in_every_form_are_the_same_camera() {
        let one = cameras_from_text(FISHEYE).unwrap();
        let toml = "width_px = 64\nheight_px = 48\nfx_px = 30.0\nposition_m = [1, 2, 3]\nlook = [1, 0, 0]\n\
                    lens = { model = \"opencv-fisheye\", radial = [0.1, -0.02], max_angle_rad = 1.4 }\n\
                    shutter = { direction = \"top_to_bottom\", readout_s = 0.03 }\n\
                    photometry = { exposure_ev = 0.5 }\n";
        for text in [
            format!("[{FISHEYE}]"),
            format!("{{\"rig\": [{FISHEYE}], \"version\": 1}}"),
            toml.to_owned(),
            format!("# a comment\n[[rig]]\n{toml}"),
            format!("[[rig]]\n{toml}"),
            camera_json(&one[0]).unwrap(),
        ] {
            assert_eq!(cameras_from_text(&text).unwrap(), one, "{text}");
        }
        let camera = &one[0];
        let k = &camera.intrinsics;
        assert_eq!((k.cx_px, k.cy_px, k.fy_px), (32.0, 24.0, 30.0));
        assert!(matches!(k.lens, Lens::Fisheye(_)) && k.photometry.exposure_ev == 0.5);
        assert_eq!(
            k.shutter,
            Shutter::new(ShutterDirection::TopToBottom, 0.03, [64, 48])
        );
        let ahead = camera.rig_from_camera.transform(DVec3::Z);
        assert!((ahead - DVec3::new(2.0, 2.0, 3.0)).length() < 1e-12);
        assert_ne!(
            cameras_from_text(&FISHEYE.replace("1.4", "1.3")).unwrap(),
            one
        );
    }

    #[test]
    fn what_is_left_out_is_a_pinhole_at_the_origin() {
        let text = r#"[{"width_px": 8, "height_px": 6, "fx_px": 9}, {"width_px": 8, "height_px": 6, "fx_px": 9.0}]"#;
        let cameras = cameras_from_text(text).unwrap();
        let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!(names, ["camera_0", "camera_1"]);
        assert_eq!(cameras[0].intrinsics, Intrinsics::centered([8, 6], 9.0));
        assert_eq!(cameras[0].rig_from_camera, Pose::IDENTITY);
    }

    #[test]
    fn faults_name_the_key() {
        let with = |change: &str| {
            let text = FISHEYE.replacen("{", &format!("{{{change}, "), 1);
            cameras_from_text(&text).unwrap_err().to_string()
        };
        for (change, part) in [
            ("\"lense\": 1", "lense"),
            ("\"windshield\": 1", "windshield"),
            ("\"cx_px\": \"left\"", "cx_px"),
            ("\"fy_px\": -1", "fy_px"),
            ("\"name\": \"a/b\"", "name"),
            (
                "\"rotation_wxyz\": [1, 0, 0, 0]",
                "either 'rotation_wxyz' or 'look'",
            ),
            ("\"cy_px\": null", "without a value"),
        ] {
            let said = with(change);
            assert!(said.contains(part), "{change}: {said}");
        }
        for (text, part) in [
            ("", "width_px"),
            ("[]", "no camera"),
            ("[3]", "rig[0]"),
            ("{\"rig\": 3}", "array"),
            ("{", "no JSON"),
            ("hello", "neither TOML nor JSON"),
            ("rig = []", "no camera"),
        ] {
            let said = cameras_from_text(text).unwrap_err().to_string();
            assert!(said.contains(part), "{text}: {said}");
        }
        let lens = FISHEYE.replace("opencv-fisheye", "wide");
        assert!(
            cameras_from_text(&lens)
                .unwrap_err()
                .to_string()
                .contains("f-theta")
        );
        let deep = "[".repeat(100_000);
        assert!(cameras_from_text(&deep).is_err());
    }
}
