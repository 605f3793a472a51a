//! The container of compressed assets: a [`CodedCloud`] and where it comes from, as one safetensors
//! file.
//!
//! Twelve bytes per splat and two codebooks, readable from Python with the `safetensors` package
//! alone. The format is documented, with an example, in `engine/asset/coded-asset.md`.

pub(crate) mod container;
mod metadata;
mod summary;
mod tensors;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use decouplegs_scene::CodedCloud;
use sha2::{Digest, Sha256};

use crate::error::read_bytes;
use crate::{AssetError, DecodeError, EncodeError, write_atomically};
use container::Container;
use tensors::Arrays;

pub use summary::CodedSummary;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "decouplegs-asset";
/// The version that is written, and the only one there is.
pub const VERSION: &str = "1";

/// Name of the format for users.
pub(crate) const NAME: &str = "coded asset";

/// Coordinates and standard deviations beyond this many meters are refused, so that decoding stays
/// within f32.
const LENGTH_MAX_M: f32 = 1e9;
/// Steps of the DC residual beyond this, which is far beyond any color, are refused for the same
/// reason.
const DC_RESIDUAL_STEP_MAX: f32 = 1e4;

/// An asset as its file holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct CodedAsset {
    /// The splats. Passes [`CodedCloud::check`] if it was read from a file.
    pub cloud: CodedCloud,
    /// Origin of the splats.
    pub provenance: Provenance,
}

/// Origin of an asset and settings of its compression.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Provenance {
    /// Version of the program that wrote it.
    pub tool_version: String,
    /// File name of the splats that were compressed.
    pub source: String,
    /// SHA-256 of that file's bytes, 64 hexadecimal digits; empty where there was no file.
    pub source_sha256: String,
    /// Settings of the compression (kept ratio, seed, ...), open to any key.
    pub settings: BTreeMap<String, String>,
}

impl Provenance {
    /// The provenance of what this version of the program makes of the file called `source` with
    /// the bytes `source_bytes`.
    #[must_use]
    pub fn of_source(source: impl Into<String>, source_bytes: &[u8]) -> Self {
        let source_sha256 =
            Sha256::digest(source_bytes)
                .iter()
                .fold(String::new(), |mut digits, byte| {
                    let _ = write!(digits, "{byte:02x}");
                    digits
                });
        Self {
            tool_version: env!("CARGO_PKG_VERSION").into(),
            source: source.into(),
            source_sha256,
            settings: BTreeMap::new(),
        }
    }
}

/// Rounds `cloud` to what its file holds, so that what is measured is what is stored: colors become
/// half floats. Doing it twice changes nothing, and neither do [`encode`] and [`decode`] after it.
pub fn round_to_stored(cloud: &mut CodedCloud) {
    cloud
        .colors
        .as_flattened_mut()
        .iter_mut()
        .for_each(|color| *color = tensors::stored(*color));
}

/// True if `path` is a coded asset's, by its extension.
#[must_use]
pub fn has_extension(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("safetensors"))
}

/// Reads an asset from the bytes of its file.
///
/// # Errors
/// A [`DecodeError`] that names the tensor or key at fault. Every splat of what is returned can be
/// drawn.
pub fn decode(bytes: &[u8]) -> Result<CodedAsset, DecodeError> {
    let container = Container::read(bytes)?;
    metadata::check_format(&container)?;
    let scalars = metadata::read_scalars(&container)?;
    let provenance = metadata::read_provenance(&container)?;
    let Arrays {
        splats,
        levels,
        shapes,
        colors,
    } = tensors::read(&container, scalars.sh_degree)?;
    let cloud = CodedCloud {
        bounds: scalars.bounds,
        log2_size_min: scalars.log2_size_min,
        log2_size_step: scalars.log2_size_step,
        dc_residual_step: scalars.dc_residual_step,
        splats,
        levels,
        shapes,
        sh_degree: scalars.sh_degree,
        colors,
        sh_frame: scalars.sh_frame,
        dims_m: scalars.dims_m,
    };
    check(&cloud).map_err(DecodeError::Malformed)?;
    Ok(CodedAsset { cloud, provenance })
}

/// The bytes of a file that holds `asset`: the same for the same asset.
///
/// # Errors
/// A sentence, when the cloud does not pass [`CodedCloud::check`], is absurdly large, has a color
/// beyond half floats, or comes with more settings than a header holds.
pub fn encode(asset: &CodedAsset) -> Result<Vec<u8>, EncodeError> {
    let cloud = &asset.cloud;
    check(cloud).map_err(EncodeError)?;
    container::write(&metadata::write(asset), &tensors::write(cloud)?)
}

/// Reads the asset at `path`.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Decode`].
pub fn read_coded(path: &Path) -> Result<CodedAsset, AssetError> {
    read_from(&read_bytes(path)?, path)
}

/// Reads an asset from the bytes of its file at `path`.
pub(crate) fn read_from(bytes: &[u8], path: &Path) -> Result<CodedAsset, AssetError> {
    decode(bytes).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: NAME,
        source,
    })
}

/// Writes `asset` to `path`, atomically.
///
/// # Errors
/// Returns the errors of [`encode`], and an error if the operating system refuses to write.
pub fn write_coded(path: &Path, asset: &CodedAsset) -> Result<(), AssetError> {
    let bytes = encode(asset).map_err(|source| AssetError::Encode {
        path: path.to_owned(),
        format: NAME,
        source,
    })?;
    write_atomically(path, |file| file.write_all(&bytes))
}

/// Checks that `cloud` decodes to splats that can be rendered. Beside the faults that
/// [`CodedCloud::check`] finds: finite numbers whose sums and products are not finite.
fn check(cloud: &CodedCloud) -> Result<(), String> {
    cloud.check()?;
    let (min, max) = (cloud.bounds.min, cloud.bounds.max);
    if (0..3)
        .any(|axis| min[axis] > max[axis] || min[axis] < -LENGTH_MAX_M || max[axis] > LENGTH_MAX_M)
    {
        return Err(format!(
            "the box {min:?} to {max:?}; expected a rising box within {LENGTH_MAX_M:e} m"
        ));
    }
    if cloud
        .dims_m
        .iter()
        .any(|dim_m| !(0.0..=LENGTH_MAX_M).contains(dim_m))
    {
        return Err(format!(
            "dims_m are {:?}; expected lengths up to {LENGTH_MAX_M:e} m",
            cloud.dims_m
        ));
    }
    if cloud
        .dc_residual_step
        .iter()
        .any(|step| step.abs() > DC_RESIDUAL_STEP_MAX)
    {
        return Err(format!(
            "dc_residual_step is {:?}; steps end at {DC_RESIDUAL_STEP_MAX}",
            cloud.dc_residual_step
        ));
    }
    let size_max =
        (f64::from(cloud.log2_size_min) + 255.0 * f64::from(cloud.log2_size_step)).exp2();
    let entry_max = cloud
        .shapes
        .as_flattened()
        .iter()
        .fold(0.0f32, |most, entry| most.max(entry.abs()));
    if size_max * f64::from(entry_max) > f64::from(LENGTH_MAX_M) {
        return Err(format!(
            "shapes up to {entry_max:e} at sizes up to {size_max:e}; splats end at {LENGTH_MAX_M:e} m"
        ));
    }
    Ok(())
}
