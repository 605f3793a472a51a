//! Images as bytes of a file, on threads of their own: while one frame is encoded, the next is
//! drawn.

use std::sync::Arc;

use decouplegs_cli::{jpeg, png_bytes};
use rayon::{ThreadPool, ThreadPoolBuilder};
use tonic::Status;

use crate::wire::sensorsim::ImageFormat;

/// Quality of JPEG where a request leaves it at zero.
const QUALITY_DEFAULT: u8 = 95;

/// Encoding of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Lossless, compressed lightly.
    Png,
    /// JPEG, with losses.
    Jpeg {
        /// Quality, 1 to 100.
        quality: u8,
    },
    /// All red bytes, then all green ones, then all blue ones; rows from the top.
    Planar,
}

impl Encoding {
    /// Encoding from `format`, and from `quality` as simulators send it: 0 to 1, or above 1 to 100;
    /// 0 leaves it to us.
    ///
    /// # Errors
    /// UNIMPLEMENTED for formats that there are not, INVALID_ARGUMENT for numbers that are no
    /// format or no quality.
    pub fn from_request(format: i32, quality: f32, field: &str) -> Result<Self, Status> {
        const SUPPORTED: &str = "supported are PNG (1), JPEG (2) and RGB_UINT8_PLANAR (4)";
        match ImageFormat::try_from(format) {
            Ok(ImageFormat::Png) => Ok(Self::Png),
            Ok(ImageFormat::RgbUint8Planar) => Ok(Self::Planar),
            Ok(ImageFormat::Jpeg) => Ok(Self::Jpeg {
                quality: quality_of(quality)?,
            }),
            Ok(ImageFormat::Undefined) => Err(Status::invalid_argument(format!(
                "{field} is not given; {SUPPORTED}"
            ))),
            Ok(other) => Err(Status::unimplemented(format!(
                "{field}: {} is not written; {SUPPORTED}",
                other.as_str_name()
            ))),
            Err(_) => Err(Status::invalid_argument(format!(
                "{field}: {format} is no format; {SUPPORTED}"
            ))),
        }
    }
}

fn quality_of(quality: f32) -> Result<u8, Status> {
    match quality {
        0.0 => Ok(QUALITY_DEFAULT),
        share if share > 0.0 && share <= 1.0 => Ok((100.0 * share).round().max(1.0) as u8),
        percent if percent > 1.0 && percent <= 100.0 => Ok(percent.round() as u8),
        _ => Err(Status::invalid_argument(format!(
            "image_quality: {quality} is neither within 0 to 1 nor within 1 to 100"
        ))),
    }
}

/// The bytes of an image, `rgba` row by row from the top, four bytes per pixel; alpha is not
/// stored.
///
/// # Errors
/// A sentence, when the format cannot hold the size.
pub fn encode(
    rgba: &[u8],
    [width_px, height_px]: [u32; 2],
    encoding: Encoding,
) -> Result<Vec<u8>, String> {
    match encoding {
        Encoding::Planar => {
            let pixels = rgba.len() / 4;
            let mut planes = vec![0; 3 * pixels];
            for (channel, plane) in planes.chunks_exact_mut(pixels.max(1)).enumerate() {
                plane
                    .iter_mut()
                    .zip(rgba.chunks_exact(4))
                    .for_each(|(to, pixel)| *to = pixel[channel]);
            }
            Ok(planes)
        }
        Encoding::Png => png_bytes::encode(rgba, [width_px, height_px]),
        Encoding::Jpeg { quality } => jpeg::encode(rgba, [width_px, height_px], quality),
    }
}

/// Threads that encode.
#[derive(Clone)]
pub struct Encoders {
    threads: Arc<ThreadPool>,
}

impl Encoders {
    /// Encoder with `threads` worker threads; 0: one per processor.
    ///
    /// # Errors
    /// Returns an error if the operating system gives no threads.
    pub fn new(threads: usize) -> anyhow::Result<Self> {
        let name = |index| format!("encode-{index}");
        Ok(Self {
            threads: Arc::new(
                ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .thread_name(name)
                    .build()?,
            ),
        })
    }

    /// Runs `work` on one of the threads.
    pub fn spawn(&self, work: impl FnOnce() + Send + 'static) {
        self.threads.spawn(work);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(size: [u32; 2]) -> Vec<u8> {
        let pixel = |i: u32| {
            [
                (i % size[0] * 3) as u8,
                (i / size[0] * 5) as u8,
                (i % 7 * 20) as u8,
                255,
            ]
        };
        (0..size[0] * size[1]).flat_map(pixel).collect()
    }

    #[test]
    fn png_and_planes_lose_nothing_and_jpeg_little() {
        let size = [37, 23];
        let rgba = image(size);
        let rgb: Vec<u8> = rgba
            .chunks(4)
            .flat_map(|pixel| pixel[..3].to_vec())
            .collect();
        let png = encode(&rgba, size, Encoding::Png).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(png))
            .read_info()
            .unwrap();
        let mut decoded = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut decoded).unwrap();
        assert_eq!(decoded, rgb);
        let planar = encode(&rgba, size, Encoding::Planar).unwrap();
        let pixels = 37 * 23;
        assert_eq!(planar.len(), 3 * pixels);
        for (i, pixel) in rgb.chunks(3).enumerate() {
            assert_eq!(
                [planar[i], planar[pixels + i], planar[2 * pixels + i]],
                pixel
            );
        }
        let jpeg = encode(&rgba, size, Encoding::Jpeg { quality: 95 }).unwrap();
        let mut decoder = jpeg_decoder::Decoder::new(jpeg.as_slice());
        let decoded = decoder.decode().unwrap();
        assert_eq!(
            decoder.info().map(|info| (info.width, info.height)),
            Some((37, 23))
        );
        let off: u64 = decoded
            .iter()
            .zip(&rgb)
            .map(|(a, b)| u64::from(a.abs_diff(*b)))
            .sum();
        assert!(
            (off as f64) < 6.0 * rgb.len() as f64,
            "mean difference {}",
            off as f64 / rgb.len() as f64
        );
    }

    #[test]
    fn quality_is_understood_both_ways() {
        let of = |quality| Encoding::from_request(2, quality, "image_format");
        for (asked, quality) in [
            (95.0, 95),
            (0.95, 95),
            (1.0, 100),
            (100.0, 100),
            (0.0, 95),
            (0.001, 1),
        ] {
            assert_eq!(of(asked).unwrap(), Encoding::Jpeg { quality });
        }
        for nonsense in [f32::NAN, -1.0, 101.0, f32::INFINITY] {
            assert!(
                of(nonsense)
                    .unwrap_err()
                    .message()
                    .contains("image_quality")
            );
        }
    }

    #[test]
    fn formats_that_there_are_not_are_named_with_those_that_there_are() {
        for (format, code) in [
            (0, tonic::Code::InvalidArgument),
            (3, tonic::Code::Unimplemented),
            (99, tonic::Code::InvalidArgument),
        ] {
            let status = Encoding::from_request(format, 0.0, "image_format").unwrap_err();
            assert!(
                status.code() == code && status.message().contains("JPEG (2)"),
                "{status}"
            );
        }
    }
}
