//! The ground about the ego's way, as triangles.

use std::path::Path;

use anyhow::Result;
use decouplegs::asset::SceneFile;
use decouplegs::drive::Ground;
use decouplegs::footing::ground_of;
use decouplegs::scene::{Pose, Trajectory};
use glam::{DVec2, DVec3};

use crate::progress;

/// Distance to which the mesh reaches to all sides of the way, meters.
const MARGIN_M: f64 = 40.0;
/// Distance between vertices, meters, where that gives not too many.
const STEP_M: f64 = 0.5;
/// Most positions that are asked for their height.
const PLACES_MAX: f64 = 1e6;
/// A triangle that rises by more than this for each meter is a wall, and no ground.
const SLOPE_MAX: f64 = 1.0;

/// Triangles in the local frame.
pub struct Mesh {
    pub vertices: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    pub step_m: f64,
}

/// The ground of a scene about its ego's way.
pub struct FoundGround {
    pub mesh: Mesh,
    /// Median height of the ego's middle above the ground below its rear axle, meters; `None` where
    /// no ground is.
    pub ego_height_m: Option<f64>,
}

/// The ground of `scene` about its ego's way. The ego's middle is expected half of `height_m` above
/// it, and its rear axle at `axle_m` meters forward of the middle.
pub fn ground_about(
    scene: &SceneFile,
    directory: &Path,
    height_m: f64,
    axle_m: f64,
) -> Result<FoundGround> {
    let finding = progress::spinner("finding the ground".into());
    let ground = ground_of(scene, directory)?;
    let standing = Trajectory::standing(Pose {
        translation: scene.origin,
        ..Pose::IDENTITY
    });
    let poses = scene.ego.as_ref().unwrap_or(&standing).poses();
    let way: Vec<DVec3> = poses.iter().map(|timed| timed.pose.translation).collect();
    let axles: Vec<DVec3> = poses
        .iter()
        .map(|timed| timed.pose.transform(DVec3::X * axle_m))
        .collect();
    let found = FoundGround {
        mesh: Grid::about(&way, height_m).mesh(&ground, scene.origin),
        ego_height_m: height_above(&ground, &axles, height_m),
    };
    finding.finish_and_clear();
    Ok(found)
}

/// Median height of `points` above the ground that is expected half of `height_m` below them.
fn height_above(ground: &Ground, points: &[DVec3], height_m: f64) -> Option<f64> {
    let queries: Vec<(DVec2, Option<f64>)> = points
        .iter()
        .map(|point| (point.truncate(), Some(point.z - 0.5 * height_m)))
        .collect();
    let heights = ground.heights_at(&queries);
    let mut heights_m: Vec<f64> = points
        .iter()
        .zip(heights)
        .filter_map(|(point, height)| Some(point.z - height?.z_m))
        .collect();
    heights_m.sort_by(f64::total_cmp);
    heights_m.get(heights_m.len() / 2).copied()
}

/// Positions on a grid, and where ground is expected there.
struct Grid {
    low: DVec2,
    columns: usize,
    rows: usize,
    step_m: f64,
    /// Points below the way: the ground at a position is expected at the height of the nearest.
    below: Vec<DVec3>,
}

impl Grid {
    fn about(way: &[DVec3], height_m: f64) -> Self {
        let flat = || way.iter().map(|point| point.truncate());
        let low = flat().fold(DVec2::INFINITY, DVec2::min) - MARGIN_M;
        let high = flat().fold(DVec2::NEG_INFINITY, DVec2::max) + MARGIN_M;
        let size = high - low;
        let step_m = STEP_M.max((size.x * size.y / PLACES_MAX).sqrt());
        let count = |side: f64| (side / step_m).floor() as usize + 1;
        let below = way
            .iter()
            .map(|point| *point - DVec3::Z * (0.5 * height_m))
            .collect();
        Self {
            low,
            columns: count(size.x),
            rows: count(size.y),
            step_m,
            below,
        }
    }

    /// The position of a node, if it is near the way, and the height expected there.
    fn query(&self, node: usize) -> Option<(DVec2, Option<f64>)> {
        let position = self.low
            + DVec2::new((node % self.columns) as f64, (node / self.columns) as f64) * self.step_m;
        let distance = |point: &&DVec3| point.truncate().distance_squared(position);
        let nearest = self
            .below
            .iter()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        (distance(&nearest) <= MARGIN_M * MARGIN_M).then_some((position, Some(nearest.z)))
    }

    fn mesh(&self, ground: &Ground, origin: DVec3) -> Mesh {
        let nodes: Vec<(usize, (DVec2, Option<f64>))> = (0..self.columns * self.rows)
            .filter_map(|node| Some((node, self.query(node)?)))
            .collect();
        let queries: Vec<(DVec2, Option<f64>)> = nodes.iter().map(|(_, query)| *query).collect();
        let mut vertices = Vec::new();
        let mut vertex_of: Vec<Option<u32>> = vec![None; self.columns * self.rows];
        for ((node, (position, _)), height) in nodes.iter().zip(ground.heights_at(&queries)) {
            if let Some(height) = height {
                vertex_of[*node] = Some(vertices.len() as u32);
                vertices.push((position.extend(height.z_m) - origin).as_vec3().to_array());
            }
        }
        let mut triangles = Vec::new();
        for row in 1..self.rows {
            for column in 1..self.columns {
                let [a, b] = [
                    (row - 1) * self.columns + column - 1,
                    row * self.columns + column - 1,
                ];
                // Counter-clockwise from above: normals point up.
                for corners in [[a, a + 1, b + 1], [a, b + 1, b]] {
                    triangles.extend(self.triangle(&vertices, corners.map(|node| vertex_of[node])));
                }
            }
        }
        Mesh {
            vertices,
            triangles,
            step_m: self.step_m,
        }
    }

    /// Three vertices that are there and lie like ground.
    fn triangle(&self, vertices: &[[f32; 3]], corners: [Option<u32>; 3]) -> Option<[u32; 3]> {
        let [Some(a), Some(b), Some(c)] = corners else {
            return None;
        };
        let heights = [a, b, c].map(|vertex| f64::from(vertices[vertex as usize][2]));
        let (low, high) = heights
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &z| {
                (low.min(z), high.max(z))
            });
        (high - low <= SLOPE_MAX * self.step_m).then_some([a, b, c])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::drive::GroundOptions;
    use decouplegs::scene::SplatCloud;

    #[test]
    fn flat_ground_is_a_flat_mesh_that_looks_up() {
        let positions: Vec<(f32, f32)> = (-40..40)
            .flat_map(|x| (-16..16).map(move |y| (0.25 * x as f32, 0.25 * y as f32)))
            .collect();
        let count = positions.len();
        let cloud = SplatCloud {
            means: positions.iter().map(|(x, y)| [*x, *y, 1.0]).collect(),
            scales: vec![[0.2, 0.2, 0.005]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.9; count],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; count],
            sh_rest: vec![],
        };
        let origin = DVec3::new(500.0, 800.0, 90.0);
        let ground = Ground::new(&cloud, origin, &GroundOptions::default());
        let middle = origin + DVec3::Z * 1.85;
        let mesh = Grid::about(&[middle], 1.5).mesh(&ground, origin);
        let height_m = height_above(&ground, &[middle], 1.5).unwrap();
        assert!((height_m - 0.85).abs() < 0.02, "{height_m} m");
        let aside = height_above(&ground, &[middle + DVec3::Y * 500.0], 1.5);
        assert_eq!(aside, None);
        assert!(
            mesh.triangles.len() > 300 && mesh.step_m == STEP_M,
            "{}",
            mesh.triangles.len()
        );
        for vertex in &mesh.vertices {
            assert!(
                (vertex[2] - 1.0).abs() < 0.02 && vertex[0].abs() < 11.0 && vertex[1].abs() < 5.0,
                "{vertex:?}"
            );
        }
        for triangle in &mesh.triangles {
            let [a, b, c] =
                triangle.map(|vertex| glam::Vec3::from_array(mesh.vertices[vertex as usize]));
            assert!((b - a).cross(c - a).z > 0.0);
        }
    }
}
