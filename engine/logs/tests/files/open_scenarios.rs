//! OpenSCENARIO files: a small one with each element that is read, faults, and hostile ones.

use std::path::Path;

use decouplegs_logs::open_scenario::{
    Action, EventTrigger, OpenScenario, Position, TargetLane, TargetSpeed, Transition, decode,
};
use decouplegs_scene::{LightColor, RoadUser};
use glam::DVec2;
use proptest::prelude::*;

const SCENARIO: &str = include_str!("../../../asset/fuzz/seeds/open_scenario/cut_in.xosc");

const CATALOG: &str = "<OpenSCENARIO><FileHeader revMajor='1' revMinor='2'/><Catalog name='vehicles'>
    <Vehicle name='van' vehicleCategory='van'><BoundingBox><Center x='1.5' y='0' z='1'/>
    <Dimensions width='2' length='5.5' height='2.2'/></BoundingBox></Vehicle></Catalog></OpenSCENARIO>";

fn catalog(path: &Path) -> Option<Vec<u8>> {
    (path == Path::new("catalogs/vehicles.xosc")).then(|| CATALOG.into())
}

fn read(text: &str) -> OpenScenario {
    decode(text.as_bytes(), catalog).unwrap()
}

fn fault(from: &str, to: &str) -> String {
    assert!(SCENARIO.contains(from), "{from}");
    let text = SCENARIO.replace(from, to);
    decode(text.as_bytes(), catalog).unwrap_err().to_string()
}

#[test]
fn entities_positions_and_actions_are_read() {
    let read = read(SCENARIO);
    assert_eq!(read.map, Path::new("road.xodr"));
    assert_eq!(read.stop_time_s, Some(30.0));
    let kinds: Vec<_> = read
        .entities
        .iter()
        .map(|entity| (entity.name.as_str(), entity.kind))
        .collect();
    assert_eq!(
        kinds,
        [
            ("Ego", RoadUser::Car),
            ("Overtaker", RoadUser::Car),
            ("Truck ahead", RoadUser::Truck),
            ("walker", RoadUser::Pedestrian),
            ("parked", RoadUser::Bus),
        ]
    );
    let [ego, overtaker, truck, walker, parked] = read.entities.as_slice() else {
        panic!("{} entities", read.entities.len());
    };
    assert_eq!(ego.speed, Some(TargetSpeed::Absolute(20.0)));
    assert!(
        matches!(&ego.position, Some(Position::Lane { road, lane: -2, s_m: 50.0, .. }) if road == "1")
    );
    assert_eq!((overtaker.size.length_m, overtaker.center_m), (5.5, 1.5));
    assert_eq!(
        overtaker.speed,
        Some(TargetSpeed::Relative {
            entity: "Ego".into(),
            factor: 1.05,
            plus_mps: 0.0
        })
    );
    assert_eq!(overtaker.events[0].trigger, EventTrigger::Time(4.0));
    assert_eq!(
        overtaker.events[1].action,
        Action::Speed {
            target: TargetSpeed::Absolute(10.0),
            transition: Transition::Rate(5.0)
        }
    );
    assert_eq!(
        truck.events[0].action,
        Action::ChangeLane(TargetLane::Absolute(-3))
    );
    assert_eq!(truck.events.len(), 1);
    let EventTrigger::Distance { distance_m, .. } = &walker.events[0].trigger else {
        panic!("{:?}", walker.events[0]);
    };
    assert_eq!(*distance_m, 60.0);
    let Action::Path(path) = &walker.events[0].action else {
        panic!("{:?}", walker.events[0]);
    };
    assert_eq!(
        path[1],
        Position::World {
            at_m: DVec2::new(590.0, 12.0),
            heading_rad: 0.0
        }
    );
    assert_eq!(parked.speed, None);
    let [light] = read.signals.as_slice() else {
        panic!("{:?}", read.signals);
    };
    let colors: Vec<_> = light.phases.iter().map(|phase| phase.color).collect();
    assert_eq!(colors, [LightColor::Green, LightColor::Red]);
    assert_eq!((light.signal.as_str(), light.offset_s), ("light", -2.0));
}

#[test]
fn what_is_skipped_is_listed_with_its_line() {
    let read = read(SCENARIO);
    let names = [
        "<ScenarioObject>",
        "<GlobalAction>",
        "<LongitudinalDistanceAction>",
    ];
    assert_eq!(read.skipped.len(), names.len(), "{:#?}", read.skipped);
    for (sentence, name) in read.skipped.iter().zip(names) {
        assert!(
            sentence.starts_with("line ") && sentence.contains(name),
            "{sentence}"
        );
    }
    let without = decode(SCENARIO.as_bytes(), |_: &Path| None).unwrap();
    assert!(
        without.skipped[0].contains("vehicles.xosc"),
        "{:?}",
        without.skipped
    );
    assert_eq!(without.entities[1].size.length_m, 4.5);
}

#[test]
fn faults_name_line_and_element() {
    for (from, to, parts) in [
        (
            "value=\"$EgoSpeed\"",
            "value=\"$Other\"",
            ["line 49", "$Other is not declared"],
        ),
        (
            "value=\"$EgoSpeed\"",
            "value=\"${2 * $EgoSpeed}\"",
            ["line 49", "not evaluated"],
        ),
        ("s=\"50\"", "s=\"far\"", ["line 48", "no finite number"]),
        (
            "name=\"walker\">\n      <P",
            "name=\"Ego\">\n      <P",
            ["line 31", "a second object"],
        ),
        (
            "length=\"9\"",
            "length=\"900\"",
            ["line 28", "0.1 to 100 m"],
        ),
        (
            "entryName=\"van\"",
            "entryName=\"tank\"",
            ["line 25", "no entry tank"],
        ),
        (
            "revMajor=\"1\"",
            "revMajor=\"2\"",
            ["line 3", "versions 1.0 to 1.3"],
        ),
        (
            "<LogicFile filepath=\"road.xodr\"/>",
            "",
            ["line 10", "<LogicFile>"],
        ),
    ] {
        let message = fault(from, to);
        assert!(
            parts.iter().all(|part| message.contains(part)),
            "{from}: {message}"
        );
    }
    // A catalog is a file of the catalogs' folders, not a path out of them.
    let text = SCENARIO.replace("catalogName=\"vehicles\"", "catalogName=\"../vehicles\"");
    let asked = std::cell::RefCell::new(Vec::new());
    let read = decode(text.as_bytes(), |path: &Path| {
        asked.borrow_mut().push(path.to_owned());
        None
    });
    assert!(read.is_ok() && asked.borrow().is_empty());
}

#[test]
fn large_files_take_linear_time() {
    let since = std::time::Instant::now();
    let state = "<TrafficSignalState trafficSignalId='ID' state='red'/>";
    let states: String = (0..50_000)
        .map(|id| state.replace("ID", &id.to_string()))
        .collect();
    let from = "<TrafficSignalState trafficSignalId=\"light\" state=\"red\"/>";
    assert_eq!(read(&SCENARIO.replace(from, &states)).signals.len(), 50_001);
    let objects: String = (0..20_000)
        .map(|id| {
            format!(
                "<ScenarioObject name='p{id}'><Pedestrian><BoundingBox><Dimensions length='1' width='1' height='1'/></BoundingBox></Pedestrian></ScenarioObject>"
            )
        })
        .collect();
    let text = SCENARIO.replace("</Entities>", &format!("{objects}</Entities>"));
    assert_eq!(read(&text).entities.len(), 20_005);
    // A short parameter that becomes a long text is refused before it is one.
    let long = SCENARIO
        .replace("value=\"20\"", &format!("value=\"{}\"", "1".repeat(1000)))
        .replace(
            "</Entities>",
            &format!("{}</Entities>", "<a b='$EgoSpeed'/>".repeat(80_000)),
        );
    let error = decode(long.as_bytes(), catalog).unwrap_err().to_string();
    assert!(error.contains("parameters are replaced"), "{error}");
    assert!(since.elapsed().as_secs_f64() < 10.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Parts of the file removed, doubled or replaced give an error or a scenario, never a panic.
    #[test]
    fn damaged_files_do_not_panic(
        from in 0usize..SCENARIO.len(),
        length in 0usize..400,
        instead in prop_oneof![Just(String::new()), Just("-1e999".to_owned()), Just("\"><".to_owned()), "[ -~]{0,12}"],
    ) {
        let to = (from + length).min(SCENARIO.len());
        if SCENARIO.is_char_boundary(from) && SCENARIO.is_char_boundary(to) {
            let text = format!("{}{instead}{}", &SCENARIO[..from], &SCENARIO[to..]);
            let _ = decode(text.as_bytes(), |_: &Path| Some(text.clone().into_bytes()));
        }
    }
}
