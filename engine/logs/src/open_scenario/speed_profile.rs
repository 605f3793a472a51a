//! Parts of actions: speeds of a `<SpeedProfileAction>`, as one change of speed after the other.

use decouplegs_asset::DecodeError;

use super::conditions::{Condition, EventTrigger, Measure, Rule};
use super::parameters::Node;
use super::{Action, Skipped, TargetSpeed, Transition};

/// Most entries of a profile that are read.
const ENTRIES_MAX: usize = 256;

/// Action, or one change of speed of a profile.
pub(super) struct Part {
    /// The action.
    pub action: Action,
    /// Time between the start of the profile and of this part, seconds.
    pub begin_s: f64,
    /// Duration of the part, seconds, where it is known; of the first, that of the whole profile.
    pub duration_s: Option<f64>,
}

/// The parts of the profile in a `<PrivateAction>`; `None` if it holds none, an empty list if the
/// profile is of a kind that is not read.
pub(super) fn read(private: Node, skipped: &mut Skipped) -> Result<Option<Vec<Part>>, DecodeError> {
    let profile = private
        .first("LongitudinalAction")
        .and_then(|action| action.first("SpeedProfileAction"));
    let Some(profile) = profile else {
        return Ok(None);
    };
    if profile.attribute("entityRef")?.is_some() {
        skipped.add(profile, "a profile relative to an entity is not read");
        return Ok(Some(Vec::new()));
    }
    let mut parts: Vec<Part> = Vec::new();
    let mut begin_s = 0.0;
    for entry in profile.all("SpeedProfileEntry") {
        if parts.len() == ENTRIES_MAX {
            skipped.add(
                profile,
                &format!("more than {ENTRIES_MAX} entries are not read"),
            );
            break;
        }
        if entry.attribute("time")?.is_none() {
            skipped.add(profile, "a profile without times is not read");
            return Ok(Some(Vec::new()));
        }
        let time_s = entry.number("time")?.max(0.0);
        let transition = if time_s > 0.0 {
            Transition::Time(time_s)
        } else {
            Transition::Step
        };
        parts.push(Part {
            action: Action::Speed {
                target: TargetSpeed::Absolute(entry.number("speed")?),
                transition,
            },
            begin_s,
            duration_s: Some(time_s),
        });
        begin_s += time_s;
    }
    if let Some(first) = parts.first_mut() {
        first.duration_s = Some(begin_s);
    }
    Ok(Some(parts))
}

/// `trigger`, `more_s` seconds later.
pub(super) fn later(trigger: &EventTrigger, line: u32, more_s: f64) -> EventTrigger {
    let mut trigger = trigger.clone();
    if more_s == 0.0 {
        return trigger;
    }
    for condition in trigger.stages.iter_mut().flatten().flatten() {
        condition.delay_s += more_s;
    }
    if trigger.stages.is_empty() {
        trigger.stages.push(vec![vec![Condition {
            line,
            measure: Measure::Time,
            rule: Rule::Above,
            value: 0.0,
            delay_s: more_s,
        }]]);
    }
    trigger
}
