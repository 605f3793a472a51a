//! Compliance with speed limits.

use decouplegs_scene::Episode;

/// Mean excess of speed at which nothing is left of the score, m/s.
const EXCESS_MPS: f64 = 2.23;

/// nuPlan's speed limit compliance (Karnchanachari et al., 2024): `max(0, 1 - excess / (2.23 T))`,
/// with the way that the ego drove by going faster than the limits, and the duration `T`. `None`
/// where no moment has a limit.
pub(super) fn compliance(episode: &Episode) -> Option<f64> {
    let (mut excess_m, mut duration_s, mut has_limit) = (0.0, 0.0, false);
    let instants: Vec<_> = episode.instants().collect();
    for pair in instants.windows(2) {
        let step_s = pair[1].time_s - pair[0].time_s;
        duration_s += step_s;
        if let Some(limit_mps) = pair[1].lanes.and_then(|lanes| lanes.limit_mps) {
            has_limit = true;
            excess_m += (pair[1].ego.speed_mps - limit_mps).max(0.0) * step_s;
        }
    }
    has_limit.then(|| (1.0 - excess_m / (EXCESS_MPS * duration_s)).max(0.0))
}
