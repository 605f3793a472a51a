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
    pub fn of(episode: &Episode) -> Self {
        let mut comfort = Self::default();
        let mut before = &episode.start;
        for instant in episode.instants() {
            comfort.braking_max_mps2 = comfort.braking_max_mps2.max(-instant.ego.acceleration_mps2);
            let span_s = instant.time_s - before.time_s;
            if span_s > 0.0 {
                let turned_rad = wrapped(instant.ego.yaw_rad - before.ego.yaw_rad);
                let speed_mps = 0.5 * (instant.ego.speed_mps + before.ego.speed_mps);
                let lateral_mps2 = (speed_mps * turned_rad / span_s).abs();
                comfort.lateral_acceleration_max_mps2 =
                    comfort.lateral_acceleration_max_mps2.max(lateral_mps2);
            }
            before = instant;
        }
        comfort
    }
}
