//! HD-Scores of episodes whose terms are known.

use decouplegs_drive::score::HdScore;
use decouplegs_scene::{EpisodeEnd, Obstacle, ObstacleKind, VehicleState};
use glam::DVec2;

use super::episodes::{Motion, episode, straight};

const STEPS: usize = 20;

fn hd_score(ego: &Motion, agents: &[Motion], end: EpisodeEnd) -> HdScore {
    HdScore::from_driven(&episode(STEPS, ego, agents, end))
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
    let off = HdScore::from_driven(&off);
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
fn comfort_counts_turns_unless_plans_are_judged() {
    // 10 m/s on a circle of 18 m: 5.6 m/s^2 across, which is no comfort; 0.56 rad/s is allowed.
    let circle: Motion = Box::new(|time_s| {
        let angle_rad = 10.0 * time_s / 18.0;
        VehicleState {
            position_m: 18.0 * DVec2::new(angle_rad.sin(), 1.0 - angle_rad.cos()),
            yaw_rad: angle_rad,
            speed_mps: 10.0,
            acceleration_mps2: 0.0,
        }
    });
    let driven = episode(STEPS, &circle, &[], EpisodeEnd::Time);
    let published = HdScore::from_plans(&driven, None).unwrap();
    let corrected = HdScore::from_driven(&driven);
    assert_eq!((published.comfort, corrected.comfort), (1.0, 0.0));
    let share = |score: &HdScore| score.hd_score / score.route_completion;
    assert!((share(&corrected) / share(&published) - 5.0 / 7.0).abs() < 1e-9);

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
    let hard = HdScore::from_driven(&episode(STEPS, &braking, &[], EpisodeEnd::Time));
    assert!(hard.comfort < 0.9 && hard.comfort > 0.6, "{hard:?}");
}

/// Values read off HUGSIM's `sim/utils/score_calculator.py` at 62c690d: what is judged are plans.
#[test]
fn the_published_score_is_that_of_the_plans() {
    let calm = straight(0.0, 0.0, 0.0, 5.0);
    let standing = |x: f64| -> Motion { straight(x, 0.0, 0.0, 0.0) };
    let of = |driven: &decouplegs_scene::Episode| HdScore::from_plans(driven, None).unwrap();
    let free = of(&episode(STEPS, &calm, &[], EpisodeEnd::Time));
    assert_eq!(
        [free.no_collision, free.time_to_collision, free.comfort],
        [1.0; 3]
    );
    // 90 % of the route are all of it (hug_sim.py:180).
    assert!((free.route_completion - 0.5 / 0.9).abs() < 1e-9, "{free:?}");
    assert_eq!(free.hd_score, free.route_completion);

    // Frames are at the ends of steps, at 2.5 m to 50 m. Plans reach 2.5 s, 12.5 m, ahead; the
    // boxes of 4.5 m touch when the middle is at 51.6 m. Then the last 5 plans touch: from 39.1 m
    // on.
    let near = of(&episode(STEPS, &calm, &[standing(56.1)], EpisodeEnd::Time));
    assert!((near.no_collision - 15.0 / 20.0).abs() < 1e-9, "{near:?}");
    // Another second of 5 m/s: from 34.1 m on.
    assert!(
        (near.time_to_collision - 13.0 / 20.0).abs() < 1e-9,
        "{near:?}"
    );
    // What was driven touched nothing.
    let driven = HdScore::from_driven(&episode(STEPS, &calm, &[standing(56.1)], EpisodeEnd::Time));
    assert_eq!(driven.no_collision, 1.0);

    // Two of the four cells of the box without road are not off it, three are (the bound is 0.3).
    let road = |right_m: f64| {
        let is_road = move |at: DVec2| at.y >= right_m && at.x < 45.0;
        HdScore::from_plans(
            &episode(STEPS, &calm, &[], EpisodeEnd::Time),
            Some(&is_road),
        )
        .unwrap()
    };
    // A box whose middle is at 45 m has road in its two cells behind, one at 47.5 m in none: plans
    // from 35 m on reach that far.
    assert!(
        (road(-5.0).drivable_area - 13.0 / 20.0).abs() < 1e-9,
        "{:?}",
        road(-5.0)
    );
    // Half of the box beside the road too: one of four cells is left at 45 m.
    assert!(
        (road(0.1).drivable_area - 12.0 / 20.0).abs() < 1e-9,
        "{:?}",
        road(0.1)
    );
    // A strip of 7 cm along the left side of the box is road as well.
    assert_eq!(road(0.83).drivable_area, road(0.1).drivable_area);

    // A plan of 3 m/s^2 is no comfort (2.40), one with a jerk of 8 m/s^3 is (8.37).
    let hasty: Motion = Box::new(|time_s| VehicleState {
        position_m: DVec2::new(5.0 * time_s + 1.5 * time_s * time_s, 0.0),
        ..VehicleState::default()
    });
    let hasty = of(&episode(4, &hasty, &[], EpisodeEnd::Time));
    assert_eq!((hasty.comfort, hasty.time_to_collision), (0.0, 1.0));
    assert!((hasty.hd_score / hasty.route_completion - 5.0 / 7.0).abs() < 1e-9);

    // A plan of two poses is not judged.
    let mut short = episode(2, &calm, &[], EpisodeEnd::Time);
    for step in &mut short.steps {
        let points = step.plan.points()[..2].to_vec();
        step.plan = decouplegs_scene::Plan::new(points).unwrap();
    }
    assert!(HdScore::from_plans(&short, None).is_none());
}
