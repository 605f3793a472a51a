//! A scene file that moves to another folder: what it names stays where it is.

use std::io;
use std::path::{Component, Path, PathBuf};

use super::{SceneFile, SceneLidar, SeenFrom};

/// The way to `target` from `directory`, both of which exist: relative where they share a folder
/// below the root, else absolute.
///
/// # Errors
/// Returns an error if one of them does not exist or cannot be accessed.
pub fn path_from(directory: &Path, target: &Path) -> io::Result<PathBuf> {
    // Symbolic links first: `..` leaves the folder that a link leads to, not the one that it lies
    // in.
    let (directory, target) = (
        existing(directory)?.canonicalize()?,
        existing(target)?.canonicalize()?,
    );
    let shared = directory
        .components()
        .zip(target.components())
        .take_while(|(a, b)| a == b)
        .count();
    let below_root = target
        .components()
        .take(shared)
        .any(|part| matches!(part, Component::Normal(_)));
    if !below_root {
        return Ok(target);
    }
    let up = directory
        .components()
        .skip(shared)
        .map(|_| Component::ParentDir);
    Ok(up.chain(target.components().skip(shared)).collect())
}

/// The folder that a file's parent names: an empty path stands for the current one.
fn existing(path: &Path) -> io::Result<PathBuf> {
    if path.as_os_str().is_empty() {
        std::env::current_dir()
    } else {
        Ok(path.to_owned())
    }
}

impl SceneFile {
    /// This scene, read in the folder `from`, as a file in the folder `to` has to say it: relative
    /// paths lead to the same files.
    ///
    /// # Errors
    /// Returns an error if one of the folders does not exist or cannot be accessed.
    pub fn moved_to_folder(&self, from: &Path, to: &Path) -> io::Result<Self> {
        let way = path_from(to, from)?;
        // An absolute path stays as it is, which `join` sees to.
        let moved = |path: &PathBuf| way.join(path);
        let mut scene = self.clone();
        scene.background = moved(&scene.background);
        scene
            .agents
            .iter_mut()
            .for_each(|agent| agent.asset = moved(&agent.asset));
        let models = scene.lidars.iter_mut().filter_map(SceneLidar::file_mut);
        models.for_each(|file| *file = moved(file));
        if let Some(sky) = &mut scene.sky_map {
            sky.file = moved(&sky.file);
        }
        if let Some(file) = scene
            .recording
            .seen_from
            .as_mut()
            .and_then(SeenFrom::file_mut)
        {
            *file = moved(file);
        }
        if let Some(ground) = &mut scene.recording.ground {
            *ground = moved(ground);
        }
        if let Some(obstacles) = &mut scene.recording.obstacles {
            *obstacles = moved(obstacles);
        }
        if let Some(light) = &mut scene.light {
            light.transfer = light.transfer.as_ref().map(moved);
        }
        Ok(scene)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SceneAgent, SceneLight, SceneRecording};
    use decouplegs_scene::{Pose, Presence, Trajectory};

    #[test]
    fn what_a_moved_scene_names_stays_where_it_is() {
        let root = tempfile::tempdir().unwrap();
        let [near, far] = ["a/street", "b/edited/new"].map(|name| root.path().join(name));
        std::fs::create_dir_all(near.join("assets")).unwrap();
        std::fs::create_dir_all(&far).unwrap();
        for file in [
            "street.ply",
            "assets/car.ply",
            "light.safetensors",
            "ground.ply",
            "obstacles.json",
        ] {
            std::fs::write(near.join(file), file).unwrap();
        }
        let elsewhere = root.path().join("absolute.ply");
        let agent = |asset: PathBuf| SceneAgent {
            name: "car".into(),
            class: None,
            asset,
            sh_frame: None,
            trajectory: Trajectory::standing(Pose::IDENTITY),
            present: Presence::ALWAYS,
        };
        let scene = SceneFile {
            agents: vec![agent("assets/car.ply".into()), agent(elsewhere.clone())],
            light: Some(SceneLight {
                transfer: Some("light.safetensors".into()),
                ..SceneLight::default()
            }),
            recording: SceneRecording {
                ground: Some("ground.ply".into()),
                obstacles: Some("obstacles.json".into()),
                ..SceneRecording::default()
            },
            ..SceneFile::of_background("street.ply")
        };
        let moved = scene.moved_to_folder(&near, &far).unwrap();
        assert_eq!(moved.background, Path::new("../../../a/street/street.ply"));
        let text = |path: &Path| std::fs::read_to_string(far.join(path)).unwrap();
        assert_eq!(
            (text(&moved.background), text(&moved.agents[0].asset)),
            ("street.ply".into(), "assets/car.ply".into())
        );
        assert_eq!(
            text(moved.light.unwrap().transfer.as_ref().unwrap()),
            "light.safetensors"
        );
        assert_eq!(text(moved.recording.ground.as_ref().unwrap()), "ground.ply");
        assert_eq!(
            text(moved.recording.obstacles.as_ref().unwrap()),
            "obstacles.json"
        );
        assert_eq!(moved.agents[1].asset, elsewhere);
        assert_eq!(scene.moved_to_folder(&near, &near).unwrap(), scene);
        assert_eq!(
            scene
                .moved_to_folder(&near, root.path())
                .unwrap()
                .background,
            Path::new("a/street/street.ply")
        );
        assert!(
            scene
                .moved_to_folder(&near, &root.path().join("absent"))
                .is_err()
        );
    }

    #[test]
    fn what_shares_only_the_root_is_named_in_full() {
        let [root, current] = [
            Path::new("/").canonicalize().unwrap(),
            std::env::current_dir().unwrap(),
        ];
        let current = current.canonicalize().unwrap();
        assert_eq!(path_from(&root, &current).unwrap(), current);
        assert_eq!(
            path_from(Path::new(""), Path::new(".")).unwrap(),
            Path::new("")
        );
    }
}
