//! The only scene of a server, which is read while the devices are opened.

use std::sync::{Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

use decouplegs::asset::{AssetError, LoadedScene};
use decouplegs::open_movable_scene;

use crate::scene_registry::SceneRegistry;

/// The scene, and the number of its assets that were compressed.
type Read = Result<(LoadedScene, usize), AssetError>;

/// A scene that is read before anyone asks for it. It stays in the memory of the host until then.
#[derive(Default)]
pub struct ReadAhead {
    reading: Mutex<Option<(String, JoinHandle<Read>)>>,
}

impl ReadAhead {
    /// Begins to read the scene of `registry`, if there is one only: of several, nobody knows which
    /// is asked for first.
    pub fn begin(registry: &SceneRegistry) -> Self {
        let ids = registry.ids();
        let [id] = &ids[..] else {
            return Self::default();
        };
        let path = registry.path(id).map(ToOwned::to_owned);
        let thread = path.and_then(|path| {
            let thread = Builder::new().name("read-ahead".into());
            thread.spawn(move || open_movable_scene(&path)).ok()
        });
        Self {
            reading: Mutex::new(thread.map(|thread| (id.clone(), thread))),
        }
    }

    /// The scene `id` as it was read ahead, once; waits until it is read. `None` where it was not
    /// read, or could not be: it is read again then, as the file may be another one now.
    pub fn take(&self, id: &str) -> Option<(LoadedScene, usize)> {
        let mut reading = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        let (_, thread) = reading.take_if(|(ahead, _)| ahead == id)?;
        // Others need not wait with it.
        drop(reading);
        thread.join().ok()?.ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::path::PathBuf;

    const PLACE: &str = "version = 1\nbackground = \"splats.ply\"\n";
    const SPLATS: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n\
                          property float y\nproperty float z\nproperty float f_dc_0\n\
                          property float f_dc_1\nproperty float f_dc_2\n\
                          property float opacity\nproperty float scale_0\n\
                          property float scale_1\nproperty float scale_2\n\
                          property float rot_0\nproperty float rot_1\nproperty float rot_2\n\
                          property float rot_3\nend_header\n\
                          0 0 5 0 0 0 2 -1 -1 -1 1 0 0 0\n";

    fn registry(folder: &tempfile::TempDir, names: &[&str]) -> SceneRegistry {
        fs::write(folder.path().join("splats.ply"), SPLATS).unwrap();
        let scene = |name: &&str| {
            let path = folder.path().join(format!("{name}.toml"));
            fs::write(&path, PLACE).unwrap();
            path
        };
        let paths: Vec<PathBuf> = names.iter().map(scene).collect();
        SceneRegistry::new(&paths, &[], None).unwrap()
    }

    #[test]
    fn the_only_scene_is_read_once_and_given_away() {
        let folder = tempfile::tempdir().unwrap();
        let ahead = ReadAhead::begin(&registry(&folder, &["town"]));
        assert!(ahead.take("village").is_none(), "another scene");
        let (loaded, compressed) = ahead.take("town").expect("read");
        assert_eq!((loaded.splat_scene.splats.len(), compressed), (1, 0));
        assert!(ahead.take("town").is_none(), "it is read anew");
    }

    #[test]
    fn of_several_scenes_none_is_read_before_it_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let ahead = ReadAhead::begin(&registry(&folder, &["town", "village"]));
        assert!(ahead.take("town").is_none() && ahead.take("village").is_none());
    }

    #[test]
    fn a_scene_that_could_not_be_read_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let registry = registry(&folder, &["town"]);
        fs::remove_file(folder.path().join("splats.ply")).unwrap();
        assert!(ReadAhead::begin(&registry).take("town").is_none());
    }
}
