//! Archives as bytes that anyone may have written.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Read;

use flate2::Crc;
use flate2::read::DeflateDecoder;

use super::{CENTRAL, CENTRAL_BYTES, END, END_BYTES, LOCAL, LOCAL_BYTES, leads_astray};
use crate::DecodeError;

/// Bytes of the record that says where the 64-bit end of the directory is.
const LOCATOR_BYTES: usize = 20;
/// Signature of the locator.
const LOCATOR: [u8; 4] = *b"PK\x06\x07";
/// Signature of the 64-bit end of the directory.
const END_64: [u8; 4] = *b"PK\x06\x06";
/// Largest size of a comment behind the directory, bytes.
const COMMENT_BYTES_MAX: usize = 65_535;
/// The extra field with 64-bit sizes.
const EXTRA_64: u16 = 1;

/// Storage method of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Method {
    Stored,
    Deflated,
}

#[derive(Clone, Debug)]
struct Entry<'a> {
    name: &'a str,
    method: Method,
    packed_bytes: u64,
    bytes: u64,
    header_at: u64,
    checksum: u32,
}

/// The directory of an archive, over its bytes.
#[derive(Clone, Debug)]
pub(crate) struct Archive<'a> {
    bytes: &'a [u8],
    entries: Vec<Entry<'a>>,
    /// Positions in `entries`; of equal names the first.
    by_name: HashMap<&'a str, usize>,
}

impl<'a> Archive<'a> {
    /// Reads the directory at the end of `bytes`.
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let (count, start) = directory(bytes)?;
        let (mut entries, mut by_name) = (Vec::new(), HashMap::new());
        let mut at = start;
        for index in 0..count {
            let (entry, next) = central_entry(bytes, at).ok_or_else(|| {
                malformed(format!("entry {index} of {count} in the zip's directory is damaged; copy or export the file again"))
            })?;
            let entry = entry?;
            if leads_astray(entry.name) {
                return Err(malformed(format!(
                    "the zip has an entry '{}', which leads out of it",
                    shown(entry.name)
                )));
            }
            by_name.entry(entry.name).or_insert(entries.len());
            entries.push(entry);
            at = next;
        }
        Ok(Self {
            bytes,
            entries,
            by_name,
        })
    }

    /// The names of all entries, in the order of the directory.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().map(|entry| entry.name)
    }

    /// True if there is an entry called `name`.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.by_name.contains_key(name)
    }

    /// The bytes of an entry that is stored as it is, a piece of the file. Its checksum is not
    /// examined.
    pub(crate) fn stored(&self, name: &str) -> Result<&'a [u8], DecodeError> {
        let entry = self.entry(name)?;
        if entry.method != Method::Stored || entry.packed_bytes != entry.bytes {
            return Err(DecodeError::Unsupported(format!(
                "the zip's entry '{}' is compressed; store it",
                shown(name)
            )));
        }
        self.packed(entry)
    }

    /// The bytes of an entry of at most `bytes_max`, its checksum right.
    pub(crate) fn checked(&self, name: &str, bytes_max: u64) -> Result<Cow<'a, [u8]>, DecodeError> {
        let entry = self.entry(name)?;
        if entry.bytes > bytes_max {
            let message = format!(
                "the zip's entry '{}' claims {} bytes; at most {bytes_max} are read",
                shown(name),
                entry.bytes
            );
            return Err(malformed(message));
        }
        let content = match entry.method {
            Method::Stored => Cow::Borrowed(self.stored(name)?),
            Method::Deflated => Cow::Owned(inflated(self.packed(entry)?, entry)?),
        };
        let mut checksum = Crc::new();
        checksum.update(&content);
        if checksum.sum() != entry.checksum {
            let message = format!(
                "the zip's entry '{}' has a wrong checksum; copy or export the file again",
                shown(name)
            );
            return Err(malformed(message));
        }
        Ok(content)
    }

    fn entry(&self, name: &str) -> Result<&Entry<'a>, DecodeError> {
        self.by_name
            .get(name)
            .map(|&index| &self.entries[index])
            .ok_or_else(|| {
                let there: Vec<String> = self.names().take(12).map(shown).collect();
                malformed(format!(
                    "the zip has no entry '{}', only: {}",
                    shown(name),
                    there.join(", ")
                ))
            })
    }

    /// The bytes of an entry as they stand in the file.
    fn packed(&self, entry: &Entry<'a>) -> Result<&'a [u8], DecodeError> {
        let truncated = || DecodeError::Truncated {
            what: format!("the zip's entry '{}'", shown(entry.name)),
            expected_bytes: entry
                .header_at
                .saturating_add(LOCAL_BYTES as u64)
                .saturating_add(entry.packed_bytes),
            found_bytes: self.bytes.len() as u64,
        };
        let at = usize::try_from(entry.header_at).map_err(|_| truncated())?;
        let header = slice(self.bytes, at, LOCAL_BYTES).ok_or_else(truncated)?;
        if !header.starts_with(&LOCAL) {
            return Err(malformed(format!(
                "the zip's directory says that '{}' begins where nothing does",
                shown(entry.name)
            )));
        }
        let before =
            LOCAL_BYTES + usize::from(u16_at(header, 26)) + usize::from(u16_at(header, 28));
        let length = usize::try_from(entry.packed_bytes).map_err(|_| truncated())?;
        at.checked_add(before)
            .and_then(|start| slice(self.bytes, start, length))
            .ok_or_else(truncated)
    }
}

/// The content of the entry `name` among the stored ones at the `start` of an archive, without its
/// directory, which is at the end of a file that may be large. `None` where it is not among them.
/// Its checksum is not examined.
pub(crate) fn first_stored<'a>(start: &'a [u8], name: &str) -> Option<&'a [u8]> {
    let mut at = 0;
    loop {
        let header = slice(start, at, LOCAL_BYTES)?;
        // Stored, and its size is known before its content.
        if !header.starts_with(&LOCAL) || u16_at(header, 8) != 0 || u16_at(header, 6) & 8 != 0 {
            return None;
        }
        let [name_bytes, extra_bytes] = [26, 28].map(|at| usize::from(u16_at(header, at)));
        let name_at = at + LOCAL_BYTES;
        let content_at = name_at + name_bytes + extra_bytes;
        let content_bytes = usize::try_from(u32_at(header, 18)).ok()?;
        if slice(start, name_at, name_bytes)? == name.as_bytes() {
            return slice(start, content_at, content_bytes);
        }
        at = content_at.checked_add(content_bytes)?;
    }
}

/// Start and size of the directory that the `end` of a file of `file_bytes` tells. `None` where it
/// tells none, or one with the 64-bit extension.
pub(super) fn directory_span(end: &[u8], file_bytes: u64) -> Option<(u64, u64)> {
    let at = (0..=end.len().checked_sub(END_BYTES)?)
        .rev()
        .find(|&at| is_end(end, at))?;
    let [size, start] = [12, 16].map(|part| u64::from(u32_at(end, at + part)));
    let is_inside = start.checked_add(size)? <= file_bytes;
    (is_inside && start != u64::from(u32::MAX)).then_some((start, size))
}

/// Place of the local header and size of the stored entry `name` in the bytes of a directory.
pub(super) fn stored_in_directory(directory: &[u8], name: &str) -> Option<(u64, u64)> {
    let mut at = 0;
    while at < directory.len() {
        let (entry, next) = central_entry(directory, at)?;
        let entry = entry.ok()?;
        if entry.name == name {
            let is_stored = entry.method == Method::Stored;
            return is_stored.then_some((entry.header_at, entry.bytes));
        }
        at = next;
    }
    None
}

/// Bytes of a local entry before its content, as its `header` says.
pub(super) fn bytes_before_content(header: &[u8; LOCAL_BYTES]) -> Option<u64> {
    let after = u64::from(u16_at(header, 26)) + u64::from(u16_at(header, 28));
    header
        .starts_with(&LOCAL)
        .then_some(LOCAL_BYTES as u64 + after)
}

fn inflated(packed: &[u8], entry: &Entry<'_>) -> Result<Vec<u8>, DecodeError> {
    let mut content = Vec::new();
    // One byte more than is claimed tells a claim that is too small.
    let result = DeflateDecoder::new(packed)
        .take(entry.bytes + 1)
        .read_to_end(&mut content);
    result
        .map_err(|error| malformed(format!("the zip's entry '{}': {error}", shown(entry.name))))?;
    if content.len() as u64 != entry.bytes {
        let message = format!(
            "the zip's entry '{}' has another size than its {} bytes",
            shown(entry.name),
            entry.bytes
        );
        return Err(malformed(message));
    }
    Ok(content)
}

/// Number of entries of the directory, and its first byte.
fn directory(bytes: &[u8]) -> Result<(u64, usize), DecodeError> {
    let earliest = bytes.len().saturating_sub(END_BYTES + COMMENT_BYTES_MAX);
    let last = bytes.len().checked_sub(END_BYTES);
    let found = last.and_then(|last| (earliest..=last).rev().find(|&at| is_end(bytes, at)));
    let Some(at) = found else {
        let message =
            "the zip has no directory at its end: the file is cut short; copy or export it again";
        return Err(malformed(message.into()));
    };
    let end = &bytes[at..at + END_BYTES];
    if u16_at(end, 4) != 0 || u16_at(end, 6) != 0 {
        return Err(DecodeError::Unsupported(
            "the zip is one of several files; join them first".into(),
        ));
    }
    let (mut count, mut start) = (u64::from(u16_at(end, 10)), u64::from(u32_at(end, 16)));
    if let Some((count_64, start_64)) = end_64(bytes, at) {
        (count, start) = (count_64, start_64);
    }
    let room = at as u64;
    if start > room || count > (room - start) / CENTRAL_BYTES as u64 {
        return Err(malformed(format!(
            "the zip's directory claims {count} entries from byte {start} of {room}"
        )));
    }
    Ok((count, start as usize))
}

/// True if the end of a directory stands at `at`, with a comment that ends where the file does.
fn is_end(bytes: &[u8], at: usize) -> bool {
    bytes[at..].starts_with(&END)
        && at + END_BYTES + usize::from(u16_at(&bytes[at..], 20)) == bytes.len()
}

/// Entries and start of the directory as the 64-bit extension in front of the end at `end_at` says.
fn end_64(bytes: &[u8], end_at: usize) -> Option<(u64, u64)> {
    let locator = slice(bytes, end_at.checked_sub(LOCATOR_BYTES)?, LOCATOR_BYTES)?;
    if !locator.starts_with(&LOCATOR) {
        return None;
    }
    let end = slice(bytes, usize::try_from(u64_at(locator, 8)).ok()?, 56)?;
    end.starts_with(&END_64)
        .then(|| (u64_at(end, 32), u64_at(end, 48)))
}

/// The entry of the directory at `at`, and where the next begins. None where the bytes are no
/// entry.
fn central_entry(bytes: &[u8], at: usize) -> Option<(Result<Entry<'_>, DecodeError>, usize)> {
    let fixed = slice(bytes, at, CENTRAL_BYTES)?;
    if !fixed.starts_with(&CENTRAL) {
        return None;
    }
    let [name_bytes, extra_bytes, comment_bytes] =
        [28, 30, 32].map(|at| usize::from(u16_at(fixed, at)));
    let name_at = at + CENTRAL_BYTES;
    let name = std::str::from_utf8(slice(bytes, name_at, name_bytes)?).ok()?;
    let extra = slice(bytes, name_at + name_bytes, extra_bytes)?;
    let next = name_at + name_bytes + extra_bytes + comment_bytes;
    let [packed_bytes, size, header_at] = sizes(fixed, extra)?;
    let method = match (u16_at(fixed, 10), u16_at(fixed, 8) & 1) {
        (0, 0) => Method::Stored,
        (8, 0) => Method::Deflated,
        (_, 1) => {
            return Some((
                Err(DecodeError::Unsupported(format!(
                    "the zip's entry '{}' is encrypted",
                    shown(name)
                ))),
                next,
            ));
        }
        (other, _) => {
            let message = format!(
                "the zip's entry '{}' is compressed by method {other}; store or deflate it",
                shown(name)
            );
            return Some((Err(DecodeError::Unsupported(message)), next));
        }
    };
    Some((
        Ok(Entry {
            name,
            method,
            packed_bytes,
            bytes: size,
            header_at,
            checksum: u32_at(fixed, 16),
        }),
        next,
    ))
}

/// Compressed size, size and offset of an entry; 32 bits that are all ones stand for the next 64 of
/// the extra field.
fn sizes(fixed: &[u8], extra: &[u8]) -> Option<[u64; 3]> {
    let mut wide = &[][..];
    let mut rest = extra;
    while rest.len() >= 4 {
        let (kind, length) = (u16_at(rest, 0), usize::from(u16_at(rest, 2)));
        let field = slice(rest, 4, length)?;
        if kind == EXTRA_64 {
            wide = field;
        }
        rest = &rest[4 + length..];
    }
    let mut next = 0;
    let mut value = |at: usize| {
        let narrow = u32_at(fixed, at);
        if narrow != u32::MAX {
            return Some(u64::from(narrow));
        }
        let field = slice(wide, next, 8)?;
        next += 8;
        Some(u64_at(field, 0))
    };
    // The extra field holds the size first; the directory the compressed size.
    let size = value(24)?;
    let packed_bytes = value(20)?;
    Some([packed_bytes, size, value(42)?])
}

fn malformed(message: String) -> DecodeError {
    DecodeError::Malformed(message)
}

/// The start of a name from a file, fit for a message.
fn shown(name: &str) -> String {
    name.chars()
        .take(60)
        .map(|c| if c.is_control() { '?' } else { c })
        .collect()
}

fn slice(bytes: &[u8], at: usize, length: usize) -> Option<&[u8]> {
    bytes.get(at..at.checked_add(length)?)
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}
