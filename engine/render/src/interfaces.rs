//! Interfaces of the kernels, a module each with its `Bindings`, `Push` and `Constants`. `make
//! shaders` writes them, and compares the structures in buffers with those of [`crate::layout`].

// Names of structures in the shaders.
use crate::layout::{
    AgentRecord as Agent, BeamEchoes, BeamRecord as LidarBeam, BeamState, BlendItem, Bucket,
    CameraRecord as Camera, ClusterRecord as Cluster, Composite, EchoRecord as Echo,
    FiringRecord as Firing, LensRecord as Lens, MergePiece, NodeRecord as DetailNode, PartialTiles,
    RelightRecord as Relight, RequiredCounts, SectorRecord as Sector, ShadingRecord as Shading,
    ShadowRecord as Shadow, ViewLists,
};
use crate::post_processing::PhotometryRecord as Photometry;

#[rustfmt::skip]
#[path = "../../../shaders/interfaces/mod.rs"]
mod written;

pub use written::*;
