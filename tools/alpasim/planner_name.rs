//! Planners by the names that the command line gives them.

use std::fmt;
use std::str::FromStr;

use crate::egodriver::{DriverAddress, DriverOptions, Egodriver, SensorLens};
use anyhow::{Context, Result};
use decouplegs::episode::ObservationRenderer;
use decouplegs::planner::{Planner, PlannerChoice, PlannerError, Timeouts};
use decouplegs::scene::Invalid;

/// Time between decisions of AlpaSim's runtime, seconds.
const DRIVER_STEP_S: f64 = 0.1;

/// Planner of the engine, or a driver of AlpaSim.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlannerName {
    /// Planner of the engine.
    Engine(PlannerChoice),
    /// Driver at this address.
    Driver(DriverAddress),
}

impl PlannerName {
    /// Opens the planner. Answers are waited for as `timeouts` say.
    ///
    /// # Errors
    /// Returns an error if it cannot be started or reached.
    pub fn open(&self, timeouts: Timeouts, options: &DriverOptions) -> Result<Box<dyn Planner>> {
        let opened: Result<Box<dyn Planner>, PlannerError> = match self {
            Self::Engine(choice) => choice.open(timeouts),
            Self::Driver(address) => Egodriver::open(address, options, timeouts)
                .map(|driver| Box::new(driver) as Box<dyn Planner>),
        };
        opened.with_context(|| format!("the planner {self} cannot be opened"))
    }

    /// True for a driver of AlpaSim.
    #[must_use]
    pub fn is_driver(&self) -> bool {
        matches!(self, Self::Driver(_))
    }

    /// Time from one plan to the next, seconds, unless something else is asked for; `None` for that
    /// of the scenario.
    #[must_use]
    pub fn step_s(&self) -> Option<f64> {
        self.is_driver().then_some(DRIVER_STEP_S)
    }

    /// Gives the cameras of `renderer` the lens that `options` ask for, for a driver.
    ///
    /// # Errors
    /// A sentence naming a camera that can have none.
    pub fn fit(
        &self,
        renderer: ObservationRenderer,
        options: &DriverOptions,
    ) -> Result<ObservationRenderer, Invalid> {
        match (self, options.driver_lens) {
            (Self::Driver(_), SensorLens::FTheta) => renderer.through_f_theta(),
            _ => Ok(renderer),
        }
    }
}

impl FromStr for PlannerName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.starts_with(DriverAddress::SCHEME) {
            return text.parse().map(Self::Driver);
        }
        let choice = text.parse().map(Self::Engine);
        choice.map_err(|reason: String| format!("{reason}, or egodriver://HOST:PORT"))
    }
}

impl fmt::Display for PlannerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Engine(choice) => choice.fmt(f),
            Self::Driver(address) => address.fmt(f),
        }
    }
}
