//! Topics of the drive: motion and plans of the ego, quantities over time, infractions.

use std::fs::File;
use std::io::BufWriter;

use anyhow::Result;
use decouplegs::drive::score::{EpisodeScore, Quantity, quantities};
use decouplegs::episode::{Moment, Moments};
use decouplegs::scene::episode::Episode;
use decouplegs::scene::{Plan, Pose};
use decouplegs_recording::ros::{
    FLOAT64, LOG, McapLog, ODOMETRY, PATH, Topic, Transform, float64, odometry, path, warning,
};

use super::{BASE, MAP, time_ns};

/// Messages of the drive, in the order of time.
pub struct DriveTopics {
    odometry: Topic,
    plan: Topic,
    infractions: Topic,
    quantities: Vec<(Topic, Quantity)>,
    moments: Vec<Moment>,
    plans: Vec<Plan>,
    /// Times and texts of infractions, in the order of time.
    infracted: Vec<(f64, String)>,
    /// Moments that are written.
    written: usize,
    /// Infractions that are written.
    written_infractions: usize,
}

impl DriveTopics {
    /// Adds the topics of `episode`, whose worlds are `moments`, to `log`.
    pub fn new(log: &mut McapLog<BufWriter<File>>, episode: &Episode, moments: &Moments) -> Self {
        let score = EpisodeScore::new(episode);
        let known = quantities(episode, &score).into_iter();
        let quantities = known.map(|quantity| {
            let name = format!("/episode/{}", quantity.key);
            (log.topic(&name, FLOAT64, false), quantity)
        });
        let quantities = quantities.collect();
        Self {
            odometry: log.topic("/odom", ODOMETRY, false),
            plan: log.topic("/plan", PATH, false),
            infractions: log.topic("/infractions", LOG, false),
            quantities,
            moments: moments.as_slice().to_vec(),
            plans: episode.steps.iter().map(|step| step.plan.clone()).collect(),
            infracted: score.described(&episode.head),
            written: 0,
            written_infractions: 0,
        }
    }

    /// Adds all messages of moments until `time_s` that are not written yet.
    pub fn add_until(&mut self, log: &mut McapLog<BufWriter<File>>, time_s: f64) -> Result<()> {
        while let Some(moment) = self.moments.get(self.written) {
            if moment.time_s > time_s {
                break;
            }
            let at_ns = time_ns(moment.time_s);
            let ego = Transform {
                parent: MAP.into(),
                child: BASE.into(),
                pose: moment.ego,
            };
            log.add(self.odometry, at_ns, &odometry(at_ns, &ego, &moment.motion))?;
            for (topic, quantity) in &self.quantities {
                if let Some(value) = quantity.values[self.written] {
                    log.add(*topic, at_ns, &float64(value))?;
                }
            }
            if let Some(plan) = moment.step.and_then(|step| self.plans.get(step as usize)) {
                let way = way_of(plan, moment);
                log.add(self.plan, at_ns, &path(at_ns, MAP, &way))?;
            }
            while let Some((begin_s, text)) = self.infracted.get(self.written_infractions) {
                if *begin_s > moment.time_s {
                    break;
                }
                log.add(self.infractions, at_ns, &warning(at_ns, "score", text))?;
                self.written_infractions += 1;
            }
            self.written += 1;
        }
        Ok(())
    }
}

/// Poses of the ego along `plan`, made at `moment`, in the world, with their times in nanoseconds.
/// Each looks where the way leads to it from the one before.
fn way_of(plan: &Plan, moment: &Moment) -> Vec<(u64, Pose)> {
    let mut way = vec![(time_ns(moment.time_s), moment.ego)];
    let (mut before_m, mut yaw_rad) = (glam::DVec2::ZERO, 0.0);
    for point in plan.points() {
        let moved_m = point.position_m - before_m;
        if moved_m.length() > 0.01 {
            yaw_rad = moved_m.to_angle();
        }
        before_m = point.position_m;
        let local = Pose::from_yaw(yaw_rad, point.position_m.extend(0.0));
        way.push((
            time_ns(moment.time_s + point.time_s),
            moment.ego.then(&local),
        ));
    }
    way
}
