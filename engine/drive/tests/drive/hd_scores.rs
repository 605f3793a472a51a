//! HD-Scores of episodes whose terms are known.

use decouplegs_drive::score::{HdScore, HdVariant};
use decouplegs_scene::{EpisodeEnd, Obstacle, ObstacleKind, VehicleState};
use glam::DVec2;

use super::episodes::{Motion, episode, straight};

const STEPS: usize = 20;

fn hd_score(ego: &Motion, agents: &[Motion], end: EpisodeEnd) -> HdScore {
    HdScore::new(&episode(STEPS, ego, agents, end), HdVariant::Corrected)
}

#[test]
fn a_calm_drive_has_its_route_completion() {
    let score = hd_score(&straight(0.0, 0.0, 0.0, 5.0), &[], EpisodeEnd::Time);
    assert_eq!(
        [
            score.no_collision,
            score.drivable_area,
            score.time_to_collision,
            score.comfort
        ],
        [1.0; 4]
    );
    assert!((score.route_completion - 0.5).abs() < 1e-9);
    assert_eq!(score.hd_score, score.route_completion);
}

#[test]
fn each_term_costs_what_it_weighs() {
    let calm = straight(0.0, 0.0, 0.0, 5.0);
    let rc = hd_score(&calm, &[], EpisodeEnd::Time).route_completion;
    // A parked car is at 56.1 m. At 5 m/s the boxes touch within one second once the middle of the
    // ego is past 46.6 m: the last 7 of 101 moments.
    let standing = |x: f64| -> Motion { straight(x, 0.0, 0.0, 0.0) };
    let near = hd_score(&calm, &[standing(56.1)], EpisodeEnd::Time);
    let share = near.time_to_collision;
    assert!((share - 94.0 / 101.0).abs() < 1e-9, "{near:?}");
    assert_eq!(near.no_collision, 1.0);
    let expected = rc * (1.0 - 5.0 / 7.0 * (1.0 - share));
    assert!((near.hd_score - expected).abs() < 1e-9, "{near:?}");
    // An ego that stands is on no course for a collision.
    let parked = hd_score(
        &standing(0.0),
        &[straight(12.0, 0.0, std::f64::consts::PI, 1.0)],
        EpisodeEnd::Time,
    );
    assert!(parked.time_to_collision > parked.no_collision - 1e-12 && parked.no_collision < 1.0);

    // Off the road for the second half.
    let mut off = episode(STEPS, &calm, &[], EpisodeEnd::Time);
    for step in &mut off.steps[STEPS / 2..] {
        step.instants
            .iter_mut()
            .for_each(|tick| tick.on_road = false);
    }
    let off = HdScore::new(&off, HdVariant::Corrected);
    assert!((off.drivable_area - 51.0 / 101.0).abs() < 1e-9);
    assert!((off.hd_score - rc * off.drivable_area).abs() < 1e-9);

    // The last moment touches something static.
    let obstacle = Obstacle {
        kind: ObstacleKind::Tree,
        center_m: DVec2::new(52.0, 0.0),
        yaw_rad: 0.0,
        length_m: 0.6,
        width_m: 0.6,
    };
    let hit = hd_score(&calm, &[], EpisodeEnd::Obstacle { obstacle });
    assert!((hit.no_collision - 100.0 / 101.0).abs() < 1e-9, "{hit:?}");
}

#[test]
fn comfort_counts_turns_unless_it_is_as_published() {
    // 10 m/s on a circle of 15 m: 6.7 m/s^2 across, which is no comfort; 0.67 rad/s is allowed.
    let circle: Motion = Box::new(|time_s| {
        let angle_rad = 10.0 * time_s / 15.0;
        VehicleState {
            position_m: 15.0 * DVec2::new(angle_rad.sin(), 1.0 - angle_rad.cos()),
            yaw_rad: angle_rad,
            speed_mps: 10.0,
            acceleration_mps2: 0.0,
        }
    });
    let driven = episode(STEPS, &circle, &[], EpisodeEnd::Time);
    let [published, corrected] = [HdVariant::AsPublished, HdVariant::Corrected]
        .map(|variant| HdScore::new(&driven, variant));
    assert_eq!((published.comfort, corrected.comfort), (1.0, 0.0));
    assert!((corrected.hd_score / published.hd_score - 5.0 / 7.0).abs() < 1e-9);

    // Braking at 6 m/s^2 from the third second on.
    let braking: Motion = Box::new(|time_s| {
        let since_s = (time_s - 3.0_f64).clamp(0.0, 2.0);
        VehicleState {
            position_m: DVec2::new(
                12.0 * time_s.min(3.0) + since_s * (12.0 - 3.0 * since_s),
                0.0,
            ),
            speed_mps: 12.0 - 6.0 * since_s,
            ..VehicleState::default()
        }
    });
    let hard = HdScore::new(
        &episode(STEPS, &braking, &[], EpisodeEnd::Time),
        HdVariant::AsPublished,
    );
    assert!(hard.comfort < 0.9 && hard.comfort > 0.6, "{hard:?}");
}
