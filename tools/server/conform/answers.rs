//! Checks of lists, batches and refusals.

use std::collections::HashSet;

use decouplegs::asset::packed_scene::read_packed_rig;
use tonic::Code;

use super::check::{Judged, Stop, failed};
use super::rgb_image::RgbImage;
use super::target::Target;
use decouplegs_alpasim::poses::pose_of;
use decouplegs_alpasim::wire::common::{Empty, Pose};
use decouplegs_alpasim::wire::sensorsim::{
    AvailableCamerasRequest, AvailableTrajectoriesRequest, BatchRgbRenderRequest,
    BatchRgbRenderRequestItem, ImageFormat, RgbRenderRequest,
};

/// Largest distance of a camera from where the package has it, meters, and radians.
const SAME_M: f64 = 1e-3;
const SAME_RAD: f64 = 1e-3;
/// Largest distance of the rig from its way in the package, meters: poses lie between others.
const SAME_WAY_M: f64 = 0.05;
/// Largest deviation of a quaternion's length from 1.
const UNIT_ERROR_MAX: f32 = 1e-3;

pub(super) async fn version(target: &mut Target) -> Judged {
    let version = target.client.get_version(Empty {}).await?.into_inner();
    let Some(api) = version.grpc_api_version else {
        return failed("grpc_api_version is absent");
    };
    if version.version_id.is_empty() {
        return failed("version_id is empty");
    }
    Ok(format!(
        "{}, contract {}.{}.{}",
        version.version_id, api.major, api.minor, api.patch
    ))
}

pub(super) async fn scenes(target: &mut Target) -> Judged {
    let scenes = target.client.get_available_scenes(Empty {}).await?;
    let ids = scenes.into_inner().scene_ids;
    let unique: HashSet<&String> = ids.iter().collect();
    if ids.iter().any(String::is_empty) || unique.len() != ids.len() {
        return failed(format!(
            "an id is empty or listed twice: {}",
            ids.join(", ")
        ));
    }
    if !ids.contains(&target.scene) {
        return failed(format!("{:?} is not listed", target.scene));
    }
    Ok(format!("{} scenes", ids.len()))
}

pub(super) async fn cameras(target: &mut Target) -> Judged {
    let scene_id = target.scene.clone();
    let answer = target
        .client
        .get_available_cameras(AvailableCamerasRequest { scene_id })
        .await?;
    let cameras = answer.into_inner().available_cameras;
    let mut ids = HashSet::new();
    for camera in &cameras {
        let id = &camera.logical_id;
        if id.is_empty() || !ids.insert(id) {
            return failed(format!("camera id {id:?} is empty or listed twice"));
        }
        let Some(spec) = &camera.intrinsics else {
            return failed(format!("camera {id}: intrinsics are absent"));
        };
        if spec.camera_param.is_none() || spec.resolution_w == 0 || spec.resolution_h == 0 {
            return failed(format!("camera {id}: no lens, or a size of 0"));
        }
        unit(
            camera.rig_to_camera.as_ref(),
            &format!("camera {id}: rig_to_camera"),
        )?;
    }
    Ok(format!("{} cameras", cameras.len()))
}

/// Compares what is listed with the package that the simulator reads for itself.
pub(super) async fn package(target: &mut Target) -> Judged {
    let Some(path) = target.package.clone() else {
        return Err(Stop::Skipped("name the package with --package".into()));
    };
    let packed = read_packed_rig(&path).or_else(|error| failed(error.to_string()))?;
    let scene_id = target.scene.clone();
    let asked = AvailableCamerasRequest {
        scene_id: scene_id.clone(),
    };
    let listed = target.client.get_available_cameras(asked).await?;
    let listed = listed.into_inner().available_cameras;
    let mut farthest_m: f64 = 0.0;
    for (name, expected) in &packed.cameras {
        let Some(camera) = listed.iter().find(|camera| camera.logical_id == *name) else {
            return failed(format!("camera {name:?} of the package is not listed"));
        };
        let pose = pose_of(camera.rig_to_camera.as_ref(), "rig_to_camera")?;
        let off_m = pose.translation.distance(expected.translation);
        let off_rad = pose.rotation.angle_between(expected.rotation);
        if off_m > SAME_M || off_rad > SAME_RAD {
            return failed(format!(
                "camera {name:?}: rig_to_camera is {off_m:.3} m and {off_rad:.4} rad off T_sensor_rig"
            ));
        }
        farthest_m = farthest_m.max(off_m);
    }
    let asked = AvailableTrajectoriesRequest { scene_id };
    if let Ok(answer) = target.client.get_available_trajectories(asked).await {
        let first = answer
            .into_inner()
            .available_trajectories
            .into_iter()
            .next();
        let poses = first
            .and_then(|first| first.trajectory)
            .map(|way| way.poses);
        for timed in poses.iter().flatten() {
            let pose = pose_of(timed.pose.as_ref(), "trajectory")?;
            let expected = packed.way.at(timed.timestamp_us as f64 * 1e-6);
            let off_m = pose.translation.distance(expected.translation);
            if off_m > SAME_WAY_M {
                return failed(format!(
                    "at {} us the rig is {off_m:.3} m off that of the package",
                    timed.timestamp_us
                ));
            }
        }
    }
    Ok(format!(
        "{} cameras, at most {farthest_m:.6} m off",
        packed.cameras.len()
    ))
}

pub(super) async fn trajectories(target: &mut Target) -> Judged {
    let scene_id = target.scene.clone();
    let answer = target
        .client
        .get_available_trajectories(AvailableTrajectoriesRequest { scene_id })
        .await?;
    let trajectories = answer.into_inner().available_trajectories;
    let Some(first) = trajectories.first().and_then(|t| t.trajectory.as_ref()) else {
        return Err(Stop::Skipped("the scene has no trajectory".into()));
    };
    if let Some(pair) = first
        .poses
        .windows(2)
        .find(|pair| pair[1].timestamp_us <= pair[0].timestamp_us)
    {
        return failed(format!(
            "time {} us follows {} us",
            pair[1].timestamp_us, pair[0].timestamp_us
        ));
    }
    for timed in &first.poses {
        unit(
            timed.pose.as_ref(),
            &format!("pose at {} us", timed.timestamp_us),
        )?;
    }
    Ok(format!("{} poses", first.poses.len()))
}

fn unit(pose: Option<&Pose>, what: &str) -> Result<(), Stop> {
    let Some(quat) = pose.and_then(|pose| pose.quat) else {
        return failed(format!("{what} has no quaternion"));
    };
    let length = (quat.w.powi(2) + quat.x.powi(2) + quat.y.powi(2) + quat.z.powi(2)).sqrt();
    if (length - 1.0).abs() <= UNIT_ERROR_MAX {
        Ok(())
    } else {
        failed(format!("{what} has a quaternion of length {length}"))
    }
}

pub(super) async fn ego_masks(target: &mut Target) -> Judged {
    let masks = target.client.get_available_ego_masks(Empty {}).await?;
    Ok(format!(
        "{} masks",
        masks.into_inner().ego_mask_metadata.len()
    ))
}

/// Images of a batch of `requests`, named camera_0, camera_1 and so on, in that order.
async fn batch_of(
    target: &mut Target,
    requests: Vec<RgbRenderRequest>,
) -> Result<Vec<RgbImage>, Stop> {
    let items = requests
        .into_iter()
        .enumerate()
        .map(|(index, request)| BatchRgbRenderRequestItem {
            camera_name: format!("camera_{index}"),
            request: Some(request),
        })
        .collect::<Vec<_>>();
    let count = items.len();
    let answer = target
        .client
        .batch_render_rgb(BatchRgbRenderRequest { items })
        .await?
        .into_inner();
    let mut images = Vec::new();
    for index in 0..count {
        let name = format!("camera_{index}");
        let mut found = answer.items.iter().filter(|item| item.camera_name == name);
        let (Some(item), None) = (found.next(), found.next()) else {
            return failed(format!("{name} is not in the answer once"));
        };
        if !item.success {
            return failed(format!("{name} has no image: {}", item.error_message));
        }
        let Some(result) = &item.result else {
            return failed(format!("{name} has success, and no image"));
        };
        images.push(RgbImage::of_png(&result.image_bytes)?);
    }
    if answer.items.len() != count {
        return failed(format!("{} items for {count}", answer.items.len()));
    }
    Ok(images)
}

/// Compares the images of a batch with those of single requests.
async fn same_alone(target: &mut Target, requests: Vec<RgbRenderRequest>) -> Judged {
    let together = batch_of(target, requests.clone()).await?;
    let mut largest: f64 = 0.0;
    for (request, together) in requests.into_iter().zip(&together) {
        let alone = target.image(request).await?;
        largest = largest.max(alone.difference(together));
    }
    if largest > 0.0 {
        return failed(format!(
            "images differ from those of render_rgb by {largest:.2} of 255 on average"
        ));
    }
    Ok(format!("{} images, the same pixels", together.len()))
}

pub(super) async fn batch(target: &mut Target) -> Judged {
    let level = target.request();
    let mut other = target.request();
    other.resolution_w /= 2;
    other.resolution_h /= 2;
    same_alone(target, vec![level, other]).await
}

pub(super) async fn batch_of_objects(target: &mut Target) -> Judged {
    let without = target.request();
    let with = RgbRenderRequest {
        dynamic_objects: vec![target.object(12.0, 0.0, 0.0)?],
        ..target.request()
    };
    same_alone(target, vec![without, with]).await
}

/// Expects that `request` is refused with one of `codes`, and that the next one is answered.
async fn refused(target: &mut Target, request: RgbRenderRequest, codes: &[Code]) -> Judged {
    let said = match target.client.render_rgb(request).await {
        Ok(_) => return failed("the request was answered"),
        Err(status) if codes.contains(&status.code()) => status.code(),
        Err(status) => {
            return failed(format!(
                "refused with {:?} ({}); expected {}",
                status.code(),
                status.message(),
                codes
                    .iter()
                    .map(|code| format!("{code:?}"))
                    .collect::<Vec<_>>()
                    .join(" or ")
            ));
        }
    };
    let after = target.request();
    match target.image(after).await {
        Ok(_) => Ok(format!("{said:?}")),
        Err(_) => failed(format!("{said:?}, and the request after it has no answer")),
    }
}

pub(super) async fn unknown_scene(target: &mut Target) -> Judged {
    let request = RgbRenderRequest {
        scene_id: "no-scene-has-this-name".into(),
        ..target.request()
    };
    refused(target, request, &[Code::NotFound, Code::InvalidArgument]).await
}

pub(super) async fn missing_camera(target: &mut Target) -> Judged {
    let request = RgbRenderRequest {
        camera_intrinsics: None,
        ..target.request()
    };
    refused(target, request, &[Code::InvalidArgument]).await
}

pub(super) async fn undefined_format(target: &mut Target) -> Judged {
    let request = RgbRenderRequest {
        image_format: ImageFormat::Undefined.into(),
        ..target.request()
    };
    let codes = [Code::InvalidArgument, Code::Unimplemented];
    refused(target, request, &codes).await
}

pub(super) async fn backward_time(target: &mut Target) -> Judged {
    let request = RgbRenderRequest {
        frame_start_us: target.time_us + 1000,
        frame_end_us: target.time_us,
        ..target.request()
    };
    refused(target, request, &[Code::InvalidArgument, Code::OutOfRange]).await
}
