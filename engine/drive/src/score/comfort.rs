//! Comfort: braking and turning of an ego.

use decouplegs_scene::Episode;

use crate::polyline::wrapped;

/// The hardest that passengers felt.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Comfort {
    /// Hardest braking, zero or above.
    pub braking_max_mps2: f64,
    /// Hardest turn: speed times rate of the heading between two moments, zero or above.
    pub lateral_acceleration_max_mps2: f64,
}

impl Comfort {
    /// Comfort of the ego in `episode`.
    #[must_use]
    pub fn new(episode: &Episode) -> Self {
        let braking = episode
            .instants()
            .map(|instant| -instant.ego.acceleration_mps2);
        let lateral = lateral_accelerations(episode).into_iter();
        Self {
            braking_max_mps2: braking.fold(0.0, f64::max),
            lateral_acceleration_max_mps2: lateral
                .map(|(_, lateral_mps2)| lateral_mps2.abs())
                .fold(0.0, f64::max),
        }
    }
}

/// Acceleration of the ego across its heading between moments, to the left above zero, with the
/// time of the later moment, seconds: speed times rate of the heading, m/s^2.
#[must_use]
pub fn lateral_accelerations(episode: &Episode) -> Vec<(f64, f64)> {
    let instants: Vec<_> = episode.instants().collect();
    let moving = instants.windows(2).filter_map(|pair| {
        let (before, after) = (pair[0], pair[1]);
        let span_s = after.time_s - before.time_s;
        let turned_rad = wrapped(after.ego.yaw_rad - before.ego.yaw_rad);
        let speed_mps = 0.5 * (after.ego.speed_mps + before.ego.speed_mps);
        (span_s > 0.0).then(|| (after.time_s, speed_mps * turned_rad / span_s))
    });
    moving.collect()
}
