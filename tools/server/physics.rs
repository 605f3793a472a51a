//! The ground service: boxes set on the captured ground.

use std::sync::{Arc, Mutex, PoisonError};

use decouplegs::asset::{AssetError, SceneFile, is_scene_file, open_scene, read_placed_splats};
use decouplegs::drive::register::grounding::set_on_ground;
use decouplegs::drive::{Ground, GroundGuides, GroundOptions, Survey};
use decouplegs::scene::{Pose, SplatCloud};
use glam::DVec3;
use tonic::{Request, Response, Status};

use crate::cache::Cache;
use crate::names::{check_name, no_scene};
use crate::options::Limits;
use crate::scene_registry::SceneRegistry;
use crate::sensorsim::version;
use decouplegs_alpasim::poses::{message_of, pose_of};
use decouplegs_alpasim::wire::common::{
    Aabb, AvailableScenesReturn, Empty, PoseAtTime, Trajectory, VersionId,
};
use decouplegs_alpasim::wire::physics::physics_ground_intersection_request::{
    EgoData, OtherObject,
};
use decouplegs_alpasim::wire::physics::physics_ground_intersection_return::{
    ReturnPose, Status as Outcome,
};
use decouplegs_alpasim::wire::physics::physics_service_server::PhysicsService;
use decouplegs_alpasim::wire::physics::{
    PhysicsGroundIntersectionRequest, PhysicsGroundIntersectionReturn,
};

/// A box that would be raised or lowered by more is left where it is, meters: as simulators' own
/// ground service does.
const TRANSLATION_MAX_M: f64 = 1.5;
/// A box that would be tilted by more is left as it is, radians: 10 degrees, as there.
const ROTATION_MAX_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// Largest side of a box, meters.
const SIDE_MAX_M: f32 = 100.0;
/// About what a splat takes in a ground, bytes.
const BYTES_A_SPLAT: u64 = 64;

/// The service.
#[derive(Clone)]
pub struct Physics {
    registry: Arc<SceneRegistry>,
    limits: Arc<Limits>,
    grounds: Arc<Mutex<Cache<Arc<LocalGround>>>>,
    /// Lock under which a ground is prepared: one at a time, and none twice.
    making: Arc<tokio::sync::Mutex<()>>,
}

/// The ground of a scene, asked in its local frame.
struct LocalGround {
    ground: Ground,
    origin: DVec3,
}

impl Physics {
    /// Grounds of the scenes of `registry`, as many as scenes in the cache.
    pub fn new(registry: Arc<SceneRegistry>, limits: Arc<Limits>) -> Self {
        let grounds = Arc::new(Mutex::new(Cache::new(
            limits.cache_size as usize,
            limits.cache_bytes,
        )));
        Self {
            registry,
            limits,
            grounds,
            making: Arc::default(),
        }
    }

    async fn ground_of(&self, id: &str) -> Result<Arc<LocalGround>, Status> {
        check_name(id, "scene_id")?;
        let path = self.registry.path(id).ok_or_else(|| no_scene(id))?;
        let known = || self.grounds.lock().unwrap_or_else(PoisonError::into_inner);
        let found = known().get(id).cloned();
        if let Some(found) = found {
            return Ok(found);
        }
        let _making = self.making.lock().await;
        let found = known().get(id).cloned();
        if let Some(found) = found {
            return Ok(found);
        }
        let path = path.to_owned();
        let read = move || -> Result<(LocalGround, u64), AssetError> {
            let Background {
                cloud,
                origin,
                way,
                survey,
            } = Background::open(&path)?;
            let mut ground = Ground::new(&cloud, origin, &GroundOptions::default());
            let way = way.as_ref();
            if way.is_some() || survey.is_some() {
                let of_way =
                    way.map(|(ego, height_m)| GroundGuides::for_way(ego.poses(), *height_m));
                let guides = GroundGuides {
                    survey: survey.as_ref(),
                    ..of_way.unwrap_or_default()
                };
                ground = ground.guided(&cloud, guides);
            }
            Ok((
                LocalGround { ground, origin },
                cloud.len() as u64 * BYTES_A_SPLAT,
            ))
        };
        let made = tokio::task::spawn_blocking(read)
            .await
            .map_err(|error| Status::internal(error.to_string()))?;
        let (ground, bytes) =
            made.map_err(|error| Status::failed_precondition(error.to_string()))?;
        let ground = Arc::new(ground);
        let mut grounds = known();
        while grounds.make_room(bytes).is_some() {}
        grounds.insert(id.to_owned(), Arc::clone(&ground), bytes);
        Ok(ground)
    }
}

/// Splats and recorded way of a scene.
struct Background {
    /// Splats, relative to the origin.
    cloud: SplatCloud,
    /// World coordinates, meters.
    origin: DVec3,
    /// Way of the recorded ego, and its height above the road, meters, where that is known.
    way: Option<(decouplegs::scene::Trajectory, Option<f64>)>,
    /// Points of the ground, where the scene has some.
    survey: Option<Survey>,
}

impl Background {
    fn open(path: &std::path::Path) -> Result<Self, AssetError> {
        if is_scene_file(path) {
            let file = SceneFile::read(path)?;
            let directory = path.parent().unwrap_or(std::path::Path::new(""));
            let background = read_placed_splats(&directory.join(&file.background))?;
            let survey = file.read_ground(directory, &background)?;
            return Ok(Self {
                survey: Survey::from_points(survey),
                cloud: background.cloud,
                origin: file.origin + background.origin,
                way: file.ego.map(|ego| (ego, file.ego_height_m)),
            });
        }
        let loaded = open_scene(path, 0.0)?;
        Ok(Self {
            survey: Survey::from_points(loaded.recording.ground_m),
            cloud: loaded.splat_scene.splats,
            origin: loaded.splat_scene.origin,
            way: Some((loaded.ego, loaded.ego_height_m)),
        })
    }
}

impl LocalGround {
    /// `pose`, that of the center of a box of `dims_m`, set on the ground: position from above and
    /// heading stay.
    fn set(&self, pose: &Pose, dims_m: [f64; 3]) -> (Pose, Outcome) {
        let world = Pose {
            translation: pose.translation + self.origin,
            ..*pose
        };
        let Some((plane, set)) = set_on_ground(&self.ground, &world, dims_m) else {
            return (*pose, Outcome::InsufficientPointsFitplane);
        };
        let bottom = world.transform(DVec3::new(0.0, 0.0, -0.5 * dims_m[2]));
        if (plane.height_m - bottom.z).abs() > TRANSLATION_MAX_M {
            return (*pose, Outcome::HighTranslation);
        }
        if (set.rotation * DVec3::Z).angle_between(pose.rotation * DVec3::Z) > ROTATION_MAX_RAD {
            return (*pose, Outcome::HighRotation);
        }
        (
            Pose {
                translation: set.translation - self.origin,
                ..set
            },
            Outcome::SuccessfulUpdate,
        )
    }
}

/// A box to be set on the ground.
struct Standing {
    pose: Pose,
    dims_m: [f64; 3],
}

fn dims_of(aabb: Option<&Aabb>, field: &str) -> Result<[f64; 3], Status> {
    let aabb = aabb.ok_or_else(|| Status::invalid_argument(format!("{field} is missing")))?;
    let sides_m = [aabb.size_x, aabb.size_y, aabb.size_z];
    if !sides_m
        .iter()
        .all(|side_m| *side_m > 0.0 && *side_m <= SIDE_MAX_M)
    {
        return Err(Status::invalid_argument(format!(
            "{field}: sides {sides_m:?} must be above 0 and at most {SIDE_MAX_M} m"
        )));
    }
    Ok(sides_m.map(f64::from))
}

fn ego_boxes(ego: Option<&EgoData>) -> Result<(Vec<Standing>, Vec<u64>), Status> {
    let Some(ego) = ego else {
        return Ok((Vec::new(), Vec::new()));
    };
    let dims_m = dims_of(ego.aabb.as_ref(), "ego_data.aabb")?;
    let poses = ego
        .ego_trajectory_aabb
        .iter()
        .flat_map(|trajectory| &trajectory.poses)
        .enumerate();
    let boxed = poses.map(|(index, timed)| {
        let field = format!("ego_data.ego_trajectory_aabb.poses[{index}].pose");
        Ok((
            Standing {
                pose: pose_of(timed.pose.as_ref(), &field)?,
                dims_m,
            },
            timed.timestamp_us,
        ))
    });
    Ok(boxed
        .collect::<Result<Vec<_>, Status>>()?
        .into_iter()
        .unzip())
}

fn other_boxes(others: &[OtherObject]) -> Result<Vec<Standing>, Status> {
    let of = |(index, other): (usize, &OtherObject)| {
        let field = format!("other_objects[{index}]");
        let future = other
            .pose_pair
            .as_ref()
            .and_then(|pair| pair.future_pose.as_ref());
        let pose = pose_of(future, &format!("{field}.pose_pair.future_pose"))?;
        Ok(Standing {
            pose,
            dims_m: dims_of(other.aabb.as_ref(), &format!("{field}.aabb"))?,
        })
    };
    others.iter().enumerate().map(of).collect()
}

#[tonic::async_trait]
impl PhysicsService for Physics {
    async fn ground_intersection(
        &self,
        request: Request<PhysicsGroundIntersectionRequest>,
    ) -> Result<Response<PhysicsGroundIntersectionReturn>, Status> {
        let request = request.into_inner();
        let (mut boxes, times_us) = ego_boxes(request.ego_data.as_ref())?;
        let others = other_boxes(&request.other_objects)?;
        let (count, most) = (boxes.len() + others.len(), self.limits.objects);
        if count > most {
            return Err(Status::resource_exhausted(format!(
                "other_objects: {count} poses in all, at most {most}"
            )));
        }
        let ground = self.ground_of(&request.scene_id).await?;
        boxes.extend(others);
        let set = move || {
            boxes
                .iter()
                .map(|each| ground.set(&each.pose, each.dims_m))
                .collect::<Vec<_>>()
        };
        let mut ego = tokio::task::spawn_blocking(set)
            .await
            .map_err(|error| Status::internal(error.to_string()))?;
        let others = ego.split_off(times_us.len());
        let timed = |((pose, _), timestamp_us): (&(Pose, Outcome), u64)| PoseAtTime {
            pose: Some(message_of(pose)),
            timestamp_us,
        };
        let returned = |(pose, outcome): (Pose, Outcome)| ReturnPose {
            pose: Some(message_of(&pose)),
            status: outcome.into(),
        };
        Ok(Response::new(PhysicsGroundIntersectionReturn {
            ego_status: ego.iter().map(|(_, outcome)| (*outcome).into()).collect(),
            ego_trajectory_aabb: Some(Trajectory {
                poses: ego.iter().zip(times_us).map(timed).collect(),
            }),
            other_poses: others.into_iter().map(returned).collect(),
        }))
    }

    async fn get_version(&self, _: Request<Empty>) -> Result<Response<VersionId>, Status> {
        Ok(Response::new(version()))
    }

    async fn get_available_scenes(
        &self,
        _: Request<Empty>,
    ) -> Result<Response<AvailableScenesReturn>, Status> {
        Ok(Response::new(AvailableScenesReturn {
            scene_ids: self.registry.ids(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use decouplegs::drive::register::grounding::corners;
    use glam::DVec2;

    use super::*;
    use glam::DQuat;

    /// A slope that rises by 5 % towards x, of discs at every quarter of a meter.
    fn slope() -> LocalGround {
        let positions: Vec<(f32, f32)> = (-60..60)
            .flat_map(|x| (-16..16).map(move |y| (0.25 * x as f32, 0.25 * y as f32)))
            .collect();
        let count = positions.len();
        let cloud = SplatCloud {
            means: positions.iter().map(|(x, y)| [*x, *y, 0.05 * x]).collect(),
            scales: vec![[0.2, 0.2, 0.005]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.9; count],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; count],
            sh_rest: vec![],
        };
        let origin = DVec3::new(500.0, 800.0, 90.0);
        LocalGround {
            ground: Ground::new(&cloud, origin, &GroundOptions::default()),
            origin,
        }
    }

    #[test]
    fn every_outcome_is_told() {
        let (slope, dims_m) = (slope(), [4.4, 1.8, 1.5]);
        let set = |x: f64, z: f64, roll_rad: f64| {
            slope.set(
                &Pose::new(DQuat::from_rotation_x(roll_rad), DVec3::new(x, 1.0, z)),
                dims_m,
            )
        };
        let (pose, outcome) = set(3.0, 1.1, 0.0);
        assert_eq!(
            (outcome, pose.translation.truncate()),
            (Outcome::SuccessfulUpdate, DVec2::new(3.0, 1.0))
        );
        for corner in corners(dims_m) {
            let wheel = pose.transform(corner.extend(-0.5 * dims_m[2]));
            assert!((wheel.z - 0.05 * wheel.x).abs() < 0.01, "{wheel}");
        }
        assert_eq!(set(3.0, 30.0, 0.0).1, Outcome::HighTranslation);
        assert_eq!(set(3.0, 0.9, 0.3).1, Outcome::HighRotation);
        let (pose, outcome) = set(100.0, 0.9, 0.0);
        assert_eq!(
            (outcome, pose.translation),
            (
                Outcome::InsufficientPointsFitplane,
                DVec3::new(100.0, 1.0, 0.9)
            )
        );
    }
}
