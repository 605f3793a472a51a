//! The ground and the obstacles of a scene beside the points of scans.

use decouplegs::drive::obstacles::outline;
use decouplegs::drive::polyline::Polyline;
use decouplegs::drive::register::grounding::{corners, plane, pose_on};
use decouplegs::episode::Site;
use decouplegs::scene::{Camera, Obstacle, Pose, Trajectory, VehicleSize, VehicleState};
use glam::{DVec2, DVec3};
use serde_json::{Value, json};

use super::gap::{Gap, Statistic};
use super::scan_points::ScanPoints;

/// Places across the way that count as on it, and as beside it, meters.
const ON_WAY_M: f64 = 1.75;
const BESIDE_WAY_M: f64 = 5.0;
/// Distance between places of the vehicle, meters.
const STRIDE_M: f64 = 1.0;
/// Obstacles and points that are farther from a driving lane do not count, meters.
const BESIDE_LANE_M: f64 = 5.0;
/// Heights of points above the ground that a vehicle hits, meters.
const HEIGHTS_M: std::ops::Range<f64> = 0.4..1.9;
/// Points in a square meter from which something stands there.
const STANDING_POINTS: usize = 8;
/// Images of the scene that show a place, at least, and their distance at most, meters: what no
/// camera saw cannot be in the scene.
const SHOWN_IMAGES: usize = 3;
const SHOWN_M: f64 = 35.0;
/// An obstacle is real where so many points are so near, meters.
const REAL_POINTS: usize = 3;
const REAL_M: f64 = 0.3;
/// Points of the ground in a square meter from which a scan saw that nothing stands there.
const FREE_POINTS: usize = 5;

/// Errors of the ground and of obstacles.
#[derive(Default)]
pub struct ComparedRoad {
    /// Heights of the scene's ground above that of scans, a value per square meter, meters.
    on_way_m: Vec<f64>,
    beside_way_m: Vec<f64>,
    /// Heights of the corners of the vehicle along the way above the ground of scans, meters.
    corners_m: Vec<f64>,
    pitches_deg: Vec<f64>,
    rolls_deg: Vec<f64>,
    /// 1 for a square meter with points of something that stands there and an obstacle of the
    /// scene, 0 for one without.
    found: Vec<f64>,
    /// 1 for an obstacle of the scene without points where scans saw the ground, 0 for a real one.
    phantoms: Vec<f64>,
}

impl ComparedRoad {
    /// The ground and the obstacles of `site` beside the points of scans; `views` are those of the
    /// scene's images.
    pub fn new(site: &Site, views: &[Camera], points: &ScanPoints) -> Self {
        let mut compared = Self::default();
        if let Some(way) = site.recorded_way() {
            compared.measure_ground(site, way, points);
            compared.measure_vehicle(site, way, points);
        }
        compared.measure_obstacles(site, views, points);
        compared
    }

    fn measure_ground(&mut self, site: &Site, way: &Trajectory, points: &ScanPoints) {
        let Some(line) = Polyline::new(way.poses().iter().map(|timed| timed.pose.translation))
        else {
            return;
        };
        for middle in points.ground_cells() {
            let across_m = line.project(middle).distance_m;
            if across_m > BESIDE_WAY_M {
                continue;
            }
            let error = points.ground_at(middle).and_then(|real_m| {
                let found_m = site.height_at(middle, real_m)?;
                Some(found_m - real_m)
            });
            let errors_m = match across_m <= ON_WAY_M {
                true => &mut self.on_way_m,
                false => &mut self.beside_way_m,
            };
            errors_m.extend(error);
        }
    }

    fn measure_vehicle(&mut self, site: &Site, way: &Trajectory, points: &ScanPoints) {
        let size = site
            .loaded
            .recording
            .vehicle_size
            .unwrap_or(VehicleSize::CAR);
        let mut last: Option<DVec2> = None;
        for timed in way.poses() {
            let state = state_of(&timed.pose);
            if last.is_some_and(|last| last.distance(state.position_m) < STRIDE_M) {
                continue;
            }
            last = Some(state.position_m);
            let local = corners(size.to_array());
            let heights_m = local.map(|corner| points.ground_at(state.to_world(corner)));
            let Some((real, _)) = plane(&local, &heights_m) else {
                continue;
            };
            if heights_m.iter().any(Option::is_none) {
                continue;
            }
            let real = pose_on(&real, state.position_m, state.yaw_rad, size.height_m);
            let near_m = real.translation.z - 0.5 * size.height_m;
            let shown = site.pose_of(&state, &size, near_m);
            let bottom = |pose: &Pose, corner: DVec2| {
                let bottom_m = -0.5 * size.height_m;
                pose.transform(corner.extend(bottom_m)).z
            };
            let errors_m = local.map(|corner| bottom(&shown, corner) - bottom(&real, corner));
            self.corners_m.extend(errors_m);
            let rise_deg = |pose: &Pose, axis: DVec3| (pose.rotation * axis).z.asin().to_degrees();
            let apart_deg = |axis: DVec3| rise_deg(&shown, axis) - rise_deg(&real, axis);
            self.pitches_deg.push(apart_deg(DVec3::X));
            self.rolls_deg.push(apart_deg(DVec3::Y));
        }
    }

    fn measure_obstacles(&mut self, site: &Site, views: &[Camera], points: &ScanPoints) {
        let is_beside =
            |at: DVec2| site.surface.reaches(at, BESIDE_LANE_M) && !site.surface.contains(at);
        let obstacles = site.obstacles.all();
        for (cell_m, standing) in points.standing_cells(&HEIGHTS_M) {
            let middle_m = cell_m + 0.5;
            if standing.len() < STANDING_POINTS || !is_beside(middle_m) {
                continue;
            }
            let shown = views.iter().filter(|view| shows(view, standing[0]));
            if shown.take(SHOWN_IMAGES).count() < SHOWN_IMAGES {
                continue;
            }
            // As far as half a cell from its middle on either axis.
            let is_found = |one: &Obstacle| outline(one).distance_to_m(middle_m) <= 0.55;
            let found = obstacles.iter().any(is_found);
            self.found.push(f64::from(u8::from(found)));
        }
        for one in obstacles.iter().filter(|one| is_beside(one.center_m)) {
            let radius_m = 0.5 * one.length_m.hypot(one.width_m) + REAL_M;
            let near = points.standing_near(one.center_m, radius_m);
            let real = near.filter(|at| outline(one).distance_to_m(*at) <= REAL_M);
            let is_real = real.take(REAL_POINTS).count() == REAL_POINTS;
            if is_real || points.ground_points_at(one.center_m) >= FREE_POINTS {
                self.phantoms.push(f64::from(u8::from(!is_real)));
            }
        }
    }

    pub fn gaps(&self) -> Vec<Gap> {
        let sizes = |values: &[f64]| values.iter().map(|value| value.abs()).collect::<Vec<f64>>();
        let gap = |name: &str, statistic, values: &[f64], digits| {
            Gap::new(name, statistic, values, digits)
        };
        let (on_way, beside, corners) = (
            sizes(&self.on_way_m),
            sizes(&self.beside_way_m),
            sizes(&self.corners_m),
        );
        vec![
            gap(
                "height of the ground on the way, median error, m",
                Statistic::Median,
                &on_way,
                3,
            ),
            gap(
                "height of the ground on the way, 95 %, m",
                Statistic::P95,
                &on_way,
                3,
            ),
            gap(
                "height of the ground to 5 m beside the way, 95 %, m",
                Statistic::P95,
                &beside,
                3,
            ),
            gap(
                "corners of the vehicle, median error, m",
                Statistic::Median,
                &corners,
                3,
            ),
            gap(
                "corners of the vehicle, 95 %, m",
                Statistic::P95,
                &corners,
                3,
            ),
            gap(
                "pitch of the vehicle, RMS error, degrees",
                Statistic::Rms,
                &self.pitches_deg,
                2,
            ),
            gap(
                "roll of the vehicle, RMS error, degrees",
                Statistic::Rms,
                &self.rolls_deg,
                2,
            ),
            gap(
                "obstacles to 5 m beside lanes that the scene has",
                Statistic::Share,
                &self.found,
                2,
            ),
            gap(
                "obstacles of the scene that scans do not see",
                Statistic::Share,
                &self.phantoms,
                2,
            ),
        ]
    }

    pub fn to_json(&self) -> Value {
        json!({
            "ground_on_way_m": self.on_way_m,
            "ground_beside_way_m": self.beside_way_m,
            "corners_m": self.corners_m,
            "pitches_deg": self.pitches_deg,
            "rolls_deg": self.rolls_deg,
            "obstacles_found": self.found,
            "phantoms": self.phantoms,
        })
    }
}

fn state_of(pose: &Pose) -> VehicleState {
    VehicleState {
        position_m: pose.translation.truncate(),
        yaw_rad: pose.heading_rad(),
        speed_mps: 0.0,
        acceleration_mps2: 0.0,
    }
}

/// True if `view` shows the place from near by.
fn shows(view: &Camera, at_m: DVec3) -> bool {
    let ray = view.world_from_camera.inverse().transform(at_m);
    let pixel = view.intrinsics.project(ray);
    let size = DVec2::new(
        f64::from(view.intrinsics.width_px),
        f64::from(view.intrinsics.height_px),
    );
    let is_inside = |pixel: DVec2| pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
    ray.z > 0.0 && ray.length() <= SHOWN_M && pixel.is_some_and(is_inside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::{Intrinsics, Motion};

    #[test]
    fn a_view_shows_what_is_before_it_and_near() {
        let view = Camera {
            world_from_camera: Pose::look_at(DVec3::Z, DVec3::new(9.0, 0.0, 1.0), DVec3::Z)
                .unwrap(),
            name: "front".into(),
            intrinsics: Intrinsics::centered([200, 100], 100.0),
            motion: Motion::REST,
        };
        assert!(shows(&view, DVec3::new(10.0, 1.0, 1.0)));
        for hidden in [[-10.0, 0.0, 1.0], [10.0, 11.0, 1.0], [36.0, 0.0, 1.0]] {
            assert!(!shows(&view, DVec3::from_array(hidden)));
        }
    }
}
