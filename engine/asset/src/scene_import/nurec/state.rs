//! Arrays of a volume, out of `volume.nurec` or of `checkpoint.ckpt`.

use std::collections::HashMap;
use std::io::Read;

use flate2::read::MultiGzDecoder;
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use super::value::{self, Value};
use crate::DecodeError;
use crate::checkpoint::{Checkpoint, Node};

/// Prefix of the keys of all layers.
pub(super) const LAYERS: &str = "gaussians_nodes.";

/// Bytes that a volume may unpack to however small it is.
const UNPACKED_BYTES_ALWAYS: u64 = 64 << 20;
/// Further bytes for each byte of its gzip. Colors without view dependence are 45 zeros of 71
/// numbers, and numbers of 16 bits hardly shrink.
const UNPACKED_BYTES_PER_BYTE: u64 = 16;

/// Numbers of an array.
#[derive(Clone, Debug, PartialEq)]
enum Numbers<'a> {
    /// Little-endian floats of 16 bits.
    Halves(&'a [u8]),
    Floats(Vec<f32>),
}

/// A tensor of a volume.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Array<'a> {
    shape: Vec<usize>,
    numbers: Numbers<'a>,
}

impl Array<'_> {
    pub(super) fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The rows `[N, width]` of an array, whose other dimensions are 1 or missing.
    ///
    /// # Errors
    /// A sentence with the shape that is there.
    pub(super) fn rows<const N: usize>(&self, name: &str) -> Result<Vec<[f32; N]>, DecodeError> {
        let count = self.shape.first().copied().unwrap_or(0);
        let width: usize = self.shape.iter().skip(1).product();
        if self.shape.is_empty() || width != N {
            return Err(DecodeError::Malformed(format!(
                "'{name}' has the shape {:?}, expected [splats, {N}]",
                self.shape
            )));
        }
        Ok(self.columns(count, width, 0))
    }

    /// `N` numbers of each of `count` rows of `width`, from the column `first` on.
    pub(super) fn columns<const N: usize>(
        &self,
        count: usize,
        width: usize,
        first: usize,
    ) -> Vec<[f32; N]> {
        let row = |row: usize| std::array::from_fn(|column| self.at(row * width + first + column));
        (0..count).into_par_iter().map(row).collect()
    }

    /// Copies the numbers from the one at `first` on, as many as `numbers` holds.
    pub(super) fn copy_to(&self, first: usize, numbers: &mut [f32]) {
        let halves = match &self.numbers {
            Numbers::Halves(bytes) => &bytes[2 * first..][..2 * numbers.len()],
            Numbers::Floats(values) => {
                numbers.copy_from_slice(&values[first..][..numbers.len()]);
                return;
            }
        };
        // Many at once: one by one, each is a call that asks what the processor can do.
        let mut aligned = [f16::ZERO; 8];
        for (bytes, numbers) in halves.chunks(16).zip(numbers.chunks_mut(8)) {
            let aligned = &mut aligned[..numbers.len()];
            for (half, bytes) in aligned.iter_mut().zip(bytes.chunks_exact(2)) {
                *half = f16::from_le_bytes([bytes[0], bytes[1]]);
            }
            aligned.convert_to_f32_slice(numbers);
        }
    }

    /// The number `index`, counted in the order of the file.
    pub(super) fn at(&self, index: usize) -> f32 {
        match &self.numbers {
            Numbers::Halves(bytes) => {
                f16::from_le_bytes([bytes[2 * index], bytes[2 * index + 1]]).to_f32()
            }
            Numbers::Floats(values) => values[index],
        }
    }

    pub(super) fn len(&self) -> usize {
        match &self.numbers {
            Numbers::Halves(bytes) => bytes.len() / 2,
            Numbers::Floats(values) => values.len(),
        }
    }
}

/// Settings of a layer that decide what its numbers mean. `None` where the volume does not say.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct LayerSettings {
    pub(super) density_activation: Option<String>,
    pub(super) scale_activation: Option<String>,
    pub(super) rotation_activation: Option<String>,
    /// Exponent of the kernel: 2 is a Gaussian.
    pub(super) kernel_degree: Option<f64>,
}

/// Arrays and settings of a volume.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct State<'a> {
    /// Version of the program that wrote it; empty where the file does not say.
    pub(super) version: String,
    /// Arrays by their names, without what stands before [`LAYERS`].
    arrays: HashMap<String, Array<'a>>,
    /// Names of the tracks of each layer.
    tracks: HashMap<String, Vec<String>>,
    settings: HashMap<String, LayerSettings>,
}

/// Bytes of a `volume.nurec` without their gzip.
///
/// # Errors
/// A sentence on what is broken or too large.
pub(super) fn unpack(bytes: &[u8]) -> Result<Vec<u8>, DecodeError> {
    let most = UNPACKED_BYTES_ALWAYS + UNPACKED_BYTES_PER_BYTE * bytes.len() as u64;
    let mut unpacked = Vec::new();
    let mut decoder = MultiGzDecoder::new(bytes).take(most);
    let read = decoder.read_to_end(&mut unpacked);
    if decoder.limit() == 0 {
        return Err(DecodeError::Malformed(format!(
            "volume.nurec unpacks to more than {most} bytes from {}; write it again",
            bytes.len()
        )));
    }
    read.map_err(|error| {
        DecodeError::Malformed(format!("volume.nurec is no MessagePack in gzip: {error}"))
    })?;
    Ok(unpacked)
}

impl<'a> State<'a> {
    /// Reads the bytes of a volume that [`unpack`] gave.
    ///
    /// # Errors
    /// A sentence on what is broken or missing.
    pub(super) fn from_volume(unpacked: &'a [u8]) -> Result<Self, DecodeError> {
        let root = value::read(unpacked)?;
        let data = root.get("nre_data").ok_or_else(|| {
            DecodeError::Malformed("volume.nurec has no 'nre_data', which holds a volume".into())
        })?;
        let version = data.get("version").and_then(Value::text).unwrap_or("");
        let mut state = Self {
            version: version.to_owned(),
            settings: settings_of(data),
            ..Self::default()
        };
        let Value::Map(mut root) = root else {
            return Ok(state);
        };
        let data = root.drain(..).find(|(key, _)| key == "nre_data");
        let Some((_, Value::Map(data))) = data else {
            return Err(DecodeError::Malformed("'nre_data' is no map".into()));
        };
        let pairs = data.into_iter().find(|(key, _)| key == "state_dict");
        let Some((_, Value::Map(pairs))) = pairs else {
            return Err(DecodeError::Malformed(
                "volume.nurec has no 'state_dict', which holds its arrays".into(),
            ));
        };
        state.take_pairs(pairs)?;
        Ok(state)
    }

    /// Takes the arrays of a state dictionary, whose shapes are values of their own.
    fn take_pairs(&mut self, pairs: Vec<(String, Value<'a>)>) -> Result<(), DecodeError> {
        let mut shapes: HashMap<String, Vec<usize>> = HashMap::new();
        let mut contents = Vec::new();
        for (key, value) in pairs {
            if let Some(name) = key.strip_suffix(".shape") {
                let shape = value.sizes().ok_or_else(|| {
                    DecodeError::Malformed(format!("'{key}' is no list of sizes"))
                })?;
                shapes.insert(plain(name).to_owned(), shape);
            } else if key == "_extra_state" || key.ends_with("._extra_state") {
                self.take_tracks(&value);
            } else if let Value::Bytes(bytes) = value {
                contents.push((plain(&key).to_owned(), bytes));
            }
        }
        for (name, bytes) in contents {
            let shape = shapes
                .remove(&name)
                .ok_or_else(|| DecodeError::Malformed(format!("'{name}' has no '{name}.shape'")))?;
            let array = array_of(&name, shape, bytes)?;
            self.arrays.insert(name, array);
        }
        Ok(())
    }

    fn take_tracks(&mut self, state: &Value<'_>) {
        let Some(Value::Map(layers)) = state.get("obj_track_ids") else {
            return;
        };
        for (layer, ids) in layers {
            let Value::List(ids) = ids else {
                continue;
            };
            let text = |id: &Value| match id {
                Value::Integer(id) => id.to_string(),
                id => id.text().unwrap_or("").to_owned(),
            };
            let names = ids.iter().map(text).collect();
            self.tracks.insert(layer.clone(), names);
        }
    }

    /// Reads `checkpoint.ckpt`: the same names behind `model.`.
    ///
    /// # Errors
    /// A [`DecodeError`] that names the tensor at fault.
    pub(super) fn from_checkpoint(bytes: &[u8]) -> Result<Self, DecodeError> {
        let checkpoint = Checkpoint::parse(bytes)?;
        let tree = &checkpoint.tree;
        let root = tree.root();
        let pairs = tree.get(root, "state_dict").unwrap_or(root);
        let mut state = Self::default();
        let names: Vec<String> = tree.keys(pairs).map(str::to_owned).collect();
        for key in names {
            let Some(node) = tree.get(pairs, &key) else {
                continue;
            };
            let name = plain(&key);
            if name == "_extra_state" {
                let layers = tree.get(node, "obj_track_ids");
                for layer in layers.into_iter().flat_map(|layers| tree.keys(layers)) {
                    let ids = layers.and_then(|layers| tree.get(layers, layer));
                    let ids = ids.into_iter().flat_map(|ids| tree.items(ids));
                    let text = |id: &Node| match id {
                        Node::Text(id) => id.to_string(),
                        Node::Int(id) => id.to_string(),
                        _ => String::new(),
                    };
                    state
                        .tracks
                        .insert(layer.to_owned(), ids.map(text).collect());
                }
            } else if matches!(node, Node::Tensor(_)) {
                let tensor = checkpoint.tensor(node, &key)?;
                let array = Array {
                    shape: tensor.shape().to_vec(),
                    numbers: Numbers::Floats(tensor.f32s().collect()),
                };
                state.arrays.insert(name.to_owned(), array);
            }
        }
        Ok(state)
    }

    /// Names of the layers, in order.
    pub(super) fn layers(&self) -> Vec<String> {
        let names = self.arrays.keys();
        let names = names.filter_map(|name| name.strip_prefix(LAYERS)?.strip_suffix(".positions"));
        let mut names: Vec<String> = names.map(str::to_owned).collect();
        names.sort();
        names
    }

    /// The array of that name, if there is one.
    pub(super) fn get(&self, name: &str) -> Option<&Array<'a>> {
        self.arrays.get(name)
    }

    /// Names of all arrays.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.arrays.keys().map(String::as_str)
    }

    /// The array `name` of `layer`.
    ///
    /// # Errors
    /// A sentence, if there is none.
    pub(super) fn of_layer(&self, layer: &str, name: &str) -> Result<&Array<'a>, DecodeError> {
        let name = format!("{LAYERS}{layer}.{name}");
        self.get(&name)
            .ok_or_else(|| DecodeError::Malformed(format!("the volume has no '{name}'")))
    }

    /// Names of the tracks of `layer`; none where it has no tracks.
    pub(super) fn tracks_of(&self, layer: &str) -> &[String] {
        self.tracks.get(layer).map_or(&[], Vec::as_slice)
    }

    /// Settings of `layer`.
    pub(super) fn settings_of(&self, layer: &str) -> LayerSettings {
        self.settings.get(layer).cloned().unwrap_or_default()
    }
}

/// A key without the names of models before it: `model.gaussians_nodes.` and `.gaussians_nodes.`
/// are one.
fn plain(key: &str) -> &str {
    let key = key.strip_prefix("model").unwrap_or(key);
    key.trim_start_matches('.')
}

/// The array of `shape` in `bytes`, whose kind of numbers its name tells.
fn array_of<'a>(name: &str, shape: Vec<usize>, bytes: &'a [u8]) -> Result<Array<'a>, DecodeError> {
    let count = shape
        .iter()
        .try_fold(1usize, |count, size| count.checked_mul(*size));
    let width = if name.ends_with("_cuboid_ids") {
        4
    } else if name.ends_with("_ranges") || name.ends_with("n_active_features") {
        8
    } else {
        2
    };
    let expected = count.and_then(|count| count.checked_mul(width));
    if expected != Some(bytes.len()) {
        return Err(DecodeError::Malformed(format!(
            "'{name}' has {} bytes; its shape {shape:?} wants numbers of {width} bytes",
            bytes.len()
        )));
    }
    let floats = |read: fn(&[u8]) -> f32| {
        let values = bytes.chunks_exact(width).map(read).collect();
        Numbers::Floats(values)
    };
    let four = |bytes: &[u8]| i32::from_le_bytes(std::array::from_fn(|place| bytes[place])) as f32;
    let eight = |bytes: &[u8]| i64::from_le_bytes(std::array::from_fn(|place| bytes[place])) as f32;
    let numbers = match width {
        4 => floats(four),
        8 => floats(eight),
        _ => Numbers::Halves(bytes),
    };
    Ok(Array { shape, numbers })
}

fn settings_of(data: &Value<'_>) -> HashMap<String, LayerSettings> {
    let layers = data.get("config").and_then(|config| config.get("layers"));
    let Some(Value::Map(layers)) = layers else {
        return HashMap::new();
    };
    let of_layer = |(name, layer): &(String, Value<'_>)| {
        let word = |key: &str| layer.get(key).and_then(Value::text).map(str::to_owned);
        let particle = layer.get("particle");
        let degree = particle.and_then(|particle| particle.get("density_kernel_degree"));
        let settings = LayerSettings {
            density_activation: word("density_activation"),
            scale_activation: word("scale_activation"),
            rotation_activation: word("rotation_activation"),
            kernel_degree: degree.and_then(Value::number),
        };
        (name.clone(), settings)
    };
    layers.iter().map(of_layer).collect()
}
