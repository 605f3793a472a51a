//! Models as text and binary, their faults, and their folders.

use super::*;

const CAMERAS: &str = "# Camera list\n1 PINHOLE 640 480 500 510 320 240\n7 OPENCV 640 480 500 510 320 240 0.1 0.01 0.001 -0.001\n";
/// A camera at (0, 0, -5) that looks along z, and one at (4, 0, 0) turned by half a turn about
/// y.
const IMAGES: &str = "# Image list\n2 0 0 1 0 4 0 0 7 b dir/b.png\n\n1 1 0 0 0 0 0 5 1 a.jpg\n1.5 2.5 -1 3.0 4.0 12\n";

fn binary() -> (Vec<u8>, Vec<u8>) {
    let mut cameras = 2u64.to_le_bytes().to_vec();
    for (id, model, parameters) in [
        (1u32, 1u32, &[500.0f64, 510.0, 320.0, 240.0][..]),
        (
            7,
            4,
            &[500.0, 510.0, 320.0, 240.0, 0.1, 0.01, 0.001, -0.001],
        ),
    ] {
        cameras.extend([id.to_le_bytes(), model.to_le_bytes()].concat());
        cameras.extend([640u64.to_le_bytes(), 480u64.to_le_bytes()].concat());
        cameras.extend(parameters.iter().flat_map(|number| number.to_le_bytes()));
    }
    let mut images = 2u64.to_le_bytes().to_vec();
    for (id, pose, camera, name, points) in [
        (
            2u32,
            [0.0f64, 0.0, 1.0, 0.0, 4.0, 0.0, 0.0],
            7u32,
            "b dir/b.png\0",
            0u64,
        ),
        (1, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0], 1, "a.jpg\0", 2),
    ] {
        images.extend(id.to_le_bytes());
        images.extend(pose.iter().flat_map(|number| number.to_le_bytes()));
        images.extend(camera.to_le_bytes());
        images.extend(name.bytes());
        images.extend(points.to_le_bytes());
        images.extend(vec![7; (POINT_BYTES * points) as usize]);
    }
    (cameras, images)
}

#[test]
fn text_and_binary_are_the_same_cameras() {
    let text = images_of_text(
        IMAGES.as_bytes(),
        &lenses_of_text(CAMERAS.as_bytes()).unwrap(),
    )
    .unwrap();
    let (cameras, images) = binary();
    assert_eq!(
        images_of_binary(&images, &lenses_of_binary(&cameras).unwrap()).unwrap(),
        text
    );
    assert_eq!(
        [text[0].name.as_str(), text[1].name.as_str()],
        ["a.jpg", "b dir/b.png"]
    );
    let [a, b] = [&text[0], &text[1]];
    assert!((a.world_from_camera.translation - DVec3::new(0.0, 0.0, -5.0)).length() < 1e-12);
    assert!((b.world_from_camera.translation - DVec3::new(4.0, 0.0, 0.0)).length() < 1e-12);
    assert!((b.world_from_camera.rotation * DVec3::Z - DVec3::NEG_Z).length() < 1e-12);
    assert_eq!(
        (a.intrinsics.lens, a.intrinsics.fy_px),
        (Lens::Pinhole, 510.0)
    );
    assert!(
        matches!(b.intrinsics.lens, Lens::OpenCv(lens) if lens.radial[0] == 0.1 && lens.tangential[1] == -0.001)
    );
}

#[test]
fn any_white_space_parts_columns_and_only_cameras_in_use_count() {
    let lenses = |text: &str| lenses_of_text(text.as_bytes()).unwrap();
    let expected = images_of_text(IMAGES.as_bytes(), &lenses(CAMERAS)).unwrap();
    let spaced = IMAGES
        .replace("0 0 5 1 a.jpg", "0\t0  5\t1 \t a.jpg  ")
        .replace("2 0 0 1", "  2\t0  0 1");
    assert_eq!(
        images_of_text(spaced.as_bytes(), &lenses(CAMERAS)).unwrap(),
        expected
    );
    // A lens that is not drawn is a fault of the image that uses it.
    let more = format!("{CAMERAS}8 FOV 640 480 1 1 1 1 1\n9 EQUIRECTANGULAR 640 320 640 320\n");
    assert_eq!(
        images_of_text(IMAGES.as_bytes(), &lenses(&more)).unwrap(),
        expected
    );
    let used = IMAGES.replace("0 0 5 1 a.jpg", "0 0 5 9 a.jpg");
    let message = images_of_text(used.as_bytes(), &lenses(&more))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("a.jpg") && message.contains("EQUIRECTANGULAR"),
        "{message}"
    );
    // In binary files the number tells the model, and so how long it is.
    let (mut cameras, images) = binary();
    cameras[0] = 4;
    for (id, model, count) in [(3u32, 11u32, 16), (4, 14, 3)] {
        cameras.extend([id.to_le_bytes(), model.to_le_bytes()].concat());
        cameras.extend([640u64.to_le_bytes(), 480u64.to_le_bytes()].concat());
        cameras.extend(
            [100.0f64, 320.0, 240.0]
                .iter()
                .flat_map(|number| number.to_le_bytes()),
        );
        cameras.extend(vec![0; 8 * (count - 3)]);
    }
    let lenses = lenses_of_binary(&cameras).unwrap();
    assert_eq!(images_of_binary(&images, &lenses).unwrap(), expected);
    let simple = lenses[&4].as_ref().unwrap();
    assert!(matches!(simple.lens, Lens::Fisheye(lens) if lens.radial == [0.0; 4]));
    assert_eq!(
        (simple.fx_px, simple.fy_px, simple.cx_px),
        (100.0, 100.0, 320.0)
    );
}

#[test]
fn a_dataset_is_found_by_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let message = read_folder(folder.path()).unwrap_err().to_string();
    assert!(
        message.contains("cameras.bin") && message.contains("sparse/0"),
        "{message}"
    );
    let model = folder.path().join("sparse/0");
    std::fs::create_dir_all(&model).unwrap();
    std::fs::write(model.join("cameras.txt"), CAMERAS).unwrap();
    assert!(
        read_folder(folder.path())
            .unwrap_err()
            .to_string()
            .contains("images.txt")
    );
    std::fs::write(model.join("images.txt"), IMAGES).unwrap();
    assert_eq!(read_folder(folder.path()).unwrap().len(), 2);
    assert_eq!(read_folder(&model).unwrap().len(), 2);
    let options = super::super::CameraOptions {
        dataparser: Some(folder.path()),
        ..Default::default()
    };
    assert!(
        super::super::read_cameras(&model, &options)
            .unwrap_err()
            .to_string()
            .contains("this is a folder")
    );
}

#[test]
fn cut_and_wrong_files_are_errors() {
    let (cameras, images) = binary();
    let lenses = lenses_of_binary(&cameras).unwrap();
    for length in 0..cameras.len() {
        assert!(lenses_of_binary(&cameras[..length]).is_err(), "{length}");
    }
    for length in 0..images.len() {
        assert!(
            images_of_binary(&images[..length], &lenses).is_err(),
            "{length}"
        );
    }
    // Other bits are an error, or cameras that stand somewhere.
    let flipped = |bytes: &[u8], bit: usize| {
        let mut bytes = bytes.to_vec();
        bytes[bit / 8] ^= 1 << (bit % 8);
        bytes
    };
    let mut read = 0;
    for bit in 0..8 * cameras.len() {
        // Whether the lenses make images is checked with all cameras.
        read += usize::from(lenses_of_binary(&flipped(&cameras, bit)).is_ok());
    }
    for bit in 0..8 * images.len() {
        for camera in images_of_binary(&flipped(&images, bit), &lenses)
            .into_iter()
            .flatten()
        {
            let Pose {
                translation,
                rotation,
            } = camera.world_from_camera;
            assert!(translation.is_finite(), "bit {bit}: {translation}");
            let length = rotation.length();
            assert!((length - 1.0).abs() < 1e-9, "bit {bit}: {rotation}");
            read += 1;
        }
    }
    assert!(read > 500, "{read}");
    // A claim of points or images allocates nothing.
    let mut lying = images.clone();
    lying[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(images_of_binary(&lying, &lenses).is_err());
    for (from, to, part) in [
        ("PINHOLE 640 480 500", "FOV 640 480 1 500", "not drawn"),
        ("PINHOLE", "CUBE", "unknown"),
        ("510 320 240\n7", "510 320\n7", "4 parameters"),
        ("640 480 500", "640 -1 500", "whole numbers"),
        ("640 480 500", "99999999999 480 500", "pixels a side"),
    ] {
        let read = lenses_of_text(CAMERAS.replacen(from, to, 1).as_bytes());
        let message = match read.and_then(|lenses| images_of_text(IMAGES.as_bytes(), &lenses)) {
            Err(error) => error.to_string(),
            Ok(_) => panic!("{to} is read"),
        };
        assert!(
            message.contains(part) && message.contains("line 2"),
            "{to}: {message}"
        );
    }
    let lenses = lenses_of_text(CAMERAS.as_bytes()).unwrap();
    for (from, to, part) in [
        ("4 0 0 7 b", "4 0 0 9 b", "no camera 9"),
        ("2 0 0 1 0", "2 0 0 0 0", "rigid"),
        ("7 b dir/b.png", "", "IMAGE_ID"),
    ] {
        let message = images_of_text(IMAGES.replacen(from, to, 1).as_bytes(), &lenses)
            .unwrap_err()
            .to_string();
        assert!(message.contains(part), "{to}: {message}");
    }
}
