//! Egos: their tasks, and several in one world.

use crate::vehicle::VehicleSize;

/// Task of the ego vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct EgoTask {
    /// Lanes of its route, by id, each a successor or a neighbor of the one before.
    pub route: Vec<String>,
    /// Start on the first of them, meters along it.
    pub start_m: f64,
    /// End of the route on the last, meters along it.
    pub end_m: f64,
    /// Initial speed.
    pub speed_mps: f64,
    /// Cruise speed on a free road.
    pub cruise_mps: f64,
    /// Size of the box.
    pub size: VehicleSize,
    /// True if the ego moves as the scene was recorded, whatever it plans: an open loop.
    pub follows_recording: bool,
    /// Middle of its box at the start, world coordinates in meters, and its heading, radians.
    /// `None`: the middle of the lane at [`EgoTask::start_m`], along it.
    pub start_pose: Option<[f64; 3]>,
}

/// Ego as the others see it, and its planner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EgoIdentity {
    /// Unique among egos and agents.
    pub name: String,
    /// Index of the car that the images of other egos show; indices beyond the last start over.
    pub asset: usize,
    /// Name of its planner; `None`: that of the run.
    pub planner: Option<String>,
}

impl Default for EgoIdentity {
    fn default() -> Self {
        Self {
            name: "ego".into(),
            asset: 0,
            planner: None,
        }
    }
}

/// Ego beside the first.
#[derive(Clone, Debug, PartialEq)]
pub struct OtherEgo {
    /// Name, look and planner.
    pub identity: EgoIdentity,
    /// Task of the ego.
    pub task: EgoTask,
}

/// Identity of the first ego of a scenario, whose task the scenario tells, and the other egos.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Egos {
    /// Identity of the first ego.
    pub own: EgoIdentity,
    /// Egos beside the first; empty where there is one.
    pub others: Vec<OtherEgo>,
}

impl Egos {
    /// Most egos of a scenario.
    pub const MAX: usize = 8;

    /// Number of egos.
    #[must_use]
    pub fn count(&self) -> usize {
        1 + self.others.len()
    }

    /// Boxes of the other egos.
    pub fn sizes(&self) -> impl Iterator<Item = VehicleSize> {
        self.others.iter().map(|other| other.task.size)
    }
}
