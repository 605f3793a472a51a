//! The frame of a safetensors file: eight bytes of length, a JSON header, the tensors one behind
//! the other.
//!
//! The header is parsed and checked by the `safetensors` crate. The frame around it is read here
//! because the crate adds the sizes that a file claims without a check (a debug build panics), and
//! written here because the crate orders metadata by a random hash: the same asset must give the
//! same bytes.

use std::collections::BTreeMap;

use safetensors::Dtype;
use safetensors::tensor::{Metadata, TensorInfo};
use serde::Serialize;

use crate::{DecodeError, EncodeError};

const LENGTH_BYTES: usize = 8;
/// A header of ours has some two kilobytes. Parsing JSON takes a multiple of its length, so this
/// bounds what a file takes.
const HEADER_BYTES_MAX: usize = 1 << 20;

/// A file taken apart.
pub(crate) struct Container<'a> {
    header: Metadata,
    data: &'a [u8],
}

/// A tensor to be written.
pub(crate) struct Tensor {
    pub(crate) name: &'static str,
    pub(crate) dtype: Dtype,
    pub(crate) shape: Vec<usize>,
    /// Little endian, row-major.
    pub(crate) bytes: Vec<u8>,
}

impl<'a> Container<'a> {
    /// Finds the tensors in `bytes`, which they fill to the end.
    pub(crate) fn read(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let truncated = |what: &str, expected_bytes: u64, found: usize| DecodeError::Truncated {
            what: what.to_owned(),
            expected_bytes,
            found_bytes: found as u64,
        };
        let Some((length, rest)) = bytes.split_first_chunk::<LENGTH_BYTES>() else {
            return Err(truncated(
                "the length of the header",
                LENGTH_BYTES as u64,
                bytes.len(),
            ));
        };
        let header_bytes = u64::from_le_bytes(*length);
        if header_bytes > HEADER_BYTES_MAX as u64 {
            let reason = format!(
                "a header of {header_bytes} bytes; at most {HEADER_BYTES_MAX} are read: this is no file of ours"
            );
            return Err(DecodeError::Malformed(reason));
        }
        let Some((header, data)) = rest.split_at_checked(header_bytes as usize) else {
            return Err(truncated("the header", header_bytes, rest.len()));
        };
        let header: Metadata = serde_json::from_slice(header)
            .map_err(|error| DecodeError::Malformed(format!("the header: {error}")))?;
        if header.data_len() > data.len() {
            return Err(truncated(
                "the tensors",
                header.data_len() as u64,
                data.len(),
            ));
        }
        if header.data_len() < data.len() {
            let reason = format!(
                "{} bytes follow the last tensor",
                data.len() - header.data_len()
            );
            return Err(DecodeError::Malformed(reason));
        }
        Ok(Self { header, data })
    }

    /// One string of the metadata.
    pub(crate) fn text(&self, key: &str) -> Result<&str, DecodeError> {
        let found = self
            .header
            .metadata()
            .as_ref()
            .and_then(|metadata| metadata.get(key));
        found
            .map(String::as_str)
            .ok_or_else(|| DecodeError::Malformed(format!("the metadata have no '{key}'")))
    }

    /// All strings of the metadata whose key begins with `prefix`, by the rest of the key.
    pub(crate) fn texts_below(&self, prefix: &str) -> BTreeMap<String, String> {
        let below = |(key, value): (&String, &String)| {
            Some((key.strip_prefix(prefix)?.to_owned(), value.clone()))
        };
        self.header
            .metadata()
            .iter()
            .flatten()
            .filter_map(below)
            .collect()
    }

    /// The bytes of a tensor of `columns` values per row (or of no second axis) and how many rows
    /// it has.
    pub(crate) fn rows(
        &self,
        name: &str,
        dtype: Dtype,
        columns: &[usize],
    ) -> Result<(&'a [u8], usize), DecodeError> {
        let info = self
            .header
            .info(name)
            .ok_or_else(|| DecodeError::Malformed(format!("the tensor '{name}' is missing")))?;
        match info.shape.split_first() {
            Some((&rows, rest)) if rest == columns && info.dtype == dtype => {
                Ok((&self.data[info.data_offsets.0..info.data_offsets.1], rows))
            }
            _ => {
                let axes: String = columns
                    .iter()
                    .map(|columns| format!(", {columns}"))
                    .collect();
                let reason = format!(
                    "tensor '{name}' is {} {:?}; expected {dtype} [rows{axes}]",
                    info.dtype, info.shape
                );
                Err(DecodeError::Malformed(reason))
            }
        }
    }

    /// Refuses tensors that are not among `names`: what they hold would be lost unnoticed.
    pub(crate) fn check_names(&self, names: &[&str]) -> Result<(), DecodeError> {
        match self
            .header
            .offset_keys()
            .iter()
            .find(|name| !names.contains(&name.as_str()))
        {
            Some(name) => Err(DecodeError::Malformed(format!(
                "there is no tensor '{name}' in this version of the format"
            ))),
            None => Ok(()),
        }
    }
}

/// The header as it is written; keys in order.
#[derive(Serialize)]
struct Header<'a> {
    #[serde(rename = "__metadata__")]
    metadata: &'a BTreeMap<String, String>,
    #[serde(flatten)]
    tensors: Metadata,
}

/// A file of `tensors`, in their order, which should put wider types first so that every tensor is
/// aligned.
pub(crate) fn write(
    metadata: &BTreeMap<String, String>,
    tensors: &[Tensor],
) -> Result<Vec<u8>, EncodeError> {
    let mut end = 0;
    let infos = tensors.iter().map(|tensor| {
        let start = end;
        end += tensor.bytes.len();
        (
            tensor.name.to_owned(),
            TensorInfo {
                dtype: tensor.dtype,
                shape: tensor.shape.clone(),
                data_offsets: (start, end),
            },
        )
    });
    let refused = |error: &dyn std::fmt::Display| EncodeError(format!("the header: {error}"));
    let tensors_of_header =
        Metadata::new(None, infos.collect()).map_err(|error| refused(&error))?;
    let header = Header {
        metadata,
        tensors: tensors_of_header,
    };
    let mut header = serde_json::to_vec(&header).map_err(|error| refused(&error))?;
    header.resize(header.len().next_multiple_of(LENGTH_BYTES), b' ');
    if header.len() > HEADER_BYTES_MAX {
        let reason = format!(
            "settings and names make a header of {} bytes; at most {HEADER_BYTES_MAX} are read",
            header.len()
        );
        return Err(EncodeError(reason));
    }
    let mut bytes = Vec::with_capacity(LENGTH_BYTES + header.len() + end);
    bytes.extend_from_slice(&(header.len() as u64).to_le_bytes());
    bytes.extend_from_slice(&header);
    tensors
        .iter()
        .for_each(|tensor| bytes.extend_from_slice(&tensor.bytes));
    Ok(bytes)
}
