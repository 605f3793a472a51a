//! The lanes of a package, in the world of its scene.

use std::path::Path;

use decouplegs_scene::LaneMap;
use glam::DVec3;
use serde::Deserialize;

use super::SCENE;
use super::read::NAME;
use super::rig::{earth_from_east_north_up, geographic_origin};
use crate::error::read_bytes;
use crate::maps::open_drive;
use crate::rigid::pose_of_rows;
use crate::zip::Archive;
use crate::{AssetError, DecodeError};

/// Entry of the map: OpenDRIVE.
pub(super) const MAP: &str = "map.xodr";
/// Entry that says where on Earth the world is.
const RIG: &str = "rig_trajectories.json";
/// Most bytes of an entry.
const BYTES_MAX: u64 = 256 << 20;
/// Largest tilt between the map's vertical and the world's, cosine: ten degrees.
const UPRIGHT_MIN: f64 = 0.985;

#[derive(Deserialize)]
struct Place {
    #[serde(rename = "T_world_base")]
    earth_from_world: Option<[[f64; 4]; 4]>,
}

/// The lanes of the package at `path`; `None` if it has no map.
///
/// # Errors
/// [`AssetError`] if the package, the map or its place cannot be read.
pub fn read_packed_lanes(path: &Path) -> Result<Option<LaneMap>, AssetError> {
    let bytes = read_bytes(path)?;
    let has_map = Archive::parse(&bytes).map(|archive| archive.has(MAP));
    let lanes = has_map.and_then(|has_map| has_map.then(|| decode(&bytes)).transpose());
    lanes.map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: NAME,
        source,
    })
}

/// Reads the lanes of the package in `bytes`. Packages of this program hold them in the coordinates
/// of their scene; others in those of the map, which its `geoReference` puts on Earth as
/// `T_world_base` puts the world there.
///
/// # Errors
/// [`DecodeError`] if there is no map, or it or its place cannot be read.
pub(crate) fn decode(bytes: &[u8]) -> Result<LaneMap, DecodeError> {
    let archive = Archive::parse(bytes)?;
    if !archive.has(MAP) {
        return Err(DecodeError::Malformed(format!(
            "the package has no '{MAP}': give a map of its own"
        )));
    }
    let map = archive.checked(MAP, BYTES_MAX)?;
    let lanes = open_drive::decode(&map)?;
    if archive.has(SCENE) {
        return Ok(lanes);
    }
    let Some((latitude_deg, longitude_deg)) = geographic_origin(&map) else {
        return Ok(lanes);
    };
    let place: Place = serde_json::from_slice(&archive.checked(RIG, BYTES_MAX)?)
        .map_err(|error| DecodeError::Malformed(format!("{RIG}: {error}")))?;
    let Some(rows) = place.earth_from_world else {
        return Ok(lanes);
    };
    let earth_from_map = earth_from_east_north_up(latitude_deg, longitude_deg);
    let earth_from_world = pose_of_rows(&rows).ok_or_else(|| {
        DecodeError::Malformed(format!(
            "{RIG}: T_world_base is no rotation and translation"
        ))
    })?;
    let world_from_map = earth_from_world.inverse().then(&earth_from_map);
    if (world_from_map.rotation * DVec3::Z).z < UPRIGHT_MIN {
        return Err(DecodeError::Malformed(format!(
            "the map's geoReference and T_world_base of {RIG} are far apart: its lanes would not lie flat; give a map of its own"
        )));
    }
    Ok(lanes.placed(&world_from_map))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::zip::StoredZip;
    use decouplegs_scene::Pose;
    use glam::DQuat;

    const ROAD: &str = r#"<OpenDRIVE><header><geoReference>+proj=tmerc +lat_0=49 +lon_0=8</geoReference></header>
        <road id="1" length="9"><planView><geometry s="0" x="0" y="0" hdg="0" length="9"><line/></geometry></planView>
        <lanes><laneSection s="0"><right><lane id="-1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right></laneSection></lanes></road></OpenDRIVE>"#;

    fn package(entries: &[(&str, &[u8])]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut zip = StoredZip::new(&mut bytes);
        for (name, content) in entries {
            zip.add(name, content).unwrap();
        }
        zip.finish().unwrap();
        bytes
    }

    #[test]
    fn lanes_of_others_are_where_both_places_on_earth_put_them() {
        // A world whose origin is 100 m east and 20 m north of the map's, turned by 90 degrees.
        let map_from_world = Pose::new(
            DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2),
            DVec3::new(100.0, 20.0, 0.0),
        );
        let earth_from_world = earth_from_east_north_up(49.0, 8.0).then(&map_from_world);
        let rows = super::super::rig::rows(&earth_from_world);
        let rig = serde_json::json!({"T_world_base": rows}).to_string();
        let lanes = decode(&package(&[
            ("map.xodr", ROAD.as_bytes()),
            ("rig_trajectories.json", rig.as_bytes()),
        ]))
        .unwrap();
        let line = &lanes.lanes[0].centerline;
        // The middle of the lane is 2 m right of the map's x axis.
        let expected = map_from_world
            .inverse()
            .transform(DVec3::new(9.0, -2.0, 0.0));
        let last = line[line.len() - 1];
        assert!(
            (last.truncate() - expected.truncate()).length() < 1e-6,
            "{last}"
        );
        // Packages of this program have the coordinates of their scene.
        let own = decode(&package(&[
            ("decouplegs/scene.toml", b""),
            ("map.xodr", ROAD.as_bytes()),
        ]))
        .unwrap();
        let last = own.lanes[0].centerline[own.lanes[0].centerline.len() - 1];
        assert!(
            (last - DVec3::new(9.0, -2.0, 0.0)).length() < 1e-6,
            "{last}"
        );
    }

    #[test]
    fn a_package_without_lanes_says_so() {
        let none = decode(&package(&[("a.txt", b"")])).unwrap_err().to_string();
        assert!(none.contains("map.xodr"), "{none}");
        let rig = br#"{"T_world_base": [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#;
        let wrong = decode(&package(&[
            ("map.xodr", ROAD.as_bytes()),
            ("rig_trajectories.json", rig),
        ]));
        assert!(wrong.unwrap_err().to_string().contains("T_world_base"));
        // The identity stands for no place at all, a tangent plane elsewhere.
        let rig = br#"{"T_world_base": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#;
        let far = decode(&package(&[
            ("map.xodr", ROAD.as_bytes()),
            ("rig_trajectories.json", rig),
        ]));
        assert!(far.unwrap_err().to_string().contains("far apart"));
    }
}
