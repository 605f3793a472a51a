//! Rays against triangles, in f64.

use bvh::aabb::{Aabb, Bounded};
use bvh::bounding_hierarchy::BHShape;
use bvh::bvh::Bvh;
use bvh::ray::Ray;
use glam::DVec3;
use nalgebra::{Point3, Vector3};

/// A triangle that light does not pass, from either side.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    pub corners: [DVec3; 3],
    node: usize,
}

impl Triangle {
    pub fn new(corners: [DVec3; 3]) -> Self {
        Self { corners, node: 0 }
    }

    /// Twice the area, along the normal.
    pub fn cross(&self) -> DVec3 {
        let [a, b, c] = self.corners;
        (b - a).cross(c - a)
    }

    /// True if the ray from `origin` meets the triangle ahead (Möller and Trumbore, Fast, Minimum
    /// Storage Ray/Triangle Intersection, 1997).
    fn meets(&self, origin: DVec3, direction: DVec3) -> bool {
        let [a, b, c] = self.corners;
        let (u_edge, v_edge) = (b - a, c - a);
        let p = direction.cross(v_edge);
        let determinant = u_edge.dot(p);
        if determinant.abs() < 1e-18 {
            return false;
        }
        let from = origin - a;
        let u = from.dot(p) / determinant;
        let q = from.cross(u_edge);
        let v = direction.dot(q) / determinant;
        u >= 0.0 && v >= 0.0 && u + v <= 1.0 && v_edge.dot(q) / determinant > 0.0
    }
}

impl Bounded<f64, 3> for Triangle {
    fn aabb(&self) -> Aabb<f64, 3> {
        let [a, b, c] = self.corners;
        let (min, max) = (a.min(b).min(c), a.max(b).max(c));
        Aabb::with_bounds(point(min), point(max))
    }
}

impl BHShape<f64, 3> for Triangle {
    fn set_bh_node_index(&mut self, index: usize) {
        self.node = index;
    }

    fn bh_node_index(&self) -> usize {
        self.node
    }
}

fn point(at: DVec3) -> Point3<f64> {
    Point3::new(at.x, at.y, at.z)
}

/// Triangles in a hierarchy of boxes.
pub struct Solid {
    triangles: Vec<Triangle>,
    hierarchy: Option<Bvh<f64, 3>>,
}

impl Solid {
    pub fn new(mut triangles: Vec<Triangle>) -> Self {
        let hierarchy = (!triangles.is_empty()).then(|| Bvh::build(&mut triangles));
        Self {
            triangles,
            hierarchy,
        }
    }

    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// True if no triangle blocks light that arrives at `origin` from `direction`, a unit vector.
    pub fn open(&self, origin: DVec3, direction: DVec3) -> bool {
        let Some(hierarchy) = &self.hierarchy else {
            return true;
        };
        let ray = Ray::new(
            point(origin),
            Vector3::new(direction.x, direction.y, direction.z),
        );
        let mut near = hierarchy.traverse_iterator(&ray, &self.triangles);
        !near.any(|triangle| triangle.meets(origin, direction))
    }
}
