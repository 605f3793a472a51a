//! Scenario files: the documented example, round trips, complaints.

use std::path::Path;

use decouplegs_logs::{read_scenario, scenario_file, write_scenario};
use decouplegs_scene::scenario::{
    After, Behavior, DriverKind, LaneSide, Maneuver, Measure, Measured, Party, Place, Trigger,
};
use decouplegs_scene::{Air, Level, Scenario, VehicleSize, Weather};
use glam::DVec2;
use proptest::prelude::*;

use crate::scenarios::scenarios_of_egos;

/// The pieces of TOML on the format's page.
fn examples() -> Vec<String> {
    let page = std::fs::read_to_string(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../asset/scenario-file.md"),
    )
    .unwrap();
    let ends = |piece: &str| piece[..piece.find("```").expect("the piece ends")].to_owned();
    page.split("```toml\n").skip(1).map(ends).collect()
}

/// The example of the page.
pub fn example() -> String {
    examples().swap_remove(0)
}

#[test]
fn the_documented_example_means_what_it_says() {
    let scenario = scenario_file::parse(&example()).unwrap();
    assert_eq!(
        (scenario.name.as_str(), scenario.level, scenario.seed),
        ("cut-in-at-the-crossing", Some(Level::Hard), 17)
    );
    assert_eq!(
        (scenario.duration_s, scenario.step_s, scenario.steps()),
        (20.0, 0.5, 40)
    );
    let place = Place::Roads {
        map: "maps/town.xodr".into(),
        probe: Some("probes/dusk.exr".into()),
        exposure_ev: -1.5,
        air: Air::default(),
        obstacles: None,
        background: 400_000,
        agent_splats: 10_000,
    };
    assert_eq!(scenario.place, place);
    assert_eq!(scenario.ego.route, ["12/0/-1", "101/0/-1", "14/0/-1"]);
    assert_eq!(
        (scenario.ego.start_m, scenario.ego.end_m, scenario.ego.size),
        (5.0, 60.0, VehicleSize::CAR)
    );
    assert_eq!(
        (scenario.ego.speed_mps, scenario.ego.cruise_mps),
        (8.0, 11.0)
    );
    let [taxi] = scenario.agents.as_slice() else {
        panic!("one agent")
    };
    let found = (&*taxi.name, taxi.asset, &*taxi.lane, taxi.at_m);
    assert_eq!(found, ("taxi", 3, "12/0/-2", 25.0));
    assert_eq!(
        (taxi.driver, taxi.changes_lanes, taxi.size.to_array()),
        (DriverKind::Hurried, true, [4.8, 1.85, 1.5])
    );
    let at = |time_s: f64, maneuver: Maneuver| Behavior {
        trigger: Trigger::Time { time_s },
        maneuver,
    };
    let point_m = DVec2::new(40.0, 1.75);
    let change = |side: LaneSide| Maneuver::ChangeLane { side };
    let behaviors = [
        Behavior {
            trigger: Trigger::NearEgo { distance_m: 14.0 },
            maneuver: Maneuver::CutIn,
        },
        Behavior {
            trigger: Trigger::Time { time_s: 9.5 },
            maneuver: Maneuver::Brake {
                deceleration_mps2: 7.0,
                duration_s: 1.5,
            },
        },
        Behavior {
            trigger: Trigger::Measured(Measured {
                of: Party::Ego,
                measure: Measure::Headway,
                less_m: 4.5,
                is_above: false,
                value: 2.0,
                from_s: 3.0,
                delay_s: 0.5,
            }),
            maneuver: Maneuver::Cruise { speed_mps: 4.0 },
        },
        Behavior {
            trigger: Trigger::Time { time_s: 12.0 },
            maneuver: Maneuver::Swerve {
                amplitude_m: 0.8,
                duration_s: 3.0,
            },
        },
        at(15.0, change(LaneSide::Left)),
        at(18.0, Maneuver::Cruise { speed_mps: 6.0 }),
        at(19.0, Maneuver::Teleport { point_m }),
        Behavior {
            trigger: Trigger::After(After {
                behavior: 4,
                is_over: true,
                from_s: 16.0,
                delay_s: 2.0,
            }),
            maneuver: change(LaneSide::Right),
        },
    ];
    assert_eq!(taxi.behaviors, behaviors);
    assert_eq!(taxi.cruise_mps, Some(12.0));
}

#[test]
fn every_documented_place_is_read_and_what_may_be_left_out_is() {
    let [example, street, scene] = examples().try_into().expect("an example and two places");
    let (from, to) = (
        example.find("[place.roads]").unwrap(),
        example.find("[ego]").unwrap(),
    );
    let at = |place: &str| {
        scenario_file::parse(&example.replace(&example[from..to], place))
            .unwrap()
            .place
    };
    assert_eq!(
        at(&street),
        Place::Street {
            weather: Weather::Clear,
            background: 200_000,
            agent_splats: 10_000,
            seed: 1
        }
    );
    assert_eq!(
        at(&scene),
        Place::Scene {
            scene: "captured/scene.toml".into(),
            map: "captured/lanes.osm".into(),
            obstacles: Some("captured/obstacles.json".into()),
        }
    );

    let bare = "version = 1\nname = \"a\"\nseed = \"0xffffffffffffffff\"\n[place.roads]\nmap = \"m.json\"\nbackground = 9\n\
        agent_splats = 8\n[ego]\nroute = [\"1\"]\nstart_m = 0\nend_m = 9\nspeed_mps = 1\ncruise_mps = 2\n\
        [[agent]]\nname = \"b\"\nasset = 0\nlane = \"2\"\nat_m = 3\nspeed_mps = 4\n";
    let Scenario {
        level,
        seed,
        duration_s,
        step_s,
        place,
        ego,
        agents,
        ..
    } = scenario_file::parse(bare).unwrap();
    assert_eq!(
        (level, seed, duration_s, step_s),
        (None, u64::MAX, Scenario::DURATION_S, Scenario::STEP_S)
    );
    assert!(
        matches!(
            place,
            Place::Roads {
                probe: None,
                exposure_ev: 0.0,
                ..
            }
        ),
        "{place:?}"
    );
    assert_eq!(
        (ego.size, agents[0].size),
        (VehicleSize::CAR, VehicleSize::CAR)
    );
    assert_eq!(
        (agents[0].driver, agents[0].changes_lanes),
        (DriverKind::Normal, true)
    );
}

/// Checks what is said about the example when a text in it is replaced by another: line, key and
/// reason.
fn check_complaints(cases: &[(&str, &str, &str)]) {
    for (from, to, complaint) in cases.iter().copied() {
        let text = example();
        let at = text
            .find(from)
            .unwrap_or_else(|| panic!("the example has no {from}"));
        let line = 1 + text[..at].matches('\n').count();
        let error = scenario_file::parse(&text.replacen(from, to, 1)).unwrap_err();
        assert!(
            error.to_string().contains(complaint),
            "{from} -> {to}: {error}"
        );
        // An added line may stand above or below the one at fault.
        assert!(
            error.line.abs_diff(line) <= to.matches('\n').count(),
            "{from} -> {to}: {error}; expected line {line}"
        );
    }
}

#[test]
fn complaints_about_measured_triggers_name_line_key_and_reason() {
    check_complaints(&[
        (
            "from_s = 3.0",
            "from_s = -3.0",
            "behavior[2].when: from_s -3 is out of range",
        ),
        (
            "delay_s = 0.5",
            "delay_s = 1e308",
            "behavior[2].when: delay_s 1",
        ),
        (
            "below = 2.0",
            "below = inf",
            "behavior[2].when: below inf is out of range",
        ),
        (
            "below = 2.0",
            "below = 2.0, above = 1.0",
            "behavior[2].when: give either 'below' or 'above'",
        ),
        (
            "\"headway\"",
            "\"luck\"",
            "behavior[2].when: the measure 'luck' is unknown",
        ),
        (
            "\"headway\"",
            "\"distance_to\"",
            "behavior[2].when: 'distance_to' needs point_m",
        ),
    ]);
}

#[test]
fn complaints_about_road_users_name_line_key_and_reason() {
    check_complaints(&[
        (
            "kind = \"car\"",
            "kind = \"pedestrian\"",
            "agent[0].kind: 'pedestrian' is unknown; there are car, truck, bus, cyclist",
        ),
        (
            "kind = \"stop\"",
            "kind = \"halt\"",
            "sign[0].kind: 'halt' is unknown; there are stop, yield",
        ),
        (
            "at_m = 79.0",
            "at_m = -79.0",
            "sign[0].at_m: a line -79 m along; expected 0 to 1000000",
        ),
        (
            "[31.2, 8.5]",
            "[31.0, -8.5]",
            "pedestrian[0].path_m: points 0 m apart; expected 0.01 to 1000 m",
        ),
        (
            ", [31.2, 8.5]",
            "",
            "pedestrian[0].path_m: 1 is out of range; expected 2 to 1000",
        ),
        (
            "speed_mps = 1.4",
            "speed_mps = 14.0",
            "pedestrian[0].speed_mps: 14 is out of range",
        ),
        (
            "near_ego_m = 40.0",
            "at_time_s = 1.0\nnear_ego_m = 40.0",
            "pedestrian[0].at_time_s: give one of",
        ),
        (
            "name = \"walker\"",
            "name = \"taxi\"",
            "pedestrian[0].name: 'taxi' is taken",
        ),
    ]);
}

#[test]
fn complaints_name_line_key_and_reason() {
    // What is replaced by what, and what the complaint says, in this order; the line is that of the
    // replacement.
    let cases = [
        ("version = 1", "version = 2", "version: 2 is not read"),
        (
            "\"cut-in-at-the-crossing\"",
            "\"../../etc\"",
            "name: '../../etc' names files",
        ),
        ("\"cut-in-at-the-crossing\"", "\"\"", "name: '' names files"),
        (
            "\"hard\"",
            "\"harder\"",
            "level: 'harder' is unknown; there are easy, medium",
        ),
        (
            "seed = 17",
            "seed = -17",
            "seed: invalid value: integer `-17`",
        ),
        (
            "seed = 17",
            "seed = \"0x1ffffffffffffffff\"",
            "seed: invalid value",
        ),
        (
            "duration_s = 20.0",
            "duration_s = 3601.0",
            "duration_s: 3601 is out of range",
        ),
        (
            "duration_s = 20.0",
            "duration_s = nan",
            "duration_s: NaN is out of range",
        ),
        (
            "step_s = 0.5",
            "step_s = 0.0",
            "step_s: 0 is out of range; expected 0.02 to 5",
        ),
        (
            "map = \"maps/town.xodr\"",
            "map = \"\"",
            "place.map: is empty",
        ),
        (
            "exposure_ev = -1.5",
            "exposure_ev = inf",
            "place.exposure_ev: inf is out of range",
        ),
        (
            "background = 400000",
            "background = 0",
            "place.background: 0 is out of range",
        ),
        (
            "agent_splats = 10000",
            "agent_splats = 9000000000",
            "place.agent_splats: 9000000000 is out of range",
        ),
        (
            "[\"12/0/-1\", \"101/0/-1\", \"14/0/-1\"]",
            "[]",
            "ego.route: 0 lanes",
        ),
        (
            "[\"12/0/-1\", \"101/0/-1\", \"14/0/-1\"]",
            "[\"\"]",
            "ego.route: a lane's id of 0 bytes",
        ),
        (
            "start_m = 5.0",
            "start_m = -5.0",
            "ego.start_m: -5 is out of range",
        ),
        (
            "cruise_mps = 11.0",
            "cruise = 11.0",
            "cruise: unknown field",
        ),
        (
            "size_m = [4.5,",
            "size_m = [0.0,",
            "ego.size_m: 0 is out of range",
        ),
        (
            "\"taxi\"",
            "\"a taxi\"",
            "agent[0].name: 'a taxi' names files",
        ),
        (
            "asset = 3",
            "asset = 65536",
            "agent[0].asset: 65536 is out of range",
        ),
        (
            "\"hurried\"",
            "\"drunk\"",
            "agent[0].driver: 'drunk' is unknown",
        ),
        (
            "\"cut_in\"",
            "\"vanish\"",
            "agent[0].behavior[0].maneuver: 'vanish' is unknown",
        ),
        (
            "near_ego_m = 14.0",
            "deceleration_mps2 = 1.0\nnear_ego_m = 14.0",
            "behavior[0].deceleration_mps2: a maneuver 'cut_in'",
        ),
        (
            "at_time_s = 9.5",
            "near_ego_m = 1.0\nat_time_s = 9.5",
            "agent[0].behavior[1].at_time_s: give one of",
        ),
        (
            "deceleration_mps2 = 7.0",
            "deceleration_mps2 = -7.0",
            "behavior[1].deceleration_mps2: -7 is out of range",
        ),
        (
            "amplitude_m = 0.8",
            "amplitude_m = 80.0",
            "agent[0].behavior[3].amplitude_m: 80 is out of range",
        ),
    ];
    check_complaints(&cases);
    let twice = format!(
        "{}{}",
        example(),
        &example()[example().find("\n[[agent]]\n").unwrap()..]
    );
    let error = scenario_file::parse(&twice).unwrap_err();
    assert!(
        error.key == "agent[1].name" && error.reason.contains("'taxi' is taken"),
        "{error}"
    );
    let two_places = example().replace("[ego]", "[place.street]\nweather = \"clear\"\n[ego]");
    assert!(scenario_file::parse(&two_places).is_err());
}

#[test]
fn more_agents_than_allowed_are_refused() {
    let mut scenario = scenario_file::parse(&example()).unwrap();
    scenario.agents[0].behaviors.clear();
    let agent = scenario.agents[0].clone();
    // The pedestrian counts, too.
    scenario.agents = (1..scenario_file::AGENTS_MAX)
        .map(|index| decouplegs_scene::scenario::TrafficAgent {
            name: format!("a{index}"),
            ..agent.clone()
        })
        .collect();
    let text = scenario_file::to_toml(&scenario).unwrap();
    assert_eq!(scenario_file::parse(&text).unwrap(), scenario);
    let one_more = format!(
        "{text}\n[[agent]]\nname = \"last\"\nasset = 0\nlane = \"1\"\nat_m = 0.0\nspeed_mps = 0.0\n"
    );
    let error = scenario_file::parse(&one_more).unwrap_err();
    assert!(
        error.reason.contains("10001 agents") && error.line > 10_000,
        "{error}"
    );
}

#[test]
fn what_no_file_can_say_is_not_written() {
    let good = scenario_file::parse(&example()).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.toml");
    let refused = |scenario: &Scenario| {
        let error = write_scenario(&path, scenario).unwrap_err().to_string();
        assert!(error.contains("a.toml") && !path.exists(), "{error}");
        error
    };
    assert!(
        refused(&Scenario {
            step_s: f64::NAN,
            ..good.clone()
        })
        .contains("step_s: NaN")
    );
    assert!(
        refused(&Scenario {
            name: "a/b".into(),
            ..good.clone()
        })
        .contains("'a/b'")
    );
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        let map = std::ffi::OsStr::from_bytes(b"\xff.xodr").into();
        let place = Place::Scene {
            scene: "s.toml".into(),
            map,
            obstacles: None,
        };
        assert!(
            refused(&Scenario {
                place,
                ..good.clone()
            })
            .contains("not Unicode")
        );
    }
    write_scenario(&path, &good).unwrap();
    assert_eq!(read_scenario(&path).unwrap(), good);
    assert!(
        std::fs::read_to_string(&path)
            .unwrap()
            .starts_with("# A scenario: "),
        "a person who opens it is told what it is"
    );
    std::fs::write(&path, b"version = 1\n\xff").unwrap();
    let error = read_scenario(&path).unwrap_err().to_string();
    assert!(
        error.contains("a.toml") && error.contains("line 2") && error.contains("UTF-8"),
        "{error}"
    );
    assert!(
        read_scenario(&directory.path().join("none.toml"))
            .unwrap_err()
            .to_string()
            .contains("none.toml")
    );
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_scenario_reads_back_as_it_was_written(scenario in scenarios_of_egos()) {
        let text = scenario_file::to_toml(&scenario).unwrap();
        let back = scenario_file::parse(&text);
        prop_assert_eq!(back.as_ref(), Ok(&scenario), "{}", text);
        // Equal numbers have equal texts, so equal texts mean equal bits.
        prop_assert_eq!(scenario_file::to_toml(&scenario_file::parse(&text).unwrap()).unwrap(), text);
    }

    #[test]
    fn any_text_is_a_scenario_or_a_complaint(text in "(?s).{0,400}") {
        let _ = scenario_file::parse(&text);
    }

    /// The example with a piece cut out: never a panic, and a line within the text.
    #[test]
    fn a_mutilated_example_is_a_scenario_or_a_complaint(from in 0usize..4000, length in 1usize..60) {
        let text: String = example().chars().enumerate().filter(|(i, _)| !(from..from + length).contains(i)).map(|(_, c)| c).collect();
        if let Err(error) = scenario_file::parse(&text) {
            prop_assert!((1..=text.lines().count() + 1).contains(&error.line), "{error}");
        }
    }
}

#[test]
fn lights_are_read_and_faults_name_their_place() {
    let bare = "version = 1\nname = \"a\"\nseed = 1\n[place.street]\nweather = \"clear\"\nbackground = 9\nagent_splats = 8\n\
        seed = 1\n[ego]\nroute = [\"1\"]\nstart_m = 0\nend_m = 9\nspeed_mps = 1\ncruise_mps = 2\n";
    let light = "[[light]]\nname = \"main\"\nstop_lines = [[\"1\", 3.5]]\nphases = [[\"green\", 8], [\"red\", 9.5]]\n";
    let read = |lights: &str| scenario_file::parse(&format!("{bare}{lights}"));
    let lights = read(light).unwrap().lights;
    assert_eq!((lights[0].cycle_s(), lights[0].offset_s), (17.5, 0.0));
    assert_eq!(
        (
            lights[0].stop_lines[0].lane.as_str(),
            lights[0].stop_lines[0].at_m
        ),
        ("1", 3.5)
    );
    let told = |from: &str, to: &str| read(&light.replace(from, to)).unwrap_err().to_string();
    let twice = read(&format!("{light}{light}")).unwrap_err().to_string();
    for (error, parts) in [
        (
            told("\"red\"", "\"pink\""),
            [
                "light[0].phases",
                "'pink' is unknown; there are green, yellow, red",
            ],
        ),
        (
            told("9.5", "0.0"),
            ["light[0].phases", "0 s; expected 0.1 to 3600"],
        ),
        (
            told("3.5", "-1.0"),
            ["light[0].stop_lines", "a line -1 m along"],
        ),
        (
            told("[[\"1\", 3.5]]", "[]"),
            ["light[0].stop_lines", "0 of them; expected 1 to 1000"],
        ),
        (
            told(
                "phases = [[\"green\", 8], [\"red\", 9.5]]",
                "offset_s = inf",
            ),
            ["light[0].phases", "0 of them"],
        ),
        (twice, ["light[1].name", "'main' is taken"]),
    ] {
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    }
}
