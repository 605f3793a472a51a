//! The lanes of both streets as a map: up to the crossing, over it (straight on, right from the
//! outer lane, left from the inner), and away from it.
//!
//! Names say street, direction, number counted from the centerline, and part:
//! `main/forward/0/before`, `/straight`, `/left`, `/right`, `/after`. Forward is along growing x on
//! the main street and growing y on the other.

use std::f64::consts::{FRAC_PI_2, PI};

use decouplegs_scene::{Lane, LaneKind, LaneMap, LightColor, LightPhase, StopLine, TrafficLight};
use glam::{DVec2, DVec3};

use super::layout::{Axis, LANE_M, STOP_LINE_M};
use super::traffic::EGO_TURN_RADIUS_M;

/// Lanes end this far from the origin: as far as traffic of the detailed streets drives in its
/// time, meters.
const END_M: f64 = 340.0;

/// Points of straight lines lie this far apart at most, meters.
const STEP_M: f64 = 5.0;

/// Largest distance between points in turns, meters: half a meter of the narrowest turn's border
/// departs 5 mm from its chord.
const TURN_STEP_M: f64 = 0.5;

/// 50 km/h, meters per second.
const SPEED_LIMIT_MPS: f64 = 50.0 / 3.6;

/// Yellow, and the time in which both lights of the crossing are red, seconds.
const YELLOW_S: f64 = 3.0;
const ALL_RED_S: f64 = 2.0;

/// Lanes in each direction.
const NUMBERS: usize = 2;

/// One direction of one street.
#[derive(Clone, Copy, PartialEq)]
struct Heading {
    axis: Axis,
    forward: bool,
}

/// Position and heading of a vehicle.
#[derive(Clone, Copy)]
struct Place {
    at: DVec2,
    yaw_rad: f64,
}

impl Heading {
    const ALL: [Self; 4] = [
        Self {
            axis: Axis::Main,
            forward: true,
        },
        Self {
            axis: Axis::Main,
            forward: false,
        },
        Self {
            axis: Axis::Cross,
            forward: true,
        },
        Self {
            axis: Axis::Cross,
            forward: false,
        },
    ];

    fn name(self) -> &'static str {
        match (self.axis, self.forward) {
            (Axis::Main, true) => "main/forward",
            (Axis::Main, false) => "main/backward",
            (Axis::Cross, true) => "cross/forward",
            (Axis::Cross, false) => "cross/backward",
        }
    }

    fn yaw_rad(self) -> f64 {
        f64::from(self.axis.yaw_rad()) + if self.forward { 0.0 } else { PI }
    }

    /// The place in lane `number`, `along_m` past the middle of the crossing.
    fn place(self, number: usize, along_m: f64) -> Place {
        let sign = if self.forward { 1.0 } else { -1.0 };
        let s = f64::from(self.axis.crossing_s()) + sign * along_m;
        let at = self.axis.at(s as f32, (-sign * offset_m(number)) as f32);
        Place {
            at: at.as_dvec2(),
            yaw_rad: self.yaw_rad(),
        }
    }

    /// Start (negative) and end of its lanes relative to the crossing's center, meters.
    fn ends_m(self) -> (f64, f64) {
        let crossing = f64::from(self.axis.crossing_s()) * if self.forward { 1.0 } else { -1.0 };
        (-END_M - crossing, END_M - crossing)
    }

    /// The heading after a turn by `turn_rad` to the left.
    fn turned(self, turn_rad: f64) -> Self {
        let ahead = DVec2::from_angle(self.yaw_rad() + turn_rad);
        let along = |heading: &Self| DVec2::from_angle(heading.yaw_rad()).dot(ahead);
        Self::ALL
            .into_iter()
            .max_by(|a, b| along(a).total_cmp(&along(b)))
            .unwrap_or(self)
    }
}

/// Centerline of the street to the middle of lane `number`, meters.
fn offset_m(number: usize) -> f64 {
    (number as f64 + 0.5) * f64::from(LANE_M)
}

/// Half the width of the crossing, meters: where the narrowest turn, from outer lane to outer lane,
/// begins.
fn crossing_half_m() -> f64 {
    offset_m(1) + EGO_TURN_RADIUS_M
}

/// A lane along an arc, or straight where `turn_rad` is 0, `length_m` long in its middle.
fn lane(id: String, from: Place, length_m: f64, turn_rad: f64) -> Lane {
    let step_m = if turn_rad == 0.0 { STEP_M } else { TURN_STEP_M };
    let steps = (length_m / step_m).ceil().max(1.0);
    let side_m = 0.5 * f64::from(LANE_M);
    let line = |left_m: f64| -> Vec<DVec3> {
        let point = |step: u32| {
            let share = f64::from(step) / steps;
            let yaw_rad = from.yaw_rad + turn_rad * share;
            let traveled = if turn_rad == 0.0 {
                DVec2::new(length_m * share, 0.0)
            } else {
                let (sin, cos) = (turn_rad * share).sin_cos();
                DVec2::new(sin, 1.0 - cos) * (length_m / turn_rad)
            };
            let left = DVec2::from_angle(yaw_rad + FRAC_PI_2);
            (from.at + DVec2::from_angle(from.yaw_rad).rotate(traveled) + left * left_m).extend(0.0)
        };
        (0..=steps as u32).map(point).collect()
    };
    Lane {
        id,
        kind: LaneKind::Driving,
        centerline: line(0.0),
        left: line(side_m),
        right: line(-side_m),
        has_height: true,
        speed_limit_mps: Some(SPEED_LIMIT_MPS),
        ..Lane::default()
    }
}

/// The map of all lanes that traffic drives in, z = 0 on the asphalt.
pub(super) fn lanes() -> LaneMap {
    let half_m = crossing_half_m();
    let mut map = LaneMap::default();
    for heading in Heading::ALL {
        let (begin_m, end_m) = heading.ends_m();
        for (part, from_m, to_m) in [
            ("before", begin_m, -half_m),
            ("straight", -half_m, half_m),
            ("after", half_m, end_m),
        ] {
            let first = map.lanes.len();
            for number in 0..NUMBERS {
                let id = format!("{}/{number}/{part}", heading.name());
                map.lanes
                    .push(lane(id, heading.place(number, from_m), to_m - from_m, 0.0));
            }
            map.lanes[first].right_neighbor = Some(first + 1);
            map.lanes[first + 1].left_neighbor = Some(first);
        }
        for (part, number, turn_rad) in [("left", 0, FRAC_PI_2), ("right", NUMBERS - 1, -FRAC_PI_2)]
        {
            let id = format!("{}/{number}/{part}", heading.name());
            // To the left past the middle of the crossing, to the right short of it.
            let radius_m = half_m + offset_m(number) * turn_rad.signum();
            map.lanes.push(lane(
                id,
                heading.place(number, -half_m),
                radius_m * FRAC_PI_2,
                turn_rad,
            ));
        }
    }
    connect(&mut map);
    map.lights = lights();
    map
}

/// One light for the main street and one for the other.
fn lights() -> Vec<TrafficLight> {
    let green_s = 12.0;
    let half_s = green_s + YELLOW_S + ALL_RED_S;
    let phase = |color, duration_s| LightPhase { color, duration_s };
    [(Axis::Main, "main", 0.0), (Axis::Cross, "cross", half_s)]
        .map(|(axis, name, offset_s)| {
            let headings = Heading::ALL.into_iter();
            let approaches = headings.filter(|heading| heading.axis == axis);
            let line = |heading: Heading, number: usize| StopLine {
                lane: format!("{}/{number}/before", heading.name()),
                at_m: -heading.ends_m().0 - STOP_LINE_M,
                ..StopLine::default()
            };
            TrafficLight {
                name: name.into(),
                stop_lines: approaches
                    .flat_map(|heading| (0..NUMBERS).map(move |number| line(heading, number)))
                    .collect(),
                phases: vec![
                    phase(LightColor::Green, green_s),
                    phase(LightColor::Yellow, YELLOW_S),
                    phase(LightColor::Red, half_s + ALL_RED_S),
                ],
                offset_s,
                changes: Vec::new(),
            }
        })
        .into()
}

/// Links each way over the crossing with the lanes that it joins.
fn connect(map: &mut LaneMap) {
    let index = |id: String| map.lanes.iter().position(|lane| lane.id == id);
    let mut links = Vec::new();
    for heading in Heading::ALL {
        let ways = (0..NUMBERS).map(|number| ("straight", number, 0.0));
        for (part, number, turn_rad) in
            ways.chain([("left", 0, FRAC_PI_2), ("right", NUMBERS - 1, -FRAC_PI_2)])
        {
            let way = index(format!("{}/{number}/{part}", heading.name()));
            let before = index(format!("{}/{number}/before", heading.name()));
            let after = index(format!(
                "{}/{number}/after",
                heading.turned(turn_rad).name()
            ));
            links.extend([(before, way), (way, after)]);
        }
    }
    for (from, to) in links {
        if let (Some(from), Some(to)) = (from, to) {
            map.lanes[from].successors.push(to);
            map.lanes[to].predecessors.push(from);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::street::{Street, StreetOptions};

    /// Distance of a point from a line of points.
    fn distance_m(line: &[DVec3], point: DVec2) -> f64 {
        let to_leg = |leg: &[DVec3]| {
            let (a, b) = (leg[0].truncate(), leg[1].truncate());
            let share = ((point - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            (a + (b - a) * share).distance(point)
        };
        line.windows(2).map(to_leg).fold(f64::MAX, f64::min)
    }

    fn nearest_m(map: &LaneMap, point: DVec2) -> f64 {
        map.lanes
            .iter()
            .map(|lane| distance_m(&lane.centerline, point))
            .fold(f64::MAX, f64::min)
    }

    #[test]
    fn lanes_join_without_a_gap_or_a_bend() {
        let map = lanes();
        map.check().unwrap();
        assert_eq!(
            (
                map.lanes.len(),
                map.lanes
                    .iter()
                    .map(|lane| &lane.id)
                    .collect::<HashSet<_>>()
                    .len()
            ),
            (32, 32)
        );
        let mut links = 0;
        for (number, lane) in map.lanes.iter().enumerate() {
            let heading = |line: &[DVec3]| (line[1] - line[0]).normalize();
            let backwards: Vec<DVec3> = lane.centerline.iter().rev().copied().collect();
            for &next in &lane.successors {
                let next = &map.lanes[next];
                assert!(next.predecessors.contains(&number));
                assert!(
                    backwards[0].distance(next.centerline[0]) < 1e-4,
                    "{} to {}",
                    lane.id,
                    next.id
                );
                assert!(
                    lane.left[lane.left.len() - 1].distance(next.left[0]) < 1e-4,
                    "{} to {}",
                    lane.id,
                    next.id
                );
                // The turns' chords stand half a step askew at their ends.
                assert!(
                    -heading(&backwards).dot(heading(&next.centerline)) > 0.999,
                    "{} to {}",
                    lane.id,
                    next.id
                );
                links += 1;
            }
            assert!(
                lane.successors.is_empty() == lane.id.ends_with("after"),
                "{}",
                lane.id
            );
            assert!(
                lane.predecessors.is_empty() == lane.id.ends_with("before"),
                "{}",
                lane.id
            );
            if let Some(right) = lane.right_neighbor {
                assert_eq!(map.lanes[right].left_neighbor, Some(number));
                assert!(map.lanes[right].left[0].distance(lane.right[0]) < 1e-4);
            }
        }
        assert_eq!(links, 32);
    }

    #[test]
    fn left_borders_lie_to_the_left() {
        for lane in lanes().lanes {
            assert_eq!(
                (lane.left.len(), lane.right.len()),
                (lane.centerline.len(), lane.centerline.len())
            );
            for (step, pair) in lane.centerline.windows(2).enumerate() {
                let across = lane.left[step] - lane.right[step];
                assert!((across.length() - f64::from(LANE_M)).abs() < 1e-6);
                assert!((pair[1] - pair[0]).cross(across).z > 0.0, "{}", lane.id);
            }
        }
    }

    #[test]
    fn agents_and_the_ego_drive_on_centerlines() {
        let options = StreetOptions {
            background: 0,
            agents: 60,
            agent_splats: 0,
            sh_degree: 0,
            seed: 3,
            ..Default::default()
        };
        let street = Street::generate(&options);
        for (agent, way) in street.agents.iter().zip(&street.agent_trajectories) {
            let (from, to) = (
                way[0].1.translation.truncate(),
                way[way.len() - 1].1.translation.truncate(),
            );
            for step in 0..=100 {
                let off_m = nearest_m(&street.lanes, from.lerp(to, f64::from(step) / 100.0));
                assert!(off_m < 0.01, "{} is {off_m} m off", agent.name);
            }
        }
        for (time_s, pose) in &street.ego {
            let off_m = nearest_m(&street.lanes, pose.translation.truncate());
            assert!(off_m < 0.01, "the ego is {off_m} m off after {time_s} s");
        }
        assert!(
            nearest_m(&street.lanes, DVec2::new(0.0, 0.0)) > 1.6,
            "nobody drives on the centerline of the street"
        );
    }
}
