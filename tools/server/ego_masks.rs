//! Ego masks: what a camera sees of its own vehicle, laid over the images that ask for it.
//!
//! A folder has a folder for each configuration of a rig, with an image for each camera:
//! `RIG/CAMERA.png`, as AlpaSim keeps them in `data/nre-artifacts/ego-hoods` (at 3032e0c). The
//! color of a mask covers the image as far as its alpha says.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use decouplegs_alpasim::wire::sensorsim::EgoMaskId;
use decouplegs_alpasim::wire::sensorsim::available_ego_masks_return::EgoMaskMetadata;

/// Largest side of a mask, pixels.
const SIDE_PX_MAX: u32 = 8192;
/// Sizes of masks that are kept.
const KEPT_MAX: usize = 16;

/// Names a mask: the configuration of the rig, and the camera.
pub type MaskName = (String, String);

/// Masks of a folder. Each is read when an image asks for it.
#[derive(Clone, Debug, Default)]
pub struct EgoMasks {
    files: Arc<BTreeMap<MaskName, PathBuf>>,
    kept: Arc<Mutex<Vec<(MaskName, Overlay)>>>,
}

/// A mask at the size of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Overlay {
    size_px: [u32; 2],
    /// RGBA rows from the top, colors multiplied by alpha.
    rgba: Arc<Vec<u8>>,
}

impl EgoMasks {
    /// The masks in `folder`; none where there is no such folder.
    #[must_use]
    pub fn in_folder(folder: &Path) -> Self {
        let entries = |folder: &Path| std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut files = BTreeMap::new();
        for rig in entries(folder).map(|entry| entry.path()) {
            for file in entries(&rig).map(|entry| entry.path()) {
                let is_png = file.extension().is_some_and(|found| found == "png");
                let name = |path: &Path, of: fn(&Path) -> Option<&std::ffi::OsStr>| {
                    of(path).and_then(|name| name.to_str()).map(str::to_owned)
                };
                let names = (name(&rig, Path::file_name), name(&file, Path::file_stem));
                if let (true, (Some(rig), Some(camera))) = (is_png, names) {
                    files.insert((rig, camera), file);
                }
            }
        }
        Self {
            files: Arc::new(files),
            kept: Arc::default(),
        }
    }

    /// Number of masks.
    #[must_use]
    pub fn count(&self) -> usize {
        self.files.len()
    }

    /// True if there is a mask of that name.
    #[must_use]
    pub fn has(&self, name: &MaskName) -> bool {
        self.files.contains_key(name)
    }

    /// The masks as the contract lists them.
    #[must_use]
    pub fn metadata(&self) -> Vec<EgoMaskMetadata> {
        let listed = |(rig, camera): &MaskName| EgoMaskMetadata {
            ego_mask_id: Some(EgoMaskId {
                camera_logical_id: camera.clone(),
                rig_config_id: rig.clone(),
            }),
        };
        self.files.keys().map(listed).collect()
    }

    /// The mask called `name` for images of `size_px`.
    ///
    /// # Errors
    /// A sentence that names the file at fault.
    pub fn overlay(&self, name: &MaskName, size_px: [u32; 2]) -> Result<Overlay, String> {
        let kept = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let is_same =
            |(own, overlay): &&(MaskName, Overlay)| own == name && overlay.size_px == size_px;
        if let Some((_, overlay)) = kept().iter().find(is_same) {
            return Ok(overlay.clone());
        }
        let path = self.files.get(name).ok_or("there is no such mask")?;
        let (from_px, rgba) =
            read_png(path).map_err(|reason| format!("{}: {reason}", path.display()))?;
        let overlay = Overlay {
            size_px,
            rgba: Arc::new(resized(&premultiplied(rgba), from_px, size_px)),
        };
        let mut kept = kept();
        if kept.len() >= KEPT_MAX {
            kept.remove(0);
        }
        kept.push((name.clone(), overlay.clone()));
        Ok(overlay)
    }
}

impl Overlay {
    /// Lays the mask over an image of its size, RGBA rows from the top.
    pub fn cover(&self, image: &mut [u8]) {
        let pixels = image.as_chunks_mut::<4>().0.iter_mut();
        for (to, mask) in pixels.zip(self.rgba.as_chunks::<4>().0) {
            let left = 255 - u32::from(mask[3]);
            for (value, own) in to[..3].iter_mut().zip(mask) {
                *value = own.saturating_add(((u32::from(*value) * left + 127) / 255) as u8);
            }
        }
    }
}

/// Size and RGBA of an image of 8 or 16 bits with alpha.
fn read_png(path: &Path) -> Result<([u32; 2], Vec<u8>), String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    let limits = png::Limits {
        bytes: 4 * (SIDE_PX_MAX as usize).pow(2),
    };
    let mut decoder = png::Decoder::new_with_limits(BufReader::new(file), limits);
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(|error| error.to_string())?;
    let size_px = [reader.info().width, reader.info().height];
    let (color, _) = reader.output_color_type();
    if size_px.iter().any(|side| *side > SIDE_PX_MAX) || color != png::ColorType::Rgba {
        return Err(format!(
            "{} x {} px of {color:?}; expected RGBA of at most {SIDE_PX_MAX} px a side",
            size_px[0], size_px[1]
        ));
    }
    let bytes = reader.output_buffer_size().ok_or("it is too large")?;
    let mut rgba = vec![0; bytes];
    reader
        .next_frame(&mut rgba)
        .map_err(|error| error.to_string())?;
    Ok((size_px, rgba))
}

fn premultiplied(mut rgba: Vec<u8>) -> Vec<u8> {
    for pixel in rgba.as_chunks_mut::<4>().0 {
        let alpha = u32::from(pixel[3]);
        for value in &mut pixel[..3] {
            *value = ((u32::from(*value) * alpha + 127) / 255) as u8;
        }
    }
    rgba
}

/// `rgba` at another size: each pixel is the mean of the area that it covers.
fn resized(rgba: &[u8], from_px: [u32; 2], to_px: [u32; 2]) -> Vec<u8> {
    if from_px == to_px {
        return rgba.to_vec();
    }
    let [columns, rows] = [0, 1].map(|axis| shares(from_px[axis], to_px[axis]));
    let width = from_px[0] as usize;
    let mut out = Vec::with_capacity(4 * to_px[0] as usize * to_px[1] as usize);
    for row in &rows {
        for column in &columns {
            let mut sums = [0.0f32; 4];
            for &(y, down) in row {
                for &(x, right) in column {
                    let pixel = &rgba[4 * (y * width + x)..];
                    for (sum, value) in sums.iter_mut().zip(pixel) {
                        *sum += down * right * f32::from(*value);
                    }
                }
            }
            out.extend(sums.map(|sum| sum.round() as u8));
        }
    }
    out
}

/// Pixels of a row of `from` that each pixel of a row of `to` covers, and the share of each.
fn shares(from: u32, to: u32) -> Vec<Vec<(usize, f32)>> {
    let step = f64::from(from) / f64::from(to);
    let covered = |index: u32| {
        let (start, end) = (f64::from(index) * step, f64::from(index + 1) * step);
        let last = (end.ceil() as u32).min(from);
        let share = |pixel: u32| {
            let inside = end.min(f64::from(pixel + 1)) - start.max(f64::from(pixel));
            (pixel as usize, (inside / step) as f32)
        };
        (start.floor() as u32..last).map(share).collect()
    };
    (0..to).map(covered).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn masks(rgba: &[u8], [width, height]: [u32; 2]) -> (tempfile::TempDir, EgoMasks) {
        let folder = tempfile::tempdir().unwrap();
        let rig = folder.path().join("sedan");
        std::fs::create_dir(&rig).unwrap();
        let file = File::create(rig.join("front.png")).unwrap();
        let mut encoder = png::Encoder::new(file, width, height);
        encoder.set_color(match rgba.len() == 4 * (width * height) as usize {
            true => png::ColorType::Rgba,
            false => png::ColorType::Rgb,
        });
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(rgba).unwrap();
        writer.finish().unwrap();
        std::fs::write(rig.join("notes.txt"), b"none").unwrap();
        let masks = EgoMasks::in_folder(folder.path());
        (folder, masks)
    }

    fn name() -> MaskName {
        ("sedan".into(), "front".into())
    }

    #[test]
    fn a_mask_covers_as_far_as_its_alpha_says() {
        let rgba = [[200, 100, 0, 255], [200, 100, 0, 0], [100, 100, 100, 128]];
        let (_folder, masks) = masks(rgba.as_flattened(), [3, 1]);
        assert_eq!((masks.count(), masks.has(&name())), (1, true));
        let id = masks.metadata().remove(0).ego_mask_id.unwrap();
        assert_eq!((id.rig_config_id, id.camera_logical_id), name());
        let mut image = [[10, 20, 30, 255]; 3];
        masks
            .overlay(&name(), [3, 1])
            .unwrap()
            .cover(image.as_flattened_mut());
        assert_eq!(image[0], [200, 100, 0, 255]);
        assert_eq!(image[1], [10, 20, 30, 255]);
        assert_eq!(image[2], [55, 60, 65, 255]);
    }

    #[test]
    fn masks_are_fitted_to_their_images_by_area() {
        let column = |x: u8| [10 * x, 0, 0, 255];
        let rgba: Vec<[u8; 4]> = (0..6).map(column).collect();
        let (_folder, masks) = masks(rgba.as_flattened(), [6, 1]);
        let reds = |size_px: [u32; 2]| {
            let mut image = vec![0; 4 * (size_px[0] * size_px[1]) as usize];
            let overlay = masks.overlay(&name(), size_px).unwrap();
            overlay.cover(&mut image);
            assert_eq!(masks.overlay(&name(), size_px).unwrap(), overlay);
            image.iter().step_by(4).copied().collect::<Vec<u8>>()
        };
        assert_eq!(reds([3, 1]), [5, 25, 45]);
        assert_eq!(reds([4, 1]), [3, 17, 33, 47]);
        assert_eq!(reds([6, 2])[6..], [0, 10, 20, 30, 40, 50]);
    }

    #[test]
    fn what_is_no_mask_gets_a_sentence() {
        let (_folder, masks) = masks(&[1, 2, 3], [1, 1]);
        let error = masks.overlay(&name(), [1, 1]).unwrap_err();
        assert!(
            error.contains("front.png") && error.contains("RGBA"),
            "{error}"
        );
        let other = ("sedan".into(), "rear".into());
        assert!(masks.overlay(&other, [1, 1]).is_err());
        assert_eq!(EgoMasks::in_folder(Path::new("nowhere")).count(), 0);
    }
}
