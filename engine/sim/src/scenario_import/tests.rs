//! Scenarios on a straight road of 400 m with one lane to the west and two to the east.

use std::path::PathBuf;

use decouplegs_scene::story::{
    Condition, Direction, Edge, End, Measure, Rule, Spot, State, Trigger, When,
};

use super::*;

pub(super) const ROAD: &str = "<OpenDRIVE><road id='1' length='400' junction='-1'>
    <planView><geometry s='0' x='0' y='0' hdg='0' length='400'><line/></geometry></planView>
    <lanes><laneSection s='0'><left><lane id='1' type='driving'><width sOffset='0' a='3.5'/></lane></left>
    <right><lane id='-1' type='driving'><width sOffset='0' a='3.5'/></lane>
    <lane id='-2' type='driving'><width sOffset='0' a='3.5'/></lane></right></laneSection></lanes></road></OpenDRIVE>";

const BOX: &str = "<BoundingBox><Center x='1.4' y='0' z='0.75'/><Dimensions width='1.8' length='4.4' height='1.5'/></BoundingBox>";
pub(super) const AT_50: &str = "<LanePosition roadId='1' laneId='-1' s='50'/>";

pub(super) fn vehicle(name: &str, more: &str) -> String {
    format!(
        "<ScenarioObject name='{name}'><Vehicle vehicleCategory='car'>{BOX}{more}</Vehicle></ScenarioObject>"
    )
}

pub(super) fn teleport(place: &str) -> String {
    format!(
        "<PrivateAction><TeleportAction><Position>{place}</Position></TeleportAction></PrivateAction>"
    )
}

pub(super) fn speed(value: &str) -> String {
    format!(
        "<PrivateAction><LongitudinalAction><SpeedAction><SpeedActionTarget><AbsoluteTargetSpeed value='{value}'/></SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>"
    )
}

pub(super) fn init(name: &str, actions: &str) -> String {
    format!("<Private entityRef='{name}'>{actions}</Private>")
}

/// A file with these entities, actions at the start and stories.
pub(super) fn file(entities: &str, actions: &str, stories: &str) -> String {
    format!(
        "<OpenSCENARIO><FileHeader revMajor='1' revMinor='2'/>
        <ParameterDeclarations><ParameterDeclaration name='V' parameterType='double' value='54'/></ParameterDeclarations>
        <CatalogLocations><MiscObjectCatalog><Directory path='.'/></MiscObjectCatalog></CatalogLocations>
        <RoadNetwork><LogicFile filepath='m.xodr'/></RoadNetwork><Entities>{entities}</Entities>
        <Storyboard><Init><Actions>{actions}</Actions></Init>{stories}
        <StopTrigger><ConditionGroup><Condition delay='0'><ByValueCondition><SimulationTimeCondition value='4' rule='greaterThan'/></ByValueCondition></Condition></ConditionGroup></StopTrigger></Storyboard></OpenSCENARIO>"
    )
}

/// The scenario of a file whose map is `road`.
pub(super) fn import_on(text: &str, road: &str) -> ImportedScenario {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.xosc");
    std::fs::write(&path, text).unwrap();
    std::fs::write(folder.path().join("m.xodr"), road).unwrap();
    import_open_scenario(&path, None).unwrap()
}

fn try_import(text: &str, with_map: bool) -> Result<ImportedScenario, AssetError> {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| -> PathBuf { folder.path().join(name) };
    std::fs::write(path("a.xosc"), text).unwrap();
    std::fs::write(path("other.xodr"), ROAD).unwrap();
    std::fs::write(
        path("cones.xosc"),
        "<OpenSCENARIO><Catalog name='cones'><MiscObject name='cone' miscObjectCategory='obstacle'><BoundingBox><Center x='0' y='0' z='0'/><Dimensions width='0.3' length='0.4' height='0.5'/></BoundingBox></MiscObject></Catalog></OpenSCENARIO>",
    )
    .unwrap();
    if with_map {
        std::fs::write(path("m.xodr"), ROAD).unwrap();
        return import_open_scenario(&path("a.xosc"), None);
    }
    import_open_scenario(&path("a.xosc"), Some(&path("other.xodr")))
}

pub(super) fn import(text: &str) -> ImportedScenario {
    try_import(text, true).unwrap()
}

/// Lane and place of the ego that is put to `places`, one after the other.
fn ego_at(places: &[&str]) -> (String, f64) {
    let teleports: String = places.iter().map(|place| teleport(place)).collect();
    let text = file(
        &vehicle("Ego", ""),
        &init("Ego", &(teleports + &speed("15"))),
        "",
    );
    let task = import(&text).scenario.ego;
    (task.route[0].clone(), (task.start_m * 1e6).round() / 1e6)
}

/// Lane and place of a vehicle at `place`, beside an ego at s = 50 of lane -1.
fn other_at(place: &str) -> Result<(String, f64), String> {
    let entities = vehicle("Ego", "") + &vehicle("T", "");
    let actions = init("Ego", &(teleport(AT_50) + &speed("15"))) + &init("T", &teleport(place));
    let read = import(&file(&entities, &actions, ""));
    match read.scenario.story.actors.first() {
        Some(actor) => Ok(middle_of(actor)),
        None => Err(read.skipped.join("\n")),
    }
}

/// Lane of an actor, and the place of the middle of its box along it.
fn middle_of(actor: &Actor) -> (String, f64) {
    let lane = actor.lane.clone().unwrap();
    let middle_x_m = actor.point_m[0] + actor.center_m * actor.heading_rad.cos();
    let is_west = lane == "1/0/1";
    let at_m = if is_west {
        400.0 - middle_x_m
    } else {
        middle_x_m
    };
    (lane, (at_m * 1e6).round() / 1e6)
}

#[test]
fn speeds_are_evaluated() {
    let text = file(
        &vehicle("Ego", "<Performance maxSpeed='${250/}'/>"),
        &init("Ego", &(teleport(AT_50) + &speed("${$V / 3.6}"))),
        "",
    );
    assert_eq!(import(&text).scenario.ego.speed_mps, 15.0);
}

#[test]
fn positions_are_those_of_the_class_model() {
    let at = |lane: &str, at_m: f64| (format!("1/0/{lane}"), at_m);
    assert_eq!(ego_at(&[AT_50]), at("-1", 51.4));
    // A turn where it stands, and a position that is not read, leave the first.
    let turn = "<RelativeRoadPosition entityRef='Ego' ds='0' dt='0'><Orientation type='relative' h='0.1'/></RelativeRoadPosition>";
    assert_eq!(ego_at(&[AT_50, turn]), at("-1", 51.4));
    assert_eq!(ego_at(&[AT_50, "<UnknownPosition/>"]), at("-1", 51.4));
    assert_eq!(
        ego_at(&[
            AT_50,
            "<RelativeRoadPosition entityRef='Ego' ds='10' dt='-3.5'/>"
        ]),
        at("-2", 61.4)
    );
    let route = "<RoutePosition><RouteRef><Route name='r' closed='false'>
        <Waypoint routeStrategy='shortest'><Position><LanePosition roadId='1' laneId='-1' s='20'/></Position></Waypoint>
        <Waypoint routeStrategy='shortest'><Position><LanePosition roadId='1' laneId='-1' s='300'/></Position></Waypoint>
        </Route></RouteRef><InRoutePosition>PLACE</InRoutePosition></RoutePosition>";
    for (place, expected) in [
        (
            "<FromLaneCoordinates pathS='30' laneId='-1'/>",
            at("-1", 51.4),
        ),
        (
            "<FromLaneCoordinates pathS='30' laneId='-2' laneOffset='0.5'/>",
            at("-2", 51.4),
        ),
        (
            "<FromRoadCoordinates pathS='30' t='-5.25'/>",
            at("-2", 51.4),
        ),
    ] {
        assert_eq!(
            ego_at(&[&route.replace("PLACE", place)]),
            expected,
            "{place}"
        );
    }
    let trajectory = "<TrajectoryPosition s='40'><TrajectoryRef><Trajectory name='t' closed='false'><Shape><Polyline>
        <Vertex time='0'><Position><WorldPosition x='10' y='-1.75'/></Position></Vertex>
        <Vertex time='1'><Position><WorldPosition x='90' y='-1.75'/></Position></Vertex></Polyline></Shape></Trajectory></TrajectoryRef></TrajectoryPosition>";
    assert_eq!(ego_at(&[trajectory]), at("-1", 51.4));

    for (place, expected) in [
        (
            "<RelativeObjectPosition entityRef='Ego' dx='30' dy='-3.5'/>",
            at("-2", 81.4),
        ),
        (
            "<RelativeWorldPosition entityRef='Ego' dx='50' dy='0'/>",
            at("-1", 101.4),
        ),
        (
            "<RelativeRoadPosition entityRef='Ego' ds='40' dt='-3.5'/>",
            at("-2", 91.4),
        ),
        (
            "<RelativeLanePosition entityRef='Ego' dLane='-1' ds='40'/>",
            at("-2", 91.4),
        ),
        (
            "<RelativeLanePosition entityRef='Ego' dLane='0' dsLane='40' offset='0.3'/>",
            at("-1", 91.4),
        ),
        // Lane 0 is not counted; traffic on lane 1 runs to the west, from s = 400.
        (
            "<RelativeLanePosition entityRef='Ego' dLane='1' ds='40'/>",
            at("1", 311.4),
        ),
        (
            "<RoadPosition roadId='1' s='100' t='-5.25'/>",
            at("-2", 101.4),
        ),
        // So far beside its lane it is on another.
        (
            "<LanePosition roadId='1' laneId='-1' s='100' offset='-3.5'/>",
            at("-2", 101.4),
        ),
        // Beside all lanes it follows its own.
        (
            "<LanePosition roadId='1' laneId='-1' s='100' offset='9'/>",
            at("-1", 101.4),
        ),
    ] {
        assert_eq!(other_at(place), Ok(expected), "{place}");
    }
    for (place, reason) in [
        (
            "<LanePosition roadId='1' laneId='-7' s='100'/>",
            "road 1 has no lane -7 at 100 m, only -2, -1, 1",
        ),
        (
            "<LanePosition roadId='8' laneId='-1' s='100'/>",
            "no road 8",
        ),
        (
            "<RelativeObjectPosition entityRef='nobody' dx='1' dy='0'/>",
            "no entity nobody",
        ),
        (
            "<GeoPosition latitudeDeg='1' longitudeDeg='1'/>",
            "latitude and longitude",
        ),
    ] {
        let message = other_at(place).unwrap_err();
        assert!(message.contains(reason), "{place}: {message}");
    }
    // On lanes to the west, ds of the road is behind, and left of the lane is right of the road.
    let west = |place: &str| {
        let entities = vehicle("Ego", "") + &vehicle("T", "");
        let start = "<LanePosition roadId='1' laneId='1' s='200'/>";
        let actions = init("Ego", &teleport(start)) + &init("T", &teleport(place));
        middle_of(&import(&file(&entities, &actions, "")).scenario.story.actors[0])
    };
    assert_eq!(
        west("<RelativeLanePosition entityRef='Ego' dLane='0' ds='40'/>"),
        at("1", 161.4)
    );
    assert_eq!(
        west("<RelativeLanePosition entityRef='Ego' dLane='0' dsLane='40'/>"),
        at("1", 241.4)
    );
    assert_eq!(
        west("<RelativeLanePosition entityRef='Ego' dLane='-1' ds='40'/>"),
        at("-1", 241.4)
    );
}

#[test]
fn waypoints_behind_the_ego_are_reached() {
    let waypoint = |s: u32| {
        format!(
            "<Waypoint routeStrategy='shortest'><Position><LanePosition roadId='1' laneId='-1' s='{s}'/></Position></Waypoint>"
        )
    };
    let end_of = |waypoints: &[u32]| {
        let waypoints: String = waypoints.iter().map(|s| waypoint(*s)).collect();
        let route = format!(
            "<PrivateAction><RoutingAction><AssignRouteAction><Route name='r' closed='false'>{waypoints}</Route></AssignRouteAction></RoutingAction></PrivateAction>"
        );
        let actions = init("Ego", &(teleport(AT_50) + &speed("15") + &route));
        try_import(&file(&vehicle("Ego", ""), &actions, ""), true)
            .map(|read| read.scenario.ego.end_m)
    };
    assert_eq!(end_of(&[60, 300]).unwrap(), 300.0);
    assert_eq!(end_of(&[50, 300]).unwrap(), 300.0);
    assert_eq!(end_of(&[10, 40, 300]).unwrap(), 300.0);
    // Behind it alone: straight on, for the time of the file.
    assert!((end_of(&[10]).unwrap() - (51.4 + 15.0 * 4.0)).abs() < 1e-6);
    let message = end_of(&[300, 100]).unwrap_err();
    let message = std::error::Error::source(&message).unwrap().to_string();
    assert!(message.contains("no way leads"), "{message}");
}

#[test]
fn events_wait_for_times_and_for_each_other() {
    let dynamics =
        "<SpeedActionDynamics dynamicsShape='linear' dynamicsDimension='time' value='2'/>";
    let action = speed("5").replace("<SpeedAction>", &format!("<SpeedAction>{dynamics}"));
    let at = |rule: &str, value: f64, delay: f64| {
        format!(
            "<Condition delay='{delay}'><ByValueCondition><SimulationTimeCondition value='{value}' rule='{rule}'/></ByValueCondition></Condition>"
        )
    };
    let after = |name: &str, state: &str, delay: f64| {
        format!(
            "<Condition delay='{delay}'><ByValueCondition><StoryboardElementStateCondition storyboardElementType='event' storyboardElementRef='{name}' state='{state}'/></ByValueCondition></Condition>"
        )
    };
    let event = |name: &str, groups: &[String]| {
        let groups: String = groups
            .iter()
            .map(|group| format!("<ConditionGroup>{group}</ConditionGroup>"))
            .collect();
        format!(
            "<Event name='{name}' priority='overwrite'><Action name='x'>{action}</Action><StartTrigger>{groups}</StartTrigger></Event>"
        )
    };
    let events = event("first", &[after("second", "completeState", 1.0)])
        + &event("second", &[at("greaterThan", 3.0, 0.5)])
        + &event(
            "either",
            &[
                at("greaterThan", 9.0, 0.0),
                after("m::second", "startTransition", 0.0) + &at("greaterThan", 5.0, 0.0),
            ],
        )
        + &event("never", &[after("never", "endTransition", 0.0)])
        + &event("gone", &[after("nobody", "endTransition", 0.0)]);
    let story = format!(
        "<Story name='s'><Act name='a'><ManeuverGroup maximumExecutionCount='1' name='g'><Actors selectTriggeringEntities='false'><EntityRef entityRef='T'/></Actors><Maneuver name='m'>{events}</Maneuver></ManeuverGroup><StartTrigger><ConditionGroup>{}</ConditionGroup></StartTrigger></Act></Story>",
        at("greaterThan", 1.0, 0.0)
    );
    let entities = vehicle("Ego", "") + &vehicle("T", "");
    let place = "<LanePosition roadId='1' laneId='-1' s='100'/>";
    let actions = init("Ego", &teleport(AT_50)) + &init("T", &(teleport(place) + &speed("10")));
    let read = import(&file(&entities, &actions, &story));
    let story = &read.scenario.story;
    let condition = |delay_s: f64, when: When| Condition {
        edge: Edge::None,
        delay_s,
        when,
    };
    let time = |value_s: f64| When::Time {
        rule: Rule::Greater,
        value_s,
    };
    // The first event is that of the start.
    let second = |state: State| When::Events {
        events: vec![2],
        state,
    };
    let begins: Vec<&Trigger> = story.events.iter().map(|event| &event.start).collect();
    assert_eq!(begins[0], &Trigger::new());
    assert_eq!(begins[1], &vec![vec![condition(1.0, second(State::Over))]]);
    assert_eq!(begins[2], &vec![vec![condition(0.5, time(3.0))]]);
    let both = vec![
        condition(0.0, second(State::Begun)),
        condition(0.0, time(5.0)),
    ];
    assert_eq!(begins[3], &vec![vec![condition(0.0, time(9.0))], both]);
    let never = When::Always { holds: false };
    assert_eq!(begins[5], &vec![vec![condition(0.0, never)]]);
    assert_eq!(story.acts[0].start, vec![vec![condition(0.0, time(1.0))]]);
    assert_eq!((read.events, read.events_driven), (5, 4));
    assert!(
        read.skipped
            .iter()
            .any(|sentence| sentence.contains("event nobody"))
    );
}

#[test]
fn the_ego_the_map_and_objects_are_found() {
    let property = "<Properties><Property name='type' value='ego_vehicle'/></Properties>";
    let cone = "<ScenarioObject name='Cone'><CatalogReference catalogName='cones' entryName='cone'/></ScenarioObject>";
    let entities = vehicle("Target", "") + &vehicle("Mine", property) + cone;
    let place = |s: u32| format!("<LanePosition roadId='1' laneId='-1' s='{s}'/>");
    let actions = init("Target", &teleport(&place(120)))
        + &init("Mine", &(teleport(AT_50) + &speed("15")))
        + &init(
            "Cone",
            &teleport("<RoadPosition roadId='1' s='90' t='-3.5'/>"),
        );
    let event = |name: &str, action: &str, measure: &str| {
        format!(
            "<Event name='{name}' priority='overwrite'><Action name='x'>{action}</Action><StartTrigger><ConditionGroup><Condition delay='0'>{measure}</Condition></ConditionGroup></StartTrigger></Event>"
        )
    };
    let slower = speed("5");
    let at_time = "<ByValueCondition><SimulationTimeCondition value='1' rule='greaterThan'/></ByValueCondition>";
    let events = event("a", &slower, at_time)
        + &event("b", "<GlobalAction/>", at_time)
        + &event("c", &slower.replace("'5'", "'$none'"), at_time);
    let story = format!(
        "<Story name='s'><Act name='a'><ManeuverGroup maximumExecutionCount='1' name='g'><Actors selectTriggeringEntities='false'><EntityRef entityRef='Target'/></Actors><Maneuver name='m'>{events}</Maneuver></ManeuverGroup><StartTrigger/></Act></Story>"
    );
    let text = file(&entities, &actions, &story);
    let read = import(&text);
    assert_eq!(
        (
            read.ego.as_str(),
            read.scenario.story.actors[0].name.as_str()
        ),
        ("Mine", "Target")
    );
    // An event at fault is lost and listed; the others are driven.
    assert_eq!((read.events, read.events_driven), (3, 1));
    assert!(
        read.skipped
            .iter()
            .any(|sentence| sentence.contains("$none is not declared"))
    );
    let [cone] = read.obstacles.as_slice() else {
        panic!("{:?}", read.obstacles);
    };
    assert_eq!(
        (cone.center_m, cone.length_m, cone.width_m),
        (DVec2::new(90.0, -3.5), 0.4, 0.3)
    );

    // Another map, where the file names none or one that is not there.
    for text in [
        text.clone(),
        text.replace("<LogicFile filepath='m.xodr'/>", ""),
    ] {
        assert_eq!(
            try_import(&text, false).unwrap().scenario.ego.route,
            ["1/0/-1"]
        );
    }
    let nameless = text.replace("<LogicFile filepath='m.xodr'/>", "");
    for (text, reason) in [
        (nameless, "--map"),
        (text.replace("m.xodr", "Town01"), "--map"),
    ] {
        let error = try_import(&text, true).unwrap_err();
        let message = format!("{error:?}");
        assert!(message.contains(reason), "{message}");
    }
}

/// Condition of an event of T, about U, beside the ego and a cone.
fn condition_of(condition: &str) -> Option<When> {
    let condition = format!(
        "<ByEntityCondition><TriggeringEntities triggeringEntitiesRule='any'><EntityRef entityRef='U'/></TriggeringEntities><EntityCondition>{condition}</EntityCondition></ByEntityCondition>"
    );
    let story = format!(
        "<Story name='s'><Act name='a'><ManeuverGroup maximumExecutionCount='1' name='g'><Actors selectTriggeringEntities='false'><EntityRef entityRef='T'/></Actors><Maneuver name='m'><Event name='e' priority='overwrite'><Action name='x'>{}</Action><StartTrigger><ConditionGroup><Condition delay='0'>{condition}</Condition></ConditionGroup></StartTrigger></Event></Maneuver></ManeuverGroup></Act></Story>",
        speed("9"),
    );
    let cone = "<ScenarioObject name='Cone'><CatalogReference catalogName='cones' entryName='cone'/></ScenarioObject>";
    let entities = vehicle("Ego", "") + cone + &vehicle("T", "") + &vehicle("U", "");
    let place = |s: u32| format!("<LanePosition roadId='1' laneId='-1' s='{s}'/>");
    let actions = init("Ego", &teleport(AT_50))
        + &init("Cone", &teleport(&place(300)))
        + &init("T", &teleport(&place(100)))
        + &init("U", &teleport(&place(150)));
    let read = import(&file(&entities, &actions, &story));
    let start = read.scenario.story.events[1].start.clone();
    let is_driven = read.events_driven == 1;
    let when = start[0][0].when.clone();
    assert_eq!(is_driven, when != When::Always { holds: false });
    is_driven.then_some(when)
}

#[test]
fn conditions_are_about_any_entity_and_about_places() {
    let distance = |to: End| Measure::Distance {
        to,
        direction: Direction::Straight,
        between_boxes: false,
    };
    let less = "freespace='false' rule='lessThan' value='2'";
    let point = |at_m: [f64; 2]| {
        End::At(Spot::Point {
            at_m,
            heading_rad: Some(0.0),
        })
    };
    let beside = End::At(Spot::Lane {
        who: Who(1),
        lanes: -1,
        ahead_m: 30.0,
        on_road: true,
        left_m: Some(0.0),
    });
    let relative = |to: &str| format!("<RelativeDistanceCondition entityRef='{to}' {less}/>");
    let place = |inner: &str| {
        format!("<DistanceCondition {less}><Position>{inner}</Position></DistanceCondition>")
    };
    for (condition, to) in [
        (relative("Ego"), End::Who(Who::EGO)),
        (relative("T"), End::Who(Who(1))),
        // What never moves is a place.
        (relative("Cone"), point([300.0, -1.75])),
        (
            place("<WorldPosition x='80' y='-1.75'/>"),
            point([80.0, -1.75]),
        ),
        (
            place("<RelativeLanePosition entityRef='T' dLane='-1' ds='30'/>"),
            beside,
        ),
    ] {
        let expected = When::Value {
            of: vec![Who(2)],
            all: false,
            measure: distance(to),
            rule: Rule::Less,
            value: 2.0,
        };
        assert_eq!(condition_of(&condition), Some(expected), "{condition}");
    }
    // Entities that the file does not have are listed instead.
    assert_eq!(condition_of(&relative("nobody")), None);
}
