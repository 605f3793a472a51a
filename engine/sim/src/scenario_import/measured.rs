//! Conditions about the ego and the actor, which are asked while driving.

use decouplegs_logs::open_scenario::{Condition, Direction, Measure, Rule, Target};
use decouplegs_logs::scenario_file::DURATION_S_MAX;
use decouplegs_scene::scenario::{self, Measured, Party, Trigger};

use super::Import;

impl Import<'_> {
    /// The trigger of a condition about the actor and the ego, compared from `from_s` seconds on;
    /// `None` if it is about others.
    pub(super) fn measured(
        &self,
        condition: &Condition,
        from_s: f64,
        [actor, ego]: [usize; 2],
    ) -> Option<Trigger> {
        let party = |name: &str| match self.locator.find(name)? {
            found if found == actor => Some(Party::Agent),
            found if found == ego => Some(Party::Ego),
            _ => None,
        };
        // Distances have two ends, one of each.
        let is_pair = |of: &str, to: &str| Some(party(of)? != party(to)?);
        let sizes = [actor, ego].map(|entity| self.file.entities[entity].size);
        let lengths_m = sizes[0].length_m + sizes[1].length_m;
        let widths_m = sizes[0].width_m + sizes[1].width_m;
        let less = |is_less: bool, sizes_m: f64| if is_less { 0.5 * sizes_m } else { 0.0 };
        let (of, measure, less_m) = match &condition.measure {
            Measure::Speed { of } => (of, scenario::Measure::Speed, 0.0),
            Measure::Acceleration { of } => (of, scenario::Measure::Acceleration, 0.0),
            Measure::Traveled { of } => (of, scenario::Measure::Traveled, 0.0),
            Measure::Standing { of } => (of, scenario::Measure::Standing, 0.0),
            Measure::RelativeSpeed { of, to } if is_pair(of, to)? => {
                (of, scenario::Measure::RelativeSpeed, 0.0)
            }
            Measure::Distance {
                of,
                to: Target::Entity(to),
                direction,
                between_boxes,
            } if is_pair(of, to)? => {
                let (measure, sizes_m) = match direction {
                    Direction::Straight => (scenario::Measure::Distance, lengths_m),
                    Direction::Longitudinal => (scenario::Measure::Longitudinal, lengths_m),
                    Direction::Lateral => (scenario::Measure::Lateral, widths_m),
                };
                (of, measure, less(*between_boxes, sizes_m))
            }
            Measure::Distance {
                of,
                to: Target::Place(place),
                direction: Direction::Straight,
                between_boxes,
            } => {
                let point_m = self.locator.locate(place, &self.located).ok()?.point_m;
                let own_m = self.file.entities[self.locator.find(of)?].size.length_m;
                let measure = scenario::Measure::DistanceTo { point_m };
                (of, measure, less(*between_boxes, own_m))
            }
            Measure::Headway {
                of,
                to,
                between_boxes,
            } if is_pair(of, to)? => {
                let less_m = less(*between_boxes, lengths_m);
                (of, scenario::Measure::Headway, less_m)
            }
            Measure::TimeToCollision {
                of,
                to: Target::Entity(to),
                between_boxes,
            } if is_pair(of, to)? => {
                let less_m = less(*between_boxes, lengths_m);
                (of, scenario::Measure::TimeToCollision, less_m)
            }
            _ => return None,
        };
        let is_above = match condition.rule {
            Rule::Above => true,
            Rule::Below => false,
            Rule::Equal => return None,
        };
        // What comes later than any episode lasts never comes.
        if condition.delay_s > DURATION_S_MAX || from_s > DURATION_S_MAX {
            return None;
        }
        Some(Trigger::Measured(Measured {
            of: party(of)?,
            measure,
            less_m: less_m.min(1000.0),
            is_above,
            value: condition.value.clamp(-1e6, 1e6),
            from_s,
            delay_s: condition.delay_s,
        }))
    }
}
