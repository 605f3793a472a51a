//! Stop and yield signs of a scenario on the lanes of a road graph.

use decouplegs_scene::{Invalid, LaneMap, SignKind, TrafficSign};

use crate::lights::LaneStopLine;
use crate::road_graph::RoadGraph;

/// Ways over a crossing begin within this behind the line of a sign, meters.
const CROSSING_M: f64 = 40.0;

/// Traffic signs with the places of their lines.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrafficSigns {
    kinds: Vec<SignKind>,
    /// Stop lines, sorted by lane, then along it. The index of a record is that of its sign.
    lines: Vec<LaneStopLine>,
    /// True for lanes over a crossing that only lead on from signs; by lane.
    minor: Vec<bool>,
}

impl TrafficSigns {
    /// `signs` on the driving lanes of `graph`, which is of `map`.
    ///
    /// # Errors
    /// Returns an error if a line is on no driving lane of the map, or beyond its end.
    pub fn new(map: &LaneMap, graph: &RoadGraph, signs: &[TrafficSign]) -> Result<Self, Invalid> {
        let mut lines = Vec::with_capacity(signs.len());
        for (index, sign) in signs.iter().enumerate() {
            let line = LaneStopLine::new(map, graph, &sign.line, index);
            lines.push(line.map_err(|error| {
                Invalid::new(format!("{} sign {index}: {error}", sign.kind.name()))
            })?);
        }
        lines.sort_by(|a, b| a.lane.cmp(&b.lane).then(a.at_m.total_cmp(&b.at_m)));
        let mut made = Self {
            kinds: signs.iter().map(|sign| sign.kind).collect(),
            lines,
            minor: Vec::new(),
        };
        if !signs.is_empty() {
            made.minor = made.minor_lanes(graph);
        }
        Ok(made)
    }

    /// Lanes that lead on from the lanes with signs, as far as other lanes are in their way and no
    /// lane without a sign leads to them.
    fn minor_lanes(&self, graph: &RoadGraph) -> Vec<bool> {
        let mut minor = vec![false; graph.lanes_in_map()];
        let mut open: Vec<(usize, f64)> = Vec::new();
        for line in &self.lines {
            minor[line.lane] = true;
            open.push((line.lane, -line.at_m));
        }
        while let Some((lane, begin_m)) = open.pop() {
            let Some(road) = graph.lane(lane) else {
                continue;
            };
            let end_m = begin_m + road.line.length_m();
            for &next in &road.successors {
                let is_way = graph.lane(next).is_some_and(|way| {
                    !way.conflicts.is_empty() && way.predecessors.iter().all(|&from| minor[from])
                });
                if end_m < CROSSING_M && is_way && !minor[next] {
                    minor[next] = true;
                    open.push((next, end_m));
                }
            }
        }
        minor
    }

    /// All lines, by lane and then along it.
    #[must_use]
    pub fn lines(&self) -> &[LaneStopLine] {
        &self.lines
    }

    /// Lines on a lane, in driving direction.
    #[must_use]
    pub fn on(&self, lane: usize) -> &[LaneStopLine] {
        LaneStopLine::on(&self.lines, lane)
    }

    /// Kind of a sign, by its index in the scenario.
    ///
    /// # Panics
    /// Panics if there is no such sign.
    #[must_use]
    pub fn kind(&self, sign: usize) -> SignKind {
        self.kinds[sign]
    }

    /// True if vehicles on a lane give way to those on lanes without signs.
    #[must_use]
    pub fn is_minor(&self, lane: usize) -> bool {
        self.minor.get(lane).copied().unwrap_or(false)
    }
}
