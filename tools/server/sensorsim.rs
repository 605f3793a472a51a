//! The camera service: messages in, images out.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use decouplegs::scene::TimedPose;
use futures_util::future::{join, join_all};
use tokio::sync::oneshot;
use tonic::{Code, Request, Response, Status};

use crate::ego_masks::{EgoMasks, MaskName};
use crate::image_memory::Images;
use crate::metrics::Metrics;
use crate::names::{CONTRACT_VERSION, check_name};
use crate::options::Limits;
use crate::reference_lens::with_reference_lens;
use crate::render_queue::RenderQueue;
use crate::render_request::RenderRequest;
use crate::scene_registry::{SceneRegistry, metadata_of};
use crate::sweep_request::SweepRequest;
use decouplegs_alpasim::camera_spec::spec_of;
use decouplegs_alpasim::encoding::{Encoders, encode};
use decouplegs_alpasim::poses::message_of;
use decouplegs_alpasim::wire::common::version_id::ApiVersion;
use decouplegs_alpasim::wire::common::{
    AvailableScenesReturn, Empty, PoseAtTime, Trajectory, VersionId,
};
use decouplegs_alpasim::wire::sensorsim::available_cameras_return::AvailableCamera;
use decouplegs_alpasim::wire::sensorsim::available_trajectories_return::AvailableTrajectory;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_server::SensorsimService;
use decouplegs_alpasim::wire::sensorsim::{
    AggregatedRenderRequest, AggregatedRenderReturn, AvailableCamerasRequest,
    AvailableCamerasReturn, AvailableEgoMasksReturn, AvailableTrajectoriesRequest,
    AvailableTrajectoriesReturn, BatchRgbRenderRequest, BatchRgbRenderReturn,
    BatchRgbRenderReturnItem, LidarRenderRequest, LidarRenderReturn, LoadedSceneEntry,
    LoadedScenesReturn, RgbRenderRequest, RgbRenderReturn,
};

/// The service.
#[derive(Clone)]
pub struct Sensorsim {
    /// Registry of scenes.
    pub registry: Arc<SceneRegistry>,
    /// Queue of the render thread.
    pub render_queue: RenderQueue,
    /// Threads that encode images.
    pub encoders: Encoders,
    /// Limits of requests.
    pub limits: Arc<Limits>,
    /// Metrics of the server.
    pub metrics: Arc<Metrics>,
    /// Masks that images may be covered with.
    pub ego_masks: EgoMasks,
}

/// Version of the server, for both services.
#[must_use]
pub fn version() -> VersionId {
    let [major, minor, patch] = CONTRACT_VERSION;
    VersionId {
        version_id: concat!("decouplegs-server ", env!("CARGO_PKG_VERSION")).to_owned(),
        git_hash: env!("DECOUPLEGS_GIT_HASH").to_owned(),
        grpc_api_version: Some(ApiVersion {
            major,
            minor,
            patch,
        }),
    }
}

impl Sensorsim {
    /// The request in `field` of a message, complete and examined.
    async fn checked(
        &self,
        request: RgbRenderRequest,
        field: &str,
    ) -> Result<RenderRequest, Status> {
        let request = with_reference_lens(&self.registry, request).await?;
        let camera = request.camera_intrinsics.as_ref();
        let camera = camera.map_or_else(String::new, |spec| spec.logical_id.clone());
        let mut request = RenderRequest::from_request(request, field, &self.limits)?;
        let metadata = metadata_of(&self.registry, request.scene.clone()).await?;
        request.calibrate(&metadata.rig, &camera);
        match &request.ego_mask {
            Some(name) if !self.ego_masks.has(name) => Err(Status::invalid_argument(format!(
                "{field}{}ego_mask_id names no mask; get_available_ego_masks lists them",
                if field.is_empty() { "" } else { "." }
            ))),
            _ => Ok(request),
        }
    }

    /// Images of `requests`, in their order. All that are of one scene are drawn in one submission
    /// of each device that has the scene, with a view per list of objects.
    async fn images(
        &self,
        requests: Vec<Result<RenderRequest, Status>>,
    ) -> Vec<Result<Bytes, Status>> {
        let mut results: Vec<Result<Bytes, Status>> = Vec::with_capacity(requests.len());
        let mut shots: Vec<Shot> = Vec::new();
        for (place, request) in requests.into_iter().enumerate() {
            match request {
                Ok(request) => {
                    results.push(Err(Status::internal("it was not drawn")));
                    match shots.iter_mut().find(|shot| shot.scene == request.scene) {
                        Some(shot) => shot.add(place, request),
                        None => shots.push(Shot::new(place, request)),
                    }
                }
                Err(status) => results.push(Err(status)),
            }
        }
        let shots = shots.into_iter().flat_map(|shot| {
            let copies = self.render_queue.copies(&shot.scene);
            shot.divided(copies)
        });
        let drawn =
            shots.map(|shot| async move { (shot.places.concat(), self.shot(shot.views).await) });
        for (places, images) in join_all(drawn).await {
            for (place, image) in places.into_iter().zip(images) {
                results[place] = image;
            }
        }
        results
    }

    /// Images of one submission, view by view.
    async fn shot(&self, views: Vec<Vec<RenderRequest>>) -> Vec<Result<Bytes, Status>> {
        let places = views.iter().enumerate().flat_map(|(view, requests)| {
            let of_view = requests.iter().enumerate();
            of_view.map(move |(camera, request)| {
                (view, camera, request.encoding, request.ego_mask.clone())
            })
        });
        let places: Vec<_> = places.collect();
        let images = match self.render_queue.draw(views).await {
            Ok(images) => Arc::new(images),
            Err(status) => return vec![Err(status); places.len()],
        };
        let encode_one = |(view, camera, encoding, mask): (_, _, _, Option<MaskName>)| {
            let (images, (done, waited)) = (Arc::clone(&images), oneshot::channel());
            let masks = self.ego_masks.clone();
            self.encoders.spawn(move || {
                let Images { bytes, .. } = &*images;
                let size_px = bytes.size_px(view, camera);
                let image = bytes.rgba(view, camera);
                let encoded = match mask {
                    Some(mask) => masks.overlay(&mask, size_px).and_then(|overlay| {
                        let mut covered = image.to_vec();
                        overlay.cover(&mut covered);
                        encode(&covered, size_px, encoding)
                    }),
                    None => encode(image, size_px, encoding),
                };
                // The client may have gone.
                let _ = done.send(encoded);
            });
            waited
        };
        let encoded: Vec<_> = places.into_iter().map(encode_one).collect();
        // Only the encoders keep it: its memory is free for another frame when they are done.
        drop(images);
        let encoded = join_all(encoded).await;
        let text = |result: Result<Result<Vec<u8>, String>, _>| match result {
            Ok(Ok(bytes)) => Ok(Bytes::from(bytes)),
            Ok(Err(reason)) => Err(Status::invalid_argument(reason)),
            Err(_) => Err(Status::internal("the encoder ended")),
        };
        encoded.into_iter().map(text).collect()
    }

    /// Refuses images that are too large together.
    fn check_pixels(
        &self,
        requests: &[Result<RenderRequest, Status>],
        field: &str,
    ) -> Result<(), Status> {
        let (pixels, most) = (
            requests
                .iter()
                .flatten()
                .map(|request| request.intrinsics.pixels())
                .sum::<u64>(),
            self.limits.pixels,
        );
        if pixels > most {
            return Err(Status::resource_exhausted(format!(
                "{field}: {pixels} pixels in all, at most {most}"
            )));
        }
        Ok(())
    }

    fn check_cameras(&self, cameras: usize, field: &str) -> Result<(), Status> {
        if cameras > self.limits.cameras {
            let most = self.limits.cameras;
            return Err(Status::resource_exhausted(format!(
                "{field}: {cameras} sensors, at most {most}"
            )));
        }
        Ok(())
    }
}

/// Requests of one scene, drawn in one submission.
struct Shot {
    scene: String,
    /// Requests by view: those of one view list the same objects.
    views: Vec<Vec<RenderRequest>>,
    /// Places of the requests in the answer.
    places: Vec<Vec<usize>>,
}

impl Shot {
    fn new(place: usize, request: RenderRequest) -> Self {
        Self {
            scene: request.scene.clone(),
            views: vec![vec![request]],
            places: vec![vec![place]],
        }
    }

    fn add(&mut self, place: usize, request: RenderRequest) {
        let same = |others: &Vec<RenderRequest>| {
            let other = others.first();
            other.is_some_and(|other| other.objects == request.objects)
        };
        match self.views.iter().position(same) {
            Some(view) => {
                self.views[view].push(request);
                self.places[view].push(place);
            }
            None => {
                self.views.push(vec![request]);
                self.places.push(vec![place]);
            }
        }
    }
}

impl Shot {
    /// `parts` shots of about as many pixels each, or fewer where there are fewer images.
    fn divided(self, parts: usize) -> Vec<Self> {
        if parts < 2 {
            return vec![self];
        }
        let places = self.places.into_iter().flatten();
        let mut images: Vec<_> = places.zip(self.views.into_iter().flatten()).collect();
        let pixels = |request: &RenderRequest| request.intrinsics.pixels();
        // The largest first: what comes last evens the sums out.
        images.sort_by_key(|(_, request)| std::cmp::Reverse(pixels(request)));
        let mut shots: Vec<(u64, Self)> = Vec::new();
        for (place, request) in images {
            let more = pixels(&request);
            if shots.len() < parts {
                shots.push((more, Self::new(place, request)));
                continue;
            }
            if let Some((sum, shot)) = shots.iter_mut().min_by_key(|(sum, _)| *sum) {
                *sum += more;
                shot.add(place, request);
            }
        }
        shots.into_iter().map(|(_, shot)| shot).collect()
    }
}

/// True if the error belongs to one camera; errors of the request belong to all of it.
fn is_of_one_camera(request: &Result<RenderRequest, Status>) -> bool {
    !request.as_ref().is_err_and(|status| {
        matches!(
            status.code(),
            Code::InvalidArgument | Code::ResourceExhausted
        )
    })
}

#[tonic::async_trait]
impl SensorsimService for Sensorsim {
    async fn render_rgb(
        &self,
        request: Request<RgbRenderRequest>,
    ) -> Result<Response<RgbRenderReturn>, Status> {
        let request = self.checked(request.into_inner(), "").await?;
        let image_bytes = self.shot(vec![vec![request]]).await.remove(0)?;
        Ok(Response::new(RgbRenderReturn { image_bytes }))
    }

    async fn render_lidar(
        &self,
        request: Request<LidarRenderRequest>,
    ) -> Result<Response<LidarRenderReturn>, Status> {
        let request = SweepRequest::from_request(request.get_ref(), "", &self.limits)?;
        Ok(Response::new(self.lidar(request).await?))
    }

    async fn render_aggregated(
        &self,
        request: Request<AggregatedRenderRequest>,
    ) -> Result<Response<AggregatedRenderReturn>, Status> {
        let request = request.into_inner();
        self.check_cameras(request.rgb_requests.len(), "rgb_requests")?;
        self.check_cameras(request.lidar_requests.len(), "lidar_requests")?;
        let mut requests = Vec::with_capacity(request.rgb_requests.len());
        for (index, request) in request.rgb_requests.into_iter().enumerate() {
            let field = format!("rgb_requests[{index}]");
            requests.push(self.checked(request, &field).await?);
        }
        // All requests are examined before the first is drawn.
        let of = |(index, request)| {
            SweepRequest::from_request(request, &format!("lidar_requests[{index}]"), &self.limits)
        };
        let sweeps = request.lidar_requests.iter().enumerate().map(of);
        let sweeps: Vec<SweepRequest> = sweeps.collect::<Result<_, _>>()?;
        let requests: Vec<_> = requests.into_iter().map(Ok).collect();
        self.check_pixels(&requests, "rgb_requests")?;
        let sweeps = sweeps.into_iter().map(|sweep| self.lidar(sweep));
        let (images, sweeps) = join(self.images(requests), join_all(sweeps)).await;
        let returned = images
            .into_iter()
            .map(|bytes| bytes.map(|image_bytes| RgbRenderReturn { image_bytes }));
        let rgb_returns = returned.collect::<Result<_, _>>()?;
        let lidar_returns = sweeps.into_iter().collect::<Result<_, _>>()?;
        Ok(Response::new(AggregatedRenderReturn {
            rgb_returns,
            lidar_returns,
            ..AggregatedRenderReturn::default()
        }))
    }

    async fn batch_render_rgb(
        &self,
        request: Request<BatchRgbRenderRequest>,
    ) -> Result<Response<BatchRgbRenderReturn>, Status> {
        let items = request.into_inner().items;
        self.check_cameras(items.len(), "items")?;
        let (mut names, mut requests) = (
            Vec::with_capacity(items.len()),
            Vec::with_capacity(items.len()),
        );
        let mut seen = HashSet::new();
        for (index, item) in items.into_iter().enumerate() {
            let field = format!("items[{index}]");
            check_name(&item.camera_name, &format!("{field}.camera_name"))?;
            if !seen.insert(item.camera_name.clone()) {
                return Err(Status::invalid_argument(format!(
                    "{field}.camera_name is that of an item before it"
                )));
            }
            let missing = || Status::invalid_argument(format!("{field}.request is missing"));
            let request = item.request.ok_or_else(missing)?;
            let request = self.checked(request, &format!("{field}.request")).await;
            if !is_of_one_camera(&request) {
                request.as_ref().map_err(Status::clone)?;
            }
            names.push(item.camera_name);
            requests.push(request);
        }
        self.check_pixels(&requests, "items")?;
        let images = self.images(requests).await;
        let returned = names
            .into_iter()
            .zip(images)
            .map(|(camera_name, image)| match image {
                Ok(image_bytes) => BatchRgbRenderReturnItem {
                    camera_name,
                    result: Some(RgbRenderReturn { image_bytes }),
                    success: true,
                    error_message: String::new(),
                },
                Err(status) => {
                    let error_message = format!("{:?}: {}", status.code(), status.message());
                    BatchRgbRenderReturnItem {
                        camera_name,
                        result: None,
                        success: false,
                        error_message,
                    }
                }
            });
        Ok(Response::new(BatchRgbRenderReturn {
            items: returned.collect(),
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

    async fn get_loaded_scenes(
        &self,
        _: Request<Empty>,
    ) -> Result<Response<LoadedScenesReturn>, Status> {
        let entry = |(scene_id, copies)| LoadedSceneEntry {
            scene_id,
            loaded_instance_count: copies,
            reusable_instance_count: copies,
        };
        Ok(Response::new(LoadedScenesReturn {
            scenes: self.metrics.scenes().into_iter().map(entry).collect(),
            loaded_instance_capacity: self.render_queue.scenes_max(),
        }))
    }

    async fn get_available_cameras(
        &self,
        request: Request<AvailableCamerasRequest>,
    ) -> Result<Response<AvailableCamerasReturn>, Status> {
        let metadata = metadata_of(&self.registry, request.into_inner().scene_id).await?;
        let cameras = metadata.rig.cameras().map(|camera| AvailableCamera {
            intrinsics: Some(spec_of(&camera.intrinsics, &camera.name)),
            rig_to_camera: Some(message_of(&camera.rig_from_camera)),
            logical_id: camera.name.clone(),
        });
        Ok(Response::new(AvailableCamerasReturn {
            available_cameras: cameras.collect(),
        }))
    }

    async fn get_available_trajectories(
        &self,
        request: Request<AvailableTrajectoriesRequest>,
    ) -> Result<Response<AvailableTrajectoriesReturn>, Status> {
        let metadata = metadata_of(&self.registry, request.into_inner().scene_id).await?;
        let timed = |timed: &TimedPose| PoseAtTime {
            pose: Some(message_of(&timed.pose)),
            timestamp_us: Duration::try_from_secs_f64(timed.time_s)
                .map_or(0, |time| time.as_micros() as u64),
        };
        let trajectory = Some(Trajectory {
            poses: metadata.ego.poses().iter().map(timed).collect(),
        });
        Ok(Response::new(AvailableTrajectoriesReturn {
            available_trajectories: vec![AvailableTrajectory { trajectory }],
        }))
    }

    async fn get_available_ego_masks(
        &self,
        _: Request<Empty>,
    ) -> Result<Response<AvailableEgoMasksReturn>, Status> {
        Ok(Response::new(AvailableEgoMasksReturn {
            ego_mask_metadata: self.ego_masks.metadata(),
        }))
    }
}
