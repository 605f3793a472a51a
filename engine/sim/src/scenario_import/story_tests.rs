//! Events of stories, on the road of `tests`.

use decouplegs_scene::story::{
    Action, Dynamics, Extent, Shape, Speed, Spot, State, TargetLane, Task, When,
};

use super::tests::{AT_50, file, import, init, speed, teleport, vehicle};
use super::{ImportedScenario, Who};

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
    // Without times the limits of the vehicle would decide: it is listed.
    let untimed = profile.replace(" time='3'", "");
    let lamps = private("<AppearanceAction/>");
    let begun = by_value(&state_of("slower", "startTransition"), 0.0);
    let read = with_story(&story_of(&[
        ("slower", slower, at(1)),
        ("right", right, begun),
        ("profile", profile, at(5)),
        ("untimed", untimed, at(9)),
        ("lamps", lamps, at(9)),
    ]));
    assert_eq!((read.events, read.events_driven), (4, 3));
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
        }),
        vec![],
        vec![],
    ];
    assert_eq!(actions_of(&read), expected);
    let when = When::Events {
        events: vec![1],
        state: State::Begun,
    };
    assert_eq!(read.scenario.story.events[2].start[0][0].when, when);
    let skipped = read.skipped.join("\n");
    for reason in ["a profile without times", "the event untimed is lost"] {
        assert!(skipped.contains(reason), "{skipped}");
    }
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
            left_m: Some(0.5),
        },
        Spot::From {
            who,
            offset_m: [3.0, 4.0],
            turns: true,
        },
        Spot::Lane {
            who,
            lanes: 0,
            ahead_m: 3.0,
            left_m: None,
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
