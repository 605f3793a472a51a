//! Several egos in one world.

use crate::episode::EpisodeTick;
use crate::scenario::{EgoTask, Scenario};
use crate::vehicle::{VehicleSize, VehicleState};

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

/// Ego beside the one whose task is [`Scenario::ego`].
#[derive(Clone, Debug, PartialEq)]
pub struct OtherEgo {
    /// Name, look and planner.
    pub identity: EgoIdentity,
    /// What it is to do.
    pub task: EgoTask,
}

/// Egos of a scenario: whose task [`Scenario::ego`] is, and the others.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Egos {
    /// Identity of the ego whose task is [`Scenario::ego`].
    pub own: EgoIdentity,
    /// The other egos; empty where there is one.
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

impl Scenario {
    /// Task of ego `ego`, from 0, in the order of the file.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn ego_task(&self, ego: usize) -> &EgoTask {
        match ego {
            0 => &self.ego,
            _ => &self.egos.others[ego - 1].task,
        }
    }

    /// Identity of ego `ego`, from 0, in the order of the file.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn ego_identity(&self, ego: usize) -> &EgoIdentity {
        match ego {
            0 => &self.egos.own,
            _ => &self.egos.others[ego - 1].identity,
        }
    }

    /// The scenario for ego `ego`: its task is [`Scenario::ego`], and the first ego has its place
    /// among the others. Done twice, it is the scenario itself.
    ///
    /// # Panics
    /// Panics if there is no such ego.
    #[must_use]
    pub fn for_ego(&self, ego: usize) -> Self {
        let mut scenario = self.clone();
        if ego > 0 {
            let other = &mut scenario.egos.others[ego - 1];
            std::mem::swap(&mut scenario.ego, &mut other.task);
            std::mem::swap(&mut scenario.egos.own, &mut other.identity);
        }
        scenario
    }
}

impl EpisodeTick {
    /// State of ego `ego` of `count` at this moment, which ego `viewer` sees; `None` where it has
    /// left.
    #[must_use]
    pub fn ego_state(&self, count: usize, viewer: usize, ego: usize) -> Option<VehicleState> {
        if ego == viewer {
            return Some(self.ego);
        }
        // The place of the viewer is that of the first ego.
        let slot = if ego == 0 { viewer } else { ego };
        let first = self.agents.len().checked_sub(count.checked_sub(1)?)?;
        *self.agents.get(first + slot.checked_sub(1)?)?
    }

    /// Agents of this moment, which ego `teller` of `count` sees, as ego `viewer` sees them.
    #[must_use]
    pub fn agents_for(
        &self,
        count: usize,
        teller: usize,
        viewer: usize,
    ) -> Vec<Option<VehicleState>> {
        let traffic = self.agents.len().saturating_sub(count - 1);
        let others = (1..count).map(|slot| {
            let ego = if slot == viewer { 0 } else { slot };
            self.ego_state(count, teller, ego)
        });
        let traffic = self.agents[..traffic].iter().copied();
        traffic.chain(others).collect()
    }
}
