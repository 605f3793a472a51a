//! Places that episodes share: each is made once, and again only when too many others came between.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use decouplegs::episode::{Appearance, Site};
use decouplegs::gpu::Gpu;
use decouplegs::scene::scenario::{Place, Scenario};
use decouplegs::scene::{Lane, LightTransfer};
use decouplegs::session::{Session, SessionOptions, SessionScene};

use crate::background::BackgroundArguments;

/// Places that are kept: a street in four weathers and a few more.
const KEPT_MAX: usize = 6;

/// A place, and its scene on the device.
pub struct Ready {
    pub site: Arc<Site>,
    /// None where nothing is drawn.
    pub scene: Option<Arc<SessionScene>>,
}

struct Kept {
    place: Place,
    directory: PathBuf,
    only_cars: bool,
    ready: Arc<Ready>,
}

/// Places by what describes them.
pub struct Sites {
    session: Option<Session>,
    transfer: Option<LightTransfer>,
    kept: Mutex<Vec<Kept>>,
    lanes: Mutex<Vec<(Place, PathBuf, Vec<Lane>)>>,
}

impl Sites {
    /// Places whose scenes are kept on `gpu`; without a device nothing is rendered.
    /// `transfer` lights the agents of synthetic places.
    pub fn new(
        gpu: Option<&Gpu>,
        background: BackgroundArguments,
        transfer: Option<LightTransfer>,
    ) -> Self {
        // Episodes share scenes, and each must be drawn as if it were alone.
        let mut options = SessionOptions {
            bakes_light_on_demand: false,
            ..SessionOptions::default()
        };
        background.apply_to(&mut options.render);
        Self {
            session: gpu.map(|gpu| Session::on(gpu, &options)),
            transfer,
            kept: Mutex::default(),
            lanes: Mutex::default(),
        }
    }

    /// The session that renders; none without a device.
    pub fn session(&self) -> Option<&Session> {
        self.session.as_ref()
    }

    /// The place of `scenario`, its files relative to `directory`, with the assets that it shows.
    /// Others wait while it is made: it may be theirs too.
    pub fn get(&self, scenario: &Scenario, directory: &Path) -> Result<Arc<Ready>> {
        let (place, only_cars) = (&scenario.place, scenario.has_only_cars());
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |other: &Kept| other.place == *place && other.directory == directory;
        if let Some(at) = kept.iter().position(same) {
            if only_cars || !kept[at].only_cars {
                return Ok(kept[at].ready.clone());
            }
            kept.remove(at);
        }
        if kept.len() >= KEPT_MAX {
            kept.remove(0);
        }
        let ready = Arc::new(self.make(place, directory, only_cars)?);
        kept.push(Kept {
            place: place.clone(),
            directory: directory.to_owned(),
            only_cars,
            ready: ready.clone(),
        });
        Ok(ready)
    }

    fn make(&self, place: &Place, directory: &Path, only_cars: bool) -> Result<Ready> {
        let appearance = Appearance {
            transfer: self.transfer.clone(),
            only_cars,
        };
        let appearance = self.session.as_ref().map(|_| &appearance);
        let site = Site::open(place, directory, appearance)
            .context("the place of the scenario is not usable")?;
        let site = Arc::new(site);
        let Some(session) = &self.session else {
            return Ok(Ready { site, scene: None });
        };
        let scene = site.add_to(session)?;
        Ok(Ready {
            site,
            scene: Some(scene),
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
