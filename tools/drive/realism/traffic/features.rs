//! Quantities of a motion, by road user and moment.
//!
//! Speeds, accelerations and their likes are central differences of places. Who is followed is told
//! by box, as in the Waymo Open Sim Agents Challenge (N. Montali et al., NeurIPS 2023; rules of
//! 2025): ahead, in the straight trail of the box, and not turned by more than 75 degrees, or 10
//! where the trails share less than half a meter.

use decouplegs::drive::OrientedBox;
use decouplegs::drive::polyline::wrapped;
use decouplegs::scene::{VehicleSize, VehicleState};
use glam::DVec2;

use super::motion::{Motion, Place, STEP_S};
use super::roads::Roads;

/// Speed from which on a headway is told, m/s.
const HEADWAY_MPS: f64 = 2.0;
/// Farthest vehicle that counts as followed where gaps are compared, meters.
const GAP_M: f64 = 100.0;
/// Limits of who is followed.
const TURNED_RAD: f64 = 75.0 * std::f64::consts::PI / 180.0;
const TURNED_BESIDE_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
const SMALL_SHARE_M: f64 = 0.5;
/// Longest time to collision, seconds.
pub const COLLISION_S: f64 = 5.0;

/// Quantity of a road user at a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    Speed,
    Acceleration,
    Jerk,
    YawRate,
    YawAcceleration,
    Gap,
    Headway,
    TimeToCollision,
    Nearest,
    Lateral,
    Edge,
}

impl Quantity {
    pub const ALL: [Self; 11] = [
        Self::Speed,
        Self::Acceleration,
        Self::Jerk,
        Self::YawRate,
        Self::YawAcceleration,
        Self::Gap,
        Self::Headway,
        Self::TimeToCollision,
        Self::Nearest,
        Self::Lateral,
        Self::Edge,
    ];

    /// Name and unit.
    pub fn name(self) -> &'static str {
        match self {
            Self::Speed => "speed, m/s",
            Self::Acceleration => "acceleration, m/s²",
            Self::Jerk => "jerk, m/s³",
            Self::YawRate => "yaw rate, rad/s",
            Self::YawAcceleration => "yaw acceleration, rad/s²",
            Self::Gap => "gap to the vehicle ahead, m",
            Self::Headway => "time headway, s",
            Self::TimeToCollision => "time to collision, s",
            Self::Nearest => "distance to the nearest, m",
            Self::Lateral => "offset from the middle of the lane, m",
            Self::Edge => "distance beyond the edge of the road, m",
        }
    }
}

/// Values by road user and moment; `None` where there is none.
pub type Series = Vec<Vec<Option<f64>>>;

/// Quantities of a motion.
pub struct Features {
    values: Vec<Series>,
    /// True where a box touches another.
    pub touches: Vec<Vec<bool>>,
    /// True where a red light was passed in the step before.
    pub red: Vec<Vec<bool>>,
    /// Lane of each road user and moment, index in the map.
    pub lanes: Vec<Vec<Option<usize>>>,
}

/// Vehicle that another one follows.
struct Followed {
    gap_m: f64,
    speed_mps: Option<f64>,
}

impl Features {
    /// Quantities of those of `motion` at `chosen`; of all others only what concerns them.
    pub fn new(motion: &Motion, roads: &Roads, chosen: &[usize]) -> Self {
        let count = motion.places.len();
        let steps = motion.places.first().map_or(0, Vec::len);
        let none: Series = vec![vec![None; steps]; count];
        let mut found = Self {
            values: vec![none; Quantity::ALL.len()],
            touches: vec![vec![false; steps]; count],
            red: vec![vec![false; steps]; count],
            lanes: vec![vec![None; steps]; count],
        };
        for (at, places) in motion.places.iter().enumerate() {
            found.measure_motion(at, places);
        }
        for &at in chosen {
            for step in 0..steps {
                let Some(place) = motion.places[at][step] else {
                    continue;
                };
                found.measure_road(roads, motion, (at, step), place);
                found.measure_others(motion, (at, step), place);
            }
        }
        found
    }

    /// Values of a quantity.
    pub fn of_quantity(&self, quantity: Quantity) -> &Series {
        &self.values[quantity as usize]
    }

    fn set(&mut self, quantity: Quantity, (at, step): (usize, usize), value: Option<f64>) {
        self.values[quantity as usize][at][step] = value;
    }

    fn measure_motion(&mut self, at: usize, places: &[Option<Place>]) {
        let x: Vec<Option<f64>> = places
            .iter()
            .map(|place| Some(place.as_ref()?.0.x))
            .collect();
        let y: Vec<Option<f64>> = places
            .iter()
            .map(|place| Some(place.as_ref()?.0.y))
            .collect();
        let yaw: Vec<Option<f64>> = places.iter().map(|place| Some(place.as_ref()?.1)).collect();
        let plain = |difference: f64| difference;
        let (x, y) = (central(&x, plain), central(&y, plain));
        let speed: Vec<Option<f64>> = x
            .into_iter()
            .zip(y)
            .map(|(x, y)| Some(x?.hypot(y?)))
            .collect();
        let acceleration = central(&speed, plain);
        self.values[Quantity::Jerk as usize][at] = central(&acceleration, plain);
        self.values[Quantity::Speed as usize][at] = speed;
        self.values[Quantity::Acceleration as usize][at] = acceleration;
        let yaw_rate = central(&yaw, wrapped);
        self.values[Quantity::YawAcceleration as usize][at] = central(&yaw_rate, plain);
        self.values[Quantity::YawRate as usize][at] = yaw_rate;
    }

    fn measure_road(
        &mut self,
        roads: &Roads,
        motion: &Motion,
        (at, step): (usize, usize),
        (at_m, yaw_rad): Place,
    ) {
        let lane = roads.lane_at(at_m, yaw_rad);
        self.lanes[at][step] = lane.as_ref().map(|lane| lane.lane);
        let lateral_m = lane.map(|lane| lane.foot.lateral_m);
        self.set(Quantity::Lateral, (at, step), lateral_m);
        let outline = outline((at_m, yaw_rad), &motion.sizes[at]);
        self.set(
            Quantity::Edge,
            (at, step),
            Some(roads.beyond_edge_m(&outline)),
        );
        let before = step.checked_sub(1).and_then(|step| motion.places[at][step]);
        if let Some((before_m, _)) = before {
            let time_s = motion.start_s + step as f64 * STEP_S;
            self.red[at][step] = roads.runs_red(before_m, at_m, time_s);
        }
    }

    fn measure_others(&mut self, motion: &Motion, (at, step): (usize, usize), place: Place) {
        let own = outline(place, &motion.sizes[at]);
        let mut nearest_m = f64::INFINITY;
        let mut followed: Option<Followed> = None;
        for (other, places) in motion.places.iter().enumerate().filter(|one| one.0 != at) {
            let Some(other_place) = places[step] else {
                continue;
            };
            let box_of_other = outline(other_place, &motion.sizes[other]);
            nearest_m = nearest_m.min(signed_m(&own, &box_of_other));
            let gap_m = followed_at_m(&own, &box_of_other);
            let best_m = followed.as_ref().map_or(f64::INFINITY, |one| one.gap_m);
            if let Some(gap_m) = gap_m.filter(|gap_m| *gap_m < best_m) {
                let speed_mps = self.values[Quantity::Speed as usize][other][step];
                followed = Some(Followed { gap_m, speed_mps });
            }
        }
        self.touches[at][step] = nearest_m < 0.0;
        let key = (at, step);
        self.set(
            Quantity::Nearest,
            key,
            nearest_m.is_finite().then_some(nearest_m),
        );
        let speed_mps = self.of_quantity(Quantity::Speed)[at][step];
        let followed = followed.filter(|one| one.gap_m < GAP_M);
        self.set(Quantity::Gap, key, followed.as_ref().map(|one| one.gap_m));
        let is_moving = speed_mps.filter(|speed_mps| *speed_mps > HEADWAY_MPS);
        let headway_s = followed.as_ref().zip(is_moving);
        let headway_s = headway_s.map(|(one, speed_mps)| one.gap_m / speed_mps);
        self.set(Quantity::Headway, key, headway_s);
        let closing_mps = followed
            .as_ref()
            .and_then(|one| Some(speed_mps? - one.speed_mps?));
        let closing_mps = closing_mps.filter(|closing_mps| *closing_mps > 0.0);
        let collides_s = followed.as_ref().zip(closing_mps);
        let collides_s = collides_s.map(|(one, closing_mps)| one.gap_m / closing_mps);
        let collides_s = collides_s.map_or(COLLISION_S, |time_s| time_s.min(COLLISION_S));
        self.set(Quantity::TimeToCollision, key, Some(collides_s));
    }
}

/// Central differences over time; `None` at the ends and where a neighbor is missing.
fn central(values: &[Option<f64>], of_difference: impl Fn(f64) -> f64) -> Vec<Option<f64>> {
    let at = |step: usize| {
        let before = values[step.checked_sub(1)?]?;
        let after = (*values.get(step + 1)?)?;
        Some(of_difference(after - before) / (2.0 * STEP_S))
    };
    (0..values.len()).map(at).collect()
}

fn outline((position_m, yaw_rad): Place, size: &VehicleSize) -> OrientedBox {
    let state = VehicleState {
        position_m,
        yaw_rad,
        ..VehicleState::default()
    };
    OrientedBox::for_vehicle(&state, size)
}

/// Gap between two boxes, meters; where they overlap, below zero by how deep.
fn signed_m(a: &OrientedBox, b: &OrientedBox) -> f64 {
    if !a.overlaps(b) {
        return a.distance_m(b);
    }
    let between = b.center_m - a.center_m;
    let half_m = |one: &OrientedBox, axis: DVec2| {
        let ahead = DVec2::from_angle(one.yaw_rad);
        one.half_length_m * ahead.dot(axis).abs() + one.half_width_m * ahead.perp_dot(axis).abs()
    };
    let (a_ahead, b_ahead) = (DVec2::from_angle(a.yaw_rad), DVec2::from_angle(b.yaw_rad));
    [a_ahead, a_ahead.perp(), b_ahead, b_ahead.perp()]
        .map(|axis| between.dot(axis).abs() - half_m(a, axis) - half_m(b, axis))
        .into_iter()
        .fold(f64::NEG_INFINITY, f64::max)
}

/// Distance from the front of a box to another one that it follows, meters.
fn followed_at_m(own: &OrientedBox, other: &OrientedBox) -> Option<f64> {
    let turn_rad = wrapped(other.yaw_rad - own.yaw_rad).abs();
    let turn = DVec2::from_angle(turn_rad).abs();
    let half = DVec2::new(other.half_length_m, other.half_width_m);
    let (along_m, across_m) = (half.dot(turn), half.dot(DVec2::new(turn.y, turn.x)));
    let apart_m = own.to_local(other.center_m);
    let gap_m = apart_m.x - own.half_length_m - along_m;
    let beside_m = apart_m.y.abs() - own.half_width_m - across_m;
    let is_followed = gap_m > 0.0
        && turn_rad <= TURNED_RAD
        && beside_m < 0.0
        && (beside_m < -SMALL_SHARE_M || turn_rad <= TURNED_BESIDE_RAD);
    is_followed.then_some(gap_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn car(x_m: f64, y_m: f64, yaw_rad: f64) -> OrientedBox {
        outline((DVec2::new(x_m, y_m), yaw_rad), &VehicleSize::CAR)
    }

    #[test]
    fn gaps_are_measured_to_who_is_ahead_in_the_trail() {
        let own = car(0.0, 0.0, 0.0);
        assert!((followed_at_m(&own, &car(20.0, 0.5, 0.0)).unwrap() - 15.5).abs() < 1e-12);
        let half_turned = std::f64::consts::FRAC_PI_4;
        for (other, name) in [
            (car(-20.0, 0.0, 0.0), "behind"),
            (car(20.0, 3.5, 0.0), "beside"),
            (car(20.0, 0.0, 1.4), "across"),
            (car(20.0, 2.9, half_turned), "touches the trail alone"),
        ] {
            assert_eq!(followed_at_m(&own, &other), None, "{name}");
        }
        assert!(followed_at_m(&own, &car(20.0, 1.6, 0.1)).is_some());
        assert!((signed_m(&own, &car(4.0, 0.0, 0.0)) + 0.5).abs() < 1e-12);
        assert!((signed_m(&own, &car(0.0, 2.8, 0.0)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn differences_are_central_and_end_where_places_do() {
        let squares: Vec<Option<f64>> = (0..5).map(|step| Some(f64::from(step * step))).collect();
        let first = central(&squares, |difference| difference);
        let expected: Vec<f64> = (1..4).map(|step| 2.0 * f64::from(step) / STEP_S).collect();
        assert_eq!((first[0], first[4]), (None, None));
        for (found, expected) in first[1..4].iter().zip(expected) {
            assert!((found.unwrap() - expected).abs() < 1e-9);
        }
        let mut missing = squares;
        missing[2] = None;
        let found = central(&missing, |difference| difference);
        assert_eq!((found[1], found[3]), (None, None));
    }
}
