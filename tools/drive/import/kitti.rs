//! Recordings of KITTI's raw data.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use decouplegs::asset::kitti_raw::{CAR, IMU_TO_MIDDLE_M, KittiDrive};
use decouplegs::asset::tracks::PoseRow;
use decouplegs::asset::{CameraOptions, SceneLidar, read_cameras};
use decouplegs::scene::{Camera, Motion, Pose, Rig, RigCamera, TimedPose, VehicleSize};
use glam::{DQuat, DVec3};

use super::recording::Recording;
use super::scans::{Scans, Turn};
use super::way_of;

/// Time of a turn of KITTI's LiDAR, seconds.
const SCAN_PERIOD_S: f64 = 0.1034;

/// Classes of KITTI as perception names them.
const CLASSES: [(&str, &str); 7] = [
    ("car", "car"),
    ("van", "car"),
    ("truck", "truck"),
    ("tram", "bus"),
    ("pedestrian", "pedestrian"),
    ("person (sitting)", "pedestrian"),
    ("cyclist", "cyclist"),
];

/// Reads a drive; poses are those of `trained` where it is given.
pub fn read(
    folder: &Path,
    trained: Option<&Path>,
    vehicle: Option<VehicleSize>,
    middle_m: Option<DVec3>,
) -> Result<Recording> {
    let drive = KittiDrive::read(folder)?;
    let middle_m = middle_m.unwrap_or(IMU_TO_MIDDLE_M);
    let vehicle = vehicle.unwrap_or(CAR);
    let imu_from_middle = Pose::new(DQuat::IDENTITY, middle_m);
    let middle_from_imu = imu_from_middle.inverse();
    let mut rig_cameras: Vec<RigCamera> = drive
        .cameras
        .iter()
        .map(|camera| RigCamera {
            name: name(camera.number),
            intrinsics: camera.intrinsics,
            rig_from_camera: middle_from_imu.then(&camera.imu_from_camera),
        })
        .collect();
    let trained = trained.map(trained_poses).transpose()?;
    // World from IMU by frame.
    let mut world_from_imu: Vec<(usize, f64, Pose)> = Vec::new();
    let frames = drive.times_s.iter().copied().enumerate();
    for (frame, time_s) in frames.filter(|(_, time_s)| *time_s >= 0.0) {
        let of_camera = |camera: &decouplegs::asset::kitti_raw::KittiCamera| {
            let pose = trained.as_ref()?.get(&(frame, camera.number))?;
            Some(
                pose.world_from_camera
                    .then(&camera.imu_from_camera.inverse()),
            )
        };
        let pose = match &trained {
            Some(_) => drive.cameras.iter().find_map(of_camera),
            None => (time_s <= drive.imu.end_s()).then(|| drive.imu.at(time_s)),
        };
        world_from_imu.extend(pose.map(|pose| (frame, time_s, pose)));
    }
    if let Some(trained) = &trained {
        ensure!(
            !world_from_imu.is_empty(),
            "none of the {} cameras of --poses is an image of {}: expected names that hold the number of the frame and of the camera, such as 000004_2.png",
            trained.len(),
            folder.display()
        );
        // Principal points and focal lengths are those that the splats were trained with.
        for (own, camera) in rig_cameras.iter_mut().zip(&drive.cameras) {
            let mut same = trained
                .iter()
                .filter(|((_, number), _)| *number == camera.number);
            if let Some((_, of)) = same.next() {
                own.intrinsics = of.intrinsics;
            }
        }
    }
    let by_frame: HashMap<usize, Pose> = world_from_imu
        .iter()
        .map(|(frame, _, pose)| (*frame, *pose))
        .collect();
    let ego = world_from_imu.iter().map(|(_, time_s, pose)| TimedPose {
        time_s: *time_s,
        pose: pose.then(&imu_from_middle),
    });
    Ok(Recording {
        lidars: vec![SceneLidar {
            name: "velodyne".into(),
            sensor: "hdl64e_kitti".into(),
            rig_from_lidar: middle_from_imu.then(&drive.imu_from_lidar),
        }],
        ego: way_of(ego.collect())?,
        ego_height_m: 0.5 * vehicle.height_m,
        vehicle,
        scans: scans_of(&drive, middle_from_imu.then(&drive.imu_from_lidar)),
        views: views_of(&drive, &rig_cameras, &by_frame, trained.as_ref()),
        held_out: Vec::new(),
        rig: Rig::from_iter(rig_cameras),
        tracks: tracks_of(&drive, &by_frame),
        level_from_world: drive.level_from_world,
        files: Vec::new(),
        origin: format!(
            "the IMU of the first frame; the middle of the vehicle is {:.2}, {:.2}, {:.2} m forward, left and up from the IMU",
            middle_m.x, middle_m.y, middle_m.z
        ),
    })
}

/// Scans of a drive, taken by `rig_from_lidar`; `None` where there are none.
fn scans_of(drive: &KittiDrive, rig_from_lidar: Pose) -> Option<Scans> {
    let timed = drive.scans.iter().filter_map(|(frame, path)| {
        let time_s = drive.times_s.get(*frame)?;
        Some((*time_s, path.clone()))
    });
    let files: Vec<(f64, PathBuf)> = timed.collect();
    (!files.is_empty()).then_some(Scans {
        files,
        rig_from_lidar,
        turn: Some(Turn {
            period_s: SCAN_PERIOD_S,
        }),
    })
}

/// Cameras of all images whose frames have a pose: those that splats were trained with, otherwise
/// those of the rig, named as their files in the drive.
fn views_of(
    drive: &KittiDrive,
    rig_cameras: &[RigCamera],
    by_frame: &HashMap<usize, Pose>,
    trained: Option<&HashMap<(usize, u32), Camera>>,
) -> Vec<Camera> {
    let mut views = Vec::new();
    for (camera, own) in drive.cameras.iter().zip(rig_cameras) {
        for image in &camera.images {
            let Some(pose) = by_frame.get(&image.frame) else {
                continue;
            };
            let named = trained.and_then(|trained| trained.get(&(image.frame, camera.number)));
            views.push(named.cloned().unwrap_or_else(|| Camera {
                name: format!("image_{:02}_data_{:010}", camera.number, image.frame),
                intrinsics: own.intrinsics,
                world_from_camera: pose.then(&camera.imu_from_camera),
                motion: Motion::REST,
            }));
        }
    }
    views
}

/// Labeled boxes at the frames that have a pose.
fn tracks_of(drive: &KittiDrive, by_frame: &HashMap<usize, Pose>) -> Vec<PoseRow> {
    let mut tracks = Vec::new();
    for (index, tracklet) in drive.tracklets.iter().enumerate() {
        let [.., height_m] = tracklet.dims_m;
        for (offset, (bottom, yaw_rad)) in tracklet.places.iter().enumerate() {
            let frame = tracklet.first_frame + offset;
            let (Some(pose), Some(&time_s)) = (by_frame.get(&frame), drive.times_s.get(frame))
            else {
                continue;
            };
            let in_lidar = Pose::from_yaw(*yaw_rad, *bottom + DVec3::Z * 0.5 * height_m);
            let at = pose.then(&drive.imu_from_lidar).then(&in_lidar);
            let known = CLASSES.iter().find(|(own, _)| *own == tracklet.class);
            tracks.push(PoseRow {
                id: format!("{}_{index:02}", tracklet.class.replace([' ', '(', ')'], "")),
                class: known.map_or("unknown", |(_, class)| class).into(),
                time_s,
                position: at.translation,
                rotation: at.rotation,
                dims_m: Some(tracklet.dims_m),
                note: String::new(),
            });
        }
    }
    tracks
}

/// Name of a camera on the vehicle.
fn name(number: u32) -> String {
    match number {
        2 => "front".into(),
        3 => "front_right".into(),
        0 => "front_gray".into(),
        _ => format!("front_gray_{number}"),
    }
}

/// Cameras by frame and number, from their names.
fn trained_poses(path: &Path) -> Result<HashMap<(usize, u32), Camera>> {
    let cameras = read_cameras(path, &CameraOptions::default())?;
    let keyed = cameras.into_iter().filter_map(|camera| {
        let key = frame_and_number(&camera.name)?;
        Some((key, camera))
    });
    Ok(keyed.collect())
}

/// Frame and number of the camera in a name: the last two numbers, of which the longer one is the
/// frame. A name with one number is an image of camera 2.
fn frame_and_number(name: &str) -> Option<(usize, u32)> {
    let digits = name
        .split(|c: char| !c.is_ascii_digit())
        .filter(|part| !part.is_empty());
    let parts: Vec<&str> = digits.collect();
    let (frame, number) = match parts.as_slice() {
        [] => return None,
        [frame] => (*frame, "2"),
        [.., a, b] if a.len() >= b.len() => (*a, *b),
        [.., a, b] => (*b, *a),
    };
    Some((frame.parse().ok()?, number.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_frame_and_camera() {
        for (name, key) in [
            ("images_000004_2", Some((4, 2))),
            ("image_02_data_0000000044", Some((44, 2))),
            ("2011_09_26_image_03_0000000001", Some((1, 3))),
            ("000017", Some((17, 2))),
            ("front", None),
        ] {
            assert_eq!(frame_and_number(name), key, "{name}");
        }
    }
}
