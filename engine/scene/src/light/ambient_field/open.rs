//! Positions that the sun reaches past the background.

use glam::{DVec3, IVec3};

use super::{AmbientField, WEIGHT};
use crate::Pose;

/// Height above a position up to which the background may hide the sun, meters: that of most
/// houses.
const OPEN_ABOVE_M: f64 = 40.0;

/// Distance from a position up to which the background may hide the sun, meters.
const OPEN_ASIDE_M: f64 = 100.0;

impl AmbientField {
    /// Share of the top of a box of size `dims_m` at `world_from_agent` that light from the
    /// direction `towards` reaches past the background, by its middle and corners.
    ///
    /// Cubes of the background that hold an opaque splat or more block the way. They are looked for
    /// up to 40 m above and 100 m away.
    #[must_use]
    pub fn open_share(&self, world_from_agent: &Pose, dims_m: [f32; 3], towards: DVec3) -> f64 {
        let [length_m, width_m, height_m] = dims_m.map(|size| 0.5 * f64::from(size));
        let corners = [
            (0.0, 0.0),
            (-1.0, -1.0),
            (-1.0, 1.0),
            (1.0, -1.0),
            (1.0, 1.0),
        ];
        let open = corners.iter().filter(|(x, y)| {
            let corner = DVec3::new(x * length_m, y * width_m, height_m);
            self.is_open(world_from_agent.transform(corner) - self.origin, towards)
        });
        open.count() as f64 / corners.len() as f64
    }

    /// True if no cube blocks the way from `position`, relative to the origin. The cube of
    /// `position` and the next one do not count: an agent may touch what it stands beside.
    fn is_open(&self, position: DVec3, towards: DVec3) -> bool {
        let step = towards.normalize_or_zero() * self.voxel_m;
        if !position.is_finite() || step.z <= 0.0 {
            return false;
        }
        let steps = (OPEN_ABOVE_M / step.z).min(OPEN_ASIDE_M / self.voxel_m) as u32;
        (2..steps).all(|at| {
            let cell = (position + f64::from(at) * step) / self.voxel_m;
            let IVec3 { x, y, z } = cell.floor().as_ivec3();
            let column = self.columns.get(&(x, y));
            let mut voxels = column.into_iter().flat_map(|at| &self.voxels[at.clone()]);
            !voxels.any(|voxel| {
                (voxel.center.z / self.voxel_m).floor() as i32 == z && voxel.sum[WEIGHT] >= 1.0
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::AmbientOptions;
    use crate::light::ambient_field::tests::street;

    #[test]
    fn the_sun_does_not_reach_past_a_wall() {
        // The wall is at y = 12 m and is 8 m high.
        let cloud = street(60_000);
        let field = AmbientField::new(&cloud, cloud.len(), DVec3::ZERO, &AmbientOptions::default());
        let open = |y: f64, towards: DVec3| {
            let pose = Pose::from_yaw(0.0, DVec3::new(0.0, y, 0.75));
            field.open_share(&pose, [4.0, 2.0, 1.5], towards)
        };
        let (low, high) = (DVec3::new(0.0, 1.0, 0.3), DVec3::new(0.0, 1.0, 2.0));
        assert_eq!(open(0.0, low), 0.0, "in the shade of the wall");
        assert_eq!(open(0.0, high), 1.0, "the sun stands above the wall");
        assert_eq!(
            open(0.0, low * DVec3::new(1.0, -1.0, 1.0)),
            1.0,
            "no wall there"
        );
        // 6.5 m of wall above the box throw 7.6 m of shade at this elevation.
        let partly = open(12.0 - 7.6, DVec3::new(0.0, 1.0, 6.5 / 7.6));
        assert!(partly > 0.0 && partly < 1.0, "{partly}");
        assert_eq!(open(0.0, DVec3::NEG_Z), 0.0);
        assert_eq!(open(f64::NAN, high), 0.0);
    }
}
