//! Recordings that are files of posed images: nerfstudio's and COLMAP's.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use decouplegs::asset::{CameraOptions, read_cameras};
use decouplegs::scene::{Camera, Pose, Rig, RigCamera, TimedPose, VehicleSize};
use glam::{DQuat, DVec3};

use super::recording::Recording;
use super::way_of;

/// Middle of a car's box from a camera behind its windshield, meters.
const CAMERA_TO_MIDDLE_M: DVec3 = DVec3::new(-0.3, 0.0, -0.75);

/// Reads the cameras of `file`. Images with one number in their names were taken at one moment; the
/// camera with most images looks ahead.
pub fn read(
    file: &Path,
    vehicle: Option<VehicleSize>,
    middle_m: Option<DVec3>,
    rate_hz: f64,
) -> Result<Recording> {
    let views = read_cameras(file, &CameraOptions::default())?;
    let groups = by_camera(&views);
    let (front_key, front) = groups
        .iter()
        .max_by(|a, b| a.1.len().cmp(&b.1.len()).then(b.0.cmp(a.0)))
        .context("the file has no cameras")?;
    ensure!(
        front.len() > 1,
        "{}: each image seems to be of another camera; expected names that differ by a number alone, such as front_0001.png",
        file.display()
    );
    let middle_m = middle_m.unwrap_or(CAMERA_TO_MIDDLE_M);
    let vehicle = vehicle.unwrap_or(VehicleSize::CAR);
    // A vehicle whose z axis is the world's, and that heads as the camera looks.
    let headed = |camera: &Camera| {
        let ahead = camera.world_from_camera.rotation * DVec3::Z;
        DQuat::from_rotation_z(ahead.truncate().to_angle())
    };
    let from_camera = |(_, camera): (&usize, &&Camera)| {
        headed(camera).inverse() * camera.world_from_camera.rotation
    };
    let vehicle_from_camera = mean(front.iter().map(from_camera));
    let rig_from_front = Pose::new(vehicle_from_camera, -middle_m);
    let front_from_rig = rig_from_front.inverse();
    let ego_at = |camera: &Camera| camera.world_from_camera.then(&front_from_rig);
    let (first, _) = front.first_key_value().context("the camera has no image")?;
    let ego = front.iter().map(|(frame, camera)| TimedPose {
        time_s: (frame - first) as f64 / rate_hz,
        pose: ego_at(camera),
    });
    let ego = way_of(ego.collect())?;
    let mut rig = vec![RigCamera {
        name: "front".into(),
        intrinsics: front
            .values()
            .next()
            .map(|camera| camera.intrinsics)
            .context("no image")?,
        rig_from_camera: rig_from_front,
    }];
    for (key, images) in groups.iter().filter(|(key, _)| *key != front_key) {
        let on_rig = images.iter().filter_map(|(frame, camera)| {
            let ego = ego_at(front.get(frame)?);
            Some(ego.inverse().then(&camera.world_from_camera))
        });
        let on_rig: Vec<Pose> = on_rig.collect();
        let (Some(camera), false) = (images.values().next(), on_rig.is_empty()) else {
            continue;
        };
        let sum: DVec3 = on_rig.iter().map(|pose| pose.translation).sum();
        rig.push(RigCamera {
            name: key.clone(),
            intrinsics: camera.intrinsics,
            rig_from_camera: Pose::new(
                mean(on_rig.iter().map(|pose| pose.rotation)),
                sum / on_rig.len() as f64,
            ),
        });
    }
    // Cameras of a vehicle are level on the whole.
    let up = front
        .values()
        .map(|camera| camera.world_from_camera.rotation * DVec3::NEG_Y);
    let up = up.sum::<DVec3>().normalize_or(DVec3::Z);
    Ok(Recording {
        rig: Rig::from_iter(rig),
        lidars: Vec::new(),
        scans: None,
        ego,
        ego_height_m: 0.5 * vehicle.height_m,
        vehicle,
        tracks: Vec::new(),
        level_from_world: DQuat::from_rotation_arc(up, DVec3::Z),
        files: Vec::new(),
        origin: format!(
            "camera front ({}); the middle of the vehicle is {:.2}, {:.2}, {:.2} m forward, left and up from it",
            front_key, middle_m.x, middle_m.y, middle_m.z
        ),
        views,
        held_out: Vec::new(),
    })
}

/// Images by camera, and then by the number in their names: the longest one, which counts frames.
fn by_camera(views: &[Camera]) -> BTreeMap<String, BTreeMap<usize, &Camera>> {
    let mut groups: BTreeMap<String, BTreeMap<usize, &Camera>> = BTreeMap::new();
    for camera in views {
        let (key, frame) = split(&camera.name).unwrap_or_else(|| (camera.name.clone(), 0));
        groups.entry(key).or_default().insert(frame, camera);
    }
    groups
}

/// A name without its longest number, and that number.
fn split(name: &str) -> Option<(String, usize)> {
    let mut longest: Option<(usize, usize)> = None;
    let mut start = None;
    for (at, c) in name.char_indices().chain([(name.len(), '.')]) {
        if c.is_ascii_digit() {
            start.get_or_insert(at);
        } else if let Some(from) = start.take() {
            let is_longer = longest.is_none_or(|(a, b)| at - from >= b - a);
            if is_longer {
                longest = Some((from, at));
            }
        }
    }
    let (from, to) = longest?;
    let frame = name[from..to].parse().ok()?;
    let rest = format!("{}_{}", &name[..from], &name[to..]);
    let words = rest.split(['_', '-', ' ']).filter(|word| !word.is_empty());
    let key = words.collect::<Vec<_>>().join("_");
    Some((if key.is_empty() { "images".into() } else { key }, frame))
}

/// The mean of rotations that are near each other.
fn mean(rotations: impl Iterator<Item = DQuat>) -> DQuat {
    let mut sum: Option<DQuat> = None;
    for rotation in rotations {
        sum = Some(match sum {
            None => rotation,
            Some(sum) if sum.dot(rotation) < 0.0 => sum - rotation,
            Some(sum) => sum + rotation,
        });
    }
    sum.map_or(DQuat::IDENTITY, DQuat::normalize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_told_apart_by_camera_and_frame() {
        for (name, key, frame) in [
            ("images_000004_2", "images_2", 4),
            ("front_0017", "front", 17),
            ("0017", "images", 17),
            ("cam1_0003", "cam1", 3),
        ] {
            assert_eq!(split(name), Some((key.into(), frame)), "{name}");
        }
        assert_eq!(split("front"), None);
    }

    #[test]
    fn the_mean_of_a_rotation_and_its_negative_is_the_rotation() {
        let rotation = DQuat::from_rotation_z(1.0);
        let found = mean([rotation, -rotation].into_iter());
        assert!(found.angle_between(rotation) < 1e-12);
    }
}
