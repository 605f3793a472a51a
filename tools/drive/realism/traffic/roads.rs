//! The map of compared traffic: lanes, their edge and their traffic lights.

use std::sync::Arc;

use decouplegs::drive::lights::TrafficLights;
use decouplegs::drive::polyline::wrapped;
use decouplegs::drive::{LaneIndex, LanePoint, OrientedBox, RoadGraph, RoadSurface};
use decouplegs::scene::{Invalid, LaneKind, LaneMap, LightColor, TrafficLight, VehicleSize};
use glam::{DVec2, DVec3};

/// Distance from the middle of a lane within which a vehicle is on it, meters, and the angle
/// beyond which it is not, radians.
const ON_LANE_M: f64 = 2.2;
const ALONG_RAD: f64 = 0.6;
/// Spacing of points on the edge of the road, and how far beyond a border no lane is where it is
/// an edge, meters.
const EDGE_STEP_M: f64 = 1.0;
const BEYOND_M: f64 = 0.4;
/// Farthest that the edge is looked for, meters.
const EDGE_M: f64 = 40.0;

/// Largest vehicle of traffic, meters.
const LENGTH_M_MAX: f64 = 25.0;
const WIDTH_M_MAX: f64 = 4.0;

/// Lanes, and what is found on them.
pub struct Roads {
    pub map: LaneMap,
    pub graph: Arc<RoadGraph>,
    pub index: LaneIndex,
    pub lights: Arc<TrafficLights>,
    surface: RoadSurface,
    /// Points on the edge of the union of driving lanes.
    edge: Vec<DVec2>,
}

impl Roads {
    /// # Errors
    /// A sentence where the lanes form no roads.
    pub fn new(map: LaneMap) -> Result<Self, Invalid> {
        let graph = RoadGraph::new(&map)?;
        // Lights whose phases the file does not tell were of some color, nobody knows which.
        let told: Vec<TrafficLight> = map
            .lights
            .iter()
            .filter(|light| !light.phases.is_empty())
            .cloned()
            .collect();
        let lights = TrafficLights::new(&map, &graph, &told)?;
        let surface = RoadSurface::new(&map);
        Ok(Self {
            edge: edge(&map, &surface),
            index: LaneIndex::new(&map),
            graph: Arc::new(graph),
            lights: Arc::new(lights),
            surface,
            map,
        })
    }

    /// The same roads for vehicles of `sizes`, where they are larger than most.
    ///
    /// # Errors
    /// A sentence where lanes lie upon each other by the thousand.
    pub fn for_vehicles(
        self,
        sizes: impl IntoIterator<Item = VehicleSize>,
    ) -> Result<Self, Invalid> {
        let mut largest = self.graph.vehicle();
        for size in sizes {
            largest.length_m = largest.length_m.max(size.length_m.min(LENGTH_M_MAX));
            largest.width_m = largest.width_m.max(size.width_m.min(WIDTH_M_MAX));
        }
        if largest == self.graph.vehicle() {
            return Ok(self);
        }
        let graph = RoadGraph::clone(&self.graph).for_vehicle(largest)?;
        Ok(Self {
            graph: Arc::new(graph),
            ..self
        })
    }

    /// The driving lane that a vehicle is on.
    pub fn lane_at(&self, at_m: DVec2, yaw_rad: f64) -> Option<LanePoint> {
        let near = self.index.lanes_near(at_m, ON_LANE_M);
        near.into_iter().find(|point| {
            let turn_rad = wrapped(point.foot.heading_rad - yaw_rad);
            self.map.lanes[point.lane].kind == LaneKind::Driving && turn_rad.abs() < ALONG_RAD
        })
    }

    /// Distance of a box beyond the edge of the road, meters, of the corner that is farthest out:
    /// below zero on the road.
    pub fn beyond_edge_m(&self, outline: &OrientedBox) -> f64 {
        let signed = |corner: DVec2| {
            let squares = self.edge.iter().map(|edge| edge.distance_squared(corner));
            let distance_m = squares.fold(EDGE_M * EDGE_M, f64::min).sqrt();
            match self.surface.contains(corner) {
                true => -distance_m,
                false => distance_m,
            }
        };
        outline
            .corners()
            .map(signed)
            .into_iter()
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// True if a vehicle passes a red light between two positions, at `time_s` of the lights.
    pub fn runs_red(&self, from_m: DVec2, to_m: DVec2, time_s: f64) -> bool {
        self.lights.lines().iter().any(|line| {
            let ((before_m, _), (after_m, between)) =
                (line.record.locate(from_m), line.record.locate(to_m));
            let passes = before_m < 0.0 && after_m >= 0.0 && between;
            passes && self.lights.color_at(line.record.index, time_s) == LightColor::Red
        })
    }
}

/// Points on the borders of driving lanes beyond which there is no other.
fn edge(map: &LaneMap, surface: &RoadSurface) -> Vec<DVec2> {
    let mut edge = Vec::new();
    let driving = map
        .lanes
        .iter()
        .filter(|lane| lane.kind == LaneKind::Driving);
    for lane in driving {
        for (border, side) in [(&lane.left, 1.0), (&lane.right, -1.0)] {
            for pair in border.windows(2) {
                let [a, b]: [DVec2; 2] = [pair[0], pair[1]].map(DVec3::truncate);
                let out = side * BEYOND_M * (b - a).normalize_or_zero().perp();
                let count = (a.distance(b) / EDGE_STEP_M).ceil().clamp(1.0, 1e4) as u32;
                let points = (0..count).map(|at| a.lerp(b, f64::from(at) / f64::from(count)));
                edge.extend(points.filter(|point| !surface.contains(*point + out)));
            }
        }
    }
    edge
}
