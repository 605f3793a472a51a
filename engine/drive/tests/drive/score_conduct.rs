//! Rules that are scored beside the driving score, and the extended PDM score, of episodes made by
//! hand.

use std::f64::consts::PI;

use decouplegs_drive::score::{
    Breach, CONDUCT_FACTOR, Conduct, ConductKind, EpisodeScore, ExtendedPdmScore, PdmScore,
};
use decouplegs_scene::episode::{LaneOffset, LaneRecord, RoadRecord, StopLineRecord};
use decouplegs_scene::{
    Episode, EpisodeEnd, LightColor, LightPhase, StopLine, TrafficLight, VehicleState,
};
use glam::DVec2;

use crate::episodes::{Motion, SIZE, episode, state, straight};

fn conduct(made: &Episode) -> Conduct {
    Conduct::new(made, &EpisodeScore::new(made))
}

fn extended(made: &Episode) -> ExtendedPdmScore {
    let score = EpisodeScore::new(made);
    let reference = Conduct::new(made, &score).reference;
    ExtendedPdmScore::new(made, &score, &PdmScore::new(made, &score), &reference)
}

/// Episode with what `road` tells of each state.
fn with_road(mut made: Episode, road: impl Fn(f64, &VehicleState) -> RoadRecord) -> Episode {
    let later = made.steps.iter_mut().flat_map(|step| &mut step.instants);
    for tick in std::iter::once(&mut made.start).chain(later) {
        tick.road = Some(road(tick.time_s, &tick.ego));
    }
    made
}

/// Motion along x at 10 m/s to `to_m`, standing there from then on.
fn until<'a>(to_m: f64) -> Motion<'a> {
    Box::new(move |time_s| {
        let x = (10.0 * time_s).min(to_m);
        state(x, 0.0, 0.0, if x < to_m { 10.0 } else { 0.0 })
    })
}

fn with_light(mut made: Episode, color: LightColor, x: f64) -> Episode {
    made.head.scenario.lights = vec![TrafficLight {
        name: "light".into(),
        stop_lines: vec![StopLine {
            lane: "lane".into(),
            at_m: x,
            towards: vec![],
        }],
        phases: vec![LightPhase {
            color,
            duration_s: 100.0,
        }],
        ..TrafficLight::default()
    }];
    made.head.stop_lines = vec![StopLineRecord {
        index: 0,
        ends_m: [DVec2::new(x, -2.0), DVec2::new(x, 2.0)],
    }];
    made
}

#[test]
fn a_red_light_costs_no_progress_against_the_reference() {
    let half_m = 0.5 * SIZE.length_m;
    let waits = |color| {
        let made = episode(40, &until(50.0 - half_m), &[], EpisodeEnd::Time);
        conduct(&with_light(made, color, 50.0)).reference
    };
    let red = waits(LightColor::Red);
    assert_eq!(red.share, 1.0, "{red:?}");
    assert!((red.reference_m - (50.0 - half_m)).abs() < 1.0, "{red:?}");
    // Who waits before a green light loses what the reference drives on, and so does who stands
    // farther from the red one.
    let green = waits(LightColor::Green);
    assert!((green.reference_m - 100.0).abs() < 1e-9, "{green:?}");
    assert!((green.share - (0.5 - 0.01 * half_m)).abs() < 1e-9);
    let early = episode(40, &until(20.0), &[], EpisodeEnd::Time);
    let early = conduct(&with_light(early, LightColor::Red, 50.0)).reference;
    assert!((early.share - 20.0 / red.reference_m).abs() < 1e-9);
    // The driving score does not know of it.
    let made = episode(40, &until(50.0 - half_m), &[], EpisodeEnd::Time);
    let made = with_light(made, LightColor::Red, 50.0);
    assert!(EpisodeScore::new(&made).driving_score < 0.5);
}

#[test]
fn what_the_ego_ended_itself_is_lost_against_the_reference() {
    // At 9 m/s into one that stands: the reference is done when the time limit is over.
    let ego = straight(0.0, 0.0, 0.0, 9.0);
    let stands: [Motion; 1] = [straight(30.0, 0.0, 0.0, 0.0)];
    let made = episode(6, &ego, &stands, EpisodeEnd::Collision { agent: 0 });
    let own = conduct(&made).reference;
    assert!((own.share - 0.27).abs() < 1e-9, "{own:?}");
    // Hit from behind at the same time: that of then.
    let hits: [Motion; 1] = [straight(-30.0, 0.0, 0.0, 17.0)];
    let made = episode(8, &ego, &hits, EpisodeEnd::Collision { agent: 0 });
    let others = conduct(&made).reference;
    assert!(others.share > 0.85, "{others:?}");
    let done = conduct(&episode(20, &ego, &[], EpisodeEnd::RouteDone));
    assert_eq!(done.reference.share, 1.0);
}

/// Conduct of an ego that stands on a crossing at x = 50 from 5 s on, until `steps` are over.
fn on_crossing(steps: usize, agents: &[Motion]) -> Conduct {
    let made = episode(steps, &until(50.0), agents, EpisodeEnd::Time);
    conduct(&with_road(made, |_, ego| RoadRecord {
        in_junction: true,
        on_crossing: (ego.position_m.x - 50.0).abs() < 4.0,
        ..RoadRecord::default()
    }))
}

#[test]
fn standing_on_a_crossing_is_a_breach_unless_others_are_waited_for() {
    let free = on_crossing(40, &[]);
    let [
        Breach {
            time_s,
            duration_s,
            kind,
        },
    ] = free.breaches[..]
    else {
        panic!("{free:?}")
    };
    assert_eq!(kind, ConductKind::OnCrossing);
    assert!((time_s - 5.0).abs() < 1e-9 && (duration_s - 15.0).abs() < 1e-9);
    let expected = CONDUCT_FACTOR * free.reference.share;
    assert!((free.all_rules_score.unwrap() - expected).abs() < 1e-12);
    // Less than 5 s is none.
    assert!(on_crossing(19, &[]).breaches.is_empty());
    assert_eq!(on_crossing(20, &[]).breaches.len(), 1);
    // One ahead that stood before excuses nothing, one that drove on then does.
    let stands = straight(50.0 + SIZE.length_m + 2.0, 0.0, 0.0, 0.0);
    assert_eq!(on_crossing(40, &[stands]).breaches.len(), 1);
    let stops: Motion = Box::new(|time_s| {
        let x = (8.0 + 10.0 * time_s).min(52.0 + SIZE.length_m);
        let moves = x < 52.0 + SIZE.length_m;
        state(x, 0.0, 0.0, if moves { 10.0 } else { 0.0 })
    });
    assert!(on_crossing(40, &[stops]).breaches.is_empty());
    // Traffic from the front, turning left.
    let comes: Motion = Box::new(|time_s| state(58.0 + time_s % 5.0, 3.5, PI, 8.0));
    assert!(on_crossing(40, &[comes]).breaches.is_empty());
}

#[test]
fn standing_before_a_free_road_is_a_breach_for_those_behind() {
    let behind = || straight(36.0 - SIZE.length_m, 0.0, 0.0, 0.0);
    let ego = straight(40.0, 0.0, 0.0, 0.0);
    let of = |agents: &[Motion]| conduct(&episode(20, &ego, agents, EpisodeEnd::Time));
    let blocked = of(&[behind()]);
    assert_eq!(blocked.count(ConductKind::Blocking), 1);
    assert!((blocked.breaches[0].duration_s - 10.0).abs() < 1e-9);
    assert!(of(&[]).breaches.is_empty(), "nobody behind");
    let ahead = straight(44.0 + SIZE.length_m, 0.0, 0.0, 0.0);
    assert!(of(&[behind(), ahead]).breaches.is_empty(), "one ahead");
    let crosses = straight(52.0, -5.0, 1.57, 1.0);
    assert!(of(&[behind(), crosses]).breaches.is_empty(), "one crosses");
    let beside = straight(36.0 - SIZE.length_m, 3.5, 0.0, 0.0);
    assert!(of(&[beside]).breaches.is_empty(), "one on the next lane");
    let red = episode(20, &ego, &[behind()], EpisodeEnd::Time);
    let red = with_light(red, LightColor::Red, 45.0);
    assert!(conduct(&red).breaches.is_empty(), "a red light");
}

fn beside(lateral_m: f64) -> RoadRecord {
    RoadRecord {
        lane: Some(LaneOffset {
            lateral_m,
            half_width_m: 1.75,
        }),
        ..RoadRecord::default()
    }
}

#[test]
fn a_turn_from_a_wrong_lane_is_a_breach() {
    let made = episode(
        20,
        &straight(0.0, 0.0, 0.0, 9.0),
        &[],
        EpisodeEnd::RouteDone,
    );
    let turned = with_road(made.clone(), |time_s, _| RoadRecord {
        wrong_turn: (time_s - 3.0).abs() < 0.01,
        ..beside(0.0)
    });
    let found = conduct(&turned);
    assert_eq!(found.count(ConductKind::WrongTurn), 1);
    assert!((found.all_rules_score.unwrap() - CONDUCT_FACTOR).abs() < 1e-12);
    let straight_on = conduct(&with_road(made, |_, _| beside(0.0)));
    assert_eq!(straight_on.all_rules_score, Some(1.0));
    // The driving score is the same.
    assert_eq!(EpisodeScore::new(&turned).driving_score, 1.0);
}

#[test]
fn the_lane_is_kept_within_its_edges_and_in_changes() {
    let of = |road: &dyn Fn(f64) -> RoadRecord| {
        let ego = straight(0.0, 0.0, 0.0, 5.0);
        let made = episode(40, &ego, &[], EpisodeEnd::Time);
        conduct(&with_road(made, |time_s, _| road(time_s)))
            .lane_keeping
            .unwrap()
    };
    let within =
        |time_s: f64, from_s: f64, to_s: f64| (from_s + 0.05..to_s + 0.05).contains(&time_s);
    // At the edge and 0.1 m over it.
    let edge_m = 1.75 - 0.5 * SIZE.width_m;
    let kept = of(&|_| beside(edge_m + 0.1));
    assert_eq!((kept.excursions, kept.kept_share()), (0, 1.0));
    assert!((kept.on_lanes_s - 20.0).abs() < 1e-9);
    // 0.3 m over it for 3 s.
    let over = of(&|time_s| {
        beside(if within(time_s, 4.0, 7.0) {
            edge_m + 0.3
        } else {
            0.0
        })
    });
    assert_eq!(over.excursions, 1);
    assert!((over.over_edge_s - 3.0).abs() < 1e-9, "{over:?}");
    assert!((over.over_edge_m - 15.0).abs() < 1e-9, "{over:?}");
    assert!((over.kept_share() - 0.85).abs() < 1e-9);
    // A change of lanes, and one that takes 10 s.
    let change = |to_s: f64| {
        of(&move |time_s| match time_s {
            _ if within(time_s, 4.0, 5.5) => beside(1.7),
            _ if within(time_s, 5.5, to_s) => beside(-1.7),
            _ => beside(0.0),
        })
    };
    assert_eq!(change(7.0).excursions, 0);
    let slow = change(14.0);
    assert!((slow.over_edge_s - 2.0).abs() < 1e-9, "{slow:?}");
    // Junctions do not count.
    let junction = of(&|_| RoadRecord {
        in_junction: true,
        ..beside(1.5)
    });
    assert_eq!((junction.on_lanes_s, junction.kept_share()), (0.0, 1.0));
}

#[test]
fn the_extended_pdm_score_is_navsims_formula() {
    let ego = straight(0.0, 0.0, 0.0, 10.0);
    let whole = extended(&episode(20, &ego, &[], EpisodeEnd::RouteDone));
    assert_eq!(
        whole.lane_keeping.zip(whole.extended_comfort),
        Some((1.0, 1.0))
    );
    assert_eq!(whole.score, 1.0);
    // 0.6 m beside the route for 1.9 and for 2 s.
    let aside = |for_s: f64| {
        let ego: Motion = Box::new(move |time_s| {
            let is_aside = (3.05..3.05 + for_s).contains(&time_s);
            state(10.0 * time_s, if is_aside { 0.6 } else { 0.0 }, 0.0, 10.0)
        });
        extended(&episode(20, &ego, &[], EpisodeEnd::RouteDone)).lane_keeping
    };
    assert_eq!((aside(1.9), aside(2.0)), (Some(1.0), Some(0.0)));
    // Half of the way of a reference at 10 m/s, and off the route.
    let slow: Motion = Box::new(|time_s| state(5.0 * time_s, 1.0, 0.0, 5.0));
    let mut made = episode(20, &slow, &[], EpisodeEnd::Time);
    made.head.scenario.ego.cruise_mps = 10.0;
    made.start.ego.speed_mps = 10.0;
    let half = extended(&made);
    assert!((half.progress - 0.5).abs() < 1e-9, "{half:?}");
    let expected = (5.0 * half.progress + 5.0 + 2.0 * half.history_comfort + 2.0) / 16.0;
    assert!((half.score - expected).abs() < 1e-12, "{half:?}");
    // A person who left the route too: the term counts as kept.
    let human = ExtendedPdmScore {
        lane_keeping: Some(0.0),
        ..whole
    };
    let filtered = half.filtered(&human);
    assert_eq!(filtered.lane_keeping, Some(1.0));
    assert!((filtered.score - half.score - 2.0 / 16.0).abs() < 1e-12);
    assert_eq!(half.filtered(&whole).score, half.score);
    // Factors.
    let red = episode(20, &ego, &[], EpisodeEnd::RouteDone);
    let red = extended(&with_light(red, LightColor::Red, 50.0));
    assert_eq!((red.traffic_lights, red.score), (0.0, 0.0));
    let stands = [straight(30.0, 0.0, 0.0, 0.0)];
    let hit = extended(&episode(
        6,
        &ego,
        &stands,
        EpisodeEnd::Collision { agent: 0 },
    ));
    assert_eq!((hit.no_collision, hit.time_to_collision), (0.0, 0.0));
}

#[test]
fn driving_against_the_lanes_counts_outside_of_junctions() {
    let against = |in_junction: bool, mps: f64| {
        let ego = straight(0.0, 0.0, 0.0, 10.0);
        let made = episode(20, &ego, &[], EpisodeEnd::RouteDone);
        let mut made = with_road(made, |_, _| RoadRecord {
            in_junction,
            ..RoadRecord::default()
        });
        for tick in made.steps.iter_mut().flat_map(|step| &mut step.instants) {
            tick.lanes = Some(LaneRecord {
                against_mps: mps,
                limit_mps: None,
            });
        }
        extended(&made).driving_direction
    };
    assert_eq!((against(false, 1.9), against(false, 5.9)), (1.0, 0.5));
    assert_eq!((against(false, 6.1), against(true, 6.1)), (0.0, 1.0));
}

#[test]
fn time_to_collision_looks_at_who_is_ahead_where_they_are_then() {
    let ego = || straight(0.0, 0.0, 0.0, 10.0);
    let ttc = |agent: Motion, road: RoadRecord| {
        let made = episode(8, &ego(), &[agent], EpisodeEnd::Time);
        extended(&with_road(made, |_, _| road)).time_to_collision
    };
    // The ego stops 0.75 m behind one that stands, too late to have kept its distance.
    let stands = || straight(35.25, 0.0, 0.0, 0.0);
    let made = episode(8, &until(30.0), &[stands()], EpisodeEnd::Time);
    assert_eq!(extended(&made).time_to_collision, 0.0);
    let made = episode(8, &until(20.0), &[stands()], EpisodeEnd::Time);
    assert_eq!(extended(&made).time_to_collision, 1.0);
    // One that leaves in time is no concern, though it stands there until then.
    let leaves = || -> Motion {
        Box::new(|time_s| state(36.0, if time_s > 3.05 { 10.0 } else { 0.0 }, 0.0, 0.0))
    };
    assert_eq!(ttc(leaves(), beside(0.0)), 1.0);
    let made = episode(8, &ego(), &[leaves()], EpisodeEnd::Time);
    let pdm = PdmScore::new(&made, &EpisodeScore::new(&made));
    assert_eq!(pdm.time_to_collision, 0.0, "as if it stood on");
    // One that scrapes along its side counts where the ego is not within its lane.
    let side = || straight(0.0, SIZE.width_m - 0.05, 0.0, 10.0);
    assert_eq!(
        (ttc(side(), beside(0.0)), ttc(side(), beside(1.0))),
        (1.0, 0.0)
    );
}

#[test]
fn plans_that_jump_are_uncomfortable() {
    let ego = straight(0.0, 0.0, 0.0, 10.0);
    let mut made = episode(20, &ego, &[], EpisodeEnd::RouteDone);
    assert_eq!(extended(&made).extended_comfort, Some(1.0));
    // One plan brakes hard: it agrees with neither of its neighbors.
    let points = made.steps[5].plan.points().iter().map(|point| {
        let mut point = *point;
        point.position_m.x -= 2.0 * point.time_s * point.time_s;
        point
    });
    made.steps[5].plan = decouplegs_scene::Plan::new(points.collect()).unwrap();
    let found = extended(&made).extended_comfort.unwrap();
    assert!((found - 17.0 / 19.0).abs() < 1e-9, "{found}");
}

#[test]
fn logs_of_older_versions_score_as_before() {
    let stands = [straight(36.0 - SIZE.length_m, 0.0, 0.0, 0.0)];
    let made = episode(
        20,
        &straight(40.0, 0.0, 0.0, 0.0),
        &stands,
        EpisodeEnd::Time,
    );
    let made = with_road(made, |_, _| RoadRecord {
        on_crossing: true,
        ..beside(1.5)
    });
    let old = made.clone().in_version(3);
    assert_eq!(old.head.log_version, 3);
    let (score, old_score) = (EpisodeScore::new(&made), EpisodeScore::new(&old));
    assert_eq!(score, old_score);
    assert_eq!(
        PdmScore::new(&made, &score),
        PdmScore::new(&old, &old_score)
    );
    let (new, old) = (conduct(&made), conduct(&old));
    assert_eq!(new.count(ConductKind::OnCrossing), 1);
    assert_eq!(
        (old.count(ConductKind::OnCrossing), old.lane_keeping),
        (0, None)
    );
    assert_eq!((old.reference, old.all_rules_score), (new.reference, None));
    assert_eq!(old.count(ConductKind::Blocking), 1);
}
