//! Images inside a page.

use anyhow::Result;
use decouplegs::render::rendered_image::{Image, ImageFileFormat};

/// `image` as a PNG in a `data:` address.
pub fn png(image: &Image) -> Result<String> {
    Ok(format!(
        "data:image/png;base64,{}",
        base64(&image.encode(ImageFileFormat::Png)?)
    ))
}

/// `image` at `1 / n` of its size, each pixel the mean of `n` by `n`, for the least n that makes it
/// at most `width_px` wide.
pub fn shrunk(image: &Image, width_px: u32) -> Image {
    let n = image
        .width
        .div_ceil(width_px)
        .clamp(1, image.width.min(image.height));
    let (width, height) = (image.width / n, image.height / n);
    let pixel = |column: u32, row: u32| -> [f32; 3] {
        let block =
            (0..n * n).map(|at| ((row * n + at / n) * image.width + column * n + at % n) as usize);
        let sum = block.fold([0.0; 3], |sum: [f32; 3], at| {
            std::array::from_fn(|channel| sum[channel] + image.rgb[at][channel])
        });
        sum.map(|value| value / (n * n) as f32)
    };
    let rgb = (0..height)
        .flat_map(|row| (0..width).map(move |column| (column, row)))
        .map(|(column, row)| pixel(column, row))
        .collect();
    Image {
        rgb,
        ..Image::filled(width, height, [0.0; 3])
    }
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let word = (0..3).fold(0u32, |word, at| {
            word << 8 | u32::from(group.get(at).copied().unwrap_or(0))
        });
        for digit in 0..4 {
            let value = word >> (18 - 6 * digit) & 63;
            text.push(if digit <= group.len() {
                char::from(DIGITS[value as usize])
            } else {
                '='
            });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_rfc() {
        let vectors = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
        ];
        for (bytes, text) in vectors {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[0xff, 0xfe, 0xfd]), "//79");
    }

    #[test]
    fn a_small_image_is_the_means_of_blocks() {
        let mut image = Image::filled(5, 4, [0.0; 3]);
        image
            .rgb
            .iter_mut()
            .enumerate()
            .for_each(|(at, rgb)| rgb[1] = at as f32);
        let small = shrunk(&image, 3);
        assert_eq!(
            (small.width, small.height, small.rgb[0][1], small.rgb[3][1]),
            (2, 2, 3.0, 15.0)
        );
        assert_eq!(shrunk(&image, 5), image);
        assert_eq!(shrunk(&Image::filled(9, 1, [1.0; 3]), 2).height, 1);
    }
}
