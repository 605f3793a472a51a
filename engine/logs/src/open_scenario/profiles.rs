//! Profiles: one speed after the other.

use decouplegs_asset::DecodeError;
use decouplegs_scene::story::Limits;

use super::Skipped;
use super::actions::{Action, USUAL_MPS2, limits};
use super::parameters::Node;

/// Most entries of a speed profile that are read.
const ENTRIES_MAX: usize = 256;

/// The speeds of a `<SpeedProfileAction>`.
pub(super) fn read(profile: Node, skipped: &mut Skipped) -> Result<Option<Action>, DecodeError> {
    if profile.attribute("entityRef")?.is_some() {
        skipped.add(profile, "a profile relative to an entity is not read");
        return Ok(None);
    }
    let limits = match profile.first("DynamicConstraints") {
        Some(constraints) => limits(Some(constraints), true)?,
        None => Limits {
            acceleration_mps2: Some(USUAL_MPS2),
            deceleration_mps2: Some(USUAL_MPS2),
            ..Limits::default()
        },
    };
    let (mut times_s, mut speeds_mps): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
    let mut limits_of_first = Limits::default();
    for entry in profile.all("SpeedProfileEntry") {
        if times_s.len() == ENTRIES_MAX {
            skipped.add(
                profile,
                &format!("more than {ENTRIES_MAX} entries are not read"),
            );
            return Ok(None);
        }
        let speed_mps = entry.number("speed")?;
        times_s.push(match (entry.attribute("time")?, speeds_mps.last()) {
            (Some(_), _) => entry.number("time")?.max(0.0),
            (None, Some(before_mps)) => limits.least_s(*before_mps, speed_mps),
            // The speed before is known when the action begins.
            (None, None) => {
                limits_of_first = limits;
                0.0
            }
        });
        speeds_mps.push(speed_mps);
    }
    Ok(Some(Action::Profile {
        times_s,
        speeds_mps,
        limits: limits_of_first,
    }))
}
