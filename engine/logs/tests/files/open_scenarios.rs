//! OpenSCENARIO files: a small one with each element that is read, faults, and hostile ones.

mod kinds;

use std::path::Path;

use decouplegs_logs::open_scenario::{
    Action, Along, Condition, Measure, OpenScenario, Position, Target, TargetLane, TargetSpeed,
    When, decode,
};
use decouplegs_scene::story::{Direction, Dynamics, Edge, Extent, Limits, Rule, Shape, Side};
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

/// The only condition of an event.
fn condition(read: &OpenScenario, event: usize) -> &Condition {
    match read.events[event].start.as_deref() {
        Some([group]) if group.len() == 1 => &group[0],
        start => panic!("{start:?}"),
    }
}

fn fault(from: &str, to: &str) -> String {
    assert!(SCENARIO.contains(from), "{from}");
    let text = SCENARIO.replace(from, to);
    decode(text.as_bytes(), catalog).unwrap_err().to_string()
}

#[test]
fn entities_positions_and_actions_are_read() {
    let read = read(SCENARIO);
    assert_eq!(read.map.as_deref(), Some(Path::new("road.xodr")));
    assert_eq!(read.stop_time_s, Some(30.0));
    let kinds: Vec<_> = read
        .entities
        .iter()
        .map(|entity| (entity.name.as_str(), entity.kind))
        .collect();
    assert_eq!(
        kinds,
        [
            ("Ego", Some(RoadUser::Car)),
            ("Overtaker", Some(RoadUser::Car)),
            ("Truck ahead", Some(RoadUser::Truck)),
            ("walker", Some(RoadUser::Pedestrian)),
            ("parked", Some(RoadUser::Bus)),
            ("cone", None),
        ]
    );
    let [ego, overtaker, truck, walker, parked, _] = read.entities.as_slice() else {
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
            plus_mps: 0.0,
            continuous: false
        })
    );
    let begin = condition(&read, 0);
    assert_eq!((begin.delay_s, begin.edge), (1.0, Edge::Rising));
    let (rule, value_s) = (Rule::Greater, 3.0);
    assert_eq!(begin.when, When::Time { rule, value_s });
    assert!(matches!(
        overtaker.position,
        Some(Position::RelativeLane {
            along: Along::Road(18.0),
            ..
        })
    ));
    let actions = |event: usize| -> Vec<&Action> {
        let tasks = read.events[event].tasks.iter();
        tasks.map(|task| &task.action).collect()
    };
    let brake = Action::Speed {
        target: TargetSpeed::Absolute(10.0),
        dynamics: Dynamics {
            shape: Shape::Linear,
            extent: Extent::RatePerS(5.0),
        },
    };
    assert_eq!(actions(1), [&brake]);
    let right = Action::ChangeLane {
        target: TargetLane::Absolute(-3),
        offset_m: 0.0,
        dynamics: Dynamics::STEP,
    };
    assert_eq!(actions(2), [&right]);
    let gap = Action::KeepGap {
        to: "Ego".into(),
        gap: 20.0,
        is_time: false,
        between_boxes: true,
        side: Side::LeftOrBehind,
        continuous: true,
        limits: Limits::default(),
    };
    assert_eq!(actions(3), [&gap]);
    assert_eq!(read.events[3].start, Some(vec![]));
    let near = When::Value {
        of: vec!["Ego".into()],
        all: false,
        measure: Measure::Distance {
            to: Target::Entity("walker".into()),
            direction: Direction::Straight,
            between_boxes: false,
        },
        rule: Rule::Less,
        value: 60.0,
    };
    assert_eq!(condition(&read, 4).when, near);
    let [
        Action::Follow {
            points,
            times_s: None,
            ..
        },
    ] = actions(4)[..]
    else {
        panic!("{:?}", actions(4));
    };
    assert_eq!(
        points[1],
        Position::World {
            at_m: DVec2::new(590.0, 12.0),
            heading_rad: 0.0
        }
    );
    let about: Vec<_> = read
        .events
        .iter()
        .map(|event| {
            (
                event.act,
                event.maneuver,
                event.actors[0].as_str(),
                event.lost,
            )
        })
        .collect();
    assert_eq!(about[1], (0, 1, "Overtaker", 0));
    assert_eq!(about[2], (0, 2, "Truck ahead", 0));
    assert_eq!(about[5], (0, 3, "walker", 0));
    assert_eq!(
        (truck.position.is_some(), walker.position.is_some()),
        (true, true)
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
    let names = ["<MiscObject>", "<EnvironmentAction>"];
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
            "value=\"${2 * $EgoSpeed / 0}\"",
            ["line 49", "its value is inf"],
        ),
        ("s=\"50\"", "s=\"far\"", ["line 48", "no finite number"]),
        (
            "name=\"walker\">\n      <P",
            "name=\"Ego\">\n      <P",
            ["line 31", "a second object"],
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
    // Controllers that wait for each other in a circle.
    let controllers: String = (0..20_000)
        .map(|id| {
            format!(
                "<TrafficSignalController name='c{id}' delay='1' reference='c{}'><Phase name='p' duration='1'/></TrafficSignalController>",
                (id + 1) % 20_000
            )
        })
        .collect();
    let text = SCENARIO.replace(
        "</TrafficSignals>",
        &format!("{controllers}</TrafficSignals>"),
    );
    assert_eq!(read(&text).controllers.len(), 20_001);
    let objects: String = (0..20_000)
        .map(|id| {
            format!(
                "<ScenarioObject name='p{id}'><Pedestrian><BoundingBox><Dimensions length='1' width='1' height='1'/></BoundingBox></Pedestrian></ScenarioObject>"
            )
        })
        .collect();
    let text = SCENARIO.replace("</Entities>", &format!("{objects}</Entities>"));
    assert_eq!(read(&text).entities.len(), 20_006);
    // A long value that many elements name is evaluated once.
    let long = SCENARIO
        .replace(
            "value=\"20\"",
            &format!("value=\"${{{}20}}\"", "1 + ".repeat(240)),
        )
        .replace(
            "</Entities>",
            &format!(
                "{}</Entities>",
                "<ScenarioObject name='$EgoSpeed'/>".repeat(80_000)
            ),
        );
    let error = decode(long.as_bytes(), catalog).unwrap_err().to_string();
    assert!(
        error.contains("a second object with the name 260"),
        "{error}"
    );
    assert!(since.elapsed().as_secs_f64() < 30.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Any expression has a finite value or is an error with a sentence, at once.
    #[test]
    fn expressions_do_not_panic(inner in "([-+*/%^(), ]|[0-9.e]{1,4}|\\$EgoSpeed|pow|max|not|and|sqrt){0,60}") {
        let text = SCENARIO.replace("value=\"$EgoSpeed\"", &format!("value=\"${{{inner}}}\""));
        match decode(text.as_bytes(), catalog) {
            Ok(read) => {
                let speed = &read.entities[0].speed;
                prop_assert!(matches!(speed, Some(TargetSpeed::Absolute(speed)) if speed.is_finite()));
            }
            Err(error) => prop_assert!(error.to_string().contains("line ")),
        }
    }

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

/// A file whose ego is at `s` and drives at `speed`, with more parameters and entities.
fn small(parameters: &str, entities: &str, [s, speed]: [&str; 2]) -> String {
    format!(
        "<OpenSCENARIO><FileHeader revMajor='1' revMinor='1'/>
        <ParameterDeclarations>{parameters}</ParameterDeclarations>
        <CatalogLocations><VehicleCatalog><Directory path='catalogs'/></VehicleCatalog></CatalogLocations>
        <RoadNetwork><LogicFile filepath='m.xodr'/></RoadNetwork>
        <Entities><ScenarioObject name='Ego'><Vehicle vehicleCategory='car'><BoundingBox>
        <Dimensions width='1.8' length='4.4' height='1.5'/></BoundingBox>
        <Performance maxSpeed='${{250/}}' maxAcceleration='$none' maxDeceleration='many'/></Vehicle></ScenarioObject>
        {entities}</Entities>
        <Storyboard><Init><Actions><Private entityRef='Ego'><!-- it was \"$Old\" and ${{gone}} -->
        <PrivateAction><TeleportAction><Position><LanePosition roadId='1' laneId='-1' s='{s}'/></Position></TeleportAction></PrivateAction>
        <PrivateAction><LongitudinalAction><SpeedAction><SpeedActionTarget><AbsoluteTargetSpeed value='{speed}'/></SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>
        </Private></Actions></Init></Storyboard></OpenSCENARIO>"
    )
}

fn parameter(name: &str, value: &str) -> String {
    format!("<ParameterDeclaration name='{name}' parameterType='double' value='{value}'/>")
}

#[test]
fn expressions_are_evaluated_where_their_value_is_needed() {
    let declared = [
        ("V", "54"),
        ("W", "${$V / 3.6}"),
        ("Price", "$100"),
        ("a", "$b"),
        ("b", "$a"),
    ]
    .map(|(name, value)| parameter(name, value))
    .concat();
    let speed = |text: &str| {
        decode(small(&declared, "", ["50", text]).as_bytes(), catalog).map(|read| {
            match read.entities[0].speed {
                Some(TargetSpeed::Absolute(speed_mps)) => speed_mps,
                ref other => panic!("{other:?}"),
            }
        })
    };
    // What nobody reads - a performance, a comment, an unused parameter - refuses nothing.
    assert_eq!(speed("${$V / 3.6}"), Ok(15.0));
    assert_eq!(speed("${max($W, 3) ^ 2}"), Ok(225.0));
    for (text, reason) in [
        ("${$V / }", "ends where a value is expected"),
        ("$a", "in a circle"),
        ("$Old", "$Old is not declared"),
        ("${$V", "does not end with }"),
        ("$Price", "no finite number"),
    ] {
        let message = speed(text).unwrap_err().to_string();
        assert!(
            message.contains(reason) && message.contains("line 11"),
            "{text}: {message}"
        );
    }
}

#[test]
fn parameters_hold_where_they_are_declared_and_references_assign_them() {
    let sized = "<OpenSCENARIO><Catalog name='sized'><Vehicle name='long' vehicleCategory='truck'>
        <ParameterDeclarations><ParameterDeclaration name='len' value='6'/></ParameterDeclarations>
        <BoundingBox><Dimensions width='2' length='$len' height='${$len / 2}'/></BoundingBox></Vehicle></Catalog></OpenSCENARIO>";
    let read_file = |path: &Path| (path == Path::new("catalogs/sized.xosc")).then(|| sized.into());
    let object = |assignments: &str| {
        format!(
            "<ScenarioObject name='T'><CatalogReference catalogName='sized' entryName='long'>
            <ParameterAssignments>{assignments}</ParameterAssignments></CatalogReference></ScenarioObject>"
        )
    };
    for (assignments, expected) in [
        ("", [6.0, 3.0]),
        (
            "<ParameterAssignment parameterRef='len' value='9.0'/>",
            [9.0, 4.5],
        ),
        (
            "<ParameterAssignment parameterRef='$len' value='${$V / 6}'/>",
            [9.0, 4.5],
        ),
    ] {
        let text = small(&parameter("V", "54"), &object(assignments), ["50", "15"]);
        let truck = &decode(text.as_bytes(), read_file).unwrap().entities[1];
        assert_eq!(
            [truck.size.length_m, truck.size.height_m],
            expected,
            "{assignments}"
        );
    }
    // Those of the file do not hold in a catalog, nor those of an entry outside.
    let text = small(&parameter("V", "54"), &object(""), ["50", "$len"]);
    let message = decode(text.as_bytes(), read_file).unwrap_err().to_string();
    assert!(message.contains("$len is not declared"), "{message}");
}

#[test]
fn a_size_that_is_none_is_the_usual_one() {
    let walker = "<ScenarioObject name='W'><Pedestrian pedestrianCategory='pedestrian'><BoundingBox>
        <Dimensions width='0' length='0' height='$tall'/></BoundingBox></Pedestrian></ScenarioObject>";
    let read = decode(small("", walker, ["50", "15"]).as_bytes(), catalog).unwrap();
    assert_eq!(
        read.entities[1].size,
        decouplegs_scene::VehicleSize::PEDESTRIAN
    );
    let about = read
        .skipped
        .iter()
        .find(|sentence| sentence.contains("length is 0"));
    assert!(
        about.is_some_and(|sentence| sentence.contains("0.5 x 0.6 x 1.75 m")),
        "{:?}",
        read.skipped
    );
}
