//! Places that episodes share: each is made once, and again only when too many others came between.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use decouplegs::LiveScene;
use decouplegs::episode::{Appearance, Site, render_options};
use decouplegs::gpu::Gpu;
use decouplegs::render::Renderer;
use decouplegs::scene::Lane;
use decouplegs::scene::scenario::Place;

/// Places that are kept: a street in four weathers and a few more.
const KEPT_MAX: usize = 6;

/// A place, and what is on the device of it.
pub struct Ready {
    pub site: Arc<Site>,
    /// None where nothing is drawn.
    pub live: Option<LiveScene>,
}

/// Places by what describes them.
pub struct Sites<'a> {
    gpu: Option<&'a Gpu>,
    appearance: Appearance,
    kept: Mutex<Vec<(Place, PathBuf, Arc<Ready>)>>,
    lanes: Mutex<Vec<(Place, PathBuf, Vec<Lane>)>>,
}

impl<'a> Sites<'a> {
    /// Creates the renderer of sites; without a device nothing is rendered.
    pub fn new(gpu: Option<&'a Gpu>, appearance: Appearance) -> Self {
        Self {
            gpu,
            appearance,
            kept: Mutex::default(),
            lanes: Mutex::default(),
        }
    }

    /// `place`, its files relative to `directory`. Others wait while it is made: it may be theirs
    /// too.
    pub fn get(&self, place: &Place, directory: &Path) -> Result<Arc<Ready>> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((.., ready)) = kept
            .iter()
            .find(|(other, base, _)| other == place && base == directory)
        {
            return Ok(ready.clone());
        }
        if kept.len() >= KEPT_MAX {
            kept.remove(0);
        }
        let ready = Arc::new(self.make(place, directory)?);
        kept.push((place.clone(), directory.to_owned(), ready.clone()));
        Ok(ready)
    }

    fn make(&self, place: &Place, directory: &Path) -> Result<Ready> {
        let site = Site::open(place, directory, self.gpu.map(|_| &self.appearance))
            .context("the place of the scenario is not usable")?;
        let site = Arc::new(site);
        let Some(gpu) = self.gpu else {
            return Ok(Ready { site, live: None });
        };
        let renderer = Renderer::new(gpu, render_options(site.loaded.world.rules));
        let mut live = LiveScene::new(&renderer, &site.loaded)?;
        live.bake_light(site.places(Site::LIGHT_STEP_M));
        Ok(Ready {
            site,
            live: Some(live),
        })
    }
}

impl Sites<'_> {
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
