//! Files of environment probes: OpenEXR and Radiance HDR.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use decouplegs_scene::light::Probe;
use image::codecs::hdr::HdrDecoder;
use image::codecs::openexr::OpenExrDecoder;
use image::codecs::png::PngDecoder;
use image::{DynamicImage, ImageDecoder};

use crate::error::read_bytes;
use crate::{AssetError, DecodeError, memory};

/// Largest probe that is read; larger ones are offered smaller by all who offer them.
const SIZE_MAX: ImageSize = ImageSize {
    width_px: 8192,
    height_px: 4096,
};

/// Size of an image.
#[derive(Clone, Copy)]
pub(crate) struct ImageSize {
    pub(crate) width_px: u32,
    pub(crate) height_px: u32,
}

/// Most pixels per byte of a file: no compression of these formats makes images of light smaller; a
/// file that claims it is broken.
const PIXELS_PER_BYTE_MAX: u64 = 1024;

/// Reads an OpenEXR or Radiance HDR image from the bytes of its file.
///
/// # Errors
/// Returns an error if they are neither, broken, or larger than 8192 x 4096 px.
pub fn decode(name: impl Into<String>, bytes: &[u8]) -> Result<Probe, DecodeError> {
    if bytes.starts_with(PNG) || !is_image(bytes) {
        let reason = "the first bytes are neither OpenEXR's nor Radiance HDR's; save the probe as .exr or .hdr";
        return Err(DecodeError::Malformed(reason.into()));
    }
    let (width, height, radiance) = decode_rgb(bytes, SIZE_MAX)?;
    Ok(Probe::new(name, width, height, radiance))
}

/// First bytes of an OpenEXR, a Radiance HDR and a PNG file.
const EXR: &[u8] = &[0x76, 0x2f, 0x31, 0x01];
const HDR: &[u8] = b"#?";
const PNG: &[u8] = b"\x89PNG";

fn is_image(bytes: &[u8]) -> bool {
    [EXR, HDR, PNG].iter().any(|first| bytes.starts_with(first))
}

/// Columns, rows and RGB, row-major from the top left, of an OpenEXR, Radiance HDR or PNG image.
/// Values of PNG are 0 to 1, those of the others as they are stored.
///
/// # Errors
/// Returns an error if the bytes are none of these, broken, or the image is larger than `max`.
pub(crate) fn decode_rgb(
    bytes: &[u8],
    max: ImageSize,
) -> Result<(usize, usize, Vec<[f32; 3]>), DecodeError> {
    let broken = |error: image::ImageError| DecodeError::Malformed(error.to_string());
    let image = if bytes.starts_with(EXR) {
        check_exr_windows(bytes, max)?;
        let decoder = OpenExrDecoder::with_alpha_preference(Cursor::new(bytes), Some(false))
            .map_err(broken)?;
        check_size(decoder.dimensions(), bytes.len(), max)?;
        DynamicImage::from_decoder(decoder).map_err(broken)?
    } else if bytes.starts_with(HDR) {
        let decoder = HdrDecoder::new(Cursor::new(bytes)).map_err(broken)?;
        check_size(decoder.dimensions(), bytes.len(), max)?;
        DynamicImage::from_decoder(decoder).map_err(broken)?
    } else if bytes.starts_with(PNG) {
        let decoder = PngDecoder::new(Cursor::new(bytes)).map_err(broken)?;
        check_size(decoder.dimensions(), bytes.len(), max)?;
        DynamicImage::from_decoder(decoder).map_err(broken)?
    } else {
        let reason = "the first bytes are those of no image that is read; save it as .exr or .png";
        return Err(DecodeError::Malformed(reason.into()));
    };
    let rgb = image.into_rgb32f();
    let (width, height) = rgb.dimensions();
    let pixels = rgb.pixels().map(|pixel| pixel.0).collect();
    Ok((width as usize, height as usize, pixels))
}

/// Reads the probe at `path`, named by its file.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Decode`].
pub fn read_probe(path: &Path) -> Result<Probe, AssetError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let decoded = decode(name, &read_bytes(path)?);
    decoded.map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: "light probe",
        source,
    })
}

/// Refuses images whose size their bytes cannot mean.
fn check_size(
    (width, height): (u32, u32),
    file_bytes: usize,
    max: ImageSize,
) -> Result<(), DecodeError> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || width > max.width_px || height > max.height_px {
        let reason = format!(
            "{width} x {height} px; expected 1 x 1 to {} x {}: make it smaller",
            max.width_px, max.height_px
        );
        return Err(DecodeError::Unsupported(reason));
    }
    if pixels > PIXELS_PER_BYTE_MAX * file_bytes as u64 {
        let reason = format!(
            "{width} x {height} px in {file_bytes} bytes: the file is cut short or its size is wrong"
        );
        return Err(DecodeError::Malformed(reason));
    }
    // As it is stored, up to 12 bytes per pixel, and as f32.
    let what = format!("an image of {width} x {height} px");
    memory::require_product(&what, &[pixels], 24)
        .map_err(|error| DecodeError::Malformed(error.into()))
}

/// Data windows may differ from the image's size, and lines of them are unpacked whole.
fn check_exr_windows(bytes: &[u8], max: ImageSize) -> Result<(), DecodeError> {
    let read = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false);
    let meta = read.map_err(|error| DecodeError::Malformed(error.to_string()))?;
    for header in &meta.headers {
        let size = header.layer_size;
        let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
        check_size((side(size.width()), side(size.height())), bytes.len(), max)?;
    }
    Ok(())
}

/// The probes among the files of a folder (`.exr`, `.hdr`), in order of their names.
///
/// # Errors
/// [`AssetError::Read`] when the folder cannot be listed.
pub fn probe_paths(folder: &Path) -> Result<Vec<PathBuf>, AssetError> {
    let refused = |source| AssetError::Read {
        path: folder.to_owned(),
        source,
    };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(refused)? {
        let path = entry.map_err(refused)?.path();
        let extension = path
            .extension()
            .unwrap_or_default()
            .to_string_lossy()
            .to_ascii_lowercase();
        if ["exr", "hdr"].contains(&extension.as_str()) && path.is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}
