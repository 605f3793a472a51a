//! Worlds: agents over a scene.

use std::sync::{Mutex, MutexGuard, PoisonError};

use decouplegs::scene::Motion;
use decouplegs::session::World as EngineWorld;
use glam::DVec3;
use pyo3::prelude::*;

use crate::error::{of_session, value_error};
use crate::pose::{pose_of, to_matrix};
use crate::scene::Scene;

/// A set of agents over a scene.
///
/// The agents of the scene file where they are at time 0, or none.
#[pyclass(frozen, module = "decouplegs")]
pub struct World {
    inner: Mutex<EngineWorld>,
}

/// An agent of a world.
#[pyclass(frozen, get_all, module = "decouplegs")]
pub struct Agent {
    /// Unique in its world.
    name: String,
    /// Index of its asset in the scene.
    asset: usize,
    /// Value in the instance layer; 0 is the background.
    instance: u16,
    /// world_from_agent, float64 [4, 4], meters.
    pose: Py<PyAny>,
    /// False where the scene file says that it is absent: it is in no image.
    present: bool,
    /// True if it moves.
    moving: bool,
}

#[pymethods]
impl Agent {
    fn __repr__(&self) -> String {
        format!(
            "Agent({:?}, asset {}, instance {})",
            self.name, self.asset, self.instance
        )
    }
}

impl World {
    pub fn from_engine(inner: EngineWorld) -> Self {
        Self {
            inner: Mutex::new(inner),
        }
    }

    /// Held for the time of a change or a copy, never while something is drawn.
    pub fn lock(&self) -> MutexGuard<'_, EngineWorld> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl World {
    #[new]
    #[pyo3(signature = (scene, empty = false))]
    fn new(scene: &Scene, empty: bool) -> Self {
        Self::from_engine(if empty {
            EngineWorld::empty(&scene.inner)
        } else {
            EngineWorld::new(&scene.inner)
        })
    }

    /// Puts the agents of the scene file that are still here where their trajectories have them.
    fn set_time(&self, time_s: f64) -> PyResult<()> {
        if !time_s.is_finite() {
            return Err(value_error(format!(
                "time_s: expected a finite number, found {time_s}"
            )));
        }
        self.lock().set_time(time_s);
        Ok(())
    }

    /// Moves an agent; pose is world_from_agent, float64 [4, 4], meters.
    fn move_to(&self, name: &str, pose: &Bound<'_, PyAny>) -> PyResult<()> {
        let pose = pose_of("pose", pose)?;
        self.lock()
            .move_to(name, pose)
            .map_err(|error| of_session(&error))
    }

    /// Sets the motion of an agent, which rolling shutters show, until it is moved or another time
    /// is set: velocity in m/s along the axes of the world, and rotation vector per second, rad/s
    /// about the axes of the agent; three numbers each.
    #[pyo3(signature = (name, velocity, turn = [0.0; 3]))]
    fn set_motion(&self, name: &str, velocity: [f64; 3], turn: [f64; 3]) -> PyResult<()> {
        let motion = Motion {
            velocity_mps: DVec3::from_array(velocity),
            turn_rad_per_s: DVec3::from_array(turn),
        };
        motion.check().map_err(value_error)?;
        self.lock()
            .set_motion(name, motion)
            .map_err(|error| of_session(&error))
    }

    /// Adds an agent that shows an asset, or lets the one of that name show it; its instance id.
    fn place(&self, name: &str, asset: usize, pose: &Bound<'_, PyAny>) -> PyResult<u16> {
        let pose = pose_of("pose", pose)?;
        self.lock()
            .place(name, asset, pose, None)
            .map_err(|error| of_session(&error))
    }

    /// Takes an agent out.
    fn remove(&self, name: &str) -> PyResult<()> {
        self.lock()
            .remove(name)
            .map(drop)
            .map_err(|error| of_session(&error))
    }

    /// Agents of the world.
    #[getter]
    fn agents(&self, py: Python<'_>) -> PyResult<Vec<Agent>> {
        let agents = self.lock().agents().to_vec();
        let agent = |agent: decouplegs::session::WorldAgent| {
            let pose = to_matrix(py, &agent.placed.pose)?.unbind();
            Ok(Agent {
                name: agent.name,
                asset: agent.placed.asset,
                instance: agent.placed.instance,
                pose,
                present: agent.present,
                moving: !agent.placed.motion.is_rest(),
            })
        };
        agents.into_iter().map(agent).collect()
    }

    /// The scene that it is over.
    #[getter]
    fn scene(&self) -> Scene {
        Scene {
            inner: self.lock().scene().clone(),
        }
    }

    /// Another world with the same agents.
    fn copy(&self) -> Self {
        Self::from_engine(self.lock().clone())
    }

    fn __copy__(&self) -> Self {
        self.copy()
    }

    fn __len__(&self) -> usize {
        self.lock().agents().len()
    }

    fn __repr__(&self) -> String {
        format!("World({} agents)", self.__len__())
    }
}
