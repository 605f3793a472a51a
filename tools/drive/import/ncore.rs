//! Recordings of NVIDIA NCore.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use decouplegs::asset::SceneLidar;
use decouplegs::asset::ncore::NcoreSequence;
use decouplegs::scene::{Camera, Motion, Pose, Rig, RigCamera, TimedPose, VehicleSize};
use glam::{DQuat, DVec3};

use crate::progress;

use super::recording::{Recording, RecordingFile};
use super::way_of;

/// Middle of a car's box from the origin of NCore's rig, which is on the ground below the rear
/// axle, meters, without its height.
const RIG_TO_MIDDLE_M: [f64; 2] = [1.35, 0.0];
/// Box of a car, meters.
const CAR_M: [f64; 3] = [4.5, 1.8, 1.5];
/// Name of the list of images.
const IMAGES: &str = "images.csv";
/// Folder of the images.
const IMAGE_FOLDER: &str = "images";

/// Reads a sequence.
pub fn read(
    path: &Path,
    vehicle: Option<VehicleSize>,
    middle_m: Option<DVec3>,
    hold_out: Option<usize>,
) -> Result<(Recording, NcoreSequence)> {
    let sequence = NcoreSequence::read(path)?;
    if sequence.cameras.is_empty() {
        bail!(
            "{} has no cameras with poses on the vehicle",
            path.display()
        );
    }
    let vehicle = vehicle.unwrap_or(VehicleSize::from_array(CAR_M));
    let [x, y] = RIG_TO_MIDDLE_M;
    let middle_m = middle_m.unwrap_or(DVec3::new(x, y, 0.5 * vehicle.height_m));
    let rig_from_middle = Pose::new(DQuat::IDENTITY, middle_m);
    let middle_from_rig = rig_from_middle.inverse();
    let cameras = sequence.cameras.iter().map(|own| RigCamera {
        rig_from_camera: middle_from_rig.then(&own.camera.rig_from_camera),
        ..own.camera.clone()
    });
    let ego = sequence.rig.poses().iter().map(|timed| TimedPose {
        pose: timed.pose.then(&rig_from_middle),
        ..*timed
    });
    let mut files = Vec::new();
    let mut lidars = Vec::new();
    for lidar in &sequence.lidars {
        let Some(parameters) = &lidar.parameters else {
            continue;
        };
        let sensor = PathBuf::from(format!("{}.json", lidar.name));
        files.push(RecordingFile {
            path: sensor.clone(),
            content: parameters.clone().into_bytes(),
        });
        lidars.push(SceneLidar {
            name: lidar.name.clone(),
            sensor,
            rig_from_lidar: middle_from_rig.then(&lidar.rig_from_lidar),
        });
    }
    files.push(RecordingFile {
        path: IMAGES.into(),
        content: list_of(&sequence).into_bytes(),
    });
    let recording = Recording {
        lidars,
        ego: way_of(ego.collect())?,
        ego_height_m: middle_m.z,
        vehicle,
        views: views_of(&sequence),
        rig: Rig::from_iter(cameras),
        tracks: sequence.boxes.clone(),
        level_from_world: DQuat::IDENTITY,
        files,
        scans: None,
        held_out: held_out_of(&sequence, hold_out)?,
        origin: format!(
            "NCore's rig, on the ground below the rear axle; the middle of the vehicle is {:.2}, {:.2}, {:.2} m forward, left and up from it",
            middle_m.x, middle_m.y, middle_m.z
        ),
    };
    Ok((recording, sequence))
}

/// Time of an image, the middle of its exposure, seconds.
fn time_s(sequence: &NcoreSequence, [start_us, end_us]: [i64; 2]) -> f64 {
    let from_start_us = |time_us: i64| time_us.saturating_sub(sequence.start_us) as f64;
    0.5e-6 * (from_start_us(start_us) + from_start_us(end_us))
}

/// Name of an image of a camera, by the end of its exposure.
fn name_of(camera: &str, [_, end_us]: [i64; 2]) -> String {
    format!("{camera}_{end_us}")
}

/// Names of every `every`-th image of each camera.
fn held_out_of(sequence: &NcoreSequence, every: Option<usize>) -> Result<Vec<String>> {
    let Some(every) = every else {
        return Ok(Vec::new());
    };
    let mut held_out = Vec::new();
    for own in &sequence.cameras {
        let frames = own.frames_us.iter().skip(every - 1).step_by(every);
        held_out.extend(frames.map(|frame_us| name_of(&own.camera.name, *frame_us)));
    }
    if held_out.is_empty() {
        bail!(
            "--hold-out leaves no image out: the cameras of the sequence have fewer than {every} images"
        );
    }
    Ok(held_out)
}

/// Cameras of all images.
fn views_of(sequence: &NcoreSequence) -> Vec<Camera> {
    let mut views = Vec::new();
    for own in &sequence.cameras {
        let rig_from_camera = &own.camera.rig_from_camera;
        let world_from_camera = |time_s: f64| sequence.rig.at(time_s).then(rig_from_camera);
        for frame_us in &own.frames_us {
            let [start_us, end_us] = *frame_us;
            let [start, end] = [start_us, end_us]
                .map(|time_us| world_from_camera(time_s(sequence, [time_us, time_us])));
            let duration_s = 1e-6 * end_us.saturating_sub(start_us) as f64;
            views.push(Camera {
                name: name_of(&own.camera.name, *frame_us),
                intrinsics: own.camera.intrinsics,
                world_from_camera: world_from_camera(time_s(sequence, *frame_us)),
                motion: match (own.camera.intrinsics.shutter.is_global(), duration_s > 0.0) {
                    (false, true) => Motion::between(&start, &end, duration_s),
                    _ => Motion::REST,
                },
            });
        }
    }
    views
}

/// Camera, time and name of each image: `render --cameras CAMERA --time TIME_S` draws its like.
fn list_of(sequence: &NcoreSequence) -> String {
    let mut list = "camera,time_s,image\n".to_owned();
    for own in &sequence.cameras {
        let name = &own.camera.name;
        for frame_us in &own.frames_us {
            let time_s = time_s(sequence, *frame_us);
            let _ = writeln!(list, "{name},{time_s:.6},{}", name_of(name, *frame_us));
        }
    }
    list
}

/// Writes the images of a sequence into a folder in `out`, as they were encoded.
pub fn write_images(sequence: &NcoreSequence, out: &Path) -> Result<()> {
    let folder = out.join(IMAGE_FOLDER);
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("{} cannot be made", folder.display()))?;
    let images = sequence.cameras.iter().map(|own| own.frames_us.len()).sum();
    let bar = progress::bar("images", images);
    for own in &sequence.cameras {
        for frame_us in &own.frames_us {
            let (bytes, extension) = sequence.image(&own.camera.name, frame_us[1])?;
            let name = name_of(&own.camera.name, *frame_us);
            let path = folder.join(format!("{name}.{extension}"));
            decouplegs::asset::write_atomically(&path, |file| {
                std::io::Write::write_all(file, &bytes)
            })?;
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok(())
}
