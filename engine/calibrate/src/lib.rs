//! Theta, calibrated offline: from environment probes and assets to a [`LightTransfer`].
//!
//! DecoupleGS section 3.4 and supplement: `T = W_T L + w_0` and `b = W_B L + b_0` are fitted by
//! ridge-regularized least squares over assets and probes. The truth is what light makes of matt
//! surfaces (`surface`): each splat faces along its shortest axis, its color is its albedo, and the
//! probe's irradiance falls on it, with a reference ground below the horizon. L is what that ground
//! looks like in that light (`surroundings`), because at run time L is what the background looks
//! like. Probes are turned, mirrored and exposed (`lighting`) so that lights span all of R^27; a
//! fit that they leave undetermined is refused.
#![forbid(unsafe_code)]

mod confidence;
mod held_out;
mod lighting;
mod moments;
mod options;
mod prior;
mod ridge;
mod sample;
mod standard;
mod surface;
#[cfg(test)]
mod tests;

use decouplegs_scene::light::{PROBE_WIDTH, Probe};
use decouplegs_scene::{LightTransfer, SplatCloud, sh};
use rayon::prelude::*;

pub use held_out::{ColorError, Comparison, HUE_FLOOR};
pub use lighting::{GROUND_DISPLAY, Lighting, PreparedProbe, lightings};
pub use options::{CalibrateError, CalibrateOptions, LIGHTS_MIN, Objective};
pub use surface::lit_cloud;

use moments::{LightMoments, Moments};
use prior::prior;
use ridge::{COLUMNS, Rank, Ridge, Theta, rank_of};
use sample::{Sample, samples};

/// The ridge where too few probes are given to leave one out.
pub const DEFAULT_RIDGE: f64 = 1e-2;

/// Ridges that are tried, in decades from this one.
const RIDGE_MIN: f64 = 1e-5;
const RIDGES: usize = 7;

/// Strength of the pull on the prior's own weights, relative to the strength of the pull to the
/// prior. A hundred and more did not differ for eight probes; one gave 4 % more error and hues 0.3
/// degrees farther off.
const RIDGE_FROM_PRIOR: f64 = 100.0;

/// Progress report of a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Choosing splats.
    Sampling,
    /// Number of probes that are integrated.
    Probes(usize),
    /// Summing over splats and lights.
    Moments,
    /// Number of probes that were left out and compared.
    HeldOut(usize),
}

/// A probe that was left out of a fit, and the colors in its light.
#[derive(Clone, Debug)]
pub struct HeldOut {
    /// Index of the probe.
    pub probe: usize,
    /// Theta fitted without it, its ridge chosen without it.
    pub transfer: LightTransfer,
    /// Ridge strength.
    pub ridge: f64,
    /// Seen colors over all turns and exposures of the probe.
    pub comparison: Comparison,
}

/// An asset that was left out of a fit, and its colors in all lights.
#[derive(Clone, Debug)]
pub struct HeldOutAsset {
    /// Index of the asset.
    pub asset: usize,
    /// Seen colors over all lights, by the transfer fitted without the asset.
    pub comparison: Comparison,
}

/// A light transfer, and what is known of it.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// Light transfer function that was fitted.
    pub transfer: LightTransfer,
    /// The ridge it was fitted with.
    pub ridge: f64,
    /// Ridges tried, and the root of the mean squared error by the objective over probes left out;
    /// empty where none could be.
    pub tried: Vec<(f64, f64)>,
    /// Lights it was fitted to, the neutral one included.
    pub lights: usize,
    /// Splats it was fitted to.
    pub samples: usize,
    /// Dimensions that the descriptors and the constant span: all 28, as fewer are refused.
    pub rank: usize,
    /// Smallest singular value of the standardized descriptors over the largest: the reciprocal of
    /// the condition number.
    pub smallest_over_largest: f64,
    /// Colors in the neutral light, which should be as they are.
    pub neutral: Comparison,
    /// Each probe left out in turn; without those that the others cannot do without.
    pub held_out: Vec<HeldOut>,
    /// Each asset left out in turn; none if there is only one.
    pub held_out_assets: Vec<HeldOutAsset>,
}

impl Calibration {
    /// All that was left out, together.
    #[must_use]
    pub fn total(&self) -> Comparison {
        let mut total = Comparison::new();
        self.held_out
            .iter()
            .for_each(|held_out| total.merge(&held_out.comparison));
        total
    }
}

/// A light transfer for `assets`, each with a name for messages, in the light of `probes`. The same
/// on any number of threads.
///
/// # Errors
/// A [`CalibrateError`]: options out of range, assets that show nothing, lights that leave the
/// weights undetermined.
pub fn calibrate(
    assets: &[(String, &SplatCloud)],
    probes: &[Probe],
    options: &CalibrateOptions,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Calibration, CalibrateError> {
    options.check(assets.len())?;
    progress(Progress::Sampling);
    let of_assets = samples_of(assets, options)?;
    let samples: Vec<Sample> = of_assets.iter().flatten().cloned().collect();
    let prepare = |(index, probe): (usize, &Probe)| {
        progress(Progress::Probes(index));
        PreparedProbe::new(&probe.downsampled(PROBE_WIDTH), &options.ground)
    };
    let probes: Vec<PreparedProbe> = probes.iter().enumerate().map(prepare).collect();
    let lights = lightings(&probes, &options.ground, options.rotations);
    progress(Progress::Moments);
    let degree_of_assets = assets
        .iter()
        .map(|(_, cloud)| cloud.sh_degree)
        .max()
        .unwrap_or(0);
    let sh_degree = options
        .sh_degree
        .unwrap_or(degree_of_assets)
        .min(sh::DEGREE_MAX);
    let (fitted, seen) = moments_of(&samples, &lights, sh_degree, options.objective);
    let fit = Fit {
        fitted,
        sh_degree,
        options,
        probes: probes.len(),
    };
    let all: Vec<&LightMoments> = fit.fitted.lights.iter().collect();
    let rank = check_rank(&all, probes.len())?;

    let left_out = fit.errors_of_left_out();
    let in_light_of = |probe: Option<usize>| {
        let pairs = lights.iter().zip(&seen.lights);
        pairs.filter(move |(_, light)| light.probe == probe)
    };
    let compare = |transfer: &LightTransfer, probe: Option<usize>| {
        let of_probe: Vec<_> = in_light_of(probe).collect();
        Comparison::for_transfer(transfer, &samples, &seen, &of_probe)
    };
    let mut held_out = Vec::new();
    for probe in (0..probes.len()).filter(|&probe| left_out[probe][probe].is_some()) {
        progress(Progress::HeldOut(probe));
        let ridge = fit.ridge_from(
            (0..probes.len())
                .filter(|&other| other != probe)
                .map(|other| &left_out[probe][other]),
        );
        let transfer = fit.transfer(&fit.without(&[probe]), ridge);
        held_out.push(HeldOut {
            probe,
            ridge,
            comparison: compare(&transfer, Some(probe)),
            transfer,
        });
    }
    let errors = || (0..probes.len()).map(|probe| &left_out[probe][probe]);
    let ridge = fit.ridge_from(errors());
    let mut transfer = fit.transfer(&all, ridge);
    let mut judged = Vec::new();
    for held_out in &held_out {
        let of_probe = in_light_of(Some(held_out.probe));
        judged.extend(
            of_probe.map(|(light, of_light)| (&held_out.transfer, &light.descriptor, of_light)),
        );
    }
    if !judged.is_empty() {
        transfer.confidence = Some(confidence::confidence(&seen, &all, &judged));
    }
    Ok(Calibration {
        neutral: compare(&transfer, None),
        transfer,
        ridge,
        tried: tried(errors()),
        lights: lights.len(),
        samples: samples.len(),
        rank: rank.rank,
        smallest_over_largest: rank.smallest_over_largest,
        held_out_assets: assets_left_out(&of_assets, &lights, &fit, ridge),
        held_out,
    })
}

/// Moments of `samples` in `lights` for colors of degree `sh_degree`: by `objective`, and by
/// visible colors.
fn moments_of(
    samples: &[Sample],
    lights: &[Lighting<'_>],
    sh_degree: u8,
    objective: Objective,
) -> (Moments, Moments) {
    let lit = |sample: &Sample, light: &Lighting<'_>| {
        sample
            .surface
            .lit(light.reflected_by_white(sample.surface.normal))
    };
    let coefficients = sh::coefficient_count(sh_degree);
    let moments = |objective| Moments::from_samples(samples, lights, coefficients, objective, lit);
    let seen = moments(Objective::Seen);
    let fitted = match objective {
        Objective::Seen => seen.clone(),
        Objective::Coefficients => moments(objective),
    };
    (fitted, seen)
}

/// Each asset compared with the truth by a fit to the others; none if there is only one.
fn assets_left_out(
    of_assets: &[Vec<Sample>],
    lights: &[Lighting<'_>],
    fit: &Fit<'_>,
    ridge: f64,
) -> Vec<HeldOutAsset> {
    if of_assets.len() < 2 {
        return Vec::new();
    }
    let all = of_assets.iter().map(Vec::len).sum::<usize>() as f64;
    let without = |(asset, own): (usize, &Vec<Sample>)| {
        let (fitted, seen) = moments_of(own, lights, fit.sh_degree, fit.options.objective);
        let share = own.len() as f64 / all;
        let rest = Fit {
            fitted: fit.fitted.without(&fitted, share),
            ..*fit
        };
        let transfer = rest.transfer(&rest.without(&[]), ridge);
        let pairs: Vec<_> = lights.iter().zip(&seen.lights).collect();
        HeldOutAsset {
            asset,
            comparison: Comparison::for_transfer(&transfer, own, &seen, &pairs),
        }
    };
    of_assets.iter().enumerate().map(without).collect()
}

/// Samples of each asset.
fn samples_of(
    assets: &[(String, &SplatCloud)],
    options: &CalibrateOptions,
) -> Result<Vec<Vec<Sample>>, CalibrateError> {
    let mut all = Vec::with_capacity(assets.len());
    for (index, (name, cloud)) in assets.iter().enumerate() {
        let of_asset = samples(
            cloud,
            options.samples / assets.len(),
            options.seed.wrapping_add(index as u64),
        );
        if of_asset.is_empty() {
            return Err(CalibrateError::NothingSeen(name.clone()));
        }
        all.push(of_asset);
    }
    Ok(all)
}

/// Rank and ratio of singular values of `lights`, if they determine all weights.
fn check_rank(lights: &[&LightMoments], probes: usize) -> Result<Rank, CalibrateError> {
    let mut different: Vec<&LightMoments> = Vec::new();
    for &light in lights.iter().filter(|light| light.probe.is_some()) {
        let same = |other: &&LightMoments| {
            light
                .descriptor
                .iter()
                .zip(other.descriptor)
                .all(|(a, b)| (a - b).abs() < 1e-6)
        };
        if !different.iter().any(same) {
            different.push(light);
        }
    }
    if different.len() < LIGHTS_MIN {
        return Err(CalibrateError::TooFewLights {
            found: different.len(),
            probes,
        });
    }
    let rank = rank_of(lights);
    if rank.rank < COLUMNS {
        let (rank, ratio) = (rank.rank, rank.smallest_over_largest);
        return Err(CalibrateError::RankDeficient {
            lights: lights.len(),
            probes,
            rank,
            ratio,
        });
    }
    Ok(rank)
}

fn ridges() -> impl Iterator<Item = f64> {
    (0..RIDGES).map(|step| RIDGE_MIN * 10f64.powi(step as i32))
}

/// Mean squared errors in the light of one probe by each ridge; none where the lights left do not
/// determine a fit.
type Errors = Option<[f64; RIDGES]>;

/// Each ridge, and the root of the mean of `errors`.
fn tried<'a>(errors: impl Iterator<Item = &'a Errors>) -> Vec<(f64, f64)> {
    let known: Vec<[f64; RIDGES]> = errors.filter_map(|errors| *errors).collect();
    if known.is_empty() {
        return Vec::new();
    }
    let mean = |at: usize| known.iter().map(|errors| errors[at]).sum::<f64>() / known.len() as f64;
    // Rounding may leave the error of a perfect fit slightly below 0.
    ridges()
        .enumerate()
        .map(|(at, ridge)| (ridge, mean(at).max(0.0).sqrt()))
        .collect()
}

/// Moments to be fitted, and how.
struct Fit<'a> {
    fitted: Moments,
    sh_degree: u8,
    options: &'a CalibrateOptions,
    probes: usize,
}

impl Fit<'_> {
    fn without(&self, probes: &[usize]) -> Vec<&LightMoments> {
        self.fitted
            .lights
            .iter()
            .filter(|light| light.probe.is_none_or(|probe| !probes.contains(&probe)))
            .collect()
    }

    fn theta(&self, equations: &Ridge, lights: &[&LightMoments], ridge: f64) -> Theta {
        equations.solve(
            RIDGE_FROM_PRIOR * ridge,
            &prior(&self.fitted, lights, ridge),
        )
    }

    fn transfer(&self, lights: &[&LightMoments], ridge: f64) -> LightTransfer {
        let theta = self.theta(&Ridge::new(&self.fitted, lights), lights, ridge);
        theta.to_transfer(self.sh_degree, self.options.ground.neutral())
    }

    /// `[f][g]`: the errors in the light of probe g of fits without f and g.
    fn errors_of_left_out(&self) -> Vec<Vec<Errors>> {
        let pairs: Vec<(usize, usize)> = (0..self.probes)
            .flat_map(|f| (f..self.probes).map(move |g| (f, g)))
            .collect();
        let of_pairs: Vec<[Errors; 2]> = pairs
            .par_iter()
            .map(|&(f, g)| self.errors_without(f, g))
            .collect();
        let mut errors = vec![vec![None; self.probes]; self.probes];
        for ((f, g), [of_f, of_g]) in pairs.into_iter().zip(of_pairs) {
            errors[g][f] = of_f;
            errors[f][g] = of_g;
        }
        errors
    }

    /// The errors in the light of probe f and of probe g of fits without both.
    fn errors_without(&self, f: usize, g: usize) -> [Errors; 2] {
        let lights = self.without(&[f, g]);
        if lights.len() < COLUMNS || rank_of(&lights).rank < COLUMNS {
            return [None; 2];
        }
        let equations = Ridge::new(&self.fitted, &lights);
        let thetas: Vec<Theta> = ridges()
            .map(|ridge| self.theta(&equations, &lights, ridge))
            .collect();
        [f, g].map(|probe| {
            let of_probe: Vec<&LightMoments> = self
                .fitted
                .lights
                .iter()
                .filter(|light| light.probe == Some(probe))
                .collect();
            let mean = |theta: &Theta| {
                let error =
                    |light: &&LightMoments| self.fitted.error(light, &theta.at(&light.descriptor));
                of_probe.iter().map(error).sum::<f64>() / of_probe.len() as f64
            };
            (!of_probe.is_empty()).then(|| std::array::from_fn(|at| mean(&thetas[at])))
        })
    }

    /// The ridge asked for, or the one of least error.
    fn ridge_from<'a>(&self, errors: impl Iterator<Item = &'a Errors>) -> f64 {
        let best = || {
            tried(errors)
                .into_iter()
                .min_by(|a, b| a.1.total_cmp(&b.1))
                .map(|(ridge, _)| ridge)
        };
        self.options.ridge.or_else(best).unwrap_or(DEFAULT_RIDGE)
    }
}
