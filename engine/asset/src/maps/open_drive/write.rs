//! Lanes as OpenDRIVE, for programs that read no other map.
//!
//! Lanes of one direction that lie beside each other are lanes of one road; any other is a road of
//! its own. The reference line of a road is the centerline of its leftmost lane, from which
//! `laneOffset` leads to the left border. A road of one lane has it in straight pieces, so that the
//! centerline is exact, and borders are as far apart as in the map, but centered. One of several
//! lanes has it in arcs, whose heading does not jump: lanes beside a bend would. Lanes that split
//! or merge meet in junctions. That lanes of opposite directions lie beside each other is lost.
//! Traffic lights and signs are left out.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use decouplegs_scene::{Invalid, Lane, LaneKind, LaneMap};
use glam::{DVec2, DVec3};

use super::beside::{Piece, ReferenceLine, roads};

/// Width of a lane without borders, meters.
pub(super) const WIDTH_M: f64 = 3.5;
/// Points closer than this are one, meters.
const SAME_M: f64 = 1e-3;

/// A road: its lanes from left to right, and where their borders are.
pub(super) struct Road {
    /// Places in the map.
    pub(super) lanes: Vec<usize>,
    pub(super) line: ReferenceLine,
    /// Heights along the line, meters.
    pub(super) heights_m: Vec<f64>,
    /// Distances of the borders from the line, to its left, meters: for each border from left to
    /// right, at each place of the line.
    pub(super) borders_m: Vec<Vec<f64>>,
}

impl Road {
    /// The road of one lane.
    fn of_lane(map: &LaneMap, number: usize) -> Result<Self, Invalid> {
        let lane = &map.lanes[number];
        let points = apart(&lane.centerline);
        if points.len() < 2 {
            return Err(Invalid::new(format!(
                "lane {}: its points are less than {SAME_M} m apart",
                lane.id
            )));
        }
        let halves = points.iter().map(|point| 0.5 * width_m(lane, *point));
        let halves: Vec<f64> = halves.collect();
        Ok(Self {
            lanes: vec![number],
            line: ReferenceLine::straight(&points),
            heights_m: points.iter().map(|point| point.z).collect(),
            borders_m: vec![halves.clone(), halves.iter().map(|half| -half).collect()],
        })
    }
}

/// Link of an end of a road.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Link {
    Nothing,
    Road(usize),
    Junction(usize),
}

/// Lanes that lead into each other, by incoming and connecting road.
type Connections = BTreeMap<(usize, usize), Vec<(usize, usize)>>;

/// Links of all roads, and the junctions where they are not one to one.
struct Links {
    successors: Vec<Link>,
    predecessors: Vec<Link>,
    junctions: Vec<Connections>,
    /// Junction that a road is a connecting road of.
    inside: Vec<Option<usize>>,
    /// Road of each lane, and its id there.
    of_lane: Vec<(usize, i64)>,
    /// Lanes that lead into each lane.
    incoming: Vec<Vec<usize>>,
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
    let singles = (0..map.lanes.len())
        .map(|number| Road::of_lane(map, number))
        .collect::<Result<Vec<_>, _>>()?;
    let roads = roads(map, singles);
    let links = Links::new(map, &roads);
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<OpenDRIVE>\n\
         <header revMajor=\"1\" revMinor=\"4\" name=\"lanes\" version=\"1\">\n\
         <geoReference><![CDATA[+proj=tmerc +lat_0=0 +lon_0=0 +k=1 +x_0=0 +y_0=0 +ellps=WGS84 +units=m]]></geoReference>\n\
         </header>\n",
    );
    for (number, road) in roads.iter().enumerate() {
        write_road(&mut text, number, road, map, &links);
    }
    for (junction, connections) in links.junctions.iter().enumerate() {
        let junction = links.junction_id(junction);
        let _ = writeln!(text, "<junction id=\"{junction}\" name=\"\">");
        for (id, ((incoming, connecting), lanes)) in connections.iter().enumerate() {
            let _ = write!(
                text,
                "<connection id=\"{id}\" incomingRoad=\"{}\" connectingRoad=\"{}\" contactPoint=\"start\">",
                incoming + 1,
                connecting + 1
            );
            for (from, to) in lanes {
                let (from, to) = (links.of_lane[*from].1, links.of_lane[*to].1);
                let _ = write!(text, "<laneLink from=\"{from}\" to=\"{to}\"/>");
            }
            text.push_str("</connection>\n");
        }
        text.push_str("</junction>\n");
    }
    text.push_str("</OpenDRIVE>\n");
    Ok(text.into_bytes())
}

impl Links {
    fn new(map: &LaneMap, roads: &[Road]) -> Self {
        let mut of_lane = vec![(0, 0); map.lanes.len()];
        for (road, of_road) in roads.iter().enumerate() {
            for (&lane, id) in of_road.lanes.iter().zip(1..) {
                of_lane[lane] = (road, -id);
            }
        }
        // Ends of roads where lanes meet, each the smallest end that it is joined with: 2 n where
        // road n ends, 2 n + 1 where it starts.
        let mut meeting: Vec<usize> = (0..2 * roads.len()).collect();
        let root = |meeting: &[usize], mut end: usize| {
            while meeting[end] != end {
                end = meeting[end];
            }
            end
        };
        let pairs = map.lanes.iter().enumerate().flat_map(|(from, lane)| {
            let next: BTreeSet<usize> = lane.successors.iter().copied().collect();
            next.into_iter().map(move |to| (from, to))
        });
        let pairs: Vec<(usize, usize)> = pairs.collect();
        for &(from, to) in &pairs {
            let ends = [2 * of_lane[from].0, 2 * of_lane[to].0 + 1];
            let [a, b] = ends.map(|end| root(&meeting, end));
            meeting[a.max(b)] = a.min(b);
            // Short ways to the root.
            ends.iter().for_each(|end| meeting[*end] = a.min(b));
        }
        let mut places: BTreeMap<usize, Vec<(usize, usize)>> = BTreeMap::new();
        for &(from, to) in &pairs {
            let place = root(&meeting, 2 * of_lane[from].0);
            places.entry(place).or_default().push((from, to));
        }
        let mut incoming = vec![Vec::new(); map.lanes.len()];
        pairs
            .iter()
            .for_each(|(from, to)| incoming[*to].push(*from));
        let mut links = Self {
            successors: vec![Link::Nothing; roads.len()],
            predecessors: vec![Link::Nothing; roads.len()],
            junctions: Vec::new(),
            inside: vec![None; roads.len()],
            of_lane,
            incoming,
        };
        for pairs in places.into_values() {
            links.add_place(&pairs);
        }
        links
    }

    /// Adds what meets in one place: two roads, lane by lane, or a junction.
    fn add_place(&mut self, pairs: &[(usize, usize)]) {
        let mut by_roads = Connections::new();
        let mut into: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        for &(from, to) in pairs {
            let (a, b) = (self.of_lane[from].0, self.of_lane[to].0);
            by_roads.entry((a, b)).or_default().push((from, to));
            into.entry(b).or_default().insert(a);
        }
        let froms: BTreeSet<usize> = pairs.iter().map(|pair| pair.0).collect();
        let tos: BTreeSet<usize> = pairs.iter().map(|pair| pair.1).collect();
        let is_one_to_one = froms.len() == pairs.len() && tos.len() == pairs.len();
        let (&(a, b), _) = by_roads.iter().next().expect("lanes meet here");
        if by_roads.len() == 1 && is_one_to_one {
            self.successors[a] = Link::Road(b);
            self.predecessors[b] = Link::Road(a);
            return;
        }
        let junction = self.junctions.len();
        for &(a, b) in by_roads.keys() {
            self.successors[a] = Link::Junction(junction);
            self.inside[b] = Some(junction);
        }
        for (b, from) in into {
            if from.len() == 1 {
                self.predecessors[b] = from.first().map_or(Link::Nothing, |a| Link::Road(*a));
            }
        }
        self.junctions.push(by_roads);
    }

    /// Ids of junctions follow those of roads.
    fn junction_id(&self, junction: usize) -> usize {
        self.inside.len() + 1 + junction
    }

    /// Id of the only lane of `lanes` that is on the road that `link` leads to.
    fn only(&self, link: Link, lanes: &[usize]) -> Option<i64> {
        let Link::Road(road) = link else {
            return None;
        };
        let mut there = lanes.iter().filter(|lane| self.of_lane[**lane].0 == road);
        match (there.next(), there.next()) {
            (Some(lane), None) => Some(self.of_lane[*lane].1),
            _ => None,
        }
    }
}

/// Adds a road.
fn write_road(text: &mut String, number: usize, road: &Road, map: &LaneMap, links: &Links) {
    let line = &road.line;
    let junction = links.inside[number];
    let junction = junction.map_or("-1".to_owned(), |j| links.junction_id(j).to_string());
    let _ = writeln!(
        text,
        "<road name=\"{}\" length=\"{:.6}\" id=\"{}\" junction=\"{junction}\">",
        escaped(&map.lanes[road.lanes[0]].id),
        line.length_m(),
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
                links.junction_id(junction)
            ),
        };
    }
    text.push_str("</link>\n<planView>\n");
    for piece in &line.pieces {
        let Piece {
            start_m,
            from: DVec2 { x, y },
            heading_rad,
            length_m,
            curvature,
        } = piece;
        let shape = match *curvature {
            0.0 => "<line/>".to_owned(),
            curvature => format!("<arc curvature=\"{curvature:.12}\"/>"),
        };
        let _ = writeln!(
            text,
            "<geometry s=\"{start_m:.6}\" x=\"{x:.6}\" y=\"{y:.6}\" hdg=\"{heading_rad:.12}\" length=\"{length_m:.6}\">{shape}</geometry>"
        );
    }
    text.push_str("</planView>\n");
    if map.lanes[road.lanes[0]].has_height {
        text.push_str("<elevationProfile>");
        write_profile(text, "elevation", "s", &line.places_m, &road.heights_m);
        text.push_str("</elevationProfile>\n");
    }
    write_lanes(text, number, road, map, links);
    text.push_str("</road>\n");
}

/// Adds the lane section, whose lanes lie to the right of the leftmost border.
fn write_lanes(text: &mut String, number: usize, road: &Road, map: &LaneMap, links: &Links) {
    let places_m = &road.line.places_m;
    text.push_str("<lanes>");
    write_profile(text, "laneOffset", "s", places_m, &road.borders_m[0]);
    text.push_str("<laneSection s=\"0\"><center><lane id=\"0\" type=\"none\" level=\"false\"/></center><right>");
    for (at, &lane_number) in road.lanes.iter().enumerate() {
        let lane = &map.lanes[lane_number];
        let kind = match lane.kind {
            LaneKind::Driving => "driving",
            LaneKind::Bicycle => "biking",
            LaneKind::Walking => "sidewalk",
            LaneKind::Parking => "parking",
            LaneKind::Other => "none",
        };
        let id = links.of_lane[lane_number].1;
        let _ = write!(
            text,
            "<lane id=\"{id}\" type=\"{kind}\" level=\"false\"><link>"
        );
        let before = links.only(links.predecessors[number], &links.incoming[lane_number]);
        let after = links.only(links.successors[number], &lane.successors);
        for (name, linked) in [("predecessor", before), ("successor", after)] {
            if let Some(linked) = linked {
                let _ = write!(text, "<{name} id=\"{linked}\"/>");
            }
        }
        text.push_str("</link>\n");
        let borders = road.borders_m[at].iter().zip(&road.borders_m[at + 1]);
        let widths: Vec<f64> = borders.map(|(left, right)| left - right).collect();
        write_profile(text, "width", "sOffset", places_m, &widths);
        if let Some(limit_mps) = lane.speed_limit_mps {
            let _ = write!(
                text,
                "<speed sOffset=\"0\" max=\"{limit_mps:.6}\" unit=\"m/s\"/>"
            );
        }
        text.push_str("</lane>");
    }
    text.push_str("</right></laneSection></lanes>\n");
}

/// Adds what is linear between `values` at `places_m`. Pieces that go on as before are left out.
fn write_profile(text: &mut String, name: &str, start: &str, places_m: &[f64], values: &[f64]) {
    let mut before: Option<(f64, f64, f64)> = None;
    for (place, value) in places_m.windows(2).zip(values.windows(2)) {
        let slope = (value[1] - value[0]) / (place[1] - place[0]);
        let goes_on = before.is_some_and(|(start_m, from, slope_before)| {
            let expected = [place[0], place[1]].map(|s| from + slope_before * (s - start_m));
            (expected[0] - value[0]).abs() < 1e-6 && (expected[1] - value[1]).abs() < 1e-6
        });
        if goes_on {
            continue;
        }
        before = Some((place[0], value[0], slope));
        let _ = writeln!(
            text,
            "<{name} {start}=\"{:.6}\" a=\"{:.6}\" b=\"{slope:.12}\" c=\"0\" d=\"0\"/>",
            place[0], value[0]
        );
    }
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
pub(super) fn apart(line: &[DVec3]) -> Vec<DVec3> {
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
