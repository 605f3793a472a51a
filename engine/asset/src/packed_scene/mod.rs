//! Scenes as one USDZ package, which AlpaSim's runtime and CARLA's NuRec scripts read and
//! [`crate::open_scene`] opens again.
//!
//! A package is a zip of stored, aligned entries. Read by others (names and fields followed:
//! NVlabs/alpasim at 3032e0cf of July 2026,
//! `src/utils/alpasim_utils/{artifact,scenario,scene_metadata}.py`, and CARLA 0.9.16,
//! `PythonAPI/examples/nvidia/nurec/scenario.py`):
//!
//! | entry | what is in it | for |
//! |---|---|---|
//! | `default.usda` | an empty stage, z up, meters: the layer that makes the package one | USD |
//! | `metadata.yaml` | scene id, sensors, time range | AlpaSim |
//! | `rig_trajectories.json` | rig poses, camera calibrations (`ftheta`, `opencv-pinhole`, `opencv-fisheye`), frames of the cameras | both |
//! | `sequence_tracks.json` | boxes and poses of the agents; the sequence is called as CARLA's script wants it | both |
//! | `data_info.json` | first and last moment | CARLA |
//! | `map.xodr` | the map, if one is given | AlpaSim |
//! | `mesh_ground.ply`, `mesh.ply` | the ground as triangles, if it is given | AlpaSim |
//! | `decouplegs/` | our scene file and everything it names | us |
//!
//! **Frames.** `local` is the scene's world seen from its origin, axes as they are: others keep it
//! in 32-bit floats. The rig's origin is where [`PackOptions::rig_origin_m`] says, on the ground
//! below the rear axle by default; agents are the middles of their boxes, as in scene files.
//! **Times** are the scene's in microseconds plus [`PackSummary::offset_s`], whole seconds: the
//! first pose is at 1 s or later, and the first frame of a camera 0.2 s after it, because AlpaSim
//! asks for the poses one control step before the first frame, and for those when its shutter
//! opens, as unsigned numbers (`src/runtime/alpasim_runtime/unbound_rollout.py:88`,
//! `event_loop.py:236`).
//!
//! Trajectories are sampled ten times a second: others interpolate, and smooth, more than two poses
//! far apart.

mod agents;
mod nurec_volume;
pub(crate) mod packed_map;
mod packed_rig;
mod read;
mod rig;
mod write;

pub use crate::camera_model::packed_intrinsics;
pub use agents::stands;
pub use packed_map::read_packed_lanes;
pub use packed_rig::{PackedRig, packed_scene_id, read_packed_rig};
pub use read::is_package;
pub use read::{PackedScene, open_packed_scene};
pub use write::{PackSummary, pack};

use decouplegs_scene::VehicleSize;
use glam::DVec3;

/// Folder of this project in a package.
const OURS: &str = "decouplegs/";
/// Scene file in that folder.
const SCENE: &str = "decouplegs/scene.toml";
/// Poses a second of what is sampled.
const SAMPLES_HZ: f64 = 10.0;
/// Duration of a scene without times, seconds.
const STANDING_S: f64 = 20.0;
/// Longest scene, seconds: a day.
const DURATION_MAX_S: f64 = 86_400.0;
/// Earliest moment in a package, seconds.
const START_S: f64 = 1.0;
/// Time from the first pose to the first frame of a camera, seconds: more than the shutter (0.03 s)
/// and the control step (0.1 s) of AlpaSim's defaults (`src/wizard/configs/base_config.yaml`).
const BEFORE_FRAMES_S: f64 = 0.2;
/// Duration of a frame of a global shutter, seconds: `shutter_duration_us` there.
const EXPOSURE_S: f64 = 0.03;
/// The name of the only sequence of tracks: CARLA's script asks for no other.
const SEQUENCE: &str = "dummy_chunk_id";

/// Data of a packed scene that a scene file does not have.
#[derive(Clone, Debug, PartialEq)]
pub struct PackOptions {
    /// Id by which clients ask for the scene.
    pub scene_id: String,
    /// The ego vehicle.
    pub vehicle: VehicleSize,
    /// Origin of the other simulator's rig in the vehicle frame (from the middle of the box),
    /// meters.
    pub rig_origin_m: DVec3,
    /// Names of cameras in the scene, and what they are called in the package. Others keep their
    /// names.
    pub camera_names: Vec<(String, String)>,
    /// An OpenDRIVE map, as it is.
    pub map: Option<Vec<u8>>,
    /// The ground as triangles in the local frame, a PLY ([`ground_mesh_ply`]).
    pub ground_mesh: Option<Vec<u8>>,
    /// True if the splats are written as NuRec's `volume.nurec`, numbers of 16 bits, instead of the
    /// scene with its files.
    pub as_nurec: bool,
}

impl PackOptions {
    /// A family car whose rear axle is 1.35 m behind its middle, no map, no ground.
    #[must_use]
    pub fn new(scene_id: impl Into<String>) -> Self {
        let vehicle = VehicleSize::CAR;
        let rig_origin_m = DVec3::new(-0.3 * vehicle.length_m, 0.0, -0.5 * vehicle.height_m);
        Self {
            scene_id: scene_id.into(),
            vehicle,
            rig_origin_m,
            camera_names: Vec::new(),
            map: None,
            ground_mesh: None,
            as_nurec: false,
        }
    }
}

/// A mesh as a binary PLY: vertices in meters, three of them a triangle.
#[must_use]
pub fn ground_mesh_ply(vertices: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<u8> {
    let mut file = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        vertices.len(),
        triangles.len()
    )
    .into_bytes();
    file.extend(
        vertices
            .as_flattened()
            .iter()
            .flat_map(|value| value.to_le_bytes()),
    );
    for triangle in triangles {
        file.push(3);
        file.extend(triangle.iter().flat_map(|index| index.to_le_bytes()));
    }
    file
}
