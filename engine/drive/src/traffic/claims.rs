//! Reservation of road cells: cells occupied by vehicles, cells of their stopping distances, and
//! crossings granted to them.
//!
//! No vehicle moves to where it could not stop before a cell that conflicts with another's; so
//! vehicles on different lanes never meet. (Reservations of cells at crossings: K. Dresner, P.
//! Stone, A multiagent approach to autonomous intersection management, 2008.)

use super::agent::{Agent, AsideKind};
use super::outsider::Outsiders;
use crate::road_graph::{RoadGraph, length_of};

/// Part of a lane that belongs to an agent which is not on it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    pub lane: usize,
    pub from_m: f64,
    pub to_m: f64,
    pub agent: usize,
}

/// Speed below which a vehicle stands, m/s.
const STANDING_MPS: f64 = 0.3;

/// Agents that have something: how many, and one of them.
#[derive(Clone, Copy, Debug, Default)]
struct Owners {
    count: u16,
    one: u32,
}

impl Owners {
    fn add(&mut self, agent: usize) {
        if self.count == 0 {
            *self = Self {
                count: 1,
                one: agent as u32,
            };
        } else if self.count > 1 || self.one != agent as u32 {
            self.count = self.count.saturating_add(1);
        }
    }

    /// True if an agent other than `agent` is among them.
    fn others_than(self, agent: usize) -> bool {
        self.count > 1 || (self.count == 1 && self.one != agent as u32)
    }
}

/// Claims of cells, by cell.
#[derive(Clone, Debug, Default)]
pub(super) struct Claims {
    owners: Vec<Owners>,
    /// Owners that stand, by cell.
    standing: Vec<Owners>,
    /// True if an ego, or a pedestrian, is or will be there, as far as known.
    ego: Vec<bool>,
    pedestrians: Vec<bool>,
    /// True if a vehicle that has waited long has the next claim.
    wanted: Vec<bool>,
    /// Cells of which something is known.
    known: Vec<u32>,
    /// Parts of other lanes that swerves take up.
    pub blocks: Vec<Block>,
    /// Room that is kept for agents behind a crossing that is granted to them, and on the lane that
    /// they are leaving.
    pub rooms: Vec<Block>,
}

impl Claims {
    pub(super) fn new(cells: usize) -> Self {
        Self {
            owners: vec![Owners::default(); cells],
            standing: vec![Owners::default(); cells],
            ego: vec![false; cells],
            pedestrians: vec![false; cells],
            wanted: vec![false; cells],
            ..Self::default()
        }
    }

    pub(super) fn build(&mut self, graph: &RoadGraph, agents: &[Agent], outsiders: &Outsiders) {
        for cell in self.known.drain(..) {
            let cell = cell as usize;
            (self.owners[cell], self.standing[cell]) = Default::default();
            (self.ego[cell], self.pedestrians[cell]) = (false, false);
            self.wanted[cell] = false;
        }
        self.blocks.clear();
        self.rooms.clear();
        for agent in agents.iter().filter(|agent| agent.is_here()) {
            self.claim(graph, agent);
        }
        for &cell in outsiders.egos.iter().flat_map(|ego| &ego.cells) {
            self.ego[cell as usize] = true;
            self.known.push(cell);
        }
        for &cell in outsiders
            .pedestrians
            .iter()
            .flat_map(|walker| &walker.cells)
        {
            self.pedestrians[cell as usize] = true;
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
        if granted_m > f64::NEG_INFINITY {
            self.keep_room(graph, agent, granted_m);
        }
        if let Some((from, from_arc_m)) = agent.left_lane() {
            let (rear_m, front_m) = (from_arc_m - agent.half_m, from_arc_m + agent.half_m);
            let stop_m = from_arc_m + agent.stop_m() - agent.arc_m;
            for cell in graph.cells().range(from, rear_m, stop_m) {
                self.take(cell, agent);
            }
            // No other vehicle enters the part of the lane that its box sweeps.
            self.rooms.push(Block {
                lane: from,
                from_m: rear_m,
                to_m: front_m + agent.leaving_m().max(0.0),
                agent: agent.number,
            });
        }
        if let Some(AsideKind::Swerve { cells, .. }) = agent.aside.as_ref().map(|aside| &aside.kind)
        {
            for &cell in cells {
                let (lane, stretch) = graph.cells().stretch_of(cell as usize);
                self.blocks.push(Block {
                    lane,
                    from_m: stretch.from_m,
                    to_m: stretch.to_m,
                    agent: agent.number,
                });
                self.take(cell as usize, agent);
            }
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
            self.take(cell, agent);
            true
        });
    }

    /// Keeps room for an agent behind the crossing that ends at `out_m` on its path.
    fn keep_room(&mut self, graph: &RoadGraph, agent: &Agent, out_m: f64) {
        let mut start_m = 0.0;
        let end_m = out_m + agent.clearance_m();
        for &lane in &agent.path[agent.here..] {
            let length_m = length_of(graph.lanes(), lane);
            if start_m + length_m > out_m {
                self.rooms.push(Block {
                    lane,
                    from_m: out_m - start_m,
                    to_m: (end_m - start_m).min(length_m),
                    agent: agent.number,
                });
            }
            start_m += length_m;
            if start_m > end_m {
                break;
            }
        }
    }

    /// True if part of a lane is kept for an agent other than `agent` to leave its crossing.
    pub(super) fn is_kept(&self, agent: usize, lane: usize, from_m: f64, to_m: f64) -> bool {
        self.rooms.iter().any(|room| {
            room.agent != agent && room.lane == lane && room.from_m < to_m && room.to_m > from_m
        })
    }

    fn take(&mut self, cell: usize, agent: &Agent) {
        self.owners[cell].add(agent.number);
        self.known.push(cell as u32);
        if agent.speed_mps < STANDING_MPS {
            self.standing[cell].add(agent.number);
        }
    }

    /// True if an agent other than `agent` has reserved a cell.
    pub(super) fn taken(&self, cell: usize, agent: usize) -> bool {
        self.owners[cell].others_than(agent)
    }

    /// True if a cell that conflicts with `cell` is reserved by an agent other than `agent` that
    /// stands.
    pub(super) fn is_stood_on(&self, graph: &RoadGraph, cell: usize, agent: usize) -> bool {
        let conflicts = graph.cells().conflicts_of(cell);
        conflicts
            .iter()
            .any(|&other| self.standing[other as usize].others_than(agent))
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

    /// True if an ego is or will be on a cell.
    pub(super) fn ego_on(&self, cell: usize) -> bool {
        self.ego[cell]
    }

    /// True if a pedestrian is or will be on a cell.
    pub(super) fn pedestrian_on(&self, cell: usize) -> bool {
        self.pedestrians[cell]
    }
}

/// Shows the cells of an agent's path between two positions, meters from the start of its lane,
/// until `see` has seen enough; whether it saw all.
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
