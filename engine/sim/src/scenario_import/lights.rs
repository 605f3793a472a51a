//! Traffic lights of a file on those of its map, and the light over the place.

use std::collections::{HashMap, HashSet};

use decouplegs_logs::open_scenario::SignalPhases;
use decouplegs_scene::{Air, LightColor, LightPhase, TrafficLight, Weather};

use super::Import;

/// Elevations of the sun below which it is night, and below which it is dusk, radians.
const NIGHT_RAD: f64 = -0.1;
const DUSK_RAD: f64 = 0.18;
/// Share of clouds from which on the sky is overcast.
const OVERCAST_SHARE: f64 = 0.8;
/// Duration of the only phase of a light whose colors are those of a story, seconds.
const GREEN_S: f64 = 60.0;

impl Import<'_> {
    /// Light and air of the file. The sun's place counts more than the time of day.
    pub(super) fn air(&self) -> Air {
        let Some(environment) = &self.file.environment else {
            return Air::default();
        };
        let height_rad = environment.sun_rad.or_else(|| {
            let hour = environment.hour?;
            // The sun of a day of twelve hours, 60 degrees high at noon.
            let share = ((hour - 12.0) * std::f64::consts::PI / 12.0).cos();
            Some((share * 60f64.to_radians().sin()).asin())
        });
        let is_covered = environment
            .clouds
            .is_some_and(|share| share >= OVERCAST_SHARE);
        let weather = match height_rad {
            Some(height_rad) if height_rad < NIGHT_RAD => Some(Weather::Night),
            Some(height_rad) if height_rad < DUSK_RAD => Some(Weather::Dusk),
            _ if is_covered => Some(Weather::Overcast),
            None if environment.clouds.is_none() => None,
            _ => Some(Weather::Clear),
        };
        Air {
            weather,
            visibility_m: environment.visibility_m,
        }
    }

    /// Lights of the map with the phases of the file. Without phases there, the map's own count.
    pub(super) fn lights(&self, skipped: &mut Vec<String>) -> Vec<TrafficLight> {
        let signals = self.file.signals.iter();
        let by_id: HashMap<&str, &SignalPhases> = signals
            .map(|signal| (signal.signal.as_str(), signal))
            .collect();
        let mut lights = Vec::new();
        let named = self.file.named_signals();
        for light in &self.map.lights {
            match by_id.get(light.name.as_str()) {
                Some(signal) => lights.push(TrafficLight {
                    phases: signal.phases.clone(),
                    offset_s: signal.offset_s,
                    ..light.clone()
                }),
                // The story gives it its colors; green until then.
                None if light.phases.is_empty() && named.contains(&*light.name) => {
                    lights.push(TrafficLight {
                        phases: green(),
                        ..light.clone()
                    });
                }
                None if light.phases.is_empty() => skipped.push(format!(
                    "the traffic light {} has no phases: vehicles ignore it",
                    light.name
                )),
                None => lights.push(light.clone()),
            }
        }
        // A signal without a stop line counts where conditions ask for it.
        let on_map: HashSet<&str> = self.map.lights.iter().map(|light| &*light.name).collect();
        for id in named.iter().filter(|id| !on_map.contains(**id)) {
            let told = by_id.get(id);
            lights.push(TrafficLight {
                name: (*id).to_owned(),
                phases: told.map_or_else(green, |signal| signal.phases.clone()),
                offset_s: told.map_or(0.0, |signal| signal.offset_s),
                ..TrafficLight::default()
            });
            skipped.push(format!(
                "the traffic signal {id} has no stop line on the map: no vehicle obeys it"
            ));
        }
        lights.retain(|light| !light.stop_lines.is_empty() || named.contains(&*light.name));
        lights
    }
}

/// Phases of a light whose colors are those of a story alone: green until then.
fn green() -> Vec<LightPhase> {
    vec![LightPhase {
        color: LightColor::Green,
        duration_s: GREEN_S,
    }]
}
