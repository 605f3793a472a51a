//! The two ways in which SPZ wraps its attribute streams.

use std::io::{self, Read, Write};

use flate2::bufread::GzDecoder;
use rayon::prelude::*;
use zstd::zstd_safe::CParameter;

use super::attributes::{Layout, Packed, STREAMS};
use super::axes::StoredAxes;
use crate::{DecodeError, EncodeError};

const MAGIC: [u8; 4] = *b"NGSP";
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// Magic, version, count, degree, fractional bits, flags and one byte more: common to all versions.
const HEADER_BYTES: usize = 16;
/// The header of version 4 adds the offset of its table of contents and 12 reserved bytes.
const HEADER_V4_BYTES: usize = 32;
/// Compressed and uncompressed size of one stream.
const CONTENTS_ENTRY_BYTES: usize = 16;
const FLAG_EXTENSIONS: u8 = 2;
/// Extension record that names the axes of the stored data.
const EXTENSION_AXES: u32 = 0xadbe_0003;
/// Extensions of a gzip file beyond this are not read; known ones have some twenty bytes.
const EXTENSION_BYTES_MAX: u64 = 1 << 16;

/// A file's claim is believed up to this many splats however small the file is, so that tiny
/// uniform clouds are read.
const SPLATS_ALWAYS: u64 = 1 << 14;
/// Further splats are believed if the file has this many bytes for each. Real files have 5 to 20
/// bytes per splat; without a bound a file of a megabyte could ask for a terabyte.
const BYTES_PER_SPLAT_MIN: u64 = 4;

/// Zstandard level: beyond it, files get slower to write but hardly smaller.
const LEVEL: i32 = 7;
/// Level of the coefficients after DC, two thirds of the bytes of degree 3: higher ones take up to
/// ten times as long, and captured streets get 0.5 % smaller by them.
const LEVEL_SH: i32 = 1;

/// Most threads that compress one stream: each holds some ten megabytes.
const THREADS_MAX: usize = 16;

/// Fixed header, checked.
struct Header {
    layout: Layout,
    has_extensions: bool,
    byte_15: u8,
}

/// Unwraps the streams of `bytes`, whatever the version.
pub(super) fn read(bytes: &[u8]) -> Result<Packed, DecodeError> {
    if bytes.starts_with(&MAGIC) {
        read_v4(bytes)
    } else if bytes.starts_with(&GZIP_MAGIC) {
        read_gzip(bytes)
    } else {
        Err(DecodeError::Malformed(
            "neither 'NGSP' (version 4) nor a gzip header (versions 1 to 3) starts the file".into(),
        ))
    }
}

fn read_header(bytes: &[u8; HEADER_BYTES], file_bytes: u64) -> Result<Header, DecodeError> {
    if !bytes.starts_with(&MAGIC) {
        return Err(DecodeError::Malformed(
            "the gzip stream does not start with 'NGSP'".into(),
        ));
    }
    let version = u32_at(bytes, 4);
    let count = u32_at(bytes, 8);
    let [stored_degree, fractional_bits, flags, byte_15] =
        [bytes[12], bytes[13], bytes[14], bytes[15]];
    if !(1..=4).contains(&version) {
        return Err(DecodeError::Unsupported(format!(
            "SPZ version {version}; versions 1 to 4 are read"
        )));
    }
    if stored_degree > 4 {
        return Err(DecodeError::Malformed(format!(
            "spherical harmonics of degree {stored_degree}; 0 to 4 are defined"
        )));
    }
    if fractional_bits > 24 {
        return Err(DecodeError::Malformed(format!(
            "{fractional_bits} fractional bits in 24-bit positions"
        )));
    }
    let count_max = SPLATS_ALWAYS + file_bytes / BYTES_PER_SPLAT_MIN;
    if u64::from(count) > count_max {
        return Err(DecodeError::Malformed(format!(
            "{count} splats in {file_bytes} bytes; at most {count_max} are believed: the count is damaged, export the file again"
        )));
    }
    let layout = Layout {
        version,
        count: count as usize,
        stored_degree,
        fractional_bits,
    };
    Ok(Header {
        layout,
        has_extensions: flags & FLAG_EXTENSIONS != 0,
        byte_15,
    })
}

fn read_gzip(bytes: &[u8]) -> Result<Packed, DecodeError> {
    let mut inflated = GzDecoder::new(bytes);
    let mut fixed = [0; HEADER_BYTES];
    inflated
        .read_exact(&mut fixed)
        .map_err(|error| DecodeError::Malformed(format!("the gzip stream: {error}")))?;
    let header = read_header(&fixed, bytes.len() as u64)?;
    if header.layout.version == 4 {
        return Err(DecodeError::Malformed(
            "version 4 inside gzip; version 4 is stored plain".into(),
        ));
    }
    let mut streams: [Vec<u8>; 6] = Default::default();
    for (stream, (name, expected)) in streams
        .iter_mut()
        .zip(STREAMS.into_iter().zip(header.layout.stream_bytes()))
    {
        // Grows with what is really there and stops at what is expected.
        let result = inflated.by_ref().take(expected as u64).read_to_end(stream);
        result.map_err(|error| {
            DecodeError::Malformed(format!("the gzip stream, in {name}: {error}"))
        })?;
        if stream.len() != expected {
            return Err(DecodeError::Truncated {
                what: format!("stream '{name}'"),
                expected_bytes: expected as u64,
                found_bytes: stream.len() as u64,
            });
        }
    }
    let mut extensions = Vec::new();
    let behind = inflated
        .take(EXTENSION_BYTES_MAX)
        .read_to_end(&mut extensions);
    behind
        .map_err(|error| DecodeError::Malformed(format!("the end of the gzip stream: {error}")))?;
    if !header.has_extensions && !extensions.is_empty() {
        return Err(DecodeError::Malformed(
            "bytes follow the last stream although the header announces no extensions".into(),
        ));
    }
    let axes = if header.has_extensions {
        axes_of(&extensions)?
    } else {
        StoredAxes::RUB
    };
    Ok(Packed {
        layout: header.layout,
        streams,
        axes,
    })
}

fn read_v4(bytes: &[u8]) -> Result<Packed, DecodeError> {
    let truncated = |what: &str, expected: u64| DecodeError::Truncated {
        what: what.to_owned(),
        expected_bytes: expected,
        found_bytes: bytes.len() as u64,
    };
    let Some(fixed) = bytes.first_chunk::<HEADER_V4_BYTES>() else {
        return Err(truncated("the header", HEADER_V4_BYTES as u64));
    };
    let Some(common) = fixed.first_chunk::<HEADER_BYTES>() else {
        return Err(truncated("the header", HEADER_BYTES as u64));
    };
    let header = read_header(common, bytes.len() as u64)?;
    if header.layout.version != 4 {
        return Err(DecodeError::Malformed(format!(
            "version {} outside gzip; only version 4 is stored plain",
            header.layout.version
        )));
    }
    let expected = header.layout.stream_bytes();
    let present: Vec<usize> = (0..6).filter(|&stream| expected[stream] > 0).collect();
    if present.len() != usize::from(header.byte_15) {
        return Err(DecodeError::Malformed(format!(
            "{} streams where {} are expected",
            header.byte_15,
            present.len()
        )));
    }
    let contents_at = u32_at(fixed, 16) as usize;
    let data_at = contents_at + present.len() * CONTENTS_ENTRY_BYTES;
    if contents_at < HEADER_V4_BYTES {
        return Err(DecodeError::Malformed(format!(
            "the table of contents at byte {contents_at} lies inside the header"
        )));
    }
    let contents = bytes
        .get(contents_at..data_at)
        .ok_or_else(|| truncated("the table of contents", data_at as u64))?;
    let sources = v4_sources(contents, &bytes[data_at..], &present, &expected)?;
    let inflated: Vec<Vec<u8>> = present
        .par_iter()
        .zip(sources)
        .map(|(&stream, source)| inflate(source, stream, expected[stream]))
        .collect::<Result<_, _>>()?;
    let mut streams: [Vec<u8>; 6] = Default::default();
    for (&stream, data) in present.iter().zip(inflated) {
        streams[stream] = data;
    }
    let axes = if header.has_extensions {
        axes_of(&bytes[HEADER_V4_BYTES..contents_at])?
    } else {
        StoredAxes::RUB
    };
    Ok(Packed {
        layout: header.layout,
        streams,
        axes,
    })
}

/// Cuts `data` into the compressed streams that the table of contents lists.
fn v4_sources<'a>(
    contents: &[u8],
    mut data: &'a [u8],
    present: &[usize],
    expected: &[usize; 6],
) -> Result<Vec<&'a [u8]>, DecodeError> {
    let mut sources = Vec::with_capacity(present.len());
    for (entry, &stream) in contents.chunks_exact(CONTENTS_ENTRY_BYTES).zip(present) {
        let (compressed, uncompressed) = (u64_at(entry, 0), u64_at(entry, 8));
        let name = STREAMS[stream];
        if uncompressed != expected[stream] as u64 {
            return Err(DecodeError::Malformed(format!(
                "stream '{name}' announces {uncompressed} bytes; this many splats have {}",
                expected[stream]
            )));
        }
        let Some((source, rest)) = usize::try_from(compressed)
            .ok()
            .and_then(|length| data.split_at_checked(length))
        else {
            return Err(DecodeError::Truncated {
                what: format!("compressed stream '{name}'"),
                expected_bytes: compressed,
                found_bytes: data.len() as u64,
            });
        };
        sources.push(source);
        data = rest;
    }
    if !data.is_empty() {
        return Err(DecodeError::Malformed(format!(
            "{} bytes follow the last stream",
            data.len()
        )));
    }
    Ok(sources)
}

/// Decompresses one stream into a buffer of exactly the size that the (bounded) splat count gives
/// it.
fn inflate(source: &[u8], stream: usize, expected: usize) -> Result<Vec<u8>, DecodeError> {
    let name = STREAMS[stream];
    let data = zstd::bulk::decompress(source, expected)
        .map_err(|error| DecodeError::Malformed(format!("Zstandard stream '{name}': {error}")))?;
    if data.len() != expected {
        return Err(DecodeError::Truncated {
            what: format!("stream '{name}'"),
            expected_bytes: expected as u64,
            found_bytes: data.len() as u64,
        });
    }
    Ok(data)
}

/// Reads extension records (type, length, value) for the one that changes what the data mean.
fn axes_of(mut records: &[u8]) -> Result<StoredAxes, DecodeError> {
    let mut axes = StoredAxes::RUB;
    while !records.is_empty() {
        let length = records.get(..8).map(|head| u32_at(head, 4) as usize);
        let Some(value) = length.and_then(|length| records.get(8..8 + length)) else {
            return Err(DecodeError::Truncated {
                what: "an extension record".into(),
                expected_bytes: 8 + length.unwrap_or(0) as u64,
                found_bytes: records.len() as u64,
            });
        };
        if u32_at(records, 0) == EXTENSION_AXES {
            match value.first_chunk::<4>() {
                Some(code) => axes = StoredAxes::of_code(u32::from_le_bytes(*code))?,
                None => {
                    return Err(DecodeError::Malformed(
                        "the coordinate-system extension is shorter than its 4 bytes".into(),
                    ));
                }
            }
        }
        records = &records[8 + value.len()..];
    }
    Ok(axes)
}

/// File of version 4: its start, then its streams.
pub(super) struct Wrapped {
    start: Vec<u8>,
    streams: Vec<Vec<u8>>,
}

impl Wrapped {
    /// Compresses `packed`.
    ///
    /// # Errors
    /// Returns an error for more splats than the format counts, or fewer bytes than readers
    /// believe.
    pub(super) fn new(packed: Packed) -> Result<Self, EncodeError> {
        let layout = packed.layout;
        let count = u32::try_from(layout.count)
            .map_err(|_| EncodeError(format!("{} splats; at most 4294967295 fit", layout.count)))?;
        let present = packed.streams.into_iter().zip(STREAMS);
        let present: Vec<(Vec<u8>, &str)> =
            present.filter(|(stream, _)| !stream.is_empty()).collect();
        let plain: Vec<usize> = present.iter().map(|(stream, _)| stream.len()).collect();
        let streams: Vec<Vec<u8>> = present
            .into_par_iter()
            .map(|(stream, name)| {
                let level = if name == "sh" { LEVEL_SH } else { LEVEL };
                compressed(&stream, level)
                    .map_err(|error| EncodeError(format!("Zstandard: {error}")))
            })
            .collect::<Result<_, _>>()?;
        let mut start = Vec::new();
        start.extend_from_slice(&MAGIC);
        start.extend_from_slice(&4u32.to_le_bytes());
        start.extend_from_slice(&count.to_le_bytes());
        start.extend_from_slice(&[
            layout.stored_degree,
            layout.fractional_bits,
            0,
            streams.len() as u8,
        ]);
        start.extend_from_slice(&(HEADER_V4_BYTES as u32).to_le_bytes());
        start.resize(HEADER_V4_BYTES, 0);
        for (plain, stream) in plain.into_iter().zip(&streams) {
            start.extend_from_slice(&(stream.len() as u64).to_le_bytes());
            start.extend_from_slice(&(plain as u64).to_le_bytes());
        }
        let wrapped = Self { start, streams };
        let length = wrapped.len() as u64;
        if u64::from(count) > SPLATS_ALWAYS + length / BYTES_PER_SPLAT_MIN {
            return Err(EncodeError(format!(
                "{count} splats shrink to {length} bytes, which readers take for an attack: they must be nearly all the same"
            )));
        }
        Ok(wrapped)
    }

    /// Bytes of the file.
    fn len(&self) -> usize {
        self.start.len() + self.streams.iter().map(Vec::len).sum::<usize>()
    }

    /// Writes the bytes of the file.
    pub(super) fn write_to(&self, file: &mut impl Write) -> io::Result<()> {
        file.write_all(&self.start)?;
        self.streams
            .iter()
            .try_for_each(|stream| file.write_all(stream))
    }
}

/// `stream` as one frame of Zstandard. Its bytes are the same for any number of threads.
fn compressed(stream: &[u8], level: i32) -> io::Result<Vec<u8>> {
    let threads = rayon::current_num_threads().min(THREADS_MAX) as u32;
    let mut compressor = zstd::bulk::Compressor::new(level)?;
    // Most of a cloud of degree 3 is one stream: it is cut between threads.
    compressor.set_parameter(CParameter::NbWorkers(threads))?;
    compressor.compress(stream)
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | u64::from(u32_at(bytes, at + 4)) << 32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_have_the_same_bytes_for_any_number_of_threads() {
        // Longer than the parts that are compressed side by side.
        let stream: Vec<u8> = (0..24_000_000_u32)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 27) as u8)
            .collect();
        let by_threads = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| compressed(&stream, LEVEL_SH)).unwrap()
        };
        let frames = [1, 2, 5].map(by_threads);
        assert!(frames[0] == frames[1] && frames[0] == frames[2]);
        assert!(inflate(&frames[0], 0, stream.len()).unwrap() == stream);
    }
}
