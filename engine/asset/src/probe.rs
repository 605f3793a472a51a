//! Files of environment probes: OpenEXR and Radiance HDR.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use decouplegs_scene::light::Probe;
use image::codecs::hdr::HdrDecoder;
use image::codecs::openexr::OpenExrDecoder;
use image::{DynamicImage, ImageDecoder};

use crate::error::read_bytes;
use crate::{AssetError, DecodeError};

/// Largest probe that is read, pixels; larger ones are offered smaller by all who offer them.
const WIDTH_MAX_PX: u32 = 8192;
const HEIGHT_MAX_PX: u32 = 4096;

/// No compression of these formats makes images of light so small; a file that claims it is broken.
const PIXELS_PER_BYTE_MAX: u64 = 1024;

/// Reads an OpenEXR or Radiance HDR image from the bytes of its file.
///
/// # Errors
/// Returns an error if they are neither, broken, or larger than 8192 x 4096 px.
pub fn decode(name: impl Into<String>, bytes: &[u8]) -> Result<Probe, DecodeError> {
    let broken = |error: image::ImageError| DecodeError::Malformed(error.to_string());
    let image = if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        check_exr_windows(bytes)?;
        let decoder = OpenExrDecoder::with_alpha_preference(Cursor::new(bytes), Some(false))
            .map_err(broken)?;
        check_size(decoder.dimensions(), bytes.len())?;
        DynamicImage::from_decoder(decoder).map_err(broken)?
    } else if bytes.starts_with(b"#?") {
        let decoder = HdrDecoder::new(Cursor::new(bytes)).map_err(broken)?;
        check_size(decoder.dimensions(), bytes.len())?;
        DynamicImage::from_decoder(decoder).map_err(broken)?
    } else {
        let reason = "the first bytes are neither OpenEXR's nor Radiance HDR's; save the probe as .exr or .hdr";
        return Err(DecodeError::Malformed(reason.into()));
    };
    let rgb = image.into_rgb32f();
    let (width, height) = rgb.dimensions();
    let radiance = rgb.pixels().map(|pixel| pixel.0).collect();
    Ok(Probe::new(name, width as usize, height as usize, radiance))
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
fn check_size((width, height): (u32, u32), file_bytes: usize) -> Result<(), DecodeError> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || width > WIDTH_MAX_PX || height > HEIGHT_MAX_PX {
        let reason = format!(
            "{width} x {height} px; expected 1 x 1 to {WIDTH_MAX_PX} x {HEIGHT_MAX_PX}: make it smaller"
        );
        return Err(DecodeError::Unsupported(reason));
    }
    if pixels > PIXELS_PER_BYTE_MAX * file_bytes as u64 {
        let reason = format!(
            "{width} x {height} px in {file_bytes} bytes: the file is cut short or its size is wrong"
        );
        return Err(DecodeError::Malformed(reason));
    }
    Ok(())
}

/// Data windows may differ from the image's size, and lines of them are unpacked whole.
fn check_exr_windows(bytes: &[u8]) -> Result<(), DecodeError> {
    let read = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false);
    let meta = read.map_err(|error| DecodeError::Malformed(error.to_string()))?;
    for header in &meta.headers {
        let size = header.layer_size;
        let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
        check_size((side(size.width()), side(size.height())), bytes.len())?;
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
