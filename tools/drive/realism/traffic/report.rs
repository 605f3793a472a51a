//! Results of comparing traffic.

use std::fmt::Write;
use std::path::Path;

use decouplegs::scene::Drivers;
use serde_json::{Value, json};

use super::distribution::{Sample, distance};
use super::features::{Features, Quantity};
use super::motion::{Model, Motion, Part, STEP_S, Simulated};
use super::roads::Roads;
use super::wosac::Likelihood;

/// Times after the start at which displacements are told, seconds.
pub const AFTER_S: [f64; 4] = [1.0, 3.0, 5.0, 8.0];

/// Result of one model.
#[derive(Clone, Debug)]
pub struct Result {
    pub model: Model,
    /// Vehicles that are compared, and those that the model could place, of all parts.
    pub vehicles: usize,
    pub placed: usize,
    /// Simulations of each part.
    pub rollouts: usize,
    /// Values at moments at which a vehicle is there in both, by quantity.
    pub recorded: Vec<Sample>,
    pub simulated: Vec<Sample>,
    /// Distances from where a vehicle was recorded, meters, by [`AFTER_S`].
    pub displacement: Vec<Sample>,
    /// Lane changes and minutes, recorded and simulated.
    pub changes: [(usize, f64); 2],
    pub likelihood: Likelihood,
}

impl Result {
    fn new(model: Model) -> Self {
        let samples = vec![Sample::default(); Quantity::ALL.len()];
        Self {
            model,
            vehicles: 0,
            placed: 0,
            rollouts: 0,
            recorded: samples.clone(),
            simulated: samples,
            displacement: vec![Sample::default(); AFTER_S.len()],
            changes: [(0, 0.0); 2],
            likelihood: Likelihood::default(),
        }
    }

    /// Kolmogorov-Smirnov distance of a quantity.
    pub fn distance(&self, quantity: Quantity) -> Option<f64> {
        let at = quantity as usize;
        distance(&self.recorded[at], &self.simulated[at])
    }

    /// Lane changes a minute, recorded and simulated.
    pub fn changes_per_minute(&self) -> [Option<f64>; 2] {
        self.changes
            .map(|(count, minutes)| (minutes > 0.0).then(|| count as f64 / minutes))
    }

    fn add(
        &mut self,
        roads: &Roads,
        recorded: &Features,
        motion: &Motion,
        own: &[Features],
        of: &Simulated,
    ) {
        let steps = motion.places.first().map_or(0, Vec::len);
        for (simulated, moved) in own.iter().zip(&of.motions) {
            for &at in &of.placed {
                for step in 0..steps {
                    let (Some(was), Some(is)) = (motion.places[at][step], moved.places[at][step])
                    else {
                        continue;
                    };
                    for quantity in Quantity::ALL {
                        let value = |features: &Features| features.of_quantity(quantity)[at][step];
                        let samples = [&mut self.recorded, &mut self.simulated];
                        for (sample, value) in
                            samples.into_iter().zip([recorded, simulated].map(value))
                        {
                            value
                                .into_iter()
                                .for_each(|value| sample[quantity as usize].add(value));
                        }
                    }
                    let told = AFTER_S
                        .iter()
                        .position(|after_s| (after_s / STEP_S).round() as usize == step);
                    if let Some(told) = told {
                        self.displacement[told].add(was.0.distance(is.0));
                    }
                }
                for (features, sum) in [recorded, simulated].into_iter().zip(&mut self.changes) {
                    let (count, moments) = changes(roads, &features.lanes[at]);
                    sum.0 += count;
                    sum.1 += moments as f64 * STEP_S / 60.0;
                }
            }
        }
        self.likelihood.add(recorded, own, &of.placed);
    }
}

/// Lane changes of a vehicle, and moments at which it is on a lane.
fn changes(roads: &Roads, lanes: &[Option<usize>]) -> (usize, usize) {
    let lanes: Vec<usize> = lanes.iter().copied().flatten().collect();
    let is_change = |pair: &&[usize]| {
        let lane = &roads.map.lanes[pair[0]];
        [lane.left_neighbor, lane.right_neighbor].contains(&Some(pair[1]))
    };
    (lanes.windows(2).filter(is_change).count(), lanes.len())
}

/// Everything that was found.
pub struct Compared {
    pub part_s: f64,
    /// Source of the drivers' parameters.
    pub drivers: Drivers,
    /// Free speed of all lanes in place of the map's limits, m/s.
    pub free_mps: Option<f64>,
    /// Name of the driver of agents, if there is one.
    pub agent_driver: Option<String>,
    pub results: Vec<Result>,
}

impl Compared {
    /// Nothing yet, of `models`.
    pub fn new(models: &[Model], part_s: f64, drivers: Drivers, free_mps: Option<f64>) -> Self {
        Self {
            part_s,
            drivers,
            free_mps,
            agent_driver: None,
            results: models.iter().copied().map(Result::new).collect(),
        }
    }

    /// Adds simulations of a part.
    pub fn add(&mut self, roads: &Roads, part: &Part, model: Model, simulated: &Simulated) {
        let Some(result) = self.results.iter_mut().find(|result| result.model == model) else {
            return;
        };
        let recorded = Features::new(&part.motion, roads, &simulated.placed);
        let own: Vec<Features> = simulated
            .motions
            .iter()
            .map(|motion| Features::new(motion, roads, &simulated.placed))
            .collect();
        result.vehicles += part.vehicles.len();
        result.placed += simulated.placed.len();
        result.rollouts = result.rollouts.max(simulated.motions.len());
        result.add(roads, &recorded, &part.motion, &own, simulated);
    }

    /// Sorts what was collected.
    pub fn finish(&mut self) {
        for result in &mut self.results {
            let samples = [
                &mut result.recorded,
                &mut result.simulated,
                &mut result.displacement,
            ];
            for sample in samples.into_iter().flatten() {
                *sample = std::mem::take(sample).sorted();
            }
        }
    }

    /// Vehicles that are compared.
    pub fn vehicles(&self) -> usize {
        self.results
            .iter()
            .map(|result| result.vehicles)
            .max()
            .unwrap_or(0)
    }

    pub fn to_text(&self) -> String {
        let mut text = self.told_of_drivers();
        text.push('\n');
        for result in &self.results {
            let _ = writeln!(
                text,
                "{}: {} of {} vehicles placed, {} simulations of parts of {} s; meta-metric {}",
                result.model.name(),
                result.placed,
                result.vehicles,
                result.rollouts,
                self.part_s,
                shown(result.likelihood.meta())
            );
            for quantity in Quantity::ALL {
                let at = quantity as usize;
                let _ = writeln!(
                    text,
                    "  {:<38} KS {}  recorded {}  simulated {}",
                    quantity.name(),
                    shown(result.distance(quantity)),
                    result.recorded[at].to_text(),
                    result.simulated[at].to_text()
                );
            }
            for (after_s, sample) in AFTER_S.iter().zip(&result.displacement) {
                let _ = writeln!(
                    text,
                    "  displacement after {after_s} s, m: mean {}, median {}",
                    shown(sample.mean()),
                    shown(sample.quantile(0.5))
                );
            }
            let [recorded, simulated] = result.changes_per_minute().map(shown);
            let _ = writeln!(
                text,
                "  lane changes of a vehicle in a minute: recorded {recorded}, simulated {simulated}"
            );
        }
        text
    }

    /// Sentence on the drivers and free speeds of simulations.
    pub fn told_of_drivers(&self) -> String {
        let drivers = match self.drivers {
            Drivers::Kinds => "drivers: the normal kind, all alike",
            Drivers::Drawn => "drivers: drawn, each with its own parameters",
        };
        let agents = self.agent_driver.as_ref();
        let agents = agents.map_or(String::new(), |name| format!("; agents: driven by {name}"));
        match self.free_mps {
            None => format!("{drivers}; free speeds: those of the map{agents}"),
            Some(free_mps) => {
                format!("{drivers}; free speed: {free_mps:.2} m/s on all lanes{agents}")
            }
        }
    }

    pub fn to_json(&self, tracks: &Path) -> Value {
        let models: Vec<Value> = self.results.iter().map(to_json).collect();
        let mut report = json!({
            "tracks": tracks.display().to_string(),
            "part_s": self.part_s,
            "drivers": self.drivers.name(),
            "free_speed_mps": self.free_mps,
            "models": models,
        });
        if let Some(name) = &self.agent_driver {
            report["agents"] = name.as_str().into();
        }
        report
    }
}

fn to_json(result: &Result) -> Value {
    let quantities = Quantity::ALL.map(|quantity| {
        let at = quantity as usize;
        json!({
            "name": quantity.name(),
            "ks": result.distance(quantity),
            "recorded": result.recorded[at].to_json(),
            "simulated": result.simulated[at].to_json(),
        })
    });
    let displacement = AFTER_S.iter().zip(&result.displacement);
    let displacement: Vec<Value> = displacement
        .map(|(after_s, sample)| {
            json!({
                "after_s": after_s,
                "count": sample.len(),
                "mean_m": sample.mean(),
                "median_m": sample.quantile(0.5),
                "p95_m": sample.quantile(0.95),
            })
        })
        .collect();
    let [recorded, simulated] = result.changes_per_minute();
    json!({
        "name": result.model.name(),
        "vehicles": result.vehicles,
        "placed": result.placed,
        "rollouts": result.rollouts,
        "quantities": quantities,
        "displacement": displacement,
        "lane_changes_per_minute": {"recorded": recorded, "simulated": simulated},
        "wosac": result.likelihood.to_json(),
    })
}

/// Number with three digits behind the point.
pub fn shown(value: Option<f64>) -> String {
    value.map_or("-".into(), |value| format!("{value:.3}"))
}

#[cfg(test)]
mod tests {
    use decouplegs::scene::{Lane, LaneMap, Track, TrackPoint};
    use glam::{DVec2, DVec3};

    use super::super::motion::Recording;
    use super::*;

    /// A road of 400 m with two lanes to the east.
    fn roads() -> Roads {
        let line = |y: f64| vec![DVec3::new(0.0, y, 0.0), DVec3::new(400.0, y, 0.0)];
        let lane = |id: &str, y: f64| Lane {
            id: id.into(),
            centerline: line(y),
            left: line(y + 1.75),
            right: line(y - 1.75),
            ..Lane::default()
        };
        let (mut right, mut left) = (lane("r", 0.0), lane("l", 3.5));
        (right.left_neighbor, left.right_neighbor) = (Some(1), Some(0));
        let map = LaneMap {
            lanes: vec![right, left],
            ..LaneMap::default()
        };
        Roads::new(map).unwrap()
    }

    /// Three cars in a row, and one that changes lanes, for 8 s.
    fn tracks() -> Vec<Track> {
        let track = |id: usize, place: &dyn Fn(f64) -> [f64; 2]| Track {
            id: id.to_string(),
            class: "car".into(),
            dims_m: None,
            points: (0..=80)
                .map(|step| {
                    let time_s = 0.1 * f64::from(step);
                    TrackPoint {
                        time_s,
                        position_m: DVec2::from_array(place(time_s)),
                        z_m: None,
                        yaw_rad: None,
                    }
                })
                .collect(),
        };
        let mut tracks: Vec<Track> = (0..3)
            .map(|at| {
                let from_m = 20.0 + 18.0 * at as f64;
                track(at, &move |s| {
                    [from_m + 12.0 * s + 0.5 * (0.8 * s).sin(), 0.1]
                })
            })
            .collect();
        tracks.push(track(3, &|s| {
            let share = ((s - 2.0) / 3.0).clamp(0.0, 1.0);
            [
                29.0 + 12.0 * s,
                3.5 * (1.0 - share * share * (3.0 - 2.0 * share)),
            ]
        }));
        tracks
    }

    /// Results of a motion that is `change`d from the recorded one.
    fn compared(change: impl Fn(&mut Motion)) -> Result {
        let (roads, tracks) = (roads(), tracks());
        let recording = Recording::new(&tracks);
        assert_eq!(recording.starts_s(8.0), [0.0]);
        let part = recording.part(&roads, 0.0, 8.0);
        assert_eq!(part.vehicles.len(), 4);
        let mut motion = part.motion.clone();
        change(&mut motion);
        let simulated = Simulated {
            motions: vec![motion],
            placed: part.vehicles.clone(),
        };
        let mut compared = Compared::new(&Model::OWN, 8.0, Drivers::Kinds, None);
        compared.add(&roads, &part, Model::Lanes, &simulated);
        compared.finish();
        compared.results.remove(0)
    }

    #[test]
    fn recorded_motion_beside_itself_is_the_same_and_a_slowed_copy_is_not() {
        let same = compared(|_| {});
        for quantity in Quantity::ALL {
            assert_eq!(same.distance(quantity), Some(0.0), "{quantity:?}");
        }
        assert_eq!(same.displacement[3].quantile(1.0), Some(0.0));
        let [recorded, simulated] = same.changes_per_minute();
        assert_eq!(recorded, simulated);
        assert!(same.changes[0].0 == 1, "{:?}", same.changes);
        // Slower by a third: every place is that of an earlier moment.
        let slowed = compared(|motion| {
            for places in &mut motion.places {
                let own = places.clone();
                for (step, place) in places.iter_mut().enumerate() {
                    *place = own[step * 2 / 3];
                }
            }
        });
        assert!(slowed.distance(Quantity::Speed).unwrap() > 0.5);
        assert!(slowed.displacement[3].quantile(0.5).unwrap() > 20.0);
        let (same, slowed) = (same.likelihood.meta(), slowed.likelihood.meta());
        assert!(
            same.unwrap() > slowed.unwrap() + 0.02,
            "{same:?} {slowed:?}"
        );
    }

    #[test]
    fn cars_that_touch_or_leave_the_road_are_less_likely() {
        let likelihood = |result: &Result, name: &str| {
            let mut features = result.likelihood.features();
            features
                .find(|feature| feature.0 == name)
                .unwrap()
                .2
                .unwrap()
        };
        let off = compared(|motion| {
            for place in motion.places[0].iter_mut().flatten() {
                place.0.y -= 6.0;
            }
        });
        let same = compared(|_| {});
        assert!(likelihood(&same, "offroad_indication") > 0.99);
        assert!(likelihood(&off, "offroad_indication") < 0.3);
        let touching = compared(|motion| {
            motion.places[1] = motion.places[0].clone();
        });
        assert!(likelihood(&same, "collision_indication") > 0.99);
        assert!(likelihood(&touching, "collision_indication") < 0.1);
    }

    #[test]
    fn every_model_moves_vehicles_from_the_same_start() {
        let (roads, tracks) = (roads(), tracks());
        let part = Recording::new(&tracks).part(&roads, 0.0, 8.0);
        let sources = Drivers::ALL.into_iter();
        let all = sources.flat_map(|drivers| Model::OWN.map(|model| (drivers, model)));
        for (drivers, model) in all {
            let simulated = part.simulated(&roads, model, (2, 1, drivers)).unwrap();
            for motion in &simulated.motions {
                for &at in &simulated.placed {
                    let start = part.motion.places[at][0].unwrap().0;
                    let apart_m = motion.places[at][0].unwrap().0.distance(start);
                    assert!(apart_m < 0.2, "{model:?}: {apart_m}");
                    let end = motion.places[at][80].unwrap().0;
                    assert!(end.x > start.x + 50.0, "{model:?}: {end}");
                }
            }
        }
    }
}
