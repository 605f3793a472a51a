//! Motion towards a distance that others change.

use decouplegs_scene::story::Limits;

/// Pull per meter, as a share of the largest acceleration, 1/m.
const PULL_PER_M: f64 = 0.4;

/// A spring with the damping that lets it settle soonest, within limits of acceleration and jerk.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Spring {
    acceleration_mps2: f64,
}

impl Spring {
    /// Acceleration for a step of `dt_s` where `more_m` are left and are closed with
    /// `closing_mps`, m/s^2. `most` are the largest ones up and down.
    pub(super) fn acceleration_mps2(
        &mut self,
        [more_m, closing_mps]: [f64; 2],
        [most_up, most_down]: [f64; 2],
        limits: &Limits,
        dt_s: f64,
    ) -> f64 {
        let pull = PULL_PER_M * if more_m < 0.0 { most_up } else { most_down };
        let wanted = pull * more_m - 2.0 * pull.sqrt() * closing_mps;
        let wanted = wanted.clamp(-most_down, most_up);
        let rate = match wanted < 0.0 {
            true => limits.deceleration_rate_mps3,
            false => limits.acceleration_rate_mps3,
        };
        let step = rate.map_or(f64::INFINITY, |rate| rate * dt_s);
        let before = self.acceleration_mps2;
        // A pull that grows does so at its rate; one that ends may end at once.
        self.acceleration_mps2 = match wanted < 0.0 {
            true => wanted.max(before - step),
            false => wanted.min(before + step),
        };
        self.acceleration_mps2
    }
}
