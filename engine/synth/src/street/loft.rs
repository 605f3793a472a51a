//! Curved surfaces given by a function of two parameters, sampled evenly by area.

use glam::{Vec2, Vec3};

use super::surface::{FAR_M, SurfacePoint};

/// Cells of the area table along each parameter: fine enough that the density inside one is even to
/// a few per cent.
const CELLS: usize = 48;

/// A function from the unit square to a surface, with a table that turns even parameters into even
/// area.
pub(super) struct Loft {
    point: Box<dyn Fn(f32, f32) -> Vec3 + Send + Sync>,
    /// Normals point away from here.
    core: Vec3,
    /// Share of the area in rows before each, `CELLS + 1` entries.
    rows: Vec<f32>,
    /// Share of the area in cells before each, within each row: `CELLS` times `CELLS + 1` entries.
    columns: Vec<f32>,
    /// Flat extent around each cell along u and v, meters.
    flat_m: Vec<[f32; 2]>,
    area_m2: f32,
    aspect: f32,
}

impl Loft {
    /// The surface `point(u, v)`, u and v in [0, 1]. It should be convex about `core`, which tells
    /// outside from inside.
    pub(super) fn new(
        core: Vec3,
        point: impl Fn(f32, f32) -> Vec3 + Send + Sync + 'static,
    ) -> Self {
        let grid: Vec<Vec3> = (0..=CELLS)
            .flat_map(|row| (0..=CELLS).map(move |column| (column, row)))
            .map(|(column, row)| point(column as f32 / CELLS as f32, row as f32 / CELLS as f32))
            .collect();
        let at = |column: usize, row: usize| grid[row * (CELLS + 1) + column];
        let (mut rows, mut columns) = (vec![0.0f32], Vec::with_capacity(CELLS * (CELLS + 1)));
        let (mut along_m, mut across_m) = (0.0f32, 0.0f32);
        for row in 0..CELLS {
            let mut sum = 0.0;
            columns.push(0.0);
            for column in 0..CELLS {
                let (a, b, c, d) = (
                    at(column, row),
                    at(column + 1, row),
                    at(column, row + 1),
                    at(column + 1, row + 1),
                );
                let area = 0.5 * ((b - a).cross(c - a).length() + (b - d).cross(c - d).length());
                along_m += area * (b - a).length();
                across_m += area * (c - a).length();
                sum += area;
                columns.push(sum);
            }
            let start = columns.len() - CELLS - 1;
            columns[start..]
                .iter_mut()
                .for_each(|value| *value /= sum.max(f32::MIN_POSITIVE));
            rows.push(rows[row] + sum);
        }
        let area_m2 = rows[CELLS];
        rows.iter_mut()
            .for_each(|value| *value /= area_m2.max(f32::MIN_POSITIVE));
        Self {
            point: Box::new(point),
            core,
            rows,
            columns,
            flat_m: flatness(&grid),
            area_m2,
            aspect: along_m / across_m.max(1e-9),
        }
    }

    /// The same surface with open edges at v = 0 and v = 1, over which splats must not reach.
    pub(super) fn bordered(mut self) -> Self {
        let height_m = self.area_m2.sqrt() / self.aspect.sqrt();
        for (cell, flat_m) in self.flat_m.iter_mut().enumerate() {
            let row = cell / CELLS;
            let to_edge_m = (row.min(CELLS - 1 - row) as f32 + 0.5) / CELLS as f32 * height_m;
            flat_m[1] = flat_m[1].min(to_edge_m);
        }
        self
    }

    pub(super) fn area_m2(&self) -> f32 {
        self.area_m2
    }

    pub(super) fn aspect(&self) -> f32 {
        self.aspect
    }

    /// The point below which the share `v` of the area lies, and the share `u` of its row.
    pub(super) fn at(&self, u: f32, v: f32) -> SurfacePoint {
        let (row, v) = invert(&self.rows, v);
        let (column, u) = invert(&self.columns[row * (CELLS + 1)..][..CELLS + 1], u);
        let position = (self.point)(u, v);
        let step = 2e-3;
        let along = (self.point)((u + step).min(1.0), v) - (self.point)((u - step).max(0.0), v);
        let across = (self.point)(u, (v + step).min(1.0)) - (self.point)(u, (v - step).max(0.0));
        let outward = (position - self.core).normalize_or(Vec3::Z);
        let normal = along.cross(across).normalize_or(outward);
        let normal = if normal.dot(outward) < 0.0 {
            -normal
        } else {
            normal
        };
        let tangent =
            (along - normal * along.dot(normal)).normalize_or(normal.any_orthonormal_vector());
        SurfacePoint {
            u,
            v,
            position,
            normal,
            tangent,
            border_m: self.flat_m[row * CELLS + column],
        }
    }
}

/// Flat extent of the surface around each cell along u and v: the least radius of curvature, from
/// the turn of the cells' edges, plus the distance to that place. A disc wider than that sticks
/// out.
fn flatness(grid: &[Vec3]) -> Vec<[f32; 2]> {
    let mut flat_m = vec![[FAR_M; 2]; CELLS * CELLS];
    for line in 0..CELLS {
        let along_u: Vec<Vec3> = (0..=CELLS).map(|i| grid[line * (CELLS + 1) + i]).collect();
        let along_v: Vec<Vec3> = (0..=CELLS).map(|i| grid[i * (CELLS + 1) + line]).collect();
        for (i, (u, v)) in line_flatness(&along_u)
            .into_iter()
            .zip(line_flatness(&along_v))
            .enumerate()
        {
            flat_m[line * CELLS + i][0] = u;
            flat_m[i * CELLS + line][1] = v;
        }
    }
    flat_m
}

/// [`flatness`] of the `CELLS` edges of one line of the grid.
fn line_flatness(line: &[Vec3]) -> Vec<f32> {
    let edge = |i: usize| line[i + 1] - line[i];
    let length_m: Vec<f32> = (0..CELLS).map(|i| edge(i).length()).collect();
    let mut flat_m: Vec<f32> = (0..CELLS)
        .map(|i| {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(CELLS - 1));
            let turn_rad = edge(before).angle_between(edge(after));
            let way_m = 0.5 * (length_m[before] + length_m[after])
                + if after - before == 2 {
                    length_m[i]
                } else {
                    0.0
                };
            if turn_rad.is_finite() && turn_rad > 1e-3 {
                (way_m / turn_rad).min(FAR_M)
            } else {
                FAR_M
            }
        })
        .collect();
    for i in 1..CELLS {
        flat_m[i] = flat_m[i].min(flat_m[i - 1] + length_m[i]);
        let back = CELLS - 1 - i;
        flat_m[back] = flat_m[back].min(flat_m[back + 1] + length_m[back]);
    }
    flat_m
}

/// Inverse of the rising piecewise-linear table at `share`: the cell, and the parameter in [0, 1]
/// over the whole table.
fn invert(table: &[f32], share: f32) -> (usize, f32) {
    let cells = table.len() - 1;
    let cell = table[1..]
        .partition_point(|&end| end <= share)
        .min(cells - 1);
    let width = (table[cell + 1] - table[cell]).max(f32::MIN_POSITIVE);
    let inside = ((share - table[cell]) / width).clamp(0.0, 1.0);
    (cell, (cell as f32 + inside) / cells as f32)
}

/// The point of the superellipse |x|^p + |y|^p = 1 in the direction `angle`: a circle at 2, a
/// square in the limit.
pub(super) fn superellipse(angle: f32, p: f32) -> Vec2 {
    let (sin, cos) = angle.sin_cos();
    let radius = (cos.abs().powf(p) + sin.abs().powf(p)).powf(-1.0 / p);
    Vec2::new(cos, sin) * radius
}

/// A round bar from `from` to `to` whose radius tapers.
pub(super) fn bar(from: Vec3, to: Vec3, radius_from_m: f32, radius_to_m: f32) -> Loft {
    let axis = (to - from).normalize_or(Vec3::Z);
    let (x, y) = axis.any_orthonormal_pair();
    Loft::new((from + to) * 0.5, move |u, v| {
        let (sin, cos) = (u * std::f32::consts::TAU).sin_cos();
        let radius = radius_from_m + (radius_to_m - radius_from_m) * v;
        from.lerp(to, v) + (x * cos + y * sin) * radius
    })
}

/// An ellipsoid with axes along the frame's.
pub(super) fn ellipsoid(center: Vec3, radii: Vec3) -> Loft {
    Loft::new(center, move |u, v| {
        let (sin, cos) = (u * std::f32::consts::TAU).sin_cos();
        let (ring, z) = (v * std::f32::consts::PI).sin_cos();
        center + radii * Vec3::new(ring * cos, ring * sin, z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sphere_is_covered_evenly_and_faces_outward() {
        let center = Vec3::new(1.0, 2.0, 3.0);
        let sphere = ellipsoid(center, Vec3::splat(2.0));
        assert!((sphere.area_m2() / (16.0 * std::f32::consts::PI) - 1.0).abs() < 0.01);
        let (mut upper, count) = (0, 4000);
        for index in 0..count {
            let (u, v) = (
                (index as f32 * 0.618_034).fract(),
                (index as f32 + 0.5) / count as f32,
            );
            let point = sphere.at(u, v);
            let outward = (point.position - center) / 2.0;
            assert!(
                (outward.length() - 1.0).abs() < 1e-3 && outward.dot(point.normal) > 0.99,
                "{point:?}"
            );
            assert!(point.tangent.dot(point.normal).abs() < 1e-3);
            upper += usize::from(outward.z > 0.5);
        }
        // Archimedes: the cap above half the radius holds a quarter of the area.
        assert!((upper as f32 / count as f32 - 0.25).abs() < 0.01, "{upper}");
    }

    #[test]
    fn a_superellipse_goes_from_circle_to_square() {
        assert!((superellipse(0.7, 2.0).length() - 1.0).abs() < 1e-5);
        let corner = superellipse(std::f32::consts::FRAC_PI_4, 40.0);
        assert!(corner.x > 0.98 && corner.y > 0.98);
    }
}
