//! Bounding boxes of agents in images, as ground truth of detectors.

use glam::{DVec2, DVec3};

use crate::{Camera, Pose, RayMap};

/// Nearest part of a box that is projected, meters in front of the camera.
const NEAR_M: f64 = 0.01;

/// Pieces of an edge through a lens, whose image is a curve.
const EDGE_PIECES: u32 = 16;

/// Box in an image, pixels from its top left corner: a pixel (i, j) covers i to i + 1 and j to
/// j + 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageBox {
    /// Left and top edge.
    pub min_px: DVec2,
    /// Right and bottom edge.
    pub max_px: DVec2,
}

impl ImageBox {
    /// Area, square pixels.
    #[must_use]
    pub fn area_px(&self) -> f64 {
        let size = (self.max_px - self.min_px).max(DVec2::ZERO);
        size.x * size.y
    }

    /// The part inside an image of `size_px`; `None` if there is none.
    #[must_use]
    pub fn clipped(&self, size_px: DVec2) -> Option<Self> {
        let clipped = Self {
            min_px: self.min_px.max(DVec2::ZERO),
            max_px: self.max_px.min(size_px),
        };
        clipped
            .min_px
            .cmplt(clipped.max_px)
            .all()
            .then_some(clipped)
    }

    /// The box around `places_px`; `None` where there are none.
    fn around(places_px: impl IntoIterator<Item = DVec2>) -> Option<Self> {
        let mut places_px = places_px.into_iter();
        let first = places_px.next()?;
        let point = Self {
            min_px: first,
            max_px: first,
        };
        Some(places_px.fold(point, |around, place_px| Self {
            min_px: around.min_px.min(place_px),
            max_px: around.max_px.max(place_px),
        }))
    }
}

/// Bounding boxes of one agent in one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AgentBox {
    /// Pose of the agent's box in the camera's frame.
    pub camera_from_box: Pose,
    /// Amodal box: around all corners of the 3D box that are in front of the camera, hidden or not,
    /// beyond the edges of the image too.
    pub amodal: ImageBox,
    /// Part of the amodal box inside the image.
    pub in_image: ImageBox,
}

/// Bounding boxes of a 3D box of `dims_m` (length, width, height) at `world_from_box`; `None` if no
/// part of it is in the image of `camera`.
///
/// Edges are cut 1 cm in front of the camera. Through a lens each edge is 16 pieces; ends that the
/// lens does not show are left out.
#[must_use]
pub fn agent_box(camera: &Camera, world_from_box: &Pose, dims_m: [f64; 3]) -> Option<AgentBox> {
    let intrinsics = &camera.intrinsics;
    let camera_from_box = camera.world_from_camera.inverse().then(world_from_box);
    let half_m = 0.5 * DVec3::from_array(dims_m);
    let corner = |index: usize| {
        let sign = |bit: usize| if index & bit == 0 { -1.0 } else { 1.0 };
        let at_m = half_m * DVec3::new(sign(1), sign(2), sign(4));
        camera_from_box.transform(at_m)
    };
    let edges = (0..8usize).flat_map(|from| {
        let ends = [1, 2, 4].into_iter().map(move |bit| from | bit);
        ends.filter(move |to| *to != from).map(move |to| (from, to))
    });
    let in_front = edges.filter_map(|(from, to)| cut(corner(from), corner(to)));
    let amodal = if intrinsics.is_pinhole() {
        let ends = in_front.flat_map(|(from, to)| [from, to]);
        ImageBox::around(ends.filter_map(|ray| intrinsics.project(ray)))
    } else {
        let lens = RayMap::new(intrinsics);
        let pieces = in_front.flat_map(|(from, to)| {
            let share = |piece| f64::from(piece) / f64::from(EDGE_PIECES);
            (0..=EDGE_PIECES).map(move |piece| from.lerp(to, share(piece)))
        });
        let shown: Vec<DVec2> = pieces.filter_map(|ray| lens.project(ray)).collect();
        ImageBox::around(shown)
    }?;
    let size_px = DVec2::new(intrinsics.width_px.into(), intrinsics.height_px.into());
    Some(AgentBox {
        camera_from_box,
        amodal,
        in_image: amodal.clipped(size_px)?,
    })
}

/// The part of an edge that is in front of the camera.
fn cut(from: DVec3, to: DVec3) -> Option<(DVec3, DVec3)> {
    let at_near = || from.lerp(to, (NEAR_M - from.z) / (to.z - from.z));
    match (from.z >= NEAR_M, to.z >= NEAR_M) {
        (true, true) => Some((from, to)),
        (true, false) => Some((from, at_near())),
        (false, true) => Some((at_near(), to)),
        (false, false) => None,
    }
}

/// Visible pixels of an instance and the box around them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibleBox {
    /// Pixels where the instance has the largest weight.
    pub pixels: u32,
    /// Box around these pixels.
    pub tight: ImageBox,
}

/// Visible pixels of each instance of an image, by instance id from 0 to `ids - 1`; `None` where an
/// instance has none. `instances` are row-major, `width_px` per row.
///
/// # Panics
/// Panics if `width_px` is 0.
#[must_use]
pub fn visible_boxes(instances: &[u16], width_px: u32, ids: usize) -> Vec<Option<VisibleBox>> {
    let mut boxes: Vec<Option<VisibleBox>> = vec![None; ids];
    for (index, &id) in instances.iter().enumerate() {
        let Some(found) = boxes.get_mut(usize::from(id)) else {
            continue;
        };
        let width = width_px as usize;
        let min_px = DVec2::new((index % width) as f64, (index / width) as f64);
        let pixel = ImageBox {
            min_px,
            max_px: min_px + 1.0,
        };
        let VisibleBox { pixels, tight } = found.get_or_insert(VisibleBox {
            pixels: 0,
            tight: pixel,
        });
        *pixels += 1;
        tight.min_px = tight.min_px.min(pixel.min_px);
        tight.max_px = tight.max_px.max(pixel.max_px);
    }
    boxes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::Fisheye;
    use crate::{Intrinsics, Lens, Motion};
    use glam::DQuat;

    fn camera(lens: Lens) -> Camera {
        Camera {
            name: "front".into(),
            intrinsics: Intrinsics {
                lens,
                fx_px: 100.0,
                fy_px: 120.0,
                cx_px: 100.0,
                cy_px: 60.0,
                ..Intrinsics::from_horizontal_fov(200, 120, 1.5)
            },
            world_from_camera: Pose::new(DQuat::from_rotation_y(0.3), DVec3::new(1.0, 2.0, 3.0)),
            motion: Motion::REST,
        }
    }

    fn placed(camera: &Camera, at_m: DVec3) -> Pose {
        camera
            .world_from_camera
            .then(&Pose::new(DQuat::IDENTITY, at_m))
    }

    #[test]
    fn a_box_ahead_has_the_corners_of_its_near_face() {
        let camera = camera(Lens::Pinhole);
        let world_from_box = placed(&camera, DVec3::new(1.0, -0.5, 6.0));
        let found = agent_box(&camera, &world_from_box, [2.0, 1.0, 2.0]).unwrap();
        // The near face is 5 m ahead, 0 to 2 m right, 1 to 0 m up.
        let near = |x_m: f64, y_m: f64| DVec2::new(100.0 + 20.0 * x_m, 60.0 + 24.0 * y_m);
        assert!((found.amodal.min_px - near(0.0, -1.0)).length() < 1e-9);
        assert!((found.amodal.max_px - near(2.0, 0.0)).length() < 1e-9);
        assert_eq!(found.in_image, found.amodal);
        assert!((found.amodal.area_px() - 40.0 * 24.0).abs() < 1e-9);
        assert!((found.camera_from_box.translation - DVec3::new(1.0, -0.5, 6.0)).length() < 1e-9);
    }

    #[test]
    fn boxes_around_beside_and_behind_the_camera() {
        let camera = camera(Lens::Pinhole);
        let at = |x: f64, z: f64| {
            agent_box(
                &camera,
                &placed(&camera, DVec3::new(x, 0.0, z)),
                [2.0, 2.0, 2.0],
            )
        };
        let whole = ImageBox {
            min_px: DVec2::ZERO,
            max_px: DVec2::new(200.0, 120.0),
        };
        assert_eq!(at(0.0, 0.0).unwrap().in_image, whole, "around the camera");
        assert!(at(0.0, -3.0).is_none(), "behind");
        assert!(at(9.0, 4.0).is_none(), "beside");
        let cut_off = at(5.0, 5.0).unwrap();
        assert!(cut_off.amodal.max_px.x > 200.0 && cut_off.in_image.max_px.x == 200.0);
    }

    /// Compares boxes with a dense sampling of the surface.
    #[test]
    fn boxes_through_a_lens_hold_what_their_surface_shows() {
        let lens = Lens::Fisheye(Fisheye {
            radial: [-0.02, 0.004, 0.0, 0.0],
            max_angle_rad: 1.5,
        });
        let camera = camera(lens);
        let pose = camera.world_from_camera.then(&Pose::new(
            DQuat::from_rotation_y(0.7),
            DVec3::new(1.5, 0.4, 2.5),
        ));
        let dims_m = [2.0, 1.0, 3.0];
        let found = agent_box(&camera, &pose, dims_m).unwrap();
        let camera_from_box = camera.world_from_camera.inverse().then(&pose);
        let steps = || (0..=60).map(|step| f64::from(step) / 60.0 - 0.5);
        let mut sampled = Vec::new();
        for a in steps() {
            for b in steps() {
                for side in [-0.5, 0.5] {
                    for at in [[side, a, b], [a, side, b], [a, b, side]] {
                        let at_m = DVec3::from_array(at) * DVec3::from_array(dims_m);
                        sampled.extend(camera.intrinsics.project(camera_from_box.transform(at_m)));
                    }
                }
            }
        }
        let truth = ImageBox::around(sampled).unwrap();
        let error = (truth.min_px - found.amodal.min_px).abs().max_element();
        let error = error.max((truth.max_px - found.amodal.max_px).abs().max_element());
        assert!(error < 0.5, "{error} px: {found:?} {truth:?}");
    }

    #[test]
    fn tight_boxes_are_around_the_pixels_of_an_instance() {
        #[rustfmt::skip]
        let instances = [
            0, 0, 2, 0,
            0, 2, 2, 7,
            1, 0, 0, 0,
        ];
        let found = visible_boxes(&instances, 4, 4);
        let two = found[2].unwrap();
        assert_eq!(
            (two.pixels, two.tight.min_px, two.tight.max_px),
            (3, DVec2::new(1.0, 0.0), DVec2::new(3.0, 2.0))
        );
        assert_eq!(found[1].unwrap().tight.max_px, DVec2::new(1.0, 3.0));
        assert!(found[3].is_none() && found.len() == 4);
    }
}
