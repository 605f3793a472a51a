//! Shutters and windshields of cameras in scene files; calibration and fog of scenes.

use decouplegs_asset::SceneFile;
use decouplegs_scene::lens::WindshieldDirection;
use decouplegs_scene::{Fog, ShutterDirection};
use glam::DVec2;

/// A scene with one camera, which has `more`.
fn scene_with(more: &str) -> String {
    format!(
        r#"version = 1
background = "street.ply"

[[rig]]
name = "front"
width_px = 160
height_px = 100
fx_px = 120.0
fy_px = 120.0
cx_px = 80.0
cy_px = 50.0
position_m = [0.0, 0.0, 1.5]
look = [1.0, 0.0, 0.0]
{more}
"#
    )
}

#[test]
fn a_camera_has_a_shutter_and_a_windshield() {
    let windshield = "windshield = { direction = \"forward\", horizontal = [0.01, 1.0, 0.0], \
                      vertical = [0.0, 0.02, 0.98] }";
    let shutter = "shutter = { direction = \"right_to_left\", readout_s = 0.02 }";
    let scene = SceneFile::parse(&scene_with(&format!("{shutter}\n{windshield}"))).unwrap();
    let camera = scene.rig.cameras().next().unwrap().intrinsics;
    assert_eq!(camera.shutter.direction(), ShutterDirection::RightToLeft);
    assert!((camera.shutter.readout_s([160, 100]) - 0.02).abs() < 1e-12);
    let bent = camera.windshield.unwrap();
    assert_eq!(bent.direction, WindshieldDirection::Forward);
    // P_h = 0.01 + phi and P_v = 0.02 phi + 0.98 theta.
    let sines = bent.bent_sines(DVec2::new(0.3f64.sin(), 0.2f64.sin()));
    let expected = DVec2::new(0.31f64.sin(), (0.006f64 + 0.196).sin());
    assert!((sines - expected).length() < 1e-12);
    let back = SceneFile::parse(&scene.to_toml().unwrap());
    assert_eq!(back.as_ref(), Ok(&scene));
    // A camera without says nothing of them.
    let plain = SceneFile::parse(&scene_with("")).unwrap();
    let text = plain.to_toml().unwrap();
    assert!(
        !text.contains("shutter") && !text.contains("windshield"),
        "{text}"
    );
}

#[test]
fn what_no_camera_has_is_refused_with_its_value() {
    let shutter = |direction: &str, readout_s: &str| {
        format!("shutter = {{ direction = \"{direction}\", readout_s = {readout_s} }}")
    };
    let windshield = |horizontal: &str, vertical: &str| {
        format!(
            "windshield = {{ direction = \"backward\", horizontal = [{horizontal}], vertical = [{vertical}] }}"
        )
    };
    for (more, field, word) in [
        (shutter("up", "0.03"), "rig[0].shutter", "top_to_bottom"),
        (shutter("top_to_bottom", "30.0"), "rig[0].shutter", "30 s"),
        (shutter("top_to_bottom", "-0.01"), "rig[0].shutter", "-0.01"),
        (shutter("top_to_bottom", "nan"), "rig[0].shutter", "NaN"),
        (
            windshield("0.0, 1.0", "0.0, 0.0, 1.0"),
            "rig[0].windshield",
            "2 coefficients",
        ),
        (
            windshield("0.0, inf, 0.0", "0.0, 0.0, 1.0"),
            "rig[0]",
            "inf",
        ),
        // Both angles are the same: no ray reaches most pixels.
        (
            windshield("0.0, 1.0, 0.0", "0.0, 1.0, 0.0"),
            "rig[0]",
            "no inverse",
        ),
        (
            windshield("0.0, -1.0, 0.0", "0.0, 0.0, 1.0"),
            "rig[0]",
            "no inverse",
        ),
    ] {
        let error = SceneFile::parse(&scene_with(&more))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(field) && error.contains(word),
            "{more}: {error}"
        );
    }
}

#[test]
fn a_scene_has_a_photometry_and_fog() {
    let parsed = |table: &str| {
        let head = "version = 1\nbackground = \"street.ply\"\n";
        SceneFile::parse(&format!("{head}{table}\n"))
    };
    let scene = parsed(
        "[photometry]\nexposure_ev = 1.0\n[fog]\nextinction_per_m = 0.1\ncolor = [0.5, 0.6, 0.7]",
    );
    let scene = scene.unwrap();
    assert_eq!(scene.photometry.exposure_ev, 1.0);
    assert_eq!(scene.fog, Some(Fog::new(0.1, [0.5, 0.6, 0.7])));
    let vignetting = "[photometry]\nvignetting = { center_px = [1.0, 1.0], radius_px = [1.0, 1.0], rgb = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]] }";
    for (table, expected) in [
        (vignetting, "belongs to a camera"),
        (
            "[photometry]\nexposure_ev = 99.0",
            "photometry: exposure_ev is 99",
        ),
        (
            "[fog]\nextinction_per_m = -0.1\ncolor = [0.5, 0.5, 0.5]",
            "fog: extinction_per_m is -0.1",
        ),
        (
            "[fog]\nextinction_per_m = 0.1\ncolor = [inf, 0.5, 0.5]",
            "not finite",
        ),
    ] {
        let message = parsed(table).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}
