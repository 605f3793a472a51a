//! Lanelet2 (`.osm`): OpenStreetMap's XML with relations of type `lanelet`, each between a way on
//! its left and one on its right.
//!
//! Ways are turned so that left is to the left. Coordinates are the tags `local_x` and `local_y`
//! where all nodes of lanelets have them, else latitude and longitude in UTM on WGS 84, full
//! eastings and northings ([`LaneMap::offset`] is zero), in the zone and on the hemisphere of the
//! first node of the first lanelet, see [`UtmZone::for_position`]. Height is the tag `ele`, known
//! to a lanelet if all its nodes have it. A lanelet continues in those that start at the two nodes
//! where it ends; neighbors share a way and its direction. A lanelet for both directions (`one_way`
//! = no) is read in that of its file alone. No tag is mandatory: a lanelet without a subtype is a
//! road, and where tags `participant:` name who takes part, they alone count (Lanelet2's
//! LaneletAndAreaTagging). Limits that a country sets without a tag are not known.
//!
//! Of regulatory elements, traffic lights (`lights`) and rights of way (`signs`) are read. Not
//! read: areas, other regulatory elements, speed limits other than the tag `speed_limit`.

mod lights;
mod signs;

use std::collections::{HashMap, HashSet};

use decouplegs_scene::{Lane, LaneKind, LaneMap};
use glam::{DVec2, DVec3};

use super::budget::Budget;
use super::links::{LaneIndices, join};
use super::polyline::{between, cleaned, halfway, is_left_of};
use super::projection::UtmZone;
use super::speed;
use crate::DecodeError;
use crate::xml::{Element, excerpt, finite, parse};

/// Reads the lanelets of a file.
///
/// # Errors
/// A [`DecodeError`] that names the element or lanelet at fault: a way or node that is missing is
/// one.
pub fn decode(bytes: &[u8]) -> Result<LaneMap, DecodeError> {
    let document = parse(bytes)?;
    let root = Element::root(&document, "osm")?;
    let file = File::read(root)?;
    if file.lanelets.is_empty() && file.has_roads {
        return Err(DecodeError::Unsupported(
            "the roads of a plain OpenStreetMap file, without lanelets; make lanes of them first, for instance with SUMO's \
             netconvert (to OpenDRIVE) or with CommonRoad's scenario designer"
                .into(),
        ));
    }
    let plane = file.plane()?;
    let mut budget = Budget::whole();
    let lanelets = file
        .lanelets
        .iter()
        .map(|lanelet| lanelet.sides(&file, plane, &mut budget));
    let sides = lanelets.collect::<Result<Vec<_>, _>>()?;
    let lanes = file
        .lanelets
        .iter()
        .zip(&sides)
        .map(|(lanelet, sides)| lanelet.lane(&file, plane, sides, &mut budget));
    let mut lanes = lanes.collect::<Result<Vec<_>, _>>()?;
    LaneIndices::new(&lanes)?;
    connect(&sides, &mut lanes);
    let lights = lights::lights(&file, plane, &lanes, &mut budget)?;
    let signs = signs::signs(&file, plane, &lanes, &mut budget)?;
    Ok(LaneMap {
        lights,
        signs,
        ..super::finished(lanes, DVec3::ZERO)?
    })
}

/// Position of a node as given in the file.
#[derive(Clone, Copy)]
struct Node {
    degrees: Option<DVec2>,
    local_m: Option<DVec2>,
    height_m: Option<f64>,
}

struct File<'a> {
    nodes: HashMap<&'a str, Node>,
    /// Nodes of each way.
    ways: HashMap<&'a str, Vec<&'a str>>,
    lanelets: Vec<Lanelet<'a>>,
    /// Relations that are traffic lights.
    lights: Vec<Element<'a>>,
    /// Relations that say who goes first.
    rights: Vec<Element<'a>>,
    /// Ways that are stop signs.
    stop_signs: HashSet<&'a str>,
    /// True if a way is a road of OpenStreetMap.
    has_roads: bool,
}

/// Rule by which nodes become points.
#[derive(Clone, Copy)]
enum Plane {
    Local,
    Utm(UtmZone),
}

/// A relation of type lanelet.
struct Lanelet<'a> {
    element: Element<'a>,
    id: &'a str,
    left: &'a str,
    right: &'a str,
    centerline: Option<&'a str>,
}

/// A way in the direction of a lanelet.
struct Side<'a> {
    way: &'a str,
    is_turned: bool,
    first: &'a str,
    last: &'a str,
    points: Vec<DVec3>,
    has_height: bool,
}

/// Value of a tag of an element.
fn tag<'a>(element: Element<'a>, key: &str) -> Option<&'a str> {
    element
        .all("tag")
        .find(|tag| tag.attribute("k") == Some(key))
        .and_then(|tag| tag.attribute("v"))
}

impl<'a> File<'a> {
    fn read(root: Element<'a>) -> Result<Self, DecodeError> {
        let mut file = File {
            nodes: HashMap::new(),
            ways: HashMap::new(),
            lanelets: Vec::new(),
            lights: Vec::new(),
            rights: Vec::new(),
            stop_signs: HashSet::new(),
            has_roads: false,
        };
        // JOSM keeps what was deleted until it is uploaded.
        for element in root
            .elements()
            .filter(|element| element.attribute("action") != Some("delete"))
        {
            match element.name() {
                "node" => {
                    file.nodes
                        .insert(element.needed_attribute("id")?, Node::read(element)?);
                }
                "way" => {
                    let nodes = element
                        .all("nd")
                        .map(|nd| nd.needed_attribute("ref"))
                        .collect::<Result<_, _>>()?;
                    let id = element.needed_attribute("id")?;
                    file.ways.insert(id, nodes);
                    file.has_roads |= tag(element, "highway").is_some();
                    if signs::is_stop_sign(element) {
                        file.stop_signs.insert(id);
                    }
                }
                "relation" if tag(element, "type") == Some("lanelet") => {
                    file.lanelets.push(Lanelet::read(element)?);
                }
                "relation" if lights::is_light(element) => file.lights.push(element),
                "relation" if signs::is_right_of_way(element) => file.rights.push(element),
                _ => {}
            }
        }
        Ok(file)
    }

    fn nodes_of(&self, lanelet: &Lanelet<'a>, way: &str) -> Result<&[&'a str], DecodeError> {
        match self.ways.get(way) {
            Some(nodes) if !nodes.is_empty() => Ok(nodes),
            Some(_) => Err(lanelet
                .element
                .fault(format!("way {} has no nodes", excerpt(way)))),
            None => Err(lanelet
                .element
                .fault(format!("way {} is not in the file", excerpt(way)))),
        }
    }

    fn node(&self, lanelet: &Lanelet, id: &str) -> Result<Node, DecodeError> {
        let node = self.nodes.get(id).copied();
        node.ok_or_else(|| {
            lanelet
                .element
                .fault(format!("node {} is not in the file", excerpt(id)))
        })
    }

    /// Local coordinates where all nodes of lanelets have them; else UTM around the first of them.
    fn plane(&self) -> Result<Plane, DecodeError> {
        let Some(first) = self.lanelets.first() else {
            return Ok(Plane::Local);
        };
        let ways: HashSet<&str> = self
            .lanelets
            .iter()
            .flat_map(|one| [one.left, one.right])
            .collect();
        let mut nodes = ways
            .iter()
            .filter_map(|way| self.ways.get(way))
            .flatten()
            .filter_map(|id| self.nodes.get(id));
        if nodes.all(|node| node.local_m.is_some()) {
            return Ok(Plane::Local);
        }
        let node = self.node(first, self.nodes_of(first, first.left)?[0])?;
        let degrees = node
            .degrees
            .ok_or_else(|| first.element.fault("its first node has no lat and lon"))?;
        Ok(Plane::Utm(UtmZone::for_position(degrees.y, degrees.x)))
    }

    /// The points of a way and whether all their heights are known.
    fn points(
        &self,
        lanelet: &Lanelet<'a>,
        way: &str,
        plane: Plane,
        budget: &mut Budget,
    ) -> Result<(Vec<DVec3>, bool), DecodeError> {
        let ids = self.nodes_of(lanelet, way)?;
        budget.spend(ids.len())?;
        let nodes = ids
            .iter()
            .map(|id| self.node(lanelet, id))
            .collect::<Result<Vec<_>, _>>()?;
        let has_height = nodes.iter().all(|node| node.height_m.is_some());
        let point = |node: &Node| -> Result<DVec3, DecodeError> {
            let position = match (plane, node.local_m, node.degrees) {
                (Plane::Local, Some(local_m), _) => local_m,
                (Plane::Utm(zone), _, Some(degrees)) => zone
                    .project(degrees.y, degrees.x)
                    .map_err(|error| lanelet.element.fault(error.reason()))?,
                _ => return Err(lanelet.element.fault("one of its nodes has no lat and lon")),
            };
            Ok(position.extend(node.height_m.filter(|_| has_height).unwrap_or(0.0)))
        };
        Ok((
            nodes.iter().map(point).collect::<Result<_, _>>()?,
            has_height,
        ))
    }
}

impl Node {
    fn read(element: Element) -> Result<Self, DecodeError> {
        let number = |key: &str| -> Result<Option<f64>, DecodeError> {
            let Some(text) = tag(element, key).filter(|text| !text.is_empty()) else {
                return Ok(None);
            };
            let number = finite(text).ok_or_else(|| {
                element.fault(format!("{key} = '{}' is no finite number", excerpt(text)))
            });
            number.map(Some)
        };
        let pair = |x: Option<f64>, y: Option<f64>| Some(DVec2::new(x?, y?));
        // Maps that were drawn in local coordinates alone leave the two empty.
        let degrees = |name: &str| match element.attribute(name) {
            None | Some("") => Ok(None),
            Some(_) => element.number(name).map(Some),
        };
        Ok(Self {
            degrees: pair(degrees("lon")?, degrees("lat")?),
            local_m: pair(number("local_x")?, number("local_y")?),
            height_m: number("ele")?,
        })
    }
}

impl<'a> Lanelet<'a> {
    fn read(element: Element<'a>) -> Result<Self, DecodeError> {
        let way = |role: &str| -> Result<Option<&'a str>, DecodeError> {
            let mut members = element.all("member").filter(|member| {
                member.attribute("role") == Some(role) && member.attribute("type") == Some("way")
            });
            match (members.next(), members.next()) {
                (None, _) => Ok(None),
                (Some(member), None) => member.needed_attribute("ref").map(Some),
                (Some(_), Some(_)) => {
                    Err(element.fault(format!("two ways are its {role}; expected one")))
                }
            }
        };
        let needed =
            |role: &str| way(role)?.ok_or_else(|| element.fault(format!("no way is its {role}")));
        let id = element.needed_attribute("id")?;
        Ok(Self {
            element,
            id,
            left: needed("left")?,
            right: needed("right")?,
            centerline: way("centerline")?,
        })
    }

    /// Borders of the lane, turned so that each has the other on its proper side.
    fn sides(
        &self,
        file: &File<'a>,
        plane: Plane,
        budget: &mut Budget,
    ) -> Result<[Side<'a>; 2], DecodeError> {
        let mut side = |way: &'a str| -> Result<Side<'a>, DecodeError> {
            let (points, has_height) = file.points(self, way, plane, budget)?;
            let nodes = file.nodes_of(self, way)?;
            Ok(Side {
                way,
                is_turned: false,
                first: nodes[0],
                last: nodes[nodes.len() - 1],
                points,
                has_height,
            })
        };
        let (mut left, mut right) = (side(self.left)?, side(self.right)?);
        if is_left_of(&left.points, halfway(&right.points)) {
            left.turn();
        }
        if !is_left_of(&right.points, halfway(&left.points)) {
            right.turn();
        }
        Ok([left, right])
    }

    fn lane(
        &self,
        file: &File<'a>,
        plane: Plane,
        sides: &[Side; 2],
        budget: &mut Budget,
    ) -> Result<Lane, DecodeError> {
        let middle = self
            .centerline
            .map(|way| file.points(self, way, plane, budget))
            .transpose()?;
        let has_height = sides.iter().all(|side| side.has_height)
            && middle.as_ref().is_none_or(|(_, has_height)| *has_height);
        let line = |points: &[DVec3]| {
            cleaned(points.iter().map(|point| {
                if has_height {
                    *point
                } else {
                    point.with_z(0.0)
                }
            }))
        };
        let [left, right] = sides.each_ref().map(|side| line(&side.points));
        budget.spend(2 * (left.len() + right.len()))?;
        let centerline = middle.map_or_else(
            || between(&left, &right),
            |(points, _)| {
                let mut points = line(&points);
                let start = 0.5 * (left[0] + right[0]);
                if points[0].distance(start) > points[points.len() - 1].distance(start) {
                    points.reverse();
                }
                points
            },
        );
        Ok(Lane {
            id: self.id.to_owned(),
            kind: self.kind(),
            centerline,
            left,
            right,
            has_height,
            speed_limit_mps: self.speed_limit_mps(),
            ..Lane::default()
        })
    }

    /// Kind of the lane by who takes part in its traffic: those that tags name, and no others; else
    /// those of its subtype, which is a road where none is given.
    fn kind(&self) -> LaneKind {
        let subtype = tag(self.element, "subtype").unwrap_or_default();
        let by_subtype = match subtype {
            "walkway" | "shared_walkway" | "crosswalk" | "stairs" => LaneKind::Walking,
            "bicycle_lane" => LaneKind::Bicycle,
            "" | "road" | "lane" | "highway" | "play_street" | "bus_lane" | "exit" => {
                LaneKind::Driving
            }
            "emergency_lane" => LaneKind::Other,
            // Subtypes of others, and of areas, keep their meaning, no matter who takes part.
            "parking" => return LaneKind::Parking,
            _ => return LaneKind::Other,
        };
        let named = self.element.all("tag").filter_map(|tag| {
            let who = tag.attribute("k")?.strip_prefix("participant:")?;
            Some((who, tag.attribute("v") == Some("yes")))
        });
        let (mut is_named, mut who) = (false, [false; 3]);
        for (name, takes_part) in named {
            is_named = true;
            // Emergency vehicles alone make no lane that traffic drives on.
            let is_vehicle =
                name == "vehicle" || name.starts_with("vehicle:") && name != "vehicle:emergency";
            who[0] |= takes_part && is_vehicle;
            who[1] |= takes_part && name == "pedestrian";
            who[2] |= takes_part && name == "bicycle";
        }
        match who {
            _ if !is_named => by_subtype,
            [true, ..] => LaneKind::Driving,
            [_, true, _] => LaneKind::Walking,
            [.., true] => LaneKind::Bicycle,
            _ => LaneKind::Other,
        }
    }

    /// The limit for cars: the finest tag that holds for them. A text that is no speed is no limit,
    /// and is warned of.
    fn speed_limit_mps(&self) -> Option<f64> {
        let keys = [
            "speed_limit:vehicle:car",
            "speed_limit:vehicle",
            "speed_limit",
        ];
        let text = keys.into_iter().find_map(|key| tag(self.element, key))?;
        match text.trim().to_ascii_lowercase().as_str() {
            "" | "none" | "no" | "unlimited" | "inf" => None,
            text => {
                let speed_mps = speed_mps(text);
                if speed_mps.is_none() {
                    log::warn!(
                        "lanelet {}: speed_limit = '{}' is no speed such as '50 km/h'; it has no limit",
                        excerpt(self.id),
                        excerpt(text)
                    );
                }
                speed_mps
            }
        }
    }
}

/// A speed with its unit in lower case, kilometers an hour where it has none.
fn speed_mps(text: &str) -> Option<f64> {
    speed::with_unit(text).map(|(number, factor)| number * factor.unwrap_or(1.0 / 3.6))
}

impl Side<'_> {
    fn turn(&mut self) {
        self.is_turned = !self.is_turned;
        std::mem::swap(&mut self.first, &mut self.last);
        self.points.reverse();
    }
}

/// Joins lanelets that follow each other or share a way.
fn connect(sides: &[[Side; 2]], lanes: &mut [Lane]) {
    let mut by_start: HashMap<[&str; 2], Vec<usize>> = HashMap::new();
    let mut by_left = HashMap::new();
    for (at, [left, right]) in sides.iter().enumerate() {
        by_start
            .entry([left.first, right.first])
            .or_default()
            .push(at);
        // Of several lanelets over one way, which only happens where lanes split, the first is the
        // neighbor.
        by_left.entry((left.way, left.is_turned)).or_insert(at);
    }
    for (at, [left, right]) in sides.iter().enumerate() {
        for &next in by_start.get(&[left.last, right.last]).into_iter().flatten() {
            join(lanes, at, next);
        }
        if let Some(&neighbor) = by_left
            .get(&(right.way, right.is_turned))
            .filter(|neighbor| **neighbor != at)
        {
            lanes[at].right_neighbor = Some(neighbor);
            lanes[neighbor].left_neighbor.get_or_insert(at);
        }
    }
}
