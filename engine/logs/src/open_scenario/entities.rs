//! Vehicles and pedestrians, and the catalogs that describe them.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use decouplegs_scene::{RoadUser, VehicleSize};

use super::{Entity, Skipped};
use decouplegs_asset::DecodeError;
use decouplegs_asset::xml::{self, Element};

/// Reads the entities of a scenario.
pub(super) fn read(
    root: Element,
    read_file: &impl Fn(&Path) -> Option<Vec<u8>>,
    skipped: &mut Skipped,
) -> Result<Vec<Entity>, DecodeError> {
    let catalogs = Catalogs {
        locations: locations(root)?,
        read_file,
    };
    let mut entities = Vec::new();
    let mut names = HashSet::new();
    for object in root.needed("Entities")?.elements() {
        if object.name() != "ScenarioObject" {
            skipped.add(object, "only objects by name are read");
            continue;
        }
        let name = object.needed_attribute("name")?;
        if !names.insert(name) {
            return Err(object.fault(format!(
                "a second object with the name {}; expected one",
                xml::excerpt(name)
            )));
        }
        let described = match object.first("CatalogReference") {
            Some(reference) => catalogs.described(reference, skipped)?,
            None => match description(object) {
                Some(element) => Body::read(element, skipped)?,
                None => None,
            },
        };
        let Some(Body {
            kind,
            size,
            center_m,
        }) = described
        else {
            skipped.add(object, "it is neither a vehicle nor a pedestrian");
            continue;
        };
        entities.push(Entity {
            name: name.to_owned(),
            kind,
            size,
            center_m,
            position: None,
            speed: None,
            route: Vec::new(),
            events: Vec::new(),
        });
    }
    Ok(entities)
}

/// Description of an object in a scenario or catalog.
fn description(parent: Element) -> Option<Element> {
    ["Vehicle", "Pedestrian"]
        .into_iter()
        .find_map(|name| parent.first(name))
}

/// Folders of catalogs with vehicles and pedestrians.
fn locations(root: Element) -> Result<Vec<PathBuf>, DecodeError> {
    let Some(list) = root.first("CatalogLocations") else {
        return Ok(Vec::new());
    };
    let kinds = ["VehicleCatalog", "PedestrianCatalog"];
    let directories = list
        .elements()
        .filter(|element| kinds.contains(&element.name()))
        .filter_map(|element| element.first("Directory"));
    directories
        .map(|directory| {
            Ok(directory
                .needed_attribute("path")?
                .replace('\\', "/")
                .into())
        })
        .collect()
}

/// Catalogs that a scenario refers to.
struct Catalogs<'a, F> {
    locations: Vec<PathBuf>,
    read_file: &'a F,
}

impl<F: Fn(&Path) -> Option<Vec<u8>>> Catalogs<'_, F> {
    /// Body of the entry that `reference` names; a car of usual size if the catalog is missing.
    fn described(
        &self,
        reference: Element,
        skipped: &mut Skipped,
    ) -> Result<Option<Body>, DecodeError> {
        let (catalog, entry) = (
            reference.needed_attribute("catalogName")?,
            reference.needed_attribute("entryName")?,
        );
        let file = format!("{catalog}.xosc");
        // A name, not a path: a reference does not lead out of the catalogs' folders.
        let is_name = !catalog.contains(['/', '\\']);
        let found = self
            .locations
            .iter()
            .filter(|_| is_name)
            .find_map(|folder| (self.read_file)(&folder.join(&file)));
        let Some(bytes) = found else {
            let (file, entry) = (xml::excerpt(&file), xml::excerpt(entry));
            skipped.add(
                reference,
                &format!("the catalog {file} was not found: {entry} is a car of 4.5 m"),
            );
            return Ok(Some(Body::CAR));
        };
        let within = |error: DecodeError| {
            reference.fault(format!("in the catalog {}: {error}", xml::excerpt(&file)))
        };
        let text = super::parameters::substituted(&bytes).map_err(within)?;
        let document = xml::parse(text.as_bytes()).map_err(within)?;
        let catalog = Element::root(&document, "OpenSCENARIO")
            .and_then(|root| root.needed("Catalog"))
            .map_err(within)?;
        let described = catalog
            .elements()
            .find(|element| element.attribute("name") == Some(entry))
            .ok_or_else(|| {
                reference.fault(format!(
                    "the catalog {} has no entry {}",
                    xml::excerpt(&file),
                    xml::excerpt(entry)
                ))
            })?;
        match described.name() {
            "Vehicle" | "Pedestrian" => Body::read(described, skipped).map_err(within),
            _ => Ok(None),
        }
    }
}

/// Kind and box of an object.
struct Body {
    kind: RoadUser,
    size: VehicleSize,
    center_m: f64,
}

impl Body {
    const CAR: Self = Self {
        kind: RoadUser::Car,
        size: VehicleSize::CAR,
        center_m: 1.4,
    };

    /// Reads a `<Vehicle>` or `<Pedestrian>`; `None` for vehicles that do not drive on roads.
    fn read(element: Element, skipped: &mut Skipped) -> Result<Option<Self>, DecodeError> {
        let kind = if element.name() == "Pedestrian" {
            match element.attribute("pedestrianCategory") {
                None | Some("pedestrian") => RoadUser::Pedestrian,
                Some(_) => return Ok(None),
            }
        } else {
            match element.attribute("vehicleCategory").unwrap_or("car") {
                "car" | "van" => RoadUser::Car,
                "truck" | "semitrailer" => RoadUser::Truck,
                "bus" => RoadUser::Bus,
                "bicycle" | "motorbike" => RoadUser::Cyclist,
                _ => return Ok(None),
            }
        };
        if element.attribute("vehicleCategory") == Some("motorbike") {
            skipped.add(element, "a motorbike drives like a cyclist");
        }
        if element.first("Trailer").is_some() {
            skipped.add(element, "its trailer is not read");
        }
        let outline = element.needed("BoundingBox")?;
        let dimensions = outline.needed("Dimensions")?;
        let side = |name: &str| {
            let side_m = dimensions.number(name)?;
            if (0.1..=100.0).contains(&side_m) {
                return Ok(side_m);
            }
            Err(dimensions.fault(format!("{name} is {side_m}; expected 0.1 to 100 m")))
        };
        let size = [side("length")?, side("width")?, side("height")?];
        let center_m = match outline.first("Center") {
            Some(center) => center.number_or("x", 0.0)?.clamp(-50.0, 50.0),
            None => 0.0,
        };
        Ok(Some(Self {
            kind,
            size: VehicleSize::from_array(size),
            center_m,
        }))
    }
}
