//! The TOML form of an ego.

use std::collections::HashSet;

use decouplegs_scene::scenario::EgoTask;
use decouplegs_scene::{EgoIdentity, Egos, OtherEgo, Scenario, VehicleSize};
use serde::{Deserialize, Serialize};

use super::check::{ASSETS_MAX, Fault, Table, check_ego, check_name, within};
use super::form::{ScenarioForm, default_size_m};
use super::write::spanless;

/// Planners that a scenario file may name: those that start no program and read no file.
pub(super) const PLANNERS: [&str; 4] = ["constant-velocity", "lane-follow", "vision", "learned"];

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EgoForm {
    // Files with one ego read as they did before there were several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) name: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) asset: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) planner: Option<String>,
    pub(super) route: Vec<String>,
    pub(super) start_m: f64,
    pub(super) end_m: f64,
    pub(super) speed_mps: f64,
    pub(super) cruise_mps: f64,
    #[serde(default = "default_size_m")]
    pub(super) size_m: [f64; 3],
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) follows_recording: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) start_pose: Option<[f64; 3]>,
}

impl EgoForm {
    pub(super) fn new(ego: &EgoTask, identity: &EgoIdentity) -> Self {
        let default = EgoIdentity::default();
        Self {
            name: (identity.name != default.name).then(|| identity.name.clone()),
            asset: (identity.asset != default.asset).then_some(identity.asset),
            planner: identity.planner.clone(),
            route: ego.route.clone(),
            start_m: ego.start_m,
            end_m: ego.end_m,
            speed_mps: ego.speed_mps,
            cruise_mps: ego.cruise_mps,
            size_m: ego.size.to_array(),
            follows_recording: ego.follows_recording,
            start_pose: ego.start_pose,
        }
    }

    fn identity(&self) -> EgoIdentity {
        let default = EgoIdentity::default();
        EgoIdentity {
            name: self.name.clone().unwrap_or(default.name),
            asset: self.asset.unwrap_or(default.asset),
            planner: self.planner.clone(),
        }
    }

    pub(super) fn task(&self) -> EgoTask {
        EgoTask {
            route: self.route.clone(),
            start_m: self.start_m,
            end_m: self.end_m,
            speed_mps: self.speed_mps,
            cruise_mps: self.cruise_mps,
            size: VehicleSize::from_array(self.size_m),
            follows_recording: self.follows_recording,
            start_pose: self.start_pose,
        }
    }
}

/// Egos of a file.
pub(super) fn egos(form: &ScenarioForm) -> Egos {
    let other = |form: &toml::Spanned<EgoForm>| OtherEgo {
        identity: form.get_ref().identity(),
        task: form.get_ref().task(),
    };
    Egos {
        own: form.ego.get_ref().identity(),
        others: form.other_ego.iter().map(other).collect(),
    }
}

/// Tables of the other egos.
pub(super) fn other_forms(scenario: &Scenario) -> Vec<toml::Spanned<EgoForm>> {
    let others = scenario.egos.others.iter();
    others
        .map(|other| spanless(EgoForm::new(&other.task, &other.identity)))
        .collect()
}

/// Checks all egos. Adds their names to `names`.
pub(super) fn check_egos<'a>(
    scenario: &'a Scenario,
    names: &mut HashSet<&'a str>,
) -> Result<(), Fault> {
    let count = scenario.egos.count();
    if count > Egos::MAX {
        let reason = format!("{count} egos with [ego]; expected at most {}", Egos::MAX);
        return Err(Fault::new(Table::OtherEgo(Egos::MAX - 1), "name", reason));
    }
    for ego in 0..count {
        let table = match ego {
            0 => Table::Ego,
            _ => Table::OtherEgo(ego - 1),
        };
        check_ego(table, scenario.ego_task(ego))?;
        let identity = scenario.ego_identity(ego);
        check_identity(table, identity)?;
        // One ego alone has no name among others.
        if count > 1 && !names.insert(identity.name.as_str()) {
            let reason = format!("'{}' is taken; names must differ", identity.name);
            return Err(Fault::new(table, "name", reason));
        }
    }
    Ok(())
}

fn check_identity(table: Table, identity: &EgoIdentity) -> Result<(), Fault> {
    check_name(table, &identity.name)?;
    within(table, "asset", identity.asset, &(0..=ASSETS_MAX - 1))?;
    match &identity.planner {
        Some(planner) if !PLANNERS.contains(&planner.as_str()) => {
            let reason = format!(
                "'{planner}' is no planner that a scenario may name; expected {}. Name others on the command line, with --ego-planner",
                PLANNERS.join(", ")
            );
            Err(Fault::new(table, "planner", reason))
        }
        _ => Ok(()),
    }
}
