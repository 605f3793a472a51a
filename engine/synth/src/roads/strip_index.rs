//! Spatial index of lanes.

use decouplegs_scene::LaneKind;
use glam::{Vec2, Vec3};
use std::collections::BTreeMap;

use super::strips::{Section, Strip};

/// Width of the cells in which pieces of lanes are looked up, meters.
const CELL_M: f32 = 6.0;

/// Decks farther apart are not the same road, meters.
const STOREY_M: f32 = 2.5;

/// A piece of a lane between two sections.
#[derive(Clone, Copy, Debug)]
struct Piece {
    strip: u32,
    section: u32,
}

/// A lane at a position.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) strip: usize,
    /// Distance to the nearer border, meters.
    pub(super) depth_m: f32,
    /// Direction of traffic, unit vector.
    pub(super) ahead: Vec2,
}

/// Strips, found by position.
pub(super) struct StripIndex {
    pub(super) strips: Vec<Strip>,
    cells: BTreeMap<(i32, i32), Vec<Piece>>,
}

fn cell_of(point: Vec2) -> (i32, i32) {
    let cell = (point / CELL_M).floor();
    (cell.x as i32, cell.y as i32)
}

/// Rank by which lanes own the area that they share: the lowest owns it.
fn rank(kind: LaneKind) -> u8 {
    match kind {
        LaneKind::Driving => 0,
        LaneKind::Parking => 1,
        LaneKind::Bicycle => 2,
        LaneKind::Walking => 3,
        LaneKind::Other => 4,
    }
}

impl StripIndex {
    pub(super) fn new(strips: Vec<Strip>) -> Self {
        let mut cells: BTreeMap<(i32, i32), Vec<Piece>> = BTreeMap::new();
        for (index, strip) in strips.iter().enumerate() {
            for (section, pair) in strip.sections.windows(2).enumerate() {
                let corners =
                    [pair[0].left, pair[0].right, pair[1].left, pair[1].right].map(Vec3::truncate);
                let low = corners.iter().copied().fold(corners[0], Vec2::min);
                let high = corners.iter().copied().fold(corners[0], Vec2::max);
                let ((i0, j0), (i1, j1)) = (cell_of(low), cell_of(high));
                // A lane wider than a town is no lane.
                for i in i0..=i1.min(i0.saturating_add(64)) {
                    for j in j0..=j1.min(j0.saturating_add(64)) {
                        let piece = Piece {
                            strip: index as u32,
                            section: section as u32,
                        };
                        cells.entry((i, j)).or_default().push(piece);
                    }
                }
            }
        }
        Self { strips, cells }
    }

    /// Lanes that `point` lies on.
    pub(super) fn at(&self, point: Vec3) -> impl Iterator<Item = Hit> {
        let pieces = self
            .cells
            .get(&cell_of(point.truncate()))
            .map_or(&[][..], Vec::as_slice);
        pieces
            .iter()
            .filter_map(move |piece| self.hit(*piece, point))
    }

    fn sections_of(&self, piece: Piece) -> (&Section, &Section) {
        let sections = &self.strips[piece.strip as usize].sections;
        (
            &sections[piece.section as usize],
            &sections[piece.section as usize + 1],
        )
    }

    fn hit(&self, piece: Piece, point: Vec3) -> Option<Hit> {
        let (from, to) = self.sections_of(piece);
        let (start, ahead) = (
            from.middle().truncate(),
            (to.middle() - from.middle()).truncate(),
        );
        let share = (point.truncate() - start).dot(ahead) / ahead.length_squared().max(1e-9);
        if !(0.0..=1.0).contains(&share) {
            return None;
        }
        let Section { left, right } = from.lerp(to, share);
        let across = (left - right).truncate();
        let index = (point - right).truncate().dot(across) / across.length_squared().max(1e-9);
        let on_deck = (point.z - right.z - (left.z - right.z) * index).abs() < STOREY_M;
        let depth_m = index.min(1.0 - index) * across.length();
        (depth_m >= 0.0 && on_deck).then(|| Hit {
            strip: piece.strip as usize,
            depth_m,
            ahead: ahead.normalize_or(Vec2::X),
        })
    }

    /// True if lane `strip` paves a position that it lies on: of all lanes there one does.
    pub(super) fn owns(&self, strip: usize, point: Vec3) -> bool {
        /// Neighbors overlap by less, meters: both pave their seam.
        const SEAM_M: f32 = 0.25;
        let key = |strip: usize| (rank(self.strips[strip].kind), strip);
        self.at(point)
            .all(|hit| hit.strip == strip || hit.depth_m < SEAM_M || key(strip) < key(hit.strip))
    }

    /// Distance on the plane to the nearest lane, meters, 0 on one; at most [`StripIndex::NEAR_M`].
    pub(super) fn distance_m(&self, point: Vec2) -> f32 {
        let (i, j) = cell_of(point);
        let cells = (i - 1..=i + 1).flat_map(|i| (j - 1..=j + 1).map(move |j| (i, j)));
        let pieces = cells.filter_map(|cell| self.cells.get(&cell)).flatten();
        pieces
            .map(|piece| self.distance_to_piece_m(*piece, point))
            .fold(Self::NEAR_M, f32::min)
    }

    /// Beyond, distances are not told apart, meters.
    pub(super) const NEAR_M: f32 = CELL_M;

    fn distance_to_piece_m(&self, piece: Piece, point: Vec2) -> f32 {
        let (from, to) = self.sections_of(piece);
        let (start, ahead) = (
            from.middle().truncate(),
            (to.middle() - from.middle()).truncate(),
        );
        let share = ((point - start).dot(ahead) / ahead.length_squared().max(1e-9)).clamp(0.0, 1.0);
        let Section { left, right } = from.lerp(to, share);
        let across = (left - right).truncate();
        let index = ((point - right.truncate()).dot(across) / across.length_squared().max(1e-9))
            .clamp(0.0, 1.0);
        point.distance(right.truncate() + across * index)
    }
}
