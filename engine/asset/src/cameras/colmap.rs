//! COLMAP sparse models: `cameras` and `images`, as text or binary (colmap.github.io, Output
//! Format).
//!
//! An image's pose is camera from world, with OpenCV axes; pixels are counted from the corner of
//! the first one, as here. Points are not read.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use decouplegs_scene::lens::{Fisheye, OpenCv};
use decouplegs_scene::{Camera, Intrinsics, Lens, Motion, Pose};
use glam::{DQuat, DVec3};

use crate::error::read_bytes;
use crate::{AssetError, DecodeError};

/// Folders of a dataset in which a model is looked for, the given one first.
const FOLDERS: [&str; 4] = ["", "sparse/0", "0", "sparse"];
/// Names of the camera models by their numbers in binary files, and the number of their parameters.
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];
/// Bytes of a point in a binary image: x, y, number.
const POINT_BYTES: u64 = 24;
/// Longest name of an image.
const NAME_BYTES_MAX: usize = 4096;

/// Reads the cameras of the model in `folder`, or in its `sparse/0`: one for each image, sorted by
/// name.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Cameras`].
pub(super) fn read_folder(folder: &Path) -> Result<Vec<Camera>, AssetError> {
    let found = FOLDERS
        .iter()
        .flat_map(|inner| ["bin", "txt"].map(|form| (folder.join(inner), form)));
    let model = found
        .into_iter()
        .find(|(folder, form)| folder.join(format!("cameras.{form}")).is_file());
    let Some((folder, form)) = model else {
        let message = "it has neither cameras.bin nor cameras.txt, nor has its sparse/0; expected a COLMAP model or a camera file";
        return Err(AssetError::Cameras {
            path: folder.to_owned(),
            source: DecodeError::Malformed(message.into()),
        });
    };
    let file = |name: &str| -> Result<(PathBuf, Vec<u8>), AssetError> {
        let path = folder.join(format!("{name}.{form}"));
        let bytes = read_bytes(&path)?;
        Ok((path, bytes))
    };
    let (lenses_path, lenses) = file("cameras")?;
    let (images_path, images) = file("images")?;
    let is_binary = form == "bin";
    let lenses = decode_lenses(&lenses, is_binary).map_err(|source| AssetError::Cameras {
        path: lenses_path,
        source,
    })?;
    decode_images(&images, &lenses, is_binary).map_err(|source| AssetError::Cameras {
        path: images_path,
        source,
    })
}

/// Reads the cameras of a model from the bytes of its two files.
pub(super) fn decode(
    lenses: &[u8],
    images: &[u8],
    is_binary: bool,
) -> Result<Vec<Camera>, DecodeError> {
    decode_images(images, &decode_lenses(lenses, is_binary)?, is_binary)
}

fn decode_lenses(bytes: &[u8], is_binary: bool) -> Result<Lenses, DecodeError> {
    if is_binary {
        lenses_of_binary(bytes)
    } else {
        lenses_of_text(bytes)
    }
}

fn decode_images(
    bytes: &[u8],
    lenses: &Lenses,
    is_binary: bool,
) -> Result<Vec<Camera>, DecodeError> {
    if is_binary {
        images_of_binary(bytes, lenses)
    } else {
        images_of_text(bytes, lenses)
    }
}

/// Intrinsics by the number of the camera, or a sentence that says why they are not drawn: it
/// counts only if an image uses the camera.
type Lenses = HashMap<u32, Result<Intrinsics, String>>;

/// Reads `cameras.txt`.
fn lenses_of_text(bytes: &[u8]) -> Result<Lenses, DecodeError> {
    let mut lenses = Lenses::new();
    for (number, line) in lines(bytes)?.filter(|(_, line)| !line.is_empty()) {
        let fault = |reason: &str| DecodeError::Malformed(format!("line {number}: {reason}"));
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let [id, model, width, height, parameters @ ..] = words.as_slice() else {
            return Err(fault("expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS"));
        };
        let parameters: Option<Vec<f64>> =
            parameters.iter().map(|word| word.parse().ok()).collect();
        let (Ok(id), Ok(width), Ok(height), Some(parameters)) =
            (id.parse(), width.parse(), height.parse(), parameters)
        else {
            return Err(fault(
                "expected whole numbers for id, width and height, and numbers behind them",
            ));
        };
        let lens = intrinsics(model, [width, height], &parameters);
        lenses.insert(id, lens.map_err(|reason| fault(&reason).to_string()));
    }
    Ok(lenses)
}

/// Reads `cameras.bin`.
fn lenses_of_binary(bytes: &[u8]) -> Result<Lenses, DecodeError> {
    let mut reader = Reader {
        rest: bytes,
        what: "cameras.bin",
    };
    let mut lenses = Lenses::new();
    for _ in 0..reader.u64()? {
        let (id, model) = (reader.u32()?, reader.u32()?);
        let size = [reader.u64()?, reader.u64()?];
        let Some((name, count)) = MODELS.get(model as usize) else {
            return Err(DecodeError::Unsupported(format!(
                "camera {id}: model number {model} is unknown"
            )));
        };
        let parameters = (0..*count)
            .map(|_| reader.f64())
            .collect::<Result<Vec<f64>, _>>()?;
        lenses.insert(id, intrinsics(name, size, &parameters));
    }
    Ok(lenses)
}

fn intrinsics(
    model: &str,
    [width, height]: [u64; 2],
    parameters: &[f64],
) -> Result<Intrinsics, String> {
    let known = MODELS
        .iter()
        .find(|(name, _)| *name == model)
        .ok_or_else(|| format!("camera model {model:.40} is unknown"))?;
    if parameters.len() != known.1 {
        return Err(format!(
            "{model} has {} parameters, found {}",
            known.1,
            parameters.len()
        ));
    }
    let size = |side: u64| {
        u32::try_from(side)
            .map_err(|_| format!("an image has 1 to 65536 pixels a side, found {side}"))
    };
    let with =
        |focal_px: [f64; 2], center_px: [f64; 2], lens: Lens| -> Result<Intrinsics, String> {
            let lens = if lens.is_pinhole() {
                Lens::Pinhole
            } else {
                lens
            };
            let size_px = [size(width)?, size(height)?];
            Ok(Intrinsics {
                lens,
                ..Intrinsics::pinhole(size_px, focal_px, center_px)
            })
        };
    let open_cv = |radial: [f64; 6], tangential: [f64; 2]| {
        Lens::OpenCv(OpenCv {
            radial,
            tangential,
            ..OpenCv::default()
        })
    };
    let fisheye = |radial: [f64; 4]| {
        Lens::Fisheye(Fisheye {
            radial,
            ..Fisheye::default()
        })
    };
    match (model, parameters) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => with([f, f], [cx, cy], Lens::Pinhole),
        ("PINHOLE", &[fx, fy, cx, cy]) => with([fx, fy], [cx, cy], Lens::Pinhole),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => with(
            [f, f],
            [cx, cy],
            open_cv([k, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
        ),
        ("RADIAL", &[f, cx, cy, k1, k2]) => with(
            [f, f],
            [cx, cy],
            open_cv([k1, k2, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
        ),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => with(
            [fx, fy],
            [cx, cy],
            open_cv([k1, k2, 0.0, 0.0, 0.0, 0.0], [p1, p2]),
        ),
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => with(
            [fx, fy],
            [cx, cy],
            open_cv([k1, k2, k3, k4, k5, k6], [p1, p2]),
        ),
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
            with([fx, fy], [cx, cy], fisheye([k1, k2, k3, k4]))
        }
        ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => {
            with([f, f], [cx, cy], fisheye([k, 0.0, 0.0, 0.0]))
        }
        ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => {
            with([f, f], [cx, cy], fisheye([k1, k2, 0.0, 0.0]))
        }
        ("SIMPLE_FISHEYE", &[f, cx, cy]) => with([f, f], [cx, cy], fisheye([0.0; 4])),
        ("FISHEYE", &[fx, fy, cx, cy]) => with([fx, fy], [cx, cy], fisheye([0.0; 4])),
        _ => Err(format!(
            "camera model {model} is not drawn: undistort the images first (colmap image_undistorter)"
        )),
    }
}

/// Reads `images.txt`: two lines per image, the second with its points, which may be empty.
fn images_of_text(bytes: &[u8], lenses: &Lenses) -> Result<Vec<Camera>, DecodeError> {
    let mut cameras = Vec::new();
    let mut lines = lines(bytes)?;
    while let Some((number, line)) = lines.next() {
        if line.is_empty() {
            continue;
        }
        let fault = |reason: String| DecodeError::Malformed(format!("line {number}: {reason}"));
        // Any white space parts the columns; the name is the rest of the line, blanks within.
        let (mut words, mut rest) = (Vec::new(), line);
        while words.len() < 9
            && let Some((word, more)) = rest.split_once(|letter: char| letter.is_ascii_whitespace())
        {
            words.push(word);
            rest = more.trim_start();
        }
        words.push(rest);
        let [_, pose @ .., lens, name] = words.as_slice() else {
            return Err(fault("expected ten columns".into()));
        };
        let pose: Option<Vec<f64>> = pose.iter().map(|word| word.parse().ok()).collect();
        let (Some(&[w, x, y, z, tx, ty, tz]), Ok(lens)) = (pose.as_deref(), lens.parse()) else {
            return Err(fault(
                "expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME".into(),
            ));
        };
        cameras.push(camera(name, [w, x, y, z], [tx, ty, tz], lens, lenses).map_err(fault)?);
        // The line of its points.
        lines.next();
    }
    Ok(sorted(cameras))
}

/// Reads `images.bin`.
fn images_of_binary(bytes: &[u8], lenses: &Lenses) -> Result<Vec<Camera>, DecodeError> {
    let mut reader = Reader {
        rest: bytes,
        what: "images.bin",
    };
    let mut cameras = Vec::new();
    for _ in 0..reader.u64()? {
        reader.u32()?;
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = reader.f64()?;
        }
        let lens = reader.u32()?;
        let name = reader.text()?;
        let points = reader.u64()?;
        reader.take(points.saturating_mul(POINT_BYTES))?;
        let [w, x, y, z, tx, ty, tz] = numbers;
        cameras.push(
            camera(&name, [w, x, y, z], [tx, ty, tz], lens, lenses)
                .map_err(DecodeError::Malformed)?,
        );
    }
    Ok(sorted(cameras))
}

fn camera(
    name: &str,
    [w, x, y, z]: [f64; 4],
    t: [f64; 3],
    lens: u32,
    lenses: &Lenses,
) -> Result<Camera, String> {
    let intrinsics = lenses
        .get(&lens)
        .ok_or_else(|| format!("image '{name:.60}': there is no camera {lens}"))?
        .clone()
        .map_err(|reason| format!("image '{name:.60}': camera {lens}: {reason}"))?;
    let (rotation, translation) = (DQuat::from_xyzw(x, y, z, w), DVec3::from_array(t));
    let no_motion = || format!("image '{name:.60}': its pose is no rigid motion");
    if !(translation.is_finite() && (1e-12..1e12).contains(&rotation.length_squared())) {
        return Err(no_motion());
    }
    let world_from_camera = Pose::new(rotation.normalize(), translation).inverse();
    if !world_from_camera.translation.is_finite() {
        return Err(no_motion());
    }
    Ok(Camera {
        name: name.to_owned(),
        intrinsics,
        world_from_camera,
        motion: Motion::REST,
    })
}

fn sorted(mut cameras: Vec<Camera>) -> Vec<Camera> {
    cameras.sort_by(|a, b| a.name.cmp(&b.name));
    cameras
}

/// Lines with their numbers, without comments. Empty lines stay: points of an image may be an empty
/// line.
fn lines(bytes: &[u8]) -> Result<impl Iterator<Item = (usize, &str)>, DecodeError> {
    let text = std::str::from_utf8(bytes)
        .map_err(|error| DecodeError::Malformed(format!("not UTF-8: {error}")))?;
    let numbered = text
        .lines()
        .enumerate()
        .map(|(index, line)| (index + 1, line.trim()));
    Ok(numbered.filter(|(_, line)| !line.starts_with('#')))
}

/// Little-endian numbers, one after the other.
struct Reader<'a> {
    rest: &'a [u8],
    what: &'static str,
}

impl<'a> Reader<'a> {
    fn take(&mut self, length: u64) -> Result<&'a [u8], DecodeError> {
        let split = usize::try_from(length)
            .ok()
            .and_then(|length| self.rest.split_at_checked(length));
        let Some((taken, rest)) = split else {
            let (expected_bytes, found_bytes) = (length, self.rest.len() as u64);
            return Err(DecodeError::Truncated {
                what: self.what.into(),
                expected_bytes,
                found_bytes,
            });
        };
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let bytes = self.take(N as u64)?;
        Ok(std::array::from_fn(|at| bytes[at]))
    }

    fn u32(&mut self) -> Result<u32, DecodeError> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, DecodeError> {
        self.array().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, DecodeError> {
        self.array().map(f64::from_le_bytes)
    }

    /// Text up to a NUL.
    fn text(&mut self) -> Result<String, DecodeError> {
        let end = self
            .rest
            .iter()
            .take(NAME_BYTES_MAX)
            .position(|&byte| byte == 0);
        let end = end.ok_or_else(|| {
            DecodeError::Malformed(format!("{}: the name of an image has no end", self.what))
        })?;
        let text = String::from_utf8_lossy(self.take(end as u64)?).into_owned();
        self.take(1)?;
        Ok(text)
    }
}

#[cfg(test)]
mod tests;
