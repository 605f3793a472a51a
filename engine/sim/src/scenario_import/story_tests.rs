//! Events of stories, on the road of `tests`.

use decouplegs_scene::scenario::{After, Maneuver, Trigger};

use super::tests::{AT_50, file, import, init, speed, teleport, vehicle};
use super::*;

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

#[test]
fn events_wait_for_measured_events_of_their_actor() {
    let traveled = "<Condition delay='0'><ByEntityCondition><TriggeringEntities triggeringEntitiesRule='any'><EntityRef entityRef='T'/></TriggeringEntities><EntityCondition><TraveledDistanceCondition value='40'/></EntityCondition></ByEntityCondition></Condition>";
    let dynamics =
        "<SpeedActionDynamics dynamicsShape='linear' dynamicsDimension='rate' value='2'/>";
    let slower = speed("7").replace("<SpeedAction>", &format!("<SpeedAction>{dynamics}"));
    let right = "<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape='sinusoidal' dynamicsDimension='distance' value='30'/><LaneChangeTarget><RelativeTargetLane entityRef='T' value='-1'/></LaneChangeTarget></LaneChangeAction></LateralAction></PrivateAction>";
    let later = "<SimulationTimeCondition value='9' rule='greaterThan'/>";
    let read = with_story(&story_of(&[
        ("slower", slower, traveled.into()),
        (
            "change",
            right.into(),
            by_value(&state_of("slower", "completeState"), 0.5),
        ),
        (
            "faster",
            speed("12"),
            by_value(&state_of("change", "completeState"), 1.0),
        ),
        (
            "both",
            speed("13"),
            by_value(&state_of("faster", "startTransition"), 0.0) + &by_value(later, 0.0),
        ),
    ]));
    let found: Vec<_> = read.scenario.agents[0]
        .behaviors
        .iter()
        .skip(1)
        .map(|behavior| behavior.trigger)
        .collect();
    let after = |behavior: usize, is_over: bool, from_s: f64, delay_s: f64| {
        Trigger::After(After {
            behavior,
            is_over,
            from_s,
            delay_s,
        })
    };
    // 10 to 7 m/s at 2 m/s^2 take 1.5 s; the end of a lane change over a way is seen.
    let expected = [
        after(0, false, 0.0, 2.0),
        after(1, true, 0.0, 1.0),
        after(2, false, 9.0, 0.0),
    ];
    assert_eq!(found, expected);
    assert_eq!((read.events, read.events_driven), (4, 4));
}

#[test]
fn a_speed_profile_is_one_change_after_the_other() {
    let profile = "<PrivateAction><LongitudinalAction><SpeedProfileAction followingMode='position'><SpeedProfileEntry speed='8' time='2'/><SpeedProfileEntry speed='12' time='3'/></SpeedProfileAction></LongitudinalAction></PrivateAction>";
    let at = by_value(
        "<SimulationTimeCondition value='1' rule='greaterThan'/>",
        0.0,
    );
    let then = by_value(&state_of("p", "completeState"), 0.0);
    let read = with_story(&story_of(&[
        ("p", profile.into(), at),
        ("q", speed("15"), then),
    ]));
    let behaviors = read.scenario.agents[0].behaviors.iter();
    let found: Vec<_> = behaviors
        .map(|behavior| (behavior.trigger, behavior.maneuver))
        .collect();
    let expected = [(1.0, 8.0), (3.0, 12.0), (6.0, 15.0)]
        .map(|(time_s, speed_mps)| (Trigger::Time { time_s }, Maneuver::Cruise { speed_mps }));
    assert_eq!(found, expected);
    // Without times the limits of the vehicle would decide: it is listed.
    let profile = profile.replace(" time='3'", "");
    let at = by_value(
        "<SimulationTimeCondition value='1' rule='greaterThan'/>",
        0.0,
    );
    let read = with_story(&story_of(&[("p", profile, at)]));
    assert_eq!(read.events_driven, 0);
    let skipped = read.skipped.join("\n");
    assert!(skipped.contains("a profile without times"), "{skipped}");
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
fn a_teleport_while_driving_is_to_the_middle_of_the_box() {
    let at = |time_s: u32| {
        let time = format!("<SimulationTimeCondition value='{time_s}' rule='greaterThan'/>");
        by_value(&time, 0.0)
    };
    let lane = teleport("<LanePosition roadId='1' laneId='-2' s='200'/>");
    let relative = teleport("<RelativeLanePosition entityRef='Ego' dLane='0' ds='10' offset='0'/>");
    let then = by_value(&state_of("lane", "completeState"), 1.0);
    let read = with_story(&story_of(&[
        ("lane", lane, at(2)),
        ("relative", relative, at(3)),
        ("nowhere", teleport("<WorldPosition x='50' y='80'/>"), at(3)),
        ("faster", speed("12"), then),
    ]));
    let behaviors = &read.scenario.agents[0].behaviors;
    let Maneuver::Teleport { point_m } = behaviors[0].maneuver else {
        panic!("{behaviors:?}");
    };
    // The middle of the box is 1.4 m ahead of the axle.
    assert!(
        point_m.distance(DVec2::new(201.4, -5.25)) < 1e-6,
        "{point_m}"
    );
    let begins: Vec<_> = behaviors.iter().map(|behavior| behavior.trigger).collect();
    assert_eq!(begins, [2.0, 3.0].map(|time_s| Trigger::Time { time_s }));
    assert_eq!((read.events, read.events_driven), (4, 2));
    let skipped = read.skipped.join("\n");
    for reason in ["relative to an entity that drives", "on no driving lane"] {
        assert!(skipped.contains(reason), "{skipped}");
    }
}
