//! The driving lanes of a map as a graph: what each continues in, what lies beside it and which
//! lanes cross it.

mod borders;
mod cells;
mod conflicts;
mod corridor;
mod path;
#[cfg(test)]
mod tests;

use decouplegs_scene::{Invalid, LaneKind, LaneMap, VehicleSize};

use crate::polyline::{Polyline, wrapped};

pub(crate) use cells::{Cells, speed_before};
pub(crate) use path::{length_of, position_on};

/// Default speed limit: 50 km/h, as in a town.
const SPEED_LIMIT_MPS: f64 = 50.0 / 3.6;
/// A lane whose successor begins farther than this from its end does not lead there, meters.
const LINK_GAP_M: f64 = 2.0;
/// A lane that turns by less is straight.
const STRAIGHT_RAD: f64 = 0.35;
/// Most meters of lanes: those of a large city. More is taken for a mistake before anything is made
/// of its size.
const LENGTH_M_MAX: f64 = 5e6;
/// Ways on are told apart up to this length: longer ones are as good as endless, meters.
const ONWARD_M_MAX: f64 = 2000.0;

/// Conflict between two lanes: vehicles on these stretches may touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conflict {
    /// Index of the other lane in [`LaneMap::lanes`].
    pub other: usize,
    /// Start of the stretch on this lane, meters along it.
    pub from_m: f64,
    /// End of the stretch on this lane.
    pub to_m: f64,
    /// Start of the stretch on the other lane.
    pub other_from_m: f64,
    /// End of the stretch on the other lane.
    pub other_to_m: f64,
    /// True if this lane has priority.
    pub goes_first: bool,
}

/// Fork: another lane that leaves the same lane as this one. Vehicles on it follow those on this
/// one as if on their own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fork {
    pub other: usize,
    /// End of the stretch of this lane that is in the way of the other, meters along it.
    pub to_m: f64,
    /// Largest offset along this lane between a conflicting point and its counterpart on the other,
    /// meters.
    pub lead_m: f64,
}

/// A lane that vehicles drive on.
#[derive(Clone, Debug)]
pub struct RoadLane {
    /// Id in the map.
    pub id: String,
    /// Centerline, from start to end.
    pub line: Polyline,
    /// Driving lanes that it continues in, indices in [`LaneMap::lanes`].
    pub successors: Vec<usize>,
    /// Driving lanes that continue in it.
    pub predecessors: Vec<usize>,
    /// The driving lane to the left with the same direction.
    pub left: Option<usize>,
    /// The driving lane to the right with the same direction.
    pub right: Option<usize>,
    /// 50 km/h where the map tells none.
    pub speed_limit_mps: f64,
    /// True if the map tells the limit.
    pub(crate) has_limit: bool,
    /// Change of heading from start to end, radians, positive to the left.
    pub turn_rad: f64,
    /// Conflicts with other lanes: crossing or merging.
    pub conflicts: Vec<Conflict>,
    /// The longest way on from its start, at most 2 km.
    pub onward_m: f64,
    /// True if it ends at the border of the map: no lane beside it goes on either.
    pub leaves_map: bool,
    pub(crate) forks: Vec<Fork>,
    /// True if z is the road's height.
    has_height: bool,
}

/// Driving lanes by their index in the map, and where they are in each other's way.
///
/// Conflicts are found for vehicles up to [`RoadGraph::vehicle`]; the corridor of a lane is what
/// such a vehicle sweeps when the middle of its box follows the lane's line.
///
/// Priority where two lanes conflict: straight on before turning; else the lane from the right;
/// else (from the front, or side by side) the lane that turns less to the left; else the lane named
/// first in the map. One of two lanes always has priority.
#[derive(Clone, Debug)]
pub struct RoadGraph {
    lanes: Vec<Option<RoadLane>>,
    by_id: Vec<usize>,
    entrances: Vec<usize>,
    vehicle: VehicleSize,
    cells: Cells,
}

impl RoadGraph {
    /// A vehicle that most cars and vans are smaller than.
    pub const VEHICLE: VehicleSize = VehicleSize {
        length_m: 5.4,
        width_m: 2.0,
        height_m: 2.0,
    };

    /// The graph of the driving lanes of `map`, for vehicles up to [`RoadGraph::VEHICLE`].
    ///
    /// Links to lanes that begin more than 2 m from the lane's end, or that nobody drives on, are
    /// left out.
    ///
    /// # Errors
    /// Returns an error for what [`LaneMap::check`] refuses, a centerline that is no line, more
    /// than 5,000 km of lanes, or more of them in one place than a city has.
    pub fn new(map: &LaneMap) -> Result<Self, Invalid> {
        map.check()?;
        let mut lanes = Vec::with_capacity(map.lanes.len());
        for lane in &map.lanes {
            let line = Polyline::new(lane.centerline.iter().copied());
            let line = line.ok_or_else(|| {
                Invalid::new(format!(
                    "lane {}: its centerline is one point; expected a line",
                    lane.id
                ))
            })?;
            lanes.push((lane.kind == LaneKind::Driving).then(|| {
                RoadLane {
                    id: lane.id.clone(),
                    successors: Vec::new(),
                    predecessors: Vec::new(),
                    left: lane
                        .left_neighbor
                        .filter(|&other| map.lanes[other].kind == LaneKind::Driving),
                    right: lane
                        .right_neighbor
                        .filter(|&other| map.lanes[other].kind == LaneKind::Driving),
                    speed_limit_mps: lane
                        .speed_limit_mps
                        .filter(|limit| *limit > 0.0)
                        .unwrap_or(SPEED_LIMIT_MPS),
                    has_limit: lane.speed_limit_mps.is_some_and(|limit| limit > 0.0),
                    turn_rad: wrapped(line.heading_at(line.length_m()) - line.heading_at(0.0)),
                    conflicts: Vec::new(),
                    onward_m: 0.0,
                    leaves_map: false,
                    forks: Vec::new(),
                    has_height: lane.has_height,
                    line,
                }
            }));
        }
        let length_m: f64 = lanes
            .iter()
            .flatten()
            .map(|lane: &RoadLane| lane.line.length_m())
            .sum();
        if length_m.is_nan() || length_m > LENGTH_M_MAX {
            return Err(Invalid::new(format!(
                "{:.0} km of driving lanes; expected at most {:.0}",
                length_m / 1e3,
                LENGTH_M_MAX / 1e3
            )));
        }
        link(map, &mut lanes);
        find_ways_on(&mut lanes);
        let entrances = borders::find(&mut lanes);
        let mut by_id: Vec<usize> = (0..lanes.len())
            .filter(|&lane| lanes[lane].is_some())
            .collect();
        by_id.sort_by(|&a, &b| map.lanes[a].id.cmp(&map.lanes[b].id));
        let graph = Self {
            lanes,
            by_id,
            entrances,
            vehicle: Self::VEHICLE,
            cells: Cells::default(),
        };
        graph.for_vehicle(Self::VEHICLE)
    }

    /// The same lanes for vehicles up to another size.
    ///
    /// # Errors
    /// Returns an error if the size is no vehicle's, or lanes lie upon each other by the thousand.
    pub fn for_vehicle(mut self, vehicle: VehicleSize) -> Result<Self, Invalid> {
        let [length_m, width_m, _] = vehicle.to_array();
        if !(0.1..=40.0).contains(&length_m) || !(0.1..=10.0).contains(&width_m) {
            return Err(Invalid::new(format!(
                "a vehicle of {length_m} by {width_m} m; expected 0.1 to 40 by 0.1 to 10"
            )));
        }
        self.vehicle = vehicle;
        let (cells, conflicts, forks) = conflicts::find(&self.lanes, vehicle)?;
        self.cells = cells;
        for ((lane, conflicts), forks) in self.lanes.iter_mut().zip(conflicts).zip(forks) {
            if let Some(lane) = lane {
                (lane.conflicts, lane.forks) = (conflicts, forks);
            }
        }
        Ok(self)
    }

    /// The largest vehicle that its conflicts are right for.
    #[must_use]
    pub fn vehicle(&self) -> VehicleSize {
        self.vehicle
    }

    /// Number of lanes of the map, including those without traffic.
    #[must_use]
    pub fn lanes_in_map(&self) -> usize {
        self.lanes.len()
    }

    /// A lane by its index in [`LaneMap::lanes`]; none where vehicles do not drive on it.
    #[must_use]
    pub fn lane(&self, lane: usize) -> Option<&RoadLane> {
        self.lanes.get(lane)?.as_ref()
    }

    /// Index of the driving lane `id` in [`LaneMap::lanes`].
    #[must_use]
    pub fn find(&self, id: &str) -> Option<usize> {
        let name = |&lane: &usize| {
            self.lanes[lane]
                .as_ref()
                .map_or("", |lane| lane.id.as_str())
        };
        let at = self
            .by_id
            .binary_search_by(|lane| name(lane).cmp(id))
            .ok()?;
        Some(self.by_id[at])
    }

    /// Lanes that begin at the border of the map, indices in [`LaneMap::lanes`].
    #[must_use]
    pub fn entrances(&self) -> &[usize] {
        &self.entrances
    }

    pub(crate) fn cells(&self) -> &Cells {
        &self.cells
    }

    pub(crate) fn lanes(&self) -> &[Option<RoadLane>] {
        &self.lanes
    }

    /// A lane that is known to be driven on.
    pub(crate) fn road(&self, lane: usize) -> &RoadLane {
        self.lanes[lane]
            .as_ref()
            .expect("paths and links lead over driving lanes only")
    }
}

/// Successors as the map has them, where they begin at the lane's end, and predecessors to match.
fn link(map: &LaneMap, lanes: &mut [Option<RoadLane>]) {
    let mut links = Vec::new();
    for (from, lane) in map.lanes.iter().enumerate() {
        let ahead = lane.successors.iter().map(|&to| (from, to));
        links.extend(ahead.chain(lane.predecessors.iter().map(|&before| (before, from))));
    }
    links.sort_unstable();
    links.dedup();
    for (from, to) in links {
        let (Some(before), Some(after)) = (&lanes[from], &lanes[to]) else {
            continue;
        };
        let end = before.line.at(before.line.length_m()).truncate();
        if from != to && end.distance(after.line.at(0.0).truncate()) <= LINK_GAP_M {
            lanes[from]
                .iter_mut()
                .for_each(|lane| lane.successors.push(to));
            lanes[to]
                .iter_mut()
                .for_each(|lane| lane.predecessors.push(from));
        }
    }
}

/// The longest way on from each lane: on a circle it grows to the most that is told apart.
fn find_ways_on(lanes: &mut [Option<RoadLane>]) {
    // Lanes whose way may have grown; each grows by at least its own length, so the work has an
    // end.
    let mut open: Vec<usize> = (0..lanes.len())
        .rev()
        .filter(|&lane| lanes[lane].is_some())
        .collect();
    let mut rises = vec![0_u32; lanes.len()];
    while let Some(at) = open.pop() {
        let Some(lane) = &lanes[at] else { continue };
        let beyond = lane
            .successors
            .iter()
            .filter_map(|&next| Some(lanes[next].as_ref()?.onward_m))
            .fold(0.0, f64::max);
        let mut onward_m = (lane.line.length_m() + beyond).min(ONWARD_M_MAX);
        if rises[at] > 200 {
            // A circle of very short lanes.
            onward_m = ONWARD_M_MAX;
        }
        if onward_m > lane.onward_m {
            rises[at] += 1;
            open.extend(lane.predecessors.iter().copied());
            lanes[at]
                .iter_mut()
                .for_each(|lane| lane.onward_m = onward_m);
        }
    }
}
