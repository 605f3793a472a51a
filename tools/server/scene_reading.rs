//! Scenes from files, with agents that can all be moved.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use decouplegs::asset::compress::{CompressOptions, Prune, compress};
use decouplegs::asset::{AssetError, LoadedAgent, LoadedScene, SceneAgent, SceneFile, coded_asset, open_scene, read_splats};
use decouplegs::scene::CodedCloud;
use decouplegs::scene::codebook::{COLOURS_MAX, SHAPES_MAX};

/// Mini-batches for the codebooks of assets that are compressed while somebody waits.
const ITERATIONS_MAX: usize = 16;
/// Splats for each entry of their codebooks, where the books could hold more.
const SPLATS_AN_ENTRY: usize = 16;

/// Whether `path` is a scene file, and not a scene of another kind.
pub fn is_scene_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

/// The scene at `path`. Agents of plain splat files would stand where they stood when the scene was loaded: their assets are
/// compressed here, so that they move as the others do.
///
/// # Errors
/// Of the file at fault.
pub fn read_scene(path: &Path) -> Result<LoadedScene, AssetError> {
    if !is_scene_file(path) {
        return open_scene(path, 0.0);
    }
    let directory = path.parent().unwrap_or(Path::new(""));
    let mut file = SceneFile::read(path)?;
    let (coded, plain) = file.agents.drain(..).partition(|agent| coded_asset::has_extension(&agent.asset));
    file.agents = coded;
    let mut loaded = file.load(directory, 0.0)?;
    code_plain(&mut loaded, plain, directory)?;
    Ok(loaded)
}

/// Adds `agents`, whose assets are plain splat files, behind those of `loaded`.
fn code_plain(loaded: &mut LoadedScene, agents: Vec<SceneAgent>, directory: &Path) -> Result<(), AssetError> {
    if agents.is_empty() {
        return Ok(());
    }
    let since = Instant::now();
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
    let seconds = since.elapsed().as_secs_f64();
    tracing::warn!(
        assets = places.len(),
        seconds,
        "plain splat files of agents were compressed: `decouplegs compress` does it once"
    );
    Ok(())
}

/// The asset at `path` with all of its splats, in the form that moves.
fn coded(path: &Path) -> Result<CodedCloud, AssetError> {
    let cloud = read_splats(path)?;
    let entries = |max: usize| (cloud.len() / SPLATS_AN_ENTRY).clamp(64, max);
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
