//! Stores of a sequence: attributes and encoded images of zarr groups, in a folder or in a tar.
//!
//! All that a scene needs of a sequence is in the attributes of its groups, which are JSON, and
//! images are stored as they were encoded: no array is decoded, so no reader of arrays is needed. A
//! tar is walked by its headers, whose index at the end of the file is not read.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::{AssetError, DecodeError};

/// Name of the format in messages.
pub(super) const NAME: &str = "NCore store";
/// Block of a tar, bytes.
const BLOCK: u64 = 512;
/// Most bytes of the attributes of a group.
const ATTRIBUTES_MAX: u64 = 256 << 20;
/// Most bytes of an image.
const IMAGE_MAX: u64 = 256 << 20;
/// Most bytes of the extended header of an entry.
const EXTENDED_MAX: u64 = 64 << 10;
/// Most entries of a tar.
const ENTRIES_MAX: usize = 50_000_000;
/// Name of the attributes of a group.
const ATTRIBUTES: &str = ".zattrs";

/// A store, opened.
pub(super) struct Store {
    path: PathBuf,
    source: Source,
}

enum Source {
    Folder,
    /// Start and size of each entry.
    Tar(RefCell<File>, BTreeMap<String, [u64; 2]>),
}

impl Store {
    /// Opens the folder or the tar at `path`.
    pub(super) fn open(path: &Path) -> Result<Self, AssetError> {
        let source = if path.is_dir() {
            Source::Folder
        } else {
            let read = |source| AssetError::Read {
                path: path.to_owned(),
                source,
            };
            let mut file = File::open(path).map_err(read)?;
            let entries = entries_of(&mut file).map_err(|source| AssetError::Decode {
                path: path.to_owned(),
                format: NAME,
                source,
            })?;
            Source::Tar(RefCell::new(file), entries)
        };
        Ok(Self {
            path: path.to_owned(),
            source,
        })
    }

    /// Attributes of `group`; `None` where it has none.
    pub(super) fn attributes(&self, group: &str) -> Result<Option<Value>, AssetError> {
        let name = format!("{group}/{ATTRIBUTES}");
        let Some(bytes) = self.bytes(&name, ATTRIBUTES_MAX)? else {
            return Ok(None);
        };
        let value = serde_json::from_slice(&bytes);
        value
            .map(Some)
            .map_err(|error| self.error(format!("{name}: {error}")))
    }

    /// Names of the groups in `group`, in the order of their names.
    pub(super) fn groups(&self, group: &str) -> Vec<String> {
        match &self.source {
            Source::Folder => {
                let Ok(entries) = std::fs::read_dir(self.path.join(group)) else {
                    return Vec::new();
                };
                let folders = entries.flatten().filter(|entry| entry.path().is_dir());
                let names = folders.filter_map(|entry| entry.file_name().into_string().ok());
                let names: BTreeSet<String> = names.collect();
                names.into_iter().collect()
            }
            Source::Tar(_, entries) => {
                let start = format!("{group}/");
                let inside = entries
                    .range(start.clone()..)
                    .map_while(|(name, _)| name.strip_prefix(&start));
                let names = inside.filter_map(|rest| rest.split_once('/').map(|(name, _)| name));
                let mut names: Vec<String> = names.map(str::to_owned).collect();
                names.dedup();
                names
            }
        }
    }

    /// The encoded image in the array `array`: its only chunk.
    pub(super) fn image(&self, array: &str) -> Result<Option<Vec<u8>>, AssetError> {
        self.bytes(&format!("{array}/0"), IMAGE_MAX)
    }

    /// An error of this store.
    pub(super) fn error(&self, reason: String) -> AssetError {
        AssetError::Decode {
            path: self.path.clone(),
            format: NAME,
            source: DecodeError::Malformed(reason),
        }
    }

    fn bytes(&self, name: &str, most: u64) -> Result<Option<Vec<u8>>, AssetError> {
        let too_large = |size: u64| {
            self.error(format!(
                "'{name}' has {size} bytes; at most {most} are read"
            ))
        };
        let read = |source| AssetError::Read {
            path: self.path.clone(),
            source,
        };
        match &self.source {
            Source::Folder => {
                let path = self.path.join(name);
                let Ok(found) = std::fs::metadata(&path) else {
                    return Ok(None);
                };
                if found.len() > most {
                    return Err(too_large(found.len()));
                }
                std::fs::read(path).map(Some).map_err(read)
            }
            Source::Tar(file, entries) => {
                let Some(&[at, size]) = entries.get(name) else {
                    return Ok(None);
                };
                if size > most {
                    return Err(too_large(size));
                }
                let mut file = file.borrow_mut();
                let mut bytes = Vec::new();
                file.seek(SeekFrom::Start(at)).map_err(read)?;
                file.by_ref()
                    .take(size)
                    .read_to_end(&mut bytes)
                    .map_err(read)?;
                Ok(Some(bytes))
            }
        }
    }
}

/// Start and size of each file of a tar, by its name. The walk ends at the first block that is no
/// header: behind the entries is an index of the writer.
fn entries_of(file: &mut (impl Read + Seek)) -> Result<BTreeMap<String, [u64; 2]>, DecodeError> {
    let io = |error: std::io::Error| DecodeError::Malformed(error.to_string());
    let file_bytes = file.seek(SeekFrom::End(0)).map_err(io)?;
    let (mut at, mut entries) = (0u64, BTreeMap::new());
    let mut long_name = None;
    while at.saturating_add(BLOCK) <= file_bytes {
        let mut header = [0; BLOCK as usize];
        file.seek(SeekFrom::Start(at)).map_err(io)?;
        file.read_exact(&mut header).map_err(io)?;
        if header.iter().all(|byte| *byte == 0) {
            return Ok(entries);
        }
        let Some(size) = size_of(&header) else {
            return Err(DecodeError::Malformed(format!(
                "the block at byte {at} is no header of a tar; copy or export it again"
            )));
        };
        let start = at + BLOCK;
        let end = start.checked_add(size).filter(|end| *end <= file_bytes);
        let Some(end) = end else {
            return Err(DecodeError::Truncated {
                what: format!("the tar's entry at byte {at}"),
                expected_bytes: start.saturating_add(size),
                found_bytes: file_bytes,
            });
        };
        match header[156] {
            b'x' if size <= EXTENDED_MAX => {
                let mut text = vec![0; size as usize];
                file.read_exact(&mut text).map_err(io)?;
                long_name = path_of(&text);
            }
            b'x' => {
                return Err(DecodeError::Malformed(format!(
                    "the tar's entry at byte {at} has a header of {size} bytes"
                )));
            }
            b'0' | 0 => {
                let name = long_name.take().unwrap_or_else(|| name_of(&header));
                entries.insert(name, [start, size]);
                if entries.len() > ENTRIES_MAX {
                    let reason = format!("the tar has more than {ENTRIES_MAX} entries");
                    return Err(DecodeError::Malformed(reason));
                }
            }
            _ => long_name = None,
        }
        at = end.next_multiple_of(BLOCK);
    }
    Err(DecodeError::Malformed(
        "the tar has no end; the sequence was not finished, or the file is cut short".into(),
    ))
}

/// Size of the entry of a header whose checksum is right.
fn size_of(header: &[u8; BLOCK as usize]) -> Option<u64> {
    let octal = |bytes: &[u8]| {
        let text = str::from_utf8(bytes).ok()?;
        u64::from_str_radix(text.trim_matches(['\0', ' ']), 8).ok()
    };
    let sum = |byte: (usize, &u8)| match byte {
        (148..156, _) => u64::from(b' '),
        (_, value) => u64::from(*value),
    };
    let sum: u64 = header.iter().enumerate().map(sum).sum();
    if octal(&header[148..156]) != Some(sum) {
        return None;
    }
    // Sizes of 8 GiB and more are binary, behind a mark.
    match header[124] {
        0x80 => Some(u64::from_be_bytes(std::array::from_fn(|i| header[128 + i]))),
        _ => octal(&header[124..136]),
    }
}

fn name_of(header: &[u8; BLOCK as usize]) -> String {
    let text = |bytes: &[u8]| {
        let end = bytes.iter().position(|byte| *byte == 0);
        String::from_utf8_lossy(&bytes[..end.unwrap_or(bytes.len())]).into_owned()
    };
    let (name, prefix) = (text(&header[..100]), text(&header[345..500]));
    match prefix.as_str() {
        "" => name,
        prefix => format!("{prefix}/{name}"),
    }
}

/// The `path` of an extended header: lines of a length, a key and a value.
fn path_of(text: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(text);
    let mut lines = text.lines();
    lines.find_map(|line| Some(line.split_once(" path=")?.1.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn entry(kind: u8, name: &str, content: &[u8]) -> Vec<u8> {
        let mut header = vec![0u8; BLOCK as usize];
        header[..name.len()].copy_from_slice(name.as_bytes());
        header[124..136].copy_from_slice(format!("{:011o}\0", content.len()).as_bytes());
        header[156] = kind;
        header[148..156].fill(b' ');
        let sum: u64 = header.iter().map(|byte| u64::from(*byte)).sum();
        header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
        header.extend(content);
        header.resize(header.len().next_multiple_of(BLOCK as usize), 0);
        header
    }

    #[test]
    fn entries_are_found_by_their_names_long_ones_too() {
        let long = format!("{}/.zattrs", "g".repeat(200));
        let mut tar = entry(b'0', "a/.zattrs", b"{}");
        tar.extend(entry(b'x', "pax", format!("217 path={long}\n").as_bytes()));
        tar.extend(entry(b'0', "ggg", b"[1]"));
        tar.extend([0; 1024]);
        tar.extend(b"an index");
        let found = entries_of(&mut Cursor::new(&tar)).unwrap();
        assert_eq!(found["a/.zattrs"], [512, 2]);
        let [at, size] = found[&long];
        assert_eq!(&tar[at as usize..(at + size) as usize], b"[1]");
        let end = tar.len() - 1032;
        for cut in (0..end).step_by(37) {
            assert!(entries_of(&mut Cursor::new(&tar[..cut])).is_err(), "{cut}");
        }
        let mut broken = tar.clone();
        broken[3] ^= 1;
        let error = entries_of(&mut Cursor::new(&broken)).unwrap_err();
        assert!(error.to_string().contains("byte 0"), "{error}");
    }
}
