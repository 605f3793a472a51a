//! Drives of KITTI's raw data: a small one that is made here, and what is no such drive.

use std::fs;
use std::path::Path;

use decouplegs_asset::kitti_raw::{
    KittiDrive, decode_calibration, decode_packet, decode_times, decode_tracklets,
};
use decouplegs_scene::explain::explain;
use glam::{DQuat, DVec3};
use proptest::prelude::*;

/// Axes of a camera in those of the LiDAR: x to the right, y down, z ahead.
const VELO_TO_CAM: &str =
    "calib_time: 15-Mar-2012 11:37:16\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.27\n";
const IMU_TO_VELO: &str = "R: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.8\n";
const CAM_TO_CAM: &str = "S_rect_02: 1242 375\nR_rect_00: 1 0 0 0 1 0 0 0 1\n\
    P_rect_02: 700 0 600 42 0 700 170 0 0 0 1 0\n\
    S_rect_03: 1242 375\nP_rect_03: 700 0 600 -333.9 0 700 170 0 0 0 1 0\n";
const LABELS: &str = "<?xml version=\"1.0\" ?>\n<!DOCTYPE boost_serialization>\n<boost_serialization><tracklets>\
    <count>1</count><item><objectType>Car</objectType><h>1.5</h><w>1.7</w><l>4.2</l><first_frame>1</first_frame>\
    <poses><count>1</count><item><tx>10</tx><ty>-2</ty><tz>-1.7</tz><rx>0</rx><ry>0</ry><rz>0.5</rz></item></poses>\
    </item></tracklets></boost_serialization>";

/// Writes a drive of three frames to the east at 10 m/s, its car rolled by 0.05 rad.
fn write_drive(root: &Path) -> std::path::PathBuf {
    let drive = root.join("day/drive_sync");
    for (name, text) in [
        ("calib_velo_to_cam.txt", VELO_TO_CAM),
        ("calib_imu_to_velo.txt", IMU_TO_VELO),
        ("calib_cam_to_cam.txt", CAM_TO_CAM),
    ] {
        fs::create_dir_all(&drive).unwrap();
        fs::write(root.join("day").join(name), text).unwrap();
    }
    for folder in ["image_02/data", "image_03/data", "oxts/data"] {
        fs::create_dir_all(drive.join(folder)).unwrap();
    }
    // A degree of longitude at 49 degrees north.
    let degree_m = 49.0_f64.to_radians().cos() * 6_378_137.0 * 1.0_f64.to_radians();
    for frame in 0..4 {
        let east_m = f64::from(frame);
        let packet = format!("49.0 {:.13} 112.5 0.05 0 0 1 2 3", 8.4 + east_m / degree_m);
        fs::write(drive.join(format!("oxts/data/{frame:010}.txt")), packet).unwrap();
        // The first frame has no image.
        if frame > 0 {
            for camera in [2, 3] {
                let image = format!("image_0{camera}/data/{frame:010}.png");
                fs::write(drive.join(image), b"png").unwrap();
            }
        }
    }
    let times = "2011-09-26 23:59:59.800000000\n2011-09-26 23:59:59.900000000\n2011-09-27 00:00:00.000000000\n2011-09-27 00:00:00.100000000\n";
    fs::write(drive.join("image_02/timestamps.txt"), times).unwrap();
    fs::write(drive.join("tracklet_labels.xml"), LABELS).unwrap();
    drive
}

#[test]
fn a_drive_is_read() {
    let root = tempfile::tempdir().unwrap();
    let drive = KittiDrive::read(&write_drive(root.path())).unwrap();
    // Frames 1 to 3 have images; midnight is passed.
    let poses = drive.imu.poses();
    assert_eq!(poses.len(), 3);
    assert!(poses[0].time_s.abs() < 1e-9 && (poses[2].time_s - 0.2).abs() < 1e-9);
    // The world is the first IMU's frame, which is rolled: the way is along x all the same.
    let end = poses[2].pose.translation;
    assert!(end.abs_diff_eq(DVec3::new(2.0, 0.0, 0.0), 1e-4), "{end}");
    let up = drive.level_from_world * (DQuat::from_rotation_x(-0.05) * DVec3::Z);
    assert!(up.abs_diff_eq(DVec3::Z, 1e-9), "{up}");
    assert_eq!(drive.cameras.len(), 2);
    let left = &drive.cameras[0];
    assert_eq!(
        (left.number, left.images.len(), left.images[0].frame),
        (2, 3, 1)
    );
    assert!((left.intrinsics.cx_px - 600.5).abs() < 1e-12);
    // 0.27 m behind the LiDAR and 0.08 m below camera 0, whose right neighbor is 0.54 m away.
    let place = left.imu_from_camera.translation;
    assert!(
        place.abs_diff_eq(DVec3::new(1.08, -0.26, 0.72), 1e-9),
        "{place}"
    );
    let ahead = left.imu_from_camera.rotation * DVec3::Z;
    assert!(ahead.abs_diff_eq(DVec3::X, 1e-12));
    let right = drive.cameras[1].imu_from_camera.translation;
    assert!((place.y - right.y - 375.9 / 700.0).abs() < 1e-9);
    let label = &drive.tracklets[0];
    assert_eq!((label.class.as_str(), label.first_frame), ("car", 1));
    assert_eq!(label.places, [(DVec3::new(10.0, -2.0, -1.7), 0.5)]);
}

#[test]
fn what_a_drive_lacks_is_said() {
    let root = tempfile::tempdir().unwrap();
    let drive = write_drive(root.path());
    let why = |drive: &Path| explain(&KittiDrive::read(drive).unwrap_err());
    let lose = |name: &str, part: &str| {
        let path = drive.join(name);
        let kept = path.with_extension("kept");
        fs::rename(&path, &kept).unwrap();
        let error = why(&drive);
        assert!(error.contains(part), "{name}: {error}");
        fs::rename(&kept, &path).unwrap();
    };
    lose("../calib_velo_to_cam.txt", "calib_velo_to_cam.txt");
    lose("image_02/timestamps.txt", "timestamps.txt");
    lose("oxts", "oxts");
    for camera in ["image_02", "image_03"] {
        fs::remove_dir_all(drive.join(camera).join("data")).unwrap();
    }
    assert!(why(&drive).contains("image_02/data"));
}

#[test]
fn broken_tables_are_refused() {
    for (text, part) in [
        ("2011-09-26 13:08:24.9\n2011-09-26 13:08:24.9\n", "line 2"),
        ("yesterday", "line 1"),
        ("2011-09-26 25:08:24.9", "line 1"),
    ] {
        let error = decode_times(text.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
    }
    for text in [
        "",
        "49 8 112 0 0",
        "49 8 112 0 0 nan",
        "90 8 112 0 0 0",
        "x",
    ] {
        assert!(decode_packet(text.as_bytes()).is_err(), "{text}");
    }
    let calibration = |cameras: &str| {
        decode_calibration(
            IMU_TO_VELO.as_bytes(),
            VELO_TO_CAM.as_bytes(),
            cameras.as_bytes(),
        )
        .unwrap()
        .camera(2)
        .map_err(|error| error.to_string())
    };
    assert!(calibration("").unwrap_err().contains("P_rect_02"));
    let short = CAM_TO_CAM.replace("1242 375", "1242");
    assert!(
        calibration(&short)
            .unwrap_err()
            .contains("S_rect_02 has 1 numbers")
    );
    let flat = CAM_TO_CAM.replace("P_rect_02: 700", "P_rect_02: 0");
    assert!(calibration(&flat).unwrap_err().contains("P_rect_02"));
    for (from, to, part) in [
        ("<l>4.2</l>", "<l>-4.2</l>", "a box of"),
        ("<first_frame>1", "<first_frame>-1", "first_frame"),
        ("<tx>10", "<tx>1e300", "no LiDAR"),
        (
            "<!DOCTYPE boost_serialization>",
            "<!DOCTYPE a [<!ENTITY b \"c\">]>",
            "XML",
        ),
    ] {
        let error = decode_tracklets(LABELS.replace(from, to).as_bytes()).unwrap_err();
        assert!(error.to_string().contains(part), "{to}: {error}");
    }
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = decode_times(&bytes);
        let _ = decode_packet(&bytes);
        let _ = decode_tracklets(&bytes);
        if let Ok(calibration) = decode_calibration(&bytes, &bytes, &bytes) {
            let _ = calibration.camera(2);
        }
    }

    #[test]
    fn any_numbers_make_a_camera_or_none(numbers in prop::collection::vec(any::<f64>(), 12)) {
        let line = numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let text = CAM_TO_CAM.replace("700 0 600 42 0 700 170 0 0 0 1 0", &line);
        let read = decode_calibration(IMU_TO_VELO.as_bytes(), VELO_TO_CAM.as_bytes(), text.as_bytes());
        if let Ok((intrinsics, pose)) = read.unwrap().camera(2) {
            prop_assert!(intrinsics.fx_px > 0.0);
            let _ = pose;
        }
    }
}
