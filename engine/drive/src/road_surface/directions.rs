//! Directions and speed limits of the lanes below a vehicle.

use decouplegs_scene::episode::LaneRecord;
use decouplegs_scene::{LaneKind, LaneMap, VehicleState};
use glam::DVec2;

use super::HALF_WIDTH_M;
use crate::lane_index::{LaneIndex, LanePoint};

/// Distance from all centerlines beyond which a position is on no lane, meters.
const DISTANCE_M_MAX: f64 = 3.0;

/// Driving lanes of a map with their directions and speed limits.
#[derive(Clone, Debug)]
pub(super) struct LaneDirections {
    index: LaneIndex,
    /// Speed limit of each lane, by its place in the map; `None` for lanes that are not
    /// for driving.
    limits_mps: Vec<Option<Option<f64>>>,
}

impl LaneDirections {
    /// The driving lanes of `map`.
    pub(super) fn new(map: &LaneMap) -> Self {
        let lanes = map.lanes.iter();
        let limits = lanes
            .map(|lane| (lane.kind == LaneKind::Driving).then_some(lane.speed_limit_mps))
            .collect();
        Self {
            index: LaneIndex::new(map),
            limits_mps: limits,
        }
    }

    /// Lanes below the middle of a vehicle: those whose centerlines are within 1.75 m, or else the
    /// nearest one within 3 m. `None` where there are none.
    pub(super) fn below(&self, state: &VehicleState) -> Option<LaneRecord> {
        let near = self.index.lanes_near(state.position_m, DISTANCE_M_MAX);
        let driving: Vec<(LanePoint, Option<f64>)> = near
            .into_iter()
            .filter_map(|point| Some((point, self.limits_mps[point.lane]?)))
            .collect();
        let within = driving.partition_point(|(point, _)| point.foot.distance_m <= HALF_WIDTH_M);
        let below = &driving[..within.max(1).min(driving.len())];
        let along = |point: &LanePoint| {
            let direction = DVec2::from_angle(point.foot.heading_rad);
            state.speed_mps * state.ahead().dot(direction)
        };
        let most_mps = below.iter().map(|(point, _)| along(point));
        let most_mps = most_mps.max_by(f64::total_cmp)?;
        let limits = below.iter().map(|(_, limit_mps)| *limit_mps);
        // A lane without a limit may be driven at any speed.
        let limit_mps = limits.collect::<Option<Vec<f64>>>();
        Some(LaneRecord {
            against_mps: if most_mps < 0.0 { -most_mps } else { 0.0 },
            limit_mps: limit_mps.and_then(|limits| limits.into_iter().max_by(f64::total_cmp)),
        })
    }
}
