//! The ego's way and cameras as others read them.

use decouplegs_scene::{Intrinsics, Pose, ShutterDirection, Trajectory};
use glam::{DMat4, DVec3};
use serde_json::{Map, Value, json};

use super::{
    BEFORE_FRAMES_S, DURATION_MAX_S, EXPOSURE_S, PackOptions, SAMPLES_HZ, STANDING_S, START_S,
};
use crate::SceneFile;
use crate::camera_model::model;

/// First and last moment of a scene, seconds.
pub(super) fn span_of(scene: &SceneFile) -> Result<(f64, f64), String> {
    let ways = || {
        scene
            .ego
            .iter()
            .chain(scene.agents.iter().map(|agent| &agent.trajectory))
    };
    // The ego's way is the scene's; without one, whatever moves.
    let (start_s, end_s) = match &scene.ego {
        Some(ego) if ego.end_s() > ego.start_s() => (ego.start_s(), ego.end_s()),
        _ => ways().fold((0.0, 0.0), |(start, end): (f64, f64), way| {
            (start.min(way.start_s()), end.max(way.end_s()))
        }),
    };
    let end_s = if end_s > start_s {
        end_s
    } else {
        start_s + STANDING_S
    };
    if end_s - start_s > DURATION_MAX_S || start_s.abs() > DURATION_MAX_S {
        return Err(format!(
            "the scene lasts from {start_s} to {end_s} s; a package lasts at most {DURATION_MAX_S} s, and begins within as many of 0"
        ));
    }
    Ok((start_s, end_s))
}

/// Whole seconds that a package adds to the times of a scene that begins at `start_s`.
pub(super) fn offset_of(start_s: f64) -> f64 {
    (START_S - start_s).ceil().max(0.0)
}

/// Microseconds of a package for a moment of a scene whose times it offsets.
pub(super) fn package_us(time_s: f64, offset_s: f64) -> u64 {
    ((time_s + offset_s) * 1e6).round() as u64
}

/// Moments from `start_s` to `end_s`, both included, as seconds of the scene and microseconds of
/// the package that rise.
pub(super) fn moments(start_s: f64, end_s: f64, offset_s: f64) -> Vec<(f64, u64)> {
    let steps = ((end_s - start_s) * SAMPLES_HZ).ceil().max(1.0) as usize;
    let mut moments: Vec<(f64, u64)> = (0..=steps)
        .map(|step| (start_s + step as f64 / SAMPLES_HZ).min(end_s))
        .map(|time_s| (time_s, package_us(time_s, offset_s)))
        .collect();
    moments.dedup_by_key(|(_, time_us)| *time_us);
    moments
}

/// `pose` as rows of a matrix.
pub(super) fn rows(pose: &Pose) -> Value {
    let matrix = DMat4::from_rotation_translation(pose.rotation, pose.translation).transpose();
    json!(matrix.to_cols_array_2d())
}

/// `rig_trajectories.json`.
pub(super) fn rig_trajectories(
    scene: &SceneFile,
    options: &PackOptions,
    span_s: (f64, f64),
) -> Value {
    let standing = Trajectory::standing(Pose {
        translation: scene.origin,
        ..Pose::IDENTITY
    });
    let ego = scene.ego.as_ref().unwrap_or(&standing);
    let moments = moments(span_s.0, span_s.1, offset_of(span_s.0));
    let local_from_rig = |time_s: f64| {
        let pose = ego.at(time_s);
        Pose {
            translation: pose.transform(options.rig_origin_m) - scene.origin,
            ..pose
        }
    };
    let mut calibrations = Map::new();
    let mut frames = Map::new();
    // A frame lasts as long as its readout or exposure, around its moment.
    let frame_times = |intrinsics: &Intrinsics| -> Vec<[u64; 2]> {
        let size_px = [intrinsics.width_px, intrinsics.height_px];
        let readout_s = match intrinsics.shutter.direction() {
            ShutterDirection::Global => EXPOSURE_S,
            _ => intrinsics.shutter.readout_s(size_px),
        };
        let readout_us = ((1e6 * readout_s).round() as u64).max(2);
        let (first_us, last_us) = (moments[0].1, moments[moments.len() - 1].1);
        let frame = |&(_, time_us): &(f64, u64)| {
            let start_us = time_us.saturating_sub(readout_us / 2);
            [start_us, start_us + readout_us]
        };
        let earliest_us = first_us + (1e6 * BEFORE_FRAMES_S) as u64;
        let is_known =
            |[start_us, end_us]: &[u64; 2]| *start_us >= earliest_us && *end_us <= last_us;
        let mut frames: Vec<[u64; 2]> = moments.iter().map(frame).filter(is_known).collect();
        if frames.is_empty() {
            // A scene too short for a frame with room before it has one at its end.
            frames.push([last_us.saturating_sub(readout_us).max(first_us), last_us]);
        }
        frames
    };
    for (index, camera) in scene.rig.cameras().enumerate() {
        let key = format!("{}@{}", camera.name, options.scene_id);
        let Pose {
            rotation,
            translation,
        } = camera.rig_from_camera;
        let rig_from_sensor = Pose {
            rotation,
            translation: translation - options.rig_origin_m,
        };
        let calibration = json!({
            "sequence_id": options.scene_id,
            "logical_sensor_name": camera.name,
            "unique_sensor_idx": index,
            // Rig from sensor, as its readers multiply it.
            "T_sensor_rig": rows(&rig_from_sensor),
            "camera_model": model(&camera.intrinsics),
        });
        calibrations.insert(key.clone(), calibration);
        frames.insert(key, json!(frame_times(&camera.intrinsics)));
    }
    let middle = DVec3::ZERO - options.rig_origin_m;
    let worlds: Vec<Value> = moments
        .iter()
        .map(|&(time_s, _)| rows(&local_from_rig(time_s)))
        .collect();
    let times: Vec<u64> = moments.iter().map(|&(_, time_us)| time_us).collect();
    json!({
        "T_world_base": rows(&earth_from_local(scene, options)),
        "world_to_nre": {"matrix": rows(&Pose::IDENTITY)},
        "camera_calibrations": calibrations,
        "lidar_calibrations": {},
        "rig_trajectories": [{
            "sequence_id": options.scene_id,
            "T_rig_world_timestamps_us": times,
            "T_rig_worlds": worlds,
            "cameras_frame_timestamps_us": frames,
            "lidars_frame_timestamps_us": {},
            "rig_bbox": {
                "centroid": middle.to_array(),
                "dim": options.vehicle.to_array(),
                "rot": [0.0, 0.0, 0.0],
            },
        }],
    })
}

/// Earth-centered from local coordinates where the map says where on Earth it is; else the position
/// of the origin in the world.
fn earth_from_local(scene: &SceneFile, options: &PackOptions) -> Pose {
    let in_world = Pose {
        translation: scene.origin,
        ..Pose::IDENTITY
    };
    let position = options.map.as_deref().and_then(geographic_origin);
    position.map_or(in_world, |(latitude_deg, longitude_deg)| {
        earth_from_east_north_up(latitude_deg, longitude_deg).then(&in_world)
    })
}

/// Latitude and longitude of a map's origin, of its `geoReference` in PROJ's words.
pub(super) fn geographic_origin(map: &[u8]) -> Option<(f64, f64)> {
    let text = std::str::from_utf8(map).ok()?;
    let (_, behind) = text.split_once("<geoReference>")?;
    let (reference, _) = behind.split_once("</geoReference>")?;
    let value = |name: &str| {
        let (_, behind) = reference.split_once(name)?;
        behind
            .split(|c: char| c.is_whitespace() || c == ']')
            .next()?
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
    };
    Some((value("+lat_0=")?, value("+lon_0=")?))
        .filter(|(latitude_deg, _)| latitude_deg.abs() <= 90.0)
}

/// Directions of east, north and up at a position on WGS 84, in Earth-centered coordinates, meters.
pub(super) fn earth_from_east_north_up(latitude_deg: f64, longitude_deg: f64) -> Pose {
    const EQUATOR_M: f64 = 6_378_137.0;
    const FLATTENING: f64 = 1.0 / 298.257_223_563;
    let (latitude, longitude) = (latitude_deg.to_radians(), longitude_deg.to_radians());
    let eccentricity_squared = FLATTENING * (2.0 - FLATTENING);
    let normal_m = EQUATOR_M / (1.0 - eccentricity_squared * latitude.sin().powi(2)).sqrt();
    let up = DVec3::new(
        latitude.cos() * longitude.cos(),
        latitude.cos() * longitude.sin(),
        latitude.sin(),
    );
    let east = DVec3::new(-longitude.sin(), longitude.cos(), 0.0);
    let position = DVec3::new(up.x, up.y, up.z * (1.0 - eccentricity_squared)) * normal_m;
    Pose::new(
        glam::DQuat::from_mat3(&glam::DMat3::from_cols(east, up.cross(east), up)),
        position,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::RigCamera;

    #[test]
    fn moments_rise_and_hold_both_ends() {
        assert_eq!(
            moments(0.0, 0.25, 1.0)
                .iter()
                .map(|moment| moment.1)
                .collect::<Vec<_>>(),
            [1_000_000, 1_100_000, 1_200_000, 1_250_000]
        );
        assert_eq!(moments(1.0, 1.0, 0.0).len(), 1);
    }

    #[test]
    fn packages_begin_at_one_second_or_later() {
        for (start_s, offset_s) in [(0.0, 1.0), (0.25, 1.0), (1.0, 0.0), (7.5, 0.0), (-3.2, 5.0)] {
            assert_eq!(offset_of(start_s), offset_s, "{start_s}");
        }
    }

    /// AlpaSim at 3032e0c, with the defaults of `src/wizard/configs/base_config.yaml` (shutter
    /// 30 ms, control step 100 ms), subtracts both from the end of the first frame and from the
    /// first pose: `unbound_rollout.py:88-94`, `event_loop.py:236`.
    #[test]
    fn times_leave_room_for_a_shutter_and_a_control_step() {
        let front = RigCamera {
            name: "front".into(),
            intrinsics: Intrinsics::from_horizontal_fov(640, 360, 1.1),
            rig_from_camera: Pose::IDENTITY,
        };
        let mut scene = SceneFile::of_background("none.ply");
        scene.rig = [front].into_iter().collect();
        let at = |time_s: f64| decouplegs_scene::TimedPose {
            time_s,
            pose: Pose::IDENTITY,
        };
        for end_s in [0.1, 4.0] {
            scene.ego = Some(Trajectory::new(vec![at(0.0), at(end_s)]).unwrap());
            let span_s = span_of(&scene).unwrap();
            let json = rig_trajectories(&scene, &PackOptions::new("place"), span_s);
            let way = &json["rig_trajectories"][0];
            let times = way["T_rig_world_timestamps_us"].as_array().unwrap();
            let (first_us, last_us) = (
                times[0].as_i64().unwrap(),
                times[times.len() - 1].as_i64().unwrap(),
            );
            let frames = way["cameras_frame_timestamps_us"]["front@place"]
                .as_array()
                .unwrap();
            assert!(
                first_us - 100_000 >= 0,
                "a control step before the first pose"
            );
            let [start_us, end_us] = [0, 1].map(|part| frames[0][part].as_i64().unwrap());
            assert!(
                end_us - 30_000 >= first_us,
                "a shutter before the first frame"
            );
            for frame in frames {
                let [start_us, end_us] = [0, 1].map(|part| frame[part].as_i64().unwrap());
                assert!(first_us <= start_us && end_us <= last_us);
                assert!(end_us - start_us == 30_000, "{frame}");
            }
            if end_s > 1.0 {
                assert!(start_us >= first_us + 200_000 && end_us < first_us + 400_000);
            }
        }
    }

    #[test]
    fn a_place_on_earth_is_read_and_found() {
        let map = b"<header><geoReference><![CDATA[+proj=tmerc +lat_0=0.0 +lon_0=90 +k=1]]></geoReference></header>";
        assert_eq!(geographic_origin(map), Some((0.0, 90.0)));
        assert_eq!(geographic_origin(b"<header/>"), None);
        let pose = earth_from_east_north_up(0.0, 90.0);
        assert!((pose.translation - DVec3::new(0.0, 6_378_137.0, 0.0)).length() < 1e-6);
        // East of there points to the west of Greenwich, north to the pole.
        assert!((pose.rotation * DVec3::X + DVec3::X).length() < 1e-12);
        assert!((pose.rotation * DVec3::Y - DVec3::Z).length() < 1e-12);
        let pole = earth_from_east_north_up(90.0, 0.0);
        assert!((pole.translation.z - 6_356_752.314_2).abs() < 1e-3);
    }
}
