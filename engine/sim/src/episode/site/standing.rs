//! The ground of a place, and vehicles on it.

use decouplegs_drive::register::grounding::{corners, plane, pose_on};
use decouplegs_scene::{Pose, VehicleSize, VehicleState};
use glam::DVec2;

use super::Site;

impl Site {
    /// A sentence where heights of the ground may be wrong, because splats show the road poorly.
    #[must_use]
    pub fn ground_warning(&self) -> Option<String> {
        self.ground.as_ref()?.quality()?.warning()
    }

    /// Height of the captured ground at `at`, otherwise of the lanes, meters; `None` where there is
    /// neither.
    ///
    /// `near_z_m` is a height nearby, which tells decks apart.
    #[must_use]
    pub fn height_at(&self, at: DVec2, near_z_m: f64) -> Option<f64> {
        let lane_z_m = self.surface.height_at(at, near_z_m);
        let expected_z_m = lane_z_m.unwrap_or(near_z_m);
        let ground = self.ground.as_ref();
        let captured = ground.and_then(|ground| ground.height_at(at, Some(expected_z_m)));
        captured.map(|height| height.z_m).or(lane_z_m)
    }

    /// Pose of a vehicle on the ground: wheels at the height of the captured ground, otherwise of
    /// the lanes.
    ///
    /// `near_z_m` is the height at which it was last, which tells decks apart.
    #[must_use]
    pub fn pose_of(&self, state: &VehicleState, size: &VehicleSize, near_z_m: f64) -> Pose {
        let dims_m = size.to_array();
        let height_at = |local| self.height_at(state.to_world(local), near_z_m);
        let corners = corners(dims_m);
        match plane(&corners, &corners.map(height_at)) {
            Some((plane, _)) => pose_on(&plane, state.position_m, state.yaw_rad, size.height_m),
            None => Pose::from_yaw(
                state.yaw_rad,
                state.position_m.extend(near_z_m + 0.5 * size.height_m),
            ),
        }
    }
}
