//! Scenes whose agents can all be moved from frame to frame.

use std::collections::{HashMap, HashSet};
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
    let directory = path.parent().unwrap_or(Path::new(""));
    let (mut loaded, plain) = without_plain_agents(path, directory)?;
    let compressed = code_plain(&mut loaded, plain, directory)?;
    Ok((loaded, compressed))
}

/// Opens a scene that is not drawn: without its agents of plain splat files, and with the length, width and height of the assets that
/// [`open_movable_scene`] gives, in its order, meters. Nothing is compressed.
///
/// # Errors
/// [`AssetError`] of the file at fault.
pub fn measure_movable_scene(path: &Path) -> Result<(LoadedScene, Vec<[f32; 3]>), AssetError> {
    let directory = path.parent().unwrap_or(Path::new(""));
    let (loaded, plain) = without_plain_agents(path, directory)?;
    let mut dims_m: Vec<_> = loaded.assets.iter().map(|asset| asset.dims_m).collect();
    let mut measured = HashSet::new();
    for path in plain.iter().map(|agent| directory.join(&agent.asset)) {
        if measured.insert(path.clone()) {
            let bounds = read_splats(&path)?.bounds();
            dims_m.push(std::array::from_fn(|axis| bounds.max[axis] - bounds.min[axis]));
        }
    }
    Ok((loaded, dims_m))
}

/// The scene at `path` without its agents of plain splat files, and these. Only scene files have such agents.
fn without_plain_agents(path: &Path, directory: &Path) -> Result<(LoadedScene, Vec<SceneAgent>), AssetError> {
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml")) {
        return Ok((open_scene(path, 0.0)?, Vec::new()));
    }
    let mut file = SceneFile::read(path)?;
    let (coded, plain) = file.agents.drain(..).partition(|agent| coded_asset::has_extension(&agent.asset));
    file.agents = coded;
    Ok((file.load(directory, 0.0)?, plain))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inria_ply;
    use crate::street::{Street, StreetOptions};

    #[test]
    fn a_scene_that_is_only_measured_has_the_assets_it_would_be_drawn_with() {
        let folder = tempfile::tempdir().unwrap();
        let street =
            Street::generate(&StreetOptions { background: 50, agents: 2, agent_splats: 200, ..StreetOptions::default() });
        inria_ply::write(&folder.path().join("ground.ply"), &street.background).unwrap();
        let mut scene = "version = 1\nbackground = \"ground.ply\"\n".to_owned();
        for (index, car) in [0, 1, 0].into_iter().enumerate() {
            inria_ply::write(&folder.path().join(format!("car{car}.ply")), &street.assets[car]).unwrap();
            scene += &format!(
                "[[agent]]\nname = \"car {index}\"\nasset = \"car{car}.ply\"\n\
                 [[agent.trajectory]]\ntime_s = 0.0\nposition_m = [{index}.0, 0.0, 1.0]\nrotation_wxyz = [1.0, 0.0, 0.0, 0.0]\n"
            );
        }
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, scene).unwrap();
        let (drawn, compressed) = open_movable_scene(&path).unwrap();
        let (measured, dims_m) = measure_movable_scene(&path).unwrap();
        assert_eq!((compressed, drawn.agents.len()), (2, 3));
        assert_eq!(dims_m, drawn.assets.iter().map(|asset| asset.dims_m).collect::<Vec<_>>());
        assert!(dims_m[0] != dims_m[1]);
        assert_eq!(measured.world.splats.len(), drawn.world.splats.len());
    }
}
