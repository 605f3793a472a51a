//! Vehicles, pedestrians and other objects, in the file and in catalogs.

use std::collections::HashSet;

use decouplegs_asset::DecodeError;
use decouplegs_asset::xml;
use decouplegs_scene::story::Limits;
use decouplegs_scene::{RoadUser, VehicleSize};

use super::catalogs::Catalogs;
use super::parameters::Node;
use super::{Entity, Skipped};

/// Reads the entities of a scenario.
pub(super) fn read(
    root: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Vec<Entity>, DecodeError> {
    let mut entities = Vec::new();
    let mut names = HashSet::new();
    for object in root.needed("Entities")?.elements() {
        if object.name() != "ScenarioObject" {
            skipped.add(object, "only objects by name are read");
            continue;
        }
        let name = object.needed_attribute("name")?.into_owned();
        if !names.insert(name.clone()) {
            return Err(object.fault(format!(
                "a second object with the name {}; expected one",
                xml::excerpt(&name)
            )));
        }
        let described = match object.first("CatalogReference") {
            Some(reference) => from_catalog(reference, catalogs, skipped)?,
            None => match object
                .elements()
                .find(|element| KINDS.contains(&element.name()))
            {
                Some(element) => Body::read(element, skipped)?,
                None => None,
            },
        };
        let Some(body) = described else {
            skipped.add(
                object,
                "it is neither a vehicle, a pedestrian nor an object",
            );
            continue;
        };
        entities.push(Entity {
            name,
            kind: body.kind,
            size: body.size,
            center_m: body.center_m,
            is_ego: body.is_ego,
            position: None,
            speed: None,
            route: Vec::new(),
            limits: body.limits,
        });
    }
    Ok(entities)
}

/// Elements that describe an object.
const KINDS: [&str; 3] = ["Vehicle", "Pedestrian", "MiscObject"];

/// Body of the entry that `reference` names; a car of usual size if the catalog is missing.
fn from_catalog(
    reference: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Body>, DecodeError> {
    let read = catalogs.with_entry(reference, skipped, |entry, skipped| {
        if KINDS.contains(&entry.name()) {
            Body::read(entry, skipped)
        } else {
            Ok(None)
        }
    })?;
    if let Some(body) = read {
        return Ok(body);
    }
    let file = format!("{}.xosc", reference.needed_attribute("catalogName")?);
    let entry = reference.needed_attribute("entryName")?;
    skipped.add(
        reference,
        &format!(
            "the catalog {} was not found: {} is a car of 4.5 m",
            xml::excerpt(&file),
            xml::excerpt(&entry)
        ),
    );
    Ok(Some(Body::CAR))
}

/// Kind and box of an object.
struct Body {
    kind: Option<RoadUser>,
    size: VehicleSize,
    center_m: f64,
    is_ego: bool,
    limits: Limits,
}

impl Body {
    const CAR: Self = Self {
        kind: Some(RoadUser::Car),
        size: VehicleSize::CAR,
        center_m: 1.4,
        is_ego: false,
        limits: Limits {
            speed_mps: None,
            acceleration_mps2: None,
            deceleration_mps2: None,
            acceleration_rate_mps3: None,
            deceleration_rate_mps3: None,
        },
    };

    /// Reads a `<Vehicle>`, `<Pedestrian>` or `<MiscObject>`; `None` for vehicles that do not drive
    /// on roads.
    fn read(element: Node, skipped: &mut Skipped) -> Result<Option<Self>, DecodeError> {
        let category = element
            .attribute("vehicleCategory")?
            .unwrap_or("car".into());
        let (kind, usual) = match element.name() {
            "Pedestrian" => match element.attribute("pedestrianCategory")?.as_deref() {
                None | Some("pedestrian" | "wheelchair") => {
                    (Some(RoadUser::Pedestrian), VehicleSize::PEDESTRIAN)
                }
                Some(_) => return Ok(None),
            },
            "MiscObject" => (None, VehicleSize::from_array([1.0, 1.0, 1.0])),
            _ => match &*category {
                "car" | "van" => (Some(RoadUser::Car), VehicleSize::CAR),
                "truck" | "semitrailer" => (
                    Some(RoadUser::Truck),
                    VehicleSize::from_array([8.0, 2.5, 3.4]),
                ),
                "bus" => (
                    Some(RoadUser::Bus),
                    VehicleSize::from_array([12.0, 2.55, 3.1]),
                ),
                "bicycle" | "motorbike" => (
                    Some(RoadUser::Cyclist),
                    VehicleSize::from_array([1.8, 0.7, 1.75]),
                ),
                _ => return Ok(None),
            },
        };
        if category == "motorbike" {
            skipped.add(element, "a motorbike drives like a cyclist");
        }
        if element.first("Trailer").is_some() {
            skipped.add(element, "its trailer is not read");
        }
        let outline = element.first("BoundingBox");
        let dimensions = outline.and_then(|outline| outline.first("Dimensions"));
        let mut size = usual.to_array();
        // A size decorates: one that is none does not keep a file from being driven.
        let mut faults = Vec::new();
        for (side_m, name) in size.iter_mut().zip(["length", "width", "height"]) {
            match dimensions.map(|dimensions| dimensions.number(name)) {
                Some(Ok(found_m)) if (0.1..=100.0).contains(&found_m) => *side_m = found_m,
                Some(Ok(found_m)) if kind.is_none() && found_m > 0.0 => {
                    *side_m = found_m.clamp(0.1, 1000.0);
                }
                Some(Ok(found_m)) => faults.push(format!("{name} is {found_m}, not 0.1 to 100 m")),
                Some(Err(_)) => faults.push(format!("{name} is no finite number")),
                None => faults.push(format!("{name} is missing")),
            }
        }
        if !faults.is_empty() {
            let [length_m, width_m, height_m] = size;
            let about = dimensions.unwrap_or(element);
            skipped.add(
                about,
                &format!(
                    "{}: its size is {length_m} x {width_m} x {height_m} m",
                    faults.join(", ")
                ),
            );
        }
        let center = outline.and_then(|outline| outline.first("Center"));
        let center_m = match center.map(|center| center.number_or("x", 0.0)) {
            Some(Ok(center_m)) => center_m.clamp(-50.0, 50.0),
            _ => 0.0,
        };
        let properties = element.first("Properties");
        let is_ego = properties
            .iter()
            .flat_map(|list| list.all("Property"))
            .filter(|property| property.element().attribute("name") == Some("type"))
            .any(|property| property.element().attribute("value") == Some("ego_vehicle"));
        Ok(Some(Self {
            kind,
            size: VehicleSize::from_array(size),
            center_m,
            is_ego,
            limits: limits(element),
        }))
    }
}

/// Limits in the `<Performance>` of a vehicle; what is no number above zero is none.
fn limits(vehicle: Node) -> Limits {
    let performance = vehicle.first("Performance");
    let of = |name: &str| {
        let found = performance?.number(name).ok()?;
        (found > 0.0).then_some(found)
    };
    Limits {
        speed_mps: of("maxSpeed"),
        acceleration_mps2: of("maxAcceleration"),
        deceleration_mps2: of("maxDeceleration"),
        // Changes of speed that files ask for have their own shapes.
        ..Limits::default()
    }
}
