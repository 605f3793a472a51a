//! Surfaces that splats are sampled from: where a point lies, how it faces and what it looks like.

use std::sync::Arc;

use glam::{Quat, Vec3};

use super::loft::Loft;
use super::random::{Stream, noise};

/// Distance reported where no edge is near, meters.
pub(super) const FAR_M: f32 = 1e6;

/// A sampled point, in the element's own frame. Textures that have edges should draw them by
/// `position`, which is what moves when the surroundings of a splat are probed.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePoint {
    /// First surface parameter in [0, 1].
    pub u: f32,
    /// Second surface parameter in [0, 1].
    pub v: f32,
    pub position: Vec3,
    /// Unit, outward.
    pub normal: Vec3,
    /// Unit, the direction in which `u` grows.
    pub tangent: Vec3,
    /// Flat extent of the surface along u and along v, meters: to its border, or as its curvature
    /// allows.
    pub border_m: [f32; 2],
}

impl SurfacePoint {
    /// The point `offset` away in the tangent plane, meters.
    pub(super) fn moved(&self, offset: Vec3) -> Self {
        Self {
            position: self.position + offset,
            ..*self
        }
    }
}

/// Surface color at a point before lighting.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texel {
    /// Linear RGB, 0 to 1.
    pub albedo: Vec3,
    /// Strength of the view-dependent sheen, 0 to 1.
    pub gloss: f32,
    /// Share of the ambient light that reaches the point.
    pub openness: f32,
    /// Share of light that passes through from behind, as in leaves.
    pub translucency: f32,
    /// Share of the color taken by the haze of distance.
    pub haze: f32,
    /// True if the element's weathering applies.
    pub weathered: bool,
    /// Linear RGB that replaces lit albedo: lamps and the sky.
    pub emitted: Option<Vec3>,
    /// Linear RGB of its own light, shown as much as the weather has lamps lit.
    pub glow: Vec3,
    /// Share of its opacity that a splat here loses: shadows laid over a ground that is not ours.
    pub sheer: f32,
}

impl Texel {
    /// A matt point of the given linear albedo.
    pub(super) fn matt(albedo: Vec3) -> Self {
        Self {
            albedo,
            gloss: 0.0,
            openness: 1.0,
            translucency: 0.0,
            haze: 0.0,
            weathered: false,
            emitted: None,
            glow: Vec3::ZERO,
            sheer: 0.0,
        }
    }
}

/// Linear RGB of a color given as it is displayed, each channel 0 to 255.
pub(crate) fn display(red: u8, green: u8, blue: u8) -> Vec3 {
    Vec3::new(f32::from(red), f32::from(green), f32::from(blue))
        .map(|value| (value / 255.0).powf(2.2))
}

/// The geometry of an element.
pub(super) enum Shape {
    /// `corner + u along + v up`; faces `along x up`.
    Rectangle { corner: Vec3, along: Vec3, up: Vec3 },
    /// A curved surface.
    Loft(Loft),
    /// Leaves in a thick shell about an ellipsoid.
    Crown { center: Vec3, radii: Vec3 },
    /// The part of a sphere about the world origin above `low` times its radius, seen from inside.
    Dome { radius_m: f32, low: f32 },
}

/// Leaf area over the area of the crown's ellipsoid.
const LEAF_LAYERS: f32 = 1.7;

impl Shape {
    /// Area in square meters.
    pub(super) fn area_m2(&self) -> f32 {
        match self {
            Self::Rectangle { along, up, .. } => along.cross(*up).length(),
            Self::Loft(loft) => loft.area_m2(),
            Self::Crown { radii, .. } => {
                // Thomsen's approximation, within 1.1 %.
                let p = 1.6075;
                let [a, b, c] = radii.to_array().map(|r| r.powf(p));
                4.0 * std::f32::consts::PI
                    * ((a * b + a * c + b * c) / 3.0).powf(1.0 / p)
                    * LEAF_LAYERS
            }
            Self::Dome { radius_m, low } => {
                std::f32::consts::TAU * radius_m * radius_m * (1.0 - low)
            }
        }
    }

    /// A point in the midst of the surface or on it.
    pub(super) fn middle(&self) -> Vec3 {
        match self {
            Self::Rectangle { corner, along, up } => *corner + (*along + *up) * 0.5,
            Self::Loft(loft) => loft.at(0.5, 0.5).position,
            Self::Crown { center, .. } => *center,
            Self::Dome { .. } => Vec3::ZERO,
        }
    }

    /// Length along u over length along v.
    fn aspect(&self) -> f32 {
        match self {
            Self::Rectangle { along, up, .. } => along.length() / up.length().max(1e-6),
            Self::Loft(loft) => loft.aspect(),
            Self::Crown { .. } => std::f32::consts::PI,
            Self::Dome { low, .. } => std::f32::consts::TAU / (1.0 - low),
        }
    }

    /// Point `index` of `count` that together cover the area evenly.
    pub(super) fn sample(&self, index: usize, count: usize, random: &mut Stream) -> SurfacePoint {
        let (u, v) = stratified(index, count, self.aspect(), random);
        match self {
            Self::Rectangle { corner, along, up } => {
                let (width, height) = (along.length(), up.length());
                SurfacePoint {
                    u,
                    v,
                    position: *corner + *along * u + *up * v,
                    normal: along.cross(*up).normalize_or(Vec3::Z),
                    tangent: *along / width.max(1e-6),
                    border_m: [u.min(1.0 - u) * width, v.min(1.0 - v) * height],
                }
            }
            Self::Loft(loft) => loft.at(u, v),
            Self::Crown { center, radii } => {
                let outward = on_sphere(u, 2.0 * v - 1.0);
                let depth = random.unit();
                // Twigs of unequal length, so that no crown ends in a smooth line.
                let twigs = noise(
                    17,
                    4.0 * outward.x + 2.3 * outward.z + center.x,
                    4.0 * outward.y - 2.9 * outward.z + center.y,
                );
                let position = *center
                    + *radii * outward * ((0.84 + 0.4 * twigs) * (1.08 - 0.5 * depth * depth));
                // Leaves face all ways, but more often out and up than in.
                let normal = (outward + 1.1 * random.signed3() + Vec3::new(0.0, 0.0, 0.4))
                    .normalize_or(outward);
                SurfacePoint {
                    u,
                    v,
                    position,
                    normal,
                    tangent: normal.any_orthonormal_vector(),
                    border_m: [FAR_M; 2],
                }
            }
            Self::Dome { radius_m, low } => {
                let outward = on_sphere(u, low + (1.0 - low) * v);
                let tangent = Vec3::Z.cross(outward).normalize_or(Vec3::X);
                SurfacePoint {
                    u,
                    v,
                    position: outward * *radius_m,
                    normal: -outward,
                    tangent,
                    border_m: [FAR_M; 2],
                }
            }
        }
    }
}

/// The unit vector at height `z` whose azimuth is `u` turns.
fn on_sphere(u: f32, z: f32) -> Vec3 {
    let (sin, cos) = (u * std::f32::consts::TAU).sin_cos();
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * cos, radius * sin, z)
}

/// Point `index` of `count` of a jittered grid over the unit square whose cells are square on a
/// surface of this aspect. Every cell has one point, so no hole is wider than two cells.
fn stratified(index: usize, count: usize, aspect: f32, random: &mut Stream) -> (f32, f32) {
    let rows = ((count as f64 / f64::from(aspect)).sqrt().round() as usize).clamp(1, count.max(1));
    let row = index * rows / count;
    let (first, next) = (
        (row * count).div_ceil(rows),
        ((row + 1) * count).div_ceil(rows),
    );
    let jitter = 0.8;
    let offset = |random: &mut Stream| 0.5 + jitter * (random.unit() - 0.5);
    let u = ((index - first) as f32 + offset(random)) / (next - first) as f32;
    let v = (row as f32 + offset(random)) / rows as f32;
    (u, v)
}

/// Appearance of a surface at a point.
pub(super) type Texture = Arc<dyn Fn(&SurfacePoint) -> Texel + Send + Sync>;

/// Aging of a surface at a point.
pub(super) type Weathering = Arc<dyn Fn(&SurfacePoint) -> f32 + Send + Sync>;

/// One surface of the street.
#[derive(Clone)]
pub(super) struct Element {
    pub shape: Arc<Shape>,
    pub texture: Texture,
    /// Factor on the albedo of weathered texels: slow variation, kept apart because the texture is
    /// also asked for edges, many times a splat.
    pub weather: Option<Weathering>,
    /// Splats a square meter, relative to the asphalt's.
    pub density: f32,
    /// True if the surface continues in the same look beyond its border, which splats may then
    /// overhang.
    pub seamless: bool,
    /// Rotation from the element's frame to its parent's.
    pub rotation: Quat,
    /// Translation from the element's frame to its parent's, meters.
    pub translation: Vec3,
}

impl Element {
    /// An element whose frame is its parent's.
    pub(super) fn new(
        shape: Shape,
        density: f32,
        texture: impl Fn(&SurfacePoint) -> Texel + Send + Sync + 'static,
    ) -> Self {
        Self {
            shape: Arc::new(shape),
            texture: Arc::new(texture),
            weather: None,
            density,
            seamless: false,
            rotation: Quat::IDENTITY,
            translation: Vec3::ZERO,
        }
    }

    /// The element moved rigidly; geometry and texture are shared with the original.
    pub(super) fn placed(&self, rotation: Quat, translation: Vec3) -> Self {
        Self {
            rotation: rotation * self.rotation,
            translation: rotation * self.translation + translation,
            ..self.clone()
        }
    }

    pub(super) fn weathered(
        self,
        weather: impl Fn(&SurfacePoint) -> f32 + Send + Sync + 'static,
    ) -> Self {
        Self {
            weather: Some(Arc::new(weather)),
            ..self
        }
    }

    pub(super) fn seamless(self) -> Self {
        Self {
            seamless: true,
            ..self
        }
    }

    /// Middle of the shape in the frame of the element's parent: see [`Shape::middle`].
    pub(super) fn middle(&self) -> Vec3 {
        self.rotation * self.shape.middle() + self.translation
    }

    pub(super) fn denser(self, factor: f32) -> Self {
        Self {
            density: self.density * factor,
            ..self
        }
    }
}

/// The six faces of the axis-aligned box from `min` to `max`, less its underside where `grounded`.
pub(super) fn box_faces(min: Vec3, max: Vec3, grounded: bool) -> Vec<Shape> {
    let size = max - min;
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let face = |corner, along, up| Shape::Rectangle { corner, along, up };
    let mut faces = vec![
        face(min, x, z),
        face(min + x, y, z),
        face(min + x + y, -x, z),
        face(min + y, -y, z),
        face(min + z, x, y),
    ];
    if !grounded {
        faces.push(face(min + y, x, -y));
    }
    faces
}

/// A box of one texture.
pub(super) fn boxed(
    min: Vec3,
    max: Vec3,
    density: f32,
    texture: impl Fn(&SurfacePoint) -> Texel + Send + Sync + 'static,
) -> Vec<Element> {
    let texture: Texture = Arc::new(texture);
    let face = |shape| {
        let texture = texture.clone();
        Element::new(shape, density, move |point| texture(point))
    };
    box_faces(min, max, false).into_iter().map(face).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stratified_set_has_one_point_in_every_cell() {
        for (count, aspect) in [(1, 1.0), (7, 0.01), (600, 6.0), (601, 300.0)] {
            let mut histogram = [0usize; 4];
            for index in 0..count {
                let (u, v) = stratified(index, count, aspect, &mut Stream::new(1, 2, index as u64));
                assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v));
                histogram[(u * 4.0) as usize] += 1;
            }
            if count >= 600 {
                assert!(
                    histogram.iter().all(|&n| n.abs_diff(count / 4) <= 12),
                    "{count} at {aspect}: {histogram:?}"
                );
            }
        }
    }

    #[test]
    fn boxes_face_outward() {
        let (min, max) = (Vec3::new(1.0, -2.0, 0.0), Vec3::new(3.0, 5.0, 4.0));
        let faces = box_faces(min, max, false);
        assert_eq!(faces.len(), 6);
        for face in &faces {
            let point = face.sample(0, 1, &mut Stream::new(0, 0, 0));
            assert!(
                (point.position - (min + max) * 0.5).dot(point.normal) > 0.5,
                "{point:?}"
            );
        }
        let area: f32 = faces.iter().map(Shape::area_m2).sum();
        assert!((area - 2.0 * (2.0 * 7.0 + 2.0 * 4.0 + 7.0 * 4.0)).abs() < 1e-3);
    }
}
