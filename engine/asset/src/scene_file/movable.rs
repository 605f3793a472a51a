//! Scenes whose agents can all be moved from frame to frame.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use decouplegs_scene::CodedCloud;
use decouplegs_scene::codebook::{COLOURS_MAX, SHAPES_MAX};

use super::load::{LoadedAgent, LoadedScene, open_scene};
use super::{SceneAgent, SceneFile};
use crate::compress::{CompressOptions, Prune, compress};
use crate::{AssetError, coded_asset, read_splats};

/// Mini-batches for the codebooks of assets that are compressed while a person waits.
const ITERATIONS_MAX: usize = 16;
/// Splats for each entry of their codebooks, where the books could hold more.
const SPLATS_PER_ENTRY: usize = 16;

/// Opens a scene so that all its agents can be moved, and counts the assets that were compressed for it. [`open_scene`] leaves agents
/// of plain splat files where they stand; here their assets are compressed first, with all their splats.
///
/// # Errors
/// [`AssetError`] of the file at fault.
pub fn open_movable_scene(path: &Path) -> Result<(LoadedScene, usize), AssetError> {
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml")) {
        return Ok((open_scene(path, 0.0)?, 0));
    }
    let directory = path.parent().unwrap_or(Path::new(""));
    let mut file = SceneFile::read(path)?;
    let (coded, plain) = file.agents.drain(..).partition(|agent| coded_asset::has_extension(&agent.asset));
    file.agents = coded;
    let mut loaded = file.load(directory, 0.0)?;
    let compressed = code_plain(&mut loaded, plain, directory)?;
    Ok((loaded, compressed))
}

/// Adds `agents`, whose assets are plain splat files, behind those of `loaded`. Returns the number of assets.
fn code_plain(loaded: &mut LoadedScene, agents: Vec<SceneAgent>, directory: &Path) -> Result<usize, AssetError> {
    let mut places: HashMap<PathBuf, usize> = HashMap::new();
    for agent in agents {
        let path = directory.join(&agent.asset);
        let asset = match places.get(&path) {
            Some(&asset) => asset,
            None => {
                loaded.assets.push(coded(&path)?);
                places.insert(path, loaded.assets.len() - 1);
                loaded.assets.len() - 1
            }
        };
        loaded.agent_names.push(agent.name.clone());
        let instance = u16::try_from(loaded.agent_names.len());
        let too_many = |_| AssetError::Placement(format!("agent {}: more than {} agents in one world", agent.name, u16::MAX));
        loaded.agents.push(LoadedAgent {
            instance: instance.map_err(too_many)?,
            sh_frame: agent.sh_frame.unwrap_or_default(),
            name: agent.name,
            asset,
            trajectory: agent.trajectory,
        });
    }
    Ok(places.len())
}

/// The asset at `path` with all of its splats, compressed.
fn coded(path: &Path) -> Result<CodedCloud, AssetError> {
    let cloud = read_splats(path)?;
    let entries = |max: usize| (cloud.len() / SPLATS_PER_ENTRY).clamp(64, max);
    let options = CompressOptions {
        prune: Prune::KeepRatio(1.0),
        colours: entries(COLOURS_MAX),
        shapes: entries(SHAPES_MAX),
        iterations_max: ITERATIONS_MAX,
        ..CompressOptions::default()
    };
    let compressed = compress(&cloud, &vec![1.0; cloud.len()], &options, &|_| {});
    let unfit = |error| AssetError::Placement(format!("{}: {error}", path.display()));
    Ok(compressed.map_err(unfit)?.cloud)
}
