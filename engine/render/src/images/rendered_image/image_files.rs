//! PNG, OpenEXR and JPEG.

use std::io::Cursor;

use exr::meta::{BlockDescription, MetaData};
use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::{DECODER_BYTES_MAX, Image, ImageError, ImageFileFormat, PIXELS_MAX};
use crate::PlaneMap;

/// Most bytes that one byte of a deflated stream can stand for.
const DEFLATE_RATIO_MAX: u64 = 1032;

/// Bytes that a block of an OpenEXR file may always unpack to, however small the file: a tile is
/// larger than a small image.
const BLOCK_BYTES_FREE: usize = 1 << 22;

/// Most pixels that one byte of a JPEG file is believed to stand for: a gray block of 16 by 16
/// takes more than a byte, unless a progressive file leaves thousands of blocks empty.
const JPEG_PIXELS_PER_BYTE_MAX: u64 = 1024;

/// Most pixels that one byte of a file can stand for: one bit each in PNG, three 16-bit channels in
/// OpenEXR.
fn pixels_per_byte_max(format: ImageFileFormat) -> u64 {
    match format {
        ImageFileFormat::Png => DEFLATE_RATIO_MAX * 8,
        ImageFileFormat::Jpeg => JPEG_PIXELS_PER_BYTE_MAX,
        _ => DEFLATE_RATIO_MAX / 6,
    }
}

pub fn decode(format: ImageFileFormat, bytes: &[u8]) -> Result<Image, ImageError> {
    if format == ImageFileFormat::Exr {
        check_exr_sizes(bytes)?;
    }
    let refused = |error: image::ImageError| format.malformed(error.to_string());
    let kind = match format {
        ImageFileFormat::Png => ImageFormat::Png,
        ImageFileFormat::Jpeg => ImageFormat::Jpeg,
        _ => ImageFormat::OpenExr,
    };
    let mut reader = ImageReader::with_format(Cursor::new(bytes), kind);
    let mut limits = Limits::default();
    limits.max_alloc = Some(DECODER_BYTES_MAX);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(refused)?;
    let (width, height) = decoder.dimensions();
    let pixels = u64::from(width) * u64::from(height);
    let believed = pixels_believed(format, bytes);
    if pixels == 0 || pixels > believed {
        return Err(format.malformed(format!(
            "it claims {width}x{height} pixels, and {} bytes of file can hold 1 to {believed}",
            bytes.len()
        )));
    }
    let image = DynamicImage::from_decoder(decoder)
        .map_err(refused)?
        .into_rgba32f();
    Ok(Image {
        width,
        height,
        rgb: image
            .pixels()
            .map(|pixel| [pixel[0], pixel[1], pixel[2]])
            .collect(),
        alpha: image.pixels().map(|pixel| pixel[3]).collect(),
        planes: PlaneMap::new(),
    })
}

fn pixels_believed(format: ImageFileFormat, bytes: &[u8]) -> u64 {
    PIXELS_MAX.min(pixels_per_byte_max(format) * bytes.len() as u64)
}

/// Refuses claims about layers and blocks, which the decoder would take memory for before it looks
/// at the pixels.
fn check_exr_sizes(bytes: &[u8]) -> Result<(), ImageError> {
    let format = ImageFileFormat::Exr;
    let meta = MetaData::read_from_buffered(bytes, false)
        .map_err(|error| format.malformed(error.to_string()))?;
    let believed = pixels_believed(format, bytes) as usize;
    for header in &meta.headers {
        let layer = header.layer_size;
        let block = match header.blocks {
            BlockDescription::Tiles(tiles) => (tiles.tile_size.width(), tiles.tile_size.height()),
            BlockDescription::ScanLines => {
                (layer.width(), header.compression.scan_lines_per_block())
            }
        };
        let block_bytes = block
            .0
            .saturating_mul(block.1)
            .saturating_mul(header.channels.bytes_per_pixel);
        let block_bytes_max =
            BLOCK_BYTES_FREE.max(believed.saturating_mul(header.channels.bytes_per_pixel));
        if layer.width().saturating_mul(layer.height()) > believed || block_bytes > block_bytes_max
        {
            return Err(format.malformed(format!(
                "it claims a layer of {}x{} pixels in blocks of {}x{}, more than {} bytes of file can hold",
                layer.width(),
                layer.height(),
                block.0,
                block.1,
                bytes.len()
            )));
        }
    }
    Ok(())
}

pub fn encode_png(image: &Image) -> Result<Vec<u8>, ImageError> {
    let levels: Vec<u8> = image.rgb.iter().flatten().copied().map(level).collect();
    encode(
        image,
        ImageFileFormat::Png,
        ImageFormat::Png,
        &levels,
        ColorType::Rgb8,
    )
}

/// The bytes of a PNG file of red, green and blue of an image of `size_px`, width and height, whose
/// `rgba` are four bytes per pixel, rows from the top.
///
/// # Errors
/// [`ImageError::Encoding`] if the size is none, or `rgba` has another number of bytes.
pub fn encode_rgba_as_png(size_px: [u32; 2], rgba: &[u8]) -> Result<Vec<u8>, ImageError> {
    let [width, height] = size_px;
    let refused = |message: String| ImageError::Encoding {
        format: ImageFileFormat::Png,
        width,
        height,
        message,
    };
    let expected = 4 * u64::from(width) * u64::from(height);
    if rgba.len() as u64 != expected {
        let found = rgba.len();
        return Err(refused(format!(
            "expected {expected} bytes of RGBA, found {found}"
        )));
    }
    let rgb: Vec<u8> = rgba
        .chunks_exact(4)
        .flat_map(|pixel| [pixel[0], pixel[1], pixel[2]])
        .collect();
    let mut file = Cursor::new(Vec::new());
    image::write_buffer_with_format(
        &mut file,
        &rgb,
        width,
        height,
        ColorType::Rgb8,
        ImageFormat::Png,
    )
    .map_err(|error| refused(error.to_string()))?;
    Ok(file.into_inner())
}

/// RGBA as the PNG specification has it, colors not premultiplied.
pub fn encode_png_with_alpha(image: &Image) -> Result<Vec<u8>, ImageError> {
    let straight = |(rgb, alpha): (&[f32; 3], &f32)| {
        let [r, g, b] = rgb.map(|premultiplied| {
            if *alpha > 0.0 {
                level(premultiplied / alpha)
            } else {
                0
            }
        });
        [r, g, b, level(*alpha)]
    };
    let levels: Vec<u8> = image
        .rgb
        .iter()
        .zip(&image.alpha)
        .flat_map(straight)
        .collect();
    encode(
        image,
        ImageFileFormat::Png,
        ImageFormat::Png,
        &levels,
        ColorType::Rgba8,
    )
}

/// `value` of 0 to 1 as 8 bits.
fn level(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

pub fn encode_exr(image: &Image) -> Result<Vec<u8>, ImageError> {
    let bytes: Vec<u8> = image
        .interleaved_rgba()
        .iter()
        .flat_map(|value| value.to_ne_bytes())
        .collect();
    encode(
        image,
        ImageFileFormat::Exr,
        ImageFormat::OpenExr,
        &bytes,
        ColorType::Rgba32F,
    )
}

fn encode(
    image: &Image,
    format: ImageFileFormat,
    kind: ImageFormat,
    samples: &[u8],
    color: ColorType,
) -> Result<Vec<u8>, ImageError> {
    let mut file = Cursor::new(Vec::new());
    image::write_buffer_with_format(&mut file, samples, image.width, image.height, color, kind)
        .map_err(|error| ImageError::Encoding {
            format,
            width: image.width,
            height: image.height,
            message: error.to_string(),
        })?;
    Ok(file.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The header of a PNG that claims to be very large, and no pixels.
    fn boastful_png() -> Vec<u8> {
        let mut bytes = Image::filled(1, 1, [0.0; 3])
            .encode(ImageFileFormat::Png)
            .unwrap();
        bytes[16..24].copy_from_slice(&[0, 0, 0xff, 0xff, 0, 0, 0xff, 0xff]);
        // The checksum of the chunk that was changed (ISO 3309), or the claim would not be
        // examined.
        let mut crc = !0u32;
        for &byte in &bytes[12..29] {
            crc ^= u32::from(byte);
            for _ in 0..8 {
                crc = (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
            }
        }
        bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
        bytes
    }

    /// A gray JPEG of 8 by 8 pixels.
    fn jpeg() -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let gray = image::GrayImage::from_pixel(8, 8, image::Luma([100]));
        gray.write_to(&mut bytes, ImageFormat::Jpeg).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn photographs_are_read_and_damaged_ones_refused() {
        let bytes = jpeg();
        let image = decode(ImageFileFormat::Jpeg, &bytes).unwrap();
        assert_eq!((image.width, image.height, image.alpha[0]), (8, 8, 1.0));
        let is_gray = |rgb: &[f32; 3]| rgb.iter().all(|value| (value - 100.0 / 255.0).abs() < 0.01);
        assert!(image.rgb.iter().all(is_gray), "{:?}", image.rgb[0]);
        // Whatever is cut off or changed, it answers.
        for length in 0..bytes.len() {
            let _ = decode(ImageFileFormat::Jpeg, &bytes[..length]);
            let mut damaged = bytes.clone();
            damaged[length] ^= 0x55;
            let _ = decode(ImageFileFormat::Jpeg, &damaged);
        }
        // Height and width behind the length and the depth of the frame's header.
        let mut boastful = bytes;
        let frame = boastful
            .windows(2)
            .position(|pair| pair == [0xff, 0xc0])
            .unwrap();
        boastful[frame + 5..frame + 9].fill(0xff);
        let error = decode(ImageFileFormat::Jpeg, &boastful)
            .unwrap_err()
            .to_string();
        assert!(error.contains("65535x65535"), "{error}");
        let written = image.encode(ImageFileFormat::Jpeg).unwrap_err().to_string();
        assert!(written.contains("read and not written"), "{written}");
    }

    #[test]
    fn a_claim_that_the_file_cannot_hold_is_refused_before_memory_is_taken() {
        let error = decode(ImageFileFormat::Png, &boastful_png())
            .unwrap_err()
            .to_string();
        assert!(error.contains("65535x65535"), "{error}");
    }

    #[test]
    fn a_layer_or_tile_that_the_file_cannot_hold_is_refused_before_memory_is_taken() {
        let bytes = Image::filled(5, 3, [0.3; 3])
            .encode(ImageFileFormat::Exr)
            .unwrap();
        let offset_of = |name: &[u8]| {
            bytes
                .windows(name.len())
                .position(|window| window == name)
                .unwrap()
                + name.len()
        };
        for (attribute, offset) in [
            (&b"dataWindow\0box2i\0"[..], 4 + 8),
            (b"tiles\0tiledesc\0", 4),
        ] {
            let mut boastful = bytes.clone();
            let at = offset_of(attribute) + offset;
            boastful[at..at + 4].copy_from_slice(&0x0fff_0000u32.to_le_bytes());
            let error = decode(ImageFileFormat::Exr, &boastful)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains("more than") && error.contains("26836992"),
                "{error}"
            );
        }
    }

    #[test]
    fn the_strongest_compression_is_still_believed() {
        let flat = Image::filled(4000, 2000, [0.25; 3]);
        for format in [ImageFileFormat::Png, ImageFileFormat::Exr] {
            assert_eq!(
                decode(format, &flat.encode(format).unwrap())
                    .unwrap()
                    .rgb
                    .len(),
                8_000_000,
                "{format}"
            );
        }
    }
}
