//! The formats that are written.

use std::path::Path;

use anyhow::{Context, Result};
use clap::ValueEnum;
use decouplegs_asset::{
    CodedAsset, Provenance, compressed_ply, inria_ply, khr_glb, read_bytes, sog, splat, spz,
    write_coded,
};
use decouplegs_scene::SplatCloud;
use decouplegs_train::compress::{CompressOptions, Prune, compress};

/// A format that splats are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// INRIA PLY: all in 32-bit floats
    Ply,
    /// PlayCanvas' compressed PLY: splats quantized within chunks of 256
    CompressedPly,
    /// SPZ version 4
    Spz,
    /// antimatter15's 32 bytes per splat
    Splat,
    /// PlayCanvas' bundle of lossless images, version 2
    Sog,
    /// Binary glTF with KHR_gaussian_splatting: all in 32-bit floats
    Glb,
    /// Compressed asset of this project, of all splats with an opacity of at least 1/255;
    /// `compress` prunes by what is seen
    Safetensors,
}

impl Format {
    /// The format of a name.
    pub fn of_path(path: &Path) -> Result<Self> {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .to_lowercase();
        let extension = name.rsplit_once('.').map_or("", |(_, extension)| extension);
        let extension = if name.ends_with(".compressed.ply") {
            Self::CompressedPly.extension()
        } else {
            extension
        };
        let formats = Self::value_variants();
        let found = formats
            .iter()
            .find(|format| format.extension() == extension);
        found.copied().with_context(|| {
            let extensions: Vec<_> = formats.iter().map(|format| format.extension()).collect();
            format!(
                "{}: expected a name that ends with .{}, or --to FORMAT, found {extension:?}",
                path.display(),
                extensions.join(", .")
            )
        })
    }

    /// File name extension, without the dot.
    fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::CompressedPly => "compressed.ply",
            Self::Spz => "spz",
            Self::Splat => "splat",
            Self::Sog => "sog",
            Self::Glb => "glb",
            Self::Safetensors => "safetensors",
        }
    }

    /// Name of the format for users.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ply => "INRIA PLY",
            Self::CompressedPly => "compressed PLY",
            Self::Spz => "SPZ version 4",
            Self::Splat => "SPLAT",
            Self::Sog => "SOG version 2",
            Self::Glb => "KHR_gaussian_splatting glTF",
            Self::Safetensors => "compressed asset",
        }
    }

    /// True if splats that cannot be rendered can be written.
    pub fn holds_defects(self) -> bool {
        matches!(self, Self::Ply | Self::Splat)
    }

    /// True if a splat's axes keep their order.
    pub fn keeps_axes(self) -> bool {
        self != Self::Safetensors
    }

    /// Properties of `cloud` that the format cannot hold, one sentence each.
    pub fn limits(self, cloud: &SplatCloud) -> Vec<String> {
        let mut limits = Vec::new();
        let mut say = |message: &str| limits.push(message.to_owned());
        match self {
            Self::Ply => say(
                "opacities and scales are stored as logits and logarithms, rounded to 32-bit floats",
            ),
            Self::Glb => {}
            Self::CompressedPly => {
                say(
                    "positions and scales of 11, 10 and 11 bits, colors of 8 bits, over what 256 neighbors span; splats in another order",
                );
                say(
                    "rotations of 10 bits a component, opacities of 8 bits, coefficients within -4 to 4 in 8 bits",
                );
            }
            Self::Spz => {
                say(
                    "positions on a grid of 0.24 mm (coarser beyond 2 km), scales in steps of 6.4 % from 4.5e-5 to 379 m",
                );
                say(
                    "rotations of 10 bits a component, opacities and colors of 8 bits, coefficients within -1 to 1 in 8 bits",
                );
            }
            Self::Splat => {
                say(
                    "colors and opacities of 8 bits within 0 to 1, rotations of 8 bits a component",
                );
                if cloud.sh_degree > 0 {
                    say("no spherical harmonics: colors are the same from everywhere");
                }
            }
            Self::Sog => {
                say(
                    "positions of 16 bits an axis, closer where the scene is small and near its origin",
                );
                say(
                    "rotations of 8 bits a component, opacities of 8 bits; scales and coefficients are one of 256 numbers each; splats in another order",
                );
            }
            Self::Safetensors => {
                say(
                    "positions of 16 bits an axis; shapes and colors are entries of codebooks; splats in another order",
                );
                say(
                    "axes are stored as a shape: which is the first is not kept, and rotations are not compared",
                );
            }
        }
        limits
    }

    /// Writes `cloud`. Where the splats come in another order: which of them stand in the file, one
    /// behind the other.
    pub fn write(self, out: &Path, source: &Path, cloud: &SplatCloud) -> Result<Option<Vec<u32>>> {
        match self {
            Self::Ply => inria_ply::write(out, cloud)?,
            Self::CompressedPly => return Ok(Some(compressed_ply::write(out, cloud)?)),
            Self::Spz => spz::write(out, cloud)?,
            Self::Splat => {
                let mut plain = cloud.clone();
                plain.set_degree(0);
                splat::write(out, &plain)?;
            }
            Self::Sog => return Ok(Some(sog::write(out, cloud)?)),
            Self::Glb => khr_glb::write(out, cloud)?,
            Self::Safetensors => return write_asset(out, source, cloud).map(Some),
        }
        Ok(None)
    }

    /// Reads what was written, where neither its first bytes nor its name tell the format. `None`:
    /// they do.
    pub fn read(self, path: &Path) -> Result<Option<SplatCloud>> {
        let bytes = || read_bytes(path);
        let decoded = match self {
            Self::Ply | Self::CompressedPly | Self::Spz | Self::Sog | Self::Glb => return Ok(None),
            Self::Splat => splat::decode(&bytes()?),
            Self::Safetensors => {
                decouplegs_asset::coded_asset::decode(&bytes()?).map(|asset| asset.cloud.decoded(0))
            }
        };
        let decoded = decoded.with_context(|| format!("{} cannot be read back", path.display()));
        decoded.map(Some)
    }
}

/// Writes a compressed asset of all splats that can be seen. Returns their indices in `cloud`, in
/// the order of the file.
fn write_asset(out: &Path, source: &Path, cloud: &SplatCloud) -> Result<Vec<u32>> {
    // Every splat counts alike: nothing is rendered, so nobody knows which are seen.
    let options = CompressOptions {
        prune: Prune::KeepRatio(1.0),
        ..CompressOptions::default()
    };
    let compressed = compress(cloud, &vec![1.0; cloud.len()], &options, &|_| ())?;
    let bytes = if source.is_file() {
        read_bytes(source)?
    } else {
        Vec::new()
    };
    let mut provenance = Provenance::of_source(
        source.file_name().unwrap_or_default().to_string_lossy(),
        &bytes,
    );
    provenance.settings.insert("prune".into(), "none".into());
    write_coded(
        out,
        &CodedAsset {
            cloud: compressed.cloud,
            provenance,
        },
    )?;
    Ok(compressed.kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_told_by_extension_and_others_refused() {
        for format in Format::value_variants() {
            let name = format.extension();
            assert_eq!(
                Format::of_path(Path::new(&format!("a.b.{}", name.to_uppercase()))).unwrap(),
                *format
            );
        }
        for (name, part) in [("a", "\"\""), ("a.obj", "\"obj\"")] {
            assert!(
                Format::of_path(Path::new(name))
                    .unwrap_err()
                    .to_string()
                    .contains(part),
                "{name}"
            );
        }
    }
}
