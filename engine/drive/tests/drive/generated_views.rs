//! Generated scenarios of captured places stay where these were seen from.

use std::sync::Arc;

use decouplegs_drive::{Route, ViewSupport};
use decouplegs_scene::scenario::EgoTask;
use decouplegs_scene::{CapturedView, LaneMap, Level};
use glam::{DVec2, DVec3};

use super::generate::street;

/// Views along the way of `task`, `step_m` apart, its length from the start.
fn views_along(map: &LaneMap, task: &EgoTask, step_m: f64, length_m: f64) -> Vec<CapturedView> {
    let route = Route::new(map, task).unwrap();
    let steps = (length_m.min(route.length_m()) / step_m) as u32;
    let view = |step: u32| {
        let (at, yaw_rad) = route.pose_at(f64::from(step) * step_m);
        CapturedView {
            position_m: at + DVec3::Z,
            ahead: DVec2::from_angle(yaw_rad).extend(0.0),
        }
    };
    (0..=steps).map(view).collect()
}

#[test]
fn routes_stay_where_a_place_was_seen_from() {
    let grounds = street();
    let anywhere = grounds.generator().scenario(Level::Medium, 7, 0).unwrap();
    let views = views_along(&grounds.map, &anywhere.ego, 1.1, 55.0);
    let support = Arc::new(ViewSupport::from_views(&views).unwrap());
    let generator = grounds.generator().seen_from(support.clone());
    let mut lengths_m = Vec::new();
    for (level, index) in [Level::Easy, Level::Medium]
        .into_iter()
        .flat_map(|level| (0..12).map(move |index| (level, index)))
    {
        let scenario = generator.scenario(level, 3, index).unwrap();
        let route = Route::new(&grounds.map, &scenario.ego).unwrap();
        let mut along_m = 0.0;
        while along_m < route.length_m() {
            let (at, yaw_rad) = route.pose_at(along_m);
            assert!(
                support.holds(at.truncate(), yaw_rad),
                "{level:?} {index}: {along_m} m along"
            );
            along_m += 1.0;
        }
        lengths_m.push(route.length_m());
    }
    // Not one route, but many: shorter ones than elsewhere, as no more was seen.
    assert!(
        lengths_m
            .iter()
            .all(|length_m| (15.0..65.0).contains(length_m)),
        "{lengths_m:?}"
    );
    lengths_m.dedup();
    assert!(lengths_m.len() > 12, "{lengths_m:?}");
    // The same numbers give other scenarios where all may be driven in.
    assert_ne!(
        generator.scenario(Level::Easy, 3, 0).unwrap().ego,
        grounds.generator().scenario(Level::Easy, 3, 0).unwrap().ego
    );
    // Against the direction of the views nothing was seen.
    let back: Vec<CapturedView> = views
        .iter()
        .map(|view| CapturedView {
            position_m: view.position_m + DVec3::new(1e4, 0.0, 0.0),
            ..*view
        })
        .collect();
    let elsewhere = Arc::new(ViewSupport::from_views(&back).unwrap());
    let why = grounds
        .generator()
        .seen_from(elsewhere)
        .scenario(Level::Easy, 3, 0)
        .unwrap_err();
    assert!(why.to_string().contains("seen_from"), "{why}");
}
