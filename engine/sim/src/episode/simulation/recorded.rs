//! Ego that takes the way of a recording.

use decouplegs_scene::{Pose, Trajectory, VehicleState};
use glam::DVec3;

use super::EgoView;

/// Time over which the acceleration of a recorded vehicle is taken, seconds.
const RECORDED_S: f64 = 0.2;

impl EgoView<'_> {
    /// Pose of an ego that follows the recording, `time_s` seconds after its start.
    pub(super) fn recorded_pose(&self, time_s: f64) -> Option<Pose> {
        let way = self.driven().recorded.as_ref()?;
        Some(way.at(way.start_s() + time_s))
    }
}

/// State and yaw rate of a vehicle on `way`, `time_s` seconds after its start. The acceleration is
/// that of the last [`RECORDED_S`].
pub(super) fn recorded_state(way: &Trajectory, time_s: f64) -> (VehicleState, f64) {
    let at_s = way.start_s() + time_s;
    let pose = way.at(at_s);
    let ahead = pose.rotation * DVec3::X;
    let motion = way.motion_at(at_s);
    let speed_mps = |at_s: f64| {
        let ahead = way.at(at_s).rotation * DVec3::X;
        way.motion_at(at_s).velocity_mps.dot(ahead)
    };
    let state = VehicleState {
        position_m: pose.translation.truncate(),
        yaw_rad: ahead.truncate().to_angle(),
        // The ego never reverses, and noise of positions is no drive.
        speed_mps: speed_mps(at_s).max(0.0),
        acceleration_mps2: (speed_mps(at_s) - speed_mps(at_s - RECORDED_S)) / RECORDED_S,
    };
    (state, motion.turn_rad_per_s.z)
}
