//! JPEG in strips, side by side: each is a restart interval of the whole, so that a decoder sees
//! one image.
//!
//! ITU-T T.81: a scan may be cut into intervals of so many blocks (DRI), between which stand
//! markers RST0 to RST7, and at which the prediction of mean values begins anew, as it does in an
//! image of its own. All strips have the same tables.

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use rayon::prelude::*;

/// Rows of a strip: the rows of one block of blocks. Small images are coded by many threads too.
const STRIP_ROWS: usize = 16;
/// Quality from which colors keep the resolution of brightness.
const FULL_COLOR_FROM: u8 = 90;

const START_OF_SCAN: u8 = 0xda;
const FRAME: u8 = 0xc0;
const RESTART: u8 = 0xd0;

/// `rgba` as JPEG, on all threads of the pool that it is called on.
///
/// # Errors
/// A sentence, when the format cannot hold the size.
pub fn encode(
    rgba: &[u8],
    [width_px, height_px]: [u32; 2],
    quality: u8,
) -> Result<Vec<u8>, String> {
    let side = |side_px: u32| {
        u16::try_from(side_px)
            .map_err(|_| format!("JPEG holds sides of 65535 pixels, not {side_px}"))
    };
    let (width_px, height_px) = (side(width_px)?, side(height_px)?);
    let row_bytes = 4 * usize::from(width_px);
    let block_px = if quality >= FULL_COLOR_FROM { 8 } else { 16 };
    let interval = (STRIP_ROWS / block_px) * usize::from(width_px).div_ceil(block_px);
    let whole = || strip(rgba, width_px, quality);
    let Some(interval) = u16::try_from(interval)
        .ok()
        .filter(|_| usize::from(height_px) > STRIP_ROWS)
    else {
        return whole();
    };
    let strips: Vec<Vec<u8>> = rgba
        .par_chunks(row_bytes * STRIP_ROWS)
        .map(|rows| strip(rows, width_px, quality))
        .collect::<Result<_, _>>()?;
    joined(&strips, height_px, interval).map_or_else(whole, Ok)
}

/// Some rows as an image of their own.
fn strip(rgba: &[u8], width_px: u16, quality: u8) -> Result<Vec<u8>, String> {
    let rows = rgba.len() / (4 * usize::from(width_px));
    let mut bytes = Vec::with_capacity(rgba.len() / 8);
    let mut encoder = Encoder::new(&mut bytes, quality);
    let full = quality >= FULL_COLOR_FROM;
    encoder.set_sampling_factor(if full {
        SamplingFactor::F_1_1
    } else {
        SamplingFactor::F_2_2
    });
    encoder
        .encode(rgba, width_px, rows as u16, ColorType::Rgba)
        .map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// One image of `strips`, each an interval of `interval` blocks but the last, which may be shorter.
/// `None` where the encoder writes something else than one scan behind its tables.
fn joined(strips: &[Vec<u8>], height_px: u16, interval: u16) -> Option<Vec<u8>> {
    let parts = strips
        .iter()
        .map(|strip| Parts::parse(strip))
        .collect::<Option<Vec<_>>>()?;
    let first = parts.first()?;
    let mut bytes = Vec::with_capacity(strips.iter().map(Vec::len).sum());
    bytes.extend_from_slice(first.tables);
    let height = first.height_at;
    bytes[height..height + 2].copy_from_slice(&height_px.to_be_bytes());
    bytes.extend_from_slice(&[0xff, 0xdd, 0, 4]);
    bytes.extend_from_slice(&interval.to_be_bytes());
    bytes.extend_from_slice(first.scan_header);
    for (index, part) in parts.iter().enumerate() {
        if index > 0 {
            bytes.extend_from_slice(&[0xff, RESTART + ((index - 1) % 8) as u8]);
        }
        bytes.extend_from_slice(part.scan);
    }
    bytes.extend_from_slice(&[0xff, 0xd9]);
    Some(bytes)
}

/// A baseline JPEG of one scan, taken apart.
struct Parts<'a> {
    /// Bytes from the start to the scan's header.
    tables: &'a [u8],
    /// Offset of the image's height in the tables.
    height_at: usize,
    scan_header: &'a [u8],
    /// Coded data, without the marker at its end.
    scan: &'a [u8],
}

impl<'a> Parts<'a> {
    fn parse(bytes: &'a [u8]) -> Option<Self> {
        let (mut at, mut height_at) = (2, None);
        loop {
            let (marker, length) = match bytes.get(at..at + 4)? {
                [0xff, marker, high, low] => {
                    (*marker, usize::from(u16::from_be_bytes([*high, *low])))
                }
                _ => return None,
            };
            let end = at + 2 + length;
            if marker == FRAME {
                height_at = Some(at + 5);
            }
            if marker == START_OF_SCAN {
                let scan = bytes.get(end..)?.strip_suffix(&[0xff, 0xd9])?;
                // Another marker would be another scan.
                let plain = scan.windows(2).all(|pair| pair[0] != 0xff || pair[1] == 0);
                let parts = Self {
                    tables: &bytes[..at],
                    height_at: height_at?,
                    scan_header: &bytes[at..end],
                    scan,
                };
                return plain.then_some(parts);
            }
            at = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image([width, height]: [u32; 2]) -> Vec<u8> {
        let pixel = |i: u32| {
            [
                (i % width * 3) as u8,
                (i / width * 5) as u8,
                (i % 7 * 20) as u8,
                255,
            ]
        };
        (0..width * height).flat_map(pixel).collect()
    }

    fn decoded(jpeg: &[u8]) -> (Vec<u8>, [u16; 2]) {
        let mut decoder = jpeg_decoder::Decoder::new(jpeg);
        let pixels = decoder.decode().unwrap();
        let info = decoder.info().unwrap();
        (pixels, [info.width, info.height])
    }

    #[test]
    fn strips_decode_to_what_the_whole_decodes_to() {
        for size in [
            [512, 320],
            [37, 1000],
            [129, 65],
            [1600, 900],
            [16, 64],
            [5, 63],
        ] {
            for quality in [95, 90, 75, 10] {
                let rgba = image(size);
                let (strips, whole) = (
                    encode(&rgba, size, quality).unwrap(),
                    strip(&rgba, size[0] as u16, quality).unwrap(),
                );
                assert_eq!(decoded(&strips).1.map(u32::from), size);
                // Colors of half the resolution are smoothed over rows of the other strip by the
                // decoder alike.
                assert!(decoded(&strips) == decoded(&whole), "{size:?} at {quality}");
                let markers = strips
                    .windows(2)
                    .filter(|pair| pair[0] == 0xff && (RESTART..RESTART + 8).contains(&pair[1]))
                    .count();
                assert_eq!(
                    markers,
                    (size[1] as usize).div_ceil(STRIP_ROWS) - 1,
                    "{size:?} at {quality} is in strips"
                );
            }
        }
    }

    #[test]
    fn what_is_no_jpeg_of_one_scan_is_not_taken_apart() {
        let bytes = strip(&image([32, 16]), 32, 95).unwrap();
        assert!(Parts::parse(&bytes).is_some());
        for length in 0..bytes.len() {
            assert!(Parts::parse(&bytes[..length]).is_none(), "{length}");
        }
        assert!(
            encode(&[0; 4], [70_000, 1], 95)
                .unwrap_err()
                .contains("70000")
        );
    }
}
