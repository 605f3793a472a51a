//! Place and light of a scenario: the caller's options, and the choice by level.

use std::path::PathBuf;

use decouplegs_scene::scenario::Place;
use decouplegs_scene::{Air, Level, Weather};

use super::random::Stream;
use super::rules::weathers;

/// A light probe and what it shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Sky {
    /// A lat-long .hdr or .exr, as [`Place::Roads`] names it.
    pub probe: PathBuf,
    /// The light it was taken in.
    pub weather: Weather,
}

/// Place of the scenarios. All that a level decides is the light.
#[derive(Clone, Debug, PartialEq)]
pub enum PlaceOptions {
    /// The synthetic street, in the weather of the level.
    Street {
        /// Splats of the static part.
        background: usize,
        /// Splats of each car.
        agent_splats: usize,
        /// Houses, trees and parked cars follow from it.
        seed: u64,
    },
    /// The roads of a map, under one of these skies.
    Roads {
        /// The file of the map, as [`Place::Roads`] names it.
        map: PathBuf,
        /// Skies to choose from. None: an overcast sky, brighter or darker.
        skies: Vec<Sky>,
        /// Splats of the static part.
        background: usize,
        /// Splats of each car.
        agent_splats: usize,
    },
    /// A captured scene: its light is what it is.
    Scene {
        /// The scene file.
        scene: PathBuf,
        /// Map file with the lanes.
        map: PathBuf,
        /// File of obstacles. `None`: the cells beside the lanes that the scene's splats fill.
        obstacles: Option<PathBuf>,
    },
}

/// Brightness of a place, stops relative to a clear day. ObservationRenderer and cameras adapt:
/// measured light differs by far more.
const fn brightness_ev(weather: Weather) -> f64 {
    match weather {
        Weather::Clear => 0.0,
        Weather::Overcast => -0.5,
        Weather::Dusk => -1.5,
        Weather::Night => -3.0,
    }
}

/// Stops by which a level makes its light more difficult: heavy clouds and late dusk at Hard; a sun
/// that blinds, or a night without lamps, at Extreme.
const fn difficulty_ev(level: Level, weather: Weather) -> f64 {
    match (level, weather) {
        (Level::Hard, _) => -0.5,
        (Level::Extreme, Weather::Night) => -1.0,
        (Level::Extreme, _) => 2.0,
        _ => 0.0,
    }
}

impl PlaceOptions {
    /// The place in a light of `level`.
    pub(super) fn lit_for(&self, level: Level, random: &mut Stream) -> Place {
        match self.clone() {
            Self::Street {
                background,
                agent_splats,
                seed,
            } => {
                let weather = random.pick(weathers(level)).copied().unwrap_or_default();
                Place::Street {
                    weather,
                    background,
                    agent_splats,
                    seed,
                }
            }
            Self::Roads {
                map,
                skies,
                background,
                agent_splats,
            } => {
                let (probe, exposure_ev) = sky_for(level, &skies, random);
                Place::Roads {
                    map,
                    probe,
                    exposure_ev,
                    air: Air::default(),
                    obstacles: None,
                    background,
                    agent_splats,
                }
            }
            Self::Scene {
                scene,
                map,
                obstacles,
            } => Place::Scene {
                scene,
                map,
                obstacles,
            },
        }
    }
}

/// A sky of the level's weather; where none is offered, the one that looks most like it, made as
/// bright or dark as that.
fn sky_for(level: Level, skies: &[Sky], random: &mut Stream) -> (Option<PathBuf>, f64) {
    let offered = |weather: Weather| skies.iter().any(|sky| sky.weather == weather);
    let mut wanted: Vec<Weather> = weathers(level)
        .iter()
        .copied()
        .filter(|&weather| offered(weather))
        .collect();
    if wanted.is_empty() {
        wanted.extend(weathers(level));
    }
    let weather = random.pick(&wanted).copied().unwrap_or_default();
    let off_ev = |sky: &Sky| (brightness_ev(sky.weather) - brightness_ev(weather)).abs();
    let least_ev = skies.iter().map(off_ev).fold(f64::INFINITY, f64::min);
    let nearest: Vec<&Sky> = skies.iter().filter(|sky| off_ev(sky) <= least_ev).collect();
    let sky = random.pick(&nearest).copied();
    // Without a probe the sky is overcast.
    let own = sky.map_or(Weather::Overcast, |sky| sky.weather);
    let exposure_ev = brightness_ev(weather) - brightness_ev(own) + difficulty_ev(level, weather);
    (sky.map(|sky| sky.probe.clone()), exposure_ev)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sky(name: &str, weather: Weather) -> Sky {
        Sky {
            probe: name.into(),
            weather,
        }
    }

    #[test]
    fn the_level_has_its_light() {
        let skies = [
            sky("noon", Weather::Clear),
            sky("gray", Weather::Overcast),
            sky("late", Weather::Dusk),
        ];
        let chosen = |level, skies: &[Sky], seed| sky_for(level, skies, &mut Stream::new(seed));
        for seed in 0..50 {
            assert_eq!(
                chosen(Level::Easy, &skies, seed),
                (Some("noon".into()), 0.0)
            );
            let (probe, exposure_ev) = chosen(Level::Hard, &skies, seed);
            assert!(
                [Some("late".into()), Some("gray".into())].contains(&probe) && exposure_ev == -0.5
            );
            // No night is offered: the low sun blinds.
            assert_eq!(
                chosen(Level::Extreme, &skies, seed),
                (Some("late".into()), 2.0)
            );
            let (probe, exposure_ev) = chosen(Level::Extreme, &skies[..1], seed);
            assert!(
                probe == Some("noon".into()) && [-4.0, 0.5].contains(&exposure_ev),
                "{exposure_ev}"
            );
            assert_eq!(chosen(Level::Easy, &[], seed), (None, 0.5));
        }
    }

    #[test]
    fn a_captured_scene_keeps_its_light() {
        let options = PlaceOptions::Scene {
            scene: "scene.toml".into(),
            map: "map.xodr".into(),
            obstacles: Some("obstacles.json".into()),
        };
        let place = options.lit_for(Level::Extreme, &mut Stream::new(1));
        assert_eq!(
            place,
            Place::Scene {
                scene: "scene.toml".into(),
                map: "map.xodr".into(),
                obstacles: Some("obstacles.json".into()),
            }
        );
    }
}
