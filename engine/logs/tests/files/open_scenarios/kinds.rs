//! Conditions and actions of each kind, traffic signals, and the light at the start.

use decouplegs_logs::open_scenario::{
    Action, Environment, Measure, OpenScenario, Target, TargetSpeed, When, decode,
};
use decouplegs_scene::LightColor;
use decouplegs_scene::story::{Direction, Dynamics, Edge, Extent, Priority, Rule, Shape, State};

use super::{SCENARIO, catalog, condition, read, small};

/// A file with a condition and an action of each kind, in events of one maneuver.
fn each_kind() -> OpenScenario {
    let entity = |inner: &str| {
        format!(
            "<ByEntityCondition><TriggeringEntities triggeringEntitiesRule='all'><EntityRef entityRef='T'/></TriggeringEntities><EntityCondition>{inner}</EntityCondition></ByEntityCondition>"
        )
    };
    let value = |inner: &str| format!("<ByValueCondition>{inner}</ByValueCondition>");
    let speed = "<PrivateAction><LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape='cubic' dynamicsDimension='distance' value='9'/><SpeedActionTarget><RelativeTargetSpeed entityRef='Ego' value='-2' speedTargetValueType='delta' continuous='true'/></SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>";
    let event = |name: &str, condition: &str, action: &str| {
        format!(
            "<Event name='{name}' priority='skip' maximumExecutionCount='3'><Action name='a'>{action}</Action><StartTrigger><ConditionGroup><Condition delay='0.5' conditionEdge='falling'>{condition}</Condition></ConditionGroup></StartTrigger></Event>"
        )
    };
    let clearance = "<RelativeClearanceCondition distanceForward='20' distanceBackward='10' freeSpace='true' oppositeLanes='false'><RelativeLaneRange from='-1' to='1'/></RelativeClearanceCondition>";
    let lane_less = "entityRef='Ego' relativeDistanceType='longitudinal' coordinateSystem='lane' freespace='true' value='7' rule='lessThan'";
    let events = [
        event("end", &entity("<EndOfRoadCondition duration='2'/>"), speed),
        event("off", &entity("<OffroadCondition duration='2'/>"), "<PrivateAction><VisibilityAction graphics='false' sensors='false' traffic='true'/></PrivateAction>"),
        event("free", &entity(clearance), "<GlobalAction><EntityAction entityRef='T'><DeleteEntityAction/></EntityAction></GlobalAction>"),
        event("hit", &entity("<CollisionCondition><EntityRef entityRef='Ego'/></CollisionCondition>"), "<PrivateAction><AppearanceAction/></PrivateAction>"),
        event("near", &entity(&format!("<RelativeDistanceCondition {lane_less}/>")), "<GlobalAction><VariableAction variableRef='v'><ModifyAction><Rule><AddValue value='2'/></Rule></ModifyAction></VariableAction></GlobalAction>"),
        event("v", &value("<VariableCondition variableRef='v' rule='notEqualTo' value='3'/>"), "<PrivateAction><LateralAction><LaneOffsetAction continuous='false'><LaneOffsetActionDynamics dynamicsShape='sinusoidal' maxLateralAcc='2'/><LaneOffsetTarget><AbsoluteTargetLaneOffset value='0.4'/></LaneOffsetTarget></LaneOffsetAction></LateralAction></PrivateAction>"),
        event("state", &value("<StoryboardElementStateCondition storyboardElementType='maneuver' storyboardElementRef='m' state='completeState'/>"), "<PrivateAction><TrailerAction/></PrivateAction>"),
        event("lost", &value("<UserDefinedValueCondition name='s' rule='equalTo' value='1'/>"), speed),
        event("signal", &value("<TrafficSignalCondition name='7' state='green'/>"), "<GlobalAction><InfrastructureAction><TrafficSignalAction><TrafficSignalStateAction name='7' state='on;off'/></TrafficSignalAction></InfrastructureAction></GlobalAction>"),
        event("phase", &value("<TrafficSignalControllerCondition trafficSignalControllerRef='c' phase='go'/>"), "<GlobalAction><InfrastructureAction><TrafficSignalAction><TrafficSignalControllerAction trafficSignalControllerRef='c' phase='stop'/></TrafficSignalAction></InfrastructureAction></GlobalAction>"),
        event("none", &value("<TrafficSignalControllerCondition trafficSignalControllerRef='d' phase='go'/>"), "<GlobalAction><InfrastructureAction><TrafficSignalAction><TrafficSignalStateAction name='7' state='blue'/></TrafficSignalAction></InfrastructureAction></GlobalAction>"),
    ]
    .concat();
    let story = format!(
        "<Story name='s'><Act name='a'><ManeuverGroup name='g' maximumExecutionCount='2'><Actors selectTriggeringEntities='false'><EntityRef entityRef='T'/></Actors><Maneuver name='m'>{events}</Maneuver></ManeuverGroup><StopTrigger><ConditionGroup><Condition delay='0'>{}</Condition></ConditionGroup></StopTrigger></Act></Story>",
        value("<SimulationTimeCondition value='8' rule='greaterOrEqual'/>")
    );
    let vehicle = "<ScenarioObject name='T'><Vehicle vehicleCategory='car'><Performance maxSpeed='40' maxAcceleration='3' maxDeceleration='9'/></Vehicle></ScenarioObject>";
    let text = small("", vehicle, ["50", "15"])
        .replace("<CatalogLocations>", "<VariableDeclarations><VariableDeclaration name='v' variableType='integer' value='1'/></VariableDeclarations><CatalogLocations>")
        .replace("</Storyboard>", &format!("{story}</Storyboard>"))
        .replace("</RoadNetwork>", &format!("{SIGNALS}</RoadNetwork>"));
    assert!(text.contains(SIGNALS));
    decode(text.as_bytes(), catalog).unwrap()
}

/// Two controllers; the second one begins 3 s after the first.
const SIGNALS: &str = "<TrafficSignals><TrafficSignalController name='c' delay='2'>\
    <Phase name='go' duration='6'><TrafficSignalState trafficSignalId='7' state='green'/></Phase>\
    <Phase name='clear' duration='1'><TrafficSignalState trafficSignalId='8' state='red'/></Phase>\
    <Phase name='stop' duration='3'><TrafficSignalState trafficSignalId='7' state='red'/></Phase>\
    </TrafficSignalController><TrafficSignalController name='after' delay='3' reference='c'>\
    <Phase name='x' duration='5'><TrafficSignalState trafficSignalId='9' state='red'/></Phase>\
    </TrafficSignalController></TrafficSignals>";

#[test]
fn signals_keep_their_color_in_phases_that_do_not_tell_it() {
    let read = each_kind();
    let phases = |signal: usize| -> Vec<(LightColor, f64)> {
        let phases = read.signals[signal].phases.iter();
        phases
            .map(|phase| (phase.color, phase.duration_s))
            .collect()
    };
    use LightColor::{Green, Red};
    assert_eq!(phases(0), [(Green, 6.0), (Green, 1.0), (Red, 3.0)]);
    assert_eq!(phases(1), [(Red, 6.0), (Red, 1.0), (Red, 3.0)]);
    let offsets: Vec<f64> = read.signals.iter().map(|signal| signal.offset_s).collect();
    assert_eq!(offsets, [-2.0, -2.0, -5.0]);
    let [first, second] = read.controllers.as_slice() else {
        panic!("{:?}", read.controllers);
    };
    assert_eq!((&*first.name, first.offset_s), ("c", -2.0));
    assert_eq!(first.signals, ["7", "8"]);
    assert_eq!((second.offset_s, &second.phases[0].1), (-5.0, &5.0));
    assert!(read.names_controllers());
    assert_eq!(read.named_signals().into_iter().collect::<Vec<_>>(), ["7"]);
}

#[test]
fn light_and_air_at_the_start_are_read() {
    let environment = |inner: &str| {
        let action = format!(
            "<GlobalAction><EnvironmentAction><Environment name='e'>{inner}</Environment></EnvironmentAction></GlobalAction>"
        );
        read(&SCENARIO.replace(
            "<GlobalAction><EnvironmentAction name=\"rain\"/></GlobalAction>",
            &action,
        ))
    };
    let read = environment(
        "<TimeOfDay animation='false' dateTime='2020-10-01T18:30:00'/><Weather cloudState='overcast'><Sun intensity='1' azimuth='0' elevation='0.3'/><Fog visualRange='150'/><Precipitation precipitationType='rain' intensity='0.4'/></Weather><RoadCondition frictionScaleFactor='0.5'/>",
    );
    let expected = Environment {
        hour: Some(18.5),
        sun_rad: Some(0.3),
        clouds: Some(1.0),
        visibility_m: Some(150.0),
    };
    assert_eq!(read.environment, Some(expected));
    let skipped = read.skipped.join("\n");
    for reason in ["<Precipitation>: rain", "<RoadCondition>: all roads"] {
        assert!(skipped.contains(reason), "{skipped}");
    }
    let clear = environment(
        "<Weather fractionalCloudCover='twoOktas'><Fog visualRange='100000'/></Weather>",
    );
    let expected = Environment {
        clouds: Some(0.25),
        ..Environment::default()
    };
    assert_eq!(clear.environment, Some(expected));
    // A fault of the weather does not keep the file from being driven.
    let wrong = environment("<Weather><Fog visualRange='far'/></Weather>");
    assert_eq!(wrong.environment, None);
    assert!(
        wrong
            .skipped
            .iter()
            .any(|sentence| sentence.contains("<EnvironmentAction>"))
    );
}

#[test]
fn conditions_of_each_kind_are_read() {
    let read = each_kind();
    assert_eq!(read.variables, [("v".to_owned(), "1".to_owned())]);
    assert_eq!(read.entities[1].limits.acceleration_mps2, Some(3.0));
    assert_eq!(read.acts[0].stop.len(), 1);
    let of = vec!["T".to_owned()];
    let measured = |measure: Measure, rule: Rule, value: f64| When::Value {
        of: of.clone(),
        all: true,
        measure,
        rule,
        value,
    };
    let near = Measure::Near {
        with: vec![],
        ahead_m: 20.0,
        behind_m: 10.0,
        lanes: [-1, 1],
        between_boxes: true,
    };
    let gap = Measure::Distance {
        to: Target::Entity("Ego".into()),
        direction: Direction::AlongLanes,
        between_boxes: true,
    };
    let touched = Measure::Touched {
        with: vec!["Ego".into()],
    };
    let expected = [
        measured(Measure::AtEnd, Rule::GreaterOrEqual, 2.0),
        measured(Measure::OffRoad, Rule::GreaterOrEqual, 2.0),
        measured(near, Rule::Less, 1.0),
        measured(touched, Rule::GreaterOrEqual, 1.0),
        measured(gap, Rule::Less, 7.0),
        When::Variable {
            variable: "v".into(),
            rule: Rule::NotEqual,
            value: "3".into(),
        },
        When::Events {
            events: (0..11).collect(),
            state: State::Over,
        },
    ];
    for (number, when) in expected.iter().enumerate() {
        let found = condition(&read, number);
        assert_eq!(
            (&found.when, found.delay_s, found.edge),
            (when, 0.5, Edge::Falling)
        );
        let event = &read.events[number];
        assert_eq!((event.priority, event.executions), (Priority::Skip, 6));
    }
    assert_eq!(read.events[7].start, None);
    let green = When::Signal {
        signal: "7".into(),
        color: LightColor::Green,
    };
    let goes = When::Phase {
        controller: "c".into(),
        phase: "go".into(),
    };
    let found = [8, 9].map(|number| condition(&read, number).when.clone());
    assert_eq!(found, [green, goes]);
    assert_eq!(read.events[10].start, None, "there is no such controller");
}

#[test]
fn actions_of_each_kind_are_read() {
    let read = each_kind();
    let lost: Vec<usize> = read.events.iter().map(|event| event.lost).collect();
    assert_eq!(lost, [0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1]);
    let tasks = |number: usize| -> Vec<(&str, &Action)> {
        let tasks = read.events[number].tasks.iter();
        tasks
            .map(|task| (task.actor.as_str(), &task.action))
            .collect()
    };
    let (shape, extent) = (Shape::Cubic, Extent::DistanceM(9.0));
    let slower = TargetSpeed::Relative {
        entity: "Ego".into(),
        factor: 1.0,
        plus_mps: -2.0,
        continuous: true,
    };
    let dynamics = Dynamics { shape, extent };
    assert_eq!(
        tasks(0),
        [(
            "T",
            &Action::Speed {
                target: slower,
                dynamics
            }
        )]
    );
    assert_eq!(tasks(1), [("T", &Action::Show(false))]);
    assert_eq!(tasks(2), [("T", &Action::Show(false))]);
    assert_eq!(tasks(3), [("T", &Action::Unseen)]);
    assert!(
        matches!(tasks(4)[..], [("", Action::Set { .. })]),
        "{:?}",
        tasks(4)
    );
    let (shape, extent) = (Shape::Sinusoidal, Extent::LateralMps2(2.0));
    let aside = Action::Offset {
        offset_m: 0.4,
        from: None,
        dynamics: Dynamics { shape, extent },
        continuous: false,
    };
    assert_eq!(tasks(5), [("T", &aside)]);
    let red = Action::Signal {
        signal: "7".into(),
        color: LightColor::Red,
    };
    let stop = Action::Phase {
        controller: "c".into(),
        phase: "stop".into(),
    };
    assert_eq!([tasks(8), tasks(9)], [[("", &red)], [("", &stop)]]);
}
