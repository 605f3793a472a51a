//! Directions of traffic lights: arrows bind the successors of a lane that lead their way.

use decouplegs_scene::{Lane, StopLine};
use glam::{DVec2, DVec3};

use super::polyline::plan_length_m;

/// Turn from which a way leads to the left or to the right, radians.
const TURN_RAD: f64 = std::f64::consts::FRAC_PI_6;
/// Length of a way after which its direction is read, meters: the first lane of a turn may be
/// short and straight.
const WAY_M: f64 = 30.0;
/// Lanes of a way that are examined at most.
const LANES_MAX: usize = 32;

/// Directions that a light is for, or in which a way leads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Directions(u8);

impl Directions {
    pub(super) const LEFT: Self = Self(1);
    pub(super) const STRAIGHT: Self = Self(2);
    pub(super) const RIGHT: Self = Self(4);
    pub(super) const ALL: Self = Self(7);

    pub(super) const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    const fn meets(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

/// Stop line at `at_m` on lane `at` for a light with `directions`: it binds the successors that
/// lead there, which it names where they are not all of them. `None` where no successor does; a
/// lane that ends is bound by any light.
pub(super) fn stop_line(
    lanes: &[Lane],
    at: usize,
    at_m: f64,
    directions: Directions,
) -> Option<StopLine> {
    // Links are tidied later: files name them at both ends.
    let mut all = lanes[at].successors.clone();
    all.sort_unstable();
    all.dedup();
    let mut towards = all.clone();
    if directions != Directions::ALL {
        towards.retain(|&next| ways(lanes, at, next).meets(directions));
    }
    if towards.is_empty() && !all.is_empty() {
        return None;
    }
    if towards.len() == all.len() {
        towards.clear();
    }
    Some(StopLine {
        lane: lanes[at].id.clone(),
        at_m,
        towards: towards
            .into_iter()
            .map(|next| lanes[next].id.clone())
            .collect(),
    })
}

/// Directions of the ways that begin with `next` behind lane `from`.
fn ways(lanes: &[Lane], from: usize, next: usize) -> Directions {
    let [.., before, end] = lanes[from].centerline[..] else {
        return Directions::ALL;
    };
    let ahead = (end - before).truncate();
    let mut found = Directions(0);
    let (mut open, mut count) = (vec![(next, 0.0)], 0);
    while let Some((at, start_m)) = open.pop() {
        let lane = &lanes[at];
        count += 1;
        let end_m: f64 = start_m + plan_length_m(&lane.centerline);
        if end_m < WAY_M && !lane.successors.is_empty() && count < LANES_MAX {
            open.extend(lane.successors.iter().map(|&next| (next, end_m)));
            continue;
        }
        found = found.and(turn(ahead, &lane.centerline));
    }
    found
}

/// Direction of the end of a line, seen from a vehicle that comes along `ahead`.
fn turn(ahead: DVec2, line: &[DVec3]) -> Directions {
    let [.., before, end] = *line else {
        return Directions::ALL;
    };
    let turn_rad = ahead.angle_to((end - before).truncate());
    match turn_rad {
        turn_rad if turn_rad > TURN_RAD => Directions::LEFT,
        turn_rad if turn_rad < -TURN_RAD => Directions::RIGHT,
        _ => Directions::STRAIGHT,
    }
}
