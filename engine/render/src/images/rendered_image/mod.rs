//! Images: what a render returns, and the files they are kept in.
//!
//! Values are display-referred RGB as blended: the sky is in them, nothing is clamped. Only PNG
//! clamps and rounds.

pub mod exposure;
mod image_files;
mod npy;
mod preview;
mod sheet;

pub use image_files::encode_rgba_as_png;
pub use preview::{distance_color, preview};
pub use sheet::contact_sheet;

use std::path::{Path, PathBuf};

use crate::plane::{Plane, PlaneMap, PlaneValues};

/// Most pixels a file may hold, 8192 x 8192: 1 GiB of RGBA in f32.
const PIXELS_MAX: u64 = 1 << 26;
/// Most bytes that a decoder may take: 64 bits for each pixel, and as much for what it works with.
const DECODER_BYTES_MAX: u64 = 1 << 30;

/// An image in f32, row-major from the top left; every array holds `width * height` entries.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels a row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// Color as blended: unclamped, background color included.
    pub rgb: Vec<[f32; 3]>,
    /// 1 - the transmittance left for the sky.
    pub alpha: Vec<f32>,
    /// The planes that were asked for.
    pub planes: PlaneMap,
}

/// The files an image can be kept in. None of them holds planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFileFormat {
    /// RGB, 8 bits: clamped to 0 to 1 and rounded to nearest. No alpha.
    Png,
    /// OpenEXR, RGBA as f32.
    Exr,
    /// NumPy: little-endian float32 `[height, width, 4]` in C order, RGB and alpha.
    Npy,
    /// JPEG, 8 bits: photographs, which are read and not written.
    Jpeg,
}

/// Reason why an image could not be read or encoded.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file could not be read at all.
    #[error("{}: cannot read the image: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The name tells no format.
    #[error("{}: expected an image named *.png, *.jpg, *.exr or *.npy", path.display())]
    Extension {
        /// The file.
        path: PathBuf,
    },
    /// The bytes are not such an image.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Error in its bytes.
        source: Box<Self>,
    },
    /// The bytes are not an image of the format.
    #[error("not a usable {format} image: {message}")]
    Malformed {
        /// The format expected.
        format: ImageFileFormat,
        /// Value expected and value found.
        message: String,
    },
    /// The encoder refused the image.
    #[error("cannot encode {width}x{height} pixels as {format}: {message}")]
    Encoding {
        /// The format asked for.
        format: ImageFileFormat,
        /// Pixels a row.
        width: u32,
        /// Number of rows.
        height: u32,
        /// Message of the encoder.
        message: String,
    },
}

impl ImageFileFormat {
    /// The format of an image that is written, by its name's extension in any case of letters.
    #[must_use]
    pub fn of_path(path: &Path) -> Option<Self> {
        Self::of_image(path).filter(|format| *format != Self::Jpeg)
    }

    /// The format of an image that is read, likewise.
    #[must_use]
    pub fn of_image(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        if extension == "jpeg" {
            return Some(Self::Jpeg);
        }
        [Self::Png, Self::Exr, Self::Npy, Self::Jpeg]
            .into_iter()
            .find(|format| format.extension() == extension)
    }

    /// File name extension of this format, without the dot.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Exr => "exr",
            Self::Npy => "npy",
            Self::Jpeg => "jpg",
        }
    }

    fn malformed(self, message: impl Into<String>) -> ImageError {
        ImageError::Malformed {
            format: self,
            message: message.into(),
        }
    }
}

impl std::fmt::Display for ImageFileFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.extension())
    }
}

impl Image {
    /// An image of one opaque color, without planes.
    #[must_use]
    pub fn filled(width: u32, height: u32, rgb: [f32; 3]) -> Self {
        let count = width as usize * height as usize;
        Self {
            width,
            height,
            rgb: vec![rgb; count],
            alpha: vec![1.0; count],
            planes: PlaneMap::new(),
        }
    }

    /// Reads an image; its name's extension tells the format. Alpha is 1 where the file has none.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, its name tells no format, or its bytes are not
    /// such an image.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let format = ImageFileFormat::of_image(path)
            .ok_or_else(|| ImageError::Extension { path: path.into() })?;
        let unreadable = |source| ImageError::Unreadable {
            path: path.into(),
            source,
        };
        // A device may have no end, and a FIFO may block forever.
        if std::fs::metadata(path).map_err(unreadable)?.is_file() {
            let bytes = std::fs::read(path).map_err(unreadable)?;
            return Self::decode(format, &bytes).map_err(|source| ImageError::File {
                path: path.into(),
                source: Box::new(source),
            });
        }
        Err(unreadable(std::io::Error::other("expected a regular file")))
    }

    /// The image in the bytes of a file. Never allocates more than the length of `bytes` can
    /// account for.
    ///
    /// # Errors
    /// Returns an error if the bytes are not an image of that format.
    pub fn decode(format: ImageFileFormat, bytes: &[u8]) -> Result<Self, ImageError> {
        match format {
            ImageFileFormat::Png | ImageFileFormat::Exr | ImageFileFormat::Jpeg => {
                image_files::decode(format, bytes)
            }
            ImageFileFormat::Npy => npy::decode(bytes),
        }
    }

    /// The bytes of a file of that format.
    ///
    /// # Errors
    /// Returns an error if the encoder refuses the image's size, or the format is only read.
    pub fn encode(&self, format: ImageFileFormat) -> Result<Vec<u8>, ImageError> {
        match format {
            ImageFileFormat::Png => image_files::encode_png(self),
            ImageFileFormat::Exr => image_files::encode_exr(self),
            ImageFileFormat::Npy => Ok(npy::encode(self)),
            ImageFileFormat::Jpeg => Err(ImageError::Encoding {
                format,
                width: self.width,
                height: self.height,
                message: "JPEG is read and not written".into(),
            }),
        }
    }

    /// [`Image::encode`], for an image over a black sky that is to be laid over another: PNG holds
    /// alpha too, its colors divided by it; the other formats hold colors premultiplied by alpha,
    /// as blended, as they always do.
    ///
    /// # Errors
    /// Returns an error if the encoder refuses the image's size.
    pub fn encode_with_alpha(&self, format: ImageFileFormat) -> Result<Vec<u8>, ImageError> {
        match format {
            ImageFileFormat::Png => image_files::encode_png_with_alpha(self),
            _ => self.encode(format),
        }
    }

    /// [`Plane::Depth`], meters; `None` where it was not asked for.
    #[must_use]
    pub fn depth(&self) -> Option<&[f32]> {
        self.planes.get(&Plane::Depth)?.as_f32()
    }

    /// [`Plane::DepthMedian`], meters; `None` where it was not asked for.
    #[must_use]
    pub fn depth_median(&self) -> Option<&[f32]> {
        self.planes.get(&Plane::DepthMedian)?.as_f32()
    }

    /// [`Plane::Instance`]; `None` where it was not asked for.
    #[must_use]
    pub fn instance(&self) -> Option<&[u16]> {
        self.planes.get(&Plane::Instance)?.as_u16()
    }

    /// `plane` as a NumPy file: float32 or uint16 `[height, width]`, or `[height, width, channels]`
    /// where a pixel has several values. `None` where it was not asked for.
    #[must_use]
    pub fn encode_plane(&self, plane: Plane) -> Option<Vec<u8>> {
        Some(match self.planes.get(&plane)? {
            PlaneValues::F32(values) => npy::encode_plane(
                self,
                plane.channels(),
                "<f4",
                values.iter().flat_map(|value| value.to_le_bytes()),
            ),
            PlaneValues::U16(values) => npy::encode_plane(
                self,
                plane.channels(),
                "<u2",
                values.iter().flat_map(|value| value.to_le_bytes()),
            ),
        })
    }

    /// RGBA of every pixel, interleaved: `[height, width, 4]`.
    fn interleaved_rgba(&self) -> Vec<f32> {
        self.rgb
            .iter()
            .zip(&self.alpha)
            .flat_map(|(&[r, g, b], &a)| [r, g, b, a])
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(super) fn sample(width: u32, height: u32) -> Image {
        let count = (width * height) as usize;
        let ramp = |k: usize| (k as f32 * 0.37).sin() * 1.3;
        Image {
            rgb: (0..count)
                .map(|i| [ramp(3 * i), ramp(3 * i + 1), ramp(3 * i + 2)])
                .collect(),
            alpha: (0..count).map(|i| i as f32 / count as f32).collect(),
            ..Image::filled(width, height, [0.0; 3])
        }
    }

    #[test]
    fn float_formats_bring_back_the_same_bits() {
        for (width, height) in [(1, 1), (7, 5), (33, 2)] {
            let image = sample(width, height);
            for format in [ImageFileFormat::Exr, ImageFileFormat::Npy] {
                assert_eq!(
                    Image::decode(format, &image.encode(format).unwrap()).unwrap(),
                    image,
                    "{format}"
                );
            }
        }
    }

    #[test]
    fn png_clamps_and_rounds_to_the_nearest_level() {
        let half_level = 0.5 / 255.0;
        let mut image = Image::filled(3, 1, [-0.5, 0.0, half_level - 1e-4]);
        image.rgb[1] = [half_level + 1e-4, 100.0 / 255.0, 254.6 / 255.0];
        image.rgb[2] = [1.0, 7.5, f32::NAN];
        let back = Image::decode(
            ImageFileFormat::Png,
            &image.encode(ImageFileFormat::Png).unwrap(),
        )
        .unwrap();
        let levels: Vec<f32> = back
            .rgb
            .iter()
            .flatten()
            .map(|value| value * 255.0)
            .collect();
        assert_eq!(
            levels.iter().map(|level| level.round()).collect::<Vec<_>>(),
            [0.0, 0.0, 0.0, 1.0, 100.0, 255.0, 255.0, 255.0, 0.0]
        );
        assert!(back.alpha.iter().all(|&alpha| alpha == 1.0));
    }

    #[test]
    fn a_transparent_png_holds_colors_that_are_not_premultiplied() {
        let mut image = Image::filled(2, 2, [0.1, 0.2, 0.25]);
        image.alpha = vec![0.25, 0.0, 1.0, 0.5];
        image.rgb[1] = [0.0; 3];
        let back = Image::decode(
            ImageFileFormat::Png,
            &image.encode_with_alpha(ImageFileFormat::Png).unwrap(),
        )
        .unwrap();
        let levels = |values: &[f32]| {
            values
                .iter()
                .map(|value| (value * 255.0).round())
                .collect::<Vec<_>>()
        };
        assert_eq!(levels(&back.alpha), [64.0, 0.0, 255.0, 128.0]);
        let expected = [
            102.0, 204.0, 255.0, 0.0, 0.0, 0.0, 26.0, 51.0, 64.0, 51.0, 102.0, 128.0,
        ];
        assert_eq!(levels(back.rgb.as_flattened()), expected);
        for format in [ImageFileFormat::Exr, ImageFileFormat::Npy] {
            assert_eq!(
                image.encode_with_alpha(format).unwrap(),
                image.encode(format).unwrap(),
                "{format}"
            );
        }
    }

    #[test]
    fn cut_and_flipped_files_are_errors_and_never_a_panic() {
        let image = sample(5, 3);
        for format in [
            ImageFileFormat::Png,
            ImageFileFormat::Exr,
            ImageFileFormat::Npy,
        ] {
            let bytes = image.encode(format).unwrap();
            for length in 0..bytes.len() {
                // A PNG is complete before its last chunk, which holds nothing.
                if let Ok(read) = Image::decode(format, &bytes[..length]) {
                    assert!(
                        format == ImageFileFormat::Png && length >= bytes.len() - 12,
                        "{format} cut to {length} bytes was read"
                    );
                    assert_eq!((read.width, read.height), (5, 3));
                }
            }
            for bit in 0..bytes.len() * 8 {
                let mut flipped = bytes.clone();
                flipped[bit / 8] ^= 1 << (bit % 8);
                // Many flips leave an image, of other values; what matters is that all of them
                // return.
                if let Ok(read) = Image::decode(format, &flipped) {
                    assert_eq!(read.rgb.len(), (read.width * read.height) as usize);
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn damage_anywhere_is_an_error_or_an_image(
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
            cut in any::<prop::sample::Index>(),
            tail in prop::collection::vec(any::<u8>(), 0..40),
        ) {
            for format in [ImageFileFormat::Png, ImageFileFormat::Exr, ImageFileFormat::Npy] {
                let mut bytes = sample(7, 4).encode(format).unwrap();
                for (index_of, byte) in &changes {
                    let at = index_of.index(bytes.len());
                    bytes[at] = *byte;
                }
                bytes.truncate(cut.index(bytes.len() * 2));
                bytes.extend(&tail);
                if let Ok(read) = Image::decode(format, &bytes) {
                    prop_assert!(read.rgb.len() == read.width as usize * read.height as usize && read.alpha.len() == read.rgb.len());
                }
            }
        }

        #[test]
        fn noise_behind_a_format_s_first_bytes_is_refused(noise in prop::collection::vec(any::<u8>(), 0..400)) {
            for format in [ImageFileFormat::Png, ImageFileFormat::Exr, ImageFileFormat::Npy] {
                let magic = &sample(1, 1).encode(format).unwrap()[..8];
                prop_assert!(Image::decode(format, &[magic, &noise].concat()).is_err());
                prop_assert!(Image::decode(format, &noise).is_err());
            }
        }
    }

    #[test]
    fn errors_name_the_file_and_what_was_expected() {
        let folder = std::env::temp_dir().join(format!("decouplegs-image-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("broken.npy");
        std::fs::write(&path, b"no image").unwrap();
        let message = Image::read(&path).unwrap_err().to_string();
        assert!(
            message.contains("broken.npy") && message.contains("NUMPY"),
            "{message}"
        );
        assert!(
            Image::read(&folder.join("a.tiff"))
                .unwrap_err()
                .to_string()
                .contains("*.png")
        );
        assert!(
            Image::read(&folder.join("absent.png"))
                .unwrap_err()
                .to_string()
                .contains("absent.png")
        );
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
