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
    let poses = episode.instants().map(|instant| {
        let pose = Pose::from_yaw(instant.ego.yaw_rad, instant.ego.position_m.extend(0.0));
        TimedPose {
            time_s: instant.time_s,
            pose,
        }
    });
    let driven = Trajectory::new(poses.collect()).ok()?;
    let mut at = 0;
    let mut all = Vec::new();
    for step in &episode.steps {
        // A plan is made at the last moment before its step.
        let TimedPose { time_s, pose } = driven.poses()[at];
        all.extend(displacements(&step.plan, &pose, time_s, &driven));
        at += step.instants.len();
    }
    mean(all.into_iter())
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
