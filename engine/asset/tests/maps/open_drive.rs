//! Roads whose lanes are known in closed form.

use decouplegs_asset::maps::{length_m, open_drive};
use decouplegs_scene::{LaneKind, LaneMap};
use glam::DVec3;

use super::{ids, lane};

/// A road along `geometry` with `rest` and the lanes given.
fn road(id: u32, attributes: &str, geometry: &str, rest: &str, lanes: &str) -> String {
    format!(
        "<road id='{id}' length='100' junction='-1' {attributes}>{rest}<planView>{geometry}</planView><lanes>{lanes}</lanes></road>"
    )
}

fn read(roads: &[String]) -> LaneMap {
    open_drive::decode(format!("<OpenDRIVE>{}</OpenDRIVE>", roads.concat()).as_bytes()).unwrap()
}

fn line(x: f64, length_m: f64) -> String {
    format!("<geometry s='0' x='{x}' y='0' hdg='0' length='{length_m}'><line/></geometry>")
}

/// A section with a lane of a width on each side.
fn both_sides(width: &str) -> String {
    let lane = |id: i32| format!("<lane id='{id}' type='driving'>{width}</lane>");
    format!(
        "<laneSection s='0'><left>{}</left><right>{}</right></laneSection>",
        lane(1),
        lane(-1)
    )
}

const WIDE: &str = "<width sOffset='0' a='3.5' b='0' c='0' d='0'/>";

#[test]
fn right_lanes_run_along_the_road_and_left_lanes_against_it() {
    let map = read(&[road(1, "", &line(0.0, 50.0), "", &both_sides(WIDE))]);
    let (right, left) = (lane(&map, "1/0/-1"), lane(&map, "1/0/1"));
    assert_eq!(
        (right.centerline[0], *right.centerline.last().unwrap()),
        (DVec3::new(0.0, -1.75, 0.0), DVec3::new(50.0, -1.75, 0.0))
    );
    assert_eq!((right.left[0].y, right.right[0].y), (0.0, -3.5));
    assert_eq!(
        (left.centerline[0], *left.centerline.last().unwrap()),
        (DVec3::new(50.0, 1.75, 0.0), DVec3::new(0.0, 1.75, 0.0))
    );
    assert_eq!((left.left[0].y, left.right[0].y), (0.0, 3.5));
    assert!(!right.has_height && right.kind == LaneKind::Driving && right.left_neighbor.is_none());
    let british = read(&[road(
        1,
        "rule='LHT'",
        &line(0.0, 50.0),
        "",
        &both_sides(WIDE),
    )]);
    let (right, left) = (lane(&british, "1/0/-1"), lane(&british, "1/0/1"));
    assert_eq!(
        (right.centerline[0].x, right.left[0].y, right.right[0].y),
        (50.0, -3.5, 0.0)
    );
    assert_eq!(
        (left.centerline[0].x, left.left[0].y, left.right[0].y),
        (0.0, 3.5, 0.0)
    );
}

#[test]
fn an_arc_is_sampled_within_its_chord_error() {
    let arc = "<geometry s='0' x='0' y='0' hdg='0' length='60'><arc curvature='0.05'/></geometry>";
    let map = read(&[road(1, "", arc, "", &both_sides(WIDE))]);
    let center = DVec3::new(0.0, 20.0, 0.0);
    for (id, radius_m) in [("1/0/-1", 21.75), ("1/0/1", 18.25)] {
        let line = &lane(&map, id).centerline;
        for pair in line.windows(2) {
            assert!((pair[0].distance(center) - radius_m).abs() < 1e-9);
            assert!(radius_m - (0.5 * (pair[0] + pair[1])).distance(center) < 0.02);
        }
        assert!(
            (length_m(line) - 60.0 * radius_m / 20.0).abs() < 0.05,
            "{id}: {}",
            length_m(line)
        );
    }
    // A tight turn needs steps far below 2 m.
    let tight = "<geometry s='0' x='0' y='0' hdg='0' length='6'><arc curvature='-0.5'/></geometry>";
    let map = read(&[road(1, "", tight, "", &both_sides(WIDE))]);
    let outer = &lane(&map, "1/0/1").right;
    for pair in outer.windows(2).filter(|pair| pair[0] != pair[1]) {
        assert!(
            (0.5 * (pair[0] + pair[1])).distance(DVec3::new(0.0, -2.0, 0.0)) > 5.5 - 0.02,
            "{pair:?}"
        );
    }
}

#[test]
fn heights_offsets_and_widths_follow_their_polynomials() {
    let elevation = "<elevationProfile><elevation s='0' a='5' b='0.1' c='0' d='0'/>\
                     <elevation s='20' a='7' b='0' c='0' d='0'/></elevationProfile>";
    let taper = "<width sOffset='0' a='0' b='0.1' c='0' d='0'/><width sOffset='30' a='3' b='0' c='0' d='0'/>";
    let lanes = format!(
        "<laneOffset s='0' a='1' b='0' c='0' d='0'/><laneOffset s='25' a='2' b='0' c='0' d='0'/>{}",
        both_sides(taper)
    );
    let map = read(&[road(1, "", &line(0.0, 50.0), elevation, &lanes)]);
    let right = lane(&map, "1/0/-1");
    assert!(right.has_height);
    for (left, right) in right.left.iter().zip(&right.right) {
        assert_eq!(left.x, right.x);
        assert!((left.z - (5.0 + 0.1 * left.x.min(20.0))).abs() < 1e-12 && left.z == right.z);
        assert!(
            (left.y - right.y - (0.1 * left.x).min(3.0)).abs() < 1e-12,
            "{left} {right}"
        );
        // At 25 m the offset jumps: there both places are kept.
        assert!(
            if left.x < 25.0 {
                left.y == 1.0
            } else {
                left.y == 2.0 || left.x == 25.0
            },
            "{left}"
        );
    }
    assert_eq!(
        right
            .left
            .iter()
            .filter(|point| point.x == 25.0)
            .map(|point| point.y)
            .collect::<Vec<_>>(),
        [1.0, 2.0]
    );
    let border = "<border sOffset='0' a='-4' b='-0.02' c='0' d='0'/>";
    let lanes = format!(
        "<laneSection s='0'><right><lane id='-1' type='biking'>{border}</lane></right></laneSection>"
    );
    let map = read(&[road(1, "", &line(0.0, 50.0), "", &lanes)]);
    assert_eq!(
        (map.lanes[0].right.last().unwrap().y, map.lanes[0].kind),
        (-5.0, LaneKind::Bicycle)
    );
}

#[test]
fn lanes_join_over_sections_roads_and_junctions() {
    let link = |before: &str, after: &str| {
        let one = |name: &str, id: &str| {
            if id.is_empty() {
                String::new()
            } else {
                format!("<{name} id='{id}'/>")
            }
        };
        format!(
            "<link>{}{}</link>",
            one("predecessor", before),
            one("successor", after)
        )
    };
    let lane_of =
        |id: i32, link: &str| format!("<lane id='{id}' type='driving'>{link}{WIDE}</lane>");
    // Road 1 has two sections; road 2, drawn the other way, touches its end with its own end; 3
    // crosses the junction to 4.
    let first = format!(
        "<laneSection s='0'><right>{}</right></laneSection><laneSection s='20'><right>{}{}</right></laneSection>",
        lane_of(-1, &link("", "-2")),
        lane_of(-1, ""),
        lane_of(-2, &link("-1", "1"))
    );
    let end_to_end =
        "<link><successor elementType='road' elementId='2' contactPoint='end'/></link>";
    let one = road(1, "", &line(0.0, 40.0), end_to_end, &first);
    let second = format!(
        "<laneSection s='0'><left>{}</left></laneSection>",
        lane_of(1, &link("", "-2"))
    );
    let turned =
        "<geometry s='0' x='80' y='0' hdg='3.141592653589793' length='40'><line/></geometry>";
    let links = "<link><successor elementType='road' elementId='1' contactPoint='end'/><predecessor elementType='junction' elementId='9'/></link>";
    let two = road(2, "", turned, links, &second);
    let across = format!(
        "<laneSection s='0'><right>{}</right></laneSection>",
        lane_of(-1, &link("1", "-1"))
    );
    let links = "<link><predecessor elementType='road' elementId='2' contactPoint='start'/>\
                 <successor elementType='road' elementId='4' contactPoint='start'/></link>";
    let three = road(3, "", &line(80.0, 10.0), links, &across);
    let last = format!(
        "<laneSection s='0'><right>{}</right></laneSection>",
        lane_of(-1, "")
    );
    let four = road(
        4,
        "",
        &line(90.0, 10.0),
        "<link><predecessor elementType='junction' elementId='9'/></link>",
        &last,
    );
    let junction = "<junction id='9'><connection id='0' incomingRoad='2' connectingRoad='3' contactPoint='start'>\
                    <laneLink from='1' to='-1'/></connection>\
                    <connection id='1' incomingRoad='77' connectingRoad='3' contactPoint='start'/></junction>";
    let map = read(&[one, two, three, four, junction.to_owned()]);
    for (id, expected) in [
        ("1/0/-1", vec!["1/1/-2"]),
        ("1/1/-2", vec!["2/0/1"]),
        ("2/0/1", vec!["3/0/-1"]),
        ("3/0/-1", vec!["4/0/-1"]),
        ("4/0/-1", vec![]),
    ] {
        assert_eq!(ids(&map, &lane(&map, id).successors), expected, "{id}");
    }
    let (inner, outer) = (lane(&map, "1/1/-1"), lane(&map, "1/1/-2"));
    assert_eq!(
        ids(
            &map,
            &[inner.right_neighbor.unwrap(), outer.left_neighbor.unwrap()]
        ),
        ["1/1/-2", "1/1/-1"]
    );
    assert!(inner.left_neighbor.is_none() && inner.successors.is_empty());
}

#[test]
fn speed_limits_are_the_lanes_or_the_roads() {
    let limited = format!("<speed sOffset='0' max='30' unit='mph'/>{WIDE}");
    let lanes = format!(
        "<laneSection s='0'><right><lane id='-1' type='driving'>{WIDE}</lane><lane id='-2' type='driving'>{limited}</lane></right></laneSection>"
    );
    let kind = "<type s='0' type='town'><speed max='50' unit='km/h'/></type><type s='30' type='town'><speed max='no limit'/></type>";
    let map = read(&[road(1, "", &line(0.0, 50.0), kind, &lanes)]);
    assert!((lane(&map, "1/0/-1").speed_limit_mps.unwrap() - 50.0 / 3.6).abs() < 1e-12);
    assert!((lane(&map, "1/0/-2").speed_limit_mps.unwrap() - 13.4112).abs() < 1e-12);
}

#[test]
fn roads_that_are_none_are_refused_with_line_and_reason() {
    let with = |geometry: &str| {
        format!(
            "<OpenDRIVE>\n{}</OpenDRIVE>",
            road(1, "", geometry, "", &both_sides(WIDE))
        )
    };
    let geometry = |length: &str, shape: &str| {
        with(&format!(
            "<geometry s='0' x='0' y='0' hdg='0' length='{length}'>{shape}</geometry>"
        ))
    };
    let twice = road(1, "", &line(0.0, 5.0), "", &both_sides(WIDE)).repeat(2);
    for (text, part) in [
        (geometry("1e308", "<line/>"), "line 2, <geometry>: a length"),
        (geometry("NaN", "<line/>"), "length=\"NaN\""),
        (geometry("10", "<helix/>"), "no line, arc"),
        (geometry("1000", "<arc curvature='1e300'/>"), "would turn"),
        (
            geometry("900000", "<spiral curvStart='0' curvEnd='1e-9'/>"),
            "m of one curve",
        ),
        (
            geometry("10", "<poly3 a='1e308' b='1e308' c='1e308' d='1e308'/>"),
            "expected finite numbers",
        ),
        (with(""), "no <geometry>"),
        (
            format!("<OpenDRIVE>{twice}</OpenDRIVE>"),
            "a second road with the id 1",
        ),
        ("<OpenDRIVE/>".to_owned(), "no lane"),
    ] {
        let error = open_drive::decode(text.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
    }
    // So many kilometers of so many lanes are told before they are made.
    let lanes: String = (1..60)
        .map(|id| format!("<lane id='-{id}' type='driving'>{WIDE}</lane>"))
        .collect();
    let wide = road(
        1,
        "",
        &line(0.0, 999_999.0),
        "",
        &format!("<laneSection s='0'><right>{lanes}</right></laneSection>"),
    );
    let error = open_drive::decode(format!("<OpenDRIVE>{wide}</OpenDRIVE>").as_bytes())
        .unwrap_err()
        .to_string();
    assert!(error.contains("more than 4000000 points"), "{error}");
}
