//! Views that a scene was captured from.

use glam::DVec3;

use crate::{Camera, Trajectory};

/// Place and direction of one image that a scene was made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CapturedView {
    /// Position of the camera or vehicle, world coordinates, meters.
    pub position_m: DVec3,
    /// Direction of view, world coordinates, a unit vector.
    pub ahead: DVec3,
}

/// Views that a scene was captured from: images of it are good near them, in their directions.
#[derive(Clone, Debug, PartialEq)]
pub enum CapturedViews {
    /// The scene looks right from everywhere, as a synthetic one does.
    Everywhere,
    /// The scene was seen from these views alone.
    From(Vec<CapturedView>),
}

impl CapturedViews {
    /// The views of cameras whose images the scene was trained on.
    #[must_use]
    pub fn from_cameras(cameras: &[Camera]) -> Self {
        let view = |camera: &Camera| CapturedView {
            position_m: camera.world_from_camera.translation,
            ahead: camera.world_from_camera.rotation * DVec3::Z,
        };
        Self::From(cameras.iter().map(view).collect())
    }

    /// The views of a vehicle that recorded the scene on its way; `None` for one that stood still,
    /// which tells nothing.
    #[must_use]
    pub fn from_way(way: &Trajectory) -> Option<Self> {
        let poses = way.poses();
        let view = |pose: &crate::Pose| CapturedView {
            position_m: pose.translation,
            ahead: pose.rotation * DVec3::X,
        };
        let views = poses.iter().map(|timed| view(&timed.pose)).collect();
        (poses.len() > 1).then_some(Self::From(views))
    }
}
