//! The container of light transfers: Theta and where it comes from, as one safetensors file.
//!
//! Tensors, K coefficients of three channels: `gain_weights` and `offset_weights` f32 \[3K, 27\],
//! `gain_constants` and `offset_constants` f32 \[3K\], rows in the order `[coefficient][rgb]`;
//! `neutral` f32 \[9, 3\], the descriptor of the light that shows colors as they are. Version 2
//! adds what the calibration knows of its errors (`TransferConfidence`): `effect` f32 \[3K, 3\],
//! `residual` f32 \[K\], `light_mean` f32 \[27\] and `light_precision` f32 \[27, 27\]. Metadata:
//! `format`, `version`, `sh_degree` (K is its coefficients), `tool_version`, `sources.NAME`
//! (SHA-256 of each asset and probe) and `settings.KEY`.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

use decouplegs_scene::light::TransferConfidence;
use decouplegs_scene::{AmbientDescriptor, LightTransfer, sh};
use safetensors::Dtype;

use crate::coded_asset::container::{self, Container, Tensor};
use crate::error::read_bytes;
use crate::{AssetError, DecodeError, EncodeError, write_atomically};

/// Value of `format` in the metadata.
pub const FORMAT: &str = "decouplegs-light-transfer";
/// The version that is written for a transfer with a confidence.
pub const VERSION: &str = "2";
/// The version that is written for a transfer without one.
pub const VERSION_PLAIN: &str = "1";

/// Name of the format for users.
const NAME: &str = "light transfer";

/// Weights beyond this are refused: colors they make of any light would leave what f32 holds.
const WEIGHT_MAX: f32 = 1e6;

const SOURCES: &str = "sources.";
const SETTINGS: &str = "settings.";
/// Tensors in the order in which they lie in the file.
const NAMES: [&str; 9] = [
    "gain_weights",
    "gain_constants",
    "offset_weights",
    "offset_constants",
    "neutral",
    "effect",
    "residual",
    "light_mean",
    "light_precision",
];

/// Number of [`NAMES`] in a file without a confidence.
const NAMES_PLAIN: usize = 5;

type Row = ([f32; AmbientDescriptor::LEN], f32);

/// A light transfer as its file holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct LightTransferFile {
    /// Theta. Passes [`LightTransfer::check`] if it was read from a file.
    pub transfer: LightTransfer,
    /// Version of the program that wrote it.
    pub tool_version: String,
    /// SHA-256, 64 hexadecimal digits, of each asset and probe it was calibrated with, by file
    /// name.
    pub sources: BTreeMap<String, String>,
    /// Settings of the calibration (ridge, seed, ...), open to any key.
    pub settings: BTreeMap<String, String>,
}

/// Reads a light transfer from the bytes of its file.
///
/// # Errors
/// A [`DecodeError`] that names the tensor or key at fault.
pub fn decode(bytes: &[u8]) -> Result<LightTransferFile, DecodeError> {
    let container = Container::read(bytes)?;
    let format = container.text("format")?;
    if format != FORMAT {
        let reason = format!(
            "the metadata's 'format' is '{format}', not '{FORMAT}': these tensors are no light transfer"
        );
        return Err(DecodeError::Malformed(reason));
    }
    let version = container.text("version")?;
    if version != VERSION && version != VERSION_PLAIN {
        let reason = format!(
            "version '{version}'; this program reads versions {VERSION_PLAIN} and {VERSION}: calibrate again"
        );
        return Err(DecodeError::Unsupported(reason));
    }
    let is_plain = version == VERSION_PLAIN;
    let sh_degree = match container.text("sh_degree")?.parse() {
        Ok(degree @ 0..=sh::DEGREE_MAX) => degree,
        _ => {
            return Err(DecodeError::Malformed(
                "the metadata's 'sh_degree' is not 0 to 3".into(),
            ));
        }
    };
    container.check_names(&NAMES[..if is_plain { NAMES_PLAIN } else { NAMES.len() }])?;
    let rows = 3 * sh::coefficient_count(sh_degree);
    let [
        gain_weights,
        gain_constants,
        offset_weights,
        offset_constants,
        neutral,
        ..,
    ] = NAMES;
    let neutral = numbers(&container, neutral, AmbientDescriptor::COEFFICIENTS, &[3])?;
    let transfer = LightTransfer {
        sh_degree,
        gain: read_rows(&container, gain_weights, gain_constants, rows)?,
        offset: read_rows(&container, offset_weights, offset_constants, rows)?,
        neutral: AmbientDescriptor {
            coefficients: std::array::from_fn(|k| std::array::from_fn(|rgb| neutral[3 * k + rgb])),
        },
        confidence: (!is_plain)
            .then(|| read_confidence(&container, rows))
            .transpose()?,
    };
    check(&transfer).map_err(DecodeError::Malformed)?;
    Ok(LightTransferFile {
        transfer,
        tool_version: container.text("tool_version")?.to_owned(),
        sources: container.texts_below(SOURCES),
        settings: container.texts_below(SETTINGS),
    })
}

/// The bytes of a file that holds `file`: the same for the same transfer.
///
/// # Errors
/// A sentence, when the transfer does not pass [`LightTransfer::check`] or has absurd weights.
pub fn encode(file: &LightTransferFile) -> Result<Vec<u8>, EncodeError> {
    let transfer = &file.transfer;
    check(transfer).map_err(EncodeError)?;
    let version = match transfer.confidence {
        Some(_) => VERSION,
        None => VERSION_PLAIN,
    };
    let own = [
        ("format", FORMAT.to_owned()),
        ("version", version.to_owned()),
        ("tool_version", file.tool_version.clone()),
        ("sh_degree", transfer.sh_degree.to_string()),
    ];
    let below = |prefix: &'static str, texts: &BTreeMap<String, String>| -> Vec<(String, String)> {
        texts
            .iter()
            .map(|(key, value)| (format!("{prefix}{key}"), value.clone()))
            .collect()
    };
    let own = own.into_iter().map(|(key, value)| (key.to_owned(), value));
    let metadata = own
        .chain(below(SOURCES, &file.sources))
        .chain(below(SETTINGS, &file.settings))
        .collect();
    let rows = transfer.gain.len();
    let tensor = |name: usize, shape: Vec<usize>, values: Vec<f32>| Tensor {
        name: NAMES[name],
        dtype: Dtype::F32,
        shape,
        bytes: values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
    };
    let weights = |rows: &[Row]| rows.iter().flat_map(|(weights, _)| *weights).collect();
    let constants = |rows: &[Row]| rows.iter().map(|(_, constant)| *constant).collect();
    let mut tensors = vec![
        tensor(
            0,
            vec![rows, AmbientDescriptor::LEN],
            weights(&transfer.gain),
        ),
        tensor(1, vec![rows], constants(&transfer.gain)),
        tensor(
            2,
            vec![rows, AmbientDescriptor::LEN],
            weights(&transfer.offset),
        ),
        tensor(3, vec![rows], constants(&transfer.offset)),
        tensor(
            4,
            vec![AmbientDescriptor::COEFFICIENTS, 3],
            transfer.neutral.coefficients.as_flattened().to_vec(),
        ),
    ];
    if let Some(confidence) = &transfer.confidence {
        let precision = confidence.light_precision.as_flattened().to_vec();
        tensors.extend([
            tensor(5, vec![rows, 3], confidence.effect.as_flattened().to_vec()),
            tensor(6, vec![rows / 3], confidence.residual.clone()),
            tensor(
                7,
                vec![AmbientDescriptor::LEN],
                confidence.light_mean.to_vec(),
            ),
            tensor(8, vec![AmbientDescriptor::LEN; 2], precision),
        ]);
    }
    container::write(&metadata, &tensors)
}

/// Reads the light transfer at `path`.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Decode`].
pub fn read_light_transfer(path: &Path) -> Result<LightTransferFile, AssetError> {
    read_from(&read_bytes(path)?, path)
}

/// Reads a transfer from the bytes of its file at `path`.
pub(crate) fn read_from(bytes: &[u8], path: &Path) -> Result<LightTransferFile, AssetError> {
    decode(bytes).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: NAME,
        source,
    })
}

/// Writes `file` to `path`, atomically.
///
/// # Errors
/// Returns the errors of [`encode`], and an error if the operating system refuses to write.
pub fn write_light_transfer(path: &Path, file: &LightTransferFile) -> Result<(), AssetError> {
    let bytes = encode(file).map_err(|source| AssetError::Encode {
        path: path.to_owned(),
        format: NAME,
        source,
    })?;
    write_atomically(path, |file| file.write_all(&bytes))
}

fn check(transfer: &LightTransfer) -> Result<(), String> {
    transfer.check()?;
    let rows = transfer
        .gain
        .iter()
        .chain(&transfer.offset)
        .flat_map(|(weights, constant)| weights.iter().chain([constant]));
    match rows
        .chain(transfer.neutral.coefficients.as_flattened())
        .find(|value| value.abs() > WEIGHT_MAX)
    {
        Some(value) => Err(format!(
            "a weight of {value:e}; weights end at {WEIGHT_MAX:e}"
        )),
        None => Ok(()),
    }
}

/// The f32 of a tensor of exactly `rows` rows.
fn numbers(
    container: &Container,
    name: &str,
    rows: usize,
    columns: &[usize],
) -> Result<Vec<f32>, DecodeError> {
    let (bytes, found) = container.rows(name, Dtype::F32, columns)?;
    if found != rows {
        return Err(DecodeError::Malformed(format!(
            "tensor '{name}' has {found} rows; expected {rows}"
        )));
    }
    Ok(bytes
        .as_chunks::<4>()
        .0
        .iter()
        .map(|&word| f32::from_le_bytes(word))
        .collect())
}

fn read_confidence(container: &Container, rows: usize) -> Result<TransferConfidence, DecodeError> {
    const LEN: usize = AmbientDescriptor::LEN;
    let [.., effect, residual, light_mean, light_precision] = NAMES;
    let effect = numbers(container, effect, rows, &[3])?;
    let light_mean = numbers(container, light_mean, LEN, &[])?;
    let precision = numbers(container, light_precision, LEN, &[LEN])?;
    Ok(TransferConfidence {
        effect: effect.as_chunks().0.to_vec(),
        residual: numbers(container, residual, rows / 3, &[])?,
        light_mean: std::array::from_fn(|index| light_mean[index]),
        light_precision: precision.as_chunks().0.to_vec(),
    })
}

fn read_rows(
    container: &Container,
    weights: &str,
    constants: &str,
    rows: usize,
) -> Result<Vec<Row>, DecodeError> {
    let weights = numbers(container, weights, rows, &[AmbientDescriptor::LEN])?;
    let constants = numbers(container, constants, rows, &[])?;
    Ok(weights
        .as_chunks::<{ AmbientDescriptor::LEN }>()
        .0
        .iter()
        .copied()
        .zip(constants)
        .collect())
}
