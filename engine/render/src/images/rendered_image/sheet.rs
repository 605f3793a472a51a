//! Several images as one.

use super::Image;

/// Space around each image of a sheet, pixels.
const GUTTER_PX: u32 = 8;

/// Color between the images: a gray that is neither a night nor a sky.
const GUTTER_RGB: [f32; 3] = [0.12; 3];

/// `images` side by side, `columns` a row (at least one), in cells of the largest width and height,
/// each at the top left of its cell. `None` where there are no images.
#[must_use]
pub fn contact_sheet(images: &[Image], columns: u32) -> Option<Image> {
    let columns = columns.clamp(1, u32::try_from(images.len()).ok()?.max(1));
    let rows = (images.len() as u32).div_ceil(columns);
    let cell_width = images.iter().map(|image| image.width).max()? + GUTTER_PX;
    let cell_height = images.iter().map(|image| image.height).max()? + GUTTER_PX;
    let mut sheet = Image::filled(
        columns * cell_width + GUTTER_PX,
        rows * cell_height + GUTTER_PX,
        GUTTER_RGB,
    );
    for (index, image) in (0u32..).zip(images) {
        let left = GUTTER_PX + index % columns * cell_width;
        let top = GUTTER_PX + index / columns * cell_height;
        for row in 0..image.height {
            let from = row as usize * image.width as usize;
            let to = (top + row) as usize * sheet.width as usize + left as usize;
            let count = image.width as usize;
            sheet.rgb[to..to + count].copy_from_slice(&image.rgb[from..from + count]);
            sheet.alpha[to..to + count].copy_from_slice(&image.alpha[from..from + count]);
        }
    }
    Some(sheet)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_several_sizes_lie_in_cells_of_the_largest() {
        let images = [
            Image::filled(4, 2, [1.0, 0.0, 0.0]),
            Image::filled(3, 5, [0.0, 1.0, 0.0]),
            Image::filled(1, 1, [0.0, 0.0, 1.0]),
        ];
        let sheet = contact_sheet(&images, 2).unwrap();
        assert_eq!((sheet.width, sheet.height), (2 * 12 + 8, 2 * 13 + 8));
        let at = |x: u32, y: u32| sheet.rgb[(y * sheet.width + x) as usize];
        assert_eq!((at(8, 8), at(11, 9)), ([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]));
        assert_eq!(
            (at(12, 9), at(8, 10), at(0, 0)),
            (GUTTER_RGB, GUTTER_RGB, GUTTER_RGB)
        );
        assert_eq!(
            (at(20, 8), at(22, 12), at(8, 21)),
            ([0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
        );
        assert_eq!(at(20, 21), GUTTER_RGB);
    }

    #[test]
    fn no_images_make_no_sheet_and_many_columns_are_not_padded() {
        assert_eq!(contact_sheet(&[], 3), None);
        assert_eq!(
            contact_sheet(&[Image::filled(4, 4, [0.0; 3])], 0)
                .unwrap()
                .width,
            20
        );
        assert_eq!(
            contact_sheet(&[Image::filled(4, 4, [0.0; 3])], 6)
                .unwrap()
                .width,
            20
        );
    }
}
