//! Post-processing on the device: sky maps, the rays that see them, and calibrations of color.

use bytemuck::{Pod, Zeroable};
use decouplegs_gpu::{Buffer, Gpu, GpuError};
use decouplegs_scene::{Camera, Fog, Intrinsics, Photometry, RayMap, Shutter, SkyMap};
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

/// Purpose under which the memory of skies and their rays is counted.
const PURPOSE: &str = "sky";

/// Tables of rays that are kept beside those in use.
const TABLES_MAX: usize = 32;

/// Light that clear air adds to the sky, and the share that it leaves of it.
pub const NO_FOG: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

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
    /// Light that fog adds to the sky, and the share that it leaves of it.
    pub fog: [f32; 4],
    sky_from_world: DMat3,
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
            fog: NO_FOG,
            sky_from_world: sky.sky_from_world(),
        })
    }

    /// The same sky behind `fog`.
    #[must_use]
    pub fn behind(self, fog: &Fog) -> Self {
        let left = fog.left(fog.sky_range_m) as f32;
        let [red, green, blue] = fog.seen_sky([0.0; 3]).map(|value| value as f32);
        Self {
            fog: [red, green, blue, left],
            ..self
        }
    }
}

/// A camera as post-processing sees it.
#[derive(Clone)]
pub struct ProcessedView {
    /// Rotation from the camera to the cube of the sky, by columns.
    pub sky_from_camera: [[f32; 3]; 3],
    /// Pixels of its image.
    pub pixels: usize,
    /// Unit ray of each pixel, camera frame, zero where no ray falls; `None` for a pinhole.
    pub rays: Option<Buffer<[f32; 3]>>,
}

/// Photometric calibration of a camera: `Photometry` in `post_process.comp`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PhotometryRecord {
    /// Rows of red, green and blue.
    pub matrix: [[f32; 3]; 3],
    /// Offsets of red, green and blue.
    pub offset: [f32; 3],
    /// Exponents of red, green and blue.
    pub gamma: [f32; 3],
    /// Coefficients of r^2, r^4 and r^6, each of red, green and blue.
    pub vignetting: [[f32; 3]; 3],
    /// Centers of the vignetting of red, green and blue, pixels.
    pub vignetting_center_px: [[f32; 2]; 3],
    /// One over the distances at which r is 1, per pixel.
    pub vignetting_scale: [f32; 2],
    /// Factor of the exposure.
    pub gain: f32,
    /// Rows of the homography of red, green and their sum with blue.
    pub balance: [[f32; 3]; 3],
    /// Exponents below the center, above it and of the whole, the center, and the value there, each
    /// of red, green and blue.
    pub response: [[f32; 3]; 5],
    /// 1 where exponents are applied.
    pub has_gamma: u32,
    /// 1 where colors are balanced.
    pub has_balance: u32,
    /// 1 where there is a response.
    pub has_response: u32,
}

impl PhotometryRecord {
    /// The record of `photometry`.
    #[must_use]
    pub fn new(photometry: &Photometry) -> Self {
        let matrix = photometry.matrix.map(|row| row.map(|value| value as f32));
        let mut record = Self {
            matrix: matrix.map(|[red, green, blue, _]| [red, green, blue]),
            offset: matrix.map(|row| row[3]),
            gamma: photometry.gamma.map(|gamma| gamma as f32),
            gain: photometry.gain() as f32,
            has_gamma: (photometry.gamma != [1.0; 3]).into(),
            ..Self::zeroed()
        };
        if let Some(vignetting) = &photometry.vignetting {
            let power = |power: usize| vignetting.rgb.map(|channel| channel[power] as f32);
            record.vignetting = [power(0), power(1), power(2)];
            record.vignetting_center_px = vignetting
                .center_px
                .map(|center_px| center_px.map(|axis| axis as f32));
            record.vignetting_scale = vignetting
                .radius_px
                .map(|radius_px| (1.0 / radius_px) as f32);
        }
        if let Some(balance) = photometry.balance {
            record.balance = balance.map(|row| row.map(|value| value as f32));
            record.has_balance = 1;
        }
        if let Some(response) = photometry.response {
            let at_center = [0, 1, 2].map(|channel| response.at_center(channel));
            record.response = [
                response.toe,
                response.shoulder,
                response.gamma,
                response.center,
                at_center,
            ]
            .map(|of| of.map(|value| value as f32));
            record.has_response = 1;
        }
        record
    }
}

/// Rays of cameras that are no pinholes, computed once per lens and image size.
#[derive(Default)]
pub(crate) struct RayTables {
    tables: Vec<(Intrinsics, Buffer<[f32; 3]>)>,
}

impl RayTables {
    /// `cameras` as post-processing sees them. Without `sky`, no rays are needed.
    pub fn seen_by(
        &mut self,
        gpu: &Gpu,
        sky: Option<&SkyBuffers>,
        cameras: &[Camera],
    ) -> Result<Vec<ProcessedView>, GpuError> {
        let mut views = Vec::with_capacity(cameras.len());
        for camera in cameras {
            let rotation = DMat3::from_quat(camera.world_from_camera.rotation);
            let from_world = sky.map_or(DMat3::IDENTITY, |sky| sky.sky_from_world);
            views.push(ProcessedView {
                sky_from_camera: (from_world * rotation).as_mat3().to_cols_array_2d(),
                pixels: camera.intrinsics.pixels() as usize,
                rays: match sky {
                    Some(_) => self.rays(gpu, &camera.intrinsics)?,
                    None => None,
                },
            });
        }
        // Those in use are the last.
        let spare = self
            .tables
            .len()
            .saturating_sub(TABLES_MAX.max(cameras.len()));
        self.tables.drain(..spare);
        Ok(views)
    }

    fn rays(
        &mut self,
        gpu: &Gpu,
        intrinsics: &Intrinsics,
    ) -> Result<Option<Buffer<[f32; 3]>>, GpuError> {
        if intrinsics.is_pinhole() {
            return Ok(None);
        }
        // Exposure may change from frame to frame; rays depend neither on it nor on the shutter.
        let geometry = Intrinsics {
            photometry: Photometry::IDENTITY,
            shutter: Shutter::GLOBAL,
            ..*intrinsics
        };
        let known = self.tables.iter().position(|(of, _)| *of == geometry);
        let table = match known {
            Some(index) => self.tables.remove(index),
            None => {
                let rays = rays_of(&geometry);
                (geometry, gpu.upload("rays", PURPOSE, &rays)?)
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
