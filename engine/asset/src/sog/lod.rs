//! PlayCanvas sets of levels of detail (`lod-meta.json`, written by splat-transform): a tree of
//! boxes, each with the splats of every level as ranges of SOG folders. The finest level of every
//! box is read.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::path::{Component, Path};

use decouplegs_scene::SplatCloud;
use serde::Deserialize;

use super::read_folder;
use crate::error::read_bytes;
use crate::{AssetError, DecodeError};

/// Name of the file that describes a set.
pub(crate) const LOD_META: &str = "lod-meta.json";

#[derive(Deserialize)]
struct Meta {
    filenames: Vec<String>,
    environment: Option<String>,
    tree: Node,
}

#[derive(Deserialize)]
struct Node {
    #[serde(default)]
    children: Vec<Node>,
    /// Splats of each level; 0 is the finest.
    #[serde(default)]
    lods: BTreeMap<u32, Range>,
}

/// Splats of a file, one behind the other.
#[derive(Clone, Copy, Deserialize)]
struct Range {
    file: usize,
    offset: usize,
    count: usize,
}

/// Reads the finest level of the set in `folder`.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Decode`].
pub(crate) fn read_set(folder: &Path) -> Result<SplatCloud, AssetError> {
    let path = folder.join(LOD_META);
    let decode_error = |message: String| AssetError::Decode {
        path: path.clone(),
        format: "PlayCanvas set of levels of detail",
        source: DecodeError::Malformed(message),
    };
    let meta: Meta = serde_json::from_slice(&read_bytes(&path)?)
        .map_err(|error| decode_error(error.to_string()))?;
    let mut files: HashMap<usize, SplatCloud> = HashMap::new();
    let (mut all, mut there) = (SplatCloud::default(), 0);
    for range in finest(&meta.tree) {
        let file = match files.entry(range.file) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(index) => {
                let name = meta
                    .filenames
                    .get(range.file)
                    .ok_or_else(|| decode_error(format!("there is no file {}", range.file)))?;
                let file = read_part(folder, name, &decode_error)?;
                there += file.len();
                index.insert(file)
            }
        };
        let end = range
            .offset
            .checked_add(range.count)
            .filter(|end| *end <= file.len());
        let end = end.ok_or_else(|| {
            decode_error(format!(
                "file {} has {} splats, fewer than a box names",
                range.file,
                file.len()
            ))
        })?;
        let indices: Vec<u32> = (range.offset as u32..end as u32).collect();
        all.append(&file.select(&indices));
        if all.len() > there {
            return Err(decode_error(
                "its boxes name the same splats more than once".into(),
            ));
        }
    }
    if let Some(name) = &meta.environment {
        all.append(&read_part(folder, name, &decode_error)?);
    }
    Ok(all)
}

/// The SOG folder whose `meta.json` is called `name` in `folder`.
fn read_part(
    folder: &Path,
    name: &str,
    decode_error: &dyn Fn(String) -> AssetError,
) -> Result<SplatCloud, AssetError> {
    let is_inside = Path::new(name)
        .components()
        .all(|part| matches!(part, Component::Normal(_)));
    if !is_inside {
        return Err(decode_error(format!(
            "the file '{name:.60}' is not in its folder"
        )));
    }
    let part = folder.join(name);
    read_folder(part.parent().unwrap_or(folder))
}

/// The finest level of each box that has any.
fn finest(tree: &Node) -> Vec<Range> {
    let mut open = vec![tree];
    let mut ranges = Vec::new();
    while let Some(node) = open.pop() {
        ranges.extend(node.lods.values().next());
        open.extend(node.children.iter().rev());
    }
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(count: usize) -> SplatCloud {
        SplatCloud {
            means: (0..count).map(|at| [at as f32, 0.5, -1.0]).collect(),
            scales: vec![[0.1; 3]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.9; count],
            sh_degree: 0,
            sh_dc: vec![[0.3; 3]; count],
            sh_rest: vec![],
        }
    }

    /// A set of a fine file of 30 splats and a coarse one of 3, in two boxes.
    fn set(folder: &Path) -> String {
        for (name, count) in [("0_0", 30), ("1_0", 3)] {
            let bundle = super::super::encode(&cloud(count)).unwrap().0;
            let archive = crate::zip::Archive::parse(&bundle).unwrap();
            std::fs::create_dir_all(folder.join(name)).unwrap();
            for entry in archive.names() {
                std::fs::write(
                    folder.join(name).join(entry),
                    archive.checked(entry, 1 << 20).unwrap(),
                )
                .unwrap();
            }
        }
        let leaf = |offset: usize, count: usize, coarse: usize| {
            format!(
                r#"{{"bound":{{}},"lods":{{"1":{{"file":1,"offset":{coarse},"count":1}},"0":{{"file":0,"offset":{offset},"count":{count}}}}}}}"#
            )
        };
        let text = format!(
            r#"{{"lodLevels":2,"filenames":["0_0/meta.json","1_0/meta.json"],"tree":{{"bound":{{}},"children":[{},{}]}}}}"#,
            leaf(0, 20, 0),
            leaf(20, 10, 1)
        );
        std::fs::write(folder.join(LOD_META), &text).unwrap();
        text
    }

    #[test]
    fn the_finest_level_of_every_box_is_read() {
        let folder = tempfile::tempdir().unwrap();
        set(folder.path());
        for path in [folder.path().to_owned(), folder.path().join(LOD_META)] {
            let all = crate::read_splats(&path).unwrap();
            assert_eq!(all.len(), 30, "{}", path.display());
        }
    }

    #[test]
    fn sets_that_lie_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let good = set(folder.path());
        for (from, to, part) in [
            ("\"count\":20", "\"count\":31", "fewer than a box names"),
            (
                "\"offset\":20",
                "\"offset\":18446744073709551615",
                "fewer than a box names",
            ),
            ("\"file\":0", "\"file\":7", "no file 7"),
            ("0_0/meta.json", "../0_0/meta.json", "not in its folder"),
            ("0_0/meta.json", "2_0/meta.json", "2_0"),
            (
                "\"offset\":20,\"count\":10",
                "\"offset\":0,\"count\":30",
                "more than once",
            ),
        ] {
            std::fs::write(folder.path().join(LOD_META), good.replacen(from, to, 1)).unwrap();
            let message = read_set(folder.path()).unwrap_err().to_string();
            assert!(message.contains(part), "{to}: {message}");
        }
    }

    #[test]
    fn other_bytes_are_an_error_or_splats_of_its_files() {
        let folder = tempfile::tempdir().unwrap();
        let good = set(folder.path()).into_bytes();
        let mut read = 0;
        for at in 0..good.len() {
            for value in [b'0', b'9', b'"', b'}', 0x80] {
                let mut bytes = good.clone();
                bytes[at] = value;
                std::fs::write(folder.path().join(LOD_META), &bytes).unwrap();
                if let Ok(cloud) = read_set(folder.path()) {
                    assert!(cloud.len() <= 40, "byte {at}: {} splats", cloud.len());
                    read += 1;
                }
            }
            std::fs::write(folder.path().join(LOD_META), &good[..at]).unwrap();
            assert!(read_set(folder.path()).is_err(), "cut to {at} bytes");
        }
        assert!(read > 50, "{read}");
    }
}
