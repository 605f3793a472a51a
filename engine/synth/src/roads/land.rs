//! The land about the roads: pavement beside them, grass and fields to the horizon, in cells that
//! grow with distance.

use glam::{Vec2, Vec3};

use super::Drawn;
use super::canvas::{Canvas, Disc, Look};
use super::strip_index::StripIndex;
use crate::street::random::{fractal_noise, smoothstep};
use crate::street::surface::display;

/// Depth of the land below the roads, so that it never covers them, meters.
const BELOW_ROADS_M: f32 = 0.04;

/// Paved beside the roads, meters.
const PAVED_M: f32 = 2.2;

/// Width of a cell over its distance from the nearest road.
const CELL_OVER_DISTANCE: f32 = 0.22;

/// Standard deviation of a disc over the width of its cell.
const SCALE_OVER_CELL: f32 = 0.7;

/// Cells beside roads over the spacing on roads.
const CELL_OVER_SPACING: f32 = 2.0;

/// Largest number of times that cells are halved.
const HALVINGS_MAX: u32 = 24;

/// A square, its middle and width.
struct Cell {
    middle: Vec2,
    width_m: f32,
    halvings: u32,
}

pub(super) fn land(canvas: &mut Canvas, place: &Drawn, spacing_m: f32) {
    let mut open = vec![Cell {
        middle: Vec2::ZERO,
        width_m: 2.0 * place.relief.radius_m(),
        halvings: 0,
    }];
    while let Some(cell) = open.pop() {
        if canvas.is_full() {
            return;
        }
        // The nearest point of the cell decides how fine it has to be.
        let half_diagonal_m = 0.71 * cell.width_m;
        let coarse_m = place.relief.distance_m(cell.middle);
        let near_m = if coarse_m > half_diagonal_m + 8.0 {
            coarse_m - half_diagonal_m
        } else {
            0.0
        };
        let finest_m = CELL_OVER_SPACING * spacing_m * place.coarseness(cell.middle.extend(0.0));
        let exact_m = if near_m > 0.0 {
            near_m
        } else {
            place.index.distance_m(cell.middle)
        };
        let allowed_m = finest_m.max(
            CELL_OVER_DISTANCE
                * if near_m > 0.0 {
                    near_m
                } else {
                    (exact_m - half_diagonal_m).max(0.0)
                },
        );
        if cell.width_m > allowed_m && cell.halvings < HALVINGS_MAX {
            let (width_m, halvings) = (0.5 * cell.width_m, cell.halvings + 1);
            for (x, y) in [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)] {
                open.push(Cell {
                    middle: cell.middle + Vec2::new(x, y) * width_m,
                    width_m,
                    halvings,
                });
            }
        } else if exact_m > 0.3 * cell.width_m.min(1.0)
            && cell.middle.length() < place.relief.radius_m()
        {
            canvas.push(disc(place, &cell, exact_m));
        }
    }
}

fn disc(place: &Drawn, cell: &Cell, from_road_m: f32) -> Disc {
    let height_m = place.relief.height_m(cell.middle) - BELOW_ROADS_M;
    let size_m = SCALE_OVER_CELL * cell.width_m;
    let slope = |axis: Vec2| {
        let step = axis * (0.5 * cell.width_m);
        let rise_m =
            place.relief.height_m(cell.middle + step) - place.relief.height_m(cell.middle - step);
        (axis * cell.width_m)
            .extend(rise_m)
            .normalize_or(axis.extend(0.0))
            * size_m
    };
    Disc {
        middle: cell.middle.extend(height_m),
        along: slope(Vec2::X),
        across: slope(Vec2::Y),
        albedo: albedo(place.seed, cell.middle, from_road_m),
        look: Look::Lit { gloss: 0.05 },
    }
}

fn albedo(seed: u64, point: Vec2, from_road_m: f32) -> Vec3 {
    let patches = fractal_noise(seed + 151, point.x * 0.03, point.y * 0.03, 4);
    let blades = fractal_noise(seed + 157, point.x * 0.9, point.y * 0.9, 3);
    let grass = display(98, 116, 62).lerp(display(142, 136, 96), smoothstep(0.42, 0.62, patches))
        * (0.6 + 0.8 * blades);
    let stones = display(150, 146, 138) * (0.8 + 0.4 * blades);
    let paved = smoothstep(
        PAVED_M + 0.5,
        PAVED_M - 0.5,
        from_road_m.min(StripIndex::NEAR_M),
    );
    grass.lerp(stones, paved)
}
