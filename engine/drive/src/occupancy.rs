//! Obstacles of a captured background: cells beside the lanes that splats fill at the height of a
//! vehicle.

use std::collections::HashMap;

use decouplegs_scene::{LaneKind, LaneMap, Obstacle, ObstacleKind, SplatCloud};
use glam::{DQuat, DVec2, DVec3};
use rayon::prelude::*;

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
/// Least opacity of a splat that counts.
const OPACITY_MIN: f32 = 0.05;
/// Largest scale of a splat that counts, meters; larger ones are backdrops.
const SCALE_M_MAX: f32 = 2.5;
/// Sum of opacity times area from which a cell is filled, square meters: a dark, smooth side of a
/// car has few splats, but large ones, and haze has many faint ones. On two captured streets this
/// finds the most at the fewest phantoms.
const FILLED_M2: f64 = 0.35;
/// Splats with an axis above this, meters, are spread along it, to this many standard deviations:
/// a wall is wider than the cell of its mean.
const SPREAD_M_MIN: f64 = 0.1;
const SPREAD_SIGMAS: f64 = 1.2;
/// Least side of an obstacle, meters: a wall of one flat splat has none.
const SIDE_M_MIN: f64 = 0.1;

/// Contents of a cell.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Distance from the nearest centerline, and its height there.
    lane: (f64, f64),
    /// Height of the ground; of the lane, while no splat is near.
    ground_z_m: f64,
    area_m2: f64,
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
    look_up_ground(&mut cells, cloud, origin, ground);
    for splat in 0..cloud.len() {
        for (at_m, part_m2) in parts(cloud, origin, splat, &cells) {
            let Some(cell) = cells.get_mut(&key(at_m.truncate())) else {
                continue;
            };
            if HEIGHTS_M.contains(&(at_m.z - cell.ground_z_m)) {
                cell.area_m2 += part_m2;
                cell.low_m = cell.low_m.min(at_m.truncate());
                cell.high_m = cell.high_m.max(at_m.truncate());
            }
        }
    }
    let surface = RoadSurface::new(map);
    let mut filled: Vec<_> = cells
        .into_iter()
        .filter(|(_, cell)| cell.area_m2 >= FILLED_M2)
        .filter(|(_, cell)| !surface.contains(0.5 * (cell.low_m + cell.high_m)))
        .collect();
    filled.sort_unstable_by_key(|(key, _)| *key);
    let boxed = |(_, cell): ((i64, i64), Cell)| {
        let size_m = (cell.high_m - cell.low_m).max(DVec2::splat(SIDE_M_MIN));
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

/// Gives the cells that splats touch the height of the ground in their middle. Most of the time
/// that obstacles take goes into these heights: they are found on all threads.
fn look_up_ground(
    cells: &mut HashMap<(i64, i64), Cell>,
    cloud: &SplatCloud,
    origin: DVec3,
    ground: &Ground,
) {
    let touched = (0..cloud.len()).into_par_iter().flat_map_iter(|splat| {
        let keys = parts(cloud, origin, splat, cells).map(|(at_m, _)| key(at_m.truncate()));
        keys.filter(|key| cells.contains_key(key))
    });
    let mut touched: Vec<(i64, i64)> = touched.collect();
    // Neighbors share what is found of the ground.
    touched.par_sort_unstable();
    touched.dedup();
    let query = |key: &(i64, i64)| {
        let middle_m = (DVec2::new(key.0 as f64, key.1 as f64) + 0.5) * CELL_M;
        (middle_m, Some(cells[key].lane.1))
    };
    let queries: Vec<_> = touched.iter().map(query).collect();
    let found = ground.heights_at(&queries);
    for (key, height) in touched.iter().zip(found) {
        if let (Some(cell), Some(height)) = (cells.get_mut(key), height) {
            cell.ground_z_m = height.z_m;
        }
    }
}

/// Parts of a splat, each with its place in the world and its share of opacity times area, square
/// meters; none of a splat that does not count, or is not near a cell.
fn parts(
    cloud: &SplatCloud,
    origin: DVec3,
    splat: usize,
    cells: &HashMap<(i64, i64), Cell>,
) -> impl Iterator<Item = (DVec3, f64)> + use<> {
    let scale_m = cloud.scales[splat].into_iter().fold(0.0, f32::max);
    let opacity = cloud.opacities[splat];
    let mean_m = origin + DVec3::from(cloud.means[splat].map(f64::from));
    let is_near = |cell: &Cell| LOOK_UP_M.contains(&(mean_m.z - cell.lane.1));
    // Written so that what is no number does not count.
    let counts = opacity >= OPACITY_MIN && scale_m <= SCALE_M_MAX;
    let (offsets_m, area_m2) =
        match counts && cells.get(&key(mean_m.truncate())).is_some_and(is_near) {
            true => spread(cloud, splat),
            false => (Vec::new(), 0.0),
        };
    let part_m2 = f64::from(opacity) * area_m2 / offsets_m.len() as f64;
    let places = offsets_m.into_iter().map(move |offset_m| mean_m + offset_m);
    places.map(move |at_m| (at_m, part_m2))
}

/// Places over which a splat is spread, relative to its mean, and its area, square meters: twice
/// that of the ellipse of one standard deviation, whose integral is that of the Gaussian.
fn spread(cloud: &SplatCloud, splat: usize) -> (Vec<DVec3>, f64) {
    let [w, x, y, z] = cloud.rotations[splat].map(f64::from);
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let length = rotation.length();
    let mut axes = [DVec3::X, DVec3::Y, DVec3::Z]
        .into_iter()
        .zip(cloud.scales[splat].map(f64::from))
        .map(|(axis, sigma_m)| (sigma_m, axis));
    let mut axes: [(f64, DVec3); 3] = std::array::from_fn(|_| axes.next().unwrap_or_default());
    axes.sort_by(|a, b| b.0.total_cmp(&a.0));
    let area_m2 = std::f64::consts::TAU * axes[0].0 * axes[1].0;
    let steps = |(sigma_m, axis): (f64, DVec3)| {
        let arm_m = match length > 0.0 && sigma_m > SPREAD_M_MIN {
            true => rotation.normalize() * axis * (SPREAD_SIGMAS * sigma_m),
            false => return vec![DVec3::ZERO],
        };
        vec![-arm_m, DVec3::ZERO, arm_m]
    };
    let (along, across) = (steps(axes[0]), steps(axes[1]));
    let places = along
        .iter()
        .flat_map(|a| across.iter().map(move |b| *a + *b));
    (places.collect(), area_m2)
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
                    ground_z_m: on_lane.z,
                    area_m2: 0.0,
                    low_m: DVec2::INFINITY,
                    high_m: DVec2::NEG_INFINITY,
                });
                if lane.0 < cell.lane.0 {
                    cell.lane = lane;
                    cell.ground_z_m = on_lane.z;
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
            ([20.3, 5.4, 1.0], 0.9, 0.095), // a post
            ([30.3, 0.5, 1.0], 0.9, 0.1),   // on the lane
            ([40.3, 5.4, 0.1], 0.9, 0.1),   // a kerb
            ([50.3, 5.4, 3.0], 0.9, 0.1),   // a crown
            ([60.3, 5.4, 1.0], 0.04, 0.3),  // haze
            ([70.3, 5.4, 1.0], 0.9, 3.0),   // a backdrop
            ([65.3, 5.4, 1.0], 0.2, 0.05),  // a few faint specks
            ([35.3, 19.4, 1.0], 0.9, 0.1),  // far from the road
        ];
        let found = found(&all);
        assert_eq!(found.len(), 1, "{found:?}");
        let post = found[0];
        assert_eq!(post.kind, ObstacleKind::Captured);
        assert!(
            post.center_m.distance(DVec2::new(20.37, 5.4)) < 0.02,
            "{post:?}"
        );
        assert!(
            post.length_m < 0.2 && post.width_m == SIDE_M_MIN,
            "{post:?}"
        );
    }

    #[test]
    fn a_smooth_wall_of_a_few_large_splats_fills_all_that_it_covers() {
        let map = LaneMap {
            lanes: vec![Lane {
                id: "a".into(),
                centerline: vec![DVec3::ZERO, DVec3::new(80.0, 0.0, 0.0)],
                ..Lane::default()
            }],
            ..LaneMap::default()
        };
        // A meter and a half along x, half a meter high, as thin as paper.
        let mut wall = disc([20.5, 5.5, 1.1], 0.5, 1.0);
        wall.scales[0] = [1.5, 0.01, 0.5];
        let ground = Ground::new(&wall, DVec3::ZERO, &GroundOptions::default());
        let found = obstacles(&wall, DVec3::ZERO, &map, &ground);
        assert!(found.len() >= 3, "{found:?}");
        assert!(
            found.iter().all(|one| (one.center_m.y - 5.5).abs() < 0.02),
            "{found:?}"
        );
        let faint = SplatCloud {
            opacities: vec![0.06],
            ..wall
        };
        assert!(obstacles(&faint, DVec3::ZERO, &map, &ground).is_empty());
    }

    #[test]
    fn a_map_without_lanes_has_no_obstacles() {
        let cloud = disc([0.0, 0.0, 1.0], 0.9, 0.1);
        let ground = Ground::new(&cloud, DVec3::ZERO, &GroundOptions::default());
        assert!(obstacles(&cloud, DVec3::ZERO, &LaneMap::default(), &ground).is_empty());
    }
}
