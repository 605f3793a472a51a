//! Drivable area: the area of all driving lanes, and its height.

use decouplegs_scene::episode::LaneRecord;
use decouplegs_scene::{LaneKind, LaneMap, VehicleState};
use glam::{DVec2, DVec3};

use crate::oriented_box::OrientedBox;

mod directions;
mod strip;
mod tree;

use directions::LaneDirections;
use tree::TriangleTree;

/// Half the width of a lane whose borders the map does not know, meters.
pub const HALF_WIDTH_M: f64 = 1.75;
/// Largest distance from the road at which a position is still on it, meters: no seam between two
/// triangles has a width.
const SEAM_M: f64 = 1e-3;
/// Largest distance between positions on a box's outline that are examined, meters.
const OUTLINE_STRIDE_M: f64 = 1.0;
/// Positions on one side of a box at most; a vehicle of any real length has fewer.
const OUTLINE_POSITIONS_MAX: f64 = 64.0;
/// Distance from all lanes beyond which a position has no height, meters.
const HEIGHT_MAX_M: f64 = 3.0;

/// The union of a map's driving lanes, from border to border, as triangles in a tree. It is seen
/// from above: what is under a bridge counts as on the road where the bridge does.
#[derive(Clone, Debug)]
pub struct RoadSurface {
    tree: TriangleTree,
    directions: LaneDirections,
}

impl RoadSurface {
    /// Largest distance of a wheel beyond the borders of the lanes on a generated route, meters:
    /// markings are as wide.
    pub const SLACK_M: f64 = 0.15;
    /// Largest distance of a corner beyond the borders of the lanes at which the ego is still on
    /// the road, meters: that of nuPlan (drivable area compliance; Karnchanachari et al., 2024).
    pub const EDGE_M: f64 = 0.3;

    /// The surface of `map`. Where a border is missing, the lane reaches 1.75 m from its
    /// centerline; lanes without a line have no area.
    #[must_use]
    pub fn new(map: &LaneMap) -> Self {
        let lanes = map
            .lanes
            .iter()
            .filter(|lane| lane.kind == LaneKind::Driving);
        Self {
            tree: TriangleTree::new(lanes.flat_map(strip::triangles).collect()),
            directions: LaneDirections::new(map),
        }
    }

    /// Lanes below the middle of a vehicle; `None` where there are none.
    #[must_use]
    pub fn lanes_below(&self, state: &VehicleState) -> Option<LaneRecord> {
        self.directions.below(state)
    }

    /// True if a position is on a driving lane.
    #[must_use]
    pub fn contains(&self, at: DVec2) -> bool {
        self.reaches(at, 0.0)
    }

    /// True if a position is on a driving lane or no more than `slack_m` from one.
    #[must_use]
    pub fn reaches(&self, at: DVec2, slack_m: f64) -> bool {
        let mut found = false;
        self.tree.visit(at, slack_m.max(0.0) + SEAM_M, |_, _| {
            found = true;
            // Nothing nearer needs to be examined.
            f64::NEG_INFINITY
        });
        found
    }

    /// True if a box is on the road: its corners and points between them, at most a meter apart,
    /// are on driving lanes or no more than `slack_m` from one.
    #[must_use]
    pub fn holds_box(&self, outline: &OrientedBox, slack_m: f64) -> bool {
        let corners = outline.corners();
        (0..4).all(|side| {
            let (from, to) = (corners[side], corners[(side + 1) % 4]);
            let count = (from.distance(to) / OUTLINE_STRIDE_M).ceil();
            // A box that is not finite has one position, which is not on the road.
            let count = if count > 1.0 {
                count.min(OUTLINE_POSITIONS_MAX)
            } else {
                1.0
            };
            (0..count as usize)
                .all(|index| self.reaches(from.lerp(to, index as f64 / count), slack_m))
        })
    }

    /// Height of the road at a position, meters: of the lanes over and under each other, the one
    /// nearest to `expected_z_m`. `None` where no lane that knows its height is within 3 m.
    #[must_use]
    pub fn height_at(&self, at: DVec2, expected_z_m: f64) -> Option<f64> {
        // Lanes at the position go before lanes beside it; of those at the same distance, the
        // nearest in height is taken.
        let mut best: Option<(f64, f64, f64)> = None;
        self.tree.visit(at, HEIGHT_MAX_M, |triangle, distance_m| {
            if triangle.has_height {
                let z_m = triangle.height_near(at);
                let key = (
                    (distance_m - SEAM_M).max(0.0),
                    (z_m - expected_z_m).abs(),
                    z_m,
                );
                if best.is_none_or(|best| key < best) {
                    best = Some(key);
                }
            }
            best.map_or(HEIGHT_MAX_M, |best| best.0 + SEAM_M)
        });
        best.map(|best| best.2)
    }
}

/// A piece of a lane's area.
#[derive(Clone, Copy, Debug)]
struct Triangle {
    corners: [DVec3; 3],
    has_height: bool,
}

impl Triangle {
    /// The position of the triangle nearest to `at`, seen from above, from `at` on: zero where `at`
    /// is within it.
    fn nearest_offset(&self, at: DVec2) -> DVec2 {
        let corners = self.corners.map(|corner| corner.truncate() - at);
        let sides = [0, 1, 2].map(|side| corners[side].perp_dot(corners[(side + 1) % 3]));
        if sides.iter().all(|side| *side > 0.0) || sides.iter().all(|side| *side < 0.0) {
            return DVec2::ZERO;
        }
        let edge = |side: usize| {
            let (from, along) = (corners[side], corners[(side + 1) % 3] - corners[side]);
            let share = (-from.dot(along) / along.length_squared()).clamp(0.0, 1.0);
            // Two corners in one place make no edge.
            from + along * if share.is_finite() { share } else { 0.0 }
        };
        let nearer = |a: DVec2, b: DVec2| {
            if a.length_squared() <= b.length_squared() {
                a
            } else {
                b
            }
        };
        nearer(nearer(edge(0), edge(1)), edge(2))
    }

    /// Distance from a position to the triangle, seen from above, meters: 0 within it.
    fn distance_m(&self, at: DVec2) -> f64 {
        self.nearest_offset(at).length()
    }

    /// Height of the triangle at the position of it nearest to `at`, meters.
    fn height_near(&self, at: DVec2) -> f64 {
        let position = at + self.nearest_offset(at);
        let [a, b, c] = self.corners.map(|corner| corner.truncate() - position);
        // The weight of each corner at the position is the share of the area on its other side.
        let areas = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)];
        let area = areas[0] + areas[1] + areas[2];
        let [z_a, z_b, z_c] = self.corners.map(|corner| corner.z);
        let z_m = (areas[0] * z_a + areas[1] * z_b + areas[2] * z_c) / area;
        // A triangle without area has one height, but for rounding.
        let [low, high] = [z_a.min(z_b).min(z_c), z_a.max(z_b).max(z_c)];
        if z_m.is_finite() {
            z_m.clamp(low, high)
        } else {
            0.5 * (low + high)
        }
    }
}
