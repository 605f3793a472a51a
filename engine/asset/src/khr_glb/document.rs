//! The JSON of a glTF, as far as splats need it.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::{EXTENSION, EXTENSION_SPZ};
use crate::DecodeError;

/// The top of the document. Everything else in it is passed over.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    #[serde(default)]
    scene: usize,
    #[serde(default)]
    scenes: Vec<Scene>,
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
    #[serde(default)]
    pub(super) meshes: Vec<Mesh>,
    #[serde(default)]
    pub(super) accessors: Vec<Accessor>,
    #[serde(default)]
    pub(super) buffer_views: Vec<BufferView>,
    #[serde(default)]
    pub(super) buffers: Vec<Buffer>,
    #[serde(default)]
    extensions_required: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct Scene {
    #[serde(default)]
    nodes: Vec<usize>,
}

/// A node: a transform, what is below it and what it shows.
#[derive(Debug, Deserialize)]
pub(super) struct Node {
    #[serde(default)]
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    /// Column by column.
    pub(super) matrix: Option<[f64; 16]>,
    #[serde(default)]
    pub(super) translation: [f64; 3],
    /// x, y, z, w.
    #[serde(default = "no_rotation")]
    pub(super) rotation: [f64; 4],
    #[serde(default = "no_scale")]
    pub(super) scale: [f64; 3],
}

fn no_rotation() -> [f64; 4] {
    [0.0, 0.0, 0.0, 1.0]
}

fn no_scale() -> [f64; 3] {
    [1.0; 3]
}

#[derive(Debug, Deserialize)]
pub(super) struct Mesh {
    #[serde(default)]
    pub(super) primitives: Vec<Primitive>,
}

/// One drawing of a mesh.
#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    #[serde(default)]
    pub(super) attributes: BTreeMap<String, usize>,
    #[serde(default)]
    extensions: PrimitiveExtensions,
}

#[derive(Debug, Default, Deserialize)]
struct PrimitiveExtensions {
    #[serde(rename = "KHR_gaussian_splatting")]
    splats: Option<Splats>,
}

/// The extension itself.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Splats {
    #[serde(default)]
    kernel: String,
    #[serde(default)]
    color_space: String,
    #[serde(default)]
    pub(super) extensions: SplatExtensions,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct SplatExtensions {
    #[serde(rename = "KHR_gaussian_splatting_compression_spz_2")]
    pub(super) spz: Option<Spz>,
}

/// An SPZ in a buffer view.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Spz {
    pub(super) buffer_view: usize,
}

/// Numbers in a buffer view.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: u64,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) sparse: Option<serde::de::IgnoredAny>,
}

/// A piece of a buffer.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
}

/// A buffer: the binary chunk, or a file beside this one.
#[derive(Debug, Deserialize)]
pub(super) struct Buffer {
    pub(super) uri: Option<serde::de::IgnoredAny>,
}

impl Document {
    pub(super) fn parse(text: &[u8]) -> Result<Self, DecodeError> {
        let document: Self = serde_json::from_slice(text)
            .map_err(|error| DecodeError::Malformed(format!("the JSON of the glTF: {error}")))?;
        let known = [EXTENSION, EXTENSION_SPZ, "KHR_mesh_quantization"];
        if let Some(other) = document
            .extensions_required
            .iter()
            .find(|name| !known.contains(&name.as_str()))
        {
            let shown: String = other.chars().take(60).collect();
            let message = format!(
                "it requires the extension '{shown}', which is not read; export it without"
            );
            return Err(DecodeError::Unsupported(message));
        }
        Ok(document)
    }

    /// The nodes that the scene begins with: of a file without scenes, those that are below no
    /// other.
    pub(super) fn roots(&self) -> Vec<usize> {
        if let Some(scene) = self.scenes.get(self.scene).or(self.scenes.first()) {
            return scene.nodes.clone();
        }
        let mut is_child = vec![false; self.nodes.len()];
        for child in self.nodes.iter().flat_map(|node| &node.children) {
            if let Some(is_child) = is_child.get_mut(*child) {
                *is_child = true;
            }
        }
        (0..self.nodes.len())
            .filter(|&node| !is_child[node])
            .collect()
    }

    /// Properties of the splats whose meaning differs from the rendered one.
    pub(super) fn notes(&self) -> Vec<String> {
        let splats = || {
            self.meshes
                .iter()
                .flat_map(|mesh| &mesh.primitives)
                .filter_map(Primitive::splats)
        };
        let mut notes = Vec::new();
        if splats().any(|splats| splats.color_space == "lin_rec709_display") {
            notes
                .push("colors are linear light (lin_rec709_display): they are kept as stored, and are drawn too dark".to_owned());
        }
        if splats().any(|splats| !matches!(splats.kernel.as_str(), "" | "ellipse")) {
            notes.push("kernels other than 'ellipse' are drawn as ellipses".to_owned());
        }
        notes
    }
}

impl Primitive {
    /// The extension, where the primitive is of splats.
    pub(super) fn splats(&self) -> Option<&Splats> {
        self.extensions.splats.as_ref()
    }
}
