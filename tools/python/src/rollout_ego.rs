//! One ego of an episode that Python steps through.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use decouplegs::drive::score::{Conduct, ConductKind, EpisodeScore, ExtendedPdmScore, PdmScore};
use decouplegs::episode::Rollout as EngineRollout;
use decouplegs::scene::episode::EpisodeEnd;
use decouplegs::scene::{Motion, Plan};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::shaped;
use crate::error::{of_session, value_error};
use crate::lidar::{MotionTuple, tuple_of};
use crate::pose::to_matrix;
use crate::world::World;

/// Duration of the plan that is made of controls, seconds: what the ego looks ahead, and more.
const CONTROL_HORIZON_S: f64 = 2.0;

/// An episode that is stepped through, and is shared by its egos.
pub type SharedRollout = Arc<Mutex<EngineRollout>>;

pub fn lock(rollout: &SharedRollout) -> MutexGuard<'_, EngineRollout> {
    rollout.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One ego of a rollout.
#[pyclass(frozen, module = "decouplegs")]
pub struct RolloutEgo {
    rollout: SharedRollout,
    index: usize,
    /// Motion of the ego when it was shown last.
    shown: Mutex<Motion>,
}

impl RolloutEgo {
    /// Ego `index` of `rollout`, from 0 in the order of the scenario.
    pub fn new(rollout: SharedRollout, index: usize) -> Self {
        Self {
            rollout,
            index,
            shown: Mutex::default(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, EngineRollout> {
        lock(&self.rollout)
    }

    /// The plan that these controls would drive.
    pub fn plan_of_controls(&self, steer_rad: f64, acceleration_mps2: f64) -> PyResult<Plan> {
        let rollout = self.lock();
        let simulation = rollout.simulation();
        let horizon_s = CONTROL_HORIZON_S.max(2.0 * simulation.scenario().step_s);
        let ego = simulation.view(self.index).ego();
        ego.plan_under(steer_rad, acceleration_mps2, horizon_s)
            .map_err(value_error)
    }
}

/// Name of the end in logs.
pub fn name_of(end: &EpisodeEnd) -> &'static str {
    match end {
        EpisodeEnd::RouteDone => "route_done",
        EpisodeEnd::Collision { .. } => "collision",
        EpisodeEnd::Obstacle { .. } => "obstacle",
        EpisodeEnd::OffRoad => "off_road",
        EpisodeEnd::OffRoute => "off_route",
        EpisodeEnd::Story => "story",
        EpisodeEnd::Time => "time",
        EpisodeEnd::Planner { .. } => "planner",
    }
}

#[pymethods]
impl RolloutEgo {
    /// Name in the scenario.
    #[getter]
    pub fn name(&self) -> String {
        let rollout = self.lock();
        let scenario = rollout.simulation().scenario();
        scenario.ego_identity(self.index).name.clone()
    }

    /// Plan that turns the wheels towards steer_rad (left above zero, at most 0.6) and accelerates
    /// so (-8 to 3) for 2 s: float64 [N, 3], as steps take it.
    fn plan_under<'py>(
        &self,
        py: Python<'py>,
        steer_rad: f64,
        acceleration_mps2: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        let plan = self.plan_of_controls(steer_rad, acceleration_mps2)?;
        let points = plan.points();
        let values = points
            .iter()
            .flat_map(|point| [point.time_s, point.position_m.x, point.position_m.y]);
        shaped(py, values.collect(), &[points.len(), 3])
    }

    /// Puts all agents and the other egos into a world over the site's scene, as this ego sees
    /// them; world_from_rig of the ego, float64 [4, 4], meters.
    pub fn show<'py>(&self, py: Python<'py>, world: &World) -> PyResult<Bound<'py, PyAny>> {
        let rollout = self.lock();
        let view = rollout.simulation().view(self.index);
        let shown = view.show(&mut world.lock());
        let (ego, motion) = shown.map_err(|error| of_session(&error))?;
        *self.shown.lock().unwrap_or_else(PoisonError::into_inner) = motion;
        to_matrix(py, &ego)
    }

    /// Motion of the ego when show was called last: velocity, m/s along the axes of the world, and
    /// turn, rad/s about those of the vehicle.
    #[getter]
    pub fn motion(&self) -> MotionTuple {
        tuple_of(&self.shown.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Speed m/s, acceleration m/s2, angle of the wheels rad, yaw rate rad/s: float64 [4].
    #[getter]
    pub fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let motion = self.lock().simulation().view(self.index).motion();
        shaped(
            py,
            vec![
                motion.speed_mps,
                motion.acceleration_mps2,
                motion.steer_rad,
                motion.yaw_rate_radps,
            ],
            &[4],
        )
    }

    /// Navigation instructions: turn (``left``, ``right``, ``straight``), distance_m, angle_rad,
    /// length_m, cruise_mps.
    #[getter]
    pub fn guidance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let guidance = self.lock().simulation().view(self.index).guidance();
        let dict = PyDict::new(py);
        dict.set_item("turn", guidance.turn.name())?;
        dict.set_item("distance_m", guidance.distance_m)?;
        dict.set_item("angle_rad", guidance.angle_rad)?;
        dict.set_item("length_m", guidance.length_m)?;
        dict.set_item("cruise_mps", guidance.cruise_mps)?;
        Ok(dict)
    }

    /// Places on the route ahead, in the ego's frame: float64 [points, 2], meters.
    #[pyo3(signature = (points = 10, spacing_m = 5.0))]
    pub fn route_ahead<'py>(
        &self,
        py: Python<'py>,
        points: usize,
        spacing_m: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        if !((1..=4096).contains(&points) && spacing_m > 0.0 && spacing_m.is_finite()) {
            return Err(value_error(format!(
                "expected 1 to 4096 points and a spacing above 0, found {points} and {spacing_m}"
            )));
        }
        let rollout = self.lock();
        let view = rollout.simulation().view(self.index);
        let (ego, route) = (view.instant().ego, view.route());
        let (progress_m, length_m) = (view.progress_m(), route.length_m());
        let place = |number: usize| {
            let (at, _) = route.pose_at((progress_m + spacing_m * number as f64).min(length_m));
            ego.to_local(at.truncate()).to_array()
        };
        shaped(py, (1..=points).flat_map(place).collect(), &[points, 2])
    }

    /// Meters of the route that are behind the ego, and all of them.
    #[getter]
    pub fn progress_m(&self) -> (f64, f64) {
        let rollout = self.lock();
        let view = rollout.simulation().view(self.index);
        (view.progress_m(), view.route().length_m())
    }

    /// Reason of the end, if it has ended.
    #[getter]
    pub fn end(&self) -> Option<&'static str> {
        self.lock().simulation().view(self.index).end().map(name_of)
    }

    /// Score so far: driving_score, route_completion, success, collisions, pedestrian_collisions,
    /// obstacle_collisions, layout_infractions, wrong_ways, red_lights, stop_signs, min_ttc_s,
    /// ttc_short_share.
    pub fn score<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let score = EpisodeScore::new(self.lock().episode().ego(self.index));
        to_dict(py, &score)
    }

    /// Scores beside the driving score so far: all_rules_score, reference_progress, pdm_score,
    /// extended_pdm_score, lane_kept_share, speed_compliance, over_edge_s, on_crossing, blocking,
    /// wrong_turns. None where the map does not tell one.
    pub fn sub_scores<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let rollout = self.lock();
        let episode = rollout.episode().ego(self.index);
        let score = EpisodeScore::new(episode);
        let (pdm, conduct) = (
            PdmScore::new(episode, &score),
            Conduct::new(episode, &score),
        );
        let extended = ExtendedPdmScore::new(episode, &score, &pdm, &conduct.reference);
        let keeping = conduct.lane_keeping;
        let dict = PyDict::new(py);
        dict.set_item("all_rules_score", conduct.all_rules_score)?;
        dict.set_item("reference_progress", conduct.reference.share)?;
        dict.set_item("pdm_score", pdm.pdm_score)?;
        dict.set_item("extended_pdm_score", extended.score)?;
        dict.set_item("lane_kept_share", keeping.map(|one| one.kept_share()))?;
        dict.set_item("over_edge_s", keeping.map(|one| one.over_edge_s))?;
        dict.set_item("speed_compliance", score.speed_compliance)?;
        dict.set_item("on_crossing", conduct.count(ConductKind::OnCrossing))?;
        dict.set_item("blocking", conduct.count(ConductKind::Blocking))?;
        dict.set_item("wrong_turns", conduct.count(ConductKind::WrongTurn))?;
        Ok(dict)
    }

    fn __repr__(&self) -> String {
        let (progress_m, length_m) = self.progress_m();
        format!(
            "RolloutEgo({}, {progress_m:.1} of {length_m:.1} m)",
            self.name()
        )
    }
}

fn to_dict<'py>(py: Python<'py>, score: &EpisodeScore) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("driving_score", score.driving_score)?;
    dict.set_item("route_completion", score.route_completion)?;
    dict.set_item("success", score.success)?;
    dict.set_item("collisions", score.collisions())?;
    dict.set_item("pedestrian_collisions", score.pedestrian_collisions())?;
    dict.set_item("obstacle_collisions", score.obstacle_collisions())?;
    dict.set_item("layout_infractions", score.layout_infractions())?;
    dict.set_item("wrong_ways", score.wrong_ways())?;
    dict.set_item("red_lights", score.red_lights())?;
    dict.set_item("stop_signs", score.stop_signs())?;
    dict.set_item("min_ttc_s", score.min_ttc_s())?;
    dict.set_item("ttc_short_share", score.ttc_short_share)?;
    Ok(dict)
}
