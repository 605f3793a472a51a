//! Traffic lights of a scenario on the lanes of a road graph.

use decouplegs_scene::episode::StopLineRecord;
use decouplegs_scene::{Invalid, LaneMap, LightChange, LightColor, StopLine, TrafficLight};
use glam::DVec2;

use crate::polyline::Polyline;
use crate::road_graph::RoadGraph;

/// Half the width of a lane whose borders are unknown, meters.
const HALF_LANE_M: f64 = 1.75;
/// Largest distance of a stop line beyond the end of its lane, meters: files round.
const BEYOND_M: f64 = 0.5;

/// Stop line on a lane.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneStopLine {
    /// Index of the lane in [`LaneMap::lanes`].
    pub lane: usize,
    /// Place on the lane, meters along it.
    pub at_m: f64,
    /// The line on the plane, and the index of its light or sign.
    pub record: StopLineRecord,
    /// Successors of the lane that it is for, indices in the map; none: all of them.
    pub towards: Vec<usize>,
}

impl LaneStopLine {
    /// `line` on a driving lane of `graph`, which is of `map`.
    pub(crate) fn new(
        map: &LaneMap,
        graph: &RoadGraph,
        line: &StopLine,
        index: usize,
    ) -> Result<Self, Invalid> {
        let id = &line.lane;
        let road = graph
            .find(id)
            .and_then(|lane| Some((lane, graph.lane(lane)?)));
        let Some((lane, road)) = road else {
            return Err(Invalid::new(format!(
                "lane {id} is not a driving lane of the map"
            )));
        };
        let length_m = road.line.length_m();
        if !(0.0..=length_m + BEYOND_M).contains(&line.at_m) {
            return Err(Invalid::new(format!(
                "a stop line {} m along lane {id}; expected 0 to {length_m:.2}",
                line.at_m
            )));
        }
        let at_m = line.at_m.min(length_m);
        let ends_m = ends(map, lane, &road.line, at_m);
        let record = StopLineRecord { index, ends_m };
        let mut towards = Vec::with_capacity(line.towards.len());
        for next in &line.towards {
            let index = graph.find(next);
            let follows = index.filter(|index| map.lanes[lane].successors.contains(index));
            towards.push(follows.ok_or_else(|| {
                Invalid::new(format!(
                    "a stop line of lane {id} towards lane {next}; expected lanes that follow it"
                ))
            })?);
        }
        Ok(Self {
            lane,
            at_m,
            record,
            towards,
        })
    }

    /// True if a vehicle that goes on to lane `next` obeys it. One whose way ends or is not known
    /// obeys the lines alone that are for all ways.
    #[must_use]
    pub fn binds(&self, next: Option<usize>) -> bool {
        self.towards.is_empty() || next.is_some_and(|next| self.towards.contains(&next))
    }

    /// True if it is for a vehicle on a route over `lanes`, in order, wherever that leaves them: a
    /// line of a lane that the route does not pass towards a successor is.
    #[must_use]
    pub fn concerns(&self, lanes: &[usize]) -> bool {
        let at = lanes.iter().position(|&lane| lane == self.lane);
        at.is_none_or(|at| self.binds(lanes.get(at + 1).copied()))
    }

    /// Stop lines on `lane` among `lines`, which are sorted by lane.
    pub(crate) fn on(lines: &[Self], lane: usize) -> &[Self] {
        let from = lines.partition_point(|line| line.lane < lane);
        let to = lines.partition_point(|line| line.lane <= lane);
        &lines[from..to]
    }
}

/// Traffic lights with the positions of their stop lines.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrafficLights {
    lights: Vec<TrafficLight>,
    /// Stop lines, sorted by lane, then along it.
    lines: Vec<LaneStopLine>,
}

impl TrafficLights {
    /// `lights` on the driving lanes of `graph`, which is of `map`, before any of them changes.
    ///
    /// # Errors
    /// Returns an error if a stop line is on no driving lane of the map, or beyond its end.
    pub fn new(map: &LaneMap, graph: &RoadGraph, lights: &[TrafficLight]) -> Result<Self, Invalid> {
        let mut lines = Vec::new();
        for (index, TrafficLight { name, .. }) in lights.iter().enumerate() {
            for line in &lights[index].stop_lines {
                let line = LaneStopLine::new(map, graph, line, index);
                lines.push(
                    line.map_err(|error| Invalid::new(format!("traffic light {name}: {error}")))?,
                );
            }
        }
        lines.sort_by(|a, b| a.lane.cmp(&b.lane).then(a.at_m.total_cmp(&b.at_m)));
        let mut lights = lights.to_vec();
        lights.iter_mut().for_each(|light| light.changes.clear());
        Ok(Self { lights, lines })
    }

    /// Adds a change, which is not before those that are known.
    pub(crate) fn change(&mut self, light: usize, change: LightChange) {
        if let Some(light) = self.lights.get_mut(light) {
            light.changes.push(change);
        }
    }

    /// Index of the light with a name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        self.lights.iter().position(|light| light.name == name)
    }

    /// True if there is no stop line.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    /// All stop lines, by lane and then along it.
    #[must_use]
    pub fn lines(&self) -> &[LaneStopLine] {
        &self.lines
    }

    /// Stop lines on a lane, in driving direction.
    #[must_use]
    pub fn on(&self, lane: usize) -> &[LaneStopLine] {
        LaneStopLine::on(&self.lines, lane)
    }

    /// Color of a light, by its index in the scenario, seconds since the start.
    ///
    /// # Panics
    /// Panics if there is no such light.
    #[must_use]
    pub fn color_at(&self, light: usize, time_s: f64) -> LightColor {
        self.lights[light].color_at(time_s)
    }
}

/// Right and left end of a stop line: the borders of its lane where the map has them.
fn ends(map: &LaneMap, lane: usize, line: &Polyline, at_m: f64) -> [DVec2; 2] {
    let middle_m = line.at(at_m).truncate();
    let left = DVec2::from_angle(line.heading_at(at_m)).perp();
    let half_m = |border: &[glam::DVec3]| {
        let border = Polyline::new(border.iter().copied());
        let offset_m = border.map(|border| border.project(middle_m).distance_m);
        offset_m
            .filter(|offset_m| (0.5..4.0 * HALF_LANE_M).contains(offset_m))
            .unwrap_or(HALF_LANE_M)
    };
    let lane = &map.lanes[lane];
    [
        middle_m - left * half_m(&lane.right),
        middle_m + left * half_m(&lane.left),
    ]
}
