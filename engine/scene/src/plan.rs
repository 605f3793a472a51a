//! Plan of a planner: the positions of the ego vehicle in the next seconds.

use crate::Invalid;
use glam::DVec2;

/// Position of the ego at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanPoint {
    /// Time after the observation that was planned from, seconds, above zero.
    pub time_s: f64,
    /// Middle of the ego's box, in the ego's frame at that observation: x forward, y left, meters.
    pub position_m: DVec2,
}

/// A trajectory for the ego, from where it stands at the observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    points: Vec<PlanPoint>,
}

impl Plan {
    /// Most points of a plan. A plan of UniAD or VAD has 6.
    pub const POINTS_MAX: usize = 256;
    /// Latest time of a plan, seconds.
    pub const HORIZON_S_MAX: f64 = 30.0;
    /// Farthest point of a plan, meters.
    pub const DISTANCE_M_MAX: f64 = 2000.0;

    /// A plan through `points`.
    ///
    /// # Errors
    /// A sentence naming what is wrong: no points or too many, a number that is not finite, time
    /// that does not rise, a position or a time out of range.
    pub fn new(points: Vec<PlanPoint>) -> Result<Self, Invalid> {
        if points.is_empty() || points.len() > Self::POINTS_MAX {
            return Err(Invalid::new(format!(
                "a plan of {} points; expected 1 to {}",
                points.len(),
                Self::POINTS_MAX
            )));
        }
        let mut before_s = 0.0;
        for (index, PlanPoint { time_s, position_m }) in points.iter().enumerate() {
            if !(time_s.is_finite() && position_m.is_finite()) {
                return Err(Invalid::new(format!(
                    "point {index} of the plan has a time or a position that is not finite"
                )));
            }
            if *time_s <= before_s || *time_s > Self::HORIZON_S_MAX {
                let horizon_s = Self::HORIZON_S_MAX;
                return Err(Invalid::new(format!(
                    "point {index} of the plan is at {time_s} s; expected more than {before_s}, at most {horizon_s}"
                )));
            }
            if position_m.length() > Self::DISTANCE_M_MAX {
                let limit_m = Self::DISTANCE_M_MAX;
                return Err(Invalid::new(format!(
                    "point {index} of the plan is {:.0} m away; expected at most {limit_m}",
                    position_m.length()
                )));
            }
            before_s = *time_s;
        }
        Ok(Self { points })
    }

    /// Standing still: one point at the ego's own position.
    #[must_use]
    pub fn standing() -> Self {
        Self {
            points: vec![PlanPoint {
                time_s: 1.0,
                position_m: DVec2::ZERO,
            }],
        }
    }

    /// Points, at least one, with increasing times.
    #[must_use]
    pub fn points(&self) -> &[PlanPoint] {
        &self.points
    }

    /// Position `time_s` after the observation: linear between points and from the ego's position
    /// at zero, and the last point beyond it.
    #[must_use]
    pub fn at(&self, time_s: f64) -> DVec2 {
        let next = self.points.partition_point(|point| point.time_s <= time_s);
        let before = next.checked_sub(1).map_or((0.0, DVec2::ZERO), |at| {
            (self.points[at].time_s, self.points[at].position_m)
        });
        match self.points.get(next) {
            Some(after) => {
                let share = ((time_s - before.0) / (after.time_s - before.0)).clamp(0.0, 1.0);
                before.1.lerp(after.position_m, share)
            }
            None => before.1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(time_s: f64, x: f64) -> PlanPoint {
        PlanPoint {
            time_s,
            position_m: DVec2::new(x, 0.0),
        }
    }

    #[test]
    fn a_plan_is_joined_from_the_ego_on() {
        let plan = Plan::new(vec![point(1.0, 4.0), point(2.0, 10.0)]).unwrap();
        assert_eq!(
            [0.0, 0.5, 1.0, 1.5, 2.0, 9.0].map(|time_s| plan.at(time_s).x),
            [0.0, 2.0, 4.0, 7.0, 10.0, 10.0]
        );
        assert_eq!(
            (Plan::standing().at(0.3), plan.at(-1.0)),
            (DVec2::ZERO, DVec2::ZERO)
        );
    }

    #[test]
    fn what_cannot_be_driven_is_refused_with_its_place() {
        let refused = |points: Vec<PlanPoint>| Plan::new(points).unwrap_err();
        assert!(refused(vec![]).reason().contains("0 points"));
        assert!(
            refused(vec![point(1.0, 1.0); 257])
                .reason()
                .contains("257 points")
        );
        assert!(
            refused(vec![point(1.0, 1.0), point(2.0, f64::NAN)])
                .reason()
                .contains("point 1")
        );
        assert!(
            refused(vec![point(f64::INFINITY, 1.0)])
                .reason()
                .contains("not finite")
        );
        assert!(
            refused(vec![point(1.0, 1.0), point(1.0, 2.0)])
                .reason()
                .contains("more than 1")
        );
        assert!(
            refused(vec![point(0.0, 1.0)])
                .reason()
                .contains("more than 0")
        );
        assert!(
            refused(vec![point(31.0, 1.0)])
                .reason()
                .contains("at most 30")
        );
        assert!(
            refused(vec![point(1.0, 1e9)])
                .reason()
                .contains("1000000000 m away")
        );
    }
}
