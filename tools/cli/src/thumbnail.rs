//! Images small enough for a page.

use decouplegs_render::rendered_image::Image;

/// `image` at `1 / n` of its size, each pixel the mean of `n` by `n`, for the least n that makes it
/// at most `width_px` wide.
pub fn thumbnail(image: &Image, width_px: u32) -> Image {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_image_is_the_means_of_blocks() {
        let mut image = Image::filled(5, 4, [0.0; 3]);
        image
            .rgb
            .iter_mut()
            .enumerate()
            .for_each(|(at, rgb)| rgb[1] = at as f32);
        let small = thumbnail(&image, 3);
        assert_eq!(
            (small.width, small.height, small.rgb[0][1], small.rgb[3][1]),
            (2, 2, 3.0, 15.0)
        );
        assert_eq!(thumbnail(&image, 5), image);
        assert_eq!(thumbnail(&Image::filled(9, 1, [1.0; 3]), 2).height, 1);
    }
}
