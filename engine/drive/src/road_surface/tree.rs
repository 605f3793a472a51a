//! Spatial index of triangles: a bounding box tree.

use std::ops::Range;

use glam::DVec2;

use super::Triangle;

/// Triangles of a leaf.
const LEAF_TRIANGLES: usize = 4;

/// Triangles, to be searched.
#[derive(Clone, Debug)]
pub(super) struct TriangleTree {
    triangles: Vec<Triangle>,
    nodes: Vec<Node>,
}

/// A box around triangles: a leaf's own where `second` is 0, otherwise those of the node behind it
/// and of `second`.
#[derive(Clone, Debug)]
struct Node {
    low: DVec2,
    high: DVec2,
    triangles: Range<usize>,
    second: usize,
}

impl TriangleTree {
    pub(super) fn new(triangles: Vec<Triangle>) -> Self {
        let mut tree = Self {
            nodes: Vec::with_capacity(triangles.len()),
            triangles,
        };
        if !tree.triangles.is_empty() {
            tree.build(0..tree.triangles.len());
        }
        tree
    }

    /// Shows every triangle within `radius_m` of a position, with its distance; `see` answers how
    /// far it still wants to look.
    pub(super) fn visit(
        &self,
        at: DVec2,
        radius_m: f64,
        mut see: impl FnMut(&Triangle, f64) -> f64,
    ) {
        if self.nodes.is_empty() || !at.is_finite() {
            return;
        }
        let (mut radius_m, mut open) = (radius_m, vec![0_usize]);
        while let Some(at_node) = open.pop() {
            let node = &self.nodes[at_node];
            if at.clamp(node.low, node.high).distance(at) > radius_m {
                continue;
            }
            if node.second > 0 {
                open.extend([node.second, at_node + 1]);
                continue;
            }
            for triangle in &self.triangles[node.triangles.clone()] {
                let distance_m = triangle.distance_m(at);
                if distance_m <= radius_m {
                    radius_m = see(triangle, distance_m).min(radius_m);
                }
            }
        }
    }

    /// The tree over a range of triangles: halves along the longer side. Its depth is the logarithm
    /// of their number.
    fn build(&mut self, range: Range<usize>) -> usize {
        let part = &mut self.triangles[range.clone()];
        let corners = part
            .iter()
            .flat_map(|triangle| triangle.corners.map(|corner| corner.truncate()));
        let (low, high) = corners
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), at| {
                (low.min(at), high.max(at))
            });
        let node = self.nodes.len();
        if part.len() <= LEAF_TRIANGLES {
            self.nodes.push(Node {
                low,
                high,
                triangles: range,
                second: 0,
            });
            return node;
        }
        let along_x = high.x - low.x >= high.y - low.y;
        let key = |triangle: &Triangle| {
            let sum = triangle.corners[0] + triangle.corners[1] + triangle.corners[2];
            if along_x { sum.x } else { sum.y }
        };
        part.sort_by(|a, b| key(a).total_cmp(&key(b)));
        let middle = usize::midpoint(range.start, range.end);
        self.nodes.push(Node {
            low,
            high,
            triangles: range.clone(),
            second: 0,
        });
        self.build(range.start..middle);
        self.nodes[node].second = self.build(middle..range.end);
        node
    }
}
