//! The camera service: messages in, images out.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use decouplegs::scene::TimedPose;
use futures_util::future::join_all;
use tokio::sync::oneshot;
use tonic::{Code, Request, Response, Status};

use crate::camera_spec::spec_of;
use crate::catalog::{Catalog, Outline};
use crate::encoding::{Encoders, encode};
use crate::metrics::Metrics;
use crate::names::{CONTRACT_VERSION, check_name, no_scene};
use crate::options::Limits;
use crate::painter::{Painter, Images};
use crate::poses::message_of;
use crate::sight::Sight;
use crate::wire::common::version_id::ApiVersion;
use crate::wire::common::{AvailableScenesReturn, Empty, PoseAtTime, Trajectory, VersionId};
use crate::wire::sensorsim::available_cameras_return::AvailableCamera;
use crate::wire::sensorsim::available_trajectories_return::AvailableTrajectory;
use crate::wire::sensorsim::sensorsim_service_server::SensorsimService;
use crate::wire::sensorsim::{
    AggregatedRenderRequest, AggregatedRenderReturn, AvailableCamerasRequest, AvailableCamerasReturn, AvailableEgoMasksReturn,
    AvailableTrajectoriesRequest, AvailableTrajectoriesReturn, BatchRgbRenderRequest, BatchRgbRenderReturn,
    BatchRgbRenderReturnItem, LidarRenderRequest, LidarRenderReturn, LoadedSceneEntry, LoadedScenesReturn, RgbRenderRequest,
    RgbRenderReturn,
};

/// The service.
#[derive(Clone)]
pub struct Sensorsim {
    /// Registry of scenes.
    pub catalog: Arc<Catalog>,
    /// Queue of the render thread.
    pub painter: Painter,
    /// Encoders.
    pub encoders: Encoders,
    /// Limits.
    pub limits: Arc<Limits>,
    /// Metrics.
    pub metrics: Arc<Metrics>,
}

/// Version of the server, for both services.
#[must_use]
pub fn version() -> VersionId {
    let [major, minor, patch] = CONTRACT_VERSION;
    VersionId {
        version_id: concat!("decouplegs-server ", env!("CARGO_PKG_VERSION")).to_owned(),
        git_hash: env!("DECOUPLEGS_GIT_HASH").to_owned(),
        grpc_api_version: Some(ApiVersion { major, minor, patch }),
    }
}

/// Metadata of the scene `id`; files are read on a blocking thread.
pub async fn outline_of(catalog: &Arc<Catalog>, id: String) -> Result<Arc<Outline>, Status> {
    check_name(&id, "scene_id")?;
    let (catalog, asked) = (Arc::clone(catalog), id.clone());
    let read = tokio::task::spawn_blocking(move || catalog.outline(&asked)).await;
    let outline = read.map_err(|error| Status::internal(error.to_string()))?;
    let outline = outline.map_err(|error| Status::failed_precondition(error.to_string()))?;
    outline.ok_or_else(|| no_scene(&id))
}

impl Sensorsim {
    /// Images of `sights`, in their order: those that see the same objects in the same scene are drawn in one submission.
    async fn images(&self, sights: Vec<Result<Sight, Status>>) -> Vec<Result<Bytes, Status>> {
        let mut results: Vec<Result<Bytes, Status>> = Vec::with_capacity(sights.len());
        let mut shots: Vec<(Vec<usize>, Vec<Sight>)> = Vec::new();
        for (place, sight) in sights.into_iter().enumerate() {
            match sight {
                Ok(sight) => {
                    results.push(Err(Status::internal("it was not drawn")));
                    let same = |(_, others): &&mut (Vec<usize>, Vec<Sight>)| {
                        others.first().is_some_and(|other| other.scene == sight.scene && other.objects == sight.objects)
                    };
                    match shots.iter_mut().find(same) {
                        Some((places, others)) => {
                            places.push(place);
                            others.push(sight);
                        }
                        None => shots.push((vec![place], vec![sight])),
                    }
                }
                Err(status) => results.push(Err(status)),
            }
        }
        let drawn = shots.into_iter().map(|(places, sights)| async move { (places, self.shot(sights).await) });
        for (places, images) in join_all(drawn).await {
            for (place, image) in places.into_iter().zip(images) {
                results[place] = image;
            }
        }
        results
    }

    /// Images of one submission.
    async fn shot(&self, sights: Vec<Sight>) -> Vec<Result<Bytes, Status>> {
        let encodings: Vec<_> = sights.iter().map(|sight| sight.encoding).collect();
        let images = match self.painter.draw(sights).await {
            Ok(images) => Arc::new(images),
            Err(status) => return vec![Err(status); encodings.len()],
        };
        let encode_one = |(index, encoding)| {
            let (images, (done, waited)) = (Arc::clone(&images), oneshot::channel());
            self.encoders.spawn(move || {
                let Images { bytes, .. } = &*images;
                // Whoever asked may have gone.
                let _ = done.send(encode(bytes.rgba(index), bytes.size_px(index), encoding));
            });
            waited
        };
        let encoded: Vec<_> = encodings.into_iter().enumerate().map(encode_one).collect();
        // Only the encoders keep it: its memory is free for another frame when they are done.
        drop(images);
        let encoded = join_all(encoded).await;
        let told = |result: Result<Result<Vec<u8>, String>, _>| match result {
            Ok(Ok(bytes)) => Ok(Bytes::from(bytes)),
            Ok(Err(reason)) => Err(Status::invalid_argument(reason)),
            Err(_) => Err(Status::internal("the encoder ended")),
        };
        encoded.into_iter().map(told).collect()
    }

    /// Refuses images that are too large together.
    fn check_pixels(&self, sights: &[Result<Sight, Status>], field: &str) -> Result<(), Status> {
        let (pixels, most) = (sights.iter().flatten().map(|sight| sight.intrinsics.pixels()).sum::<u64>(), self.limits.pixels);
        if pixels > most {
            return Err(Status::resource_exhausted(format!("{field}: {pixels} pixels in all, at most {most}")));
        }
        Ok(())
    }

    fn check_cameras(&self, cameras: usize, field: &str) -> Result<(), Status> {
        if cameras > self.limits.cameras {
            let most = self.limits.cameras;
            return Err(Status::resource_exhausted(format!("{field}: {cameras} cameras, at most {most}")));
        }
        Ok(())
    }
}

/// True if the error belongs to one camera; errors of the request belong to all of it.
fn is_of_one_camera(sight: &Result<Sight, Status>) -> bool {
    !sight.as_ref().is_err_and(|status| matches!(status.code(), Code::InvalidArgument | Code::ResourceExhausted))
}

#[tonic::async_trait]
impl SensorsimService for Sensorsim {
    async fn render_rgb(&self, request: Request<RgbRenderRequest>) -> Result<Response<RgbRenderReturn>, Status> {
        let sight = Sight::of(request.into_inner(), "", &self.limits)?;
        let image_bytes = self.shot(vec![sight]).await.remove(0)?;
        Ok(Response::new(RgbRenderReturn { image_bytes }))
    }

    async fn render_lidar(&self, _: Request<LidarRenderRequest>) -> Result<Response<LidarRenderReturn>, Status> {
        Err(Status::unimplemented("this server renders no lidar"))
    }

    async fn render_aggregated(
        &self,
        request: Request<AggregatedRenderRequest>,
    ) -> Result<Response<AggregatedRenderReturn>, Status> {
        let request = request.into_inner();
        if !request.lidar_requests.is_empty() {
            return Err(Status::unimplemented("lidar_requests: this server renders no lidar"));
        }
        self.check_cameras(request.rgb_requests.len(), "rgb_requests")?;
        let of = |(index, request)| Sight::of(request, &format!("rgb_requests[{index}]"), &self.limits);
        let sights: Vec<Sight> = request.rgb_requests.into_iter().enumerate().map(of).collect::<Result<_, _>>()?;
        let sights: Vec<_> = sights.into_iter().map(Ok).collect();
        self.check_pixels(&sights, "rgb_requests")?;
        let images = self.images(sights).await;
        let returned = images.into_iter().map(|bytes| bytes.map(|image_bytes| RgbRenderReturn { image_bytes }));
        let rgb_returns = returned.collect::<Result<_, _>>()?;
        Ok(Response::new(AggregatedRenderReturn { rgb_returns, ..AggregatedRenderReturn::default() }))
    }

    async fn batch_render_rgb(&self, request: Request<BatchRgbRenderRequest>) -> Result<Response<BatchRgbRenderReturn>, Status> {
        let items = request.into_inner().items;
        self.check_cameras(items.len(), "items")?;
        let (mut names, mut sights) = (Vec::with_capacity(items.len()), Vec::with_capacity(items.len()));
        let mut seen = HashSet::new();
        for (index, item) in items.into_iter().enumerate() {
            let field = format!("items[{index}]");
            check_name(&item.camera_name, &format!("{field}.camera_name"))?;
            if !seen.insert(item.camera_name.clone()) {
                return Err(Status::invalid_argument(format!("{field}.camera_name is that of an item before it")));
            }
            let missing = || Status::invalid_argument(format!("{field}.request is missing"));
            let sight = Sight::of(item.request.ok_or_else(missing)?, &format!("{field}.request"), &self.limits);
            if !is_of_one_camera(&sight) {
                sight.as_ref().map_err(Status::clone)?;
            }
            names.push(item.camera_name);
            sights.push(sight);
        }
        self.check_pixels(&sights, "items")?;
        let images = self.images(sights).await;
        let returned = names.into_iter().zip(images).map(|(camera_name, image)| match image {
            Ok(image_bytes) => BatchRgbRenderReturnItem {
                camera_name,
                result: Some(RgbRenderReturn { image_bytes }),
                success: true,
                error_message: String::new(),
            },
            Err(status) => {
                let error_message = format!("{:?}: {}", status.code(), status.message());
                BatchRgbRenderReturnItem { camera_name, result: None, success: false, error_message }
            }
        });
        Ok(Response::new(BatchRgbRenderReturn { items: returned.collect() }))
    }

    async fn get_version(&self, _: Request<Empty>) -> Result<Response<VersionId>, Status> {
        Ok(Response::new(version()))
    }

    async fn get_available_scenes(&self, _: Request<Empty>) -> Result<Response<AvailableScenesReturn>, Status> {
        Ok(Response::new(AvailableScenesReturn { scene_ids: self.catalog.ids() }))
    }

    async fn get_loaded_scenes(&self, _: Request<Empty>) -> Result<Response<LoadedScenesReturn>, Status> {
        let entry = |scene_id| LoadedSceneEntry { scene_id, loaded_instance_count: 1, reusable_instance_count: 1 };
        Ok(Response::new(LoadedScenesReturn {
            scenes: self.metrics.scenes().into_iter().map(entry).collect(),
            loaded_instance_capacity: self.limits.cache_size.into(),
        }))
    }

    async fn get_available_cameras(
        &self,
        request: Request<AvailableCamerasRequest>,
    ) -> Result<Response<AvailableCamerasReturn>, Status> {
        let outline = outline_of(&self.catalog, request.into_inner().scene_id).await?;
        let cameras = outline.rig.cameras.iter().map(|camera| AvailableCamera {
            intrinsics: Some(spec_of(&camera.intrinsics, &camera.name)),
            rig_to_camera: Some(message_of(&camera.rig_from_camera)),
            logical_id: camera.name.clone(),
        });
        Ok(Response::new(AvailableCamerasReturn { available_cameras: cameras.collect() }))
    }

    async fn get_available_trajectories(
        &self,
        request: Request<AvailableTrajectoriesRequest>,
    ) -> Result<Response<AvailableTrajectoriesReturn>, Status> {
        let outline = outline_of(&self.catalog, request.into_inner().scene_id).await?;
        let timed = |timed: &TimedPose| PoseAtTime {
            pose: Some(message_of(&timed.pose)),
            timestamp_us: Duration::try_from_secs_f64(timed.time_s).map_or(0, |time| time.as_micros() as u64),
        };
        let trajectory = Some(Trajectory { poses: outline.ego.poses().iter().map(timed).collect() });
        Ok(Response::new(AvailableTrajectoriesReturn { available_trajectories: vec![AvailableTrajectory { trajectory }] }))
    }

    async fn get_available_ego_masks(&self, _: Request<Empty>) -> Result<Response<AvailableEgoMasksReturn>, Status> {
        Ok(Response::new(AvailableEgoMasksReturn::default()))
    }
}
