//! Recordings that are scenes of nuScenes.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use decouplegs::asset::SceneLidar;
use decouplegs::asset::cameras::file_safe;
use decouplegs::asset::nuscenes::{AXLE_TO_MIDDLE_M, CAR, NuscenesScene};
use decouplegs::asset::tracks::PoseRow;
use decouplegs::scene::{Camera, Motion, Pose, Rig, RigCamera, TimedPose, Track, VehicleSize};
use glam::{DQuat, DVec3};

use super::recording::Recording;
use super::way_of;

/// Reads the scene called `scene` of the data set in `folder`.
pub fn read(
    folder: &Path,
    scene: Option<&str>,
    vehicle: Option<VehicleSize>,
    middle_m: Option<DVec3>,
    hold_out: Option<usize>,
) -> Result<Recording> {
    let scene = NuscenesScene::read(folder, scene)?;
    let middle_m = middle_m.unwrap_or(AXLE_TO_MIDDLE_M);
    let axle_from_middle = Pose::new(DQuat::IDENTITY, middle_m);
    let middle_from_axle = axle_from_middle.inverse();
    let ego = scene.ego.poses().iter().map(|timed| TimedPose {
        time_s: timed.time_s,
        pose: timed.pose.then(&axle_from_middle),
    });
    let mut cameras: Vec<RigCamera> = Vec::new();
    let (mut views, mut held_out) = (Vec::new(), Vec::new());
    for camera in &scene.cameras {
        cameras.push(RigCamera {
            name: name_of(&camera.channel),
            intrinsics: camera.intrinsics,
            rig_from_camera: middle_from_axle.then(&camera.ego_from_camera),
        });
        let mut keyframes = 0;
        for image in &camera.images {
            let stem = Path::new(&image.file).with_extension("");
            let name = file_safe(&stem.to_string_lossy());
            if image.is_keyframe {
                if hold_out.is_some_and(|every| keyframes % every == every - 1) {
                    held_out.push(name.clone());
                }
                keyframes += 1;
            }
            views.push(Camera {
                name,
                intrinsics: camera.intrinsics,
                world_from_camera: image.world_from_ego.then(&camera.ego_from_camera),
                motion: Motion::REST,
            });
        }
    }
    // The one that looks ahead is the first: planners and viewers begin with it.
    cameras.sort_by_key(|camera| camera.name != "front");
    ensure!(
        hold_out.is_none() || !held_out.is_empty(),
        "--hold-out leaves no image out: the cameras of the scene {} have fewer keyframes",
        scene.name
    );
    let lidar = scene.ego_from_lidar.map(|ego_from_lidar| SceneLidar {
        name: "lidar_top".into(),
        sensor: "hdl32e".into(),
        rig_from_lidar: middle_from_axle.then(&ego_from_lidar).then(&from_ours()),
    });
    let tracks = scene.tracks.iter().map(rows).collect::<Result<Vec<_>>>()?;
    let [x, y, z] = middle_m.to_array();
    Ok(Recording {
        rig: Rig::from_iter(cameras),
        lidars: lidar.into_iter().collect(),
        ego: way_of(ego.collect())?,
        ego_height_m: middle_m.z,
        vehicle: vehicle.unwrap_or(CAR),
        views,
        held_out,
        files: Vec::new(),
        scans: None,
        tracks: tracks.into_iter().flatten().collect(),
        // Its global frame is level.
        level_from_world: DQuat::IDENTITY,
        origin: format!(
            "poses of the rear axle on the ground in the global frame of nuScenes, scene {}; the middle of the vehicle is {x:.2} m ahead, {y:.2} m left, {z:.2} m up from there",
            scene.name
        ),
    })
}

/// Axes of nuScenes' LiDAR (x to the right, y forward) from ours (x forward, y to the left).
fn from_ours() -> Pose {
    Pose::new(
        DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2),
        DVec3::ZERO,
    )
}

/// Name of a camera on the vehicle: `front_left` of `CAM_FRONT_LEFT`.
fn name_of(channel: &str) -> String {
    let name = channel.strip_prefix("CAM_").unwrap_or(channel);
    file_safe(&name.to_lowercase())
}

/// Poses of the middle of a track's boxes.
fn rows(track: &Track) -> Result<Vec<PoseRow>> {
    let row = |point: &decouplegs::scene::TrackPoint| {
        Some(PoseRow {
            id: track.id.clone(),
            class: track.class.clone(),
            time_s: point.time_s,
            position: point.position_m.extend(point.z_m?),
            rotation: DQuat::from_rotation_z(point.yaw_rad?),
            dims_m: track.dims_m,
            note: String::new(),
        })
    };
    let rows: Option<Vec<PoseRow>> = track.points.iter().map(row).collect();
    rows.with_context(|| format!("the track {} has no heights or headings", track.id))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_names_and_axes_are_turned() {
        assert_eq!(name_of("CAM_FRONT_LEFT"), "front_left");
        assert_eq!(name_of("Extra/1"), "extra_1");
        // What is ahead of our LiDAR is along the y axis of theirs.
        let ahead = from_ours().transform(DVec3::X);
        assert!(ahead.abs_diff_eq(DVec3::Y, 1e-12), "{ahead}");
    }
}
