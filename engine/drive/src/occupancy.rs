//! Obstacles of a captured background: cells beside the lanes that splats fill at the height of a
//! vehicle.

use std::collections::HashMap;

use decouplegs_scene::{LaneKind, LaneMap, Obstacle, ObstacleKind, SplatCloud};
use glam::{DVec2, DVec3};

use crate::ground::Ground;
use crate::road_surface::RoadSurface;

/// Side of a cell, meters.
const CELL_M: f64 = 1.0;
/// Largest distance of cells that count from the centerline of a lane, meters.
const BESIDE_M: f64 = 15.0;
/// Heights above the ground at which splats count, meters: above kerbs and grass, below crowns and
/// signs.
const HEIGHTS_M: std::ops::Range<f64> = 0.4..1.9;
/// Heights above the nearest lane outside of which no splat is examined, meters.
const LOOK_UP_M: std::ops::Range<f64> = -2.0..4.0;
/// Least opacity of a splat that counts; fainter ones are haze.
const OPACITY_MIN: f32 = 0.3;
/// Largest scale of a splat that counts, meters; larger ones are backdrops.
const SCALE_M_MAX: f32 = 1.0;
/// Sum of opacities from which a cell is filled: one or two splats are floaters.
const FILLED: f32 = 3.0;

/// Contents of a cell.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Distance from the nearest centerline, and its height there.
    lane: (f64, f64),
    /// Height of the ground, looked up when a splat is near it.
    ground_z_m: Option<f64>,
    mass: f32,
    low_m: DVec2,
    high_m: DVec2,
}

/// Obstacles that the background `cloud`, whose means are relative to `origin`, has beside the
/// lanes of `map`. Cells on driving lanes are none: what the capture shows there has driven away.
#[must_use]
pub fn obstacles(
    cloud: &SplatCloud,
    origin: DVec3,
    map: &LaneMap,
    ground: &Ground,
) -> Vec<Obstacle> {
    let mut cells = cells_beside(map);
    for (splat, mean) in cloud.means.iter().enumerate() {
        let scale_m = cloud.scales[splat].into_iter().fold(0.0, f32::max);
        let opacity = cloud.opacities[splat];
        // Written so that what is no number does not count.
        if !(opacity >= OPACITY_MIN && scale_m <= SCALE_M_MAX) {
            continue;
        }
        let at_m = origin + DVec3::from(mean.map(f64::from));
        let Some(cell) = cells.get_mut(&key(at_m.truncate())) else {
            continue;
        };
        if !(LOOK_UP_M.contains(&(at_m.z - cell.lane.1))) {
            continue;
        }
        let ground_z_m = *cell.ground_z_m.get_or_insert_with(|| {
            let middle_m = ((at_m.truncate() / CELL_M).floor() + 0.5) * CELL_M;
            let found = ground.height_at(middle_m, Some(cell.lane.1));
            found.map_or(cell.lane.1, |height| height.z_m)
        });
        if HEIGHTS_M.contains(&(at_m.z - ground_z_m)) {
            cell.mass += opacity;
            cell.low_m = cell.low_m.min(at_m.truncate());
            cell.high_m = cell.high_m.max(at_m.truncate());
        }
    }
    let surface = RoadSurface::new(map);
    let mut filled: Vec<_> = cells
        .into_iter()
        .filter(|(_, cell)| cell.mass >= FILLED)
        .filter(|(_, cell)| !surface.contains(0.5 * (cell.low_m + cell.high_m)))
        .collect();
    filled.sort_unstable_by_key(|(key, _)| *key);
    let boxed = |(_, cell): ((i64, i64), Cell)| {
        let size_m = cell.high_m - cell.low_m;
        Obstacle {
            kind: ObstacleKind::Captured,
            center_m: 0.5 * (cell.low_m + cell.high_m),
            yaw_rad: 0.0,
            length_m: size_m.x,
            width_m: size_m.y,
        }
    };
    filled.into_iter().map(boxed).collect()
}

fn key(at_m: DVec2) -> (i64, i64) {
    let cell = (at_m / CELL_M).floor();
    (cell.x as i64, cell.y as i64)
}

/// Empty cells near driving lanes, with the height of the nearest.
fn cells_beside(map: &LaneMap) -> HashMap<(i64, i64), Cell> {
    let mut cells: HashMap<(i64, i64), Cell> = HashMap::new();
    let beside = (BESIDE_M / CELL_M).ceil() as i64;
    let driving = map
        .lanes
        .iter()
        .filter(|lane| lane.kind == LaneKind::Driving);
    for pair in driving.flat_map(|lane| lane.centerline.windows(2)) {
        // Cells overlap from step to step: half of what they cover is close enough.
        let steps = (pair[0].distance(pair[1]) / (4.0 * CELL_M)).ceil();
        let steps = if steps.is_finite() {
            steps.clamp(1.0, 1e5) as u32
        } else {
            continue;
        };
        for step in 0..=steps {
            let on_lane = pair[0].lerp(pair[1], f64::from(step) / f64::from(steps));
            let (x, y) = key(on_lane.truncate());
            for (dx, dy) in
                (-beside..=beside).flat_map(|dx| (-beside..=beside).map(move |dy| (dx, dy)))
            {
                let distance_m = CELL_M * DVec2::new(dx as f64, dy as f64).length();
                if distance_m > BESIDE_M {
                    continue;
                }
                let lane = (distance_m, on_lane.z);
                let cell = cells.entry((x + dx, y + dy)).or_insert(Cell {
                    lane,
                    ground_z_m: None,
                    mass: 0.0,
                    low_m: DVec2::INFINITY,
                    high_m: DVec2::NEG_INFINITY,
                });
                if lane.0 < cell.lane.0 {
                    cell.lane = lane;
                }
            }
        }
    }
    cells
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::Lane;

    use super::*;
    use crate::ground::GroundOptions;

    /// A disc at a place.
    fn disc(at: [f32; 3], opacity: f32, scale_m: f32) -> SplatCloud {
        SplatCloud {
            means: vec![at],
            scales: vec![[scale_m, scale_m, 0.01]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacities: vec![opacity],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]],
            sh_rest: vec![],
        }
    }

    /// A lane along x at the height of 5 m, flat ground, and `things`.
    fn found(things: &[([f32; 3], f32, f32)]) -> Vec<Obstacle> {
        let map = LaneMap {
            lanes: vec![Lane {
                id: "a".into(),
                centerline: vec![DVec3::new(0.0, 0.0, 5.0), DVec3::new(80.0, 0.0, 5.0)],
                ..Lane::default()
            }],
            ..LaneMap::default()
        };
        let mut cloud = disc([0.0, 0.0, -1.0], 0.0, 0.1);
        for (x, y) in (0..160).flat_map(|x| (-40..40).map(move |y| (x, y))) {
            let at = [0.5 * x as f32, 0.5 * y as f32, 0.0];
            cloud.append(&disc(at, 0.9, 0.3));
        }
        for &(at, opacity, scale_m) in things {
            for splat in 0..8 {
                let shift = 0.02 * splat as f32;
                cloud.append(&disc([at[0] + shift, at[1], at[2]], opacity, scale_m));
            }
        }
        // Means are relative to the origin.
        let origin = DVec3::new(0.0, 0.0, 5.0);
        let ground = Ground::new(&cloud, origin, &GroundOptions::default());
        obstacles(&cloud, origin, &map, &ground)
    }

    #[test]
    fn what_stands_beside_the_lanes_at_the_height_of_a_vehicle_is_an_obstacle() {
        let all = [
            ([20.3, 5.4, 1.0], 0.9, 0.1),  // a post
            ([30.3, 0.5, 1.0], 0.9, 0.1),  // on the lane
            ([40.3, 5.4, 0.1], 0.9, 0.1),  // a kerb
            ([50.3, 5.4, 3.0], 0.9, 0.1),  // a crown
            ([60.3, 5.4, 1.0], 0.2, 0.1),  // haze
            ([70.3, 5.4, 1.0], 0.9, 3.0),  // a backdrop
            ([35.3, 19.4, 1.0], 0.9, 0.1), // far from the road
        ];
        let found = found(&all);
        assert_eq!(found.len(), 1, "{found:?}");
        let post = found[0];
        assert_eq!(post.kind, ObstacleKind::Captured);
        assert!(
            post.center_m.distance(DVec2::new(20.37, 5.4)) < 0.02,
            "{post:?}"
        );
        assert!(post.length_m < 0.2 && post.width_m < 0.01, "{post:?}");
    }

    #[test]
    fn a_map_without_lanes_has_no_obstacles() {
        let cloud = disc([0.0, 0.0, 1.0], 0.9, 0.1);
        let ground = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
        assert!(obstacles(&cloud, DVec3::ZERO, &LaneMap::default(), &ground).is_empty());
    }
}
