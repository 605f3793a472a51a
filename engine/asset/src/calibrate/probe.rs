//! Environment probes: the light that arrives at a place from all around, as lat-long images.

use std::f64::consts::{PI, TAU};
use std::io::Cursor;
use std::path::{Path, PathBuf};

use glam::DVec3;
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

/// Brighter radiance is clamped: beyond a half float's range by far, and sums over pixels stay
/// finite.
const RADIANCE_MAX: f32 = 1e9;

/// Linear radiance from every direction, lat-long.
///
/// World: z up. The top row is the zenith; the middle column is +x, and left of it, as for one who
/// looks along +x, is +y: pixel (u, v) in \[0, 1)² lies at azimuth pi (1 - 2 u) from +x towards +y
/// and at pi v from the zenith.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Name in reports.
    pub name: String,
    width: usize,
    height: usize,
    /// Row-major from the top left, linear RGB, finite and not negative.
    radiance: Vec<[f32; 3]>,
    /// Pixels of the file that held no radiance (NaN, infinite, negative or beyond all reason) and
    /// were clamped.
    pub clamped: usize,
}

impl Probe {
    /// The probe of `radiance`, linear RGB, row-major from the top left.
    ///
    /// # Panics
    /// If there are not `width` times `height` pixels, or none.
    #[must_use]
    pub fn new(
        name: impl Into<String>,
        width: usize,
        height: usize,
        mut radiance: Vec<[f32; 3]>,
    ) -> Self {
        assert!(
            width * height == radiance.len() && !radiance.is_empty(),
            "{width} x {height} px of {}",
            radiance.len()
        );
        let mut clamped = 0;
        for pixel in &mut radiance {
            let kept = pixel.map(|value| {
                if value.is_nan() {
                    0.0
                } else {
                    value.clamp(0.0, RADIANCE_MAX)
                }
            });
            clamped += usize::from(kept != *pixel);
            *pixel = kept;
        }
        Self {
            name: name.into(),
            width,
            height,
            radiance,
            clamped,
        }
    }

    /// A probe of `width` by `width / 2` pixels of what `radiance` is at their middles.
    #[must_use]
    pub fn from_fn(
        name: impl Into<String>,
        width: usize,
        radiance: impl Fn(DVec3) -> [f32; 3],
    ) -> Self {
        let height = (width / 2).max(1);
        let blank = Self {
            name: name.into(),
            width,
            height,
            radiance: Vec::new(),
            clamped: 0,
        };
        let pixels = (0..width * height)
            .map(|pixel| radiance(blank.direction(pixel)))
            .collect();
        Self::new(blank.name, width, height, pixels)
    }

    /// Reads an OpenEXR or Radiance HDR image from the bytes of its file.
    ///
    /// # Errors
    /// When they are neither, broken, or larger than 8192 x 4096 px.
    pub fn decode(name: impl Into<String>, bytes: &[u8]) -> Result<Self, DecodeError> {
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
        Ok(Self::new(name, width as usize, height as usize, radiance))
    }

    /// Reads the probe at `path`, named by its file.
    ///
    /// # Errors
    /// [`AssetError::Read`] or [`AssetError::Decode`].
    pub fn read(path: &Path) -> Result<Self, AssetError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let decoded = Self::decode(name, &read_bytes(path)?);
        decoded.map_err(|source| AssetError::Decode {
            path: path.to_owned(),
            format: "light probe",
            source,
        })
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The linear RGB of all pixels, row-major from the top left.
    #[must_use]
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.radiance
    }

    /// Unit vector to the middle of a pixel, counted row by row.
    #[must_use]
    pub fn direction(&self, pixel: usize) -> DVec3 {
        let (column, row) = (pixel % self.width, pixel / self.width);
        let azimuth = PI * (1.0 - 2.0 * (column as f64 + 0.5) / self.width as f64);
        let from_zenith = PI * (row as f64 + 0.5) / self.height as f64;
        DVec3::new(
            from_zenith.sin() * azimuth.cos(),
            from_zenith.sin() * azimuth.sin(),
            from_zenith.cos(),
        )
    }

    /// Steradians that a pixel covers, exactly; 4 pi over all.
    #[must_use]
    pub fn solid_angle(&self, pixel: usize) -> f64 {
        let row = (pixel / self.width) as f64;
        let edge = |row: f64| (PI * row / self.height as f64).cos();
        TAU / self.width as f64 * (edge(row) - edge(row + 1.0))
    }

    /// Linear RGB radiance from `direction` (any length but zero): that of the pixel it falls in.
    #[must_use]
    pub fn radiance(&self, direction: DVec3) -> [f32; 3] {
        let d = direction.normalize_or(DVec3::Z);
        let u = 0.5 * (1.0 - d.y.atan2(d.x) / PI);
        let v = d.z.clamp(-1.0, 1.0).acos() / PI;
        let place = |share: f64, count: usize| ((share * count as f64) as usize).min(count - 1);
        self.radiance[place(v, self.height) * self.width + place(u, self.width)]
    }

    /// Each pixel: unit vector to its middle, steradians, linear RGB.
    pub fn rays(&self) -> impl Iterator<Item = (DVec3, f64, [f64; 3])> + '_ {
        let ray = |pixel| {
            (
                self.direction(pixel),
                self.solid_angle(pixel),
                self.radiance[pixel].map(f64::from),
            )
        };
        (0..self.radiance.len()).map(ray)
    }

    /// The same light on at most `width` columns: blocks of pixels become their mean by solid
    /// angle, so no light is lost.
    #[must_use]
    pub fn downsampled(&self, width: usize) -> Self {
        let block = self.width.div_ceil(width.max(1));
        if block == 1 {
            return self.clone();
        }
        let (columns, rows) = (self.width.div_ceil(block), self.height.div_ceil(block));
        let mut sums = vec![([0.0f64; 3], 0.0f64); columns * rows];
        for (pixel, rgb) in self.radiance.iter().enumerate() {
            let (column, row) = (pixel % self.width, pixel / self.width);
            // A width that the block does not divide: columns are spread evenly instead.
            let place = row * rows / self.height * columns + column * columns / self.width;
            let weight = self.solid_angle(pixel);
            let (sum, weights) = &mut sums[place];
            (0..3).for_each(|channel| sum[channel] += weight * f64::from(rgb[channel]));
            *weights += weight;
        }
        let radiance = sums
            .iter()
            .map(|(sum, weights)| sum.map(|value| (value / weights) as f32))
            .collect();
        Self {
            clamped: self.clamped,
            ..Self::new(self.name.clone(), columns, rows, radiance)
        }
    }
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
