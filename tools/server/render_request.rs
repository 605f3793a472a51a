//! A request for an image, checked: what is seen, from where, and how it is to be stored.

use std::collections::HashSet;

use decouplegs::scene::{Intrinsics, Motion, Pose, Rig};
use tonic::Status;

use crate::ego_masks::MaskName;
use crate::names::check_name;
use crate::options::Limits;
use decouplegs_alpasim::camera_spec::{intrinsics_of, shutter_of};
use decouplegs_alpasim::encoding::Encoding;
use decouplegs_alpasim::poses::middle_of;
use decouplegs_alpasim::wire::sensorsim::{DynamicObject, RgbRenderRequest};

/// An agent where a request puts it, in the local frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedObject {
    /// The agent's name.
    pub track_id: String,
    /// Pose of the center of its box at mid-shutter.
    pub pose: Pose,
    /// Motion from the opening of the shutter to its closing.
    pub motion: Motion,
}

/// Render request of one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderRequest {
    /// Id of the scene.
    pub scene: String,
    /// Intrinsics of the camera, at the requested size.
    pub intrinsics: Intrinsics,
    /// Pose at mid-shutter, in the local frame.
    pub local_from_camera: Pose,
    /// Motion from the opening of the shutter to its closing.
    pub motion: Motion,
    /// The agents that are seen.
    pub objects: Vec<PlacedObject>,
    /// Encoding of the image.
    pub encoding: Encoding,
    /// Mask that the image is covered with.
    pub ego_mask: Option<MaskName>,
}

impl RenderRequest {
    /// The request in `field` of a message (empty: the message itself).
    ///
    /// # Errors
    /// INVALID_ARGUMENT with the name of the field that is missing or makes no sense,
    /// RESOURCE_EXHAUSTED with the limit that it passes, UNIMPLEMENTED for lenses and formats that
    /// there are not.
    pub fn from_request(
        request: RgbRenderRequest,
        field: &str,
        limits: &Limits,
    ) -> Result<Self, Status> {
        let named = |name: &str| {
            if field.is_empty() {
                name.to_owned()
            } else {
                format!("{field}.{name}")
            }
        };
        let invalid = |name: &str, reason: &str| {
            Status::invalid_argument(format!("{} {reason}", named(name)))
        };
        check_name(&request.scene_id, &named("scene_id"))?;
        if request.frame_end_us < request.frame_start_us {
            return Err(invalid("frame_end_us", "is before frame_start_us"));
        }
        let mask = request.ego_mask_id.filter(|_| request.insert_ego_mask);
        if request.insert_ego_mask && mask.is_none() {
            return Err(invalid(
                "ego_mask_id",
                "is missing, and insert_ego_mask is set",
            ));
        }
        let shutter_s = (request.frame_end_us - request.frame_start_us) as f64 * 1e-6;
        let (local_from_camera, motion) = middle_of(
            request.sensor_pose.as_ref(),
            shutter_s,
            &named("sensor_pose"),
        )?;
        let objects = objects_of(
            &request.dynamic_objects,
            shutter_s,
            &named("dynamic_objects"),
            limits,
        )?;
        let encoding = Encoding::from_request(
            request.image_format,
            request.image_quality,
            &named("image_format"),
        )?;
        let spec = request
            .camera_intrinsics
            .as_ref()
            .ok_or_else(|| invalid("camera_intrinsics", "is missing"))?;
        let size = [request.resolution_w, request.resolution_h];
        let camera = named("camera_intrinsics");
        let intrinsics = intrinsics_of(spec, size, &camera)?;
        let intrinsics = Intrinsics {
            shutter: shutter_of(spec, shutter_s, &intrinsics, &camera)?,
            ..intrinsics
        };
        if intrinsics.pixels() > limits.image_pixels {
            let (pixels, most) = (intrinsics.pixels(), limits.image_pixels);
            return Err(Status::resource_exhausted(format!(
                "{}: {pixels} pixels, at most {most}",
                named("resolution_w")
            )));
        }
        Ok(Self {
            scene: request.scene_id,
            intrinsics,
            local_from_camera,
            motion,
            objects,
            encoding,
            ego_mask: mask.map(|mask| (mask.rig_config_id, mask.camera_logical_id)),
        })
    }
}

impl RenderRequest {
    /// Gives the image the photometric calibration that the camera called `name` of `rig` has, at
    /// the size of the image: requests have none.
    pub fn calibrate(&mut self, rig: &Rig, name: &str) {
        let Some(camera) = rig.cameras().find(|camera| camera.name == name) else {
            return;
        };
        let (own, asked) = (&camera.intrinsics, &mut self.intrinsics);
        let [right, down] = [
            (asked.width_px, own.width_px),
            (asked.height_px, own.height_px),
        ]
        .map(|(to, from)| f64::from(to) / f64::from(from.max(1)));
        asked.photometry = own.photometry.scaled(right, down);
    }
}

/// The agents of `objects` halfway through the `shutter_s` that their motion takes.
///
/// # Errors
/// INVALID_ARGUMENT with the name of the field that makes no sense, RESOURCE_EXHAUSTED where there
/// are too many.
pub fn objects_of(
    objects: &[DynamicObject],
    shutter_s: f64,
    field: &str,
    limits: &Limits,
) -> Result<Vec<PlacedObject>, Status> {
    if objects.len() > limits.objects {
        let (count, most) = (objects.len(), limits.objects);
        return Err(Status::resource_exhausted(format!(
            "{field}: {count} objects, at most {most}"
        )));
    }
    let mut names = HashSet::new();
    let mut placed = Vec::with_capacity(objects.len());
    for (index, object) in objects.iter().enumerate() {
        check_name(&object.track_id, &format!("{field}[{index}].track_id"))?;
        if !names.insert(&object.track_id) {
            return Err(Status::invalid_argument(format!(
                "{field}[{index}].track_id is that of an object before it"
            )));
        }
        let (pose, motion) = middle_of(
            object.pose_pair.as_ref(),
            shutter_s,
            &format!("{field}[{index}].pose_pair"),
        )?;
        placed.push(PlacedObject {
            track_id: object.track_id.clone(),
            pose,
            motion,
        });
    }
    Ok(placed)
}
