//! The tables `when` and `after` of a trigger.

use decouplegs_scene::scenario::{After, Measure, Measured, Party, Trigger};
use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::check::{Fault, Table};

#[derive(Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WhenForm {
    measure: String,
    of: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    below: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    above: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    point_m: Option<[f64; 2]>,
    #[serde(default)]
    less_m: f64,
    #[serde(default)]
    from_s: f64,
    #[serde(default)]
    delay_s: f64,
}

/// Name of the distance to a point, which has a key of its own.
const DISTANCE_TO: &str = "distance_to";

impl WhenForm {
    pub(super) fn new(measured: &Measured) -> Self {
        let (measure, point_m) = match measured.measure {
            Measure::DistanceTo { point_m } => (DISTANCE_TO, Some(point_m.to_array())),
            measure => (name(&Measure::NAMED, measure), None),
        };
        Self {
            measure: measure.into(),
            of: name(&Party::NAMED, measured.of).into(),
            below: (!measured.is_above).then_some(measured.value),
            above: measured.is_above.then_some(measured.value),
            point_m,
            less_m: measured.less_m,
            from_s: measured.from_s,
            delay_s: measured.delay_s,
        }
    }

    pub(super) fn trigger(&self, table: Table) -> Result<Trigger, Fault> {
        let fault = |reason: String| Err(Fault::new(table, "when", reason));
        let Some(of) = by_name(&Party::NAMED, &self.of) else {
            let reason = format!("of '{}' is unknown; there are ego, agent", self.of);
            return fault(reason);
        };
        let measure = match (self.measure.as_str(), self.point_m) {
            (DISTANCE_TO, Some(point_m)) => Measure::DistanceTo {
                point_m: DVec2::from_array(point_m),
            },
            (DISTANCE_TO, None) => {
                return fault(format!("'{DISTANCE_TO}' needs point_m"));
            }
            (measure, Some(_)) => {
                return fault(format!("'{measure}' has no point_m"));
            }
            (measure, None) => match by_name(&Measure::NAMED, measure) {
                Some(measure) => measure,
                None => {
                    let known: Vec<&str> = Measure::NAMED.iter().map(|(name, _)| *name).collect();
                    let known = known.join(", ");
                    return fault(format!(
                        "the measure '{measure}' is unknown; there are {known}, {DISTANCE_TO}"
                    ));
                }
            },
        };
        let (is_above, value) = match (self.above, self.below) {
            (Some(above), None) => (true, above),
            (None, Some(below)) => (false, below),
            _ => return fault("give either 'below' or 'above'".into()),
        };
        Ok(Trigger::Measured(Measured {
            of,
            measure,
            less_m: self.less_m,
            is_above,
            value,
            from_s: self.from_s,
            delay_s: self.delay_s,
        }))
    }
}

#[derive(Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AfterForm {
    /// Number of the behavior in the file, from 1.
    behavior: usize,
    #[serde(default)]
    is_over: bool,
    #[serde(default)]
    from_s: f64,
    #[serde(default)]
    delay_s: f64,
}

impl AfterForm {
    pub(super) fn new(after: &After) -> Self {
        Self {
            behavior: after.behavior + 1,
            is_over: after.is_over,
            from_s: after.from_s,
            delay_s: after.delay_s,
        }
    }

    pub(super) fn trigger(&self, table: Table) -> Result<Trigger, Fault> {
        let Some(behavior) = self.behavior.checked_sub(1) else {
            let reason = "behavior 0; behaviors of an agent count from 1";
            return Err(Fault::new(table, "after", reason.into()));
        };
        Ok(Trigger::After(After {
            behavior,
            is_over: self.is_over,
            from_s: self.from_s,
            delay_s: self.delay_s,
        }))
    }
}

fn by_name<T: Copy>(named: &[(&str, T)], wanted: &str) -> Option<T> {
    let found = named.iter().find(|(name, _)| *name == wanted);
    found.map(|(_, value)| *value)
}

fn name<T: Copy + PartialEq>(named: &[(&'static str, T)], wanted: T) -> &'static str {
    let found = named.iter().find(|(_, value)| *value == wanted);
    found.map_or("", |(name, _)| name)
}
