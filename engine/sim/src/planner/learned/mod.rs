//! A planner that learned to drive: a small network that sees the front image.

mod network;
mod view;

use std::path::Path;
use std::sync::LazyLock;

use decouplegs_scene::plan::Plan;
use decouplegs_scene::{Invalid, Sensor};
use glam::DVec2;

use self::network::{Map, Network, Shape};
use self::view::{HEIGHT_PX, Small, View, WIDTH_PX};
use super::cadence::{HORIZON_S, SPACING_S, plan_through};
use super::{
    Cameras, EgoMotion, EpisodeInfo, Navigation, Observation, ObservationRequest, Planner,
    PlannerError, Turn, images,
};

/// Points of a plan.
const POINTS: usize = (HORIZON_S / SPACING_S) as usize;
/// Scale of the outputs: meters from a point of the plan to the next, ahead and to the left.
const STEP_M: [f64; 2] = [2.5, 0.5];
/// Age of the earlier image that the network sees beside the present one, seconds.
const EARLIER_S: f64 = 0.5;
/// Images that are kept for it, at most.
const IMAGES_MAX: usize = 64;
/// Numbers beside the images.
const NUMBERS: usize = 11;
/// Largest file of weights, bytes.
const FILE_BYTES_MAX: u64 = 64 << 20;

/// Shape of the networks that can drive.
const SHAPE: Shape = Shape {
    image: [HEIGHT_PX, WIDTH_PX, 6],
    numbers: NUMBERS,
    outputs: 2 * POINTS,
};

/// The network that comes with the program, trained as `learned-planner.md` says.
static OWN: LazyLock<Network> = LazyLock::new(|| {
    Network::from_bytes(include_bytes!("weights.safetensors"), &SHAPE)
        .expect("the weights of the program are those of a network")
});

/// Drives by the front image of now and of half a second ago, its own speed and turn, and what
/// navigation announces. It copies `lane-follow`, which knows everything, and knows only what it
/// saw that planner do: places, lights and road users of the synthetic kind.
pub struct Learned {
    network: Network,
    state: Option<State>,
}

/// State within an episode.
struct State {
    view: Option<View>,
    /// Images of the last half second and more, with their times, seconds; the last is the newest.
    images: Vec<(f64, Small)>,
}

impl Default for Learned {
    fn default() -> Self {
        Self {
            network: OWN.clone(),
            state: None,
        }
    }
}

impl Learned {
    /// Planner with the network in `file`, a safetensors file that `train_planner.py` wrote.
    ///
    /// # Errors
    /// A sentence if the file cannot be read, or has no such network.
    pub fn from_file(file: &Path) -> Result<Self, PlannerError> {
        let failed = |reason: String| PlannerError(format!("{}: {reason}", file.display()));
        let size = std::fs::metadata(file)
            .map_err(|error| failed(error.to_string()))?
            .len();
        if size > FILE_BYTES_MAX {
            return Err(failed(format!(
                "{size} bytes; expected at most {FILE_BYTES_MAX}"
            )));
        }
        let bytes = std::fs::read(file).map_err(|error| failed(error.to_string()))?;
        let network = Network::from_bytes(&bytes, &SHAPE);
        let network = network.map_err(|fault: Invalid| {
            failed(format!(
                "{fault}; expected a network that train_planner.py wrote"
            ))
        })?;
        Ok(Self {
            network,
            state: None,
        })
    }
}

impl Planner for Learned {
    fn name(&self) -> String {
        "learned".into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest {
            cameras: Cameras::Front,
            ..ObservationRequest::default()
        }
    }

    fn begin(&mut self, info: &EpisodeInfo) -> Result<(), PlannerError> {
        let camera = info.sensors.iter().find_map(|sensor| match sensor {
            Sensor::Camera(camera) => Some(camera),
            Sensor::Lidar(_) => None,
        });
        self.state = Some(State {
            view: camera.and_then(View::new),
            images: Vec::new(),
        });
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let state = self.state.as_mut().ok_or_else(|| {
            PlannerError("learned was asked for a plan before an episode began".into())
        })?;
        state.look(observation);
        let numbers = numbers(&observation.ego, &observation.guidance);
        let outputs = self.network.outputs(state.seen(), &numbers);
        let mut points = Vec::with_capacity(POINTS);
        let mut at_m = DVec2::ZERO;
        for step in outputs.as_chunks::<2>().0 {
            // It never drives backward.
            let [ahead, left] = [step[0].max(0.0), step[1]].map(f64::from);
            at_m += DVec2::new(ahead * STEP_M[0], left * STEP_M[1]);
            points.push(at_m);
        }
        plan_through(|time_s| points[(time_s / SPACING_S).round() as usize - 1])
    }
}

impl State {
    /// Keeps the image of now, and of those before it as many as are needed.
    fn look(&mut self, observation: &Observation) {
        let Some(frame) = images(observation.readings).next() else {
            return;
        };
        let Some(image) = self.view.as_ref().and_then(|view| view.small(&frame)) else {
            return;
        };
        let now_s = observation.time_s;
        let is_older = |(taken_s, _): &(f64, Small)| now_s - taken_s >= EARLIER_S - TOLERANCE_S;
        // The newest of those that are old enough stays.
        while self.images.get(1).is_some_and(is_older) || self.images.len() >= IMAGES_MAX {
            self.images.remove(0);
        }
        self.images.push((now_s, image));
    }

    /// The newest image and the one [`EARLIER_S`] before it, or the oldest that there is, side by
    /// side as channels. Without any, gray.
    fn seen(&self) -> Map {
        let gray = || vec![128; HEIGHT_PX * WIDTH_PX * 3];
        let newest = self
            .images
            .last()
            .map_or_else(gray, |(_, image)| image.clone());
        let oldest = self
            .images
            .first()
            .map_or_else(gray, |(_, image)| image.clone());
        let pixels = newest
            .as_chunks::<3>()
            .0
            .iter()
            .zip(oldest.as_chunks::<3>().0);
        let values = pixels.flat_map(|(newest, oldest)| newest.iter().chain(oldest));
        Map {
            height: HEIGHT_PX,
            width: WIDTH_PX,
            channels: 6,
            values: values.map(|&value| f32::from(value) / 64.0 - 2.0).collect(),
        }
    }
}

/// Difference of times that is none, seconds.
const TOLERANCE_S: f64 = 1e-3;

/// Numbers beside the images, each of the size of one.
fn numbers(ego: &EgoMotion, guidance: &Navigation) -> [f32; NUMBERS] {
    let is = |turn: Turn| f64::from(u8::from(guidance.turn == turn));
    let finite = |value: f64, least: f64, most: f64| match value.is_finite() {
        true => value.clamp(least, most),
        false => least,
    };
    let distance_m = finite(guidance.distance_m, -40.0, 100.0);
    [
        finite(ego.speed_mps, 0.0, 40.0) / 10.0,
        finite(ego.steer_rad, -0.7, 0.7) / 0.3,
        finite(ego.yaw_rate_radps, -1.0, 1.0) / 0.3,
        finite(guidance.cruise_mps, 0.0, 40.0) / 10.0,
        is(Turn::Left),
        is(Turn::Right),
        finite(guidance.angle_rad, -3.2, 3.2),
        distance_m / 40.0,
        (-distance_m.max(0.0) / 8.0).exp(),
        f64::from(u8::from(distance_m < 0.0)),
        finite(guidance.length_m, 0.0, 60.0) / 20.0,
    ]
    .map(|value| value as f32)
}
