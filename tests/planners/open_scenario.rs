//! Episodes from OpenSCENARIO files.

use std::path::Path;
use std::sync::Arc;

use decouplegs::drive::score::EpisodeScore;
use decouplegs::episode::{Site, drive, replay};
use decouplegs::logs::{episode_log, scenario_file};
use decouplegs::planner::{ConstantVelocity, LaneFollow};
use decouplegs::scenario_import::{ImportedScenario, import_open_scenario};
use decouplegs::scene::episode::Episode;
use decouplegs::scene::scenario::Place;
use decouplegs::scene::story::{Action, Event};
use decouplegs::scene::{RoadUser, Scenario};
use tempfile::TempDir;

const SCENARIO: &str = include_str!("../../engine/asset/fuzz/seeds/open_scenario/cut_in.xosc");

/// A straight road of 1000 m with three lanes to the east, a walkway, and a traffic light.
const ROAD: &str = include_str!("../../engine/asset/fuzz/seeds/open_drive/three_lanes.xodr");

/// The folder of a scenario whose text is changed.
fn folder(replaced: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut text = SCENARIO.to_owned();
    for (from, to) in replaced {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    std::fs::write(folder.path().join("cut_in.xosc"), text).unwrap();
    std::fs::write(folder.path().join("road.xodr"), ROAD).unwrap();
    folder
}

fn imported(replaced: &[(&str, &str)]) -> (TempDir, ImportedScenario) {
    let folder = folder(replaced);
    let imported = import_open_scenario(&folder.path().join("cut_in.xosc"), None).unwrap();
    (folder, imported)
}

fn refused(replaced: &[(&str, &str)]) -> String {
    let folder = folder(replaced);
    let error = import_open_scenario(&folder.path().join("cut_in.xosc"), None).unwrap_err();
    let message = error.to_string();
    assert!(message.contains("cut_in.xosc"), "{message}");
    message
}

fn driven(scenario: &Scenario) -> Episode {
    let site = Arc::new(Site::open(&scenario.place, Path::new(""), None).unwrap());
    drive(scenario, &site, None, &mut LaneFollow::default(), &mut ())
        .unwrap()
        .episode
}

#[test]
fn a_file_becomes_a_scenario_that_can_be_written() {
    let (
        _folder,
        ImportedScenario {
            scenario, skipped, ..
        },
    ) = imported(&[]);
    // Reference points are rear axles, scenarios count from the middle of boxes.
    assert_eq!(scenario.ego.route, ["1/0/-2"]);
    assert_eq!((scenario.ego.start_m, scenario.ego.end_m), (51.4, 651.4));
    assert_eq!((scenario.ego.speed_mps, scenario.duration_s), (20.0, 60.0));
    let [overtaker, truck, walker, parked] = scenario.story.actors.as_slice() else {
        panic!("{:#?}", scenario.story.actors);
    };
    assert_eq!(
        (overtaker.lane.as_deref(), overtaker.speed_mps),
        (Some("1/0/-1"), 21.0)
    );
    assert_eq!(
        (overtaker.point_m, overtaker.center_m),
        ([68.0, -1.75], 1.4)
    );
    assert_eq!(
        (truck.name.as_str(), truck.kind),
        ("Truck_ahead", RoadUser::Truck)
    );
    assert_eq!(
        (walker.kind, walker.point_m),
        (RoadUser::Pedestrian, [590.0, -12.0])
    );
    assert_eq!(
        (parked.lane.as_deref(), parked.point_m),
        (Some("1/0/-3"), [700.0, -8.75])
    );
    assert_eq!(parked.speed_mps, 0.0);
    let actions = |event: usize| &scenario.story.events[event].actions;
    assert_eq!(scenario.story.events.len(), 7);
    assert!(matches!(actions(1)[0].action, Action::ChangeLane { .. }));
    assert!(matches!(actions(2)[0].action, Action::Speed { .. }));
    assert!(matches!(actions(5)[0].action, Action::Follow { .. }));
    assert_eq!(scenario.lights[0].stop_lines.len(), 3);
    // The cone has neither a size nor a place; the weather does not change.
    let parts = ["<MiscObject>", "<EnvironmentAction>", "cone"];
    for part in parts {
        assert!(
            skipped.iter().any(|sentence| sentence.contains(part)),
            "{part}: {skipped:#?}"
        );
    }

    let text = scenario_file::to_toml(&scenario).unwrap();
    assert_eq!(scenario_file::parse(&text).unwrap(), scenario);
}

#[test]
fn vehicles_do_what_the_file_says() {
    let (_folder, imported) = imported(&[]);
    let episode = driven(&imported.scenario);
    let at = |time_s: f64, agent: usize| {
        let mut instants = episode.instants();
        let instant = instants
            .find(|instant| instant.time_s >= time_s - 1e-6)
            .unwrap();
        instant.agents[agent].unwrap()
    };
    // The sinusoidal change of lanes takes 3 s from 4 s on, the brake 2.2 s from 10 s on.
    assert_eq!(at(3.9, 0).speed_mps, 21.0);
    assert!((at(3.9, 0).position_m.x - (69.4 + 3.9 * 21.0)).abs() < 1e-6);
    assert_eq!(at(3.9, 0).position_m.y, -1.75);
    assert!((at(5.5, 0).position_m.y + 3.5).abs() < 0.1);
    assert!((at(7.1, 0).position_m.y + 5.25).abs() < 1e-6);
    assert!((at(11.0, 0).speed_mps - 16.0).abs() < 0.11);
    assert_eq!(at(12.5, 0).speed_mps, 10.0);
    // The truck is 20 m behind the ego at once, until it leaves the lane.
    assert!((at(10.0, 1).position_m.y + 8.75).abs() < 1e-6);
    assert_eq!(at(0.0, 3), at(20.0, 3));
    let walked = at(0.0, 2).position_m.y;
    let last = episode.instants().last().unwrap();
    assert!(walked < -11.9 && last.agents[2].unwrap().position_m.y > walked + 5.0);
    // The log holds the scenario, its story included.
    let bytes = episode_log::encode(&episode).unwrap();
    assert_eq!(
        episode_log::decode(&bytes).unwrap().head.scenario,
        episode.head.scenario
    );
}

#[test]
fn what_cannot_be_placed_is_said() {
    let message = refused(&[("laneId=\"-2\" s=\"50\"", "laneId=\"-9\" s=\"50\"")]);
    assert!(
        message.contains("Ego") && message.contains("road 1 has no lane -9"),
        "{message}"
    );
    let path = "<LanePosition roadId=\"1\" laneId=\"-9\"";
    let (_folder, import) = imported(&[
        ("<RoadPosition roadId=\"1\"", path),
        ("t=\"-8.75\"", "offset=\"0\""),
    ]);
    assert_eq!(import.scenario.story.actors.len(), 3);
    let about = |sentence: &String| sentence.contains("parked") && sentence.contains("no lane -9");
    assert!(import.skipped.iter().any(about), "{:#?}", import.skipped);
    // A position relative to itself is none, and does not hang.
    let message = refused(&[(
        "<LanePosition roadId=\"1\" laneId=\"-2\" s=\"50\" offset=\"0\"/>",
        "<RelativeLanePosition entityRef=\"Overtaker\" dLane=\"0\" ds=\"5\"/>",
    )]);
    assert!(message.contains("it counts from Overtaker"), "{message}");
}

/// The scenario of the file with a traffic light at s = 250 and events of a story.
fn with_light_events(events: &str) -> Scenario {
    let story = format!(
        "<Story name='lights'><Act name='a'><ManeuverGroup name='g' maximumExecutionCount='1'><Actors selectTriggeringEntities='false'/>\
         <Maneuver name='m'>{events}</Maneuver></ManeuverGroup></Act></Story></Storyboard>"
    );
    let folder = folder(&[("</Storyboard>", &story)]);
    let road = ROAD.replace("s='900'", "s='250'");
    assert_ne!(road, ROAD);
    std::fs::write(folder.path().join("road.xodr"), road).unwrap();
    let imported = import_open_scenario(&folder.path().join("cut_in.xosc"), None).unwrap();
    let mut scenario = imported.scenario;
    // Nobody else: the ego meets the light alone.
    let own = |event: &Event| event.name.starts_with("light");
    scenario.story.events.retain(own);
    scenario.story.actors.clear();
    // The map is gone with its folder.
    let path = folder.keep().join("road.xodr");
    if let Place::Roads { map, .. } = &mut scenario.place {
        *map = path;
    }
    scenario
}

/// An event from `time_s` on.
fn light_event(time_s: f64, action: &str) -> String {
    format!(
        "<Event name='light' priority='parallel'><Action name='x'><GlobalAction><InfrastructureAction><TrafficSignalAction>{action}</TrafficSignalAction></InfrastructureAction></GlobalAction></Action>\
         <StartTrigger><ConditionGroup><Condition delay='0'><ByValueCondition><SimulationTimeCondition value='{time_s}' rule='greaterThan'/></ByValueCondition></Condition></ConditionGroup></StartTrigger></Event>"
    )
}

#[test]
fn lights_that_events_change_are_obeyed_scored_logged_and_replayed() {
    let red = light_event(6.0, "<TrafficSignalStateAction name='light' state='red'/>");
    let green = light_event(
        20.0,
        "<TrafficSignalControllerAction trafficSignalControllerRef='main' phase='go'/>",
    );
    let scenario = with_light_events(&(red + &green));
    let site = Arc::new(Site::open(&scenario.place, Path::new(""), None).unwrap());
    let episode = drive(&scenario, &site, None, &mut LaneFollow::default(), &mut ())
        .unwrap()
        .episode;
    let at = |time_s: f64| {
        let mut instants = episode.instants();
        let found = instants.find(|instant| instant.time_s >= time_s - 1e-6);
        found.unwrap().ego
    };
    // Without the events the light is green when the ego comes, after 10 s.
    assert!(at(19.0).speed_mps < 0.1 && at(19.0).position_m.x < 250.0);
    assert!(at(26.0).speed_mps > 5.0 && at(26.0).position_m.x > 250.0);
    assert_eq!(EpisodeScore::new(&episode).red_lights(), 0);
    let changes: Vec<_> = episode.steps.iter().flat_map(|step| &step.lights).collect();
    assert_eq!(changes.len(), 2, "{changes:?}");
    let bytes = episode_log::encode(&episode).unwrap();
    let read = episode_log::decode(&bytes).unwrap();
    assert_eq!(read, episode);
    let replayed = replay(&read, &site, None, &mut ()).unwrap();
    assert_eq!(replayed.moved_differently, None);
    // Who does not look passes at red, by the log alone too.
    let blind = drive(&scenario, &site, None, &mut ConstantVelocity, &mut ());
    let blind = blind.unwrap().episode;
    assert_eq!(EpisodeScore::new(&blind).red_lights(), 1);
    let read = episode_log::decode(&episode_log::encode(&blind).unwrap()).unwrap();
    assert_eq!(EpisodeScore::new(&read).red_lights(), 1);
    // A log whose lights change at another time does not replay.
    let mut other = episode.clone();
    let changed = other.steps.iter_mut().find(|step| !step.lights.is_empty());
    changed.unwrap().lights[0].change.time_s += 0.25;
    let replayed = replay(&other, &site, None, &mut ()).unwrap();
    let different = replayed
        .moved_differently
        .expect("the light changes differently");
    assert!(different.contains("traffic lights"), "{different}");
}
