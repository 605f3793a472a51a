//! Common form of all recordings.

use std::path::PathBuf;

use decouplegs::asset::SceneLidar;
use decouplegs::asset::tracks::PoseRow;
use decouplegs::scene::{Camera, Pose, Rig, TimedPose, Trajectory, VehicleSize};
use glam::DQuat;

use super::scans::Scans;

/// A file of a new scene.
pub struct RecordingFile {
    /// Path in the folder of the scene.
    pub path: PathBuf,
    pub content: Vec<u8>,
}

/// A recording in the coordinates of its splats.
pub struct Recording {
    /// Cameras on the vehicle.
    pub rig: Rig,
    pub lidars: Vec<SceneLidar>,
    /// Poses of the middle of the vehicle's box.
    pub ego: Trajectory,
    /// Height of the middle above the road, meters.
    pub ego_height_m: f64,
    pub vehicle: VehicleSize,
    /// Cameras of all images.
    pub views: Vec<Camera>,
    /// Scans of the vehicle's LiDAR, where there are some.
    pub scans: Option<Scans>,
    /// Names of the views to hold out of training, where that is asked for.
    pub held_out: Vec<String>,
    /// Labeled boxes.
    pub tracks: Vec<PoseRow>,
    /// Rotation that makes the world's z axis vertical.
    pub level_from_world: DQuat,
    /// Files that the scene names, or that tell of the recording.
    pub files: Vec<RecordingFile>,
    /// Origin of the recorded poses, and where the middle of the vehicle is from there: a phrase.
    pub origin: String,
}

impl Recording {
    /// Turns everything by `pose`.
    pub fn turn(&mut self, pose: &Pose) {
        let turned = self.ego.poses().iter().map(|timed| TimedPose {
            time_s: timed.time_s,
            pose: pose.then(&timed.pose),
        });
        self.ego = Trajectory::new(turned.collect()).expect("the times stay as they are");
        for view in &mut self.views {
            view.world_from_camera = pose.then(&view.world_from_camera);
        }
        for row in &mut self.tracks {
            let at = pose.then(&Pose::new(row.rotation, row.position));
            (row.rotation, row.position) = (at.rotation, at.translation);
        }
        self.level_from_world = DQuat::IDENTITY;
    }
}
