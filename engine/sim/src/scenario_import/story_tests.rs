//! Events of stories, on the road of `tests`.

use decouplegs_scene::story::{
    Action, Dynamics, Extent, Limits, Shape, Speed, Spot, State, TargetLane, Task, When,
};

use decouplegs_logs::scenario_file;
use decouplegs_scene::{LightColor, Weather};

use super::tests::{AT_50, ROAD, file, import, import_on, init, speed, teleport, vehicle};
use super::{ImportedScenario, Place, Who};

/// A story of events of T: names, actions and conditions.
fn story_of(events: &[(&str, String, String)]) -> String {
    let events: String = events
        .iter()
        .map(|(name, action, condition)| {
            format!(
                "<Event name='{name}' priority='overwrite'><Action name='x'>{action}</Action><StartTrigger><ConditionGroup>{condition}</ConditionGroup></StartTrigger></Event>"
            )
        })
        .collect();
    format!(
        "<Story name='s'><Act name='a'><ManeuverGroup maximumExecutionCount='1' name='g'><Actors selectTriggeringEntities='false'><EntityRef entityRef='T'/></Actors><Maneuver name='m'>{events}</Maneuver></ManeuverGroup></Act></Story>"
    )
}

fn by_value(condition: &str, delay_s: f64) -> String {
    format!(
        "<Condition delay='{delay_s}'><ByValueCondition>{condition}</ByValueCondition></Condition>"
    )
}

fn state_of(event: &str, state: &str) -> String {
    format!(
        "<StoryboardElementStateCondition storyboardElementType='event' storyboardElementRef='{event}' state='{state}'/>"
    )
}

/// Scenario of an ego, and T at s = 100 with 10 m/s.
fn with_story(story: &str) -> ImportedScenario {
    let entities = vehicle("Ego", "") + &vehicle("T", "");
    let place = "<LanePosition roadId='1' laneId='-1' s='100'/>";
    let actions = init("Ego", &teleport(AT_50)) + &init("T", &(teleport(place) + &speed("10")));
    import(&file(&entities, &actions, story))
}

/// Actions of the events of a story, without that of the start.
fn actions_of(read: &ImportedScenario) -> Vec<Vec<Task>> {
    let events = read.scenario.story.events.iter().skip(1);
    events.map(|event| event.actions.clone()).collect()
}

fn at(time_s: u32) -> String {
    let time = format!("<SimulationTimeCondition value='{time_s}' rule='greaterThan'/>");
    by_value(&time, 0.0)
}

fn private(inner: &str) -> String {
    format!("<PrivateAction>{inner}</PrivateAction>")
}

#[test]
fn actions_are_those_of_the_file() {
    let dynamics =
        "<SpeedActionDynamics dynamicsShape='linear' dynamicsDimension='rate' value='2'/>";
    let slower = speed("7").replace("<SpeedAction>", &format!("<SpeedAction>{dynamics}"));
    let right = private(
        "<LateralAction><LaneChangeAction targetLaneOffset='0.2'><LaneChangeActionDynamics dynamicsShape='sinusoidal' dynamicsDimension='distance' value='30'/><LaneChangeTarget><RelativeTargetLane entityRef='Ego' value='-1'/></LaneChangeTarget></LaneChangeAction></LateralAction>",
    );
    let profile = private(
        "<LongitudinalAction><SpeedProfileAction followingMode='position'><SpeedProfileEntry speed='8' time='2'/><SpeedProfileEntry speed='12' time='3'/></SpeedProfileAction></LongitudinalAction>",
    );
    // Without times the limits decide: 2 m/s^2 here, and 5 where the file tells none.
    let untimed = profile.replace(" time='3'", "");
    let limited = untimed.replace(" time='2'", "").replace(
        "<SpeedProfileEntry speed='8'/>",
        "<DynamicConstraints maxAcceleration='2' maxDeceleration='4'/><SpeedProfileEntry speed='8'/>",
    );
    let lamps = private("<AppearanceAction/>");
    let begun = by_value(&state_of("slower", "startTransition"), 0.0);
    let read = with_story(&story_of(&[
        ("slower", slower, at(1)),
        ("right", right, begun),
        ("profile", profile, at(5)),
        ("untimed", untimed, at(9)),
        ("limited", limited, at(10)),
        ("lamps", lamps, at(9)),
    ]));
    assert_eq!((read.events, read.events_driven), (5, 5));
    assert_eq!(read.events_unseen, 1);
    let of_t = |action: Action| vec![Task { of: Who(1), action }];
    let expected = [
        of_t(Action::Speed {
            target: Speed::Mps(7.0),
            dynamics: Dynamics {
                shape: Shape::Linear,
                extent: Extent::RatePerS(2.0),
            },
        }),
        of_t(Action::ChangeLane {
            target: TargetLane::Beside {
                who: Who::EGO,
                lanes: -1,
            },
            offset_m: 0.2,
            dynamics: Dynamics {
                shape: Shape::Sinusoidal,
                extent: Extent::DistanceM(30.0),
            },
        }),
        of_t(Action::Profile {
            times_s: vec![2.0, 3.0],
            speeds_mps: vec![8.0, 12.0],
            limits: Limits::default(),
        }),
        of_t(Action::Profile {
            times_s: vec![2.0, 0.8],
            speeds_mps: vec![8.0, 12.0],
            limits: Limits::default(),
        }),
        of_t(Action::Profile {
            times_s: vec![0.0, 2.0],
            speeds_mps: vec![8.0, 12.0],
            limits: Limits {
                acceleration_mps2: Some(2.0),
                deceleration_mps2: Some(4.0),
                ..Limits::default()
            },
        }),
        vec![],
    ];
    assert_eq!(actions_of(&read), expected);
    let when = When::Events {
        events: vec![1],
        state: State::Begun,
    };
    assert_eq!(read.scenario.story.events[2].start[0][0].when, when);
}

#[test]
fn events_of_the_ego_take_their_time_for_others() {
    let dynamics =
        "<SpeedActionDynamics dynamicsShape='linear' dynamicsDimension='rate' value='2'/>";
    let faster = speed("6").replace("<SpeedAction>", &format!("<SpeedAction>{dynamics}"));
    let story = story_of(&[("faster", faster, at(1))]).replace("entityRef='T'", "entityRef='Ego'");
    let read = with_story(&story);
    // From a stand to 6 m/s.
    let action = Action::Wait { duration_s: 3.0 };
    let of = Who::EGO;
    assert_eq!(actions_of(&read), [[Task { of, action }]]);
    assert_eq!((read.events, read.events_driven), (0, 0));
}

#[test]
fn what_takes_time_at_the_start_is_the_first_event() {
    let dynamics =
        "<SpeedActionDynamics dynamicsShape='cubic' dynamicsDimension='time' value='3'/>";
    let faster = speed("9").replace("<SpeedAction>", &format!("<SpeedAction>{dynamics}"));
    let entities = vehicle("Ego", "") + &vehicle("T", "") + &vehicle("Later", "");
    let place = "<LanePosition roadId='1' laneId='-1' s='100'/>";
    let actions = init("Ego", &teleport(AT_50)) + &init("T", &(teleport(place) + &faster));
    let add = format!(
        "<GlobalAction><EntityAction entityRef='Later'><AddEntityAction><Position>{}</Position></AddEntityAction></EntityAction></GlobalAction>",
        "<LanePosition roadId='1' laneId='-2' s='200'/>"
    );
    let read = import(&file(
        &entities,
        &actions,
        &story_of(&[("add", add, at(2))]),
    ));
    let story = &read.scenario.story;
    assert!(matches!(
        story.events[0].actions[..],
        [Task {
            of: Who(1),
            action: Action::Speed {
                target: Speed::Mps(9.0),
                ..
            }
        }]
    ));
    assert_eq!(story.actors[0].speed_mps, 0.0);
    let later = &story.actors[1];
    assert_eq!((later.is_hidden, later.point_m), (true, [200.0, -5.25]));
    let shown = Action::Show { is_shown: true };
    assert_eq!(
        story.events[1].actions[1],
        Task {
            of: Who(2),
            action: shown
        }
    );
    assert_eq!((read.events, read.events_driven), (1, 1));
}

#[test]
fn who_has_no_position_starts_on_its_trajectory() {
    let vertex = |time_s: f64, s_m: f64| {
        format!(
            "<Vertex time='{time_s}'><Position><LanePosition roadId='1' laneId='-1' s='{s_m}'/></Position></Vertex>"
        )
    };
    let follow = format!(
        "<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name='t' closed='false'><Shape><Polyline>{}{}</Polyline></Shape></Trajectory></TrajectoryRef><TimeReference><None/></TimeReference><TrajectoryFollowingMode followingMode='position'/></FollowTrajectoryAction></RoutingAction></PrivateAction>",
        vertex(0.0, 60.0),
        vertex(5.0, 160.0)
    );
    let read = import(&file(&vehicle("Ego", ""), &init("Ego", &follow), ""));
    let task = &read.scenario.ego;
    assert!((task.start_m - 61.4).abs() < 1e-6, "{}", task.start_m);
    let said = |sentence: &String| sentence.contains("the first point of its trajectory");
    assert!(read.skipped.iter().any(said));
}

#[test]
fn places_of_actions_may_count_from_others_that_drive() {
    let lane = teleport("<LanePosition roadId='1' laneId='1' s='200'/>");
    let relative =
        teleport("<RelativeLanePosition entityRef='Ego' dLane='-1' ds='10' offset='0.5'/>");
    let beside = teleport("<RelativeObjectPosition entityRef='Ego' dx='3' dy='4'/>");
    let along = teleport("<RelativeRoadPosition entityRef='Ego' ds='3' dt='0'/>");
    let read = with_story(&story_of(&[
        ("lane", lane, at(2)),
        ("relative", relative, at(3)),
        ("beside", beside, at(3)),
        ("along", along, at(3)),
        (
            "nowhere",
            teleport("<LanePosition roadId='9' laneId='1' s='2'/>"),
            at(3),
        ),
    ]));
    assert_eq!((read.events, read.events_driven), (5, 4));
    let who = Who::EGO;
    let expected = [
        // Traffic on lane 1 runs to the west.
        Spot::Point {
            at_m: [200.0, 1.75],
            heading_rad: Some(std::f64::consts::PI),
        },
        Spot::Lane {
            who,
            lanes: -1,
            ahead_m: 10.0,
            on_road: true,
            left_m: Some(0.5),
        },
        Spot::From {
            who,
            offset_m: [3.0, 4.0],
            turns: true,
        },
        Spot::Road {
            who,
            along_m: 3.0,
            left_m: 0.0,
        },
    ];
    let places: Vec<Spot> = actions_of(&read)
        .iter()
        .flatten()
        .map(|task| match task.action {
            Action::Teleport { to } => to,
            ref action => panic!("{action:?}"),
        })
        .collect();
    assert_eq!(places, expected);
}

/// The road of the tests with a traffic light at s = 200.
fn with_light(text: &str) -> ImportedScenario {
    let signal = "<signals><signal id='7' s='200' t='-4' type='1000001' subtype='-1' dynamic='yes' orientation='+'/></signals></road>";
    import_on(text, &ROAD.replace("</road>", signal))
}

#[test]
fn events_direct_the_lights_of_the_map_and_wait_for_them() {
    let global = |inner: &str| {
        format!(
            "<GlobalAction><InfrastructureAction><TrafficSignalAction>{inner}</TrafficSignalAction></InfrastructureAction></GlobalAction>"
        )
    };
    let red = global("<TrafficSignalStateAction name='7' state='red'/>");
    let absent = global("<TrafficSignalStateAction name='99' state='red'/>");
    let stop =
        global("<TrafficSignalControllerAction trafficSignalControllerRef='c' phase='stop'/>");
    let wrong =
        global("<TrafficSignalControllerAction trafficSignalControllerRef='c' phase='halt'/>");
    let is_red = by_value("<TrafficSignalCondition name='7' state='red'/>", 0.0);
    let entities = vehicle("Ego", "") + &vehicle("T", "");
    let place = "<LanePosition roadId='1' laneId='-1' s='100'/>";
    let actions = init("Ego", &teleport(AT_50)) + &init("T", &(teleport(place) + &speed("10")));
    let story = story_of(&[
        ("red", red, at(1)),
        ("slower", speed("3"), is_red),
        ("absent", absent, at(1)),
        ("stop", stop, at(3)),
        ("wrong", wrong, at(3)),
        (
            "waits",
            speed("4"),
            by_value(
                "<TrafficSignalControllerCondition trafficSignalControllerRef='c' phase='wait'/>",
                0.0,
            ),
        ),
    ]);
    let text = file(&entities, &actions, &story);
    let controller = "<TrafficSignals><TrafficSignalController name='c'><Phase name='go' duration='6'><TrafficSignalState trafficSignalId='7' state='green'/></Phase><Phase name='stop' duration='4'><TrafficSignalState trafficSignalId='7' state='red'/></Phase></TrafficSignalController></TrafficSignals></RoadNetwork>";
    let read = with_light(&text.replace("</RoadNetwork>", controller));
    let story = &read.scenario.story;
    let light = |color| Action::Light {
        light: "7".into(),
        color,
    };
    assert_eq!(story.events[1].actions[0].action, light(LightColor::Red));
    let waits = When::Light {
        light: "7".into(),
        color: LightColor::Red,
    };
    assert_eq!(story.events[2].start[0][0].when, waits);
    // One that the map does not have counts for the conditions alone.
    assert_eq!(story.events[3].actions.len(), 1);
    assert!(read.scenario.lights[1].stop_lines.is_empty());
    let text = scenario_file::to_toml(&read.scenario).unwrap();
    assert_eq!(scenario_file::parse(&text).unwrap(), read.scenario);
    let phase = Action::Phase {
        controller: "c".into(),
        phase: "stop".into(),
    };
    assert_eq!(story.events[4].actions[0].action, phase);
    assert_eq!(story.controllers[0].lights, ["7"]);
    assert_eq!(read.scenario.lights[0].phases.len(), 2);
    let skipped = read.skipped.join("\n");
    assert!(skipped.contains("signal 99 has no stop line"), "{skipped}");
    // Phases that the controller does not have can be neither begun nor met.
    for phase in ["halt", "wait"] {
        let said = format!("the controller c has no phase {phase}");
        assert!(skipped.contains(&said), "{skipped}");
    }
    assert_eq!((read.events, read.events_driven), (6, 4));
    // A light that the story alone directs is green until then.
    let alone = with_light(&file(
        &entities,
        &actions,
        &story_of(&[(
            "red",
            global("<TrafficSignalStateAction name='7' state='red'/>"),
            at(1),
        )]),
    ));
    assert_eq!(alone.scenario.lights[0].color_at(0.0), LightColor::Green);
    assert!(alone.scenario.story.controllers.is_empty());
}

#[test]
fn light_and_air_become_those_of_the_place() {
    let air = |inner: &str| {
        let action = format!(
            "<GlobalAction><EnvironmentAction><Environment name='e'>{inner}</Environment></EnvironmentAction></GlobalAction>"
        );
        let actions = action + &init("Ego", &teleport(AT_50));
        let Place::Roads { air, .. } = import(&file(&vehicle("Ego", ""), &actions, ""))
            .scenario
            .place
        else {
            panic!("a place that is no map");
        };
        (air.weather, air.visibility_m)
    };
    let sky = |cloud: &str, sun: f64| {
        format!(
            "<Weather cloudState='{cloud}'><Sun azimuth='0' elevation='{sun}' intensity='1'/></Weather>"
        )
    };
    let hour =
        |hour: u32| format!("<TimeOfDay animation='false' dateTime='2024-03-20T{hour:02}:00:00'/>");
    for (inner, weather) in [
        (sky("free", 0.8), Some(Weather::Clear)),
        (sky("overcast", 0.8), Some(Weather::Overcast)),
        (sky("free", 0.05), Some(Weather::Dusk)),
        (sky("overcast", -0.5), Some(Weather::Night)),
        (hour(12), Some(Weather::Clear)),
        (hour(18), Some(Weather::Dusk)),
        (hour(23), Some(Weather::Night)),
        // The place of the sun counts more.
        (hour(23) + &sky("free", 0.8), Some(Weather::Clear)),
        (String::new(), None),
    ] {
        assert_eq!(air(&inner), (weather, None), "{inner}");
    }
    let fog = "<Weather><Fog visualRange='120'/></Weather>";
    assert_eq!(air(fog), (None, Some(120.0)));
}

#[test]
fn conditions_stop_the_episode_and_times_its_drive() {
    let entities = vehicle("Ego", "") + &vehicle("T", "");
    let place = "<LanePosition roadId='1' laneId='-1' s='100'/>";
    let actions = init("Ego", &teleport(AT_50)) + &init("T", &(teleport(place) + &speed("10")));
    let story = story_of(&[("slower", speed("3"), at(1))]);
    let group = |conditions: &str| format!("<ConditionGroup>{conditions}</ConditionGroup>");
    let traveled = |who: &str| {
        format!(
            "<Condition delay='0'><ByEntityCondition><TriggeringEntities triggeringEntitiesRule='any'><EntityRef entityRef='{who}'/></TriggeringEntities><EntityCondition><TraveledDistanceCondition value='30'/></EntityCondition></ByEntityCondition></Condition>"
        )
    };
    let groups = [
        group(&(traveled("Ego") + &at(4))),
        group(&by_value(&state_of("slower", "endTransition"), 2.0)),
        group(&traveled("nobody")),
    ]
    .concat();
    // The file of the tests stops at 4 s.
    let text = file(&entities, &actions, &story);
    let text = text.replace("<StopTrigger>", &format!("<StopTrigger>{groups}"));
    assert!(text.contains("nobody"), "{text}");
    let read = import(&text);
    let story = &read.scenario.story;
    assert_eq!(story.stop.len(), 2, "{:?}", story.stop);
    assert_eq!(story.stop[0].len(), 2);
    let ended = &story.stop[1][0];
    assert!(matches!(&ended.when, When::Events { events, .. } if *events == [1]));
    assert_eq!(ended.delay_s, 2.0);
    // The ego drives for the time of the file, with what planners may take longer.
    let alone = import(&file(&entities, &actions, ""));
    assert_eq!(read.scenario.duration_s, alone.scenario.duration_s);
    assert!(alone.scenario.story.stop.is_empty());
    let skipped = read.skipped.join("\n");
    assert!(
        skipped.contains("it does not stop the episode"),
        "{skipped}"
    );
    let text = scenario_file::to_toml(&read.scenario).unwrap();
    assert_eq!(scenario_file::parse(&text).unwrap(), read.scenario);
}

#[test]
fn a_spline_without_a_start_begins_where_its_actor_is() {
    let spline = private(
        "<RoutingAction><FollowTrajectoryAction><Trajectory name='t' closed='false'><Shape><ClothoidSpline><ClothoidSplineSegment curvatureStart='0' curvatureEnd='0' length='20'/></ClothoidSpline></Shape></Trajectory><TimeReference><None/></TimeReference><TrajectoryFollowingMode followingMode='position'/></FollowTrajectoryAction></RoutingAction>",
    );
    let read = with_story(&story_of(&[("t", spline, at(1))]));
    let Action::Follow {
        points_m,
        seen_from,
        ..
    } = &actions_of(&read)[0][0].action
    else {
        panic!("{:?}", actions_of(&read));
    };
    assert_eq!(*seen_from, Some(Who(1)));
    assert_eq!(points_m.first(), Some(&[0.0, 0.0]));
    assert!((points_m.last().unwrap()[0] - 20.0).abs() < 1e-9);
}
