//! Speeds at the start from which all vehicles can stop in time.
//!
//! The rule is that of Gipps ("A behavioral car-following model for computer simulation", 1981) and
//! Krauss ("Microscopic modeling of traffic flow", 1998): a follower can stop behind a leader
//! that brakes at once and as hard as it can, after a time to react.

/// A planner answers at steps of half a second; one step may be lost.
const REACTION_S: f64 = 1.0;
/// Deceleration of a follower on which safe gaps count, m/s^2: a full brake of the ego is 8.
const BRAKING_MPS2: f64 = 6.0;
/// Hardest braking of any vehicle, m/s^2: a dry road gives no more.
const LEADER_BRAKING_MPS2: f64 = 8.0;
/// Gap between two standing vehicles, meters.
const STANDING_GAP_M: f64 = 2.0;

/// The highest speed behind a leader `gap_m` ahead, bumper to bumper: that of v T + v^2 / 2b = gap
/// + (its own braking distance).
pub(super) fn behind(gap_m: f64, leader_mps: f64) -> f64 {
    let room_m = gap_m - STANDING_GAP_M + leader_mps * leader_mps / (2.0 * LEADER_BRAKING_MPS2);
    let root = (REACTION_S * REACTION_S + 2.0 * room_m.max(0.0) / BRAKING_MPS2).sqrt();
    BRAKING_MPS2 * (root - REACTION_S)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_follows_so_fast_stops_behind() {
        for gap_m in [2.5, 6.0, 15.0, 60.0] {
            for leader_mps in [0.0, 4.0, 14.0] {
                let speed_mps = behind(gap_m, leader_mps);
                // Step by step, as vehicles move.
                let (mut gap_m, mut least_m, dt_s) = (gap_m, f64::INFINITY, 0.001);
                let (mut own_mps, mut leader_mps) = (speed_mps, leader_mps);
                for step in 0..10_000 {
                    let braking = if f64::from(step) * dt_s < REACTION_S {
                        0.0
                    } else {
                        BRAKING_MPS2
                    };
                    own_mps = (own_mps - braking * dt_s).max(0.0);
                    leader_mps = (leader_mps - LEADER_BRAKING_MPS2 * dt_s).max(0.0);
                    gap_m += (leader_mps - own_mps) * dt_s;
                    least_m = least_m.min(gap_m);
                }
                assert!(
                    (least_m - STANDING_GAP_M).abs() < 0.02,
                    "{speed_mps} m/s leave {least_m} m"
                );
            }
        }
        assert_eq!(behind(1.0, 0.0), 0.0);
    }
}
