//! Traffic signals: controllers and their phases, and states.

use std::collections::{HashMap, HashSet};

use decouplegs_scene::{LightColor, LightPhase};

use super::parameters::Node;
use super::{SignalController, SignalPhases, Skipped};
use decouplegs_asset::DecodeError;

/// Most phases of a controller that are read.
const PHASES_MAX: usize = 100;
/// Most phases of all signals together: a signal that is named once has as many as its controller.
const ALL_PHASES_MAX: usize = 1_000_000;
/// Most controllers that begin one after the other.
const CHAIN_MAX: usize = 16;
/// Shortest and longest phase, seconds: those of scenario files.
const PHASE_S: std::ops::RangeInclusive<f64> = 0.1..=3600.0;

/// Controllers of the road network, and the phases of their signals.
#[derive(Default)]
pub(super) struct Signals {
    pub phases: Vec<SignalPhases>,
    pub controllers: Vec<SignalController>,
}

/// A controller, and the colors of its signals by phase; `None` where a phase does not tell one.
struct Read<'a> {
    controller: SignalController,
    /// Seconds after which its first phase begins, and the controller after whose first phase that
    /// counts.
    delay_s: f64,
    after: Option<String>,
    signals: Vec<(String, Vec<Option<LightColor>>)>,
    element: Node<'a>,
}

/// All controllers of the road network.
pub(super) fn read(network: Node, skipped: &mut Skipped) -> Result<Signals, DecodeError> {
    let list = network.first("TrafficSignals");
    let mut found: Vec<Read> = Vec::new();
    for controller in list
        .iter()
        .flat_map(|list| list.all("TrafficSignalController"))
    {
        found.extend(read_controller(controller, skipped)?);
    }
    // Of several with one name the last counts.
    let by_name: HashMap<&str, &Read> = found
        .iter()
        .map(|read| (read.controller.name.as_str(), read))
        .collect();
    let offsets: Vec<f64> = found
        .iter()
        // The first phase begins after the delay: that far before the end of the cycle at time 0.
        .map(|read| 0.0 - delay_s(read, &by_name, skipped))
        .collect();
    let mut signals = Signals::default();
    let (mut known, mut phases) = (HashSet::new(), 0);
    for (mut read, offset_s) in found.into_iter().zip(offsets) {
        read.controller.offset_s = offset_s;
        for (signal, colors) in read.signals {
            phases += colors.len();
            let reason = match known.insert(signal.clone()) {
                false => "a signal of it has another controller before, which counts",
                true if phases > ALL_PHASES_MAX => "its signals have more phases than are read",
                true => {
                    read.controller.signals.push(signal.clone());
                    signals.phases.push(SignalPhases {
                        signal,
                        phases: phases_of(&read.controller, &colors),
                        offset_s,
                    });
                    continue;
                }
            };
            skipped.add(read.element, reason);
        }
        signals.controllers.push(read.controller);
    }
    Ok(signals)
}

/// Seconds after which the first phase of a controller begins, with the delays of those that it
/// waits for.
fn delay_s(read: &Read, by_name: &HashMap<&str, &Read>, skipped: &mut Skipped) -> f64 {
    let (mut delay_s, mut after) = (read.delay_s, read.after.as_ref());
    // Controllers may wait for each other in a circle.
    for _ in 0..CHAIN_MAX {
        let Some(name) = after else { break };
        let Some(other) = by_name.get(name.as_str()) else {
            skipped.add(
                read.element,
                "it starts after a controller that is not there",
            );
            break;
        };
        delay_s += other.delay_s;
        after = other.after.as_ref();
    }
    delay_s
}

fn read_controller<'a>(
    controller: Node<'a>,
    skipped: &mut Skipped,
) -> Result<Option<Read<'a>>, DecodeError> {
    let mut read = Read {
        controller: SignalController {
            name: controller
                .attribute("name")?
                .unwrap_or_default()
                .into_owned(),
            ..SignalController::default()
        },
        delay_s: controller.number_or("delay", 0.0)?,
        after: controller.attribute("reference")?.map(Into::into),
        signals: Vec::new(),
        element: controller,
    };
    let mut by_id: HashMap<String, usize> = HashMap::new();
    for phase in controller.all("Phase") {
        let at = read.controller.phases.len();
        if at == PHASES_MAX {
            skipped.add(
                controller,
                &format!("more than {PHASES_MAX} phases are not read"),
            );
            break;
        }
        let duration_s = phase.number("duration")?;
        if duration_s <= 0.0 {
            continue;
        }
        let name = phase.attribute("name")?.unwrap_or_default().into_owned();
        let duration_s = duration_s.clamp(*PHASE_S.start(), *PHASE_S.end());
        read.controller.phases.push((name, duration_s));
        for (_, colors) in &mut read.signals {
            colors.push(None);
        }
        for state in phase.all("TrafficSignalState") {
            let signal = state.needed_attribute("trafficSignalId")?;
            let Some(color) = known(state, &state.needed_attribute("state")?, skipped) else {
                continue;
            };
            let next = read.signals.len();
            let index = *by_id.entry(signal.to_string()).or_insert(next);
            if index == next {
                read.signals.push((signal.into_owned(), vec![None; at + 1]));
            }
            read.signals[index].1[at] = Some(color);
        }
    }
    Ok((!read.controller.phases.is_empty()).then_some(read))
}

/// The phases of a signal: in a phase that does not tell its color it keeps the one before.
fn phases_of(controller: &SignalController, colors: &[Option<LightColor>]) -> Vec<LightPhase> {
    let last = colors.iter().rev().find_map(|color| *color);
    let mut color = last.unwrap_or(LightColor::Green);
    let mut phases = Vec::with_capacity(colors.len());
    for ((_, duration_s), own) in controller.phases.iter().zip(colors) {
        color = own.unwrap_or(color);
        phases.push(LightPhase {
            color,
            duration_s: *duration_s,
        });
    }
    phases
}

/// Color of a state; `None` with a sentence if it has none that is known.
pub(super) fn known(element: Node, state: &str, skipped: &mut Skipped) -> Option<LightColor> {
    let color = color_of(state);
    if color.is_none() {
        skipped.add(
            element,
            "the state is unknown; expected red, yellow or green, or lamps as on;off;off or on;off",
        );
    }
    color
}

/// Color of a state: the standard leaves its text to the simulator.
fn color_of(state: &str) -> Option<LightColor> {
    let state = state.to_ascii_lowercase();
    match state.as_str() {
        "red" | "stop" => return Some(LightColor::Red),
        "yellow" | "amber" | "attention" => return Some(LightColor::Yellow),
        "green" | "go" => return Some(LightColor::Green),
        _ => {}
    }
    // Lamps from the top; the first that is lit stops vehicles at red and yellow together.
    let lamps: Vec<&str> = state.split(';').map(str::trim).collect();
    let lit = lamps
        .iter()
        .position(|lamp| matches!(*lamp, "on" | "true" | "1"))?;
    match (lamps.len(), lit) {
        (3, 0) => Some(LightColor::Red),
        (3, 1) => Some(LightColor::Yellow),
        (3, 2) => Some(LightColor::Green),
        // Lights of pedestrians.
        (2, 0) => Some(LightColor::Red),
        (2, 1) => Some(LightColor::Green),
        _ => None,
    }
}

/// The controller and phase that a condition or an action names; `None` with a sentence if there
/// is no such controller.
pub(super) fn phase(
    element: Node,
    skipped: &mut Skipped,
) -> Result<Option<(String, String)>, DecodeError> {
    let controller = element.needed_attribute("trafficSignalControllerRef")?;
    let phase = element.needed_attribute("phase")?.into_owned();
    if !skipped.controllers.contains(&*controller) {
        skipped.add(element, "there is no controller of this name");
        return Ok(None);
    }
    Ok(Some((controller.into_owned(), phase)))
}
