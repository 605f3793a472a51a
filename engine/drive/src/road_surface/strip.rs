//! The area between a lane's borders as triangles.

use decouplegs_scene::Lane;
use glam::{DVec2, DVec3};

use super::{HALF_WIDTH_M, Triangle};

/// Longest piece of a border on one triangle, meters: boxes around longer ones, aslant, would be
/// mostly empty.
const PIECE_M: f64 = 10.0;
/// Pieces of a border at most; a longer one has longer pieces.
const PIECES_MAX: f64 = 20_000.0;

/// The area of `lane`, its borders walked abreast: of the two triangles that go on along one of
/// them, the slimmer is taken.
pub(super) fn triangles(lane: &Lane) -> Vec<Triangle> {
    let border = |points: &[DVec3], side: f64| {
        if points.len() < 2 {
            beside(&lane.centerline, side * HALF_WIDTH_M)
        } else {
            in_pieces(points)
        }
    };
    let (left, right) = (border(&lane.left, 1.0), border(&lane.right, -1.0));
    if left.len() < 2
        || right.len() < 2
        || left.iter().chain(&right).any(|point| !point.is_finite())
    {
        return Vec::new();
    }
    let (mut l, mut r) = (0, 0);
    let mut triangles = Vec::with_capacity(left.len() + right.len());
    while l + 1 < left.len() || r + 1 < right.len() {
        let across = |l: usize, r: usize| left[l].truncate().distance_squared(right[r].truncate());
        let (left_ends, right_ends) = (l + 1 == left.len(), r + 1 == right.len());
        let along_left = right_ends || (!left_ends && across(l + 1, r) <= across(l, r + 1));
        let next = if along_left {
            left[l + 1]
        } else {
            right[r + 1]
        };
        triangles.push(Triangle {
            corners: [left[l], right[r], next],
            has_height: lane.has_height,
        });
        if along_left {
            l += 1;
        } else {
            r += 1;
        }
    }
    triangles
}

/// `points` with more of them where they are far apart.
fn in_pieces(points: &[DVec3]) -> Vec<DVec3> {
    let length_m: f64 = points
        .windows(2)
        .map(|pair| pair[0].truncate().distance(pair[1].truncate()))
        .sum();
    let piece_m = PIECE_M.max(length_m / PIECES_MAX);
    let mut border: Vec<DVec3> = points.first().copied().into_iter().collect();
    for pair in points.windows(2) {
        let pieces = (pair[0].truncate().distance(pair[1].truncate()) / piece_m)
            .ceil()
            .max(1.0);
        border.extend(
            (1..=pieces as usize).map(|piece| pair[0].lerp(pair[1], piece as f64 / pieces)),
        );
    }
    border
}

/// Line at `to_left_m` to the left of `centerline`, meters.
fn beside(centerline: &[DVec3], to_left_m: f64) -> Vec<DVec3> {
    let points = in_pieces(centerline);
    let along = |from: DVec3, to: DVec3| (to - from).truncate().normalize_or_zero();
    let shifted = |at: usize| {
        let before = if at > 0 {
            along(points[at - 1], points[at])
        } else {
            DVec2::ZERO
        };
        let after = points
            .get(at + 1)
            .map_or(DVec2::ZERO, |next| along(points[at], *next));
        let left = (before + after).normalize_or_zero().perp();
        points[at] + (left * to_left_m).extend(0.0)
    };
    (0..points.len()).map(shifted).collect()
}
