//! Phases of the traffic lights of a map.

use decouplegs_scene::{LaneMap, LightColor, LightPhase, StopLine, TrafficLight};

use super::random::Stream;
use super::{to_centimeter, to_tenth};
use crate::polyline::wrapped;
use crate::road_graph::RoadGraph;

/// Green, and the time in which all lights of a crossing are red, seconds. Cycles are shorter than
/// in most towns, so that an episode of half a minute sees them change.
const GREEN_S: f64 = 12.0;
const ALL_RED_S: f64 = 2.0;
/// Yellow, seconds, by the speed limit, m/s (RiLSA, Forschungsgesellschaft für Straßen- und
/// Verkehrswesen, 2015): the first that is not below the limit.
const YELLOW_S: [(f64, f64); 3] = [(50.0 / 3.6, 3.0), (60.0 / 3.6, 4.0), (f64::INFINITY, 5.0)];
/// Largest distance behind a stop line at which lanes belong to its crossing, meters.
const CROSSING_M: f64 = 60.0;
/// Lanes behind a stop line that are examined at most.
const LANES_MAX: usize = 64;

/// Stop line of a light without phases.
struct Approach<'a> {
    line: &'a StopLine,
    /// Lanes from the line on, sorted.
    ahead: Vec<usize>,
    heading_rad: f64,
    speed_limit_mps: f64,
}

/// The traffic lights of `map`, with phases, at a random position in their cycles. Lights whose
/// phases the map does not tell are grouped: those that cross each other are never green together,
/// and those of one direction or the opposite one always are.
pub(super) fn programs(map: &LaneMap, graph: &RoadGraph, random: &mut Stream) -> Vec<TrafficLight> {
    let told = map.lights.iter().filter(|light| !light.phases.is_empty());
    let mut lights: Vec<TrafficLight> = told.cloned().collect();
    let untold = map.lights.iter().filter(|light| light.phases.is_empty());
    let approaches: Vec<Approach> = untold
        .flat_map(|light| &light.stop_lines)
        .filter_map(|line| Approach::new(map, graph, line))
        .collect();
    for (number, crossing) in crossings(graph, &approaches).iter().enumerate() {
        lights.extend(light_crossing(number, crossing));
    }
    // One shift for all keeps them in step.
    let shift = random.unit();
    for light in &mut lights {
        for line in &mut light.stop_lines {
            line.at_m = to_centimeter(line.at_m);
        }
        light.offset_s = to_tenth(light.offset_s + shift * light.cycle_s());
    }
    lights
}

impl<'a> Approach<'a> {
    /// `None` where the line is on no driving lane.
    fn new(map: &LaneMap, graph: &RoadGraph, line: &'a StopLine) -> Option<Self> {
        let lane = graph.find(&line.lane)?;
        let road = graph.lane(lane)?;
        let mut ahead = vec![lane];
        let mut open = vec![(lane, -line.at_m)];
        while let Some((at, begin_m)) = open.pop() {
            let Some(road) = graph.lane(at) else { continue };
            let end_m = begin_m + road.line.length_m();
            for &next in &road.successors {
                let leads = at != lane || line.binds(Some(&map.lanes[next].id));
                if leads && end_m < CROSSING_M && ahead.len() < LANES_MAX && !ahead.contains(&next)
                {
                    ahead.push(next);
                    open.push((next, end_m));
                }
            }
        }
        ahead.sort_unstable();
        Some(Self {
            line,
            ahead,
            heading_rad: road.line.heading_at(line.at_m),
            speed_limit_mps: road.speed_limit_mps,
        })
    }

    /// True if the ways behind two lines are in each other's way.
    fn meets(&self, graph: &RoadGraph, other: &Self) -> bool {
        self.ahead.iter().any(|&lane| {
            other.ahead.binary_search(&lane).is_ok()
                || graph.lane(lane).is_some_and(|road| {
                    let mut conflicts = road.conflicts.iter();
                    conflicts.any(|conflict| other.ahead.binary_search(&conflict.other).is_ok())
                })
        })
    }
}

/// Approaches of the same crossing, crossing by crossing.
fn crossings<'a, 'b>(
    graph: &RoadGraph,
    approaches: &'b [Approach<'a>],
) -> Vec<Vec<&'b Approach<'a>>> {
    let mut crossings: Vec<Vec<&Approach>> = Vec::new();
    for approach in approaches {
        let (met, mut others): (Vec<_>, Vec<_>) = crossings
            .into_iter()
            .partition(|crossing| crossing.iter().any(|other| approach.meets(graph, other)));
        let mut crossing: Vec<&Approach> = met.into_iter().flatten().collect();
        crossing.push(approach);
        others.push(crossing);
        crossings = others;
    }
    crossings
}

/// Lights of a crossing: one for the direction of its first approach and the opposite one, one for
/// those across.
fn light_crossing(number: usize, approaches: &[&Approach]) -> Vec<TrafficLight> {
    let first_rad = approaches[0].heading_rad;
    let along = |approach: &Approach| {
        let off_rad = wrapped(approach.heading_rad - first_rad).abs();
        off_rad.min(std::f64::consts::PI - off_rad) < std::f64::consts::FRAC_PI_4
    };
    let (main, cross): (Vec<&Approach>, Vec<&Approach>) =
        approaches.iter().partition(|approach| along(approach));
    let limit_mps = approaches
        .iter()
        .map(|approach| approach.speed_limit_mps)
        .fold(0.0, f64::max);
    let yellow = YELLOW_S
        .iter()
        .find(|(most_mps, _)| limit_mps <= most_mps + 0.1);
    let yellow_s = yellow.map_or(5.0, |(_, yellow_s)| *yellow_s);
    let half_s = GREEN_S + yellow_s + ALL_RED_S;
    let phase = |color, duration_s| LightPhase { color, duration_s };
    let groups = [("main", main, 0.0), ("cross", cross, half_s)];
    groups
        .into_iter()
        .filter(|(_, approaches, _)| !approaches.is_empty())
        .map(|(name, approaches, offset_s)| TrafficLight {
            name: format!("crossing_{number}_{name}"),
            stop_lines: approaches
                .iter()
                .map(|approach| approach.line.clone())
                .collect(),
            phases: vec![
                phase(LightColor::Green, GREEN_S),
                phase(LightColor::Yellow, yellow_s),
                phase(LightColor::Red, half_s + ALL_RED_S),
            ],
            offset_s,
            changes: Vec::new(),
        })
        .collect()
}
