//! The structs that C programs see.

use std::ffi::{c_char, c_void};

use decouplegs::gpu::{DeviceInfo, DeviceKind};
use decouplegs::render::{Plane, Planes};
use decouplegs::scene::lidar::LidarPoint;
use decouplegs::scene::{Camera, Intrinsics, Lens, Motion, Pose};
use glam::{DQuat, DVec3};

use crate::status::{DgsStatus, Failure};
use crate::world::DgsWorld;

/// Largest departure of a rotation's length from 1; beyond, something else was meant.
const ROTATION_LENGTH_SPARE: f64 = 1e-3;

/// Pose: parent = rotation * child + position.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct DgsPose {
    /// Unit quaternion: w, x, y, z.
    pub rotation_wxyz: [f64; 4],
    /// Translation, meters.
    pub position_m: [f64; 3],
}

impl DgsPose {
    pub fn from_pose(pose: &Pose) -> Self {
        let [x, y, z, w] = pose.rotation.to_array();
        Self {
            rotation_wxyz: [w, x, y, z],
            position_m: pose.translation.to_array(),
        }
    }

    pub fn to_pose(self, what: &str) -> Result<Pose, Failure> {
        let [w, x, y, z] = self.rotation_wxyz;
        let (rotation, position) = (
            DQuat::from_xyzw(x, y, z, w),
            DVec3::from_array(self.position_m),
        );
        if !position.is_finite() {
            return Err(Failure::argument(format!(
                "the position of {what} is {position}: expected finite numbers"
            )));
        }
        // Written so that what is not a number fails too.
        let is_unit = (rotation.length() - 1.0).abs() <= ROTATION_LENGTH_SPARE;
        if !is_unit {
            let found = format!("({w}, {x}, {y}, {z})");
            return Err(Failure::argument(format!(
                "the rotation of {what} is {found}: expected w, x, y, z of length 1"
            )));
        }
        Ok(Pose::new(rotation, position))
    }
}

/// A pinhole camera in the world, without photometric calibration; cameras of every other kind are
/// in a DgsRig. The center of pixel (i, j) is at (i + 0.5, j + 0.5).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct DgsCamera {
    /// Width of the image, at least 1.
    pub width_px: u32,
    /// Height of the image, at least 1.
    pub height_px: u32,
    /// Focal length along x.
    pub fx_px: f64,
    /// Focal length along y.
    pub fy_px: f64,
    /// Principal point, from the left edge of the image.
    pub cx_px: f64,
    /// Principal point, from the upper edge of the image.
    pub cy_px: f64,
    /// Pose of the camera: world from camera.
    pub world_from_camera: DgsPose,
}

impl DgsCamera {
    /// `camera`, which must be a pinhole: others do not fit.
    pub fn from_camera(camera: &Camera) -> Result<Self, Failure> {
        let Intrinsics {
            width_px,
            height_px,
            fx_px,
            fy_px,
            cx_px,
            cy_px,
            lens,
            windshield,
            photometry,
            shutter,
        } = camera.intrinsics;
        if !photometry.is_identity() {
            let text = format!(
                "camera {:?} has a photometric calibration, which this struct has no place for: draw the rig with dgs_scene_rig() and dgs_batch_renderer_draw_rigs()",
                camera.name
            );
            return Err(Failure::new(DgsStatus::Unsupported, text));
        }
        if !shutter.is_global() {
            let text = format!(
                "camera {:?} has a rolling shutter, which this struct has no place for: draw the rig with dgs_scene_rig() and dgs_batch_renderer_draw_rigs()",
                camera.name
            );
            return Err(Failure::new(DgsStatus::Unsupported, text));
        }
        if lens != Lens::Pinhole || windshield.is_some() {
            let text = format!(
                "camera {:?} has a lens, and this struct holds pinholes: draw the rig with dgs_scene_rig() and dgs_batch_renderer_draw_rigs()",
                camera.name
            );
            return Err(Failure::new(DgsStatus::Unsupported, text));
        }
        let world_from_camera = DgsPose::from_pose(&camera.world_from_camera);
        Ok(Self {
            width_px,
            height_px,
            fx_px,
            fy_px,
            cx_px,
            cy_px,
            world_from_camera,
        })
    }

    /// The camera, called `name` in what goes wrong with it.
    pub fn to_camera(self, name: String) -> Result<Camera, Failure> {
        let size_px = [self.width_px, self.height_px];
        let center_px = [self.cx_px, self.cy_px];
        let intrinsics = Intrinsics::pinhole(size_px, [self.fx_px, self.fy_px], center_px);
        intrinsics
            .check()
            .map_err(|fault| Failure::argument(format!("{name}: {fault}")))?;
        Ok(Camera {
            intrinsics,
            world_from_camera: self.world_from_camera.to_pose(&name)?,
            name,
            motion: Motion::REST,
        })
    }
}

/// A world, and the cameras that look at it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct DgsView {
    /// World to render. The same world may be in many views.
    pub world: *const DgsWorld,
    /// Cameras of the view.
    pub cameras: *const DgsCamera,
    /// Number of cameras; at least one.
    pub camera_count: usize,
}

/// An agent as it stands.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct DgsAgent {
    /// Pose of its origin: world from agent.
    pub pose: DgsPose,
    /// Number of the asset that it shows.
    pub asset: u32,
    /// Id in instance images, above 0.
    pub instance: u32,
}

/// Storage format of color.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DgsColor {
    /// Four bytes: red, green, blue, clamped to 0 to 1 and rounded, and alpha. What a camera
    /// delivers.
    U8 = 0,
    /// Four floats: red, green, blue as blended, unclamped, and alpha.
    F32 = 1,
}

/// Content of an image.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DgsImageKind {
    /// uint8_t red, green, blue, alpha; sessions of DGS_COLOR_U8.
    RgbaU8 = 0,
    /// float red, green, blue, alpha; sessions of DGS_COLOR_F32.
    RgbaF32 = 1,
    /// float: expected depth along the camera's z, meters; 0 where nothing was hit. Sessions with
    /// `depth`.
    DepthF32 = 2,
    /// uint16_t: the agent that weighs most, by its `instance`; 0 is the background. Sessions with
    /// `instance`.
    InstanceU16 = 3,
    /// float: expected distance from the camera, meters. This kind and those up to the scene flow
    /// are means over the splats of a pixel, and 0 where nothing was hit. Sessions with them in
    /// `planes`.
    RangeF32 = 4,
    /// float x, y, z: normal in world axes, towards the camera; its length tells how far the splats
    /// agree.
    NormalF32 = 5,
    /// float x, y: pixels that the content moves in `flow_interval_s`. Agents go on with the motion
    /// of their trajectory, and rigs with theirs; a DgsCamera stands.
    FlowForwardF32 = 6,
    /// float x, y: the same to the time earlier.
    FlowBackwardF32 = 7,
    /// float x, y, z: velocity in world axes, meters per second.
    SceneFlowF32 = 8,
    /// float: depth of the splat in which half of a pixel's light is gone, meters; 0 where more
    /// than half is left.
    DepthMedianF32 = 9,
    /// float: distance of that splat from the camera, meters.
    RangeMedianF32 = 10,
}

impl DgsImageKind {
    /// The last kind.
    pub(crate) const LAST: u32 = Self::RangeMedianF32 as u32;

    /// The kind of the images of `plane`.
    const fn from_plane(plane: Plane) -> Self {
        match plane {
            Plane::Depth => Self::DepthF32,
            Plane::Instance => Self::InstanceU16,
            Plane::Range => Self::RangeF32,
            Plane::Normal => Self::NormalF32,
            Plane::FlowForward => Self::FlowForwardF32,
            Plane::FlowBackward => Self::FlowBackwardF32,
            Plane::SceneFlow => Self::SceneFlowF32,
            Plane::DepthMedian => Self::DepthMedianF32,
            Plane::RangeMedian => Self::RangeMedianF32,
        }
    }

    /// The plane whose kind is `kind`.
    pub(crate) fn plane(kind: u32) -> Option<Plane> {
        let mut planes = Plane::ALL.into_iter();
        planes.find(|plane| Self::from_plane(*plane) as u32 == kind)
    }
}

/// An image in the library's memory: rows from the top, pixels from the left.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct DgsImage {
    /// The upper left pixel. Valid until the batch renderer draws or is closed.
    pub data: *const c_void,
    /// Distance between rows, bytes.
    pub row_bytes: usize,
    /// Distance between pixels of a row, bytes.
    pub pixel_bytes: u32,
    /// Pixels in a row.
    pub width_px: u32,
    /// Number of rows.
    pub height_px: u32,
    /// A DgsImageKind.
    pub kind: u32,
}

/// Options of a session. All zero but the size is what most want: the best device and images in
/// bytes.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct DgsSessionOptions {
    /// sizeof(DgsSessionOptions).
    pub struct_bytes: u32,
    /// Storage format of color: a DgsColor.
    pub color: u32,
    /// 1 to have images of depth too, else 0.
    pub depth: u32,
    /// 1 to have images of instances too, else 0.
    pub instance: u32,
    /// Device: a number as in dgs_device(), a part of a name, a UUID as 32 hexadecimal digits, or
    /// NULL or "auto" for the best.
    pub device: *const c_char,
    /// Interval of flow images, seconds; 0 for 0.1.
    pub flow_interval_s: f64,
    /// Kinds of further images, DGS_IMAGE_KIND_RANGE_F32 and those behind it: the sum of 1 << kind.
    pub planes: u32,
    /// Storage of the backgrounds' splats: a DgsStorage.
    pub storage: u32,
    /// Backgrounds are drawn with fewer splats where they lie at most this many pixels apart; 0:
    /// always the finest, which is exact.
    pub background_pitch_px: f64,
    /// Rules of image formation for all scenes: "default", "gsplat15", "gsplat16", "inria" or
    /// "nurec"; NULL: each scene's own, as its file says.
    pub rules: *const c_char,
}

impl DgsSessionOptions {
    /// Size when it was first published.
    pub(crate) const FIRST_BYTES: usize = 24;
    pub const DEFAULT: Self = Self {
        struct_bytes: size_of::<Self>() as u32,
        color: 0,
        depth: 0,
        instance: 0,
        device: std::ptr::null(),
        flow_interval_s: 0.0,
        planes: 0,
        storage: 0,
        background_pitch_px: 0.0,
        rules: std::ptr::null(),
    };

    /// The planes that are asked for.
    pub(crate) fn planes(&self) -> Result<Planes, Failure> {
        let flags = [(Plane::Depth, self.depth), (Plane::Instance, self.instance)];
        if let Some((plane, number)) = flags.iter().find(|(_, number)| *number > 1) {
            let name = plane.name();
            let text = format!("{name} is {number}: expected 0 or 1");
            return Err(Failure::argument(text));
        }
        let bit = |plane: Plane| 1 << DgsImageKind::from_plane(plane) as u32;
        // Depth and instance have members of their own.
        let beside = || {
            Planes::ALL
                .iter()
                .filter(|plane| !Planes::BESIDE_COLOR.contains(*plane))
        };
        let known = beside().fold(0, |bits, plane| bits | bit(plane));
        if self.planes & !known != 0 {
            let text = format!(
                "planes is {:#x}: expected the bits of kinds 4 to {}, {known:#x}",
                self.planes,
                DgsImageKind::LAST
            );
            return Err(Failure::argument(text));
        }
        let asked = flags.into_iter().filter(|(_, number)| *number == 1);
        let others = beside().filter(|plane| self.planes & bit(*plane) != 0);
        Ok(asked.map(|(plane, _)| plane).chain(others).collect())
    }
}

/// Kind of a device.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DgsDeviceKind {
    /// The driver does not say.
    Other = 0,
    /// A card with its own memory.
    Discrete = 1,
    /// Part of the processor, sharing its memory.
    Integrated = 2,
    /// Handed through by a hypervisor.
    Virtual = 3,
    /// Software on the processor, such as lavapipe.
    Cpu = 4,
}

/// A device that Vulkan finds.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct DgsDevice {
    /// sizeof(DgsDevice), set by the caller.
    pub struct_bytes: u32,
    /// A DgsDeviceKind.
    pub kind: u32,
    /// Size of its largest memory.
    pub memory_bytes: u64,
    /// UUID of the driver, the same for this device in every process and after every start; CUDA
    /// names it by the same 16 bytes.
    pub uuid: [u8; 16],
    /// Name; ends with a NUL.
    pub name: [c_char; 256],
    /// The driver's name and version; ends with a NUL.
    pub driver: [c_char; 256],
}

impl DgsDevice {
    /// Size when it was first published.
    pub(crate) const FIRST_BYTES: usize = 544;

    pub fn from_info(info: &DeviceInfo) -> Self {
        let kind = match info.kind {
            DeviceKind::Discrete => DgsDeviceKind::Discrete,
            DeviceKind::Integrated => DgsDeviceKind::Integrated,
            DeviceKind::Virtual => DgsDeviceKind::Virtual,
            DeviceKind::Cpu => DgsDeviceKind::Cpu,
            DeviceKind::Other => DgsDeviceKind::Other,
        };
        Self {
            struct_bytes: size_of::<Self>() as u32,
            kind: kind as u32,
            memory_bytes: info.device_memory_bytes,
            uuid: info.uuid,
            name: fixed_text(&info.name),
            driver: fixed_text(&info.driver),
        }
    }
}

/// `text` and a NUL; cut between characters where it is too long.
fn fixed_text<const LENGTH: usize>(text: &str) -> [c_char; LENGTH] {
    let mut fixed = [0; LENGTH];
    let cut = text.floor_char_boundary(LENGTH - 1);
    fixed
        .iter_mut()
        .zip(text[..cut].bytes())
        .for_each(|(to, byte)| *to = byte as c_char);
    fixed
}

/// Statistics of a draw.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct DgsStatistics {
    /// sizeof(DgsStatistics), set by the caller.
    pub struct_bytes: u32,
    /// Frames that were submitted: one draws up to 32 cameras of worlds over the same scene that
    /// follow one another.
    pub frames: u32,
    /// Agents that some camera could see, summed over frames.
    pub agents: u32,
    /// Number of repeated draws because a list outgrew its buffer, which has grown since.
    pub redrawn: u32,
    /// Time on the device, milliseconds, summed over frames; without what ran beside another frame.
    pub gpu_ms: f64,
    /// Wall clock of the whole call, milliseconds.
    pub wall_ms: f64,
    /// Splats that cameras saw, each counted once for each camera.
    pub splats_listed: u64,
    /// Memory that the session holds on the device.
    pub memory_bytes: u64,
}

impl DgsStatistics {
    /// Size when it was first published.
    pub(crate) const FIRST_BYTES: usize = 48;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn structs_are_no_smaller_than_when_they_were_published() {
        assert!(size_of::<DgsSessionOptions>() >= DgsSessionOptions::FIRST_BYTES);
        assert!(size_of::<DgsDevice>() >= DgsDevice::FIRST_BYTES);
        assert!(size_of::<DgsStatistics>() >= DgsStatistics::FIRST_BYTES);
        // Those without a size stay as they are under the ABI version.
        let frozen = [
            size_of::<DgsPose>(),
            size_of::<DgsCamera>(),
            size_of::<DgsView>(),
            size_of::<DgsAgent>(),
            size_of::<DgsImage>(),
        ];
        assert_eq!(frozen, [56, 96, 24, 64, 32]);
    }

    #[test]
    fn long_names_are_cut_between_characters() {
        let text = |fixed: [c_char; 6]| {
            String::from_utf8(fixed.iter().map(|&byte| byte as u8).collect()).unwrap()
        };
        assert_eq!(text(fixed_text("abc")), "abc\0\0\0");
        assert_eq!(text(fixed_text("abcdefgh")), "abcde\0");
        assert_eq!(text(fixed_text("abcd\u{e4}f")), "abcd\0\0");
    }

    #[test]
    fn poses_go_there_and_back() {
        let pose = Pose::new(
            DQuat::from_rotation_z(0.4) * DQuat::from_rotation_x(1.0),
            DVec3::new(1.0, 2.0, 3.0),
        );
        let back = DgsPose::from_pose(&pose).to_pose("it").unwrap();
        assert!(
            back.rotation.angle_between(pose.rotation) < 1e-7
                && back.translation == pose.translation
        );
        let with = |rotation_wxyz, position_m| {
            DgsPose {
                rotation_wxyz,
                position_m,
            }
            .to_pose("it")
            .map_err(|fault| fault.message)
        };
        assert!(
            with([1.0, 0.0, 0.0, 0.0], [0.0, f64::INFINITY, 0.0])
                .unwrap_err()
                .contains("position of it")
        );
        for nonsense in [
            [0.0; 4],
            [f64::NAN; 4],
            [2.0, 0.0, 0.0, 0.0],
            [1.0, 0.0, f64::INFINITY, 0.0],
        ] {
            assert!(with(nonsense, [0.0; 3]).unwrap_err().contains("length 1"));
        }
    }
}

/// A point of a sweep.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct DgsLidarPoint {
    /// Position in the frame of the sweep, meters.
    pub position_m: [f32; 3],
    /// Range along the beam, meters.
    pub range_m: f32,
    /// Intensity from 0 to 1. Luma of splats: uncalibrated.
    pub intensity: f32,
    /// Time of firing after the start of the sweep, nanoseconds.
    pub offset_ns: u32,
    /// Column of the beam.
    pub column: u32,
    /// Row of the beam, from the highest.
    pub ring: u16,
    /// Laser of the beam, as the manufacturer counts.
    pub laser: u16,
    /// Number in images of instances; 0 is the background.
    pub instance: u16,
    /// Number among the returns of the beam, from 1.
    pub return_number: u8,
    /// Returns of the beam.
    pub return_count: u8,
}

impl DgsLidarPoint {
    pub fn from_point(point: &LidarPoint) -> Self {
        Self {
            position_m: point.position_m.as_vec3().to_array(),
            range_m: point.measured.range_m,
            intensity: point.measured.intensity,
            offset_ns: point.beam.offset_ns(),
            column: point.beam.column,
            ring: point.beam.ring,
            laser: point.beam.laser,
            instance: point.measured.instance,
            return_number: point.measured.number,
            return_count: point.measured.count,
        }
    }
}
