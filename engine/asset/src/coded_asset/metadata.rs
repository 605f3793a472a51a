//! Conversion between an asset's scalars and the strings of its file's metadata.
//!
//! Numbers are the shortest decimals that read back as the same f32, three of them as a JSON array:
//! `json.loads` reads both.

use std::collections::BTreeMap;
use std::fmt::Debug;

use decouplegs_scene::{Bounds, ShFrame, sh};

use super::container::Container;
use super::{CodedAsset, FORMAT, Provenance, VERSION};
use crate::DecodeError;

/// Prefix of the keys of [`Provenance::settings`].
const SETTINGS: &str = "settings.";

/// The scalars of a coded cloud, read.
pub(super) struct Scalars {
    pub(super) bounds: Bounds,
    pub(super) log2_size_min: f32,
    pub(super) log2_size_step: f32,
    pub(super) dc_residual_step: [f32; 3],
    pub(super) sh_degree: u8,
    pub(super) sh_frame: ShFrame,
    pub(super) dims_m: [f32; 3],
}

/// Refuses files of other formats and versions.
pub(super) fn check_format(container: &Container) -> Result<(), DecodeError> {
    match container.text("format") {
        Ok(FORMAT) => {}
        found => {
            let found = found.map_or_else(|_| "missing".to_owned(), |found| format!("'{found}'"));
            let reason = format!(
                "the metadata's 'format' is {found}, not '{FORMAT}': these tensors are no asset of ours"
            );
            return Err(DecodeError::Malformed(reason));
        }
    }
    match container.text("version")? {
        VERSION => Ok(()),
        found => {
            let reason = format!(
                "version '{found}'; this program reads version {VERSION}: compress the source again"
            );
            Err(DecodeError::Unsupported(reason))
        }
    }
}

/// Reads what the cloud needs beside its tensors.
pub(super) fn read_scalars(container: &Container) -> Result<Scalars, DecodeError> {
    let sh_degree = match container.text("sh_degree")?.parse() {
        Ok(degree @ 0..=sh::DEGREE_MAX) => degree,
        _ => return Err(invalid(container, "sh_degree", "0 to 3")),
    };
    let sh_frame = match container.text("sh_frame")? {
        "canonical" => ShFrame::Canonical,
        "world" => ShFrame::World,
        _ => return Err(invalid(container, "sh_frame", "'canonical' or 'world'")),
    };
    Ok(Scalars {
        bounds: Bounds {
            min: three_numbers(container, "bounds_min_m")?,
            max: three_numbers(container, "bounds_max_m")?,
        },
        log2_size_min: number(container, "log2_size_min")?,
        log2_size_step: number(container, "log2_size_step")?,
        dc_residual_step: three_numbers(container, "dc_residual_step")?,
        sh_degree,
        sh_frame,
        dims_m: three_numbers(container, "dims_m")?,
    })
}

/// Reads where the asset comes from.
pub(super) fn read_provenance(container: &Container) -> Result<Provenance, DecodeError> {
    Ok(Provenance {
        tool_version: container.text("tool_version")?.to_owned(),
        source: container.text("source")?.to_owned(),
        source_sha256: container.text("source_sha256")?.to_owned(),
        settings: container.texts_below(SETTINGS),
    })
}

fn invalid(container: &Container, key: &str, expected: &str) -> DecodeError {
    let found = container.text(key).unwrap_or_default();
    DecodeError::Malformed(format!(
        "the metadata's '{key}' is '{found}'; expected {expected}"
    ))
}

fn number(container: &Container, key: &str) -> Result<f32, DecodeError> {
    container
        .text(key)?
        .parse()
        .map_err(|_| invalid(container, key, "a number"))
}

fn three_numbers(container: &Container, key: &str) -> Result<[f32; 3], DecodeError> {
    let inside = container
        .text(key)?
        .trim()
        .strip_prefix('[')
        .and_then(|text| text.strip_suffix(']'));
    let numbers = inside.and_then(|text| {
        text.split(',')
            .map(|number| number.trim().parse().ok())
            .collect::<Option<Vec<f32>>>()
    });
    let numbers = numbers.and_then(|numbers| <[f32; 3]>::try_from(numbers).ok());
    numbers.ok_or_else(|| invalid(container, key, "an array of three numbers"))
}

/// The metadata of `asset`.
pub(super) fn write(asset: &CodedAsset) -> BTreeMap<String, String> {
    let CodedAsset { cloud, provenance } = asset;
    let exact = |value: &dyn Debug| format!("{value:?}");
    let sh_frame = match cloud.sh_frame {
        ShFrame::Canonical => "canonical",
        ShFrame::World => "world",
    };
    let own = [
        ("format", FORMAT.to_owned()),
        ("version", VERSION.to_owned()),
        ("tool_version", provenance.tool_version.clone()),
        ("source", provenance.source.clone()),
        ("source_sha256", provenance.source_sha256.clone()),
        ("dims_m", exact(&cloud.dims_m)),
        ("bounds_min_m", exact(&cloud.bounds.min)),
        ("bounds_max_m", exact(&cloud.bounds.max)),
        ("log2_size_min", exact(&cloud.log2_size_min)),
        ("log2_size_step", exact(&cloud.log2_size_step)),
        ("dc_residual_step", exact(&cloud.dc_residual_step)),
        ("sh_degree", cloud.sh_degree.to_string()),
        ("sh_frame", sh_frame.to_owned()),
    ];
    let settings = provenance
        .settings
        .iter()
        .map(|(key, value)| (format!("{SETTINGS}{key}"), value.clone()));
    own.into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .chain(settings)
        .collect()
}
