//! HUGSIM's own HD-Score: that of the plans, not of what was driven.
//!
//! Followed is hyzhou404/HUGSIM at 62c690d of November 2025: `closed_loop.py:49-96` for what a
//! frame is, `sim/utils/score_calculator.py` for its terms, `sim/hugsim_env/envs/hug_sim.py:174`
//! for route completion. A frame is a step: its plan, and the ego and the others when the step is
//! over; the plan is laid out from where the ego is then, as that code does. Poses of a plan are
//! 0.5 s apart, and the last one gives only the heading of the one before. Not judged are
//! collisions with splats of the background, which are in no log.

use std::f64::consts::PI;

use decouplegs_scene::VehicleState;
use decouplegs_scene::episode::{Episode, EpisodeTick};
use glam::DVec2;

use super::hd_score::{AHEAD_MPS2, AHEAD_S, HdScore, TermSums, YAW_RADPS, YAW_RADPS2};
use super::progress::route_completion;
use crate::oriented_box::OrientedBox;

/// Interval of a plan's poses, seconds (`closed_loop.py:91`).
const INTERVAL_S: f64 = 0.5;
/// Moments nearer than this are one, seconds.
const SAME_S: f64 = 1e-5;
/// A plan shorter than this has the heading of its start, meters (`score_calculator.py:501`).
const SHORT_M: f64 = 1.0;
/// Share of the route at which it counts as completed (`hug_sim.py:180`).
const ROUTE_SHARE: f64 = 0.9;
/// Cells along and across the ego's box in which there has to be road (`score_calculator.py:181`).
const CELLS: usize = 2;
/// Places of a cell at which road is looked for are no farther apart than this, meters: a strip of
/// road along its edge counts there, too.
const PLACES_M: f64 = 0.05;
/// Share of cells with road below which a plan leaves it.
const CELLS_SHARE: f64 = 0.3;
/// Greatest jerk ahead, m/s^3 (`score_calculator.py:20`, whose other bounds are those of nuPlan).
const AHEAD_MPS3: f64 = 8.37;

/// A pose of a plan, world coordinates.
#[derive(Clone, Copy, Debug)]
struct PlanPose {
    position_m: DVec2,
    yaw_rad: f64,
}

impl HdScore {
    /// The score of `episode` by HUGSIM's own formula, from its plans; `None` where no plan has
    /// three poses. `is_road` tells whether a place is on the road; without it the drivable area
    /// counts as kept.
    #[must_use]
    pub fn from_plans(episode: &Episode, is_road: Option<&dyn Fn(DVec2) -> bool>) -> Option<Self> {
        let ticks: Vec<&EpisodeTick> = episode.instants().collect();
        let size = &episode.head.scenario.ego.size;
        let outline = |pose: &PlanPose| OrientedBox {
            center_m: pose.position_m,
            yaw_rad: pose.yaw_rad,
            half_length_m: 0.5 * size.length_m,
            half_width_m: 0.5 * size.width_m,
        };
        let mut sums = TermSums::default();
        for step in &episode.steps {
            let Some(after) = step.instants.last() else {
                continue;
            };
            let last_s = step.plan.points()[step.plan.points().len() - 1].time_s;
            let count = (last_s / INTERVAL_S + 1e-6).floor() as usize;
            // The last pose is dropped, and two have to be left.
            if count < 3 {
                continue;
            }
            let poses = planned(&after.ego, count, |time_s| step.plan.at(time_s));
            let others = boxes_at(episode, &ticks, after.time_s, poses.len());
            let collides = |moved: &dyn Fn(usize) -> DVec2| {
                poses.iter().enumerate().any(|(index, pose)| {
                    let position_m = pose.position_m + moved(index);
                    let ego = outline(&PlanPose {
                        position_m,
                        ..*pose
                    });
                    let then = &others[index.min(others.len() - 1)];
                    then.iter().any(|other| other.overlaps(&ego))
                })
            };
            let velocity = |index: usize| {
                let at = index.max(1);
                (poses[at].position_m - poses[at - 1].position_m) / INTERVAL_S
            };
            let no_collision = !collides(&|_| DVec2::ZERO);
            let keeps_distance = !AHEAD_S
                .iter()
                .any(|ahead_s| collides(&|index| velocity(index) * *ahead_s));
            let keeps_road = is_road
                .is_none_or(|is_road| poses.iter().all(|pose| is_on_road(&outline(pose), is_road)));
            let comfort = is_comfortable(&poses);
            sums.add([no_collision, keeps_road, keeps_distance, comfort]);
        }
        let route_completion = (route_completion(episode) / ROUTE_SHARE).min(1.0);
        (!sums.is_empty()).then(|| sums.score(route_completion))
    }
}

/// The pose of `ego` and those of a plan of `count` positions, but for the last one.
fn planned(ego: &VehicleState, count: usize, at: impl Fn(f64) -> DVec2) -> Vec<PlanPose> {
    let turn = DVec2::from_angle(ego.yaw_rad);
    let place = |index: usize| ego.position_m + turn.rotate(at(INTERVAL_S * index as f64));
    let mut poses = vec![PlanPose {
        position_m: ego.position_m,
        yaw_rad: ego.yaw_rad,
    }];
    poses.extend((1..count).map(|index| {
        let (position_m, next_m) = (place(index), place(index + 1));
        let along = next_m - position_m;
        PlanPose {
            position_m,
            yaw_rad: along.y.atan2(along.x),
        }
    }));
    if poses[count - 1].position_m.distance(ego.position_m) < SHORT_M {
        poses.iter_mut().for_each(|pose| pose.yaw_rad = ego.yaw_rad);
    }
    poses
}

/// The boxes of the agents at `start_s` and every [`INTERVAL_S`] after it, at most `count` times
/// and no farther than the record reaches.
fn boxes_at(
    episode: &Episode,
    ticks: &[&EpisodeTick],
    start_s: f64,
    count: usize,
) -> Vec<Vec<OrientedBox>> {
    let at = |index: usize| {
        let time_s = start_s + INTERVAL_S * index as f64;
        let next = ticks.partition_point(|tick| tick.time_s < time_s - SAME_S);
        // Where steps do not divide the interval, the moment before.
        let tick = match ticks.get(next) {
            Some(tick) if tick.time_s <= time_s + SAME_S => tick,
            Some(_) => ticks.get(next.checked_sub(1)?)?,
            None => return None,
        };
        let agents = tick.agents.iter().zip(&episode.head.agent_sizes);
        let there = agents
            .filter_map(|(state, size)| Some(OrientedBox::for_vehicle(state.as_ref()?, size)));
        Some(there.collect())
    };
    (0..count).map_while(at).collect()
}

/// True if there is road in enough cells of `outline`.
fn is_on_road(outline: &OrientedBox, is_road: &dyn Fn(DVec2) -> bool) -> bool {
    let ahead = DVec2::from_angle(outline.yaw_rad);
    let half_m = [outline.half_length_m, outline.half_width_m];
    let places = half_m.map(|half_m| {
        (2.0 * half_m / CELLS as f64 / PLACES_M)
            .ceil()
            .clamp(1.0, 200.0)
    });
    let places = places.map(|count| count as usize);
    let place = |cell: [usize; 2], within: [usize; 2]| {
        let share = |axis: usize| {
            let in_cell = (within[axis] as f64 + 0.5) / places[axis] as f64;
            2.0 * (cell[axis] as f64 + in_cell) / CELLS as f64 - 1.0
        };
        outline.center_m
            + ahead * (outline.half_length_m * share(0))
            + ahead.perp() * (outline.half_width_m * share(1))
    };
    let grid = |[rows, columns]: [usize; 2]| {
        (0..rows * columns).map(move |index| [index / columns, index % columns])
    };
    let has_road = |cell: &[usize; 2]| grid(places).any(|within| is_road(place(*cell, within)));
    let cells = grid([CELLS; 2]).filter(has_road).count();
    cells as f64 / (CELLS * CELLS) as f64 >= CELLS_SHARE
}

/// True if a plan keeps the bounds of comfort; one of less than four poses does.
fn is_comfortable(poses: &[PlanPose]) -> bool {
    if poses.len() < 4 {
        return true;
    }
    let differences = |values: &[f64]| -> Vec<f64> {
        let pairs = values.windows(2);
        pairs.map(|pair| (pair[1] - pair[0]) / INTERVAL_S).collect()
    };
    let speeds: Vec<f64> = poses
        .windows(2)
        .map(|pair| (pair[1].position_m - pair[0].position_m).length() / INTERVAL_S)
        .collect();
    let yaw_rates: Vec<f64> = poses
        .windows(2)
        .map(|pair| {
            let turn_rad = pair[1].yaw_rad - pair[0].yaw_rad;
            // Once, as there: headings are from -pi to pi.
            match turn_rad {
                _ if turn_rad > PI => (turn_rad - 2.0 * PI) / INTERVAL_S,
                _ if turn_rad < -PI => (turn_rad + 2.0 * PI) / INTERVAL_S,
                _ => turn_rad / INTERVAL_S,
            }
        })
        .collect();
    let accelerations = differences(&speeds);
    let within = |values: &[f64], most: f64| values.iter().all(|value| value.abs() <= most);
    accelerations
        .iter()
        .all(|ahead| (AHEAD_MPS2[0]..=AHEAD_MPS2[1]).contains(ahead))
        && within(&differences(&accelerations), AHEAD_MPS3)
        && within(&differences(&yaw_rates), YAW_RADPS2)
        && within(&yaw_rates, YAW_RADPS)
}
