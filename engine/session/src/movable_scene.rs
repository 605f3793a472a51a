//! Scenes whose agents can all be moved from frame to frame.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use decouplegs_asset::packed_scene::{PackedScene, is_package};
use decouplegs_asset::{
    AgentLabel, AssetError, LoadedAgent, LoadedScene, SceneAgent, SceneFile, coded_asset,
    is_scene_file, open_scene, read_splats,
};
use decouplegs_scene::SplatCloud;
use decouplegs_train::compress::{compress_quickly, quick_dims_m};

/// Opens a scene so that all its agents can be moved, and counts the assets that were compressed
/// for it. [`open_scene`] leaves agents of plain splat files where they stand; here their assets
/// are compressed first, with all splats that can be seen.
///
/// # Errors
/// [`AssetError`] of the file at fault.
pub fn open_movable_scene(path: &Path) -> Result<(LoadedScene, usize), AssetError> {
    let mut scene = WithoutPlain::open(path)?;
    let compressed = scene.code_plain()?;
    Ok((scene.loaded, compressed))
}

/// Opens a scene that is not drawn: without its agents of plain splat files, and with the length,
/// width and height of the assets that [`open_movable_scene`] gives, in its order, meters. Nothing
/// is compressed.
///
/// # Errors
/// [`AssetError`] of the file at fault.
pub fn measure_movable_scene(path: &Path) -> Result<(LoadedScene, Vec<[f32; 3]>), AssetError> {
    let scene = WithoutPlain::open(path)?;
    let mut dims_m: Vec<_> = scene
        .loaded
        .assets
        .iter()
        .map(|asset| asset.dims_m)
        .collect();
    let mut measured = HashSet::new();
    for asset in scene.plain.iter().map(|agent| &agent.asset) {
        if measured.insert(asset) {
            let (place, splats) = scene.files.splats(asset)?;
            let no_splat =
                || AssetError::Placement(format!("{}: no splat can be seen", place.display()));
            dims_m.push(quick_dims_m(&splats).ok_or_else(no_splat)?);
        }
    }
    Ok((scene.loaded, dims_m))
}

/// Place of the assets of a scene.
enum Files {
    /// The folder of the scene file.
    Folder(PathBuf),
    /// The package that holds the scene file.
    Package(PathBuf, Box<PackedScene>),
}

impl Files {
    /// The splats of an asset, and its place for messages.
    fn splats(&self, asset: &Path) -> Result<(PathBuf, SplatCloud), AssetError> {
        match self {
            Self::Folder(folder) => {
                let place = folder.join(asset);
                let splats = read_splats(&place)?;
                Ok((place, splats))
            }
            Self::Package(package, packed) => Ok((package.join(asset), packed.splats(asset)?)),
        }
    }
}

/// A scene without its agents of plain splat files, and these. Only scene files have such agents.
struct WithoutPlain {
    loaded: LoadedScene,
    plain: Vec<SceneAgent>,
    files: Files,
}

impl WithoutPlain {
    fn open(path: &Path) -> Result<Self, AssetError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        if is_scene_file(path) {
            let (file, plain) = divided(SceneFile::read(path)?);
            return Ok(Self {
                loaded: file.load(folder, 0.0)?,
                plain,
                files: Files::Folder(folder.to_owned()),
            });
        }
        if is_package(path) {
            let packed = PackedScene::open(path)?;
            let (file, plain) = divided(packed.file().clone());
            return Ok(Self {
                loaded: packed.load(&file, 0.0)?,
                plain,
                files: Files::Package(path.to_owned(), Box::new(packed)),
            });
        }
        Ok(Self {
            loaded: open_scene(path, 0.0)?,
            plain: Vec::new(),
            files: Files::Folder(folder.to_owned()),
        })
    }

    /// Adds the agents of plain splat files behind the others. Returns the number of their assets.
    fn code_plain(&mut self) -> Result<usize, AssetError> {
        let loaded = &mut self.loaded;
        let mut indices: HashMap<PathBuf, usize> = HashMap::new();
        for agent in self.plain.drain(..) {
            let asset = match indices.get(&agent.asset) {
                Some(&asset) => asset,
                None => {
                    let (place, splats) = self.files.splats(&agent.asset)?;
                    let unfit =
                        |error| AssetError::Placement(format!("{}: {error}", place.display()));
                    loaded
                        .assets
                        .push(compress_quickly(&splats).map_err(unfit)?);
                    indices.insert(agent.asset.clone(), loaded.assets.len() - 1);
                    loaded.assets.len() - 1
                }
            };
            loaded.agent_labels.push(AgentLabel::from_agent(&agent));
            let instance = u16::try_from(loaded.agent_labels.len());
            let too_many = |_| {
                AssetError::Placement(format!(
                    "agent {}: more than {} agents in one world",
                    agent.name,
                    u16::MAX
                ))
            };
            loaded.agents.push(LoadedAgent {
                instance: instance.map_err(too_many)?,
                sh_frame: agent.sh_frame.unwrap_or_default(),
                name: agent.name,
                asset,
                trajectory: agent.trajectory,
                present: agent.present,
            });
        }
        Ok(indices.len())
    }
}

/// `file` without its agents of plain splat files, and these.
fn divided(mut file: SceneFile) -> (SceneFile, Vec<SceneAgent>) {
    let (coded, plain) = file
        .agents
        .drain(..)
        .partition(|agent| coded_asset::has_extension(&agent.asset));
    file.agents = coded;
    (file, plain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_asset::inria_ply;
    use decouplegs_asset::packed_scene::{PackOptions, pack};
    use decouplegs_synth::street::{Street, StreetOptions};

    #[test]
    fn a_scene_that_is_only_measured_has_the_assets_it_would_be_drawn_with() {
        let folder = tempfile::tempdir().unwrap();
        let street = Street::generate(&StreetOptions {
            background: 50,
            agents: 2,
            agent_splats: 200,
            ..StreetOptions::default()
        });
        inria_ply::write(&folder.path().join("ground.ply"), &street.background).unwrap();
        let mut scene = "version = 1\nbackground = \"ground.ply\"\n".to_owned();
        for (index, car) in [0, 1, 0].into_iter().enumerate() {
            // A splat that no image shows adds nothing to the size.
            let mut splats = street.assets[car].clone();
            splats.opacities[0] = 1e-4;
            splats.means[0] = [50.0; 3];
            inria_ply::write(&folder.path().join(format!("car{car}.ply")), &splats).unwrap();
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
        assert_eq!(
            dims_m,
            drawn
                .assets
                .iter()
                .map(|asset| asset.dims_m)
                .collect::<Vec<_>>()
        );
        assert!(
            dims_m[0] != dims_m[1] && dims_m.as_flattened().iter().all(|&side_m| side_m < 20.0)
        );
        assert_eq!(
            measured.splat_scene.splats.len(),
            drawn.splat_scene.splats.len()
        );
        // Packed, the same can be moved.
        let package = folder.path().join("cars.usdz");
        let file = SceneFile::read(&path).unwrap();
        let options = PackOptions::new("cars");
        pack(&file, folder.path(), &options, &package).unwrap();
        let (packed, compressed) = open_movable_scene(&package).unwrap();
        assert_eq!(compressed, 2);
        assert_eq!(packed, drawn);
        assert_eq!(measure_movable_scene(&package).unwrap().1, dims_m);
    }
}
