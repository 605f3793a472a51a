//! Each format by a small file whose lanes and tracks are known; the files also seed the fuzz
//! targets.

use decouplegs_asset::maps::{argoverse2, commonroad, lane_json, lanelet2, open_drive};
use decouplegs_asset::{read_map, tracks};
use decouplegs_scene::{Lane, LaneKind, LaneMap, LightColor, SignKind};
use glam::{DVec2, DVec3};

use super::{ids, lane, seed};

#[test]
fn lanelets_are_turned_joined_and_projected() {
    let map = lanelet2::decode(&seed("lanelet2/two.osm")).unwrap();
    // The stop line lies 3.7 m before the end of the first lanelet, and before the second.
    let lines = &map.lights[0].stop_lines;
    let length_m = decouplegs_asset::maps::length_m(&lane(&map, "21").centerline);
    assert!(map.lights.len() == 1 && map.lights[0].phases.is_empty());
    assert_eq!(
        (lines[0].lane.as_str(), lines[1].lane.as_str()),
        ("21", "22")
    );
    assert!((lines[0].at_m - 0.875 * length_m).abs() < 0.05, "{lines:?}");
    assert_eq!(lines[1].at_m, 0.0);
    // A stop sign at the same line, and a yield sign at the end of the second lanelet. The bicycle
    // lane has none.
    let signs: Vec<_> = map
        .signs
        .iter()
        .map(|sign| (sign.kind, &*sign.line.lane))
        .collect();
    assert_eq!(signs, [(SignKind::Stop, "21"), (SignKind::Yield, "22")]);
    assert_eq!(map.signs[0].line.at_m, lines[0].at_m);
    let length_m = decouplegs_asset::maps::length_m(&lane(&map, "22").centerline);
    assert!((map.signs[1].line.at_m - length_m).abs() < 0.05);
    assert_eq!(
        map.lanes
            .iter()
            .map(|lane| lane.id.as_str())
            .collect::<Vec<_>>(),
        ["21", "22", "23"]
    );
    let (first, second, bicycle) = (lane(&map, "21"), lane(&map, "22"), lane(&map, "23"));
    // Its right way is drawn the other way round.
    assert!(first.centerline[0].x < first.centerline[1].x && first.right[0].x < first.right[1].x);
    assert_eq!(ids(&map, &first.successors), ["22"]);
    assert_eq!(
        (first.right_neighbor, bicycle.left_neighbor),
        (Some(2), Some(0))
    );
    assert!(first.has_height && second.has_height && !bicycle.has_height);
    assert_eq!(
        (
            first.centerline[0].z,
            first.centerline[1].z,
            bicycle.left[0].z
        ),
        (110.0, 111.0, 0.0)
    );
    assert_eq!(
        (first.kind, bicycle.kind),
        (LaneKind::Driving, LaneKind::Bicycle)
    );
    assert_eq!(
        (first.speed_limit_mps, second.speed_limit_mps),
        (Some(50.0 / 3.6), None)
    );
    // 0.0004 degrees of longitude at 49 degrees north are 29.2 m, 0.00003 of latitude 3.3 m.
    assert!((first.left[0].distance(first.left[1]) - 29.2).abs() < 0.1);
    assert!((first.left[0].distance(first.right[0]) - 3.336).abs() < 0.01);

    let text = String::from_utf8(seed("lanelet2/two.osm")).unwrap();
    let local = |k: &str, v: u32| format!("<tag k='{k}' v='{v}'/>");
    let mut with_local = text.replace(
        "<node id=\"7\" lat=\"48.99994\" lon=\"8.4000\"/>",
        "<node id=\"7\" lat=\"\" lon=\"\"></node>",
    );
    with_local = with_local.replace(
        "<node id=\"8\" lat=\"48.99994\" lon=\"8.4004\"/>",
        "<node id=\"8\"></node>",
    );
    for (x, y, id) in [
        (0, 6, 1),
        (30, 6, 2),
        (60, 9, 3),
        (0, 3, 4),
        (30, 3, 5),
        (60, 6, 6),
        (0, 0, 7),
        (30, 0, 8),
    ] {
        let at = with_local.find(&format!("<node id=\"{id}\"")).unwrap();
        let end = at + with_local[at..].find("</node>").unwrap();
        with_local.insert_str(end, &(local("local_x", x) + &local("local_y", y)));
    }
    let map = lanelet2::decode(with_local.as_bytes()).unwrap();
    assert_eq!(lane(&map, "21").centerline[0], DVec3::new(0.0, 4.5, 110.0));
    for (from, to, part) in [
        (
            "<nd ref=\"4\"/>",
            "<nd ref=\"44\"/>",
            "node 44 is not in the file",
        ),
        (
            "ref=\"14\" role",
            "ref=\"41\" role",
            "way 41 is not in the file",
        ),
        (
            "relation id=\"22\"",
            "relation id=\"21\"",
            "two lanes have the id 21",
        ),
        ("role=\"left\"", "role=\"middle\"", "no way is its left"),
        (
            "lon=\"8.4008\"",
            "lon=\"98.4\"",
            "degrees from the middle of UTM zone 32",
        ),
        ("lat=\"49.0000\"", "lat=\"91\"", "UTM reaches"),
    ] {
        let error = lanelet2::decode(text.replace(from, to).as_bytes())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(part) && error.contains("line ") | error.contains("id 21"),
            "{from}: {error}"
        );
    }
}

#[test]
fn argoverse_segments_are_lanes() {
    let map = argoverse2::decode(&seed("argoverse2/log_map_archive_two.json")).unwrap();
    let (first, second, oncoming) = (lane(&map, "7"), lane(&map, "8"), lane(&map, "9"));
    // Shares of length are taken in space, where the right boundary, which bends, is a little
    // longer.
    let expected = [
        DVec3::new(0.0, 0.0, 10.0),
        DVec3::new(10.0, 0.0, 10.225),
        DVec3::new(20.0, 0.0, 10.5),
    ];
    assert!(
        first.centerline.len() == 3
            && first
                .centerline
                .iter()
                .zip(expected)
                .all(|(a, b)| a.distance(b) < 1e-3)
    );
    assert_eq!(second.centerline[1], DVec3::new(40.5, 3.0, 11.0));
    assert_eq!(
        (second.kind, oncoming.kind),
        (LaneKind::Bicycle, LaneKind::Driving)
    );
    // The lane 999 is not in the file, and 9 comes towards 7.
    assert_eq!(
        (
            ids(&map, &first.successors),
            ids(&map, &second.predecessors)
        ),
        (vec!["8".to_owned()], vec!["7".to_owned()])
    );
    assert!(first.left_neighbor.is_none() && oncoming.left_neighbor.is_none() && first.has_height);
    let text = String::from_utf8(seed("argoverse2/log_map_archive_two.json")).unwrap();
    for (from, to, part) in [
        ("\"id\": 9", "\"id\": 7", "two lanes have the id 7"),
        ("\"z\": 11}", "\"z\": 1e999}", "number out of range"),
        (
            "\"left_lane_boundary\": [{\"x\": 0",
            "\"left_boundary\": [{\"x\": 0",
            "left_lane_boundary",
        ),
        ("\"x\": 41", "\"x\": 4e55", "no place on Earth"),
    ] {
        let error = argoverse2::decode(text.replace(from, to).as_bytes())
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{from}: {error}");
    }
}

#[test]
fn a_scenario_of_2020_has_types_signs_and_areas() {
    let bytes = seed("commonroad/2020a.xml");
    let map = commonroad::decode(&bytes).unwrap();
    let (first, bicycle, left) = (lane(&map, "1"), lane(&map, "2"), lane(&map, "3"));
    assert_eq!(
        (first.speed_limit_mps, left.speed_limit_mps),
        (Some(13.89), None)
    );
    assert_eq!(
        (first.kind, bicycle.kind, left.kind),
        (LaneKind::Driving, LaneKind::Bicycle, LaneKind::Driving)
    );
    assert_eq!(
        (first.has_height, first.centerline[1].z, bicycle.has_height),
        (true, 1.5, false)
    );
    assert_eq!(
        (
            ids(&map, &first.successors),
            first.left_neighbor,
            left.right_neighbor
        ),
        (vec!["2".to_owned()], Some(2), Some(0))
    );

    let found = tracks::commonroad::decode(&bytes).unwrap();
    let [truck, pedestrian] = found.as_slice() else {
        panic!("{found:?}")
    };
    assert_eq!(
        (truck.class.as_str(), truck.dims_m),
        ("truck", Some([8.0, 2.4, 3.2]))
    );
    let times_s: Vec<f64> = truck.points.iter().map(|point| point.time_s).collect();
    assert_eq!(times_s, [0.0, 0.5, 1.5]);
    assert_eq!(
        (truck.points[0].position_m, truck.points[2].position_m),
        (DVec2::new(1.0, 0.5), DVec2::new(11.0, 0.0))
    );
    assert!(
        (truck.points[0].yaw_rad.unwrap() - 0.1).abs() < 1e-12 && truck.points[2].yaw_rad.is_none()
    );
    assert_eq!(
        (pedestrian.dims_m, pedestrian.points[0].position_m),
        (Some([0.6, 0.6, 1.75]), DVec2::new(3.0, 4.0))
    );

    let text = String::from_utf8(bytes).unwrap();
    for (from, to, part) in [
        ("2020a\"", "2017a\"", "version 2017a"),
        ("timeStepSize=\"0.5\"", "timeStepSize=\"0\"", "timeStepSize"),
        (
            "<exact>1</exact>",
            "<exact>0</exact>",
            "point 1 at 0 s does not follow",
        ),
        (
            "dynamicObstacle id=\"62\"",
            "dynamicObstacle id=\"61\"",
            "a second obstacle with the id 61",
        ),
        ("<length>8</length>", "<length>-8</length>", "-8 by 2.4 m"),
        ("<x>6</x>", "<x>six</x>", "'six' is no finite number"),
    ] {
        let error = tracks::commonroad::decode(text.replace(from, to).as_bytes())
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{from}: {error}");
    }
    let error = commonroad::decode(
        text.replace("lanelet id=\"2\"", "lanelet id=\"3\"")
            .as_bytes(),
    )
    .unwrap_err()
    .to_string();
    assert!(error.contains("two lanes have the id 3"), "{error}");
}

#[test]
fn lane_json_is_read_and_written() {
    let map = lane_json::decode(&seed("lane_json/three.json")).unwrap();
    let (a, two, c) = (lane(&map, "a"), lane(&map, "2"), lane(&map, "c"));
    assert_eq!(
        (a.has_height, two.has_height, a.kind, c.kind),
        (false, true, LaneKind::Driving, LaneKind::Bicycle)
    );
    assert_eq!(
        (ids(&map, &two.successors), &a.predecessors[..]),
        (vec!["a".to_owned()], &[1][..])
    );
    assert_eq!(
        (two.left_neighbor, c.right_neighbor, two.speed_limit_mps),
        (Some(2), Some(1), Some(13.9))
    );
    let [main, untold] = &map.lights[..] else {
        panic!("{:?}", map.lights);
    };
    assert_eq!(
        (main.cycle_s(), main.offset_s, main.stop_lines[1].at_m),
        (34.0, 4.5, 40.0)
    );
    assert!(untold.phases.is_empty());
    let [stop, give_way] = &map.signs[..] else {
        panic!("{:?}", map.signs);
    };
    assert_eq!((stop.kind, stop.line.at_m), (SignKind::Stop, 47.5));
    assert_eq!(
        (give_way.kind, &*give_way.line.lane),
        (SignKind::Yield, "2")
    );
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("lanes.json");
    lane_json::write(&path, &map).unwrap();
    assert_eq!(read_map(&path).unwrap(), map);
    for (text, part) in [
        (r#"{"lanes": []}"#, "no lane"),
        (
            r#"{"version": 2, "lanes": []}"#,
            "version 2; version 1 is read",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0]]}]}"#,
            "lane 1: a centerline of 1 points",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0, 0, 0], [1, 1]]}]}"#,
            "a point of 2 or 3 numbers",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0], [1, 1]], "successors": ["x"]}]}"#,
            "lane 1 names lane x",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0], [1, 1]], "succesors": []}]}"#,
            "succesors",
        ),
        (
            r#"{"lanes": [{"id": 1, "kind": "rail", "centerline": [[0, 0], [1, 1]]}]}"#,
            "the kind 'rail'",
        ),
        (
            r#"{"lanes": [{"id": 1, "has_height": true, "centerline": [[0, 0], [1, 1]]}]}"#,
            "has_height",
        ),
        (
            r#"{"lanes": [{"id": 1, "speed_limit_mps": -1, "centerline": [[0, 0], [1, 1]]}]}"#,
            "a speed limit of -1",
        ),
        (
            r#"{"lanes": [{"id": true, "centerline": [[0, 0], [1, 1]]}]}"#,
            "expected an id",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0], [1, 1]]}, {"id": "1", "centerline": [[0, 0], [1, 1]]}]}"#,
            "two lanes have the id 1",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0], [1, 1]]}], "lights": [{"name": "a", "stop_lines": [["2", 1]]}]}"#,
            "traffic light a: a stop line on lane 2; expected a lane of the map",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0], [1, 1]]}], "lights": [{"name": "a", "stop_lines": []}]}"#,
            "lights[0].stop_lines: 0 of them",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0], [1, 1]]}], "signs": [{"kind": "halt", "lane": "1", "at_m": 0}]}"#,
            "signs[0].kind: 'halt' is unknown; there are stop, yield",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0], [1, 1]]}], "signs": [{"kind": "stop", "lane": "2", "at_m": 0}]}"#,
            "a stop sign on lane 2; expected a lane of the map",
        ),
        (
            r#"{"lanes": [{"id": 1, "centerline": [[0, 0], [1, 1]]}], "signs": [{"kind": "stop", "lane": "1", "at_m": -1}]}"#,
            "signs[0].at_m: a line -1 m along",
        ),
    ] {
        let error = lane_json::decode(text.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
    }
    let endless = Lane {
        id: "e".into(),
        centerline: vec![DVec3::ZERO, DVec3::INFINITY],
        ..Lane::default()
    };
    let error = lane_json::write(
        &path,
        &LaneMap {
            lanes: vec![endless],
            ..LaneMap::default()
        },
    )
    .unwrap_err()
    .to_string();
    assert!(
        error.contains("lane e") && error.contains("lanes.json"),
        "{error}"
    );
    assert_eq!(read_map(&path).unwrap(), map, "what stood there stays");
}

/// Lane of a stop line, and meters along it.
type Line<'a> = (&'a str, f64);

/// Name, phases and stop lines of each light.
fn lights(map: &LaneMap) -> Vec<(&str, usize, Vec<Line<'_>>)> {
    let line = |line: &decouplegs_scene::StopLine| {
        let at = map.lanes.iter().position(|lane| lane.id == line.lane);
        (
            map.lanes[at.expect("a lane of the map")].id.as_str(),
            line.at_m,
        )
    };
    let lights = map.lights.iter();
    lights
        .map(|light| {
            let lines = light.stop_lines.iter().map(line).collect();
            (light.name.as_str(), light.phases.len(), lines)
        })
        .collect()
}

#[test]
fn lights_of_commonroad_have_their_cycle_and_stop_lines() {
    let text = String::from_utf8(seed("commonroad/2020a.xml")).unwrap();
    let map = commonroad::decode(text.as_bytes()).unwrap();
    // The second light is inactive; lanelet 3 has no stop line.
    assert_eq!(lights(&map), [("51", 4, vec![("1", 18.0), ("3", 20.0)])]);
    let light = &map.lights[0];
    // Steps of half a second, 8 of them before the cycle begins.
    assert_eq!((light.cycle_s(), light.offset_s), (29.0, -4.0));
    assert_eq!(light.phase_at(4.0), (LightColor::Green, 10.0));
    assert_eq!(light.phase_at(3.5), (LightColor::Red, 0.5));
    let error = |from: &str, to: &str| {
        let changed = text.replacen(from, to, 1);
        commonroad::decode(changed.as_bytes())
            .unwrap_err()
            .to_string()
    };
    assert!(error(">green<", ">blue<").contains("the color 'blue'; expected red"));
    assert!(error("<duration>20<", "<duration>-2<").contains("traffic light 51: phases: -1 s"));
}

#[test]
fn lights_of_open_drive_are_on_the_lanes_that_they_are_for() {
    let text = String::from_utf8(seed("open_drive/crossing.xodr")).unwrap();
    let map = open_drive::decode(text.as_bytes()).unwrap();
    let found = lights(&map);
    let names: Vec<&str> = found.iter().map(|light| light.0).collect();
    assert_eq!(names, ["tl", "both"]);
    // 31.5 of the 35 m of its section, and the start of the road that refers to it.
    let [(first, along_m), (second, start_m)] = found[0].2[..] else {
        panic!("{found:?}");
    };
    let length_m = decouplegs_asset::maps::length_m(&lane(&map, "1/1/-1").centerline);
    assert_eq!((first, second, start_m), ("1/1/-1", "2/0/-1", 0.0));
    assert!(
        (along_m - 0.9 * length_m).abs() < 0.05,
        "{along_m} of {length_m}"
    );
    // Lane 1 runs against the road: 25 m before the start of its section.
    let [(id, along_m)] = found[1].2[..] else {
        panic!("{found:?}");
    };
    assert!(id == "1/0/1" && (along_m - 25.0).abs() < 0.8, "{along_m}");
}

/// A lanelet over `points`, the middle line; `links` are its other elements.
fn lanelet(id: usize, points: [[f64; 2]; 3], links: &str) -> String {
    let bound = |name: &str, left_m: f64| {
        let point = |[x, y]: [f64; 2]| {
            // Moved in y alone; the last leg of a turn, which runs along y, in x.
            let turns = (y - points[0][1]).signum() * f64::from(u8::from(y != points[0][1]));
            let (x, y) = (
                x - turns * left_m,
                y + left_m * f64::from(u8::from(turns == 0.0)),
            );
            format!("<point><x>{x}</x><y>{y}</y></point>")
        };
        let points: String = points.map(point).concat();
        format!("<{name}>{points}</{name}>")
    };
    let bounds = bound("leftBound", 1.5) + &bound("rightBound", -1.5);
    format!("<lanelet id=\"{id}\">{bounds}{links}<laneletType>urban</laneletType></lanelet>")
}

#[test]
fn lights_of_commonroad_bind_the_successors_in_their_direction() {
    let map = |first: &str, second: &str| {
        let light = |id: usize, direction: &str| {
            format!(
                "<trafficLight id=\"{id}\"><cycle><cycleElement><duration>20</duration>\
                 <color>red</color></cycleElement></cycle>\
                 <direction>{direction}</direction></trafficLight>"
            )
        };
        let links = "<successor ref=\"2\"/><successor ref=\"3\"/><successor ref=\"4\"/>\
                     <trafficLightRef ref=\"8\"/><trafficLightRef ref=\"9\"/>";
        let text = format!(
            "<commonRoad commonRoadVersion=\"2020a\" timeStepSize=\"1\">{}{}{}{}{}{}</commonRoad>",
            lanelet(1, [[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]], links),
            // Turns over a short straight lane count, too.
            lanelet(2, [[20.0, 0.0], [30.0, 0.0], [30.0, 40.0]], ""),
            lanelet(3, [[20.0, 0.0], [40.0, 0.0], [60.0, 0.0]], ""),
            lanelet(4, [[20.0, 0.0], [30.0, 0.0], [30.0, -40.0]], ""),
            light(8, first),
            light(9, second),
        );
        commonroad::decode(text.as_bytes())
    };
    let towards = |first: &str, second: &str| -> Vec<(String, Vec<String>)> {
        let map = map(first, second).unwrap();
        let lines = |light: &decouplegs_scene::TrafficLight| {
            let lines = light.stop_lines.iter().map(|line| line.towards.clone());
            (light.name.clone(), lines.collect::<Vec<_>>().concat())
        };
        map.lights.iter().map(lines).collect()
    };
    let expected = |first: &[&str], second: &[&str]| {
        let owned = |ids: &[&str]| ids.iter().map(|&id| id.to_owned()).collect();
        vec![
            ("8".to_owned(), owned(first)),
            ("9".to_owned(), owned(second)),
        ]
    };
    assert_eq!(
        towards("left", "straightRight"),
        expected(&["2"], &["3", "4"])
    );
    assert_eq!(
        towards("leftStraight", "right"),
        expected(&["2", "3"], &["4"])
    );
    assert_eq!(
        towards("straight", "leftRight"),
        expected(&["3"], &["2", "4"])
    );
    assert_eq!(towards("all", "left"), expected(&[], &["2"]));
    let error = map("upwards", "left").unwrap_err().to_string();
    assert!(
        error.contains("the direction 'upwards'; expected left"),
        "{error}"
    );
}
