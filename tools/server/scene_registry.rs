//! Registry of scenes, and their metadata without rendering.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result, bail, ensure};
use decouplegs::asset::{AssetError, SceneFile, is_scene_file, open_scene};
use decouplegs::scene::{Pose, Rig, RigCamera, RigLidar, TimedPose, Trajectory};
use glam::DVec3;

/// Metadata of a scene as clients see it: in the local frame, and from the clients' rig origin.
#[derive(Debug)]
pub struct SceneMetadata {
    /// The rig's cameras.
    pub rig: Rig,
    /// The rig's LiDARs.
    pub lidars: Vec<RigLidar>,
    /// The way of the rig.
    pub ego: Trajectory,
}

/// The scenes of a server, by id.
pub struct SceneRegistry {
    paths: BTreeMap<String, PathBuf>,
    /// The clients' rig origin in the vehicle frame, meters.
    rig_origin: DVec3,
    metadata: Mutex<HashMap<String, Arc<SceneMetadata>>>,
    /// Held while an metadata is read: one at a time, because a splat file may take gigabytes.
    reading: Mutex<()>,
}

impl SceneRegistry {
    /// The scenes at `paths` and those that `patterns` find.
    ///
    /// # Errors
    /// Returns an error if a path does not exist, a pattern makes no sense, two scenes have one id,
    /// or there is no scene at all.
    pub fn new(paths: &[PathBuf], patterns: &[String], rig_origin: DVec3) -> Result<Self> {
        let mut found = paths.to_vec();
        for pattern in patterns {
            let matches = glob::glob(pattern)
                .with_context(|| format!("--artifact-glob {pattern:?} is no pattern"))?;
            for path in matches {
                found.push(path.with_context(|| format!("--artifact-glob {pattern:?}"))?);
            }
        }
        let mut by_id = BTreeMap::new();
        for path in found {
            ensure!(
                path.is_file(),
                "{} is no file: expected a scene file or a splat file",
                path.display()
            );
            let id = id_of(&path).with_context(|| {
                format!("{} has no name that could be a scene's id", path.display())
            })?;
            let there = by_id.insert(id.clone(), path.clone());
            if let Some(other) = there.filter(|other| *other != path) {
                bail!(
                    "{} and {} would both be called {id:?}: rename one",
                    other.display(),
                    path.display()
                );
            }
        }
        let searched = patterns.join(", ");
        ensure!(
            !by_id.is_empty(),
            "no scenes: name scene files, or a pattern that finds some (searched: {searched:?})"
        );
        Ok(Self {
            paths: by_id,
            rig_origin,
            metadata: Mutex::default(),
            reading: Mutex::default(),
        })
    }

    /// All ids, sorted.
    pub fn ids(&self) -> Vec<String> {
        self.paths.keys().cloned().collect()
    }

    /// The file of a scene.
    pub fn path(&self, id: &str) -> Option<&Path> {
        self.paths.get(id).map(PathBuf::as_path)
    }

    /// Metadata of the scene `id`; `None` if there is no such scene. Reads files the first time.
    ///
    /// # Errors
    /// Returns an error if the scene file cannot be read.
    pub fn metadata(&self, id: &str) -> Result<Option<Arc<SceneMetadata>>, AssetError> {
        let known = || self.metadata.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(metadata) = known().get(id) {
            return Ok(Some(Arc::clone(metadata)));
        }
        let Some(path) = self.path(id) else {
            return Ok(None);
        };
        let _reading = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        // Another request may have read it meanwhile.
        if let Some(metadata) = known().get(id) {
            return Ok(Some(Arc::clone(metadata)));
        }
        let metadata = if is_scene_file(path) {
            let file = SceneFile::read(path)?;
            let ego = file.ego.clone().unwrap_or_else(|| {
                Trajectory::standing(Pose {
                    translation: file.origin,
                    ..Pose::IDENTITY
                })
            });
            let directory = path.parent().unwrap_or(Path::new(""));
            self.seen_by_clients(file.loaded_rig(directory)?, &ego, file.origin)
        } else {
            let loaded = open_scene(path, 0.0)?;
            self.seen_by_clients(loaded.rig, &loaded.ego, loaded.splat_scene.origin)
        };
        let metadata = Arc::new(metadata);
        known().insert(id.to_owned(), Arc::clone(&metadata));
        Ok(Some(metadata))
    }

    fn seen_by_clients(&self, rig: Rig, ego: &Trajectory, world_origin: DVec3) -> SceneMetadata {
        let in_rig = |pose: Pose| Pose {
            translation: pose.translation - self.rig_origin,
            ..pose
        };
        let moved = |camera: RigCamera| RigCamera {
            rig_from_camera: in_rig(camera.rig_from_camera),
            ..camera
        };
        let moved_lidar = |lidar: RigLidar| RigLidar {
            rig_from_lidar: in_rig(lidar.rig_from_lidar),
            ..lidar
        };
        let local = |timed: &TimedPose| {
            let translation = timed.pose.transform(self.rig_origin) - world_origin;
            TimedPose {
                pose: Pose {
                    translation,
                    ..timed.pose
                },
                ..*timed
            }
        };
        let poses = ego.poses().iter().map(local).collect();
        SceneMetadata {
            lidars: rig.lidars().cloned().map(moved_lidar).collect(),
            rig: rig.cameras().cloned().map(moved).collect(),
            ego: Trajectory::new(poses).unwrap_or_else(|_| ego.clone()),
        }
    }
}

/// The folder's name for `scene.toml`, and otherwise the file's without its ending.
fn id_of(path: &Path) -> Option<String> {
    let absolute = std::path::absolute(path).ok()?;
    let is_plain = absolute
        .file_name()
        .is_some_and(|name| name.eq_ignore_ascii_case("scene.toml"));
    let named = if is_plain {
        absolute.parent()?.file_name()
    } else {
        absolute.file_stem()
    };
    named.and_then(|name| name.to_str()).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_called_by_their_folder_or_file() {
        assert_eq!(
            id_of(Path::new("/data/street_1/scene.toml")).as_deref(),
            Some("street_1")
        );
        assert_eq!(
            id_of(Path::new("/data/garden.ply")).as_deref(),
            Some("garden")
        );
        assert_eq!(id_of(Path::new("/scene.toml")), None);
    }

    #[test]
    fn what_cannot_be_served_is_refused_at_the_start() {
        let folder = tempfile::tempdir().unwrap();
        let (one, two) = (
            folder.path().join("town.toml"),
            folder.path().join("town.ply"),
        );
        for path in [&one, &two] {
            std::fs::write(path, "").unwrap();
        }
        let refused = |paths: &[PathBuf], patterns: &[String]| {
            SceneRegistry::new(paths, patterns, DVec3::ZERO)
                .map(|_| ())
                .unwrap_err()
                .to_string()
        };
        assert!(refused(&[one.clone(), two], &[]).contains("both be called \"town\""));
        assert!(refused(&[], &[]).contains("no scenes"));
        assert!(refused(&[folder.path().join("absent.toml")], &[]).contains("absent.toml"));
        assert!(refused(&[], &["a***".to_owned()]).contains("no pattern"));
        let pattern = format!("{}/*.toml", folder.path().display());
        assert_eq!(
            SceneRegistry::new(&[one], &[pattern], DVec3::ZERO)
                .unwrap()
                .ids(),
            ["town"]
        );
    }

    #[test]
    fn cameras_stand_where_they_do_whatever_the_rigs_origin() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("town.toml");
        let text = "version = 1\nbackground = \"none.ply\"\norigin = [1000.0, 2000.0, 50.0]\n[[rig]]\nname = \"front\"\nwidth_px = 64\n\
                    height_px = 36\nfx_px = 40.0\nfy_px = 40.0\ncx_px = 32.0\ncy_px = 18.0\nposition_m = [1.7, 0.1, 0.5]\nlook = [1.0, \
                    0.2, 0.0]\n[[ego]]\ntime_s = 0.5\nposition_m = [1010.0, 2005.0, 50.8]\nyaw_rad = 1.0\n";
        std::fs::write(&path, text).unwrap();
        let camera = |rig_origin| {
            let registry =
                SceneRegistry::new(std::slice::from_ref(&path), &[], rig_origin).unwrap();
            let metadata = registry.metadata("town").unwrap().unwrap();
            assert!(registry.metadata("village").unwrap().is_none());
            metadata
                .rig
                .at(&metadata.ego.at(0.5))
                .remove(0)
                .world_from_camera
        };
        let (center, axle) = (camera(DVec3::ZERO), camera(DVec3::new(-1.4, 0.0, -0.8)));
        assert!((center.translation - axle.translation).length() < 1e-9);
        assert!(
            (center.translation - DVec3::new(10.0, 5.0, 0.8)).length() < 2.0,
            "local: the scene's origin is taken off"
        );
    }
}
