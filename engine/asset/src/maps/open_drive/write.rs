//! Lanes as OpenDRIVE: a road with one lane for each, for programs that read no other map.
//!
//! The reference line of a road is the centerline of its lane, in straight pieces; the lane lies to
//! both sides of it by `laneOffset`. So the centerline is exact, and borders are as far apart as in
//! the map, but centered. Lanes that split or merge meet in junctions. That lanes lie beside each
//! other is lost: each is a road of its own. Traffic lights and signs are left out.

use std::fmt::Write as _;

use decouplegs_scene::{Invalid, Lane, LaneKind, LaneMap};
use glam::DVec3;

/// Width of a lane without borders, meters.
const WIDTH_M: f64 = 3.5;
/// Points closer than this are one, meters.
const SAME_M: f64 = 1e-3;

/// Link of an end of a road.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Link {
    Nothing,
    Road(usize),
    Junction(usize),
}

/// Links of all lanes, and the junctions where they are not one to one.
struct Links {
    successors: Vec<Link>,
    predecessors: Vec<Link>,
    /// Incoming and connecting lanes of each junction.
    junctions: Vec<Vec<(usize, usize)>>,
    /// Junction that a lane is a connecting road of.
    inside: Vec<Option<usize>>,
}

/// Writes a map as OpenDRIVE 1.4.
///
/// The header says that the map is at latitude and longitude 0: a lane map does not tell where on
/// Earth it is.
///
/// # Errors
/// A sentence naming the lane at fault.
pub fn encode(map: &LaneMap) -> Result<Vec<u8>, Invalid> {
    map.check()?;
    let links = Links::new(map);
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<OpenDRIVE>\n\
         <header revMajor=\"1\" revMinor=\"4\" name=\"lanes\" version=\"1\">\n\
         <geoReference><![CDATA[+proj=tmerc +lat_0=0 +lon_0=0 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m]]></geoReference>\n\
         </header>\n",
    );
    for (number, lane) in map.lanes.iter().enumerate() {
        road(&mut text, number, lane, &links)?;
    }
    for (junction, connections) in links.junctions.iter().enumerate() {
        let _ = writeln!(
            text,
            "<junction id=\"{}\" name=\"\">",
            junction_id(map, junction)
        );
        for (id, (incoming, connecting)) in connections.iter().enumerate() {
            let _ = writeln!(
                text,
                "<connection id=\"{id}\" incomingRoad=\"{}\" connectingRoad=\"{}\" contactPoint=\"start\"><laneLink from=\"-1\" to=\"-1\"/></connection>",
                incoming + 1,
                connecting + 1
            );
        }
        text.push_str("</junction>\n");
    }
    text.push_str("</OpenDRIVE>\n");
    Ok(text.into_bytes())
}

/// Ids of junctions follow those of roads.
fn junction_id(map: &LaneMap, junction: usize) -> usize {
    map.lanes.len() + 1 + junction
}

impl Links {
    fn new(map: &LaneMap) -> Self {
        let count = map.lanes.len();
        let mut incoming: Vec<Vec<usize>> = vec![Vec::new(); count];
        for (lane, of_lane) in map.lanes.iter().enumerate() {
            for &next in &of_lane.successors {
                incoming[next].push(lane);
            }
        }
        let mut links = Self {
            successors: vec![Link::Nothing; count],
            predecessors: vec![Link::Nothing; count],
            junctions: Vec::new(),
            inside: vec![None; count],
        };
        let mut seen = vec![false; count];
        for lane in 0..count {
            let next = &map.lanes[lane].successors;
            if seen[lane] || next.is_empty() {
                continue;
            }
            if let [next] = next[..]
                && incoming[next].len() == 1
            {
                links.successors[lane] = Link::Road(next);
                links.predecessors[next] = Link::Road(lane);
                continue;
            }
            let junction = links.junctions.len();
            let mut connections = Vec::new();
            // All lanes that meet here: the successors of one, their other predecessors, and so on.
            let mut waiting = vec![lane];
            seen[lane] = true;
            while let Some(from) = waiting.pop() {
                links.successors[from] = Link::Junction(junction);
                for &to in &map.lanes[from].successors {
                    connections.push((from, to));
                    links.inside[to] = Some(junction);
                    if let [only] = incoming[to][..] {
                        links.predecessors[to] = Link::Road(only);
                    }
                    for &other in &incoming[to] {
                        if !std::mem::replace(&mut seen[other], true) {
                            waiting.push(other);
                        }
                    }
                }
            }
            connections.sort_unstable();
            links.junctions.push(connections);
        }
        links
    }
}

/// Adds the road of a lane.
fn road(text: &mut String, number: usize, lane: &Lane, links: &Links) -> Result<(), Invalid> {
    let points = apart(&lane.centerline);
    if points.len() < 2 {
        return Err(Invalid::new(format!(
            "lane {}: its points are less than {SAME_M} m apart",
            lane.id
        )));
    }
    let mut starts_m = vec![0.0];
    for pair in points.windows(2) {
        let before = starts_m[starts_m.len() - 1];
        starts_m.push(before + pair[0].truncate().distance(pair[1].truncate()));
    }
    let length_m = starts_m[points.len() - 1];
    let first_junction = links.inside.len() + 1;
    let junction =
        links.inside[number].map_or("-1".to_owned(), |j| (first_junction + j).to_string());
    let _ = writeln!(
        text,
        "<road name=\"{}\" length=\"{length_m:.6}\" id=\"{}\" junction=\"{junction}\">",
        escaped(&lane.id),
        number + 1
    );
    text.push_str("<link>");
    for (name, link, contact) in [
        ("predecessor", links.predecessors[number], "end"),
        ("successor", links.successors[number], "start"),
    ] {
        let _ = match link {
            Link::Nothing => Ok(()),
            Link::Road(other) => write!(
                text,
                "<{name} elementType=\"road\" elementId=\"{}\" contactPoint=\"{contact}\"/>",
                other + 1
            ),
            Link::Junction(junction) => write!(
                text,
                "<{name} elementType=\"junction\" elementId=\"{}\"/>",
                first_junction + junction
            ),
        };
    }
    text.push_str("</link>\n<planView>\n");
    for (pair, start_m) in points.windows(2).zip(&starts_m) {
        let along = (pair[1] - pair[0]).truncate();
        let DVec3 { x, y, .. } = pair[0];
        let _ = writeln!(
            text,
            "<geometry s=\"{start_m:.6}\" x=\"{x:.6}\" y=\"{y:.6}\" hdg=\"{:.12}\" length=\"{:.6}\"><line/></geometry>",
            along.to_angle(),
            along.length()
        );
    }
    text.push_str("</planView>\n");
    if lane.has_height {
        text.push_str("<elevationProfile>");
        for (pair, start_m) in points.windows(2).zip(&starts_m) {
            let run_m = pair[0].truncate().distance(pair[1].truncate());
            let slope = (pair[1].z - pair[0].z) / run_m;
            let height_m = pair[0].z;
            let _ = writeln!(
                text,
                "<elevation s=\"{start_m:.6}\" a=\"{height_m:.6}\" b=\"{slope:.12}\" c=\"0\" d=\"0\"/>"
            );
        }
        text.push_str("</elevationProfile>\n");
    }
    lanes(text, lane, &points, &starts_m, links.of_lane(number));
    text.push_str("</road>\n");
    Ok(())
}

impl Links {
    /// True for each end of a lane, start and end, that is linked to one road.
    fn of_lane(&self, number: usize) -> [bool; 2] {
        [self.predecessors[number], self.successors[number]]
            .map(|link| matches!(link, Link::Road(_)))
    }
}

/// Adds the lane section: a lane to both sides of the reference line.
fn lanes(text: &mut String, lane: &Lane, points: &[DVec3], starts_m: &[f64], linked: [bool; 2]) {
    let widths: Vec<f64> = points.iter().map(|point| width_m(lane, *point)).collect();
    let pieces = || {
        let slopes = (0..points.len() - 1).map(|at| {
            let run_m = starts_m[at + 1] - starts_m[at];
            (
                starts_m[at],
                widths[at],
                (widths[at + 1] - widths[at]) / run_m,
            )
        });
        slopes.collect::<Vec<_>>()
    };
    text.push_str("<lanes>");
    for (start_m, width_m, slope) in pieces() {
        let _ = writeln!(
            text,
            "<laneOffset s=\"{start_m:.6}\" a=\"{:.6}\" b=\"{:.12}\" c=\"0\" d=\"0\"/>",
            0.5 * width_m,
            0.5 * slope
        );
    }
    let kind = match lane.kind {
        LaneKind::Driving => "driving",
        LaneKind::Bicycle => "biking",
        LaneKind::Walking => "sidewalk",
        LaneKind::Parking => "parking",
        LaneKind::Other => "none",
    };
    let _ = writeln!(
        text,
        "<laneSection s=\"0\"><center><lane id=\"0\" type=\"none\" level=\"false\"/></center><right><lane id=\"-1\" type=\"{kind}\" level=\"false\"><link>{}{}</link>",
        if linked[0] {
            "<predecessor id=\"-1\"/>"
        } else {
            ""
        },
        if linked[1] {
            "<successor id=\"-1\"/>"
        } else {
            ""
        },
    );
    for (start_m, width_m, slope) in pieces() {
        let _ = writeln!(
            text,
            "<width sOffset=\"{start_m:.6}\" a=\"{width_m:.6}\" b=\"{slope:.12}\" c=\"0\" d=\"0\"/>"
        );
    }
    if let Some(limit_mps) = lane.speed_limit_mps {
        let _ = write!(
            text,
            "<speed sOffset=\"0\" max=\"{limit_mps:.6}\" unit=\"m/s\"/>"
        );
    }
    text.push_str("</lane></right></laneSection></lanes>\n");
}

/// Distance of the borders beside a point of the centerline, meters.
fn width_m(lane: &Lane, point: DVec3) -> f64 {
    if lane.left.len() < 2 || lane.right.len() < 2 {
        return WIDTH_M;
    }
    let beside = [&lane.left, &lane.right].map(|border| {
        let distances = border.windows(2).map(|pair| {
            let (from, along) = (pair[0].truncate(), (pair[1] - pair[0]).truncate());
            let share = (point.truncate() - from).dot(along) / along.length_squared().max(1e-12);
            point
                .truncate()
                .distance(from + along * share.clamp(0.0, 1.0))
        });
        distances.fold(f64::INFINITY, f64::min)
    });
    beside[0] + beside[1]
}

/// The points without those that follow another too closely, seen from above.
fn apart(line: &[DVec3]) -> Vec<DVec3> {
    let mut points: Vec<DVec3> = Vec::with_capacity(line.len());
    for &point in line {
        let is_apart = |last: &DVec3| last.truncate().distance(point.truncate()) > SAME_M;
        if points.last().is_none_or(is_apart) {
            points.push(point);
        }
    }
    points
}

/// Text of an attribute.
fn escaped(text: &str) -> String {
    let escape = |letter: char| match letter {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '"' => "&quot;".to_owned(),
        letter if letter.is_control() => String::new(),
        letter => letter.to_string(),
    };
    text.chars().map(escape).collect()
}
