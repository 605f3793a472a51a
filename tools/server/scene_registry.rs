//! Registry of scenes, and their metadata without rendering.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result, bail, ensure};
use decouplegs::asset::packed_scene::{
    is_package, packed_intrinsics, packed_scene_id, read_packed_rig,
};
use decouplegs::asset::{AssetError, SceneFile, is_scene_file, open_scene};
use decouplegs::scene::{Pose, Rig, RigCamera, RigLidar, TimedPose, Trajectory};
use glam::DVec3;
use tonic::Status;

use crate::names::{check_name, no_scene};

/// Control step of AlpaSim's defaults, seconds, for which it asks before the first pose
/// (`src/wizard/configs/base_config.yaml`).
const CONTROL_STEP_S: f64 = 0.1;
/// Shutter of AlpaSim's defaults, seconds, which opens before the first frame.
const SHUTTER_S: f64 = 0.03;

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
    /// The clients' rig origin in the vehicle frame, meters, whatever the scene. None: that of a
    /// package, and of other scenes the middle of the box.
    rig_origin: Option<DVec3>,
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
    pub fn new(paths: &[PathBuf], patterns: &[String], rig_origin: Option<DVec3>) -> Result<Self> {
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

    /// About the size of the scene `id`: bytes of its file, or of the files of splats that a scene
    /// file names. 0 where they cannot be read.
    pub fn size_bytes(&self, id: &str) -> u64 {
        let length = |path: &Path| std::fs::metadata(path).map_or(0, |found| found.len());
        let Some(path) = self.path(id) else { return 0 };
        if !is_scene_file(path) {
            return length(path);
        }
        let Ok(file) = SceneFile::read(path) else {
            return 0;
        };
        let directory = path.parent().unwrap_or(Path::new(""));
        let assets = file.agents.iter().map(|agent| &agent.asset);
        let assets: BTreeSet<&PathBuf> = assets.collect();
        let files = assets.into_iter().chain([&file.background]);
        let sizes = files.map(|file| length(&directory.join(file)));
        sizes.fold(0, u64::saturating_add)
    }

    /// Metadata of the scene `id`, if they were read.
    #[must_use]
    pub fn known(&self, id: &str) -> Option<Arc<SceneMetadata>> {
        let known = self.metadata.lock().unwrap_or_else(PoisonError::into_inner);
        known.get(id).map(Arc::clone)
    }

    /// Metadata of the scene `id`; `None` if there is no such scene. Reads files the first time.
    ///
    /// # Errors
    /// Returns an error if the scene file cannot be read.
    pub fn metadata(&self, id: &str) -> Result<Option<Arc<SceneMetadata>>, AssetError> {
        if let Some(metadata) = self.known(id) {
            return Ok(Some(metadata));
        }
        let Some(path) = self.path(id) else {
            return Ok(None);
        };
        let _reading = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        // Another request may have read it meanwhile.
        if let Some(metadata) = self.known(id) {
            return Ok(Some(metadata));
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
            let rig_origin = self.rig_origin.unwrap_or(DVec3::ZERO);
            let local = in_local(&ego, rig_origin, file.origin);
            seen_by_clients(file.loaded_rig(directory)?, local, rig_origin)
        } else if is_package(path) {
            self.packed(path)?
        } else {
            let loaded = open_scene(path, 0.0)?;
            let rig_origin = self.rig_origin.unwrap_or(DVec3::ZERO);
            let local = in_local(&loaded.ego, rig_origin, loaded.splat_scene.origin);
            seen_by_clients(loaded.rig, local, rig_origin)
        };
        let metadata = Arc::new(metadata);
        let mut known = self.metadata.lock().unwrap_or_else(PoisonError::into_inner);
        known.insert(id.to_owned(), Arc::clone(&metadata));
        Ok(Some(metadata))
    }

    /// A package as its other readers see it: its rig, lenses, poses and times.
    fn packed(&self, path: &Path) -> Result<SceneMetadata, AssetError> {
        let packed = read_packed_rig(path)?;
        let mut rig = open_scene(path, 0.0)?.rig;
        for camera in rig.cameras_mut() {
            camera.intrinsics = packed_intrinsics(&camera.intrinsics);
        }
        let start_s = packed.way.start_s();
        let first_frame_s = packed.first_frame_s.unwrap_or(f64::INFINITY);
        if start_s < CONTROL_STEP_S || first_frame_s < start_s + SHUTTER_S {
            tracing::warn!(
                package = %path.display(),
                "packed by {:?}, its times begin at {start_s} s and its frames at {first_frame_s} s: AlpaSim's defaults fail with it; pack the scene again",
                packed.version
            );
        }
        let Some(rig_origin) = self.rig_origin else {
            return Ok(seen_by_clients(rig, packed.way, packed.origin_m));
        };
        if rig_origin.distance(packed.origin_m) > 1e-6 {
            tracing::warn!(
                package = %path.display(),
                "--rig-origin {rig_origin} is not that of the package, {}: simulators that read the package put their cameras elsewhere",
                packed.origin_m
            );
        }
        let way = in_local(&packed.way, rig_origin - packed.origin_m, DVec3::ZERO);
        Ok(seen_by_clients(rig, way, rig_origin))
    }
}

/// The way of a point of a vehicle whose way is `ego`, in the frame at `world_origin`.
fn in_local(ego: &Trajectory, point: DVec3, world_origin: DVec3) -> Trajectory {
    let local = |timed: &TimedPose| {
        let translation = timed.pose.transform(point) - world_origin;
        TimedPose {
            pose: Pose {
                translation,
                ..timed.pose
            },
            ..*timed
        }
    };
    let poses = ego.poses().iter().map(local).collect();
    Trajectory::new(poses).unwrap_or_else(|_| ego.clone())
}

/// A rig from the vehicle's frame seen from `rig_origin`, whose way is `way`.
fn seen_by_clients(rig: Rig, way: Trajectory, rig_origin: DVec3) -> SceneMetadata {
    let in_rig = |pose: Pose| Pose {
        translation: pose.translation - rig_origin,
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
    SceneMetadata {
        lidars: rig.lidars().cloned().map(moved_lidar).collect(),
        rig: rig.cameras().cloned().map(moved).collect(),
        ego: way,
    }
}

/// The id in a package, the folder's name for `scene.toml`, and otherwise the file's without its
/// ending.
pub fn id_of(path: &Path) -> Option<String> {
    if let Some(id) = packed_scene_id(path) {
        return Some(id);
    }
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

/// Metadata of the scene `id`; files are read on a blocking thread.
pub async fn metadata_of(
    registry: &Arc<SceneRegistry>,
    id: String,
) -> Result<Arc<SceneMetadata>, Status> {
    check_name(&id, "scene_id")?;
    if let Some(metadata) = registry.known(&id) {
        return Ok(metadata);
    }
    let (registry, asked) = (Arc::clone(registry), id.clone());
    let read = tokio::task::spawn_blocking(move || registry.metadata(&asked)).await;
    let metadata = read.map_err(|error| Status::internal(error.to_string()))?;
    let metadata = metadata.map_err(|error| Status::failed_precondition(error.to_string()))?;
    metadata.ok_or_else(|| no_scene(&id))
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::asset::packed_scene::{PackOptions, pack};
    use decouplegs::scene::Lens;

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
            SceneRegistry::new(paths, patterns, None)
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
            SceneRegistry::new(&[one], &[pattern], None).unwrap().ids(),
            ["town"]
        );
    }

    /// AlpaSim composes the poses of the package with the `rig_to_camera` of the server
    /// (`src/runtime/alpasim_runtime/services/sensorsim_service.py:295-332`).
    #[test]
    fn a_package_is_served_with_the_rig_lenses_times_and_id_that_are_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let cloud = decouplegs::scene::SplatCloud::default();
        decouplegs::asset::inria_ply::write(&folder.path().join("none.ply"), &cloud).unwrap();
        let text = "version = 1\nbackground = \"none.ply\"\norigin = [1000.0, 2000.0, 50.0]\n[[rig]]\nname = \"front\"\nwidth_px = 64\n\
                    height_px = 36\nfx_px = 40.0\nfy_px = 40.0\ncx_px = 32.0\ncy_px = 18.0\nposition_m = [1.7, 0.1, 0.5]\nlook = [1.0, \
                    0.2, 0.0]\n[[ego]]\ntime_s = 0.0\nposition_m = [1010.0, 2005.0, 50.8]\nyaw_rad = 1.0\n\
                    [[ego]]\ntime_s = 2.0\nposition_m = [1020.0, 2005.0, 50.8]\nyaw_rad = 1.2\n";
        let file = SceneFile::parse(text).unwrap();
        let mut options = PackOptions::new("place");
        options.rig_origin_m = DVec3::new(-1.2, 0.05, -0.7);
        options.camera_names = vec![("front".into(), "camera_front_wide_120fov".into())];
        let path = folder.path().join("another_name.usdz");
        pack(&file, folder.path(), &options, &path).unwrap();
        let metadata = |rig_origin| {
            let registry =
                SceneRegistry::new(std::slice::from_ref(&path), &[], rig_origin).unwrap();
            assert_eq!(registry.ids(), ["place"]);
            registry.metadata("place").unwrap().unwrap()
        };
        let served = metadata(None);
        let camera = served.rig.cameras().next().unwrap();
        let own = file.rig.cameras().next().unwrap();
        assert_eq!(camera.name, "camera_front_wide_120fov");
        let place = own.rig_from_camera.translation - options.rig_origin_m;
        assert!((camera.rig_from_camera.translation - place).length() < 1e-9);
        assert!(
            matches!(camera.intrinsics.lens, Lens::FTheta(_)),
            "as the package says"
        );
        assert_eq!((served.ego.start_s(), served.ego.end_s()), (1.0, 3.0));
        // From the middle of the box, where the rig's origin was before.
        let middle = metadata(Some(DVec3::ZERO));
        for time_s in [1.0, 1.55, 3.0] {
            let ego = file.ego.as_ref().unwrap().at(time_s - 1.0);
            let truth = ego.transform(own.rig_from_camera.translation) - file.origin;
            for metadata in [&served, &middle] {
                let shown = metadata.rig.at(&metadata.ego.at(time_s)).remove(0);
                let found = shown.world_from_camera.translation;
                // Ten poses a second of a point that goes around a bend.
                assert!((found - truth).length() < 1e-4, "{found} {truth}");
            }
        }
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
                SceneRegistry::new(std::slice::from_ref(&path), &[], Some(rig_origin)).unwrap();
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
