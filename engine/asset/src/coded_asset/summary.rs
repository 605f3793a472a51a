//! Contents of a compressed asset, for `inspect`.

use std::collections::BTreeMap;

use decouplegs_scene::ShFrame;
use serde::Serialize;

use super::CodedAsset;
use crate::SplatSummary;

/// Contents of a compressed asset.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CodedSummary {
    /// Splats of each level of detail, the finest first.
    pub levels: Vec<u64>,
    /// Entries of the shape codebook.
    pub shapes: u64,
    /// Entries of the color codebook.
    pub colors: u64,
    /// Length, width and height of what it shows, meters.
    pub dims_m: [f32; 3],
    /// Frame of the colors: `canonical` or `world`.
    pub sh_frame: &'static str,
    /// Meters from one place of the position grid to the next.
    pub position_step_m: [f32; 3],
    /// Bytes of its file.
    pub file_bytes: u64,
    /// Bytes of its file, codebooks and header included, for each splat of any level; none without
    /// splats.
    pub bytes_per_splat: Option<f64>,
    /// Version of the program that wrote it.
    pub tool_version: String,
    /// File name of the splats that were compressed.
    pub source: String,
    /// SHA-256 of that file's bytes.
    pub source_sha256: String,
    /// Settings of the compression.
    pub settings: BTreeMap<String, String>,
    /// The finest level, as it is drawn.
    #[serde(flatten)]
    pub finest: SplatSummary,
}

impl CodedSummary {
    /// Describes `asset`, whose file has `file_bytes`.
    ///
    /// # Panics
    /// Panics if the cloud does not pass its check.
    #[must_use]
    pub fn new(asset: &CodedAsset, file_bytes: u64) -> Self {
        let CodedAsset { cloud, provenance } = asset;
        let splats = cloud.splats.len();
        Self {
            levels: cloud.levels.iter().map(|&level| level as u64).collect(),
            shapes: cloud.shapes.len() as u64,
            colors: cloud.color_count() as u64,
            dims_m: cloud.dims_m,
            sh_frame: match cloud.sh_frame {
                ShFrame::Canonical => "canonical",
                ShFrame::World => "world",
            },
            position_step_m: cloud.position_step_m(),
            file_bytes,
            bytes_per_splat: (splats > 0).then(|| file_bytes as f64 / splats as f64),
            tool_version: provenance.tool_version.clone(),
            source: provenance.source.clone(),
            source_sha256: provenance.source_sha256.clone(),
            settings: provenance.settings.clone(),
            finest: SplatSummary::new(&cloud.decoded(0)),
        }
    }
}
