//! Lanes: lines that the page draws, and places that vehicles snap to.

use decouplegs::drive::{LaneIndex, LanePoint};
use decouplegs::scene::{Lane, LaneKind, LaneMap};
use glam::{DVec2, DVec3};

/// Lanes farther than this from the places that are shown are left out, meters.
const WITHIN_M: f64 = 150.0;
/// A vehicle that is dragged snaps to the middle of a lane within this, meters.
const SNAP_M: f64 = 3.0;

/// Lanes of a place.
pub struct Lanes {
    map: LaneMap,
    index: LaneIndex,
}

impl Lanes {
    /// The lanes of `map`.
    pub fn new(map: LaneMap) -> Self {
        Self {
            index: LaneIndex::new(&map),
            map,
        }
    }

    /// Id of the nearest driving lane, and the length along it up to `at`, meters; `None` where no
    /// lane is near.
    pub fn lane_at(&self, at: DVec2) -> Option<(&str, f64)> {
        let nearest = self.nearest(at)?;
        Some((&self.map.lanes[nearest.lane].id, nearest.foot.arc_m))
    }

    /// Nearest point in the middle of a driving lane, and the heading of the lane there, radians;
    /// `None` where no lane is near.
    pub fn snapped(&self, at: DVec2) -> Option<(DVec2, f64)> {
        let foot = self.nearest(at)?.foot;
        Some((foot.point.truncate(), foot.heading_rad))
    }

    fn nearest(&self, at: DVec2) -> Option<LanePoint> {
        let is_driven = |lane: usize| self.map.lanes[lane].kind == LaneKind::Driving;
        let nearest = self.index.nearest(at, |point| is_driven(point.lane));
        nearest.filter(|nearest| nearest.foot.distance_m <= SNAP_M)
    }

    /// Borders of the lanes about `places`, or middles where a lane has none; world coordinates,
    /// meters.
    pub fn lines_about(&self, places: impl Iterator<Item = DVec3>) -> Vec<Vec<[f64; 3]>> {
        let bounds = (DVec3::MAX, DVec3::MIN);
        let (low, high) = places.fold(bounds, |(low, high), at| (low.min(at), high.max(at)));
        let (low, high) = (low - WITHIN_M, high + WITHIN_M);
        let near = |at: &DVec3| at.cmpge(low).all() && at.cmple(high).all();
        let lines = |lane: &Lane| -> Vec<Vec<DVec3>> {
            let borders = [&lane.left, &lane.right].into_iter();
            let borders: Vec<_> = borders.filter(|line| !line.is_empty()).cloned().collect();
            match borders.is_empty() {
                true => vec![lane.centerline.clone()],
                false => borders,
            }
        };
        let round = |m: f64| (100.0 * m).round() / 100.0;
        (self.map.lanes.iter())
            .flat_map(lines)
            .filter(|line| line.iter().any(near))
            .map(|line| line.iter().map(|at| at.to_array().map(round)).collect())
            .collect()
    }
}
