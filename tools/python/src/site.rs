//! Places of episodes.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use decouplegs::drive::generate::{Generator, PlaceOptions};
use decouplegs::episode::{Appearance, Site as EngineSite};
use decouplegs::logs::read_scenario;
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{Egos, Level, Scenario, Weather};
use decouplegs::session::Scene as EngineScene;
use pyo3::prelude::*;

use crate::camera::RigCamera;
use crate::error::{FileError, of_session, of_site, sentence, value_error};
use crate::scene::Scene;
use crate::session::Session;

/// A place of episodes, on the device.
///
/// The synthetic street of ``background`` splats with cars of ``agent_splats``, its houses by
/// ``seed``; or the place of a scenario file (.toml), whose scenario is then the one that is
/// driven.
#[pyclass(frozen, module = "decouplegs")]
pub struct Site {
    pub site: Arc<EngineSite>,
    pub scene: Arc<EngineScene>,
    place: Place,
    /// Scenario of a scenario file, if one was named.
    scenario: Option<Scenario>,
}

impl Site {
    /// Scenario `index` of `level`, in this place, with `egos` egos: one where it is not given. A
    /// scenario file has its own.
    pub fn scenario(
        &self,
        level: &str,
        seed: u64,
        index: u32,
        egos: Option<usize>,
    ) -> PyResult<Scenario> {
        if let Some(scenario) = &self.scenario {
            let count = scenario.egos.count();
            if egos.is_some_and(|egos| egos != count) {
                return Err(value_error(format!(
                    "egos: the scenario file has {count}, which cannot be changed here"
                )));
            }
            return Ok(scenario.clone());
        }
        let egos = egos.unwrap_or(1);
        if !(1..=Egos::MAX).contains(&egos) {
            return Err(value_error(format!(
                "egos: expected 1 to {}, found {egos}",
                Egos::MAX
            )));
        }
        let expected = || {
            value_error(format!(
                "level: expected easy, medium, hard or extreme, found {level:?}"
            ))
        };
        let level = Level::by_name(level).ok_or_else(expected)?;
        let Place::Street {
            background,
            agent_splats,
            seed: street,
            ..
        } = self.place
        else {
            return Err(value_error(
                "scenarios are generated on the synthetic street only: name a scenario file for this place".to_owned(),
            ));
        };
        let options = PlaceOptions::Street {
            background,
            agent_splats,
            seed: street,
        };
        let generator = Generator::new(&self.site.lanes, options, &self.site.asset_sizes);
        let generator = generator.map_err(|error| value_error(sentence(&error)))?;
        let made = generator.scenario(level, seed, index);
        let scenario = made.map_err(|error| value_error(sentence(&error)))?;
        let scenario = match egos {
            1 => scenario,
            _ => generator.with_egos(&scenario, egos).map_err(value_error)?,
        };
        // The light is that of the place, which is there already, and not the level's.
        Ok(Scenario {
            place: self.place.clone(),
            ..scenario
        })
    }
}

#[pymethods]
impl Site {
    #[new]
    #[pyo3(signature = (session, *, weather = "clear", background = 200_000, agent_splats = 4_000, seed = 1, scenario = None))]
    fn new(
        py: Python<'_>,
        session: &Session,
        weather: &str,
        background: usize,
        agent_splats: usize,
        seed: u64,
        scenario: Option<PathBuf>,
    ) -> PyResult<Self> {
        let expected = || {
            value_error(format!(
                "weather: expected clear, overcast, dusk or night, found {weather:?}"
            ))
        };
        let weather = Weather::by_name(weather).ok_or_else(expected)?;
        if agent_splats == 0 || background == 0 {
            return Err(value_error(format!(
                "expected at least one splat of the background and of each car, found {background} and {agent_splats}"
            )));
        }
        let directory = scenario
            .as_deref()
            .and_then(Path::parent)
            .unwrap_or(Path::new(""))
            .to_owned();
        let scenario = scenario.map(|path| read_scenario(&path)).transpose();
        let scenario = scenario.map_err(|error| FileError::new_err(sentence(&error)))?;
        let street = Place::Street {
            weather,
            background,
            agent_splats,
            seed,
        };
        let place = scenario
            .as_ref()
            .map_or(street, |scenario| scenario.place.clone());
        py.detach(|| {
            let site = EngineSite::open(&place, &directory, Some(&Appearance::default()))
                .map_err(|error| of_site(&error))?;
            let scene = site
                .add_to(&session.inner)
                .map_err(|error| of_session(&error))?;
            Ok(Self {
                site: Arc::new(site),
                scene,
                place,
                scenario,
            })
        })
    }

    /// Scene of the site: worlds over it can follow rollouts.
    #[getter]
    fn scene(&self) -> Scene {
        Scene {
            inner: self.scene.clone(),
        }
    }

    /// The ego's cameras.
    #[getter]
    fn rig(&self) -> Vec<RigCamera> {
        self.scene
            .rig()
            .cameras()
            .map(|camera| RigCamera {
                inner: camera.clone(),
            })
            .collect()
    }

    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// A handle: its copies are itself. Gymnasium copies the arguments of environments.
    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __repr__(&self) -> String {
        format!(
            "Site({} lanes, {} splats)",
            self.site.lanes.lanes.len(),
            self.scene.background_splats()
        )
    }
}
