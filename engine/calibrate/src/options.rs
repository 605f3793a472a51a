//! Options and errors of a calibration.

use std::fmt;

use thiserror::Error;

use super::ridge::COLUMNS;
use decouplegs_scene::light::Surroundings;

/// Least lights that can tell the 27 weights and the constant of each row of Theta.
pub const LIGHTS_MIN: usize = COLUMNS;

/// Quantity that the fit minimizes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Objective {
    /// The error of coefficients, each on its own: that of the paper. As much as the error of
    /// colors in all directions, those from which the splat's outer side is not seen included.
    Coefficients,
    /// The error of colors in the directions in which a splat's outer side is seen, by projected
    /// area.
    #[default]
    Seen,
}

impl fmt::Display for Objective {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Coefficients => "coefficients",
            Self::Seen => "seen",
        })
    }
}

/// Options of the calibration of a light transfer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrateOptions {
    /// Degree of the colors it is for; by default the highest among the assets.
    pub sh_degree: Option<u8>,
    /// Ridge strength towards the prior, above 0. Default: the strength with the least error on
    /// probes that are left out.
    pub ridge: Option<f64>,
    /// Quantity that the fit minimizes.
    pub objective: Objective,
    /// Number of turns of each probe about the vertical, 1 to 64.
    pub rotations: usize,
    /// Splats examined, shared evenly by the assets, at least one each.
    pub samples: usize,
    /// The ground whose color tells of the light.
    pub ground: Surroundings,
    /// Seed of all randomness.
    pub seed: u64,
}

impl Default for CalibrateOptions {
    fn default() -> Self {
        Self {
            sh_degree: None,
            ridge: None,
            objective: Objective::default(),
            rotations: 6,
            samples: 4096,
            ground: Surroundings::default(),
            seed: 1,
        }
    }
}

impl CalibrateOptions {
    pub(super) fn check(&self, assets: usize) -> Result<(), CalibrateError> {
        let Surroundings { albedo, gloss } = self.ground;
        let fault = match self {
            _ if assets == 0 => "there is no asset; name at least one file of splats".to_owned(),
            Self {
                rotations: 0 | 65..,
                ..
            } => format!("{} rotations; expected 1 to 64", self.rotations),
            Self { samples, .. } if !(assets..=1 << 20).contains(samples) => {
                format!(
                    "{samples} samples; expected {assets}, one an asset, to {}",
                    1 << 20
                )
            }
            Self {
                sh_degree: Some(degree @ 4..),
                ..
            } => format!("degree {degree}; expected 0 to 3"),
            Self {
                ridge: Some(ridge), ..
            } if !(ridge.is_finite() && *ridge > 0.0) => {
                format!("a ridge of {ridge}; expected a number above 0")
            }
            _ if !(albedo > 0.0 && albedo <= 1.0) => {
                format!("a ground of albedo {albedo}; expected above 0, at most 1")
            }
            _ if !(0.0..=1.0).contains(&gloss) => {
                format!("a ground of gloss {gloss}; expected 0 to 1")
            }
            _ => return Ok(()),
        };
        Err(CalibrateError::Option(fault))
    }
}

/// Reason why a calibration failed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CalibrateError {
    /// An option out of range.
    #[error("{0}")]
    Option(String),
    /// An asset of which nothing is seen.
    #[error("{0}: none of its splats shows and tells which way it faces; leave it out")]
    NothingSeen(String),
    /// The lights are fewer than the unknowns.
    #[error(
        "{found} different lights from {probes} probe(s); at least {LIGHTS_MIN} are needed: give more probes or turn them more ways"
    )]
    TooFewLights {
        /// Different descriptors, without the neutral one.
        found: usize,
        /// Probes given.
        probes: usize,
    },
    /// Lights that leave weights undetermined.
    #[error(
        "{lights} lights from {probes} probe(s) span {rank} of {COLUMNS} dimensions (smallest singular value {ratio:.1e} of the \
         largest): the weights are not determined; give at least six probes of other places and hours, and turn each at least 5 ways"
    )]
    RankDeficient {
        /// Number of lights.
        lights: usize,
        /// Probes given.
        probes: usize,
        /// Dimensions that they span, constant included.
        rank: usize,
        /// Smallest singular value over the largest.
        ratio: f64,
    },
}
