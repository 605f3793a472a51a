//! PNG of images in bytes.

/// `rgba`, rows from the top, as PNG of three channels, compressed lightly; alpha is not stored.
///
/// # Errors
/// A sentence, when the format cannot hold the size.
pub fn encode(rgba: &[u8], [width_px, height_px]: [u32; 2]) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::with_capacity(rgba.len() / 2);
    let mut encoder = png::Encoder::new(&mut bytes, width_px, height_px);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut rgb = vec![0; 3 * (rgba.len() / 4)];
    rgb.chunks_exact_mut(3)
        .zip(rgba.chunks_exact(4))
        .for_each(|(to, pixel)| to.copy_from_slice(&pixel[..3]));
    let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
    writer
        .write_image_data(&rgb)
        .and_then(|()| writer.finish())
        .map_err(|error| error.to_string())?;
    Ok(bytes)
}
