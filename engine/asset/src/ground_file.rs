//! The ground of a scene as its files have it: a mesh, or points.

use std::io::Write;
use std::path::Path;

use decouplegs_scene::SplatCloud;
use glam::DVec3;

use crate::error::read_bytes;
use crate::ply::Ply;
use crate::{AssetError, DecodeError, write_atomically};

/// Name of the format in messages.
pub(crate) const NAME: &str = "ground";
/// Distance of points on a mesh, meters, where that gives not too many.
const STEP_M: f64 = 0.25;
/// Most points that are made of a mesh.
const POINTS_MAX: f64 = 4e6;
/// Splats of a road that are fainter are no ground.
const OPACITY_MIN: f32 = 0.5;

/// Reads a PLY in scene coordinates: points, or a mesh, on which points are put a quarter of a
/// meter apart.
///
/// # Errors
/// [`AssetError`] that says what is wrong with the file.
pub fn read_ground(path: &Path) -> Result<Vec<DVec3>, AssetError> {
    decode(&read_bytes(path)?).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: NAME,
        source,
    })
}

/// Reads the bytes of a PLY as [`read_ground`] does.
///
/// # Errors
/// [`DecodeError`] if there are no finite vertices, or a triangle names one that is not there.
pub fn decode(bytes: &[u8]) -> Result<Vec<DVec3>, DecodeError> {
    let ply = Ply::parse(bytes)?;
    let axes = ["x", "y", "z"].map(|axis| ply.column("vertex", axis));
    let [x, y, z] = axes;
    let (x, y, z) = (x?, y?, z?);
    let rows = ply.rows("vertex")?;
    let vertices: Vec<DVec3> = rows
        .bytes
        .chunks_exact(rows.stride)
        .map(|row| DVec3::new(x.f64_of(row), y.f64_of(row), z.f64_of(row)))
        .collect();
    let points = match ply.triangles()? {
        Some(triangles) => on_triangles(&vertices, &triangles)?,
        None => vertices,
    };
    let points: Vec<DVec3> = points
        .into_iter()
        .filter(|point| point.is_finite())
        .collect();
    if points.is_empty() {
        return Err(DecodeError::Malformed("it has no finite points".into()));
    }
    Ok(points)
}

/// Middles of the small triangles that each of `triangles` is divided into.
fn on_triangles(vertices: &[DVec3], triangles: &[[u32; 3]]) -> Result<Vec<DVec3>, DecodeError> {
    let corners = |triangle: &[u32; 3]| -> Result<[DVec3; 3], DecodeError> {
        let mut corners = [DVec3::ZERO; 3];
        for (corner, &index) in corners.iter_mut().zip(triangle) {
            *corner = *vertices.get(index as usize).ok_or_else(|| {
                DecodeError::Malformed(format!(
                    "a triangle names vertex {index} of {}",
                    vertices.len()
                ))
            })?;
        }
        Ok(corners)
    };
    let side_m = |[a, b, c]: [DVec3; 3]| {
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        if longest.is_finite() { longest } else { 0.0 }
    };
    let mut area_m2 = 0.0;
    for triangle in triangles {
        area_m2 += side_m(corners(triangle)?).powi(2);
    }
    // A triangle of n by n parts has no more than its longest side allows.
    let step_m = STEP_M.max((2.0 * area_m2 / POINTS_MAX).sqrt());
    let mut points = Vec::new();
    for triangle in triangles {
        let [a, b, c] = corners(triangle)?;
        let parts = (side_m([a, b, c]) / step_m).ceil().max(1.0);
        let (right, up) = ((b - a) / parts, (c - a) / parts);
        for row in 0..parts as u32 {
            for column in 0..parts as u32 - row {
                let corner = a + right * f64::from(column) + up * f64::from(row);
                points.push(corner + (right + up) / 3.0);
                if column + row + 1 < parts as u32 {
                    points.push(corner + (right + up) * (2.0 / 3.0));
                }
            }
        }
    }
    Ok(points)
}

/// Means of those splats of a road that are opaque enough to be ground.
pub(crate) fn points_of_road(road: &SplatCloud) -> Vec<DVec3> {
    let opaque = road.means.iter().zip(&road.opacities);
    opaque
        .filter(|(_, opacity)| **opacity >= OPACITY_MIN)
        .map(|(mean, _)| glam::Vec3::from_array(*mean).as_dvec3())
        .collect()
}

/// Writes `points` as a PLY that [`read_ground`] reads.
///
/// # Errors
/// [`AssetError::Write`].
pub fn write_ground(path: &Path, points: &[DVec3]) -> Result<(), AssetError> {
    write_atomically(path, |file| {
        write!(
            file,
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nend_header\n",
            points.len()
        )?;
        for value in points.iter().flat_map(DVec3::to_array) {
            file.write_all(&value.to_le_bytes())?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packed_scene::ground_mesh_ply;

    #[test]
    fn points_lie_on_the_triangles_a_quarter_of_a_meter_apart() {
        // A slope of 4 m by 3 m in two triangles.
        let vertices = [
            [0.0, 0.0, 0.0],
            [4.0, 0.0, 0.4],
            [4.0, 3.0, 0.4],
            [0.0, 3.0, 0.0],
        ];
        let mesh = ground_mesh_ply(&vertices, &[[0, 1, 2], [0, 2, 3]]);
        let points = decode(&mesh).unwrap();
        for point in &points {
            assert!((point.z - 0.1 * point.x).abs() < 1e-6, "{point}");
            assert!((0.0..=4.0).contains(&point.x) && (0.0..=3.0).contains(&point.y));
        }
        for at in 0..48 {
            let place = DVec3::new(
                f64::from(at % 8) * 0.5 + 0.25,
                f64::from(at / 8) * 0.5 + 0.25,
                0.0,
            );
            let near = |point: &&DVec3| point.truncate().distance(place.truncate()) < 0.25;
            assert!(points.iter().any(|point| near(&point)), "{place}");
        }
        assert!(points.len() < 1000, "{}", points.len());
    }

    #[test]
    fn points_are_written_and_read_to_the_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ground.ply");
        let points = [DVec3::new(500_000.125, -3.0, 0.1), DVec3::ONE];
        write_ground(&path, &points).unwrap();
        assert_eq!(read_ground(&path).unwrap(), points);
    }

    #[test]
    fn hostile_meshes_get_a_sentence() {
        let mesh = ground_mesh_ply(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 1, 2]]);
        for cut in 0..mesh.len() {
            assert!(decode(&mesh[..cut]).is_err(), "{cut}");
        }
        let with = |from: &str, to: &str| {
            let text: Vec<u8> = mesh.clone();
            let at = text
                .windows(from.len())
                .position(|w| w == from.as_bytes())
                .unwrap();
            [&text[..at], to.as_bytes(), &text[at + from.len()..]].concat()
        };
        for claim in ["face 4000000000", "face 18446744073709551615"] {
            assert!(decode(&with("face 1", claim)).is_err(), "{claim}");
        }
        let beyond = ground_mesh_ply(&[[0.0; 3]], &[[0, 7, 0]]);
        assert!(
            decode(&beyond)
                .unwrap_err()
                .to_string()
                .contains("vertex 7")
        );
        let none = ground_mesh_ply(&[[f32::NAN; 3]], &[[0, 0, 0]]);
        assert!(decode(&none).unwrap_err().to_string().contains("finite"));
        // A triangle of a million kilometers is divided no finer than memory allows.
        let huge = ground_mesh_ply(&[[0.0; 3], [1e9, 0.0, 0.0], [0.0, 1e9, 0.0]], &[[0, 1, 2]]);
        assert!(decode(&huge).unwrap().len() < 5_000_000);
    }
}
