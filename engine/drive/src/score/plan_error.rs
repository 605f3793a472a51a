//! Distance between plans and the driven path.

use decouplegs_scene::{Episode, Plan, Pose, TimedPose, Trajectory};

/// Mean distance, meters, from above, between where `plan` wants the ego and where `reference` has
/// it at the same time. The plan was made at `time_s` of the reference, at `pose`. Points of the
/// plan beyond the reference's end do not count; `None` where none does. (The average displacement
/// error of trajectory forecasting: Pellegrini, Ess, Schindler and van Gool, "You'll Never Walk
/// Alone", 2009.)
#[must_use]
pub fn plan_ade_m(plan: &Plan, pose: &Pose, time_s: f64, reference: &Trajectory) -> Option<f64> {
    mean(displacements(plan, pose, time_s, reference))
}

/// The mean over all plans of an episode and their points, against what was driven.
pub(super) fn episode_ade_m(episode: &Episode) -> Option<f64> {
    let plans = displacements_of_plans(episode);
    mean(plans.into_iter().flat_map(|(_, distances_m)| distances_m))
}

/// Mean distance of each plan of an episode from what was driven, meters, with the time at which it
/// was made, seconds. Plans that reach into nothing that was driven are left out.
#[must_use]
pub fn plan_errors(episode: &Episode) -> Vec<(f64, f64)> {
    let plans = displacements_of_plans(episode).into_iter();
    plans
        .filter_map(|(time_s, distances_m)| Some((time_s, mean(distances_m.into_iter())?)))
        .collect()
}

/// The time of each plan, and the distances of its points from what was driven.
fn displacements_of_plans(episode: &Episode) -> Vec<(f64, Vec<f64>)> {
    let poses = episode.instants().map(|instant| {
        let pose = Pose::from_yaw(instant.ego.yaw_rad, instant.ego.position_m.extend(0.0));
        TimedPose {
            time_s: instant.time_s,
            pose,
        }
    });
    let Ok(driven) = Trajectory::new(poses.collect()) else {
        return Vec::new();
    };
    let mut at = 0;
    let mut all = Vec::with_capacity(episode.steps.len());
    for step in &episode.steps {
        // A plan is made at the last moment before its step.
        let TimedPose { time_s, pose } = driven.poses()[at];
        let distances_m = displacements(&step.plan, &pose, time_s, &driven);
        all.push((time_s, distances_m.collect()));
        at += step.instants.len();
    }
    all
}

fn displacements(
    plan: &Plan,
    pose: &Pose,
    time_s: f64,
    reference: &Trajectory,
) -> impl Iterator<Item = f64> {
    let within = plan
        .points()
        .iter()
        .filter(move |point| time_s + point.time_s <= reference.end_s() + 1e-9);
    within.map(move |point| {
        let planned = pose.transform(point.position_m.extend(0.0));
        (planned - reference.at(time_s + point.time_s).translation)
            .truncate()
            .length()
    })
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| {
        (sum + value, count + 1)
    });
    (count > 0).then(|| sum / count as f64)
}
