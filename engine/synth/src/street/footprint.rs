//! Extent of each splat on its surface: wide in uniform areas, narrow beside an edge.

use glam::{Mat3, Quat, Vec3};

use super::random::Stream;
use super::surface::{Element, SurfacePoint, Texel};

/// Median tangential standard deviation over the spacing of the opaque splats. Below about 0.5,
/// holes open between jittered neighbors; above 0.8, lane markings smear.
const SCALE_OVER_SPACING: f32 = 0.7;

/// Spread of ln scale that a splat's two tangential axes share, and that each has of its own;
/// together 0.6.
const LN_SCALE_SHARED: f32 = 0.42;
/// Spread of ln scale that each tangential axis has of its own: see [`LN_SCALE_SHARED`].
const LN_SCALE_OWN: f32 = 0.43;

/// Change of albedo, as the difference of square roots (roughly of what is displayed), that counts
/// as an edge.
const EDGE_CONTRAST: f32 = 0.14;

/// Positions at which the surroundings are sampled, as shares of the distance: dense enough not to
/// step over a lane line.
const PROBES: [f32; 6] = [1.0, -1.0, 0.55, -0.55, 0.25, -0.25];

/// Smallest width of a splat beside an edge, relative to the spacing: the gap must still be
/// covered.
const NARROWEST: f32 = 0.25;

/// Leaves are smaller than a closed surface would need: light shows through crowns.
const LEAF_SHRINK: f32 = 0.6;

/// A splat's spread within the plane that touches its surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// Standard deviations, meters.
    along_m: f32,
    across_m: f32,
    /// Unit, what `along_m` and `across_m` are measured along before the turn.
    tangent: Vec3,
    bitangent: Vec3,
    /// About the normal, radians; none beside an edge.
    turn_rad: f32,
    near_edge: bool,
}

impl Footprint {
    /// Drawn about the splats' spacing, at most `largest_m`, and narrowed where a change of color
    /// is near.
    pub(super) fn new(
        element: &Element,
        point: &SurfacePoint,
        texel: &Texel,
        (spacing_m, largest_m): (f32, f32),
        random: &mut Stream,
    ) -> Self {
        let leaf = texel.translucency > 0.5;
        let median_m = SCALE_OVER_SPACING * spacing_m * if leaf { LEAF_SHRINK } else { 1.0 };
        let shared = LN_SCALE_SHARED * random.normal();
        // The tail is cut where one splat would cover dozens of others.
        let mut draw =
            || (median_m * (shared + LN_SCALE_OWN * random.normal()).min(1.1).exp()).min(largest_m);
        let (mut along_m, mut across_m) = (draw(), draw());
        let bitangent = point
            .normal
            .cross(point.tangent)
            .normalize_or(point.normal.any_orthonormal_vector());
        let tangent = bitangent.cross(point.normal);

        let distance_m = 1.6 * along_m.max(across_m);
        let near_edge = !leaf
            && [tangent, bitangent]
                .iter()
                .any(|axis| !clear(element, point, texel, *axis, distance_m));
        let turn_rad = if near_edge {
            0.0
        } else {
            random.range(0.0, std::f32::consts::TAU)
        };
        if near_edge {
            // Most edges run along the surface's own axes: lie along them, and stop short of them.
            let floor_m = NARROWEST * spacing_m;
            for (scale_m, axis) in [(&mut along_m, tangent), (&mut across_m, bitangent)] {
                while *scale_m > floor_m && !clear(element, point, texel, axis, 1.6 * *scale_m) {
                    *scale_m *= 0.6;
                }
            }
        }
        Self {
            along_m,
            across_m,
            tangent,
            bitangent,
            turn_rad,
            near_edge,
        }
    }

    /// Standard deviations and rotation, in the element's frame, of a thin disc with this
    /// footprint.
    pub(super) fn disc(&self, normal: Vec3, random: &mut Stream) -> (Vec3, Quat) {
        let Self {
            along_m,
            across_m,
            tangent,
            bitangent,
            ..
        } = *self;
        let thin_m = (along_m * across_m).sqrt() / random.range(5.0, 20.0);
        let (sin, cos) = self.turn_rad.sin_cos();
        let axes = Mat3::from_cols(
            tangent * cos + bitangent * sin,
            bitangent * cos - tangent * sin,
            normal,
        );
        // Training does not order the axes either, so readers must not count on the last being the
        // normal.
        let (scales, axes) = match random.bits() % 3 {
            0 => (Vec3::new(along_m, across_m, thin_m), axes),
            1 => (
                Vec3::new(across_m, thin_m, along_m),
                Mat3::from_cols(axes.y_axis, axes.z_axis, axes.x_axis),
            ),
            _ => (
                Vec3::new(thin_m, along_m, across_m),
                Mat3::from_cols(axes.z_axis, axes.x_axis, axes.y_axis),
            ),
        };
        (scales, Quat::from_mat3(&axes))
    }

    /// The albedo that a splat of this size is trained to: what it covers, where that is finer than
    /// the splat.
    pub(super) fn mean_albedo(
        &self,
        element: &Element,
        point: &SurfacePoint,
        texel: &Texel,
    ) -> Vec3 {
        if !self.near_edge {
            return texel.albedo;
        }
        let (along, across) = (self.tangent * self.along_m, self.bitangent * self.across_m);
        let around: Vec3 = [along, -along, across, -across]
            .iter()
            .map(|offset| (element.texture)(&point.moved(*offset)).albedo)
            .sum();
        0.2 * (texel.albedo + around)
    }
}

/// True if the surface continues in the same color for `distance_m` both ways along `axis`.
fn clear(
    element: &Element,
    point: &SurfacePoint,
    texel: &Texel,
    axis: Vec3,
    distance_m: f32,
) -> bool {
    let border_m = if axis.dot(point.tangent).abs() > 0.5 {
        point.border_m[0]
    } else {
        point.border_m[1]
    };
    let root = |albedo: Vec3| albedo.max(Vec3::ZERO).map(f32::sqrt);
    let here = root(texel.albedo);
    (element.seamless || border_m >= distance_m)
        && PROBES.into_iter().all(|share| {
            let there = point.moved(axis * (share * distance_m));
            (root((element.texture)(&there).albedo) - here)
                .abs()
                .max_element()
                < EDGE_CONTRAST
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::street::surface::Shape;

    /// A wall 4 m wide, white where `white` holds for x.
    fn wall(white: fn(f32) -> bool) -> Element {
        let shape = Shape::Rectangle {
            corner: Vec3::ZERO,
            along: Vec3::X * 4.0,
            up: Vec3::Z * 4.0,
        };
        Element::new(shape, 1.0, move |point| {
            Texel::matt(Vec3::splat(if white(point.position.x) {
                0.8
            } else {
                0.05
            }))
        })
    }

    fn footprints(
        element: &Element,
        spacing_m: f32,
        largest_m: f32,
    ) -> Vec<(SurfacePoint, Texel, Footprint)> {
        let drawn = |index: u64| {
            let mut random = Stream::new(4, 4, index);
            let point = element.shape.sample(index as usize, 400, &mut random);
            let texel = (element.texture)(&point);
            (
                point,
                texel,
                Footprint::new(element, &point, &texel, (spacing_m, largest_m), &mut random),
            )
        };
        (0..400).map(drawn).collect()
    }

    #[test]
    fn splats_stop_short_of_an_edge_across_it_only() {
        let element = wall(|x| x > 2.0);
        let near: Vec<_> = footprints(&element, 0.2, 9.0)
            .into_iter()
            .filter(|(point, ..)| {
                (0.04..0.15).contains(&(point.position.x - 2.0).abs()) && point.border_m[1] > 1.2
            })
            .collect();
        assert!(near.len() > 8);
        for (point, _, footprint) in &near {
            let gap_m = (point.position.x - 2.0).abs();
            assert!(
                footprint.along_m <= (gap_m / 1.6).max(NARROWEST * 0.2),
                "{gap_m} from the edge: {footprint:?}"
            );
        }
        let mean = |pick: fn(&Footprint) -> f32| {
            near.iter()
                .map(|(.., footprint)| pick(footprint))
                .sum::<f32>()
        };
        assert!(mean(|f| f.across_m) > 2.0 * mean(|f| f.along_m));
    }

    #[test]
    fn no_splat_is_larger_than_allowed() {
        assert!(
            footprints(&wall(|_| true), 0.5, 0.3)
                .iter()
                .all(|(.., f)| f.along_m <= 0.3 && f.across_m <= 0.3)
        );
    }

    #[test]
    fn stripes_finer_than_splats_are_seen_mixed() {
        let element = wall(|x| (x / 0.01).fract() < 0.5);
        let all = footprints(&element, 0.3, 9.0);
        let spread = |color: &dyn Fn(&(SurfacePoint, Texel, Footprint)) -> f32| {
            let mean = all.iter().map(color).sum::<f32>() / all.len() as f32;
            (all.iter()
                .map(|item| (color(item) - mean).powi(2))
                .sum::<f32>()
                / all.len() as f32)
                .sqrt()
        };
        let sampled = spread(&|(_, texel, _)| texel.albedo.x);
        let mixed =
            spread(&|(point, texel, footprint)| footprint.mean_albedo(&element, point, texel).x);
        assert!(mixed < 0.75 * sampled, "{mixed} of {sampled}");
    }
}
