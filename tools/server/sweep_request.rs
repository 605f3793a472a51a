//! A request for a sweep of a LiDAR, checked.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, OnceLock};

use decouplegs::asset::{lidar_names, read_lidar};
use decouplegs::scene::lidar::{PointFrame, ReturnMode, ReturnOptions};
use decouplegs::scene::{Lidar, LidarModel, Motion, Pose};
use tonic::Status;

use crate::names::check_name;
use crate::options::Limits;
use crate::render_request::{PlacedObject, objects_of};
use decouplegs_alpasim::poses::pair_of;
use decouplegs_alpasim::wire::lidar::SweepRequest as NamedRequest;
use decouplegs_alpasim::wire::sensorsim::{
    DynamicObject, LidarDeviceType, LidarRenderRequest, PosePair,
};

/// Request for one sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepRequest {
    /// Id of the scene.
    pub scene: String,
    /// LiDAR and its motion, in the local frame.
    pub lidar: Lidar,
    /// Agents halfway through the sweep.
    pub objects: Vec<PlacedObject>,
    /// Options of the returns.
    pub options: ReturnOptions,
    /// Frame of the points.
    pub frame: PointFrame,
}

/// Models that come with the program, by name. Each is read once.
pub fn models() -> &'static BTreeMap<&'static str, Arc<LidarModel>> {
    static MODELS: OnceLock<BTreeMap<&'static str, Arc<LidarModel>>> = OnceLock::new();
    MODELS.get_or_init(|| {
        let model = |name: &'static str| {
            let read = read_lidar(Path::new(name));
            (
                name,
                Arc::new(read.expect("models that come with the program are good")),
            )
        };
        lidar_names().map(model).into_iter().collect()
    })
}

/// Fields that both kinds of requests have.
struct Common<'a> {
    scene_id: &'a str,
    frame_us: [u64; 2],
    sensor_pose: Option<&'a PosePair>,
    objects: &'a [DynamicObject],
}

impl SweepRequest {
    /// The request in `field` of a message (empty: the message itself).
    ///
    /// # Errors
    /// INVALID_ARGUMENT with the name of the field that is missing or makes no sense,
    /// RESOURCE_EXHAUSTED with the limit that it passes.
    pub fn from_request(
        request: &LidarRenderRequest,
        field: &str,
        limits: &Limits,
    ) -> Result<Self, Status> {
        let prefix = match field {
            "" => String::new(),
            _ => format!("{field}."),
        };
        let kind = request
            .lidar_config
            .as_ref()
            .map_or(0, |spec| spec.lidar_type);
        let name = match LidarDeviceType::try_from(kind) {
            Ok(LidarDeviceType::Pandar128) => "pandar128",
            Ok(LidarDeviceType::At128) => "at128",
            Err(_) => {
                return Err(Status::invalid_argument(format!(
                    "{prefix}lidar_config.lidar_type {kind} is unknown; expected PANDAR128 or AT128"
                )));
            }
        };
        let model = &models()[name];
        let common = Common {
            scene_id: &request.scene_id,
            frame_us: [request.frame_start_us, request.frame_end_us],
            sensor_pose: request.sensor_pose.as_ref(),
            objects: &request.dynamic_objects,
        };
        common.checked(name, model, &prefix, limits)
    }

    /// The request for a sweep of `model`.
    ///
    /// # Errors
    /// Returns the errors of [`SweepRequest::from_request`].
    pub fn from_named(
        request: &NamedRequest,
        model: &Arc<LidarModel>,
        limits: &Limits,
    ) -> Result<Self, Status> {
        let common = Common {
            scene_id: &request.scene_id,
            frame_us: [request.frame_start_us, request.frame_end_us],
            sensor_pose: request.sensor_pose.as_ref(),
            objects: &request.dynamic_objects,
        };
        let mut checked = common.checked(&request.logical_id, model, "", limits)?;
        checked.options.seed = request.seed;
        if !request.returns.is_empty() {
            let unknown = || {
                let names = ReturnMode::NAMED.map(|(name, _)| name).join(", ");
                Status::invalid_argument(format!("returns: expected one of {names}"))
            };
            checked.options.mode = ReturnMode::by_name(&request.returns).ok_or_else(unknown)?;
        }
        if request.opacity_threshold != 0.0 {
            let threshold = request.opacity_threshold;
            if !(threshold > 0.0 && threshold <= 1.0) {
                return Err(Status::invalid_argument(format!(
                    "opacity_threshold: {threshold}; expected above 0 and at most 1"
                )));
            }
            checked.options.opacity_min = threshold;
        }
        checked.frame = match request.frame.as_str() {
            "" | "end" => PointFrame::End,
            "start" => PointFrame::Start,
            "raw" => PointFrame::Raw,
            "local" => PointFrame::World,
            _ => {
                return Err(Status::invalid_argument(
                    "frame: expected raw, start, end or local",
                ));
            }
        };
        Ok(checked)
    }
}

impl Common<'_> {
    /// The request for a sweep of `model`, in the sensor's frame at the end of the sweep.
    fn checked(
        &self,
        name: &str,
        model: &Arc<LidarModel>,
        prefix: &str,
        limits: &Limits,
    ) -> Result<SweepRequest, Status> {
        check_name(self.scene_id, &format!("{prefix}scene_id"))?;
        let [start_us, end_us] = self.frame_us;
        if end_us < start_us {
            return Err(Status::invalid_argument(format!(
                "{prefix}frame_end_us is before {prefix}frame_start_us"
            )));
        }
        // The poses are those at both ends of the sweep, however long the model takes for it.
        let duration_s = match end_us - start_us {
            0 => 0.0,
            _ => model.sweep_s,
        };
        let (start, end) = pair_of(self.sensor_pose, &format!("{prefix}sensor_pose"))?;
        let field = format!("{prefix}dynamic_objects");
        Ok(SweepRequest {
            scene: self.scene_id.to_owned(),
            lidar: Lidar {
                name: name.to_owned(),
                model: model.clone(),
                rig_from_lidar: Pose::IDENTITY,
                world_from_rig: start,
                motion: match duration_s {
                    0.0 => Motion::REST,
                    _ => Motion::between(&start, &end, duration_s),
                },
            },
            objects: objects_of(self.objects, duration_s, &field, limits)?,
            options: ReturnOptions::for_model(model),
            frame: PointFrame::End,
        })
    }
}
