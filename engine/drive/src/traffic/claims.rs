//! Reservation of road cells: cells occupied by vehicles, cells of their stopping distances, and
//! crossings granted to them.
//!
//! No vehicle moves to where it could not stop before a cell that conflicts with another's; so
//! vehicles on different lanes never meet. (Reservations of cells at crossings: K. Dresner, P.
//! Stone, A multiagent approach to autonomous intersection management, 2008.)

use super::agent::{Agent, AsideKind};
use super::ego::EgoSeen;
use crate::road_graph::{RoadGraph, length_of};

/// Part of a lane that a swerve occupies.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    pub lane: usize,
    pub from_m: f64,
    pub to_m: f64,
    pub agent: usize,
}

/// Claims of cells, by cell.
#[derive(Clone, Debug, Default)]
pub(super) struct Claims {
    /// Number of reservations, and one of their agents.
    owners: Vec<(u16, u32)>,
    /// True if the ego is or will be there, as far as known.
    ego: Vec<bool>,
    /// True if a vehicle that has waited long has the next claim.
    wanted: Vec<bool>,
    /// Cells of which something is known.
    known: Vec<u32>,
    pub blocks: Vec<Block>,
}

impl Claims {
    pub(super) fn new(cells: usize) -> Self {
        Self {
            owners: vec![(0, 0); cells],
            ego: vec![false; cells],
            wanted: vec![false; cells],
            ..Self::default()
        }
    }

    pub(super) fn build(&mut self, graph: &RoadGraph, agents: &[Agent], ego: Option<&EgoSeen>) {
        for cell in self.known.drain(..) {
            let cell = cell as usize;
            (self.owners[cell], self.ego[cell], self.wanted[cell]) = ((0, 0), false, false);
        }
        self.blocks.clear();
        for agent in agents {
            self.claim(graph, agent);
        }
        for &cell in ego.iter().flat_map(|ego| &ego.cells) {
            self.ego[cell as usize] = true;
            self.known.push(cell);
        }
    }

    /// All that belongs to an agent.
    pub(super) fn claim(&mut self, graph: &RoadGraph, agent: &Agent) {
        let granted_m = agent
            .crossing
            .filter(|crossing| crossing.granted)
            .map_or(f64::NEG_INFINITY, |crossing| crossing.to_m - 0.01);
        self.claim_between(graph, agent, agent.rear_m(), agent.stop_m().max(granted_m));
        match agent.aside.as_ref().map(|aside| &aside.kind) {
            Some(AsideKind::Change {
                from, from_arc_m, ..
            }) => {
                let reach_m = agent.stop_m() - agent.arc_m;
                for cell in
                    graph
                        .cells()
                        .range(*from, from_arc_m - agent.half_m, from_arc_m + reach_m)
                {
                    self.take(cell, agent.number);
                }
            }
            Some(AsideKind::Swerve { cells, .. }) => {
                for &cell in cells {
                    let (lane, stretch) = graph.cells().stretch_of(cell as usize);
                    self.blocks.push(Block {
                        lane,
                        from_m: stretch.from_m,
                        to_m: stretch.to_m,
                        agent: agent.number,
                    });
                    self.take(cell as usize, agent.number);
                }
            }
            None => {}
        }
    }

    /// Cells of an agent's path.
    pub(super) fn claim_between(
        &mut self,
        graph: &RoadGraph,
        agent: &Agent,
        from_m: f64,
        to_m: f64,
    ) {
        each_cell(graph, agent, from_m, to_m, |cell| {
            self.take(cell, agent.number);
            true
        });
    }

    fn take(&mut self, cell: usize, agent: usize) {
        let (count, owner) = &mut self.owners[cell];
        if *count == 0 {
            (*count, *owner) = (1, agent as u32);
            self.known.push(cell as u32);
        } else if *count > 1 || *owner != agent as u32 {
            *count = count.saturating_add(1);
        }
    }

    /// True if an agent other than `agent` has reserved a cell.
    pub(super) fn taken(&self, cell: usize, agent: usize) -> bool {
        let (count, owner) = self.owners[cell];
        count > 1 || (count == 1 && owner != agent as u32)
    }

    /// True if a cell that conflicts with `cell` is reserved by an agent other than `agent`.
    pub(super) fn conflict(&self, graph: &RoadGraph, cell: usize, agent: usize) -> bool {
        graph
            .cells()
            .conflicts_of(cell)
            .iter()
            .any(|&other| self.taken(other as usize, agent))
    }

    /// True if a vehicle that has waited longer has the next claim on a cell that conflicts with
    /// this one.
    pub(super) fn is_wanted(&self, graph: &RoadGraph, cell: usize) -> bool {
        graph
            .cells()
            .conflicts_of(cell)
            .iter()
            .any(|&other| self.wanted[other as usize])
    }

    pub(super) fn want(&mut self, cell: usize) {
        self.wanted[cell] = true;
        self.known.push(cell as u32);
    }

    /// True if the ego is or will be on a cell.
    pub(super) fn ego_on(&self, cell: usize) -> bool {
        self.ego[cell]
    }
}

/// Shows the cells of an agent's path between two places, meters from the start of its lane, until
/// `see` has seen enough; whether it saw all.
pub(super) fn each_cell(
    graph: &RoadGraph,
    agent: &Agent,
    from_m: f64,
    to_m: f64,
    mut see: impl FnMut(usize) -> bool,
) -> bool {
    let (mut at, mut start_m) = (agent.here, 0.0);
    while at > 0 && from_m < start_m {
        at -= 1;
        start_m -= length_of(graph.lanes(), agent.path[at]);
    }
    while at < agent.path.len() && start_m <= to_m {
        let lane = agent.path[at];
        let length_m = length_of(graph.lanes(), lane);
        if from_m <= start_m + length_m || at + 1 == agent.path.len() {
            for cell in graph.cells().range(lane, from_m - start_m, to_m - start_m) {
                if !see(cell) {
                    return false;
                }
            }
        }
        start_m += length_m;
        at += 1;
    }
    true
}
