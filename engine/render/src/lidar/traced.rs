//! Result of a sweep: states of beams, and the returns that a sensor makes of them.

use std::sync::Arc;

use decouplegs_gpu::StageTime;
use decouplegs_scene::lidar::{Beam, Echo, LidarReturn, ReturnMode, ReturnOptions};
use decouplegs_scene::{Lidar, LidarSweep, random};

use rayon::prelude::*;

use crate::layout::{BeamEchoes, BeamState, RequiredCounts};

/// States of the beams of a sweep.
#[derive(Clone, Debug)]
pub struct TracedSweep {
    /// Sensor, and its poses during the sweep.
    pub lidar: Lidar,
    /// Beams, in the order of `LidarModel::beams`.
    pub beams: Arc<[Beam]>,
    /// State of each beam.
    pub states: Vec<BeamState>,
    /// Echoes of each beam; empty unless they were asked for.
    pub echoes: Vec<BeamEchoes>,
    /// Counts of the lists.
    pub required: RequiredCounts,
    /// Time on the device, nanoseconds.
    pub gpu_time_ns: u64,
    /// Start and end of each stage; empty unless [`crate::LidarRenderer::time_stages`] asked for
    /// them.
    pub stages: Vec<StageTime>,
}

impl TracedSweep {
    /// Returns of the sweep: a beam has one if splats took enough of it and the range is one that
    /// the sensor reports. Noise, where the model has some, is added last, and depends on the seed
    /// and the beam alone.
    ///
    /// # Panics
    /// Panics if the mode is [`ReturnMode::Dual`], and the sweep was traced for another one.
    #[must_use]
    pub fn returns(&self, options: &ReturnOptions) -> LidarSweep {
        let model = &self.lidar.model;
        let noise_m = |beam: usize| match model.range_noise_m {
            0.0 => 0.0,
            deviation_m => (deviation_m * normal(options.seed, beam as u64)) as f32,
        };
        let [least_m, greatest_m] = model.range_m.map(|range| range as f32);
        let is_dual = options.mode == ReturnMode::Dual;
        assert!(
            !is_dual || self.echoes.len() == self.states.len(),
            "dual returns of a sweep that was traced without echoes"
        );
        let found = |(beam, state): (usize, &BeamState)| {
            let of_state = || {
                let (range_m, instance) = state.range(options.mode)?;
                let weight = 1.0 - state.transmittance;
                let intensity = state.intensity();
                let echo = Echo {
                    weight,
                    range_m,
                    intensity,
                    instance,
                };
                (weight >= options.opacity_min).then_some(echo)
            };
            let echoes = match is_dual {
                true => self.echoes[beam].found(),
                false => [of_state(), None],
            };
            let reports = |echo: &Echo| (least_m..=greatest_m).contains(&echo.range_m);
            let echoes = echoes.map(|echo| echo.filter(reports));
            let count = echoes.iter().flatten().count() as u8;
            echoes
                .into_iter()
                .flatten()
                .zip(1..)
                .map(move |(echo, number)| LidarReturn {
                    beam: beam as u32,
                    range_m: echo.range_m + noise_m(beam),
                    intensity: echo.intensity,
                    instance: echo.instance,
                    number,
                    count,
                })
        };
        LidarSweep {
            lidar: self.lidar.clone(),
            beams: self.beams.clone(),
            returns: in_order(&self.states, found),
        }
    }
}

/// Beams that a thread is given at once.
const BEAMS_AT_ONCE: usize = 4096;

/// Returns that `found` makes of each beam, in the order of beams, on all threads.
fn in_order<I: Iterator<Item = LidarReturn>>(
    states: &[BeamState],
    found: impl Fn((usize, &BeamState)) -> I + Sync,
) -> Vec<LidarReturn> {
    let of_some = |(piece, some): (usize, &[BeamState])| -> Vec<LidarReturn> {
        let beams = piece * BEAMS_AT_ONCE..;
        beams.zip(some).flat_map(&found).collect()
    };
    let pieces = states.par_chunks(BEAMS_AT_ONCE).enumerate();
    let returns: Vec<Vec<LidarReturn>> = pieces.map(of_some).collect();
    returns.concat()
}

/// A normally distributed number of mean 0 and variance 1 (Box and Muller, 1958).
fn normal(seed: u64, index: u64) -> f64 {
    let mut state = random::mix(seed ^ random::mix(index));
    let [first, second] = std::array::from_fn(|_| random::unit(random::next(&mut state)));
    (-2.0 * (1.0 - first).ln()).sqrt() * (std::f64::consts::TAU * second).cos()
}
