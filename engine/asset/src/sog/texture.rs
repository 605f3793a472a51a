//! A lossless WebP image as bytes.

use std::io::Cursor;

use image_webp::{ColorType, EncoderParams, WebPDecoder, WebPEncoder};

use crate::{DecodeError, EncodeError};

/// Pixels of 3 or 4 bytes, row by row.
pub(super) struct Texture {
    pub(super) width: usize,
    pub(super) height: usize,
    channels: usize,
    bytes: Vec<u8>,
}

impl Texture {
    /// Decodes the image `name`, of `pixels_min` to `pixels_max` pixels. Nothing is decoded before
    /// its size is examined.
    pub(super) fn decode(
        name: &str,
        file: &[u8],
        pixels_min: u64,
        pixels_max: u64,
    ) -> Result<Self, DecodeError> {
        let malformed =
            |message: String| DecodeError::Malformed(format!("image '{name}' {message}"));
        let broken =
            |error: image_webp::DecodingError| malformed(format!("is no readable WebP: {error}"));
        let mut decoder = WebPDecoder::new(Cursor::new(file)).map_err(broken)?;
        if decoder.is_lossy() || decoder.is_animated() {
            return Err(malformed(
                "is not lossless WebP; its bytes are data, which lossy coding destroys".into(),
            ));
        }
        let (width, height) = decoder.dimensions();
        let pixels = u64::from(width) * u64::from(height);
        if !(pixels_min..=pixels_max.max(pixels_min)).contains(&pixels) {
            return Err(malformed(format!(
                "has {width} x {height} pixels, expected {pixels_min} to {pixels_max}"
            )));
        }
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        decoder.set_memory_limit(8 * pixels as usize + (1 << 20));
        let mut bytes = vec![0; pixels as usize * channels];
        decoder.read_image(&mut bytes).map_err(broken)?;
        Ok(Self {
            width: width as usize,
            height: height as usize,
            channels,
            bytes,
        })
    }

    /// Red, green, blue and alpha of one pixel; 255 where there is no alpha.
    pub(super) fn at(&self, pixel: usize) -> [u8; 4] {
        let start = pixel * self.channels;
        let alpha = if self.channels == 4 {
            self.bytes[start + 3]
        } else {
            255
        };
        [
            self.bytes[start],
            self.bytes[start + 1],
            self.bytes[start + 2],
            alpha,
        ]
    }
}

/// `pixels` as a lossless WebP of `width` columns; the last row is filled up with zeros. Pixels are
/// stored as differences from the row above where these take fewer bytes.
pub(super) fn encode(mut pixels: Vec<[u8; 4]>, width: usize) -> Result<Vec<u8>, EncodeError> {
    let height = pixels.len().div_ceil(width).max(1);
    pixels.resize(width * height, [0; 4]);
    let encoded = |use_predictor_transform: bool| {
        let mut file = Vec::new();
        let mut encoder = WebPEncoder::new(&mut file);
        let mut parameters = EncoderParams::default();
        parameters.use_predictor_transform = use_predictor_transform;
        encoder.set_params(parameters);
        let (bytes, color) = (pixels.as_flattened(), ColorType::Rgba8);
        let result = encoder.encode(bytes, width as u32, height as u32, color);
        result.map(|()| file)
    };
    let (plain, predicted) = rayon::join(|| encoded(false), || encoded(true));
    let failed = |error| {
        EncodeError(format!(
            "an image of {width} x {height} pixels: {error}; write fewer splats"
        ))
    };
    let (plain, predicted) = (plain.map_err(failed)?, predicted.map_err(failed)?);
    Ok(match plain.len() < predicted.len() {
        true => plain,
        false => predicted,
    })
}
