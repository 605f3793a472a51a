//! Images of answers, and how far two of them are apart.

use super::check::{Stop, failed};

/// Image of 8 bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct RgbImage {
    pub(super) width_px: u32,
    pub(super) height_px: u32,
    /// `[height, width, 3]`.
    pub(super) rgb: Vec<u8>,
}

impl RgbImage {
    /// Reads a PNG of 8 bits with or without alpha, which is dropped.
    pub(super) fn of_png(bytes: &[u8]) -> Result<Self, Stop> {
        let fault = |error: png::DecodingError| Stop::Failed(format!("this is no PNG: {error}"));
        let decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        let mut reader = decoder.read_info().map_err(fault)?;
        let size = reader.output_buffer_size().unwrap_or(0);
        if size == 0 || size > super::MESSAGE_BYTES_MAX {
            return failed(format!("a PNG of {size} bytes of pixels"));
        }
        let mut pixels = vec![0; size];
        let frame = reader.next_frame(&mut pixels).map_err(fault)?;
        let channels = match (frame.color_type, frame.bit_depth) {
            (png::ColorType::Rgb, png::BitDepth::Eight) => 3,
            (png::ColorType::Rgba, png::BitDepth::Eight) => 4,
            (color, depth) => {
                return failed(format!(
                    "a PNG of {color:?} with {depth:?} bits; expected RGB with 8"
                ));
            }
        };
        let rgb = pixels
            .chunks_exact(channels)
            .flat_map(|p| [p[0], p[1], p[2]]);
        Ok(Self {
            width_px: frame.width,
            height_px: frame.height,
            rgb: rgb.collect(),
        })
    }

    /// Reads three planes of bytes.
    pub(super) fn of_planes(bytes: &[u8], [width_px, height_px]: [u32; 2]) -> Result<Self, Stop> {
        let pixels = width_px as usize * height_px as usize;
        if bytes.len() != 3 * pixels {
            return failed(format!(
                "{} bytes for {width_px} x {height_px} pixels; expected {}",
                bytes.len(),
                3 * pixels
            ));
        }
        let rgb = (0..pixels).flat_map(|i| [0, 1, 2].map(|channel| bytes[channel * pixels + i]));
        Ok(Self {
            width_px,
            height_px,
            rgb: rgb.collect(),
        })
    }

    /// Reads a JPEG of three channels.
    pub(super) fn of_jpeg(bytes: &[u8]) -> Result<Self, Stop> {
        let mut decoder = jpeg_decoder::Decoder::new(bytes);
        let rgb = match decoder.decode() {
            Ok(rgb) => rgb,
            Err(error) => return failed(format!("this is no JPEG: {error}")),
        };
        let (width_px, height_px) = decoder
            .info()
            .map_or((0, 0), |info| (info.width.into(), info.height.into()));
        if rgb.len() != 3 * width_px as usize * height_px as usize {
            return failed("a JPEG without three channels");
        }
        Ok(Self {
            width_px,
            height_px,
            rgb,
        })
    }

    /// Width and height, pixels.
    pub(super) fn size(&self) -> [u32; 2] {
        [self.width_px, self.height_px]
    }

    /// Mean absolute difference of two images of one size, of 255, in the given rows.
    pub(super) fn difference_in(&self, other: &Self, rows: std::ops::Range<u32>) -> f64 {
        let stride = 3 * self.width_px as usize;
        let range = rows.start as usize * stride..rows.end as usize * stride;
        let (Some(a), Some(b)) = (self.rgb.get(range.clone()), other.rgb.get(range)) else {
            return f64::INFINITY;
        };
        let sum: u64 = a
            .iter()
            .zip(b)
            .map(|(a, b)| u64::from(a.abs_diff(*b)))
            .sum();
        sum as f64 / a.len().max(1) as f64
    }

    /// Mean absolute difference of two images, of 255; infinite where sizes differ.
    pub(super) fn difference(&self, other: &Self) -> f64 {
        if self.size() != other.size() {
            return f64::INFINITY;
        }
        self.difference_in(other, 0..self.height_px)
    }

    /// Standard deviation of all values, of 255: near 0 where an image shows nothing.
    pub(super) fn contrast(&self) -> f64 {
        let count = self.rgb.len().max(1) as f64;
        let mean = self.rgb.iter().map(|&value| f64::from(value)).sum::<f64>() / count;
        let squares = self
            .rgb
            .iter()
            .map(|&value| (f64::from(value) - mean).powi(2));
        (squares.sum::<f64>() / count).sqrt()
    }

    /// The image at half its size: means of 2 x 2 pixels.
    pub(super) fn halved(&self) -> Self {
        let (width_px, height_px) = (self.width_px / 2, self.height_px / 2);
        let stride = 3 * self.width_px as usize;
        let mut rgb = Vec::with_capacity(3 * width_px as usize * height_px as usize);
        for y in 0..height_px as usize {
            for x in 0..width_px as usize {
                for channel in 0..3 {
                    let at = 2 * y * stride + 6 * x + channel;
                    let four = [at, at + 3, at + stride, at + stride + 3];
                    let sum: u16 = four.iter().map(|&at| u16::from(self.rgb[at])).sum();
                    rgb.push(((sum + 2) / 4) as u8);
                }
            }
        }
        Self {
            width_px,
            height_px,
            rgb,
        }
    }

    /// Shift of `other` against this image, pixels to the right and down, by least squares over the
    /// gradients (Lucas and Kanade, "An Iterative Image Registration Technique", 1981, one step):
    /// right for shifts below a pixel. None where there are no gradients.
    pub(super) fn shift_of(&self, other: &Self) -> Option<[f64; 2]> {
        let (width, height) = (self.width_px as usize, self.height_px as usize);
        if self.size() != other.size() || width < 8 || height < 8 {
            return None;
        }
        let gray = |image: &Self| -> Vec<f64> {
            let sums = image.rgb.chunks_exact(3);
            sums.map(|p| p.iter().map(|&value| f64::from(value)).sum())
                .collect()
        };
        let (a, b) = (gray(self), gray(other));
        let (mut xx, mut xy, mut yy, mut xt, mut yt) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for y in 2..height - 2 {
            for x in 2..width - 2 {
                let at = y * width + x;
                let slope = |step: usize| {
                    0.25 * (a[at + step] - a[at - step] + b[at + step] - b[at - step])
                };
                let (dx, dy, dt) = (slope(1), slope(width), b[at] - a[at]);
                xx += dx * dx;
                xy += dx * dy;
                yy += dy * dy;
                xt += dx * dt;
                yt += dy * dt;
            }
        }
        let determinant = xx * yy - xy * xy;
        let solved = [
            -(yy * xt - xy * yt) / determinant,
            -(xx * yt - xy * xt) / determinant,
        ];
        (determinant > 1e-6 * xx * yy && xx * yy > 0.0).then_some(solved)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth pattern, shifted to the right and down.
    fn pattern(right_px: f64, down_px: f64) -> RgbImage {
        let value = |x: f64, y: f64| {
            (127.0 + 60.0 * (0.3 * x).sin() + 60.0 * (0.2 * y + 0.1 * x).cos()) as u8
        };
        let pixel = |i: u32| {
            let (x, y) = (f64::from(i % 64) - right_px, f64::from(i / 64) - down_px);
            [value(x, y); 3]
        };
        RgbImage {
            width_px: 64,
            height_px: 48,
            rgb: (0..64 * 48).flat_map(pixel).collect(),
        }
    }

    #[test]
    fn shifts_below_a_pixel_are_found() {
        for shift in [[0.0, 0.0], [0.5, 0.0], [-0.25, 0.5], [0.05, -0.1]] {
            let found = pattern(0.0, 0.0)
                .shift_of(&pattern(shift[0], shift[1]))
                .unwrap();
            for (found, shift) in found.iter().zip(shift) {
                assert!((found - shift).abs() < 0.02, "{found} {shift}");
            }
        }
        let flat = RgbImage {
            rgb: vec![90; 3 * 64 * 48],
            ..pattern(0.0, 0.0)
        };
        assert_eq!(flat.shift_of(&flat), None);
    }

    #[test]
    fn planes_and_pixels_are_the_same_image() {
        let planes = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12];
        let Ok(image) = RgbImage::of_planes(&planes, [2, 2]) else {
            panic!("three planes of four bytes")
        };
        assert_eq!(image.rgb[..6], [1, 5, 9, 2, 6, 10]);
        assert_eq!(image.halved().rgb, [3, 7, 11]);
        assert!(RgbImage::of_planes(&planes, [3, 2]).is_err());
    }
}
