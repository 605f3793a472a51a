//! The names under which services are found: releases of the contract have moved them from package
//! to package.

use tonic::Status;

/// The camera service, as this program's own messages call it.
pub const SENSORSIM: &str = "nre.grpc.protos.sensorsim.SensorsimService";
/// Other names of the camera service.
pub const SENSORSIM_ALSO: [&str; 2] = [
    "sensorsim.SensorsimService",
    "nurec.grpc.protos.sensorsim.SensorsimService",
];
/// The ground service, as this program's own messages call it.
pub const PHYSICS: &str = "physics.PhysicsService";
/// Other names of the ground service.
pub const PHYSICS_ALSO: [&str; 2] = [
    "nre.grpc.protos.physics.PhysicsService",
    "nurec.grpc.protos.physics.PhysicsService",
];
/// The LiDAR service, our own.
pub const LIDAR: &str = "decouplegs.Lidar";
/// The health service.
pub const HEALTH: &str = "grpc.health.v1.Health";

/// The version of the contract that is spoken.
pub const CONTRACT_VERSION: [u32; 3] = [0, 54, 0];

/// Methods that are counted by name; any other is counted as `other`.
const METHODS: [(&str, &str); 17] = [
    (SENSORSIM, "render_rgb"),
    (SENSORSIM, "render_lidar"),
    (SENSORSIM, "render_aggregated"),
    (SENSORSIM, "batch_render_rgb"),
    (SENSORSIM, "get_version"),
    (SENSORSIM, "get_available_scenes"),
    (SENSORSIM, "get_loaded_scenes"),
    (SENSORSIM, "get_available_cameras"),
    (SENSORSIM, "get_available_trajectories"),
    (SENSORSIM, "get_available_ego_masks"),
    (LIDAR, "get_available_lidars"),
    (LIDAR, "render_sweep"),
    (PHYSICS, "ground_intersection"),
    (PHYSICS, "get_version"),
    (PHYSICS, "get_available_scenes"),
    (HEALTH, "Check"),
    (HEALTH, "Watch"),
];

/// Most bytes of a name that a client sends: of a scene, a camera or an object.
pub const NAME_BYTES_MAX: usize = 256;
/// Characters of a client's name that are repeated in a status.
const SHOWN_CHARS_MAX: usize = 60;

/// Checks a client's `name` in `field`. Names are kept and logged, so their length is bounded.
///
/// # Errors
/// INVALID_ARGUMENT with the field and the limit.
pub fn check_name(name: &str, field: &str) -> Result<(), Status> {
    match name.len() {
        0 => Err(Status::invalid_argument(format!("{field} is empty"))),
        1..=NAME_BYTES_MAX => Ok(()),
        bytes => Err(Status::invalid_argument(format!(
            "{field} has {bytes} bytes; at most {NAME_BYTES_MAX} are read"
        ))),
    }
}

/// NOT_FOUND for the scene `id`.
#[must_use]
pub fn no_scene(id: &str) -> Status {
    let shown: String = id.chars().take(SHOWN_CHARS_MAX).collect();
    Status::not_found(format!(
        "scene_id: there is no scene {shown:?}; get_available_scenes lists them"
    ))
}

/// Destination of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Destination {
    /// The path of the service as this program calls it; `None`: the path is that already, or
    /// unknown.
    pub path: Option<String>,
    /// The name that it is counted under.
    pub counted_as: &'static str,
    /// True if it is a health check, which needs no token.
    pub is_health: bool,
}

/// Destination of a request to `path`, `/package.Service/method`.
#[must_use]
pub fn destination_of(path: &str) -> Destination {
    let Some((asked, method)) = path.strip_prefix('/').and_then(|path| path.split_once('/')) else {
        return Destination {
            path: None,
            counted_as: "other",
            is_health: false,
        };
    };
    let service = if SENSORSIM_ALSO.contains(&asked) {
        SENSORSIM
    } else if PHYSICS_ALSO.contains(&asked) {
        PHYSICS
    } else {
        asked
    };
    let known = METHODS.iter().find(|known| **known == (service, method));
    Destination {
        path: (service != asked).then(|| format!("/{service}/{method}")),
        counted_as: known.map_or("other", |(_, method)| method),
        is_health: service == HEALTH,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_names_lead_to_one_service() {
        for name in SENSORSIM_ALSO {
            let destination = destination_of(&format!("/{name}/render_rgb"));
            assert_eq!(
                destination.path.as_deref(),
                Some("/nre.grpc.protos.sensorsim.SensorsimService/render_rgb")
            );
            assert_eq!(destination.counted_as, "render_rgb");
        }
        let own = destination_of("/physics.PhysicsService/ground_intersection");
        assert_eq!(
            own,
            Destination {
                path: None,
                counted_as: "ground_intersection",
                is_health: false
            }
        );
        assert!(destination_of("/grpc.health.v1.Health/Check").is_health);
    }

    #[test]
    fn long_names_are_refused_and_not_repeated() {
        check_name("car", "track_id").unwrap();
        check_name(&"x".repeat(256), "track_id").unwrap();
        for name in [String::new(), "x".repeat(257), "\u{1}".repeat(15 << 20)] {
            let status = check_name(&name, "track_id").unwrap_err();
            assert!(
                status.message().starts_with("track_id") && status.message().len() < 100,
                "{status}"
            );
        }
        assert!(no_scene(&"\u{1}".repeat(256)).message().len() < 1000);
    }

    #[test]
    fn what_is_unknown_stays_as_it_is() {
        for path in [
            "",
            "/",
            "x",
            "/x",
            "/sensorsim/x",
            "/nre.grpc.protos.sensorsim.SensorsimService/paint",
        ] {
            assert_eq!(
                destination_of(path),
                Destination {
                    path: None,
                    counted_as: "other",
                    is_health: false
                }
            );
        }
        assert_eq!(
            destination_of("/sensorsim.SensorsimService/edit_assets").counted_as,
            "other"
        );
    }
}
