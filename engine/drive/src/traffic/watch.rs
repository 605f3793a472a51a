//! Triggers that compare a measured value of an agent or the ego with a limit.

use decouplegs_scene::VehicleState;
use decouplegs_scene::scenario::{Measure, Measured, Party};
use glam::DVec2;

/// Speed up to which a vehicle stands, m/s.
const STANDING_MPS: f64 = 0.01;

/// Memory of a trigger that waits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Watch {
    last_m: Option<DVec2>,
    traveled_m: f64,
    standing_since_s: Option<f64>,
    met_s: Option<f64>,
}

impl Watch {
    /// True once `trigger` has been met for its delay. It is asked at each step until then; `own`
    /// is the agent.
    pub(super) fn is_due(
        &mut self,
        trigger: &Measured,
        time_s: f64,
        own: &VehicleState,
        ego: Option<&VehicleState>,
    ) -> bool {
        if self.met_s.is_none() {
            let (of, other) = match trigger.of {
                Party::Agent => (Some(own), ego),
                Party::Ego => (ego, Some(own)),
            };
            let Some(of) = of else {
                return false;
            };
            self.follow(of, time_s);
            let value = self.value(trigger, time_s, of, other);
            let holds = value.is_some_and(|value| match trigger.is_above {
                true => value >= trigger.value,
                false => value <= trigger.value,
            });
            if holds && time_s >= trigger.from_s {
                self.met_s = Some(time_s);
            }
        }
        self.met_s
            .is_some_and(|met_s| time_s >= met_s + trigger.delay_s)
    }

    /// True once `holds` has been true from a time on, and a delay has passed. It is asked at each
    /// step until then.
    pub(super) fn is_past(
        &mut self,
        holds: bool,
        (from_s, delay_s): (f64, f64),
        time_s: f64,
    ) -> bool {
        if self.met_s.is_none() && holds && time_s >= from_s {
            self.met_s = Some(time_s);
        }
        self.met_s.is_some_and(|met_s| time_s >= met_s + delay_s)
    }

    fn follow(&mut self, of: &VehicleState, time_s: f64) {
        if let Some(last_m) = self.last_m {
            self.traveled_m += of.position_m.distance(last_m);
        }
        self.last_m = Some(of.position_m);
        self.standing_since_s = match self.standing_since_s {
            _ if of.speed_mps > STANDING_MPS => None,
            None => Some(time_s),
            since => since,
        };
    }

    /// The value; `None` while it has none.
    fn value(
        &self,
        trigger: &Measured,
        time_s: f64,
        of: &VehicleState,
        other: Option<&VehicleState>,
    ) -> Option<f64> {
        let apart_m = |to: &VehicleState| to.position_m - of.position_m;
        let gap_m = |distance_m: f64| (distance_m - trigger.less_m).max(0.0);
        Some(match trigger.measure {
            Measure::Speed => of.speed_mps,
            Measure::Acceleration => of.acceleration_mps2,
            Measure::RelativeSpeed => of.speed_mps - other?.speed_mps,
            Measure::Traveled => self.traveled_m,
            Measure::Standing => time_s - self.standing_since_s?,
            Measure::DistanceTo { point_m } => gap_m(of.position_m.distance(point_m)),
            Measure::Distance => gap_m(apart_m(other?).length()),
            Measure::Longitudinal => gap_m(apart_m(other?).dot(of.ahead()).abs()),
            Measure::Lateral => gap_m(apart_m(other?).perp_dot(of.ahead()).abs()),
            Measure::Headway => {
                let along_m = apart_m(other?).dot(of.ahead());
                if along_m < 0.0 {
                    return None;
                }
                over(gap_m(along_m), of.speed_mps)
            }
            Measure::TimeToCollision => {
                let other = other?;
                let apart_m = apart_m(other);
                let velocity_mps = of.speed_mps * of.ahead() - other.speed_mps * other.ahead();
                let closing_mps = velocity_mps.dot(apart_m.normalize_or_zero());
                over(gap_m(apart_m.length()), closing_mps)
            }
        })
    }
}

/// Time to go `way_m` at `speed_mps`, seconds: without end where it does not come nearer.
fn over(way_m: f64, speed_mps: f64) -> f64 {
    if way_m == 0.0 {
        0.0
    } else if speed_mps > 0.0 {
        way_m / speed_mps
    } else {
        f64::INFINITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(x_m: f64, y_m: f64, yaw_rad: f64, speed_mps: f64) -> VehicleState {
        VehicleState {
            position_m: DVec2::new(x_m, y_m),
            yaw_rad,
            speed_mps,
            acceleration_mps2: -1.5,
        }
    }

    fn measured(measure: Measure, value: f64) -> Measured {
        Measured {
            of: Party::Agent,
            measure,
            less_m: 0.0,
            is_above: true,
            value,
            from_s: 0.0,
            delay_s: 0.0,
        }
    }

    /// The value that `measure` has for an agent at the origin and an ego 30 m ahead and 4 m left.
    fn value(measure: Measure, less_m: f64) -> f64 {
        let trigger = Measured {
            less_m,
            ..measured(measure, 0.0)
        };
        let (own, ego) = (state(0.0, 0.0, 0.0, 15.0), state(30.0, 4.0, 0.0, 10.0));
        let watch = Watch::default();
        watch.value(&trigger, 0.0, &own, Some(&ego)).unwrap()
    }

    #[test]
    fn each_measure_has_the_value_of_its_formula() {
        let line_m = (30.0f64 * 30.0 + 4.0 * 4.0).sqrt();
        let point_m = DVec2::new(-3.0, 4.0);
        for (measure, less_m, expected) in [
            (Measure::Speed, 0.0, 15.0),
            (Measure::Acceleration, 0.0, -1.5),
            (Measure::RelativeSpeed, 0.0, 5.0),
            (Measure::DistanceTo { point_m }, 0.0, 5.0),
            (Measure::Distance, 0.0, line_m),
            (Measure::Distance, 40.0, 0.0),
            (Measure::Longitudinal, 4.5, 25.5),
            (Measure::Lateral, 0.0, 4.0),
            (Measure::Headway, 0.0, 2.0),
            (Measure::Headway, 4.5, 1.7),
            (
                Measure::TimeToCollision,
                0.0,
                line_m / (5.0 * 30.0 / line_m),
            ),
        ] {
            let found = value(measure, less_m);
            assert!((found - expected).abs() < 1e-12, "{measure:?}: {found}");
        }
    }

    #[test]
    fn who_is_behind_or_falls_back_has_no_headway_and_no_collision() {
        let (own, ego) = (state(0.0, 0.0, 0.0, 15.0), state(-30.0, 0.0, 0.0, 10.0));
        let watch = Watch::default();
        let headway = measured(Measure::Headway, 0.0);
        assert_eq!(watch.value(&headway, 0.0, &own, Some(&ego)), None);
        let collision = measured(Measure::TimeToCollision, 0.0);
        let never = watch.value(&collision, 0.0, &own, Some(&ego));
        assert_eq!(never, Some(f64::INFINITY));
        assert_eq!(watch.value(&collision, 0.0, &own, None), None);
    }

    /// Time at which a trigger is due, for a vehicle that stands until 1 s and drives 10 m/s then.
    fn due_s(trigger: &Measured) -> Option<f64> {
        let mut watch = Watch::default();
        (0..100).find_map(|step| {
            let time_s = f64::from(step) * 0.1;
            let x_m = (10.0 * (time_s - 1.0)).max(0.0);
            let own = state(x_m, 0.0, 0.0, if step < 10 { 0.0 } else { 10.0 });
            watch
                .is_due(trigger, time_s, &own, None)
                .then_some(f64::from(step) / 10.0)
        })
    }

    #[test]
    fn ways_and_stands_count_from_the_start_and_delays_after_them() {
        let traveled = measured(Measure::Traveled, 19.95);
        assert_eq!(due_s(&traveled), Some(3.0));
        assert_eq!(due_s(&measured(Measure::Standing, 0.45)), Some(0.5));
        let delayed = Measured {
            delay_s: 1.95,
            ..traveled
        };
        assert_eq!(due_s(&delayed), Some(5.0));
        let later = Measured {
            from_s: 5.95,
            ..traveled
        };
        assert_eq!(due_s(&later), Some(6.0));
        let never = Measured {
            delay_s: 1e308,
            ..traveled
        };
        assert_eq!(due_s(&never), None);
        let of_ego = Measured {
            of: Party::Ego,
            ..traveled
        };
        assert_eq!(due_s(&of_ego), None);
    }
}
