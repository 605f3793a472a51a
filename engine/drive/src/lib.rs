//! Motion in a world: lanes and ground, registration of tracks, traffic, the ego vehicle, generated
//! scenarios, scores.
//!
//! Plain mathematics over [`decouplegs_scene`]; nothing here reads a file or knows a GPU. Units are
//! meters, seconds and radians.
#![forbid(unsafe_code)]

pub mod alignment;
mod cells;
pub mod ego;
pub mod generate;
mod grid;
pub mod ground;
pub mod haze;
pub mod lane_index;
pub mod lights;
pub mod obstacles;
pub mod occupancy;
pub mod oriented_box;
pub mod other_egos;
pub mod planar;
pub mod polyline;
mod reference_drive;
pub mod register;
pub mod road_graph;
pub mod road_parts;
pub mod road_surface;
pub mod route;
pub mod scans;
pub mod score;
pub mod signs;
mod story;
pub mod traffic;
pub mod turn_watch;
pub mod view_support;

pub use ego::{Ego, EgoOptions};
pub use ground::{
    Ground, GroundGuides, GroundHeight, GroundOptions, GroundQuality, GroundSource, RecordedWay,
    Survey,
};
pub use lane_index::{LaneIndex, LanePoint};
pub use obstacles::Obstacles;
pub use oriented_box::{OrientedBox, time_to_collision};
pub use planar::PlanarTransform;
pub use polyline::{Foot, Polyline};
pub use register::{
    Outcome, RegisterError, RegisterOptions, RegisteredTrack, Registration, Treatment, register,
};
pub use road_graph::{Conflict, RoadGraph, RoadLane};
pub use road_parts::RoadParts;
pub use road_surface::RoadSurface;
pub use route::{Route, RouteTurn};
pub use score::{EpisodeScore, Summary};
pub use traffic::{LanePosition, Traffic, TrafficError, driver, idm, mobil};
pub use turn_watch::TurnWatch;
pub use view_support::ViewSupport;
