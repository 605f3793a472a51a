//! Scene data: splats, spherical harmonics, poses, cameras, and the rules by which they become an
//! image.
//!
//! Plain data and mathematics; nothing here reads a file or knows a GPU. Units are meters, seconds
//! and radians, frames are right-handed. World: z up. Vehicle and agent: x forward, y left, z up,
//! origin at the center of the bounding box. Camera: OpenCV (x right, y down, z forward). A
//! [`Pose`] is active: `p_parent = R p_child + t`.
#![forbid(unsafe_code)]

mod air;
pub mod bounding_box;
pub mod bounds;
pub mod camera;
pub mod captured_views;
pub mod codebook;
pub mod detail;
pub mod egos;
pub mod episode;
pub mod explain;
mod floaters;
pub mod fog;
pub mod framing;
mod invalid;
pub mod lane_map;
pub mod lens;
pub mod lidar;
pub mod light;
pub mod merge;
pub mod motion;
pub mod obstacle;
pub mod photometry;
pub mod plan;
pub mod pose;
pub mod presence;
pub mod random;
mod release;
pub mod road_user;
pub mod rules;
pub mod scenario;
pub mod sh;
pub mod shape;
pub mod shutter;
pub mod similarity;
pub mod sky;
pub mod splat_scene;
pub mod splats;
pub mod story;
pub mod symmetric;
pub mod track;
pub mod traffic_light;
pub mod traffic_sign;
pub mod trajectory;
pub mod vehicle;

pub use air::{Air, Weather};
pub use bounds::Bounds;
pub use camera::{Camera, Intrinsics, Rig, RigCamera, Sensor};
pub use captured_views::{CapturedView, CapturedViews};
pub use codebook::{CodedCloud, CodedSplat, SplatCodes};
pub use detail::{DetailLevels, DetailNode};
pub use egos::{EgoIdentity, Egos, OtherEgo};
pub use episode::{Episode, EpisodeEnd, EpisodeHead, EpisodeStep};
pub use fog::Fog;
pub use framing::Framing;
pub use invalid::Invalid;
pub use lane_map::{Lane, LaneKind, LaneMap};
pub use lens::{Lens, RayMap};
pub use lidar::{Lidar, LidarModel, LidarSweep, RigLidar};
pub use light::{AmbientDescriptor, ColorTransfer, GroundShadow, LightTransfer};
pub use motion::Motion;
pub use obstacle::{Obstacle, ObstacleKind};
pub use photometry::Photometry;
pub use plan::{Plan, PlanPoint};
pub use pose::Pose;
pub use presence::Presence;
pub use release::release;
pub use road_user::RoadUser;
pub use rules::{DepthOrder, EarlyStop, Rules};
pub use scenario::{Drivers, Level, Pedestrian, Scenario};
pub use shutter::{Shutter, ShutterDirection};
pub use similarity::Similarity;
pub use sky::SkyMap;
pub use splat_scene::{AgentPlacement, ShFrame, SplatScene};
pub use splats::{SplatCloud, SplatDefect};
pub use story::Story;
pub use track::{Track, TrackPoint};
pub use traffic_light::{LightChange, LightColor, LightCourse, LightPhase, StopLine, TrafficLight};
pub use traffic_sign::{SignKind, TrafficSign};
pub use trajectory::{TimedPose, Trajectory};
pub use vehicle::{VehicleSize, VehicleState};
