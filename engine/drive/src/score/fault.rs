//! Attribution of the fault of a collision.
//!
//! The rules are nuPlan's (Caesar et al., "nuPlan: A closed-loop ML-based planning benchmark for
//! autonomous vehicles", 2021), as far as a record without a map can tell them. It is not the ego's
//! fault when
//! - the ego stands: it is slower than 0.1 m/s at the contact and at the moment before;
//! - it is hit from behind by a vehicle in its lane: the other's middle is behind its rear, both
//!   point the same way to within 45 degrees, and for the second before each was in the other's
//!   way;
//! - the other cuts in: it drives along the route, in either direction, was beside the ego's way
//!   less than a second before, and came nearer to it by moving sideways more than the ego did.
//!
//! A collision with a pedestrian is the ego's fault unless the ego stands.
//!
//! All else is: running into what is ahead, into what crosses, and changing into the way of others.
//! Lanes are not in the record. What stands for them is the route, averaged over up to 40 m to both
//! sides: a line that bends with the road but hardly changes lanes where the route does, so that it
//! shows which of two vehicles leaves its lane. In bends it is averaged over less, or it would cut
//! them; in those of less than about 80 m radius it no longer tells a route that changes lanes from
//! a road that bends.

use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{Episode, RoadUser, VehicleSize, VehicleState};
use glam::DVec2;

use crate::oriented_box::OrientedBox;
use crate::polyline::{Foot, Polyline, wrapped};

/// Speed below which a vehicle counts as standing, m/s.
const STANDING_MPS: f64 = 0.1;
/// Reaction time: an agent that enters the ego's path later than this before the contact is at
/// fault, seconds.
const REACTION_S: f64 = 1.0;
/// Headings that differ by less are one direction, radians.
const SAME_DIRECTION_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// Largest distance to each side over which the route is averaged, meters: more than a lane change
/// is long.
const AVERAGED_M: f64 = 40.0;
/// Largest bend of the route within that distance, radians.
const AVERAGED_BEND_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// Distance between points of the averaged route, meters.
const STRIDE_M: f64 = 2.0;
/// Largest number of points of an averaged route; those of a longer one lie farther apart.
const STRIDES_MAX: f64 = 50_000.0;

/// Fault of a collision, and the reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Ego at fault: nothing excuses it.
    Ego,
    /// Other vehicle at fault: it hit a standing ego.
    EgoStood,
    /// Other vehicle at fault: it hit the rear of the ego, which was in its own lane.
    HitFromBehind,
    /// Other vehicle at fault: it cut in with less than the reaction time left.
    CutIn,
}

impl Fault {
    /// True if the ego is at fault.
    #[must_use]
    pub fn at_fault(self) -> bool {
        self == Self::Ego
    }

    /// Reason, a clause for reports.
    #[must_use]
    pub const fn why(self) -> &'static str {
        match self {
            Self::Ego => "the ego drove into another road user",
            Self::EgoStood => "the ego stood",
            Self::HitFromBehind => "the ego was hit from behind by a vehicle in its lane",
            Self::CutIn => "the other moved into the ego's way less than a second before",
        }
    }
}

/// Fault of the contact between the ego and `agent` at moment `contact` of `instants`.
pub(super) fn fault(
    episode: &Episode,
    instants: &[&EpisodeTick],
    contact: usize,
    agent: usize,
) -> Fault {
    let (now, before) = (instants[contact], instants[contact.saturating_sub(1)]);
    if now.ego.speed_mps < STANDING_MPS && before.ego.speed_mps < STANDING_MPS {
        return Fault::EgoStood;
    }
    if episode.head.scenario.agent(agent).1 == RoadUser::Pedestrian {
        return Fault::Ego;
    }
    let Some(road) = averaged_route(&episode.head.route_m, now.ego.position_m) else {
        return Fault::Ego;
    };
    let sizes = [
        episode.head.scenario.ego.size,
        episode.head.agent_sizes[agent],
    ];
    let recent = instants[..=contact]
        .iter()
        .filter(|instant| instant.time_s >= now.time_s - REACTION_S);
    let abreast: Vec<Abreast> = recent
        .filter_map(|instant| {
            Some(Abreast::new(
                &road,
                [&instant.ego, instant.agents.get(agent)?.as_ref()?],
                &sizes,
            ))
        })
        .collect();
    let Some(other) = &now.agents[agent] else {
        return Fault::Ego;
    };
    let outline = OrientedBox::for_vehicle(&now.ego, &sizes[0]);
    let behind = outline.to_local(other.position_m).x <= -outline.half_length_m;
    let same_direction = wrapped(other.yaw_rad - now.ego.yaw_rad).abs() < SAME_DIRECTION_RAD;
    if behind && same_direction && abreast.iter().all(|at| at.gap_m <= 0.0) {
        return Fault::HitFromBehind;
    }
    let along_road = wrapped(2.0 * (other.yaw_rad - road.project(other.position_m).heading_rad))
        .abs()
        < 2.0 * SAME_DIRECTION_RAD;
    let beside = abreast.iter().find(|at| at.gap_m > 0.0);
    let (Some(beside), Some(end)) = (beside, abreast.last()) else {
        return Fault::Ego;
    };
    let side = (beside.laterals_m[1] - beside.laterals_m[0]).signum();
    let ego_came_m = side * (end.laterals_m[0] - beside.laterals_m[0]);
    let other_came_m = side * (beside.laterals_m[1] - end.laterals_m[1]);
    if along_road && other_came_m > ego_came_m {
        Fault::CutIn
    } else {
        Fault::Ego
    }
}

/// The ego and the other across the road at one moment.
struct Abreast {
    /// Offsets of the middles of both boxes from the road's line, meters, positive to the left.
    laterals_m: [f64; 2],
    /// Gap between the outlines of both boxes across the road, meters; zero and below where one is
    /// in the other's way.
    gap_m: f64,
}

impl Abreast {
    fn new(road: &Polyline, states: [&VehicleState; 2], sizes: &[VehicleSize; 2]) -> Self {
        let feet: [Foot; 2] = states.map(|state| road.project(state.position_m));
        let half_width_m = |which: usize| {
            let turned = DVec2::from_angle(states[which].yaw_rad - feet[which].heading_rad);
            0.5 * (sizes[which].length_m * turned.y.abs() + sizes[which].width_m * turned.x.abs())
        };
        let laterals_m = feet.map(|foot| foot.lateral_m);
        Self {
            laterals_m,
            gap_m: (laterals_m[1] - laterals_m[0]).abs() - half_width_m(0) - half_width_m(1),
        }
    }
}

/// The route, straight on beyond its ends, each position the mean of those around it: of as many as
/// the route's bend at `near` lets.
fn averaged_route(route_m: &[DVec2], near: DVec2) -> Option<Polyline> {
    let line = Polyline::new(route_m.iter().map(|point| point.extend(0.0)))?;
    let (length_m, middle_m) = (line.length_m(), line.project(near).arc_m);
    let end = |arc_m: f64, by_m: f64| {
        line.at(arc_m).truncate() + DVec2::from_angle(line.heading_at(arc_m)) * by_m
    };
    let at = |arc_m: f64| {
        if arc_m < 0.0 {
            end(0.0, arc_m)
        } else if arc_m > length_m {
            end(length_m, arc_m - length_m)
        } else {
            line.at(arc_m).truncate()
        }
    };
    let stride_m = STRIDE_M.max(length_m / STRIDES_MAX);
    let bends = |half: i64| {
        let span_m = half as f64 * stride_m;
        (line.heading_at(middle_m + span_m) - line.heading_at(middle_m - span_m)).abs()
            > AVERAGED_BEND_RAD
    };
    let half_max = (AVERAGED_M / stride_m).ceil() as i64;
    let half = (1..=half_max).rev().find(|&half| !bends(half)).unwrap_or(1);
    let last = (length_m / stride_m).ceil() as i64 + half;
    // From the route's start, so that the mean is as exact far from the world's origin.
    let origin = at(0.0);
    let mean = |middle: i64| {
        let sum: DVec2 = (middle - half..=middle + half)
            .map(|index| at(index as f64 * stride_m) - origin)
            .sum();
        (origin + sum / (2 * half + 1) as f64).extend(0.0)
    };
    Polyline::new((-half..=last).map(mean))
}
