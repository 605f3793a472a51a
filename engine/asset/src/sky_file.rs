//! Files of skies: cubes of six faces and lat-long images, as OpenEXR or PNG.

use std::io::{Cursor, Write};
use std::path::Path;

use decouplegs_scene::SkyMap;
use decouplegs_scene::sky::FACE_TEXELS_MAX;
use glam::{DMat3, DVec3};
use image::{ImageFormat, Rgb32FImage};

use crate::probe::{ImageSize, decode_rgb};
use crate::sky_bundle::{self, SkyBundle};
use crate::{AssetError, DecodeError, SceneSky, memory, write_atomically};

/// Layout of a sky's image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SkyKind {
    /// Six square faces, one below the other: see [`SkyMap`] for their order and directions.
    Cube,
    /// Lat-long: the top row is +z of the sky's frame, the middle column +x, and left of it +y.
    Equirect,
    /// Cube of Instant NuRec, with calibrations of its cameras.
    Npz,
}

impl SkyKind {
    /// All layouts.
    pub const ALL: [Self; 3] = [Self::Cube, Self::Equirect, Self::Npz];

    /// Name in scene files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cube => "cube",
            Self::Equirect => "equirect",
            Self::Npz => "npz",
        }
    }
}

/// Largest images of skies, pixels.
const SIZE_MAX: ImageSize = ImageSize {
    width_px: 8192,
    height_px: 6 * FACE_TEXELS_MAX as u32,
};

/// Reads a sky from the bytes of its file, display-referred RGB.
///
/// Lat-long images become cubes whose faces have a quarter of their columns: each texel is the mean
/// of four samples, interpolated linearly.
///
/// # Errors
/// Returns an error if the file is no OpenEXR or PNG image, or no `.npz` of a sky, is broken or too
/// large, has other sides than `kind` needs, or `world_from_sky` is neither a rotation nor a
/// reflection.
pub fn decode(bytes: &[u8], kind: SkyKind, world_from_sky: DMat3) -> Result<SkyMap, DecodeError> {
    if kind == SkyKind::Npz {
        return Ok(sky_bundle::decode(bytes, world_from_sky)?.sky);
    }
    let (width, height, rgb) = decode_rgb(bytes, SIZE_MAX)?;
    let wrong = |expected: &str| {
        DecodeError::Malformed(format!(
            "{width} x {height} px; expected {expected} for a sky of kind \"{}\"",
            kind.name()
        ))
    };
    let sky = match kind {
        SkyKind::Cube => {
            if height != 6 * width || width > FACE_TEXELS_MAX {
                return Err(wrong(&format!(
                    "six square faces of at most {FACE_TEXELS_MAX} px, one below the other,"
                )));
            }
            SkyMap::new(width, &rgb, world_from_sky)
        }
        SkyKind::Equirect => {
            if width != 2 * height {
                return Err(wrong("twice as many columns as rows"));
            }
            if let Some(bad) = rgb
                .as_flattened()
                .iter()
                .position(|value| !value.is_finite())
            {
                let reason = format!("pixel {} is not finite; expected display RGB", bad / 3);
                return Err(DecodeError::Malformed(reason));
            }
            let face_texels = (width / 4).clamp(1, FACE_TEXELS_MAX);
            let texels = 6 * (face_texels as u64 + 2).pow(2);
            memory::require_product("the cube of a sky", &[texels], 24)
                .map_err(|error| DecodeError::Malformed(error.into()))?;
            let image = LatLong { width, height, rgb };
            SkyMap::from_fn(face_texels, world_from_sky, |direction| {
                image.color(direction)
            })
        }
        SkyKind::Npz => unreachable!("read above"),
    };
    sky.map_err(|reason| DecodeError::Malformed(reason.into()))
}

/// Reads the sky of a scene file from the bytes of its file, and the calibrations of cameras that
/// are with it.
pub(crate) fn decode_sky(bytes: &[u8], sky: &SceneSky) -> Result<SkyBundle, DecodeError> {
    let mut decoded = match sky.kind {
        SkyKind::Npz => sky_bundle::decode(bytes, sky.world_from_sky)?,
        kind => SkyBundle::of_sky(decode(bytes, kind, sky.world_from_sky)?),
    };
    (decoded.sky.clamps, decoded.sky.clamps_splats) = (sky.clamps, sky.clamps_splats);
    Ok(decoded)
}

/// Writes the six faces of a cube, `face_texels` squared each, as an OpenEXR image that
/// [`SkyKind::Cube`] reads.
///
/// # Errors
/// [`AssetError::Write`].
///
/// # Panics
/// Panics if there are not the texels of six faces.
pub fn write_cube(path: &Path, face_texels: usize, texels: &[[f32; 3]]) -> Result<(), AssetError> {
    let (width, height) = (face_texels as u32, 6 * face_texels as u32);
    let image = Rgb32FImage::from_vec(width, height, texels.as_flattened().to_vec());
    let image = image.expect("six faces have the texels of an image of their height");
    let mut bytes = Cursor::new(Vec::new());
    write_atomically(path, |file| {
        image
            .write_to(&mut bytes, ImageFormat::OpenExr)
            .map_err(std::io::Error::other)?;
        file.write_all(bytes.get_ref())
    })
}

/// A lat-long image.
struct LatLong {
    width: usize,
    height: usize,
    rgb: Vec<[f32; 3]>,
}

impl LatLong {
    /// Color in the unit `direction`, interpolated linearly; columns wrap around, the rows at the
    /// poles end there.
    fn color(&self, direction: DVec3) -> [f64; 3] {
        use std::f64::consts::PI;
        let u = 0.5 - direction.y.atan2(direction.x) / (2.0 * PI);
        let v = direction.z.clamp(-1.0, 1.0).acos() / PI;
        let (x, y) = (u * self.width as f64 - 0.5, v * self.height as f64 - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (right_share, bottom_share) = (x - left, y - top);
        let column = |offset: f64| (left + offset).rem_euclid(self.width as f64) as usize;
        let row = |offset: f64| (top + offset).clamp(0.0, (self.height - 1) as f64) as usize;
        let at = |row: usize, column: usize| {
            self.rgb[row * self.width + column.min(self.width - 1)].map(f64::from)
        };
        let corners = [
            (
                at(row(0.0), column(0.0)),
                (1.0 - right_share) * (1.0 - bottom_share),
            ),
            (
                at(row(0.0), column(1.0)),
                right_share * (1.0 - bottom_share),
            ),
            (
                at(row(1.0), column(0.0)),
                (1.0 - right_share) * bottom_share,
            ),
            (at(row(1.0), column(1.0)), right_share * bottom_share),
        ];
        std::array::from_fn(|channel| {
            corners
                .iter()
                .map(|(rgb, weight)| rgb[channel] * weight)
                .sum()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exr_of(width: u32, height: u32, rgb: impl Fn(u32, u32) -> [f32; 3]) -> Vec<u8> {
        let image = Rgb32FImage::from_fn(width, height, |x, y| image::Rgb(rgb(x, y)));
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::OpenExr).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn a_cube_is_read_back_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sky.exr");
        let texels: Vec<[f32; 3]> = (0..6 * 9)
            .map(|texel| [texel as f32, -0.25, 0.5 * texel as f32])
            .collect();
        write_cube(&path, 3, &texels).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let found = decode(&bytes, SkyKind::Cube, DMat3::IDENTITY).unwrap();
        let expected = SkyMap::new(3, &texels, DMat3::IDENTITY).unwrap();
        assert_eq!(found, expected);
    }

    #[test]
    fn a_lat_long_sky_has_its_compass() {
        // Red ahead (+x), green left (+y), blue above, by the middle of their regions.
        let bytes = exr_of(64, 32, |x, y| match (x, y) {
            (_, 0..8) => [0.0, 0.0, 1.0],
            (24..40, 8..24) => [1.0, 0.0, 0.0],
            (8..24, 8..24) => [0.0, 1.0, 0.0],
            _ => [0.0; 3],
        });
        let sky = decode(&bytes, SkyKind::Equirect, DMat3::IDENTITY).unwrap();
        assert_eq!(sky.face_texels(), 16);
        for (axis, color) in [
            (DVec3::X, [1.0, 0.0, 0.0]),
            (DVec3::Y, [0.0, 1.0, 0.0]),
            (DVec3::Z, [0.0, 0.0, 1.0]),
            (-DVec3::X, [0.0; 3]),
            (-DVec3::Y, [0.0; 3]),
            (-DVec3::Z, [0.0; 3]),
        ] {
            assert_eq!(sky.color(axis), color, "{axis}");
        }
    }

    #[test]
    fn png_is_read_and_other_shapes_are_refused_with_their_size() {
        let mut bytes = Cursor::new(Vec::new());
        image::RgbImage::from_pixel(2, 12, image::Rgb([255, 0, 51]))
            .write_to(&mut bytes, ImageFormat::Png)
            .unwrap();
        let png = bytes.into_inner();
        let sky = decode(&png, SkyKind::Cube, DMat3::IDENTITY).unwrap();
        let found = sky.color(DVec3::ONE);
        assert!((found[0] - 1.0).abs() + found[1].abs() + (found[2] - 0.2).abs() < 1e-6);
        let error = |bytes: &[u8], kind| {
            let error = decode(bytes, kind, DMat3::IDENTITY).unwrap_err();
            error.to_string()
        };
        assert!(error(&png, SkyKind::Equirect).contains("2 x 12 px; expected twice"));
        assert!(error(&exr_of(4, 12, |_, _| [0.0; 3]), SkyKind::Cube).contains("six square faces"));
        let nan = exr_of(4, 2, |_, _| [f32::NAN; 3]);
        assert!(error(&nan, SkyKind::Equirect).contains("not finite"));
        assert!(error(b"BM", SkyKind::Cube).contains(".exr or .png"));
        // The last 16 bytes hold no pixels.
        for end in (0..png.len() - 16).step_by(3) {
            assert!(decode(&png[..end], SkyKind::Cube, DMat3::IDENTITY).is_err());
        }
    }
}
