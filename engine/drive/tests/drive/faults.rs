//! Faults of collisions.

use std::f64::consts::{FRAC_PI_2, PI};

use decouplegs_drive::score::{EpisodeScore, Fault, InfractionKind, PEDESTRIAN_FACTOR};
use decouplegs_scene::scenario::Trigger;
use decouplegs_scene::{Episode, EpisodeEnd, Pedestrian, VehicleSize, VehicleState};
use glam::DVec2;

use crate::episodes::{Motion, aside, episode, state, straight};

/// Episode up to the first contact with agent 0, which must come.
fn until_contact(ego: &Motion, agents: &[Motion]) -> Episode {
    let mut whole = episode(40, ego, agents, EpisodeEnd::Collision { agent: 0 });
    let score = EpisodeScore::new(&whole);
    let contact_s = score
        .infractions
        .iter()
        .find(|infraction| infraction.kind != InfractionKind::Layout)
        .unwrap()
        .time_s;
    whole
        .steps
        .retain(|step| step.instants[0].time_s <= contact_s);
    whole
        .steps
        .last_mut()
        .unwrap()
        .instants
        .retain(|instant| instant.time_s <= contact_s);
    whole
}

fn fault_of(ego: &Motion, other: Motion) -> Fault {
    let score = EpisodeScore::new(&until_contact(ego, &[other]));
    let [infraction] = &score.infractions[..] else {
        panic!("{:?}", score.infractions)
    };
    let InfractionKind::Collision {
        agent: 0, fault, ..
    } = infraction.kind
    else {
        panic!("{infraction:?}")
    };
    assert_eq!((score.success, score.min_ttc_s()), (false, Some(0.0)));
    let expected = match fault.at_fault() {
        true => 0.60 * score.route_completion,
        false => 1.0,
    };
    assert!((score.driving_score - expected).abs() < 1e-12 && score.route_completion < 1.0);
    fault
}

#[test]
fn whose_fault_it_is() {
    let ego = || straight(0.0, 0.0, 0.0, 10.0);
    // Into one that is slower, one that stands and one that comes against it.
    assert_eq!(fault_of(&ego(), straight(30.0, 0.3, 0.0, 5.0)), Fault::Ego);
    assert_eq!(fault_of(&ego(), straight(40.0, -0.3, 0.1, 0.0)), Fault::Ego);
    assert_eq!(fault_of(&ego(), straight(90.0, 0.0, PI, 10.0)), Fault::Ego);
    // Into one that crosses, with either's front.
    assert_eq!(
        fault_of(&ego(), straight(40.0, -30.0, FRAC_PI_2, 7.0)),
        Fault::Ego
    );
    assert_eq!(
        fault_of(&ego(), straight(38.0, -40.0, FRAC_PI_2, 10.0)),
        Fault::Ego
    );
    // Standing, and hit from behind, from the side, from ahead.
    let stands = straight(30.0, 0.0, 0.0, 0.0);
    assert_eq!(
        fault_of(&stands, straight(0.0, 0.0, 0.0, 8.0)),
        Fault::EgoStood
    );
    assert_eq!(
        fault_of(&stands, straight(30.0, -30.0, FRAC_PI_2, 8.0)),
        Fault::EgoStood
    );
    assert_eq!(
        fault_of(&stands, straight(70.0, 0.0, PI, 8.0)),
        Fault::EgoStood
    );
    // Driving, and hit from behind in its lane.
    assert_eq!(
        fault_of(&straight(30.0, 0.0, 0.0, 4.0), straight(0.0, 0.4, 0.0, 9.0)),
        Fault::HitFromBehind
    );
}

#[test]
fn whose_fault_it_is_when_lanes_are_changed() {
    // The other comes over in front of the ego half a second before they touch, or into its side.
    let cuts_in = || aside(5.3, 5.0, [3.5, 0.0], [0.5, 1.3]);
    assert_eq!(
        fault_of(&straight(-3.0, 0.0, 0.0, 10.0), cuts_in()),
        Fault::CutIn
    );
    assert_eq!(
        fault_of(
            &straight(0.0, 0.0, 0.0, 10.0),
            aside(1.0, 10.0, [3.5, 0.0], [1.0, 3.0])
        ),
        Fault::CutIn
    );
    // From the lane of those who come against it.
    assert_eq!(
        fault_of(
            &straight(0.0, 0.0, 0.0, 10.0),
            aside(60.0, -10.0, [3.5, 0.0], [2.0, 3.0])
        ),
        Fault::CutIn
    );
    // It came over, but so long before that the ego could have braked.
    assert_eq!(
        fault_of(&straight(-30.0, 0.0, 0.0, 10.0), cuts_in()),
        Fault::Ego
    );
    // The ego comes over: into the side of another, and before one that is faster and then hits it
    // from behind.
    assert_eq!(
        fault_of(
            &aside(0.0, 10.0, [0.0, 3.5], [1.0, 3.0]),
            straight(1.0, 3.5, 0.0, 10.0)
        ),
        Fault::Ego
    );
    assert_eq!(
        fault_of(
            &aside(9.0, 5.0, [0.0, 3.5], [0.5, 1.3]),
            straight(0.0, 3.5, 0.0, 10.0)
        ),
        Fault::Ego
    );
    // Long after it came over, it is hit from behind in its lane.
    assert_eq!(
        fault_of(
            &aside(30.0, 5.0, [0.0, 3.5], [0.5, 1.3]),
            straight(0.0, 3.5, 0.0, 10.0)
        ),
        Fault::HitFromBehind
    );
}

#[test]
fn a_route_that_changes_lanes_does_not_make_others_cut_in() {
    let ego = aside(0.0, 10.0, [0.0, 3.5], [2.0, 5.0]);
    let mut collided = until_contact(&ego, &[straight(1.0, 3.5, 0.0, 10.0)]);
    collided.head.route_m = (0..=100)
        .map(|x| ego(0.1 * f64::from(x)).position_m)
        .collect();
    let score = EpisodeScore::new(&collided);
    assert!(
        matches!(
            score.infractions[0].kind,
            InfractionKind::Collision {
                fault: Fault::Ego,
                ..
            }
        ),
        "{:?}",
        score.infractions
    );
}

/// Motion on a circle that begins at the world's origin and bends to the left, `beside_m` to the
/// left of it; never out of it but by what `aside_m` says.
fn bending<'a>(
    radius_m: f64,
    beside_m: f64,
    from_m: f64,
    speed_mps: f64,
    aside_m: impl Fn(f64) -> f64 + 'a,
) -> Motion<'a> {
    Box::new(move |time_s| {
        let angle_rad = (from_m + speed_mps * time_s) / radius_m;
        let out_m = radius_m - beside_m - aside_m(time_s);
        let position = DVec2::new(0.0, radius_m) + DVec2::from_angle(angle_rad - FRAC_PI_2) * out_m;
        VehicleState {
            position_m: position,
            yaw_rad: angle_rad,
            speed_mps,
            acceleration_mps2: 0.0,
        }
    })
}

/// Fault where the route follows `route` for 9 s.
fn fault_along(route: &Motion, ego: &Motion, other: Motion) -> Fault {
    let mut collided = until_contact(ego, &[other]);
    collided.head.route_m = (0..=90)
        .map(|at| route(0.1 * f64::from(at)).position_m)
        .collect();
    let InfractionKind::Collision { fault, .. } = EpisodeScore::new(&collided).infractions[0].kind
    else {
        unreachable!()
    };
    fault
}

#[test]
fn a_bend_of_the_road_is_no_cut_in_and_hides_none() {
    let still = |_| 0.0;
    for radius_m in [9.0, 30.0, 100.0, 400.0] {
        for side in [3.5_f64, -3.5] {
            let comes = move |time_s: f64| side.signum() * time_s;
            let route = bending(radius_m, 0.0, 0.0, 10.0, still);
            let (keeps, leaves) = (
                bending(radius_m, 0.0, 0.0, 10.0, still),
                bending(radius_m, 0.0, 0.0, 10.0, comes),
            );
            let other = |aside: bool| {
                bending(radius_m, side, 0.0, 10.0, move |time_s| {
                    if aside { -comes(time_s) } else { 0.0 }
                })
            };
            assert_eq!(
                fault_along(&route, &keeps, other(true)),
                Fault::CutIn,
                "radius {radius_m}, side {side}"
            );
            assert_eq!(
                fault_along(&route, &leaves, other(false)),
                Fault::Ego,
                "radius {radius_m}, side {side}"
            );
        }
    }
    // A route that changes lanes in a bend: the one beside it stays where it is.
    let changes = |time_s: f64| 3.5 * ((time_s - 3.0) / 3.0).clamp(0.0, 1.0);
    for radius_m in [100.0, 400.0] {
        let (route, ego) = (
            bending(radius_m, 0.0, 0.0, 10.0, changes),
            bending(radius_m, 0.0, 0.0, 10.0, changes),
        );
        assert_eq!(
            fault_along(&route, &ego, bending(radius_m, 3.5, 1.0, 10.0, still)),
            Fault::Ego,
            "radius {radius_m}"
        );
    }
}

#[test]
fn a_pedestrian_counts_more_than_a_vehicle_and_is_never_at_fault() {
    let mut walked = until_contact(
        &straight(0.0, 0.0, 0.0, 10.0),
        &[straight(40.0, -8.0, FRAC_PI_2, 2.0)],
    );
    let scenario = &mut walked.head.scenario;
    let agent = scenario.agents.remove(0);
    scenario.pedestrians.push(Pedestrian {
        name: agent.name,
        asset: 0,
        size: VehicleSize::PEDESTRIAN,
        path_m: vec![DVec2::new(40.0, -8.0), DVec2::new(40.0, 8.0)],
        speed_mps: 2.0,
        start: Trigger::Time { time_s: 0.0 },
        waits_for_gap: false,
    });
    let score = EpisodeScore::new(&walked);
    assert_eq!((score.collisions(), score.pedestrian_collisions()), (1, 1));
    assert!(score.infractions[0].at_fault());
    let expected = PEDESTRIAN_FACTOR * score.route_completion;
    assert!((score.driving_score - expected).abs() < 1e-12);
}

/// True if the collision of `ego` with `other` could be avoided by braking.
fn is_avoidable(ego: &Motion, other: Motion) -> bool {
    let made = until_contact(ego, &[other]);
    let infraction = EpisodeScore::new(&made).infractions[0];
    let InfractionKind::Collision { is_avoidable, .. } = infraction.kind else {
        panic!("{infraction:?}")
    };
    let says = infraction.describe(&made.head).contains("could not avoid");
    assert_eq!(says, !is_avoidable);
    is_avoidable
}

#[test]
fn braking_avoids_what_is_seen_in_time_and_nothing_else() {
    // Braking from 10 m/s takes 6.25 m. The boxes are 4.5 m long.
    let ego = straight(0.0, 0.0, 0.0, 10.0);
    assert!(
        is_avoidable(&ego, straight(34.5, 0.0, 0.0, 0.0)),
        "a standing car, 30 m ahead"
    );
    // It comes out from beside the road within 0.2 s, when the ego's front is so far before it.
    let comes_out = |gap_m: f64| aside(4.5 + 10.0 + gap_m, 0.0, [4.0, 0.0], [1.0, 1.2]);
    assert!(!is_avoidable(&ego, comes_out(4.0)));
    assert!(is_avoidable(&ego, comes_out(12.0)));
    // A faster one from behind.
    let slow = straight(0.0, 0.0, 0.0, 5.0);
    assert!(!is_avoidable(&slow, straight(-30.0, 0.0, 0.0, 15.0)));
    // One that is slower: braking to its speed is enough, standing is not needed.
    assert!(is_avoidable(&ego, straight(12.0, 0.0, 0.0, 6.0)));
}

#[test]
fn speeds_that_nobody_drives_take_no_time_to_judge() {
    let fast = || -> Motion { Box::new(|_| state(0.0, 0.0, 0.0, 1e200)) };
    let made = episode(4, &fast(), &[fast()], EpisodeEnd::Time);
    assert_eq!(EpisodeScore::new(&made).collisions(), 1);
}
