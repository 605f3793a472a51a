//! Colors of the level ground, cube by cube.

use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::ops::RangeInclusive;

use glam::{DVec2, DVec3};

use super::{AmbientField, GROUND, SUM, Voxel, WEIGHT_MIN};
use crate::light::to_linear;
use crate::{SplatCloud, sh};

/// Heights over a position, meters, at which the ground below the middle of an agent is looked
/// for: a truck's middle is high above it.
const BELOW_AGENT_M: RangeInclusive<f64> = -3.0..=0.5;

/// Exponent of the cosine between a splat's normal and the vertical, in its weight as ground: half
/// the weight at 11 degrees, 82 % on a road that climbs by 10 %.
const UPWARD_EXPONENT: i32 = 40;

/// Area of a splat that lies level, square meters, of its ellipse at one standard deviation. By a
/// normal of `normals` where it has one; else by its thinnest axis, and 0 if it is a ball.
pub(super) fn facing_up_m2(cloud: &SplatCloud, normals: &[[f32; 3]], splat: usize) -> f64 {
    let [thin_m, broad_m, long_m] = cloud.sorted_scales_m(splat);
    if broad_m <= 0.0 {
        return 0.0;
    }
    let (up, share) = match normals.get(splat) {
        Some(&[x, y, z]) if [x, y, z] != [0.0; 3] => (f64::from(z), 1.0),
        _ => (cloud.thin_axis(splat).z, 1.0 - thin_m / broad_m),
    };
    PI * broad_m * long_m * share * up.abs().powi(UPWARD_EXPONENT)
}

/// Level ground of one cube of the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPatch {
    /// World coordinates.
    pub center: DVec3,
    /// Mean color, linear.
    pub color: [f64; 3],
    /// Opaque area that faces up, square meters.
    pub area_m2: f64,
}

impl AmbientField {
    /// Ground of the columns of cubes that are less than `radius_m` from the middles of agents at
    /// `places`, world coordinates, each patch once. Far from all `places`, the ground is of many
    /// colors: lawns, roofs, squares.
    #[must_use]
    pub fn ground_along(
        &self,
        places: impl IntoIterator<Item = DVec3>,
        radius_m: f64,
    ) -> Vec<GroundPatch> {
        let cells = (radius_m / self.voxel_m).ceil() as i32;
        let mut found = BTreeSet::new();
        for place in places {
            let at = place - self.origin;
            for x in -cells..=cells {
                for y in -cells..=cells {
                    let aside = DVec2::new(f64::from(x), f64::from(y)) * self.voxel_m;
                    if aside.length() < radius_m {
                        found.extend(self.at_heights(at + aside.extend(0.0), BELOW_AGENT_M));
                    }
                }
            }
        }
        let voxels = found.into_iter().map(|index| &self.voxels[index]);
        voxels.filter_map(|voxel| self.patch(voxel)).collect()
    }

    /// Ground of the column of cubes at `position`, world coordinates, at most 1 m above or below.
    pub fn ground_at(&self, position: DVec3) -> impl Iterator<Item = GroundPatch> + '_ {
        self.at_heights(position - self.origin, -1.0..=1.0)
            .filter_map(|index| self.patch(&self.voxels[index]))
    }

    /// Cubes of the column at `at`, relative to the origin, at `heights_m` over it.
    fn at_heights(
        &self,
        at: DVec3,
        heights_m: RangeInclusive<f64>,
    ) -> impl Iterator<Item = usize> + '_ {
        let cell = (at / self.voxel_m).floor().as_ivec3();
        let column = self.columns.get(&(cell.x, cell.y)).cloned();
        column
            .into_iter()
            .flatten()
            .filter(move |&index| heights_m.contains(&(self.voxels[index].center.z - at.z)))
    }

    fn patch(&self, voxel: &Voxel) -> Option<GroundPatch> {
        let area_m2 = f64::from(voxel.sum[SUM - 1]);
        let color =
            |channel: usize| to_linear(sh::Y0 * f64::from(voxel.sum[GROUND + channel]) / area_m2);
        (area_m2 > WEIGHT_MIN).then(|| GroundPatch {
            center: self.origin + voxel.center,
            color: std::array::from_fn(color),
            area_m2,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SplatCloud;
    use crate::light::{AmbientOptions, to_display};

    /// Level ground from x = 0 on, lighter from x = 8 m on, and a red roof 6 m above all of it.
    fn ground_and_roof(origin: DVec3) -> AmbientField {
        let mut cloud = SplatCloud::with_degree(0);
        for i in 0..64 {
            for j in 0..32 {
                let at = [0.25 * i as f32 + 0.1, 0.25 * j as f32 - 4.0];
                let light = if i < 32 { 0.05 } else { 0.2 };
                for (height_m, color) in [(0.0, [light; 3]), (6.0, [0.4, 0.02, 0.02])] {
                    cloud.means.push([at[0], at[1], height_m]);
                    cloud.scales.push([0.1, 0.1, 0.001]);
                    cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
                    cloud.opacities.push(0.9);
                    let dc = color.map(|linear| ((to_display(linear) - 0.5) / sh::Y0) as f32);
                    cloud.sh_dc.push(dc);
                }
            }
        }
        AmbientField::new(&cloud, cloud.len(), origin, &AmbientOptions::default())
    }

    /// Balls have no thinnest axis: only a stored normal tells that they are ground. A stored
    /// normal that looks aside wins over a flat splat that lies level.
    #[test]
    fn a_stored_normal_wins_over_the_thinnest_axis() {
        let mut cloud = SplatCloud::with_degree(0);
        for (at, scale_z) in [(0.0, 0.1), (40.0, 0.001)] {
            for i in 0..16 {
                cloud.means.push([at + 0.1 * i as f32, 0.0, 0.0]);
                cloud.scales.push([0.1, 0.1, scale_z]);
                cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
                cloud.opacities.push(0.9);
                cloud.sh_dc.push([0.1; 3]);
            }
        }
        let ground_m2 = |normals: &[[f32; 3]], x: f64| -> f64 {
            let options = AmbientOptions::default();
            let splats = (&cloud, normals);
            let field = AmbientField::with_normals(splats, cloud.len(), DVec3::ZERO, &options);
            let patches = field.ground_along([DVec3::new(x, 0.0, 0.5)], 3.0);
            patches.iter().map(|patch| patch.area_m2).sum()
        };
        let (balls, flat) = (0.8, 40.8);
        assert_eq!(ground_m2(&[], balls), 0.0);
        let by_axis = ground_m2(&[], flat);
        assert!(by_axis > 0.4, "{by_axis} square meters");
        // Of either sign; splats whose normal is zero go by their axes.
        let mut normals = vec![[0.0, 0.0, -1.0]; 16];
        normals.extend([[0.0; 3]; 16]);
        let by_normal = ground_m2(&normals, balls);
        assert!((by_normal / by_axis - 1.0).abs() < 0.02, "{by_normal}");
        assert_eq!(ground_m2(&normals, flat), by_axis);
        normals[16..].fill([1.0, 0.0, 0.0]);
        assert_eq!(ground_m2(&normals, flat), 0.0);
    }

    #[test]
    fn the_ground_under_agents_is_found_and_no_roof_above_them() {
        let origin = DVec3::new(4e5, 5e6, 90.0);
        let field = ground_and_roof(origin);
        let place = origin + DVec3::new(3.0, 0.0, 0.8);
        let patches = field.ground_along([place, place, place + DVec3::X], 2.5);
        let centers: BTreeSet<_> = patches
            .iter()
            .map(|patch| patch.center.to_array().map(f64::to_bits))
            .collect();
        assert!(centers.len() == patches.len() && patches.len() > 20);
        for GroundPatch { center, color, .. } in &patches {
            assert!((center.z - origin.z).abs() < 1e-3);
            assert!(center.truncate().distance(place.truncate()) < 4.5);
            assert!(color.iter().all(|value| (value - 0.05).abs() < 1e-4));
        }
        let color_at = |x: f64, z: f64| {
            let patch = field.ground_at(origin + DVec3::new(x, 0.1, z)).next();
            patch.map(|patch| patch.color[1])
        };
        assert!((color_at(12.0, 0.4).unwrap() - 0.2).abs() < 1e-4);
        assert!((color_at(12.0, 6.3).unwrap() - 0.02).abs() < 1e-4);
        assert_eq!((color_at(12.0, 3.0), color_at(-3.0, 0.0)), (None, None));
    }
}
