//! File formats: splats, compressed assets, cameras, scene files, maps and tracks.
//!
//! One module per format. Each reader takes bytes that anyone may have written: it returns a
//! [`DecodeError`] and neither panics nor allocates by a count that the bytes do not cover. Each
//! writer goes through [`write_atomically`].
#![forbid(unsafe_code)]

mod activation;
mod atomic;
mod error;
mod npy;
mod placed;
mod ply;
mod read;
mod rigid;
mod summary;

// Parts of readers that other crates of files are made of, too.
#[doc(hidden)]
pub mod toml_text;
#[doc(hidden)]
pub mod traffic_light_form;
#[doc(hidden)]
pub mod traffic_sign_form;
#[doc(hidden)]
pub mod xml;

mod camera_model;
pub mod cameras;
pub mod checkpoint;
pub mod coded_asset;
pub mod compressed_ply;
mod extent;
pub mod ground_file;
pub mod inria_ply;
pub mod khr_glb;
pub mod kitti_raw;
pub mod lidar_file;
pub mod light_transfer_file;
pub mod loss;
mod map_file;
pub mod maps;
pub mod memory;
pub mod ncore;
pub mod nuscenes;
pub mod obstacle_file;
pub mod packed_scene;
pub mod probe;
pub mod scan;
pub mod scene_file;
pub mod scene_import;
mod sky_bundle;
pub mod sky_file;
pub mod sog;
pub mod splat;
pub mod spz;
pub mod tracks;
mod unfinished;
mod unknown_keys;
pub mod zip;

#[doc(hidden)]
pub use atomic::sync_directory_of;
pub use atomic::{Replaces, TEMPORARY_PREFIX, check_writable, write_atomically, write_in_folder};
pub use cameras::{CameraOptions, read_cameras};
pub use coded_asset::{CodedAsset, CodedSummary, Provenance, read_coded, write_coded};
pub use error::{AssetError, DecodeError, EncodeError, SceneError, check_readable, read_bytes};
pub use extent::SplatExtent;
pub use ground_file::{read_ground, write_ground};
pub use lidar_file::{lidar_names, read_lidar};
pub use light_transfer_file::{LightTransferFile, read_light_transfer, write_light_transfer};
pub use loss::{AttributeLoss, Comparison, LossReport};
pub use map_file::read_map;
pub use obstacle_file::{read_obstacles, write_obstacles};
pub use packed_scene::open_packed_scene;
pub use placed::{PlacedSplats, SplatLabels};
pub use probe::{probe_paths, read_probe};
pub use read::{SplatFormat, read_placed_splats, read_splat_pieces, read_splats, usual_up};
pub use scan::{Scan, ScanFormat, read_scan};
pub use scene_file::{
    AgentLabel, EditError, Layer, LoadedAgent, LoadedLight, LoadedRecording, LoadedScene,
    PlainAgent, SceneAgent, SceneFile, SceneLidar, SceneLight, SceneRecording, SceneSky, SeenFrom,
    camera_json, cameras_from_text, is_scene_file, open_scene,
};
pub use sky_file::SkyKind;
pub use summary::{DefectCounts, Histogram, SplatSummary, SummaryBounds};
pub use tracks::read_tracks;
pub use unfinished::UnfinishedFolder;
