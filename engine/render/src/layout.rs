//! Structures shared with the shaders, which spell them out too. `tests/stages/layout.rs` compares
//! names, offsets and sizes of all of them with the reflection of every kernel.
//!
//! Arrays of `f32` and `u32` only: glam's vectors may be padded for SIMD. The shaders use scalar
//! block layout, whose offsets are those of `repr(C)`.

mod detail;
mod lens;
mod lidar;
mod light;
mod lists;

pub use detail::NodeRecord;
pub use lens::{LENS_INTERVALS, LensKind, LensRecord};
pub use lidar::{BeamEchoes, BeamRecord, BeamState, EchoRecord, FiringRecord, SectorRecord};
pub use light::{RelightRecord, ShadingRecord, ShadowRecord};
pub use lists::{
    BlendItem, Bucket, Composite, MergePiece, NO_BIN, NO_PARTIAL, NOT_BLENDED, PartialTiles,
    RequiredCounts, ViewLists,
};

use bytemuck::{Pod, Zeroable};
use decouplegs_scene::{Camera, Fog, Invalid, Motion, Pose, Rules, rules};
use decouplegs_shaders::constants;
use glam::{DMat3, DVec3};

/// Splats a cluster: culled as one, one workgroup of `cull` and `project`.
pub const CLUSTER_SPLATS: usize = constants::CLUSTER_SPLATS as usize;
/// Width of a coarse tile, 8 fine tiles of 8 pixels.
pub const COARSE_WIDTH_PX: u32 = constants::COARSE_COLUMNS * constants::FINE_TILE_PX;
/// Height of a coarse tile, 4 fine tiles of 8 pixels.
pub const COARSE_HEIGHT_PX: u32 = constants::COARSE_ROWS * constants::FINE_TILE_PX;
/// Pixels of a coarse tile.
pub const COARSE_PIXELS: usize = (COARSE_WIDTH_PX * COARSE_HEIGHT_PX) as usize;
/// Fine tiles of a coarse tile.
pub const FINE_TILES: usize = (constants::COARSE_COLUMNS * constants::COARSE_ROWS) as usize;
/// Records that one workgroup of `count_pairs` and `fill_pairs` takes.
pub const PAIR_BLOCK: usize = constants::PAIR_BLOCK as usize;
/// Pairs after which a bucket of the tile sort ends with the next depth slab.
pub const BUCKET_PAIRS: usize = constants::BUCKET_PAIRS as usize;
/// Pairs of a bucket, at most; longer depth slabs are cut into pieces.
pub const SHARED_PAIRS: usize = constants::SHARED_PAIRS as usize;
/// Entries of a piece of a merged list, at most.
pub const MERGE_PAIRS: usize = constants::MERGE_PAIRS as usize;
/// Depth slabs by which coarse tiles' lists are cut; `depth_slab.glsl`.
pub const SLABS: usize = constants::SLABS as usize;
/// A camera whose direction has no set in the persistent key buffer.
pub const NO_KEY_SET: u32 = constants::NO_KEY_SET;
/// Entries that one workgroup of `scan` takes.
pub const SCAN_BLOCK: usize = 1024;
/// Indirect dispatches of a frame.
pub const ARGUMENT_SETS: usize = 7;
/// Cameras that one submission can draw.
pub const CAMERAS_MAX: usize = constants::CAMERAS_MAX as usize;

/// `Camera` of `frame.glsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct CameraRecord {
    /// Camera from world rotation, first row.
    pub row_x: [f32; 3],
    /// Second row.
    pub row_y: [f32; 3],
    /// Third row.
    pub row_z: [f32; 3],
    /// Rounding error of the third row.
    pub row_z_low: [f32; 3],
    /// The center relative to the world's origin, rounded to f32.
    pub center_high_m: [f32; 3],
    /// Rounding error.
    pub center_low_m: [f32; 3],
    /// First row in steps of 2^-11 ([`CameraRecord::COARSE_STEPS`]).
    pub row_x_coarse: [f32; 3],
    /// Second row.
    pub row_y_coarse: [f32; 3],
    /// Third row.
    pub row_z_coarse: [f32; 3],
    /// Rest of the first row beside its coarse part.
    pub row_x_fine: [f32; 3],
    /// Rest of the second row.
    pub row_y_fine: [f32; 3],
    /// Rest of the third row.
    pub row_z_fine: [f32; 3],
    /// Focal lengths.
    pub focal_px: [f32; 2],
    /// Principal point.
    pub principal_px: [f32; 2],
    /// Focal lengths in steps of 2^(18 - `mean_shift`) pixels.
    pub focal_coarse_px: [f32; 2],
    /// Rest of the focal lengths.
    pub focal_fine_px: [f32; 2],
    /// Principal point in such steps.
    pub principal_coarse_px: [f32; 2],
    /// Rest of the principal point.
    pub principal_fine_px: [f32; 2],
    /// Means of splats are stored in steps of 2^-`mean_shift` pixels.
    pub mean_shift: u32,
    /// Lower limits of x/z and y/z in the Jacobian.
    pub slope_min: [f32; 2],
    /// Upper limits.
    pub slope_max: [f32; 2],
    /// Image size.
    pub size_px: [u32; 2],
    /// Coarse tiles along x and y.
    pub coarse_tiles: [u32; 2],
    /// Offset of a depth relative to the world's origin before scaling: the value as f32, and its
    /// rounding error.
    pub key_offset: [f32; 2],
    /// A power of two that takes such a depth between -1 and 1.
    pub key_scale: f32,
    /// The camera's own depth relative to the world's origin, scaled.
    pub key_depth: f32,
    /// Index of the camera's first coarse tile among all cameras'.
    pub first_bin: u32,
    /// Index of the camera's first pixel in the output buffers.
    pub first_pixel: u32,
    /// Rotation vector of the camera per second, camera axes.
    pub turn_rad_per_s: [f32; 3],
    /// Rotation vector of the splats' frame per second, in its own axes.
    pub frame_turn_rad_per_s: [f32; 3],
    /// Velocity of the splats' frame relative to the camera, camera axes.
    pub frame_velocity_mps: [f32; 3],
    /// Time of exposure at pixel coordinates (0, 0).
    pub shutter_first_s: f32,
    /// Increase of that time per pixel along x and y.
    pub shutter_s_per_px: [f32; 2],
}

impl CameraRecord {
    /// Steps of a row's coarse part in 1.
    pub const COARSE_STEPS: f64 = 2048.0;

    /// The record of `camera` in a world with the given `origin`, whose depths are scaled by
    /// `key_scale`; bins and pixels begin where the arguments say.
    #[must_use]
    pub fn new(
        camera: &Camera,
        origin: DVec3,
        key_scale: f32,
        first_bin: u32,
        first_pixel: u32,
    ) -> Self {
        let k = &camera.intrinsics;
        let size = DVec3::new(f64::from(k.width_px), f64::from(k.height_px), 0.0);
        let margin = |size: f64, focal: f64| rules::JACOBIAN_MARGIN * 0.5 * size / focal;
        let axes = DMat3::from_quat(camera.world_from_camera.rotation.normalize());
        let forward = steady(axes.z_axis);
        let center = camera.world_from_camera.translation - origin;
        let high = center.as_vec3();
        let low = (center - high.as_dvec3()).as_vec3();
        let mean_shift = mean_shift(k.width_px.max(k.height_px));
        let coarse_row = |row: DVec3| (row * Self::COARSE_STEPS).round() / Self::COARSE_STEPS;
        let fine_row = |row: DVec3| (row - coarse_row(row)).as_vec3().to_array();
        let steps_per_px = (f64::from(mean_shift) - 18.0).exp2();
        let coarse_px = |px: [f64; 2]| px.map(|px| (px * steps_per_px).round() / steps_per_px);
        let fine_px = |px: [f64; 2]| {
            let [x, y] = coarse_px(px);
            [(px[0] - x) as f32, (px[1] - y) as f32]
        };
        let (focal_px, principal_px) = ([k.fx_px, k.fy_px], [k.cx_px, k.cy_px]);
        Self {
            row_x: axes.x_axis.as_vec3().to_array(),
            row_y: axes.y_axis.as_vec3().to_array(),
            row_z: forward.as_vec3().to_array(),
            row_z_low: (forward - forward.as_vec3().as_dvec3())
                .as_vec3()
                .to_array(),
            center_high_m: high.to_array(),
            center_low_m: low.to_array(),
            row_x_coarse: coarse_row(axes.x_axis).as_vec3().to_array(),
            row_y_coarse: coarse_row(axes.y_axis).as_vec3().to_array(),
            row_z_coarse: coarse_row(forward).as_vec3().to_array(),
            row_x_fine: fine_row(axes.x_axis),
            row_y_fine: fine_row(axes.y_axis),
            row_z_fine: fine_row(forward),
            focal_px: focal_px.map(|px| px as f32),
            principal_px: principal_px.map(|px| px as f32),
            focal_coarse_px: coarse_px(focal_px).map(|px| px as f32),
            focal_fine_px: fine_px(focal_px),
            principal_coarse_px: coarse_px(principal_px).map(|px| px as f32),
            principal_fine_px: fine_px(principal_px),
            mean_shift,
            slope_min: [
                (-k.cx_px / k.fx_px - margin(size.x, k.fx_px)) as f32,
                (-k.cy_px / k.fy_px - margin(size.y, k.fy_px)) as f32,
            ],
            slope_max: [
                ((size.x - k.cx_px) / k.fx_px + margin(size.x, k.fx_px)) as f32,
                ((size.y - k.cy_px) / k.fy_px + margin(size.y, k.fy_px)) as f32,
            ],
            size_px: [k.width_px, k.height_px],
            coarse_tiles: [
                k.width_px.div_ceil(COARSE_WIDTH_PX),
                k.height_px.div_ceil(COARSE_HEIGHT_PX),
            ],
            key_offset: [0.0; 2],
            key_scale,
            key_depth: (forward.dot(center) * f64::from(key_scale)) as f32,
            first_bin,
            first_pixel,
            turn_rad_per_s: [0.0; 3],
            frame_turn_rad_per_s: [0.0; 3],
            frame_velocity_mps: [0.0; 3],
            shutter_first_s: 0.0,
            shutter_s_per_px: [0.0; 2],
        }
    }

    /// Copy of the record with the motion of `camera`, whose record it is, and of the frame of the
    /// splats; an equal record if both are at rest. With a global shutter, the times of all pixels
    /// are 0, and splats do not move during the exposure.
    #[must_use]
    pub fn moving(self, camera: &Camera, frame: &Motion) -> Self {
        let shutter = camera.intrinsics.shutter;
        if camera.motion.is_rest() && frame.is_rest() {
            return self;
        }
        let camera_from_world = camera.world_from_camera.rotation.normalize().conjugate();
        let velocity = camera_from_world * (frame.velocity_mps - camera.motion.velocity_mps);
        let vec3 = |vector: DVec3| vector.as_vec3().to_array();
        Self {
            turn_rad_per_s: vec3(camera.motion.turn_rad_per_s),
            frame_turn_rad_per_s: vec3(frame.turn_rad_per_s),
            frame_velocity_mps: vec3(velocity),
            shutter_first_s: shutter.first_s as f32,
            shutter_s_per_px: shutter.s_per_px.map(|s_per_px| s_per_px as f32),
            ..self
        }
    }

    /// True if splats move in the image while it is exposed.
    #[must_use]
    pub fn rolls(&self) -> bool {
        self.shutter_s_per_px != [0.0; 2]
    }

    /// This camera as the splats of an agent see it, which stands at `world_from_agent`: the image
    /// and the depth keys of a splat are the same whether it is moved into the world or the camera
    /// into the agent's frame. `camera` and `origin` are those that the record was made of.
    #[must_use]
    pub fn moved_into(&self, camera: &Camera, origin: DVec3, world_from_agent: &Pose) -> Self {
        let agent_from_camera = world_from_agent.inverse().then(&camera.world_from_camera);
        let local = Camera {
            world_from_camera: agent_from_camera,
            ..camera.clone()
        };
        let forward =
            steady(DMat3::from_quat(camera.world_from_camera.rotation.normalize()).z_axis);
        let offset = forward.dot(world_from_agent.translation - origin) * f64::from(self.key_scale);
        let high = offset as f32;
        Self {
            key_offset: [high, (offset - f64::from(high)) as f32],
            ..Self::new(
                &local,
                DVec3::ZERO,
                self.key_scale,
                self.first_bin,
                self.first_pixel,
            )
        }
    }

    /// Step in which means of splats are stored, pixels.
    #[must_use]
    pub fn mean_step_px(&self) -> f64 {
        (-f64::from(self.mean_shift)).exp2()
    }

    /// Coarse tiles of the camera's image.
    #[must_use]
    pub fn bins(&self) -> u32 {
        self.coarse_tiles[0] * self.coarse_tiles[1]
    }

    /// Pixels of the camera's image.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.size_px[0] as usize * self.size_px[1] as usize
    }
}

/// The shift of [`CameraRecord::mean_shift`] for an image of `size_px` pixels along its longer
/// side: 31 bits reach a quarter of the image beyond it. At most 20: means are not exact to more.
fn mean_shift(size_px: u32) -> u32 {
    let reach_px = u64::from(size_px) * 5 / 4;
    (31 - reach_px.next_power_of_two().ilog2()).min(20)
}

/// A direction without its last digits, which rounding changes from one frame to the next although
/// nothing turned: what is left out moves a splat a kilometer away by a nanometer.
fn steady(direction: DVec3) -> DVec3 {
    const STEPS: f64 = (1u64 << 40) as f64;
    (direction * STEPS).round() / STEPS
}

/// The largest power of two that takes depths of up to `distance_max_m` between -1 and 1, and no
/// f32 out of its range.
#[must_use]
pub fn key_scale(distance_max_m: f64) -> f32 {
    // A sixteenth more: what rounding adds stays below 1 as well.
    let exponent = (distance_max_m.max(1e-30) * 1.0625)
        .log2()
        .ceil()
        .clamp(-100.0, 100.0);
    (-exponent).exp2() as f32
}

/// Color of the air and extinction per meter, as the shaders take them; zeros for clear air.
#[must_use]
pub fn fog_vector(fog: Option<&Fog>) -> [f32; 4] {
    let of = |fog: &Fog| {
        let [red, green, blue] = fog.color.map(|value| value as f32);
        [red, green, blue, fog.extinction_per_m as f32]
    };
    fog.map_or([0.0; 4], of)
}

/// The near plane as the shaders compare with it: the smallest f32 that is not nearer than the
/// rules', so that f32 depths fall on the same side of both.
#[must_use]
pub fn near_m(rules: &Rules) -> f32 {
    let rounded = rules.near_m as f32;
    if f64::from(rounded) < rules.near_m {
        rounded.next_up()
    } else {
        rounded
    }
}

/// Largest sum of squares of an exponent at which a splat is blended; infinite without a limit.
#[must_use]
pub fn response_squares_max(rules: &Rules) -> f32 {
    -rules.response_min.log2() as f32
}

/// `Cluster` of `frame.glsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ClusterRecord {
    /// Center of the box around the means.
    pub center_m: [f32; 3],
    /// Half its size.
    pub half_extent_m: [f32; 3],
    /// Longest standard deviation times cut-off radius (at least sqrt(3)) of any splat in it.
    pub splat_radius_m: f32,
}

/// `Agent` of `agent.glsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct AgentRecord {
    /// World from agent rotation, first row.
    pub row_x: [f32; 3],
    /// Second row.
    pub row_y: [f32; 3],
    /// Third row.
    pub row_z: [f32; 3],
    /// Lower corner of the position grid.
    pub box_min_m: [f32; 3],
    /// Stride from one element to the next.
    pub box_step_m: [f32; 3],
    /// Quantization steps of luma, orange and green.
    pub dc_residual_step: [f32; 3],
    /// Binary logarithm of the smallest size.
    pub log2_size_min: f32,
    /// Binary logarithm of the ratio between two sizes.
    pub log2_size_step: f32,
    /// First cluster among those of all agents of the frame.
    pub first_cluster: u32,
    /// First box of its level of detail in the pool.
    pub first_bounds: u32,
    /// First splat in the pool.
    pub first_splat: u32,
    /// Splats of its level of detail.
    pub splat_count: u32,
    /// First shape in the pool.
    pub first_shape: u32,
    /// First color in the pool.
    pub first_color: u32,
    /// Mask of the cameras that may see it, bit 0 for the first.
    pub cameras: u32,
    /// Instance id.
    pub instance: u32,
    /// 1 where colors are not turned with it.
    pub colors_in_world: u32,
    /// 1 where its colors are those that were made for it, and `first_color` counts among these.
    pub colors_relit: u32,
    /// Shading by normals: 0 none, else one more than its index among those of the frame.
    pub shading: u32,
    /// Factors on the part that is added to the DC term of its colors.
    pub dc_residual_gain: [f32; 3],
    /// Velocity, world axes.
    pub velocity_mps: [f32; 3],
    /// Rotation vector per second, its own axes.
    pub turn_rad_per_s: [f32; 3],
}

/// The cameras of one frame as the shaders see them.
#[derive(Clone, Debug)]
pub struct View {
    /// One record a camera.
    pub cameras: Vec<CameraRecord>,
    /// One record a camera; none at all where all are pinholes.
    pub lenses: Vec<LensRecord>,
    /// Coarse tiles of all cameras.
    pub bins: u32,
    /// Pixels of all cameras.
    pub pixels: usize,
}

impl View {
    /// First pixel, and width and height, of the image of each camera.
    #[must_use]
    pub fn ranges(&self) -> Vec<(usize, [u32; 2])> {
        let range = |camera: &CameraRecord| (camera.first_pixel as usize, camera.size_px);
        self.cameras.iter().map(range).collect()
    }

    /// Lays out the images of `cameras` one after the other; depths up to `distance_max_m` from the
    /// world's `origin` are told apart.
    ///
    /// # Errors
    /// A sentence when there is no camera, too many, or one that cannot make an image.
    pub fn new(cameras: &[Camera], origin: DVec3, distance_max_m: f64) -> Result<Self, Invalid> {
        if cameras.is_empty() || cameras.len() > CAMERAS_MAX {
            return Err(Invalid::new(format!(
                "{} cameras were given; a frame draws 1 to {CAMERAS_MAX}",
                cameras.len()
            )));
        }
        let key_scale = key_scale(distance_max_m);
        let mut view = Self {
            cameras: Vec::with_capacity(cameras.len()),
            lenses: Vec::new(),
            bins: 0,
            pixels: 0,
        };
        for camera in cameras {
            camera
                .intrinsics
                .check()
                .map_err(|reason| format!("camera {}: {reason}", camera.name))?;
            let pose = &camera.world_from_camera;
            if !(pose.translation.is_finite()
                && pose.rotation.is_finite()
                && pose.rotation.length_squared() > 1e-12)
            {
                return Err(Invalid::new(format!(
                    "camera {}: its pose {pose:?} is not finite",
                    camera.name
                )));
            }
            let first_pixel = u32::try_from(view.pixels).map_err(|_| {
                format!("camera {}: more than 2^32 pixels in one frame", camera.name)
            })?;
            let record = CameraRecord::new(camera, origin, key_scale, view.bins, first_pixel)
                .moving(camera, &Motion::REST);
            view.bins += record.bins();
            view.pixels += record.pixels();
            view.cameras.push(record);
        }
        if cameras.iter().any(|camera| !camera.intrinsics.is_pinhole()) {
            view.lenses = cameras
                .iter()
                .map(|camera| LensRecord::new(&camera.intrinsics))
                .collect();
        }
        Ok(view)
    }
}

/// Largest turn of a camera or an agent between the time of its pose and any exposure, radians.
const TURN_MAX_RAD: f64 = 1.0;

/// Checks that `motion` can be projected at all times up to `within_s` before and after that of the
/// pose.
pub(crate) fn check_motion(motion: &Motion, within_s: f64) -> Result<(), Invalid> {
    motion.check()?;
    let turn_rad = motion.turn_rad_per_s.length() * within_s;
    if turn_rad > TURN_MAX_RAD {
        return Err(Invalid::new(format!(
            "a turn of {turn_rad:.2} rad in {within_s} s, half of an exposure or the interval of \
             flow; expected at most {TURN_MAX_RAD} rad"
        )));
    }
    Ok(())
}

/// Largest distance of an exposure from the time of the pose, seconds.
pub(crate) fn exposed_within_s(camera: &Camera) -> f64 {
    let k = &camera.intrinsics;
    let last_px = [f64::from(k.width_px), f64::from(k.height_px)];
    let [first_s, last_s] = [[0.0; 2], last_px].map(|pixel| k.shutter.time_s(pixel).abs());
    first_s.max(last_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::Intrinsics;

    fn camera(width: u32, height: u32) -> Camera {
        let intrinsics = Intrinsics::from_horizontal_fov(width, height, 1.0);
        Camera {
            name: "c".into(),
            intrinsics,
            world_from_camera: Pose::IDENTITY,
            motion: Motion::REST,
        }
    }

    #[test]
    fn images_lie_one_after_the_other() {
        let view = View::new(&[camera(65, 33), camera(1, 1)], DVec3::ZERO, 1.0).unwrap();
        assert_eq!(view.cameras[0].coarse_tiles, [2, 2]);
        assert_eq!(
            (view.cameras[1].first_bin, view.cameras[1].first_pixel),
            (4, 65 * 33)
        );
        assert_eq!((view.bins, view.pixels), (5, 65 * 33 + 1));
    }

    #[test]
    fn a_center_at_utm_distance_keeps_its_micrometers() {
        let mut far = camera(4, 4);
        far.world_from_camera.translation = DVec3::new(4.5e6 + 0.001, 1.0, 0.0);
        let record = CameraRecord::new(&far, DVec3::ZERO, 1.0, 0, 0);
        let kept = f64::from(record.center_high_m[0]) + f64::from(record.center_low_m[0]);
        assert!((kept - (4.5e6 + 0.001)).abs() < 1e-7);
    }

    #[test]
    fn cameras_that_cannot_be_drawn_are_named() {
        assert!(View::new(&[], DVec3::ZERO, 1.0).is_err());
        assert!(
            View::new(&vec![camera(4, 4); 33], DVec3::ZERO, 1.0)
                .unwrap_err()
                .reason()
                .contains("33")
        );
        let mut lost = camera(4, 4);
        lost.world_from_camera.translation.x = f64::NAN;
        assert!(
            View::new(&[lost], DVec3::ZERO, 1.0)
                .unwrap_err()
                .reason()
                .contains("camera c")
        );
    }
}
