//! Images as PNG files.

use std::io::Write;
use std::path::Path;

use decouplegs_asset::write_atomically;
use decouplegs_render::rendered_image::encode_rgba_as_png;

use crate::{HostImages, SessionError};

/// Writes an image of `size_px`, width and height, to a PNG file at `path`: red, green and blue of
/// each pixel, as `render` does. `rgba` has four bytes per pixel, rows from the top. The file is
/// there whole or not at all, and replaces one that was there.
///
/// # Errors
/// [`SessionError::Image`] where the bytes are not as many as the size says, and
/// [`SessionError::Asset`] where the file cannot be written.
pub fn save_png(path: &Path, size_px: [u32; 2], rgba: &[u8]) -> Result<(), SessionError> {
    let bytes = encode_rgba_as_png(size_px, rgba)?;
    Ok(write_atomically(path, |file| file.write_all(&bytes))?)
}

impl HostImages {
    /// Writes the image of camera `camera` of view `view` to a PNG file at `path`, as [`save_png`]
    /// does.
    ///
    /// # Errors
    /// Returns the errors of [`save_png`].
    ///
    /// # Panics
    /// Panics if there is no such view or camera.
    pub fn save_png(&self, view: usize, camera: usize, path: &Path) -> Result<(), SessionError> {
        save_png(path, self.size_px(view, camera), self.rgba(view, camera))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_render::Image;

    #[test]
    fn colors_are_kept_and_other_sizes_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let rgba: Vec<u8> = (0..6 * 4).map(|byte| 10 * byte).collect();
        save_png(&path, [3, 2], &rgba).unwrap();
        let image = Image::read(&path).unwrap();
        assert_eq!((image.width, image.height), (3, 2));
        for (pixel, rgb) in image.rgb.iter().enumerate() {
            let expected = [0, 1, 2].map(|channel| f32::from(rgba[4 * pixel + channel]) / 255.0);
            assert_eq!(rgb, &expected);
        }
        let refused = save_png(&path, [3, 3], &rgba).unwrap_err().to_string();
        assert!(
            refused.contains("36") && refused.contains("24"),
            "{refused}"
        );
        let absent = folder.path().join("none/a.png");
        let refused = save_png(&absent, [3, 2], &rgba).unwrap_err().to_string();
        assert!(refused.contains("none/a.png"), "{refused}");
    }
}
