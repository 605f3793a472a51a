//! Writes splats as binary glTF.

use std::io::Write;
use std::path::Path;

use decouplegs_scene::SplatCloud;
use serde_json::{Map, Value, json};

use super::{CHUNK_BINARY, CHUNK_JSON, EXTENSION, HALF_TURN, HEADER_BYTES, NAME};
use crate::spz::flip;
use crate::{AssetError, EncodeError, write_atomically};

/// glTF's code of 32-bit floats.
const FLOAT: u32 = 5126;

/// The binary chunk as it grows, and what its pieces are.
#[derive(Default)]
struct Pieces {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    attributes: Map<String, Value>,
}

impl Pieces {
    /// Adds an attribute of `N` floats per splat.
    fn add<const N: usize>(&mut self, name: &str, rows: impl Iterator<Item = [f32; N]>) {
        let start = self.bytes.len();
        let mut count = 0;
        let (mut min, mut max) = ([f32::INFINITY; N], [f32::NEG_INFINITY; N]);
        for row in rows {
            self.bytes
                .extend(row.iter().flat_map(|value| value.to_le_bytes()));
            min = std::array::from_fn(|i| min[i].min(row[i]));
            max = std::array::from_fn(|i| max[i].max(row[i]));
            count += 1;
        }
        let kind = match N {
            1 => "SCALAR",
            3 => "VEC3",
            _ => "VEC4",
        };
        let mut accessor = json!({"bufferView": self.views.len(), "componentType": FLOAT, "count": count, "type": kind});
        // glTF wants the extent of positions.
        if name == "POSITION" {
            accessor["min"] = json!(min.as_slice());
            accessor["max"] = json!(max.as_slice());
        }
        self.attributes
            .insert(name.to_owned(), json!(self.accessors.len()));
        self.accessors.push(accessor);
        self.views.push(
            json!({"buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start}),
        );
    }
}

/// `cloud` as the bytes of a file, all in 32-bit floats: nothing is lost but what exceeds the
/// format (below).
///
/// # Errors
/// Returns an error if a splat is defective ([`SplatCloud::defect_of`]), when there is none, or
/// when the file would exceed 4 GiB.
pub fn encode(cloud: &SplatCloud) -> Result<Vec<u8>, EncodeError> {
    if cloud.is_empty() {
        return Err(EncodeError(
            "there is no splat to write; glTF has no empty accessors".into(),
        ));
    }
    if let Some(first) = (0..cloud.len()).find(|&splat| cloud.defect_of(splat).is_some()) {
        return Err(EncodeError(format!(
            "splat {first} is not finite or has no rotation; drop such splats before writing"
        )));
    }
    let mut turned = cloud.clone();
    flip(&mut turned, HALF_TURN);
    let cloud = &turned;
    let mut pieces = Pieces::default();
    let named = |name: &str| format!("{EXTENSION}:{name}");
    pieces.add("POSITION", cloud.means.iter().copied());
    pieces.add(
        &named("ROTATION"),
        cloud.rotations.iter().map(|&[w, x, y, z]| [x, y, z, w]),
    );
    pieces.add(&named("SCALE"), cloud.scales.iter().copied());
    pieces.add(
        &named("OPACITY"),
        cloud.opacities.iter().map(|&opacity| [opacity]),
    );
    pieces.add(&named("SH_DEGREE_0_COEF_0"), cloud.sh_dc.iter().copied());
    let coefficients = (1..=cloud.sh_degree).flat_map(|l| (0..2 * l + 1).map(move |n| (l, n)));
    for (k, (l, n)) in coefficients.enumerate() {
        let values = (0..cloud.len()).map(|splat| cloud.rest_of(splat)[k]);
        pieces.add(&named(&format!("SH_DEGREE_{l}_COEF_{n}")), values);
    }
    assemble(pieces)
}

/// Writes `cloud` to `path`, atomically.
///
/// # Errors
/// Returns the errors of [`encode`], and an error if the operating system refuses to write.
pub fn write(path: &Path, cloud: &SplatCloud) -> Result<(), AssetError> {
    let bytes = encode(cloud).map_err(|source| AssetError::Encode {
        path: path.to_owned(),
        format: NAME,
        source,
    })?;
    write_atomically(path, |file| file.write_all(&bytes))
}

fn assemble(mut pieces: Pieces) -> Result<Vec<u8>, EncodeError> {
    pieces
        .bytes
        .resize(pieces.bytes.len().next_multiple_of(4), 0);
    let mut extension = Map::new();
    extension.insert(
        EXTENSION.to_owned(),
        json!({"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}),
    );
    let document = json!({
        "asset": {"version": "2.0", "generator": concat!("decouplegs ", env!("CARGO_PKG_VERSION"))},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": pieces.attributes, "mode": 0, "extensions": extension}]}],
        "buffers": [{"byteLength": pieces.bytes.len()}],
        "bufferViews": pieces.views,
        "accessors": pieces.accessors,
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = HEADER_BYTES + 8 + text.len() + 8 + pieces.bytes.len();
    let length = u32::try_from(length)
        .map_err(|_| EncodeError(format!("{length} bytes; a .glb has at most 4294967295")))?;
    let mut file = Vec::with_capacity(length as usize);
    file.extend_from_slice(b"glTF");
    file.extend([2, length].into_iter().flat_map(u32::to_le_bytes));
    for (kind, content) in [(CHUNK_JSON, &text), (CHUNK_BINARY, &pieces.bytes)] {
        file.extend(
            [content.len() as u32, kind]
                .into_iter()
                .flat_map(u32::to_le_bytes),
        );
        file.extend_from_slice(content);
    }
    Ok(file)
}
