//! Photographs and the cameras that took them.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use decouplegs::asset::cameras::file_safe;
use decouplegs::render::rendered_image::{Image, ImageFileFormat};
use decouplegs::scene::Camera;

use crate::thumbnail::thumbnail;

/// Shapes that differ by less count as one.
const SHAPE_TOLERANCE: f64 = 0.01;

/// A photograph, and the camera that took it at the photograph's size.
pub struct Photograph {
    /// Name of its view.
    pub name: String,
    pub camera: Camera,
    pub image: Image,
    /// True for pixels that count.
    pub counts: Vec<bool>,
}

impl Photograph {
    /// The photograph at half the size.
    pub fn half_size(&self) -> Image {
        thumbnail(&self.image, self.image.width.div_ceil(2))
    }

    /// Share of the pixels in `rectangle` (left, top, width, height) that count.
    pub fn counted(&self, [left, top, width, height]: &[f64; 4]) -> f64 {
        let range = |from: f64, length: f64, side: u32| {
            let end = (from + length).ceil().clamp(0.0, f64::from(side)) as usize;
            (from.floor().max(0.0) as usize).min(end)..end
        };
        let columns = range(*left, *width, self.image.width);
        let rows = range(*top, *height, self.image.height);
        let pixels = rows.len() * columns.len();
        let row = |row: usize| &self.counts[row * self.image.width as usize..][columns.clone()];
        let counted = rows.flat_map(row).filter(|counts| **counts).count();
        counted as f64 / pixels.max(1) as f64
    }
}

/// A photograph that is not read yet.
pub struct Found {
    pub name: String,
    file: PathBuf,
    mask: Option<PathBuf>,
    camera: Camera,
}

/// Folders below the one that is given, at most: of cameras, of sequences.
const DEPTH_MAX: usize = 4;
/// Ending of the names of masks.
const MASK: &str = "_mask";

/// Names that a camera file may have for the image in `file`: of the file alone, and with the
/// folders that it is in.
fn names_of(file: &Path) -> Vec<String> {
    let parts: Vec<&str> = file.iter().filter_map(|part| part.to_str()).collect();
    let last = parts.len().saturating_sub(DEPTH_MAX)..parts.len();
    last.map(|first| file_safe(&parts[first..].join("/")))
        .collect()
}

/// The images in `folder` and those below it, in the order of their names.
fn images_in(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<()> {
    let unreadable = || format!("cannot read the folder {}", folder.display());
    let entries = fs::read_dir(folder).with_context(unreadable)?;
    let entries = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<std::io::Result<Vec<_>>>();
    let mut paths = entries.with_context(unreadable)?;
    paths.sort();
    for path in paths {
        if path.is_dir() && depth < DEPTH_MAX {
            images_in(&path, depth + 1, found)?;
        } else if ImageFileFormat::of_image(&path).is_some() && path.is_file() {
            found.push(path);
        }
    }
    Ok(())
}

/// The photographs in `folder` of those `views` that `chosen` names, or of all; in the order of the
/// views.
///
/// # Errors
/// Returns an error if there is none, one that is named is absent, or two are of one view.
pub fn find(folder: &Path, views: &[Camera], chosen: Option<&[String]>) -> Result<Vec<Found>> {
    let mut files = Vec::new();
    images_in(folder, 0, &mut files)?;
    let is_mask = |file: &PathBuf| {
        let stem = file.file_stem().and_then(|stem| stem.to_str());
        stem.is_some_and(|stem| stem.ends_with(MASK))
    };
    files.retain(|file| !is_mask(file));
    let mut named: HashMap<String, Vec<&PathBuf>> = HashMap::new();
    for file in &files {
        for name in names_of(file) {
            named.entry(name).or_default().push(file);
        }
    }
    let mut found = Vec::new();
    let mut used = HashSet::new();
    for camera in views {
        let Some(of_view) = named.get(&camera.name) else {
            continue;
        };
        let names = names_of(of_view[0]);
        if chosen.is_some_and(|chosen| !chosen.iter().any(|name| names.contains(name))) {
            continue;
        }
        ensure!(
            of_view.len() == 1,
            "{} and {} are both named as the view {}",
            of_view[0].display(),
            of_view[1].display(),
            camera.name
        );
        used.extend(names);
        let file = of_view[0].clone();
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let mask = file.with_file_name(format!("{stem}{MASK}.png"));
        found.push(Found {
            name: camera.name.clone(),
            mask: mask.is_file().then_some(mask),
            camera: camera.clone(),
            file,
        });
    }
    for name in chosen.unwrap_or_default() {
        ensure!(
            used.contains(name),
            "no photograph of a view named {name} is in {}",
            folder.display()
        );
    }
    ensure!(
        !found.is_empty(),
        "{} has no photograph of any of the {} views, the first of which is named {:?}: photographs are named as their views, .png or .jpg",
        folder.display(),
        views.len(),
        views.first().map_or("", |view| &view.name)
    );
    Ok(found)
}

/// Names of photographs in a text file, one per line.
///
/// # Errors
/// Returns an error if the file cannot be read or names none.
pub fn names_in(file: &Path) -> Result<Vec<String>> {
    let text =
        fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let stem = |line: &str| {
        let named = Path::new(line.trim());
        named
            .file_stem()
            .map(|stem| stem.to_string_lossy().into_owned())
    };
    let names: Vec<String> = text.lines().filter_map(stem).collect();
    ensure!(
        !names.is_empty(),
        "{} names no photograph: write one name per line",
        file.display()
    );
    Ok(names)
}

impl Found {
    /// Reads the photograph, and its mask where there is one: black where pixels do not count.
    ///
    /// # Errors
    /// Returns an error if a file is no image, or has another shape than the camera or the mask.
    pub fn read(&self) -> Result<Photograph> {
        let image = Image::read(&self.file)?;
        let camera = &self.camera.intrinsics;
        let shape = |width: u32, height: u32| f64::from(width) / f64::from(height);
        let (own, wanted) = (
            shape(image.width, image.height),
            shape(camera.width_px, camera.height_px),
        );
        ensure!(
            (own / wanted - 1.0).abs() < SHAPE_TOLERANCE,
            "{} has {}x{} pixels, and its camera takes {}x{}: another shape",
            self.file.display(),
            image.width,
            image.height,
            camera.width_px,
            camera.height_px
        );
        let counts = match &self.mask {
            None => vec![true; image.rgb.len()],
            Some(file) => {
                let mask = Image::read(file)?;
                ensure!(
                    (mask.width, mask.height) == (image.width, image.height),
                    "{} has {}x{} pixels, and its photograph {}x{}",
                    file.display(),
                    mask.width,
                    mask.height,
                    image.width,
                    image.height
                );
                mask.rgb.iter().map(|rgb| rgb[0] > 0.5).collect()
            }
        };
        Ok(Photograph {
            name: self.name.clone(),
            camera: Camera {
                intrinsics: camera.resized(image.width, image.height),
                ..self.camera.clone()
            },
            image,
            counts,
        })
    }
}
