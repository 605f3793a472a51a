//! Detection of the format of a splat file.

use std::path::Path;

use decouplegs_scene::{Invalid, SplatCloud};

use crate::error::read_bytes;
use crate::ply::Ply;
use crate::zip::Archive;
use crate::{
    AssetError, DecodeError, checkpoint, coded_asset, compressed_ply, inria_ply, khr_glb, sog,
    splat, spz,
};

/// The formats that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplatFormat {
    /// PLY with one property per parameter.
    InriaPly,
    /// PlayCanvas' quantized PLY.
    CompressedPly,
    /// antimatter15's 32 bytes per splat.
    Splat,
    /// Niantic's, versions 1 to 4.
    Spz,
    /// PlayCanvas' bundle of lossless images, version 2.
    Sog,
    /// Binary glTF with the extension KHR_gaussian_splatting.
    KhrGlb,
    /// Checkpoint that gsplat's trainer saves with PyTorch.
    Checkpoint,
    /// Compressed asset of this project, with codebooks; its finest level is read.
    CodedAsset,
}

impl SplatFormat {
    /// Extensions of the formats that are read, as help texts and errors list them.
    pub const EXTENSIONS: &str = ".ply, .splat, .spz, .sog, .glb, .pt, .safetensors";

    /// Name of the format for users.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::InriaPly => "INRIA PLY",
            Self::CompressedPly => "compressed PLY",
            Self::Splat => "SPLAT",
            Self::Spz => "SPZ",
            Self::Sog => sog::NAME,
            Self::KhrGlb => khr_glb::NAME,
            Self::Checkpoint => checkpoint::NAME,
            Self::CodedAsset => coded_asset::NAME,
        }
    }

    /// The format of `bytes`: by their first bytes where the format has such, else by the file's
    /// `extension`.
    ///
    /// # Errors
    /// A sentence on what the bytes look like and what to do.
    pub fn detect(bytes: &[u8], extension: &str) -> Result<Self, Invalid> {
        match bytes {
            [b'p', b'l', b'y', b'\n' | b'\r', ..] => match Ply::parse(bytes) {
                Ok(ply) if compressed_ply::is_compressed(&ply) => Ok(Self::CompressedPly),
                // A broken header is the PLY reader's to explain.
                _ => Ok(Self::InriaPly),
            },
            [b'N', b'G', b'S', b'P', ..] | [0x1f, 0x8b, ..] => Ok(Self::Spz),
            [b'P', b'K', 3, 4, ..] => Ok(Self::of_zip(bytes, extension)?),
            [b'g', b'l', b'T', b'F', ..] => Ok(Self::KhrGlb),
            // As PyTorch saved before 1.6.
            [0x80, 2, 0x8a, 10, ..] => Ok(Self::Checkpoint),
            _ if extension.eq_ignore_ascii_case("splat") => Ok(Self::Splat),
            _ if extension.eq_ignore_ascii_case("safetensors") => Ok(Self::CodedAsset),
            [] => Err("the file is empty".into()),
            _ => Err(Invalid::new(format!(
                "neither its first bytes nor its extension '{extension}' tell a splat format"
            ))),
        }
    }

    /// The format of a zip, by what is in it.
    fn of_zip(bytes: &[u8], extension: &str) -> Result<Self, String> {
        let is = |other: &str| extension.eq_ignore_ascii_case(other);
        match Archive::parse(bytes) {
            Ok(archive) if sog::is_bundle(&archive) => Ok(Self::Sog),
            Ok(archive) if checkpoint::is_checkpoint(&archive) => Ok(Self::Checkpoint),
            Ok(_) if is("usdz") => {
                Err("a USDZ package, which is a scene: open it as one, not as splats".into())
            }
            Ok(_) => Err(
                "a zip archive with neither a SOG's meta.json nor a checkpoint's data.pkl in it"
                    .into(),
            ),
            // A broken zip is its reader's to explain.
            Err(_) if is("pt") || is("pth") || is("ckpt") => Ok(Self::Checkpoint),
            Err(_) => Ok(Self::Sog),
        }
    }
}

/// Reads the splats of a file in any format, chosen by its content and, where that says nothing,
/// its extension.
///
/// A SOG may also be a folder, or the `meta.json` in it; a folder with `lod-meta.json` is a set of
/// SOG folders, read at its finest level. Coordinates are the file's own; SPZ is turned to the axes
/// of the PLY it was made from (see [`spz`]). Splats that cannot be drawn are kept:
/// [`SplatCloud::defect_of`] tells them.
///
/// # Errors
/// [`AssetError::Read`], [`AssetError::Unrecognized`] or [`AssetError::Decode`].
pub fn read_splats(path: &Path) -> Result<SplatCloud, AssetError> {
    let is_set = |folder: &Path| folder.join(sog::LOD_META).is_file();
    if path.is_dir() {
        return if is_set(path) {
            sog::read_set(path)
        } else {
            sog::read_folder(path)
        };
    }
    if path.file_name().is_some_and(|name| name == sog::LOD_META) {
        return sog::read_set(path.parent().unwrap_or(Path::new("")));
    }
    if path.file_name().is_some_and(|name| name == sog::META) {
        return sog::read_folder(path.parent().unwrap_or(Path::new("")));
    }
    splats_of(&read_bytes(path)?, path)
}

/// Reads the splats in the bytes of the file at `path`.
pub(crate) fn splats_of(bytes: &[u8], path: &Path) -> Result<SplatCloud, AssetError> {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    let format =
        SplatFormat::detect(bytes, &extension).map_err(|found| AssetError::Unrecognized {
            path: path.to_owned(),
            found: found.into(),
            expected: SplatFormat::EXTENSIONS,
        })?;
    decode(bytes, format).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: format.name(),
        source,
    })
}

fn decode(bytes: &[u8], format: SplatFormat) -> Result<SplatCloud, DecodeError> {
    match format {
        SplatFormat::InriaPly => inria_ply::decode(bytes),
        SplatFormat::CompressedPly => compressed_ply::decode(bytes),
        SplatFormat::Splat => splat::decode(bytes),
        SplatFormat::Spz => spz::decode(bytes),
        SplatFormat::Sog => sog::decode(bytes),
        SplatFormat::KhrGlb => khr_glb::decode(bytes),
        SplatFormat::Checkpoint => checkpoint::decode(bytes),
        SplatFormat::CodedAsset => Ok(coded_asset::decode(bytes)?.cloud.decoded(0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_is_believed_before_the_extension() {
        assert_eq!(
            SplatFormat::detect(b"ply\nformat", "splat"),
            Ok(SplatFormat::InriaPly)
        );
        assert_eq!(SplatFormat::detect(b"NGSP", "bin"), Ok(SplatFormat::Spz));
        assert_eq!(
            SplatFormat::detect(&[0x1f, 0x8b, 8], "ply"),
            Ok(SplatFormat::Spz)
        );
        assert_eq!(
            SplatFormat::detect(&[0; 32], "SPLAT"),
            Ok(SplatFormat::Splat)
        );
        assert_eq!(
            SplatFormat::detect(&[0; 32], "safetensors"),
            Ok(SplatFormat::CodedAsset)
        );
        assert_eq!(
            SplatFormat::detect(b"PK\x03\x04", "sog"),
            Ok(SplatFormat::Sog)
        );
        assert_eq!(
            SplatFormat::detect(b"PK\x03\x04", "pt"),
            Ok(SplatFormat::Checkpoint)
        );
        assert_eq!(
            SplatFormat::detect(b"glTF\x02", "bin"),
            Ok(SplatFormat::KhrGlb)
        );
        assert!(
            SplatFormat::detect(b"hello", "txt")
                .unwrap_err()
                .reason()
                .contains("'txt'")
        );
    }

    #[test]
    fn errors_name_the_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.splat");
        assert!(
            read_splats(&path)
                .unwrap_err()
                .to_string()
                .contains("a.splat")
        );
        std::fs::write(&path, [0; 33]).unwrap();
        let error = read_splats(&path).unwrap_err().to_string();
        assert!(
            error.contains("a.splat") && error.contains("needs 64 bytes, found 33"),
            "{error}"
        );
    }
}
