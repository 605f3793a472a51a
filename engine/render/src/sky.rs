//! Sky maps on the device, and the rays that see them.

use decouplegs_gpu::{Buffer, Gpu, GpuError};
use decouplegs_scene::{Camera, Intrinsics, RayMap, SkyMap};
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

/// Purpose under which the memory of skies and their rays is counted.
const PURPOSE: &str = "sky";

/// Tables of rays that are kept beside those in use.
const TABLES_MAX: usize = 32;

/// A sky map on the device.
#[derive(Clone)]
pub struct SkyBuffers {
    /// Six faces with a border of one texel.
    pub texels: Buffer<[f32; 3]>,
    /// Texels along each side of a face, without its border.
    pub face_texels: u32,
    /// True if interpolated colors are clamped to 0 to 1.
    pub clamps: bool,
    /// True if the color of splats is clamped to at most 1 before the sky is added.
    pub clamps_splats: bool,
    /// Rays of a pinhole: none.
    pub no_rays: Buffer<[f32; 3]>,
    sky_from_world: DMat3,
}

/// Camera as it sees a sky.
#[derive(Clone)]
pub struct SkyCamera {
    /// Rotation from the camera to the cube, by columns.
    pub sky_from_camera: [[f32; 3]; 3],
    /// Pixels of its image.
    pub pixels: usize,
    /// Unit ray of each pixel, camera frame, zero where no ray falls; `None` for a pinhole.
    pub rays: Option<Buffer<[f32; 3]>>,
}

impl SkyBuffers {
    /// Copies `sky` to the device.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn upload(gpu: &Gpu, sky: &SkyMap) -> Result<Self, GpuError> {
        Ok(Self {
            texels: gpu.upload("sky_texels", PURPOSE, sky.bordered_texels())?,
            face_texels: sky.face_texels() as u32,
            clamps: sky.clamps,
            clamps_splats: sky.clamps_splats,
            no_rays: gpu.upload("rays", PURPOSE, &[])?,
            sky_from_world: sky.sky_from_world(),
        })
    }
}

/// Rays of cameras that are no pinholes, computed once per lens and image size.
#[derive(Default)]
pub(crate) struct RayTables {
    tables: Vec<(Intrinsics, Buffer<[f32; 3]>)>,
}

impl RayTables {
    /// `cameras` as they see `sky`.
    pub fn seen_by(
        &mut self,
        gpu: &Gpu,
        sky: &SkyBuffers,
        cameras: &[Camera],
    ) -> Result<Vec<SkyCamera>, GpuError> {
        let mut seen_by = Vec::with_capacity(cameras.len());
        for camera in cameras {
            let rotation = DMat3::from_quat(camera.world_from_camera.rotation);
            let sky_from_camera = (sky.sky_from_world * rotation).as_mat3();
            seen_by.push(SkyCamera {
                sky_from_camera: sky_from_camera.to_cols_array_2d(),
                pixels: camera.intrinsics.pixels() as usize,
                rays: self.rays(gpu, &camera.intrinsics)?,
            });
        }
        // Those in use are the last.
        let spare = self
            .tables
            .len()
            .saturating_sub(TABLES_MAX.max(cameras.len()));
        self.tables.drain(..spare);
        Ok(seen_by)
    }

    fn rays(
        &mut self,
        gpu: &Gpu,
        intrinsics: &Intrinsics,
    ) -> Result<Option<Buffer<[f32; 3]>>, GpuError> {
        if intrinsics.lens.is_pinhole() {
            return Ok(None);
        }
        let known = self.tables.iter().position(|(of, _)| of == intrinsics);
        let table = match known {
            Some(index) => self.tables.remove(index),
            None => {
                let rays = rays_of(intrinsics);
                (*intrinsics, gpu.upload("rays", PURPOSE, &rays)?)
            }
        };
        let rays = table.1.clone();
        self.tables.push(table);
        Ok(Some(rays))
    }
}

/// Unit ray of each pixel, row-major; zero where there is none.
fn rays_of(intrinsics: &Intrinsics) -> Vec<[f32; 3]> {
    let map = RayMap::new(intrinsics);
    let width = intrinsics.width_px as usize;
    (0..intrinsics.pixels() as usize)
        .into_par_iter()
        .map(|pixel| {
            let center_px = DVec2::new((pixel % width) as f64, (pixel / width) as f64) + 0.5;
            let ray = map.unproject(center_px).unwrap_or(DVec3::ZERO);
            ray.as_vec3().to_array()
        })
        .collect()
}
