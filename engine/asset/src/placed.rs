//! Splats of a file, the place they stand at, and what their file says that they show.

use decouplegs_scene::SplatCloud;
use glam::{DVec3, Vec3};

use crate::DecodeError;
use crate::ground_file::points_of_road;
use crate::ply::{Ply, Rows};

/// Marks of splats that show the road: `uchar`, not 0.
const ROAD: &str = "road_mask";
/// Share of the sky in a splat, 0 to 1.
const SKY: &str = "sky_mask";
/// Least share of the sky from which a splat shows it.
const SKY_SHARE_MIN: f32 = 0.5;
/// Normals, unit vectors.
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
/// Rows after which a file without a normal has none, about.
const NORMALS_LOOKED_AT: usize = 4096;

/// Marks of splats, as Instant NuRec writes them: those that show the road or the sky, and normals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatLabels {
    /// Indices of splats that show the road, ascending.
    pub road: Vec<u32>,
    /// Indices of splats that show the sky, ascending.
    pub sky: Vec<u32>,
    /// Unit normals of all splats, zero where a splat has none; empty where no splat has one.
    pub normals: Vec<[f32; 3]>,
}

impl SplatLabels {
    /// Labels in the columns of an element; none where it has no such columns.
    pub(crate) fn from_ply(ply: &Ply<'_>, element: &str) -> Result<Self, DecodeError> {
        let rows = ply.rows(element)?;
        let marked = |name: &str, is_marked: fn(f32) -> bool| -> Vec<u32> {
            let Some(column) = ply.column_if_present(element, name) else {
                return Vec::new();
            };
            let rows = rows.bytes.chunks_exact(rows.stride.max(1)).zip(0..);
            rows.filter(|(row, _)| is_marked(column.f32_of(row)))
                .map(|(_, splat)| splat)
                .collect()
        };
        Ok(Self {
            road: marked(ROAD, |mark| mark > 0.0),
            sky: marked(SKY, |share| share >= SKY_SHARE_MIN),
            normals: normals(ply, element, &rows),
        })
    }
}

/// Normals `nx`, `ny` and `nz` of an element. Trainers of 3DGS write zeros there: where all of some
/// thousand rows are, there are none.
fn normals(ply: &Ply<'_>, element: &str, rows: &Rows<'_>) -> Vec<[f32; 3]> {
    let columns = NORMAL.map(|name| ply.column_if_present(element, name));
    let [Some(x), Some(y), Some(z)] = columns else {
        return Vec::new();
    };
    let normal = |row: &[u8]| {
        let own = DVec3::new(x.f64_of(row), y.f64_of(row), z.f64_of(row));
        own.try_normalize().unwrap_or(DVec3::ZERO).as_vec3()
    };
    let all = || rows.bytes.chunks_exact(rows.stride.max(1));
    let step = (all().len() / NORMALS_LOOKED_AT).max(1);
    if all().step_by(step).all(|row| normal(row) == Vec3::ZERO) {
        return Vec::new();
    }
    all().map(|row| normal(row).to_array()).collect()
}

/// Splats relative to an origin.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlacedSplats {
    /// Splats, their means relative to the origin.
    pub cloud: SplatCloud,
    /// World coordinates, meters: zero, but for a PLY of large doubles.
    pub origin: DVec3,
    /// Splats that the file labels.
    pub labels: SplatLabels,
}

impl From<SplatCloud> for PlacedSplats {
    fn from(cloud: SplatCloud) -> Self {
        Self {
            cloud,
            ..Self::default()
        }
    }
}

impl PlacedSplats {
    /// The same splats in their [spatial order](SplatCloud::spatial_order).
    #[must_use]
    pub fn in_spatial_order(self) -> Self {
        let order = self.cloud.spatial_order();
        let SplatLabels { road, sky, normals } = self.labels;
        let normals = match normals.is_empty() {
            true => normals,
            false => order.iter().map(|splat| normals[*splat as usize]).collect(),
        };
        let moved = |labeled: Vec<u32>| -> Vec<u32> {
            let mut is_labeled = vec![false; order.len()];
            labeled
                .iter()
                .for_each(|splat| is_labeled[*splat as usize] = true);
            let places = order.iter().zip(0..);
            places
                .filter(|(splat, _)| is_labeled[**splat as usize])
                .map(|(_, place)| place)
                .collect()
        };
        let labels = match road.is_empty() && sky.is_empty() {
            true => SplatLabels {
                normals,
                ..SplatLabels::default()
            },
            false => SplatLabels {
                road: moved(road),
                sky: moved(sky),
                normals,
            },
        };
        Self {
            cloud: self.cloud.select(&order),
            labels,
            ..self
        }
    }

    /// Means of opaque splats that show the road, meters from [`PlacedSplats::origin`].
    #[must_use]
    pub fn road_points_m(&self) -> Vec<DVec3> {
        match self.labels.road.as_slice() {
            [] => Vec::new(),
            road => points_of_road(&self.cloud.select(road)),
        }
    }
}
