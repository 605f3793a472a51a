//! Detection of the format of a splat file.

use std::io::Read;
use std::path::{Path, PathBuf};

use decouplegs_scene::{Invalid, SplatCloud};
use glam::DVec3;

use crate::error::read_bytes;
use crate::ply::Ply;
use crate::zip::Archive;
use crate::{
    AssetError, DecodeError, PlacedSplats, checkpoint, coded_asset, compressed_ply, inria_ply,
    khr_glb, memory, sog, splat, spz,
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
            Self::CompressedPly => compressed_ply::NAME,
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
            _ if extension.eq_ignore_ascii_case("gltf") => {
                Err("a glTF of text with its data in other files; write it as one .glb file".into())
            }
            _ if extension.eq_ignore_ascii_case("toml") => {
                Err("a scene or a scenario, whose splats are in the files that it names".into())
            }
            _ if extension.eq_ignore_ascii_case("ksplat") => {
                Err("a .ksplat; convert it with splat-transform to .ply or .sog".into())
            }
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

/// The direction that is mostly up in the file at `path`: z in scenes and compressed assets, -y in
/// splat files, which are mostly trained from COLMAP's coordinates. A .glb is turned to these when
/// it is read.
#[must_use]
pub fn usual_up(path: &Path) -> DVec3 {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    match extension.to_lowercase().as_str() {
        "toml" | "usdz" | "safetensors" => DVec3::Z,
        _ => DVec3::NEG_Y,
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
    let mut all = SplatCloud::default();
    let mut short = Ok(());
    read_splat_pieces(path, |total, piece| {
        if piece.len() == total {
            all = piece;
            return true;
        }
        if all.is_empty() {
            let bytes = memory::cloud_bytes(total as u64, piece.sh_degree);
            short = memory::require("reading it", bytes);
            if short.is_err() {
                return false;
            }
            all = SplatCloud::with_degree(piece.sh_degree);
            all.reserve(total);
        }
        all.append(&piece);
        true
    })?;
    short.map_err(|source| AssetError::Read {
        path: path.to_owned(),
        source: std::io::Error::other(source),
    })?;
    Ok(all)
}

/// Reads like [`read_splats`], piece by piece: `each` gets the number of all splats and the next
/// ones, in the order of the file. Binary PLY files are never whole in memory, and SPZ files are
/// not decoded at once; others come in one piece. False where `each` ended it.
///
/// # Errors
/// Returns the errors of [`read_splats`]. `each` may have got pieces before them.
pub fn read_splat_pieces(
    path: &Path,
    mut each: impl FnMut(usize, SplatCloud) -> bool,
) -> Result<bool, AssetError> {
    // A FIFO is not opened: that waits for its writer.
    if path.is_file() {
        let read = inria_ply::read_pieces(path, &mut each);
        let read = read.map_err(|source| AssetError::Read {
            path: path.to_owned(),
            source,
        })?;
        if let Some(whole) = read {
            warn_of_parts(path);
            return Ok(whole);
        }
        if is_spz(path) {
            let read = spz::decode_pieces(&read_bytes(path)?, &mut each);
            return read.map_err(|source| AssetError::Decode {
                path: path.to_owned(),
                format: SplatFormat::Spz.name(),
                source,
            });
        }
    }
    let cloud = read_whole_splats(path)?;
    Ok(each(cloud.len(), cloud))
}

/// True if the file at `path` begins as SPZ of version 4 does. Other versions are in gzip, which
/// may hold anything.
fn is_spz(path: &Path) -> bool {
    let mut start = [0; 4];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start == *b"NGSP"
}

fn read_whole_splats(path: &Path) -> Result<SplatCloud, AssetError> {
    let PlacedSplats { cloud, origin, .. } = read_placed_splats(path)?;
    if origin != DVec3::ZERO {
        log::warn!(
            "{}: coordinates are large doubles; {origin} is taken off, and positions are relative to it",
            path.display()
        );
    }
    Ok(cloud)
}

/// Reads like [`read_splats`], with the origin that positions are relative to
/// ([`inria_ply::decode_placed`]), and with the labels of splats.
///
/// # Errors
/// Returns the errors of [`read_splats`].
pub fn read_placed_splats(path: &Path) -> Result<PlacedSplats, AssetError> {
    let is_set = |folder: &Path| folder.join(sog::LOD_META).is_file();
    if path.is_dir() {
        if let Some(file) = last_iteration(path) {
            return placed_splats_of(&read_bytes(&file)?, &file);
        }
        let read = if is_set(path) {
            sog::read_set(path)
        } else if path.join(sog::META).exists() {
            sog::read_folder(path)
        } else {
            return Err(AssetError::Read {
                path: path.to_owned(),
                source: std::io::Error::other(format!(
                    "it is a folder with neither a {} nor a point_cloud; expected a file of splats, an unzipped SOG, or the folder of a model",
                    sog::META
                )),
            });
        };
        return read.map(PlacedSplats::from);
    }
    if path.file_name().is_some_and(|name| name == sog::LOD_META) {
        return sog::read_set(path.parent().unwrap_or(Path::new(""))).map(PlacedSplats::from);
    }
    if path.file_name().is_some_and(|name| name == sog::META) {
        return sog::read_folder(path.parent().unwrap_or(Path::new(""))).map(PlacedSplats::from);
    }
    warn_of_parts(path);
    placed_splats_of(&read_bytes(path)?, path)
}

/// The PLY of the last iteration in the folder of a model that the original 3DGS trained
/// (`point_cloud/iteration_30000/point_cloud.ply`), or in its `point_cloud`; `None` if it is no
/// such folder.
fn last_iteration(folder: &Path) -> Option<PathBuf> {
    let inner = folder.join("point_cloud");
    let within = if inner.is_dir() {
        inner
    } else {
        folder.to_owned()
    };
    let mut last: Option<(u64, PathBuf)> = None;
    for entry in std::fs::read_dir(within).ok()?.flatten() {
        let name = entry.file_name();
        let number = name
            .to_str()
            .and_then(|name| name.strip_prefix("iteration_"));
        let Some(number) = number.and_then(|number| number.parse().ok()) else {
            continue;
        };
        let file = entry.path().join("point_cloud.ply");
        if file.is_file() && last.as_ref().is_none_or(|(found, _)| *found < number) {
            last = Some((number, file));
        }
    }
    let (number, file) = last?;
    log::warn!(
        "{} is a trained model: its last iteration, {number}, is read",
        folder.display()
    );
    Some(file)
}

/// Warns where `path` is one of several parts of a scene that lie side by side, as trainers on
/// several devices write them: `splats_rank0.ply`, `splats_rank1.ply`.
fn warn_of_parts(path: &Path) {
    let name = path.file_name().and_then(|name| name.to_str());
    let Some((start, end)) = name.and_then(part_of) else {
        return;
    };
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let Ok(entries) = std::fs::read_dir(folder.unwrap_or(Path::new("."))) else {
        return;
    };
    let is_part = |name: &str| part_of(name) == Some((start, end));
    let parts = entries.flatten().filter(|entry| {
        let name = entry.file_name();
        name.to_str().is_some_and(is_part)
    });
    let count = parts.count();
    if count > 1 {
        log::warn!(
            "{} is one of {count} parts of a scene that lie beside it, '{start}' to '{end}': only this one is read; join \
             them where they were trained",
            path.display()
        );
    }
}

/// Texts before and behind the number of a part in a file name.
fn part_of(name: &str) -> Option<(&str, &str)> {
    ["rank", "part", "shard", "chunk", "block"]
        .into_iter()
        .find_map(|word| {
            let after = name.find(word)? + word.len();
            let separator = usize::from(name[after..].starts_with(['_', '-']));
            let digits = after + separator;
            let end = name[digits..].find(|letter: char| !letter.is_ascii_digit())? + digits;
            (end > digits).then(|| (&name[..digits], &name[end..]))
        })
}

/// Reads the splats in the bytes of the file at `path`.
pub(crate) fn placed_splats_of(bytes: &[u8], path: &Path) -> Result<PlacedSplats, AssetError> {
    let unzipped = gunzipped(bytes).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: "gzip",
        source,
    })?;
    let bytes = unzipped.as_deref().unwrap_or(bytes);
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    let format =
        SplatFormat::detect(bytes, &extension).map_err(|found| AssetError::Unrecognized {
            path: path.to_owned(),
            found: found.into(),
            expected: SplatFormat::EXTENSIONS,
        })?;
    let decoded = match format {
        SplatFormat::InriaPly => inria_ply::decode_placed(bytes),
        _ => decode(bytes, format).map(PlacedSplats::from),
    };
    decoded.map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: format.name(),
        source,
    })
}

/// The content of a gzip file that is no SPZ; `None` for other files. It grows with what is there,
/// up to what the file may decode to.
fn gunzipped(bytes: &[u8]) -> Result<Option<Vec<u8>>, DecodeError> {
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(None);
    }
    let mut content = flate2::read::MultiGzDecoder::new(bytes);
    let mut start = [0; 4];
    // What is broken so early, or an SPZ, is the SPZ reader's to explain.
    if content.read_exact(&mut start).is_err() || start == *b"NGSP" {
        return Ok(None);
    }
    let most = memory::decoded_bytes_max(bytes.len());
    let mut unzipped = start.to_vec();
    content
        .take(most)
        .read_to_end(&mut unzipped)
        .map_err(|error| DecodeError::Malformed(format!("the gzip stream: {error}")))?;
    if unzipped.len() as u64 > most {
        return Err(DecodeError::Malformed(format!(
            "more than {most} bytes are in {} bytes of gzip; unpack it with gunzip",
            bytes.len()
        )));
    }
    Ok(Some(unzipped))
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
    fn gzip_files_and_folders_of_models_are_opened() {
        let cloud = SplatCloud {
            means: vec![[1.0, 2.0, 3.0]],
            scales: vec![[1.0; 3]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacities: vec![0.5],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]],
            sh_rest: Vec::new(),
        };
        let directory = tempfile::tempdir().unwrap();
        let write = |name: &str, bytes: &[u8]| {
            let path = directory.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, bytes).unwrap();
            path
        };
        let zipped = |bytes: &[u8]| {
            let mut gzip = flate2::read::GzEncoder::new(bytes, flate2::Compression::fast());
            let mut zipped = Vec::new();
            gzip.read_to_end(&mut zipped).unwrap();
            zipped
        };
        let ply = inria_ply::encode(&cloud);
        let path = write("a.ply.gz", &zipped(&ply));
        assert_eq!(read_splats(&path).unwrap(), cloud);
        let bomb = write("b.ply.gz", &zipped(&vec![b'p'; 100 << 20]));
        let message = format!("{:?}", read_splats(&bomb).unwrap_err());
        assert!(message.contains("gunzip"), "{message}");

        let other = SplatCloud {
            means: vec![[9.0; 3]],
            ..cloud.clone()
        };
        let iteration = "model/point_cloud/iteration";
        write(
            &format!("{iteration}_7000/point_cloud.ply"),
            &inria_ply::encode(&other),
        );
        write(&format!("{iteration}_30000/point_cloud.ply"), &ply);
        write(&format!("{iteration}_x/point_cloud.ply"), b"ply");
        for name in ["model", "model/point_cloud"] {
            let read = read_splats(&directory.path().join(name)).unwrap();
            assert_eq!(read, cloud, "{name}");
        }
        let message = SplatFormat::detect(b"{}", "gltf").unwrap_err().to_string();
        assert!(message.contains(".glb"), "{message}");
    }

    #[test]
    fn parts_of_a_scene_are_told_by_their_names() {
        for (name, part) in [
            ("splats_rank0.ply", Some(("splats_rank", ".ply"))),
            (
                "cloud_30000_rank_12_of_4.ply",
                Some(("cloud_30000_rank_", "_of_4.ply")),
            ),
            ("part-3.ply", Some(("part-", ".ply"))),
            ("frank.ply", None),
            ("car_3.ply", None),
        ] {
            assert_eq!(part_of(name), part, "{name}");
        }
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
