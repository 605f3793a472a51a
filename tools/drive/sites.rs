//! Places that episodes share: each is made once, and again only when too many others came between.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use decouplegs::episode::{Appearance, Site};
use decouplegs::gpu::Gpu;
use decouplegs::scene::Lane;
use decouplegs::scene::scenario::Place;
use decouplegs::session::{Scene, Session, SessionError, SessionOptions};

use crate::arguments::warn;
use crate::background::BackgroundArguments;

/// Places that are kept: a street in four weathers and a few more.
const KEPT_MAX: usize = 6;

/// A place, and its scene on each device that draws it.
pub struct ReadySite {
    pub site: Arc<Site>,
    /// Scenes by device; none where nothing is drawn yet.
    scenes: Vec<Mutex<Option<Arc<Scene>>>>,
}

/// A place that is there, or is being made by one thread while others wait for it.
type Making = Arc<Mutex<Option<Arc<ReadySite>>>>;

/// Places by what describes them.
pub struct Sites {
    /// One for each device.
    sessions: Vec<Session>,
    appearance: Appearance,
    kept: Mutex<Vec<(Place, PathBuf, Making)>>,
    lanes: Mutex<Vec<(Place, PathBuf, Vec<Lane>)>>,
}

impl Sites {
    /// Places whose scenes are kept on `gpus`; without a device nothing is rendered.
    pub fn new(gpus: &[Gpu], background: BackgroundArguments, appearance: Appearance) -> Self {
        // Episodes share scenes, and each must be drawn as if it were alone.
        let mut options = SessionOptions {
            bakes_light_on_demand: false,
            ..SessionOptions::default()
        };
        background.apply_to(&mut options.render);
        Self {
            sessions: gpus.iter().map(|gpu| Session::on(gpu, &options)).collect(),
            appearance,
            kept: Mutex::default(),
            lanes: Mutex::default(),
        }
    }

    /// The sessions that render, one for each device.
    pub fn sessions(&self) -> &[Session] {
        &self.sessions
    }

    /// The scene of `ready` on the device at `position`, copied to it unless it is there already.
    pub fn scene(&self, ready: &ReadySite, position: usize) -> Result<Arc<Scene>, SessionError> {
        let mut scene = ready.scenes[position]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(scene) = &*scene {
            return Ok(scene.clone());
        }
        let added = ready.site.add_to(&self.sessions[position])?;
        Ok(scene.insert(added).clone())
    }

    /// `place`, its files relative to `directory`. Who asks for a place that another thread makes
    /// waits for it, and nobody else does.
    pub fn get(&self, place: &Place, directory: &Path) -> Result<Arc<ReadySite>> {
        let making = self.making(place, directory);
        let mut ready = making.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(ready) = &*ready {
            return Ok(ready.clone());
        }
        let made = Arc::new(self.make(place, directory)?);
        Ok(ready.insert(made).clone())
    }

    /// The entry of `place`, made if there is none.
    fn making(&self, place: &Place, directory: &Path) -> Making {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let mut known = kept.iter();
        if let Some((.., making)) =
            known.find(|(other, base, _)| other == place && base == directory)
        {
            return making.clone();
        }
        if kept.len() >= KEPT_MAX {
            kept.remove(0);
        }
        let making = Making::default();
        kept.push((place.clone(), directory.to_owned(), making.clone()));
        making
    }

    fn make(&self, place: &Place, directory: &Path) -> Result<ReadySite> {
        let appearance = (!self.sessions.is_empty()).then_some(&self.appearance);
        let site = Site::open(place, directory, appearance)
            .context("the place of the scenario is not usable")?;
        if let Some(warning) = site.ground_warning() {
            warn(&warning);
        }
        Ok(ReadySite {
            site: Arc::new(site),
            scenes: self.sessions.iter().map(|_| Mutex::default()).collect(),
        })
    }

    /// The lanes of `place`, without anything that is only to be seen.
    pub fn lanes(&self, place: &Place, directory: &Path) -> Result<Vec<Lane>> {
        let mut lanes = self.lanes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((.., known)) = lanes
            .iter()
            .find(|(other, base, _)| other == place && base == directory)
        {
            return Ok(known.clone());
        }
        let found = Site::open(place, directory, None)?.lanes.lanes;
        lanes.push((place.clone(), directory.to_owned(), found.clone()));
        Ok(found)
    }
}
