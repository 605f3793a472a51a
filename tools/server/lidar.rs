//! Sweeps of LiDARs: the calls of the public contract, and the service of our own.

use std::sync::Arc;

use bytes::Bytes;
use decouplegs::scene::lidar::LidarPoint;
use decouplegs::scene::{LidarModel, RigLidar};
use tonic::{Request, Response, Status};

use crate::names::check_name;
use crate::scene_registry::metadata_of;
use crate::sensorsim::Sensorsim;
use crate::sweep_request::{SweepRequest, models};
use decouplegs_alpasim::poses::message_of;
use decouplegs_alpasim::wire::lidar::lidar_server::Lidar;
use decouplegs_alpasim::wire::lidar::{
    AvailableLidar, AvailableLidarsRequest, AvailableLidarsReturn, SweepRequest as NamedRequest,
    SweepReturn,
};
use decouplegs_alpasim::wire::sensorsim::LidarRenderReturn;

/// Largest number of points that are listed beside their buffers: 36 bytes each, in the 4 MiB that
/// a client of gRPC takes by default. All points of a Pandar128 in lists and buffers would not fit
/// the 10 MB that CARLA's client takes either.
const LISTED_POINTS: usize = (4 << 20) / 40;

impl Sensorsim {
    /// Points of the sweep that `request` asks for.
    async fn points(&self, request: SweepRequest) -> Result<Vec<LidarPoint>, Status> {
        let frame = request.frame;
        let sweep = self.render_queue.sweep(request).await?;
        let done = tokio::task::spawn_blocking(move || sweep.points(frame)).await;
        done.map_err(|error| Status::internal(error.to_string()))
    }

    /// The answer to a request of the public contract.
    pub async fn lidar(&self, request: SweepRequest) -> Result<LidarRenderReturn, Status> {
        let points = self.points(request).await?;
        let places = points
            .iter()
            .flat_map(|point| point.position_m.as_vec3().to_array());
        let intensities = points.iter().map(|point| point.measured.intensity);
        let rings = points.iter().map(|point| point.beam.ring);
        let buffers = LidarRenderReturn {
            num_points: points.len() as u32,
            point_xyzs_buffer: floats(places.clone()),
            point_intensities_buffer: floats(intensities.clone()),
            point_ring_ids_buffer: words(rings.clone()),
            ..LidarRenderReturn::default()
        };
        if points.len() > LISTED_POINTS {
            return Ok(buffers);
        }
        Ok(LidarRenderReturn {
            point_xyzs: places.collect(),
            point_intensities: intensities.collect(),
            point_ring_ids: rings.map(u32::from).collect(),
            ..buffers
        })
    }

    /// The model that `logical_id` names: that of a LiDAR of the scene, or one that comes with the
    /// program.
    async fn model(&self, scene_id: &str, logical_id: &str) -> Result<Arc<LidarModel>, Status> {
        check_name(logical_id, "logical_id")?;
        let metadata = metadata_of(&self.registry, scene_id.to_owned()).await?;
        let mut of_scene = metadata.lidars.iter();
        let found = of_scene.find(|lidar| lidar.name == logical_id);
        let built_in = models().get(logical_id);
        let model = found.map(|lidar| &lidar.model).or(built_in);
        let missing = || {
            Status::not_found(
                "logical_id: the scene has no such LiDAR; get_available_lidars lists them",
            )
        };
        model.cloned().ok_or_else(missing)
    }
}

fn floats(values: impl Iterator<Item = f32>) -> Bytes {
    values.flat_map(f32::to_le_bytes).collect()
}

fn integers(values: impl Iterator<Item = u32>) -> Bytes {
    values.flat_map(u32::to_le_bytes).collect()
}

fn words(values: impl Iterator<Item = u16>) -> Bytes {
    values.flat_map(u16::to_le_bytes).collect()
}

fn available(logical_id: &str, model: &LidarModel, mounted: Option<&RigLidar>) -> AvailableLidar {
    let [least_m, greatest_m] = model.range_m;
    AvailableLidar {
        logical_id: logical_id.to_owned(),
        sensor: model.name.clone(),
        rig_to_lidar: mounted.map(|lidar| message_of(&lidar.rig_from_lidar)),
        rings: model.rings() as u32,
        columns: model.columns() as u32,
        sweep_us: (1e6 * model.sweep_s).round() as u32,
        range_min_m: least_m as f32,
        range_max_m: greatest_m as f32,
    }
}

#[tonic::async_trait]
impl Lidar for Sensorsim {
    async fn get_available_lidars(
        &self,
        request: Request<AvailableLidarsRequest>,
    ) -> Result<Response<AvailableLidarsReturn>, Status> {
        let metadata = metadata_of(&self.registry, request.into_inner().scene_id).await?;
        let mounted = metadata.lidars.iter();
        let mounted = mounted.map(|lidar| available(&lidar.name, &lidar.model, Some(lidar)));
        let is_free = |name: &str| metadata.lidars.iter().all(|lidar| lidar.name != name);
        let built_in = models().iter().filter(|(name, _)| is_free(name));
        let built_in = built_in.map(|(name, model)| available(name, model, None));
        Ok(Response::new(AvailableLidarsReturn {
            available_lidars: mounted.chain(built_in).collect(),
        }))
    }

    async fn render_sweep(
        &self,
        request: Request<NamedRequest>,
    ) -> Result<Response<SweepReturn>, Status> {
        let request = request.into_inner();
        let model = self.model(&request.scene_id, &request.logical_id).await?;
        let checked = SweepRequest::from_named(&request, &model, &self.limits)?;
        let points = self.points(checked).await?;
        let points = || points.iter();
        let places = points().flat_map(|point| point.position_m.as_vec3().to_array());
        Ok(Response::new(SweepReturn {
            logical_id: request.logical_id,
            sensor: model.name.clone(),
            num_points: points().len() as u32,
            point_xyzs_buffer: floats(places),
            point_intensities_buffer: floats(points().map(|point| point.measured.intensity)),
            point_ranges_buffer: floats(points().map(|point| point.measured.range_m)),
            point_offsets_ns_buffer: integers(points().map(|point| point.beam.offset_ns())),
            point_columns_buffer: integers(points().map(|point| point.beam.column)),
            point_ring_ids_buffer: words(points().map(|point| point.beam.ring)),
            point_laser_ids_buffer: words(points().map(|point| point.beam.laser)),
            point_instance_ids_buffer: words(points().map(|point| point.measured.instance)),
            point_return_numbers_buffer: points().map(|point| point.measured.number).collect(),
            point_return_counts_buffer: points().map(|point| point.measured.count).collect(),
        }))
    }
}
