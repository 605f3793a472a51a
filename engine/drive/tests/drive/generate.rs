//! Generated scenarios keep what their level promises, and begin with nothing that cannot
//! be survived.

use decouplegs_asset::read_map;
use decouplegs_drive::generate::{
    Area, GenerateError, Generator, PlaceOptions, agents_near, weathers,
};
use decouplegs_drive::{OrientedBox, Polyline, RoadGraph, RoadSurface, Route, Traffic};
use decouplegs_scene::scenario::{DriverKind, Maneuver, Place, TrafficAgent};
use decouplegs_scene::{Lane, LaneMap, Level, Scenario, VehicleSize, VehicleState};
use decouplegs_synth::street::{Street, StreetOptions};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A place to make scenarios in.
pub struct Grounds {
    name: &'static str,
    pub map: LaneMap,
    place: PlaceOptions,
    sizes: Vec<VehicleSize>,
}

pub fn street() -> Grounds {
    let made = Street::generate(&StreetOptions {
        background: 0,
        agents: 1,
        agent_splats: 1,
        ..StreetOptions::default()
    });
    let sizes = made
        .asset_dims_m
        .iter()
        .map(|size| VehicleSize::from_array(size.map(f64::from)))
        .collect();
    Grounds {
        name: "street",
        map: made.lanes,
        place: PlaceOptions::Street {
            background: 1000,
            agent_splats: 100,
            seed: 3,
        },
        sizes,
    }
}

/// A map of the test data, or nothing and a line that says so where there is none.
pub fn roads(name: &'static str) -> Option<Grounds> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("DECOUPLEGS_DATA")
        .map_or_else(default, PathBuf::from)
        .join("maps")
        .join(name);
    if !path.exists() {
        println!(
            "skipped: {} is not there; set DECOUPLEGS_DATA to the folder of test data",
            path.display()
        );
        return None;
    }
    let place = PlaceOptions::Roads {
        map: name.into(),
        skies: Vec::new(),
        background: 1000,
        agent_splats: 100,
    };
    Some(Grounds {
        name,
        map: read_map(&path).unwrap(),
        place,
        sizes: vec![VehicleSize::CAR; 2],
    })
}

impl Grounds {
    pub fn generator(&self) -> Generator<'_> {
        Generator::new(&self.map, self.place.clone(), &self.sizes).unwrap()
    }
}

/// A lane of a map, examined without the generator.
fn lane_of<'a>(map: &'a LaneMap, id: &str) -> (usize, &'a Lane) {
    map.lanes
        .iter()
        .enumerate()
        .find(|(_, lane)| lane.id == id)
        .unwrap_or_else(|| panic!("no lane {id}"))
}

fn line_of(lane: &Lane) -> Polyline {
    Polyline::new(lane.centerline.iter().copied()).unwrap()
}

/// A vehicle as it stands at the start.
struct Starter {
    name: String,
    lane: usize,
    at_m: f64,
    speed_mps: f64,
    size: VehicleSize,
    outline: OrientedBox,
}

fn starter(
    map: &LaneMap,
    name: &str,
    (lane, at_m): (&str, f64),
    speed_mps: f64,
    size: VehicleSize,
) -> Starter {
    let (lane, road) = lane_of(map, lane);
    let line = line_of(road);
    let state = VehicleState {
        position_m: line.at(at_m).truncate(),
        yaw_rad: line.heading_at(at_m),
        ..VehicleState::default()
    };
    Starter {
        name: name.into(),
        lane,
        at_m,
        speed_mps,
        size,
        outline: OrientedBox::for_vehicle(&state, &size),
    }
}

/// The ego, then the agents.
fn starters(map: &LaneMap, scenario: &Scenario) -> Vec<Starter> {
    let ego = &scenario.ego;
    let mut all = vec![starter(
        map,
        "the ego",
        (&ego.route[0], ego.start_m),
        ego.speed_mps,
        ego.size,
    )];
    all.extend(scenario.agents.iter().map(|agent| {
        starter(
            map,
            &agent.name,
            (&agent.lane, agent.at_m),
            agent.speed_mps,
            agent.size,
        )
    }));
    all
}

/// True if the follower stops behind a leader that brakes with 8 m/s^2 at once, if it brakes with 6
/// m/s^2 after a second.
fn survives(gap_m: f64, follower_mps: f64, leader_mps: f64) -> bool {
    let stops_m = follower_mps + follower_mps * follower_mps / 12.0;
    stops_m < gap_m + leader_mps * leader_mps / 16.0
}

/// Vehicles ahead of one, over all lanes that it may take, and their gaps up to `max_m`.
fn gaps_ahead(map: &LaneMap, all: &[Starter], from: usize, max_m: f64) -> Vec<(usize, f64)> {
    let (mut open, mut gaps) = (vec![(all[from].lane, -all[from].at_m)], Vec::new());
    while let Some((lane, begin_m)) = open.pop() {
        for (at, other) in all
            .iter()
            .enumerate()
            .filter(|(_, other)| other.lane == lane)
        {
            let middles_m = begin_m + other.at_m;
            if middles_m > 0.0 {
                gaps.push((
                    at,
                    middles_m - 0.5 * (all[from].size.length_m + other.size.length_m),
                ));
            }
        }
        let end_m = begin_m + line_of(&map.lanes[lane]).length_m();
        if end_m < max_m {
            open.extend(map.lanes[lane].successors.iter().map(|&next| (next, end_m)));
        }
    }
    gaps
}

fn is_round(value: f64, parts: f64) -> bool {
    (value * parts - (value * parts).round()).abs() < 1e-6
}

fn has(agents: &[TrafficAgent], is: impl Fn(&Maneuver) -> bool) -> bool {
    agents
        .iter()
        .flat_map(|agent| &agent.behaviors)
        .any(|behavior| is(&behavior.maneuver))
}

fn check_behaviors(scenario: &Scenario, level: Level, what: &str) {
    let agents = &scenario.agents;
    let brakes = has(agents, |maneuver| {
        matches!(maneuver, Maneuver::Brake { .. })
    });
    let cuts_in = has(agents, |maneuver| *maneuver == Maneuver::CutIn);
    let swerves = has(agents, |maneuver| {
        matches!(maneuver, Maneuver::Swerve { .. })
    });
    let drivers = |kinds: &[DriverKind]| agents.iter().all(|agent| kinds.contains(&agent.driver));
    match level {
        Level::Easy => {
            assert!(
                agents
                    .iter()
                    .all(|agent| agent.behaviors.is_empty() && !agent.changes_lanes),
                "{what}"
            );
            assert!(drivers(&[DriverKind::Calm, DriverKind::Normal]), "{what}");
        }
        Level::Medium => {
            assert!(
                agents.iter().all(|agent| agent.behaviors.is_empty()),
                "{what}"
            );
            assert!(drivers(&[DriverKind::Calm, DriverKind::Normal]), "{what}");
        }
        Level::Hard => assert!(cuts_in || brakes, "{what}"),
        Level::Extreme => {
            assert!(
                brakes && swerves && agents.iter().all(|agent| agent.driver != DriverKind::Calm),
                "{what}"
            );
        }
    }
}

fn check_lead(
    scenario: &Scenario,
    all: &[Starter],
    gaps: &[(usize, f64)],
    level: Level,
    what: &str,
) {
    let Some(lead) = all.iter().position(|starter| starter.name == "lead") else {
        assert_eq!(level, Level::Easy, "{what}: nobody ahead");
        return;
    };
    let (_, gap_m) = gaps
        .iter()
        .find(|(at, _)| *at == lead)
        .unwrap_or_else(|| panic!("{what}: the lead is not ahead"));
    assert!(
        (15.0..=40.0).contains(gap_m),
        "{what}: the lead is {gap_m} m ahead"
    );
    if level != Level::Easy {
        assert!(
            all[lead].speed_mps < all[0].speed_mps,
            "{what}: {} is no slower",
            all[lead].speed_mps
        );
    }
    assert!(
        scenario.ego.speed_mps >= 0.25 * scenario.ego.cruise_mps,
        "{what}: {}",
        scenario.ego.speed_mps
    );
}

/// All that a scenario promises at its start.
fn check(grounds: &Grounds, scenario: &Scenario, level: Level, what: &str) {
    let (map, all) = (&grounds.map, starters(&grounds.map, scenario));
    let near =
        |starter: &&Starter| starter.outline.center_m.distance(all[0].outline.center_m) <= 50.0;
    let (least, most) = agents_near(level);
    let count = all[1..].iter().filter(near).count();
    assert!(
        (least..=most).contains(&count),
        "{what}: {count} agents within 50 m"
    );
    for (at, a) in all.iter().enumerate() {
        for b in &all[..at] {
            assert!(
                !a.outline.overlaps(&b.outline) && a.name != b.name,
                "{what}: {} and {}",
                a.name,
                b.name
            );
        }
        let gaps = gaps_ahead(map, &all, at, 110.0);
        for &(other, gap_m) in &gaps {
            let message = || format!("{what}: {} {gap_m:.1} m behind {}", a.name, all[other].name);
            assert!(
                survives(gap_m, a.speed_mps, all[other].speed_mps),
                "{}",
                message()
            );
        }
        if at == 0 {
            check_lead(scenario, &all, &gaps, level, what);
        }
        assert!(
            is_round(a.at_m, 100.0) && is_round(a.speed_mps, 10.0),
            "{what}: {} {}",
            a.at_m,
            a.speed_mps
        );
    }
    let route = Route::new(map, &scenario.ego).unwrap_or_else(|fault| panic!("{what}: {fault}"));
    assert!(
        (55.0..=181.0).contains(&route.length_m()),
        "{what}: a route of {} m",
        route.length_m()
    );
    assert!(
        route.length_m() / scenario.ego.cruise_mps < 14.0 && scenario.ego.cruise_mps <= 13.9,
        "{what}"
    );
    assert_eq!((scenario.level, scenario.step_s), (Some(level), 0.5));
    // A reference drive of 8 to 13 s, waits at lights, and the time that the level adds.
    assert!(
        (20.0..=140.0).contains(&scenario.duration_s) && is_round(scenario.duration_s, 1.0),
        "{what}: {} s",
        scenario.duration_s
    );
    let surface = RoadSurface::new(map);
    for meter in 0..=route.length_m() as u32 {
        let (position, yaw_rad) = route.pose_at(f64::from(meter));
        let state = VehicleState {
            position_m: position.truncate(),
            yaw_rad,
            ..VehicleState::default()
        };
        let outline = OrientedBox::for_vehicle(&state, &scenario.ego.size);
        assert!(
            surface.holds_box(&outline, RoadSurface::SLACK_M),
            "{what}: the route leaves the road after {meter} m"
        );
    }
    // The front of the ego stays on the map where the route ends.
    let last = lane_of(map, scenario.ego.route.last().unwrap()).1;
    if last.successors.is_empty() {
        let rest_m = line_of(last).length_m() - scenario.ego.end_m;
        let least_m = 0.5 * scenario.ego.size.length_m + 2.0;
        assert!(
            rest_m >= least_m,
            "{what}: the route ends {rest_m} m before the map"
        );
    }
    if let Place::Street { weather, .. } = scenario.place {
        assert!(weathers(level).contains(&weather), "{what}: {weather:?}");
    }
    check_behaviors(scenario, level, what);
}

/// The ego as it brakes after a second: where it is on its route, and how fast.
struct BrakingEgo {
    route: Route,
    size: VehicleSize,
    progress_m: f64,
    speed_mps: f64,
}

impl BrakingEgo {
    fn state(&self) -> VehicleState {
        let (position, yaw_rad) = self.route.pose_at(self.progress_m);
        VehicleState {
            position_m: position.truncate(),
            yaw_rad,
            speed_mps: self.speed_mps,
            acceleration_mps2: 0.0,
        }
    }
}

/// Drives the start with an ego that brakes after a second: nobody may touch it until it stands,
/// but for who cuts in. That is made to come whatever gap there is, and an ego that brakes beside
/// it opens one.
fn check_start(graph: &Arc<RoadGraph>, map: &LaneMap, scenario: &Scenario, what: &str) {
    let mut traffic = Traffic::new(graph.clone(), &scenario.agents, scenario.seed)
        .unwrap_or_else(|why| panic!("{what}: {why}"));
    for (state, agent) in traffic.states().iter().flatten().zip(&scenario.agents) {
        let slower_mps = agent.speed_mps - state.speed_mps;
        assert!(
            slower_mps.abs() < 1e-9,
            "{what}: {} starts {slower_mps} m/s slower than it should",
            agent.name
        );
    }
    let route = Route::new(map, &scenario.ego).unwrap();
    let mut ego = BrakingEgo {
        route,
        size: scenario.ego.size,
        progress_m: 0.0,
        speed_mps: scenario.ego.speed_mps,
    };
    for step in 0..40 {
        let state = ego.state();
        traffic.step(0.1, Some((&state, &ego.size)));
        let slower_mps = if step < 10 { 0.0 } else { 0.6 };
        ego.progress_m += 0.1 * (ego.speed_mps - 0.5 * slower_mps).max(0.0);
        ego.speed_mps = (ego.speed_mps - slower_mps).max(0.0);
        let outline = OrientedBox::for_vehicle(&ego.state(), &ego.size);
        for (state, agent) in traffic.states().iter().flatten().zip(&scenario.agents) {
            let touches = outline.overlaps(&OrientedBox::for_vehicle(state, &agent.size));
            let cuts_in = agent
                .behaviors
                .iter()
                .any(|behavior| behavior.maneuver == Maneuver::CutIn);
            assert!(
                !touches || cuts_in,
                "{what}: {} touches the ego at {:.1} s",
                agent.name,
                0.1 * f64::from(step + 1)
            );
        }
    }
}

/// Makes `count` scenarios of each level and checks them; how many of each level there was room
/// for.
fn check_all(grounds: &Grounds, count: u32) -> [usize; 4] {
    let graph = Arc::new(RoadGraph::new(&grounds.map).unwrap());
    let generator = grounds.generator();
    Level::ALL.map(|level| {
        let made = (0..count).into_par_iter().map(|index| {
            let what = format!("{} {} {index}", grounds.name, level.name());
            match generator.scenario(level, 11, index) {
                Ok(scenario) => {
                    assert_eq!(scenario.name, format!("{}_{index:04}", level.name()));
                    check(grounds, &scenario, level, &what);
                    check_start(&graph, &grounds.map, &scenario, &what);
                    true
                }
                Err(GenerateError::NoRoom { found, .. }) => {
                    assert!(found < agents_near(level).0, "{what}: {found}");
                    false
                }
                Err(why) => panic!("{what}: {why}"),
            }
        });
        made.filter(|made| *made).count()
    })
}

#[test]
fn scenarios_of_the_street_keep_what_their_level_promises() {
    assert_eq!(check_all(&street(), 200), [200; 4]);
}

#[test]
fn scenarios_of_real_maps_keep_what_their_level_promises() {
    for name in [
        "esmini_fabriksgatan.xodr",
        "esmini_soderleden.xodr",
        "lanelet2_mapping_example.osm",
    ] {
        let Some(grounds) = roads(name) else { continue };
        let made = check_all(&grounds, 50);
        println!("{name}: {made:?} of 50 scenarios of each level");
        assert_eq!(made, [50; 4], "{name}");
    }
}

#[test]
fn the_same_numbers_give_the_same_scenario_and_others_give_others() {
    let (grounds, again) = (street(), street());
    let (generator, second) = (grounds.generator(), again.generator());
    let mut seen: Vec<Scenario> = Vec::new();
    for level in Level::ALL {
        for (seed, index) in [(1, 0), (1, 1), (2, 0)] {
            let scenario = generator.scenario(level, seed, index).unwrap();
            assert_eq!(scenario, second.scenario(level, seed, index).unwrap());
            assert!(
                seen.iter()
                    .all(|other| other.ego != scenario.ego && other.seed != scenario.seed)
            );
            seen.push(scenario);
        }
    }
}

#[test]
fn routes_stay_in_the_area() {
    let grounds = street();
    let area = Area {
        center_m: DVec2::new(40.0, 0.0),
        radius_m: 90.0,
    };
    let generator = grounds.generator().within(area);
    for index in 0..40 {
        let scenario = generator.scenario(Level::Medium, 5, index).unwrap();
        let route = Route::new(&grounds.map, &scenario.ego).unwrap();
        for progress_m in [0.0, route.length_m()] {
            let off_m = route
                .pose_at(progress_m)
                .0
                .truncate()
                .distance(area.center_m);
            assert!(off_m <= area.radius_m + 0.5, "{off_m} m from the middle");
        }
    }
}

fn straight(length_m: f64) -> LaneMap {
    let line = |y: f64| vec![DVec3::new(0.0, y, 0.0), DVec3::new(length_m, y, 0.0)];
    let lane = Lane {
        id: "only".into(),
        centerline: line(0.0),
        left: line(1.6),
        right: line(-1.6),
        ..Lane::default()
    };
    LaneMap {
        lanes: vec![lane],
        ..LaneMap::default()
    }
}

#[test]
fn slow_places_are_driven_at_their_limits() {
    let place = street().place;
    for limit_kmh in [3.0, 5.0, 10.0, 15.0, 30.0] {
        let mut map = straight(160.0);
        map.lanes[0].speed_limit_mps = Some(limit_kmh / 3.6);
        let generator = Generator::new(&map, place.clone(), &[VehicleSize::CAR]).unwrap();
        for index in 0..5 {
            let scenario = generator.scenario(Level::Easy, 1, index).unwrap();
            let (task, length_m) = (&scenario.ego, scenario.ego.end_m - scenario.ego.start_m);
            assert!(task.cruise_mps <= limit_kmh / 3.6 && task.cruise_mps > limit_kmh / 3.6 - 0.11);
            assert!(length_m >= 29.0, "{length_m}");
            // The time limit follows from the drive.
            let least_s = length_m / task.cruise_mps;
            assert!(scenario.duration_s > least_s, "{limit_kmh}: {least_s} s");
            assert!(
                scenario.duration_s < 3.0 * least_s + 30.0,
                "{limit_kmh}: {least_s} s"
            );
        }
    }
}

#[test]
fn maps_that_are_too_small_say_what_they_have_room_for() {
    let place = street().place;
    let generate = |map: &LaneMap, sizes: &[VehicleSize], level| {
        Generator::new(map, place.clone(), sizes)
            .and_then(|generator| generator.scenario(level, 1, 2))
    };
    let cars = [VehicleSize::CAR];
    let why = generate(&straight(110.0), &cars, Level::Extreme).unwrap_err();
    assert!(
        matches!(
            why,
            GenerateError::NoRoom {
                least: 16,
                most: 24,
                found: 1..16,
                ..
            }
        ),
        "{why:?}"
    );
    assert!(
        why.to_string()
            .contains("extreme_0002: expected 16 to 24 agents"),
        "{why}"
    );
    assert!(generate(&straight(300.0), &cars, Level::Easy).is_ok());
    let why = generate(&straight(30.0), &cars, Level::Easy).unwrap_err();
    assert!(
        matches!(why, GenerateError::NoRoute { .. }) && why.to_string().contains("30 m"),
        "{why}"
    );
    assert!(matches!(
        generate(&LaneMap::default(), &cars, Level::Easy),
        Err(GenerateError::NoRoute { .. })
    ));
    assert_eq!(
        generate(&straight(300.0), &[], Level::Easy),
        Err(GenerateError::NoAssets)
    );
    let broken = VehicleSize {
        width_m: f64::NAN,
        ..VehicleSize::CAR
    };
    assert!(
        generate(&straight(300.0), &[broken], Level::Easy)
            .unwrap_err()
            .to_string()
            .contains("NaN")
    );
    // A lane that is as wide as a motorcycle.
    let mut narrow = straight(300.0);
    narrow.lanes[0]
        .left
        .iter_mut()
        .for_each(|point| point.y = 0.4);
    assert!(generate(&narrow, &cars, Level::Easy).is_err());
}
