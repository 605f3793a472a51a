//! Global actions that concern entities, variables, parameters and traffic signals.

use decouplegs_asset::DecodeError;
use decouplegs_scene::story::Change;

use super::Skipped;
use super::actions::{Action, Read};
use super::catalogs::Catalogs;
use super::parameters::Node;
use super::{positions, signals};

/// The global action `inner` of the kind `kind`; `None` if it is not read.
pub(super) fn read(
    kind: Node,
    inner: Option<Node>,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Read, DecodeError> {
    let unknown = |skipped: &mut Skipped| {
        skipped.add(inner.unwrap_or(kind), "actions of this kind are not read");
        Ok(None)
    };
    let set = |inner: Node, variable: String| -> Result<Option<Action>, DecodeError> {
        let value = |node: Node| node.needed_attribute("value").map(String::from);
        Ok(match inner.name() {
            "SetAction" => Some(Action::Set {
                variable,
                value: value(inner)?,
                by: Change::Set,
            }),
            "ModifyAction" => {
                let rule = inner.needed("Rule")?;
                let by = rule.elements().next();
                match by.map(|by| (by.name(), by)) {
                    Some(("AddValue", by)) => Some(Action::Set {
                        variable,
                        value: value(by)?,
                        by: Change::Add,
                    }),
                    Some(("MultiplyByValue", by)) => Some(Action::Set {
                        variable,
                        value: value(by)?,
                        by: Change::Multiply,
                    }),
                    _ => None,
                }
            }
            _ => None,
        })
    };
    let named = |attribute: &str| -> Result<String, DecodeError> {
        let element = kind.element();
        Ok(element
            .needed_attribute(attribute)?
            .trim_start_matches('$')
            .to_owned())
    };
    match (kind.name(), inner) {
        ("ParameterAction" | "VariableAction", Some(inner)) => {
            let attribute = match kind.name() {
                "ParameterAction" => "parameterRef",
                _ => "variableRef",
            };
            match set(inner, named(attribute)?)? {
                Some(action) => Ok(Some(vec![(None, action)])),
                None => unknown(skipped),
            }
        }
        ("EntityAction", Some(inner)) => {
            let entity = Some(kind.needed_attribute("entityRef")?.into_owned());
            if inner.name() == "DeleteEntityAction" {
                return Ok(Some(vec![(entity, Action::Show(false))]));
            }
            let place = match inner.first("Position") {
                Some(place) => positions::read(place, catalogs, skipped)?,
                None => None,
            };
            let Some(place) = place.filter(|_| inner.name() == "AddEntityAction") else {
                return unknown(skipped);
            };
            let actions = [Action::Teleport(place), Action::Show(true)];
            Ok(Some(actions.map(|action| (entity.clone(), action)).into()))
        }
        ("InfrastructureAction", Some(inner)) => {
            let action = inner.elements().next();
            match action.map(|action| (action.name(), action)) {
                Some(("TrafficSignalStateAction", action)) => {
                    let state = action.needed_attribute("state")?;
                    let signal = action.needed_attribute("name")?.into_owned();
                    let color = signals::known(action, &state, skipped);
                    Ok(color.map(|color| vec![(None, Action::Signal { signal, color })]))
                }
                Some(("TrafficSignalControllerAction", action)) => {
                    let named = signals::phase(action, skipped)?;
                    let phase = |(controller, phase)| Action::Phase { controller, phase };
                    Ok(named.map(|named| vec![(None, phase(named))]))
                }
                _ => unknown(skipped),
            }
        }
        ("EnvironmentAction", _) => {
            skipped.add(kind, "light and weather change at the start only");
            Ok(None)
        }
        _ => unknown(skipped),
    }
}
