//! Small files with each kind of lens, and faults.

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
fn angles_of_either_axis_and_keys_of_other_lenses() {
    let shared = "\"fl_x\": 500, \"fl_y\": 510,";
    let with = |more: &str| decode(FILE.replacen(shared, more, 1).as_bytes(), None);
    // The second frame has a focal length of its own.
    for (more, expected_px) in [
        ("\"x_fov\": 90, \"y_fov\": 90,", (320.0, 240.0)),
        ("\"camera_angle_y\": 1.5707963267948966,", (240.0, 240.0)),
        ("\"fl_y\": 300,", (300.0, 300.0)),
    ] {
        let lens = with(more).unwrap()[0].intrinsics;
        let apart_px = (lens.fx_px - expected_px.0).hypot(lens.fy_px - expected_px.1);
        assert!(apart_px < 1e-9, "{more}: {lens:?}");
    }
    for (more, part) in [
        ("\"is_latlong\": true,", "is_latlong"),
        ("\"fl_x\": 1, \"ftheta_p1\": 120,", "ftheta_p1"),
        (
            "\"fl_x\": 1, \"rolling_shutter\": [0, 0, 0.03, 0],",
            "rolling_shutter",
        ),
        ("", "no focal length"),
    ] {
        let message = with(more).unwrap_err().to_string();
        assert!(message.contains(part), "{more}: {message}");
    }
    assert!(with("\"fl_x\": 9, \"is_latlong\": false, \"rolling_shutter\": [0, 0],").is_ok());
    let fisheye = FILE.replacen("\"camera_model\": \"OPENCV\"", "\"is_fisheye\": true", 1);
    let lens = decode(fisheye.as_bytes(), None).unwrap()[0].intrinsics.lens;
    assert!(matches!(lens, Lens::Fisheye(_)), "{lens:?}");
}

#[test]
fn the_size_of_a_jpeg_is_in_its_header() {
    let mut jpeg = vec![0xff, 0xd8, 0xff, 0xe0, 0, 4, 9, 9, 0xff, 0xc4, 0, 3, 1];
    jpeg.extend([
        0xff, 0xff, 0xc2, 0, 11, 8, 0x01, 0x02, 0x03, 0x04, 1, 1, 0x11, 0,
    ]);
    assert_eq!(super::jpeg_size(&jpeg), Some([0x304, 0x102]));
    for length in 0..jpeg.len() - 4 {
        assert_eq!(super::jpeg_size(&jpeg[..length.min(17)]), None);
    }
    assert_eq!(super::jpeg_size(b"PNG"), None);
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
