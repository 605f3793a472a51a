//! Phases of traffic signals.

use std::collections::HashMap;

use decouplegs_scene::{LightColor, LightPhase};

use super::parameters::Node;
use super::{SignalPhases, Skipped};
use decouplegs_asset::DecodeError;

/// Phases of all signals of the road network.
pub(super) fn read(network: Node, skipped: &mut Skipped) -> Result<Vec<SignalPhases>, DecodeError> {
    let mut signals: Vec<SignalPhases> = Vec::new();
    let mut by_id: HashMap<String, usize> = HashMap::new();
    let controllers = network.first("TrafficSignals");
    for controller in controllers
        .iter()
        .flat_map(|list| list.all("TrafficSignalController"))
    {
        if controller.element().attribute("reference").is_some() {
            skipped.add(
                controller,
                "it starts after another controller: only `delay` of its own is read",
            );
            continue;
        }
        // The first phase begins after the delay: that far before the end of the cycle at time 0.
        let offset_s = -controller.number_or("delay", 0.0)?;
        for phase in controller.all("Phase") {
            let duration_s = phase.number("duration")?;
            for state in phase.all("TrafficSignalState") {
                let signal = state.needed_attribute("trafficSignalId")?;
                let Some(color) = color_of(&state.needed_attribute("state")?) else {
                    skipped.add(
                        state,
                        "the state is unknown; expected red, yellow or green, or three lamps as on;off;off",
                    );
                    continue;
                };
                let next = LightPhase { color, duration_s };
                let index = *by_id.entry(signal.to_string()).or_insert(signals.len());
                if index == signals.len() {
                    signals.push(SignalPhases {
                        signal: signal.into_owned(),
                        phases: Vec::new(),
                        offset_s,
                    });
                }
                signals[index].phases.push(next);
            }
        }
    }
    Ok(signals)
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
        _ => None,
    }
}
