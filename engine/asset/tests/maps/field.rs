//! Maps as the field writes them: tags that are left out, limits that change
//! along a road, links that lead nowhere.

use decouplegs_asset::maps::{commonroad, lanelet2, open_drive};
use decouplegs_scene::{Lane, LaneKind, LaneMap, SignKind};

use super::{ids, lane};

/// A lanelet of 120 m with tags.
fn lanelet(tags: &[(&str, &str)]) -> Lane {
    let nodes: String = [(1, 0, 0.0), (2, 120, 0.0), (3, 0, 3.5), (4, 120, 3.5)]
        .map(|(id, x, y)| {
            format!(
                "<node id='{id}' lat='' lon=''><tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/></node>"
            )
        })
        .concat();
    let tags: String = tags
        .iter()
        .map(|(key, value)| format!("<tag k='{key}' v='{value}'/>"))
        .collect();
    let text = format!(
        "<osm>{nodes}<way id='11'><nd ref='1'/><nd ref='2'/></way><way id='12'><nd ref='3'/><nd ref='4'/></way>
        <relation id='21'><member type='way' role='left' ref='12'/><member type='way' role='right' ref='11'/>
        <tag k='type' v='lanelet'/>{tags}</relation></osm>"
    );
    let map = lanelet2::decode(text.as_bytes()).unwrap();
    lane(&map, "21").clone()
}

#[test]
fn lanelets_have_the_defaults_of_their_format() {
    let road = ("subtype", "road");
    for (tags, kind) in [
        (&[][..], LaneKind::Driving),
        (&[("location", "nonurban")], LaneKind::Driving),
        (&[("subtype", "walkway")], LaneKind::Walking),
        (&[("subtype", "emergency_lane")], LaneKind::Other),
        (&[("subtype", "parking")], LaneKind::Parking),
        // Who takes part is told by tags alone, once one tells it.
        (
            &[
                road,
                ("participant:vehicle", "no"),
                ("participant:pedestrian", "yes"),
            ],
            LaneKind::Walking,
        ),
        (&[road, ("participant:bicycle", "yes")], LaneKind::Bicycle),
        (&[road, ("participant:vehicle", "no")], LaneKind::Other),
        (
            &[("subtype", "walkway"), ("participant:vehicle:bus", "yes")],
            LaneKind::Driving,
        ),
        (
            &[road, ("participant:vehicle:emergency", "yes")],
            LaneKind::Other,
        ),
    ] {
        assert_eq!(lanelet(tags).kind, kind, "{tags:?}");
    }
    for (tags, limit_kmh) in [
        (&[("speed_limit", "40")][..], Some(40.0)),
        (&[("speed_limit", " 50 km/h")], Some(50.0)),
        (&[("speed_limit", "50kmph")], Some(50.0)),
        (&[("speed_limit", "10 mps")], Some(36.0)),
        (&[("speed_limit", "")], None),
        (&[("speed_limit", "none")], None),
        (&[("speed_limit", "fast")], None),
        (
            &[("speed_limit", "50"), ("speed_limit:vehicle", "30")],
            Some(30.0),
        ),
        (&[("speed_limit:bicycle", "20")], None),
    ] {
        let found = lanelet(tags)
            .speed_limit_mps
            .map(|limit_mps| (3.6 * limit_mps * 1e6).round() / 1e6);
        assert_eq!(found, limit_kmh, "{tags:?}");
    }
}

#[test]
fn roads_without_lanelets_and_prefixed_namespaces_are_told() {
    let plain = "<osm><node id='1' lat='48' lon='8'/><way id='2'><nd ref='1'/><tag k='highway' v='residential'/></way></osm>";
    let message = lanelet2::decode(plain.as_bytes()).unwrap_err().to_string();
    assert!(message.contains("plain OpenStreetMap"), "{message}");
    let prefixed = format!(
        "<od:OpenDRIVE xmlns:od='http://code.asam.net/x'><od:road id='1' length='9'><od:planView>
        <od:geometry s='0' x='0' y='0' hdg='0' length='9'><od:line/></od:geometry></od:planView><od:lanes>{}</od:lanes></od:road></od:OpenDRIVE>",
        section(0.0, "", &[(-1, "")]).replace("</", "</od:").replace('<', "<od:").replace("<od:/od:", "</od:")
    );
    assert_eq!(
        open_drive::decode(prefixed.as_bytes()).unwrap().lanes.len(),
        1
    );
}

#[test]
fn signs_of_commonroad_limit_speeds_in_any_unit() {
    let sign = |sign: &str, value: &str| {
        let bound = |name: &str, y: f64| {
            format!(
                "<{name}><point><x>0</x><y>{y}</y></point><point><x>50</x><y>{y}</y></point></{name}>"
            )
        };
        let text = format!(
            "<commonRoad commonRoadVersion='2020a'><lanelet id='1'>{}{}<trafficSignRef ref='9'/></lanelet>
            <trafficSign id='9'><trafficSignElement><trafficSignID>{sign}</trafficSignID>
            <additionalValue>{value}</additionalValue></trafficSignElement></trafficSign></commonRoad>",
            bound("leftBound", 3.5),
            bound("rightBound", 0.0)
        );
        commonroad::decode(text.as_bytes()).unwrap()
    };
    let limit = |id: &str, value: &str| sign(id, value).lanes[0].speed_limit_mps;
    assert_eq!(limit("274", "13.9"), Some(13.9));
    assert_eq!(limit("274", "50kmh"), Some(50.0 / 3.6));
    assert_eq!(limit("274.1", "8.33"), Some(8.33));
    assert_eq!(limit("B14", "13.9"), Some(13.9));
    assert_eq!(limit("274", "often"), None);
    assert_eq!(limit("306", "13.9"), None);
    assert_eq!(sign("206", "").signs[0].kind, SignKind::Stop);
    let yields = &sign("R1-2", "").signs;
    assert_eq!(
        (
            yields[0].kind,
            yields[0].line.lane.as_str(),
            yields[0].line.at_m
        ),
        (SignKind::Yield, "1", 50.0)
    );
    assert!(sign("274", "13.9").signs.is_empty());
}

/// Roads of one lane section each, as `(id, x, y, length, attributes and links, section)`.
fn open_drive_map(roads: &[(u32, [f64; 3], &str, &str)], junction: &str) -> LaneMap {
    let roads: String = roads
        .iter()
        .map(|(id, [x, y, length], links, sections)| {
            format!(
                "<road id='{id}' length='{length}' junction='-1'>{links}
                <planView><geometry s='0' x='{x}' y='{y}' hdg='0' length='{length}'><line/></geometry></planView>
                <lanes>{sections}</lanes></road>"
            )
        })
        .collect();
    open_drive::decode(format!("<OpenDRIVE>{roads}{junction}</OpenDRIVE>").as_bytes()).unwrap()
}

/// A lane section from `s` on with lanes given by id and content.
fn section(s: f64, attributes: &str, lanes: &[(i64, &str)]) -> String {
    let side = |name: &str, keep: fn(i64) -> bool| {
        let lanes: String = lanes
            .iter()
            .filter(|(id, _)| keep(*id))
            .map(|(id, content)| {
                format!(
                    "<lane id='{id}' type='driving'>{content}<width sOffset='0' a='3.5'/></lane>"
                )
            })
            .collect();
        if lanes.is_empty() {
            lanes
        } else {
            format!("<{name}>{lanes}</{name}>")
        }
    };
    format!(
        "<laneSection s='{s}' {attributes}>{}{}</laneSection>",
        side("left", |id| id > 0),
        side("right", |id| id < 0)
    )
}

fn limits(map: &LaneMap) -> Vec<(&str, Option<f64>)> {
    map.lanes
        .iter()
        .map(|lane| (lane.id.as_str(), lane.speed_limit_mps))
        .collect()
}

#[test]
fn a_section_is_divided_where_a_limit_changes() {
    let types = "<type s='0' type='town'><speed max='50' unit='km/h'/></type><type s='60' type='rural'><speed max='100' unit='kmh'/></type>";
    let next = section(80.0, "", &[(-1, "<link><predecessor id='-1'/></link>")]);
    let first = section(0.0, "", &[(-1, "<link><successor id='-1'/></link>")]);
    let map = open_drive_map(&[(1, [0.0, 0.0, 100.0], types, &(first + &next))], "");
    let (town, rural) = (Some(50.0 / 3.6), Some(100.0 / 3.6));
    // Ids of other sections stay.
    assert_eq!(
        limits(&map),
        [("1/0/-1", town), ("1/0.1/-1", rural), ("1/1/-1", rural)]
    );
    assert_eq!(ids(&map, &lane(&map, "1/0/-1").successors), ["1/0.1/-1"]);
    assert_eq!(ids(&map, &lane(&map, "1/0.1/-1").successors), ["1/1/-1"]);
    assert!((lane(&map, "1/0.1/-1").centerline[0].x - 60.0).abs() < 1e-9);
    let of_lane = |speeds: &str| {
        let map = open_drive_map(
            &[(1, [0.0, 0.0, 100.0], "", &section(0.0, "", &[(-1, speeds)]))],
            "",
        );
        map.lanes
            .iter()
            .map(|lane| lane.speed_limit_mps)
            .collect::<Vec<_>>()
    };
    let speeds = "<speed sOffset='0' max='13.9'/><speed sOffset='50' max='8.33'/>";
    assert_eq!(of_lane(speeds), [Some(13.9), Some(8.33)]);
    assert_eq!(
        of_lane("<speed sOffset='50' max='8.33'/>"),
        [None, Some(8.33)]
    );
    assert_eq!(
        of_lane("<speed sOffset='0' max='9' unit='furlongs'/>"),
        [None]
    );
    assert_eq!(
        of_lane("<speed max='13.9'/><speed sOffset='40' max='13.9'/>"),
        [Some(13.9)]
    );
}

#[test]
fn a_section_of_one_side_leaves_the_other() {
    let both = section(0.0, "", &[(1, ""), (-1, "")]);
    let right = section(
        50.0,
        "singleSide='true'",
        &[(-1, "<link><predecessor id='-1'/></link>"), (-2, "")],
    );
    let map = open_drive_map(&[(1, [0.0, 0.0, 100.0], "", &(both + &right))], "");
    let names: Vec<&str> = map.lanes.iter().map(|lane| lane.id.as_str()).collect();
    assert_eq!(names, ["1/0/1", "1/0/-1", "1/1/1", "1/1/-1", "1/1/-2"]);
    // The left lane runs against the road.
    assert_eq!(ids(&map, &lane(&map, "1/1/1").successors), ["1/0/1"]);
    assert_eq!(ids(&map, &lane(&map, "1/0/-1").successors), ["1/1/-1"]);
}

#[test]
fn links_are_believed_where_lanes_meet() {
    let successor =
        "<link><successor elementType='road' elementId='2' contactPoint='start'/></link>";
    let swapped = successor.replace("'start'", "'end'");
    let out = section(0.0, "", &[(-1, "<link><successor id='-1'/></link>")]);
    let plain = section(0.0, "", &[(-1, "")]);
    let joined = |links: &str, x: f64, y: f64| {
        let roads = [
            (1, [0.0, 0.0, 40.0], links, &*out),
            (2, [x, y, 60.0], "", &*plain),
        ];
        let map = open_drive_map(&roads, "");
        ids(&map, &lane(&map, "1/0/-1").successors)
    };
    assert_eq!(joined(successor, 40.0, 0.0), ["2/0/-1"]);
    assert_eq!(joined(successor, 41.5, 0.5), ["2/0/-1"]);
    assert!(joined(successor, 120.0, 30.0).is_empty());
    // The wrong end of the right road.
    assert_eq!(joined(&swapped, 40.0, 0.0), ["2/0/-1"]);

    // A junction that its incoming road does not name, and whose contact is the wrong one.
    for contact in ["start", "end"] {
        let junction = format!(
            "<junction id='9'><connection id='0' incomingRoad='1' connectingRoad='3' contactPoint='{contact}'>
            <laneLink from='-1' to='-1'/></connection></junction>"
        );
        let roads = [
            (1, [0.0, 0.0, 50.0], "", &*plain),
            (3, [50.0, 0.0, 30.0], "", &*plain),
        ];
        let map = open_drive_map(&roads, &junction);
        assert_eq!(
            ids(&map, &lane(&map, "1/0/-1").successors),
            ["3/0/-1"],
            "{contact}"
        );
    }

    // A lane with two lanes before it.
    let two = section(0.0, "", &[(-1, ""), (-2, "")]);
    let one = section(
        50.0,
        "",
        &[(
            -1,
            "<link><predecessor id='-1'/><predecessor id='-2'/></link>",
        )],
    );
    let map = open_drive_map(&[(1, [0.0, 0.0, 100.0], "", &(two + &one))], "");
    assert_eq!(
        ids(&map, &lane(&map, "1/1/-1").predecessors),
        ["1/0/-1", "1/0/-2"]
    );
}
