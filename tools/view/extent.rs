//! Size of a scene for the page: how far its cameras stand and move.

use decouplegs::asset::{LoadedScene, SplatExtent};
use decouplegs::scene::{CapturedViews, SplatScene};
use glam::Vec3;
use serde_json::{Value, json};

/// Center and radius of the box that holds nearly all splats, as JSON; null without a splat. Few
/// far splats, or a sky, do not count.
pub fn facts(scene: &SplatScene) -> Value {
    let Some(extent) = SplatExtent::new(&scene.splats) else {
        return Value::Null;
    };
    let ends = [extent.middle.min, extent.middle.max];
    let [low, high] = ends.map(|end| Vec3::from_array(end).as_dvec3());
    let center = scene.origin + 0.5 * (low + high);
    json!({"center_m": center.to_array(), "radius_m": 0.5 * low.distance(high)})
}

/// True where a scene looks right from the cameras that captured it alone: behind the car nothing
/// may be seen.
pub fn is_captured(loaded: &LoadedScene) -> bool {
    match &loaded.recording.views {
        Some(CapturedViews::Everywhere) => false,
        Some(CapturedViews::From(_)) => true,
        None => loaded.ego.poses().len() > 1,
    }
}
