//! Spatial index of lanes: a bounding box tree over the segments of all centerlines.

use decouplegs_scene::LaneMap;
use glam::DVec2;

use crate::polyline::{Foot, Polyline};

/// The position on a lane's centerline nearest to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LanePoint {
    /// Place in [`LaneMap::lanes`].
    pub lane: usize,
    /// Nearest point on its centerline.
    pub foot: Foot,
}

/// Centerlines of a map, to be searched.
#[derive(Clone, Debug)]
pub struct LaneIndex {
    lines: Vec<Option<Polyline>>,
    pieces: Vec<Piece>,
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug)]
struct Piece {
    lane: u32,
    segment: u32,
}

/// A box around pieces: a leaf's own, otherwise those of the node behind it and of `second`.
#[derive(Clone, Debug)]
struct Node {
    low: DVec2,
    high: DVec2,
    pieces: std::ops::Range<u32>,
    second: u32,
}

/// Pieces of a leaf.
const LEAF_PIECES: usize = 4;

impl LaneIndex {
    /// The index of `map`. Lanes whose centerline is no line are in none of its answers.
    #[must_use]
    pub fn new(map: &LaneMap) -> Self {
        let lines: Vec<Option<Polyline>> = map
            .lanes
            .iter()
            .map(|lane| Polyline::new(lane.centerline.iter().copied()))
            .collect();
        let mut pieces = Vec::new();
        for (lane, line) in lines.iter().enumerate() {
            let segments = line.as_ref().map_or(0, |line| line.points().len() - 1);
            pieces.extend((0..segments).map(|segment| Piece {
                lane: lane as u32,
                segment: segment as u32,
            }));
        }
        let mut index = Self {
            lines,
            pieces,
            nodes: Vec::new(),
        };
        if !index.pieces.is_empty() {
            index.build(0, index.pieces.len());
        }
        index
    }

    /// The centerline of a lane, where it is a line.
    #[must_use]
    pub fn line(&self, lane: usize) -> Option<&Polyline> {
        self.lines.get(lane)?.as_ref()
    }

    /// The nearest position of each lane within `radius_m` of `at`, the nearest first.
    #[must_use]
    pub fn lanes_near(&self, at: DVec2, radius_m: f64) -> Vec<LanePoint> {
        let mut found: Vec<LanePoint> = Vec::new();
        self.visit(at, radius_m, |piece, foot| {
            match found
                .iter_mut()
                .find(|point| point.lane == piece.lane as usize)
            {
                Some(point) if point.foot.distance_m <= foot.distance_m => {}
                Some(point) => point.foot = foot,
                None => found.push(LanePoint {
                    lane: piece.lane as usize,
                    foot,
                }),
            }
            radius_m
        });
        found.sort_by(|a, b| {
            a.foot
                .distance_m
                .total_cmp(&b.foot.distance_m)
                .then(a.lane.cmp(&b.lane))
        });
        found
    }

    /// The nearest position on any lane that `accept` takes.
    #[must_use]
    pub fn nearest(&self, at: DVec2, accept: impl Fn(&LanePoint) -> bool) -> Option<LanePoint> {
        let mut best: Option<LanePoint> = None;
        self.visit(at, f64::INFINITY, |piece, foot| {
            let point = LanePoint {
                lane: piece.lane as usize,
                foot,
            };
            let nearer = best.is_none_or(|best| {
                (foot.distance_m, point.lane) < (best.foot.distance_m, best.lane)
            });
            if nearer && accept(&point) {
                best = Some(point);
            }
            best.map_or(f64::INFINITY, |best| best.foot.distance_m)
        });
        best
    }

    /// Shows every piece within a radius, which `see` may lessen.
    fn visit(&self, at: DVec2, radius_m: f64, mut see: impl FnMut(Piece, Foot) -> f64) {
        if self.nodes.is_empty() || !at.is_finite() {
            return;
        }
        let (mut radius_m, mut open) = (radius_m, vec![0_u32]);
        while let Some(node) = open.pop() {
            let node_at = node as usize;
            let node = &self.nodes[node_at];
            if at.clamp(node.low, node.high).distance(at) > radius_m {
                continue;
            }
            if node.second == 0 {
                for &piece in &self.pieces[node.pieces.start as usize..node.pieces.end as usize] {
                    let Some(line) = self.line(piece.lane as usize) else {
                        continue;
                    };
                    let segment = piece.segment as usize;
                    let arcs = line.arcs_m();
                    let share = line.share_of(segment, at);
                    let foot = line.foot(
                        at,
                        arcs[segment] + share * (arcs[segment + 1] - arcs[segment]),
                    );
                    if foot.distance_m <= radius_m {
                        radius_m = see(piece, foot).min(radius_m);
                    }
                }
            } else {
                let (first, second) = (node_at as u32 + 1, node.second);
                let distance = |node: u32| {
                    let node = &self.nodes[node as usize];
                    at.clamp(node.low, node.high).distance_squared(at)
                };
                // The nearer one is examined first.
                let nearer_first = distance(first) <= distance(second);
                open.extend(if nearer_first {
                    [second, first]
                } else {
                    [first, second]
                });
            }
        }
    }

    /// The tree over pieces `from` to `to`: halves along the longer side. Its depth is the
    /// logarithm of their number.
    fn build(&mut self, from: usize, to: usize) -> u32 {
        let ends = |piece: &Piece| {
            let points = self.lines[piece.lane as usize]
                .as_ref()
                .map_or(&[][..], Polyline::points);
            [
                points[piece.segment as usize].truncate(),
                points[piece.segment as usize + 1].truncate(),
            ]
        };
        let all = self.pieces[from..to].iter().flat_map(ends);
        let (low, high) = all.fold(
            (DVec2::INFINITY, DVec2::NEG_INFINITY),
            |(low, high), end| (low.min(end), high.max(end)),
        );
        let node = self.nodes.len();
        let along_x = high.x - low.x >= high.y - low.y;
        if to - from > LEAF_PIECES {
            let mut keyed: Vec<(f64, Piece)> = Vec::with_capacity(to - from);
            keyed.extend(self.pieces[from..to].iter().map(|piece| {
                let middle = ends(piece)[0] + ends(piece)[1];
                (if along_x { middle.x } else { middle.y }, *piece)
            }));
            keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (to, (_, piece)) in self.pieces[from..to].iter_mut().zip(keyed) {
                *to = piece;
            }
        }
        self.nodes.push(Node {
            low,
            high,
            pieces: from as u32..to as u32,
            second: 0,
        });
        if to - from > LEAF_PIECES {
            let middle = usize::midpoint(from, to);
            self.build(from, middle);
            self.nodes[node].second = self.build(middle, to);
        }
        node as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::Lane;
    use glam::DVec3;

    fn map() -> LaneMap {
        let lane = |at: usize| {
            let offset = 3.0 * at as f64;
            let point = |x: f64| DVec3::new(x, offset + 5.0 * (0.05 * x + at as f64).sin(), 0.0);
            Lane {
                id: at.to_string(),
                centerline: (0..60).map(|x| point(2.0 * f64::from(x))).collect(),
                ..Lane::default()
            }
        };
        LaneMap {
            lanes: (0..12).map(lane).collect(),
            ..LaneMap::default()
        }
    }

    #[test]
    fn the_tree_finds_what_looking_at_all_lanes_finds() {
        let index = LaneIndex::new(&map());
        for at in 0..400 {
            let at = DVec2::new(
                f64::from(at * 37 % 131) - 5.0,
                f64::from(at * 53 % 47) - 6.0,
            );
            let mut all: Vec<(usize, f64)> = (0..12)
                .map(|lane| (lane, index.line(lane).unwrap().project(at).distance_m))
                .collect();
            all.sort_by(|a, b| a.1.total_cmp(&b.1));
            let nearest = index.nearest(at, |_| true).unwrap();
            assert!(
                (nearest.foot.distance_m - all[0].1).abs() < 1e-9,
                "{nearest:?} for {all:?}"
            );
            let near = index.lanes_near(at, 6.0);
            assert_eq!(
                near.len(),
                all.iter().filter(|(_, distance)| *distance <= 6.0).count()
            );
            assert!(
                near.iter()
                    .zip(&all)
                    .all(|(found, all)| (found.foot.distance_m - all.1).abs() < 1e-9)
            );
            let odd = index.nearest(at, |point| point.lane % 2 == 1).unwrap();
            let odd_truth = all.iter().find(|(lane, _)| lane % 2 == 1).unwrap();
            assert!((odd.foot.distance_m - odd_truth.1).abs() < 1e-9);
        }
    }

    #[test]
    fn no_lanes_and_no_numbers_find_nothing() {
        assert!(
            LaneIndex::new(&LaneMap::default())
                .nearest(DVec2::ZERO, |_| true)
                .is_none()
        );
        assert!(
            LaneIndex::new(&map())
                .lanes_near(DVec2::NAN, 5.0)
                .is_empty()
        );
    }
}
