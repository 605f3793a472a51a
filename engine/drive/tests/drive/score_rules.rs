//! Rules of the road in scores: the direction of lanes, speed limits, faults of others, and time
//! that was lost.

use decouplegs_drive::RoadSurface;
use decouplegs_drive::score::{EpisodeScore, Infraction, InfractionKind, PdmScore, Summary};
use decouplegs_scene::episode::{LaneRecord, StopLineRecord};
use decouplegs_scene::{
    Episode, EpisodeEnd, LaneMap, LightColor, LightPhase, StopLine, TrafficLight,
};
use glam::DVec2;

use crate::episodes::{Motion, episode, state, straight};
use crate::traffic_scenes::lane;

fn with_lanes(mut made: Episode, lanes: impl Fn(f64) -> LaneRecord) -> Episode {
    for instant in made.steps.iter_mut().flat_map(|step| &mut step.instants) {
        instant.lanes = Some(lanes(instant.time_s));
    }
    made
}

/// Score of 10 s at 9 m/s, against the lanes with as much in each span of time.
fn against(spans: &[(f64, f64, f64)]) -> EpisodeScore {
    let made = episode(
        20,
        &straight(0.0, 0.0, 0.0, 9.0),
        &[],
        EpisodeEnd::RouteDone,
    );
    EpisodeScore::new(&with_lanes(made, |time_s| {
        let within = |span: &&(f64, f64, f64)| (span.0 + 0.01..span.1 + 0.01).contains(&time_s);
        LaneRecord {
            against_mps: spans.iter().find(within).map_or(0.0, |span| span.2),
            limit_mps: None,
        }
    }))
}

#[test]
fn driving_against_the_lane_is_an_infraction_by_the_way_within_a_second() {
    let none = against(&[(1.0, 1.6, 3.3), (3.0, 8.0, 1.9)]);
    assert_eq!((none.wrong_ways(), none.driving_score), (0, 1.0));
    assert!(none.success);
    let once = against(&[(1.0, 4.0, 5.9)]);
    let [Infraction { time_s, kind }] = once.infractions[..] else {
        panic!("{:?}", once.infractions)
    };
    // 0.4 s at 5.9 m/s are more than 2 m.
    assert!((time_s - 1.4).abs() < 1e-9, "{time_s}");
    assert_eq!(kind, InfractionKind::WrongWay { is_far: false });
    assert_eq!((once.driving_score, once.success), (0.5, false));
    let far = against(&[(1.0, 2.0, 3.0), (2.0, 3.0, 6.1)]);
    assert_eq!((far.wrong_ways(), far.driving_score), (1, 0.0));
    assert_eq!(
        far.infractions[0].kind,
        InfractionKind::WrongWay { is_far: true }
    );
    // A second on the right side ends it.
    let twice = against(&[(1.0, 2.0, 3.0), (3.2, 4.2, 3.0)]);
    assert_eq!((twice.wrong_ways(), twice.driving_score), (2, 0.25));
    let again = against(&[(1.0, 2.0, 3.0), (2.5, 3.5, 3.0)]);
    assert_eq!((again.wrong_ways(), again.driving_score), (1, 0.5));
}

#[test]
fn lanes_below_a_vehicle_tell_direction_and_limit() {
    let mut map = LaneMap::default();
    map.lanes.push(lane("east", &[[0.0, 0.0], [100.0, 0.0]]));
    map.lanes.push(lane("west", &[[100.0, 3.5], [0.0, 3.5]]));
    map.lanes
        .push(lane("north", &[[50.0, -50.0], [50.0, 50.0]]));
    map.lanes[0].speed_limit_mps = Some(14.0);
    let surface = RoadSurface::new(&map);
    let below = |x: f64, y: f64, yaw_rad: f64| surface.lanes_below(&state(x, y, yaw_rad, 8.0));
    let east = below(20.0, 0.5, 0.1).unwrap();
    assert_eq!((east.against_mps, east.limit_mps), (0.0, Some(14.0)));
    let west = below(20.0, 3.3, 0.1).unwrap();
    assert!((west.against_mps - 8.0 * 0.1_f64.cos()).abs() < 1e-9);
    assert_eq!(west.limit_mps, None);
    // One lane of a crossing leads its way.
    assert_eq!(below(50.0, 3.5, 1.2).unwrap().against_mps, 0.0);
    // Beyond half a lane the nearest counts, and nothing beyond 3 m.
    assert!(below(20.0, 6.0, 0.0).unwrap().against_mps > 7.9);
    assert_eq!(below(20.0, 6.6, 0.0), None);
}

#[test]
fn a_collision_that_is_not_its_fault_takes_nothing_of_the_route() {
    // Hit from behind after 3.3 s of 10, having run a red light.
    let agents: [Motion; 1] = [straight(-30.0, 0.0, 0.0, 17.0)];
    let end = EpisodeEnd::Collision { agent: 0 };
    let mut made = episode(8, &straight(0.0, 0.0, 0.0, 9.0), &agents, end);
    let score = EpisodeScore::new(&made);
    assert!((0.2..0.5).contains(&score.route_completion), "{score:?}");
    assert_eq!((score.counted_completion, score.driving_score), (1.0, 1.0));
    assert!(score.ended_by_other && !score.success);
    let summary = Summary::from_scores(std::slice::from_ref(&score));
    summary.check().unwrap();
    assert_eq!(summary.all.unwrap().ended_by_others, 1);
    made.head.scenario.lights = vec![light(LightColor::Red)];
    made.head.stop_lines = vec![line(20.0)];
    let score = EpisodeScore::new(&made);
    assert!((score.driving_score - 0.7).abs() < 1e-12);
    // Into one that stands: all that was not driven is lost.
    let agents: [Motion; 1] = [straight(30.0, 0.0, 0.0, 0.0)];
    let end = EpisodeEnd::Collision { agent: 0 };
    let score = EpisodeScore::new(&episode(6, &straight(0.0, 0.0, 0.0, 9.0), &agents, end));
    assert!(score.driving_score < 0.6 * 0.5 && !score.ended_by_other);
}

#[test]
fn a_story_that_ends_an_episode_counts_what_the_reference_drove_until_then() {
    let scored = |speed_mps: f64| {
        let ego = straight(0.0, 0.0, 0.0, speed_mps);
        EpisodeScore::new(&episode(8, &ego, &[], EpisodeEnd::Story))
    };
    // The reference cruises at the speed that the scenario gives.
    let whole = scored(9.0);
    assert!((0.2..0.5).contains(&whole.route_completion), "{whole:?}");
    assert_eq!((whole.counted_completion, whole.success), (1.0, true));
    let slow = scored(1.0);
    assert!((0.01..0.5).contains(&slow.counted_completion), "{slow:?}");
    assert!(slow.counted_completion > slow.route_completion && !slow.success);
    let stands = scored(0.0);
    assert_eq!((stands.counted_completion, stands.success), (0.0, false));
    Summary::from_scores(&[whole, slow, stands])
        .check()
        .unwrap();
    // The same drive that time ended is not done.
    let ego = straight(0.0, 0.0, 0.0, 9.0);
    let timed = EpisodeScore::new(&episode(8, &ego, &[], EpisodeEnd::Time));
    assert!(timed.counted_completion < 0.5 && !timed.success);
}

fn light(color: LightColor) -> TrafficLight {
    TrafficLight {
        name: "light".into(),
        stop_lines: vec![StopLine {
            lane: "lane".into(),
            at_m: 50.0,
            towards: vec![],
        }],
        phases: vec![LightPhase {
            color,
            duration_s: 100.0,
        }],
        ..TrafficLight::default()
    }
}

fn line(x: f64) -> StopLineRecord {
    StopLineRecord {
        index: 0,
        ends_m: [DVec2::new(x, -2.0), DVec2::new(x, 2.0)],
    }
}

#[test]
fn lost_time_has_its_reason() {
    let stands = || straight(40.0, 0.0, 0.0, 0.0);
    let end = || EpisodeEnd::Time;
    let near = |found_s: f64, expected_s: f64| (found_s - expected_s).abs() < 1e-9;
    // 10 s behind a vehicle that stands, half of them after it has gone.
    let leaves: Motion = Box::new(|time_s| {
        let y = if time_s < 5.05 { 0.0 } else { 40.0 };
        state(48.0, y, 0.0, 0.0)
    });
    let lost = EpisodeScore::new(&episode(20, &stands(), &[leaves], end())).time_lost;
    assert!(
        near(lost.behind_s[&0], 5.0) && near(lost.other_s, 5.0),
        "{lost:?}"
    );
    assert_eq!(lost.longest_behind().unwrap().0, 0);
    assert!(near(lost.sum_s(), 10.0));
    // Before a red light, and before a green one.
    for (color, light_s) in [(LightColor::Red, 10.0), (LightColor::Green, 0.0)] {
        let mut made = episode(20, &stands(), &[], end());
        made.head.scenario.lights = vec![light(color)];
        made.head.stop_lines = vec![line(45.0)];
        let lost = EpisodeScore::new(&made).time_lost;
        assert!(
            near(lost.light_s, light_s) && near(lost.sum_s(), 10.0),
            "{lost:?}"
        );
    }
    // For one that crosses.
    let crosses = straight(52.0, -5.0, 1.57, 1.0);
    let lost = EpisodeScore::new(&episode(20, &stands(), &[crosses], end())).time_lost;
    assert!(lost.yielding_s > 9.0, "{lost:?}");
    // At half the cruising speed half the time is lost, at all of it none.
    let half = EpisodeScore::new(&episode(10, &straight(0.0, 0.0, 0.0, 5.0), &[], end()));
    assert!(near(half.time_lost.other_s, 2.5));
    let full = EpisodeScore::new(&episode(10, &straight(0.0, 0.0, 0.0, 10.0), &[], end()));
    assert!(near(full.time_lost.sum_s(), 0.0));
}

#[test]
fn speeding_lowers_the_compliance_as_in_nuplan() {
    let made = |limit_mps: Option<f64>| {
        let made = episode(20, &straight(0.0, 0.0, 0.0, 9.0), &[], EpisodeEnd::Time);
        let lanes = LaneRecord {
            against_mps: 0.0,
            limit_mps,
        };
        EpisodeScore::new(&with_lanes(made, |_| lanes)).speed_compliance
    };
    assert_eq!((made(None), made(Some(9.0))), (None, Some(1.0)));
    assert!((made(Some(8.0)).unwrap() - (1.0 - 1.0 / 2.23)).abs() < 1e-9);
    assert_eq!(made(Some(6.0)), Some(0.0));
}

#[test]
fn the_pdm_score_is_navsims_formula() {
    let pdm = |made: &Episode| PdmScore::new(made, &EpisodeScore::new(made));
    let ego = straight(0.0, 0.0, 0.0, 9.0);
    let whole = pdm(&episode(20, &ego, &[], EpisodeEnd::RouteDone));
    assert_eq!(whole.pdm_score, 1.0);
    // Half the route, at one speed, with nobody near.
    let half = pdm(&episode(10, &ego, &[], EpisodeEnd::Time));
    assert!((half.progress - 0.45).abs() < 1e-9);
    assert!((half.pdm_score - (5.0 * 0.45 + 5.0 + 2.0) / 12.0).abs() < 1e-9);
    // One that comes near from behind is not its concern, one ahead is.
    let from_behind = [straight(-20.0, 0.0, 0.0, 12.0)];
    let behind = pdm(&episode(8, &ego, &from_behind, EpisodeEnd::Time));
    assert_eq!(behind.time_to_collision, 1.0);
    let slow = [straight(30.0, 0.0, 0.0, 3.0)];
    let ahead = pdm(&episode(7, &ego, &slow, EpisodeEnd::Time));
    assert_eq!((ahead.time_to_collision, ahead.no_collision), (0.0, 1.0));
    // Into it.
    let hit = pdm(&episode(9, &ego, &slow, EpisodeEnd::Collision { agent: 0 }));
    assert_eq!((hit.no_collision, hit.pdm_score), (0.0, 0.0));
    // Off the road, and a turn on the spot.
    let mut off = episode(20, &ego, &[], EpisodeEnd::RouteDone);
    off.steps[3].instants[0].on_road = false;
    assert_eq!((pdm(&off).drivable_area, pdm(&off).pdm_score), (0.0, 0.0));
    let brakes: Motion = Box::new(|time_s| {
        let (x, speed_mps) = if time_s < 3.05 {
            (9.0 * time_s, 9.0)
        } else {
            (27.45, 0.0)
        };
        state(x, 0.0, 0.0, speed_mps)
    });
    let hard = pdm(&episode(10, &brakes, &[], EpisodeEnd::Time));
    assert_eq!(hard.comfort, 0.0);
}
