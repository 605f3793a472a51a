//! `post_process.comp`: the sky map behind what was blended, and calibrations of color.

use decouplegs::render::layout::View;
use decouplegs::render::post_processing::{PhotometryRecord, ProcessedView, SkyBuffers};
use decouplegs::render::stages::{PostProcess, PostProcessInputs};
use decouplegs::render::twins::output::pack_unorm_4x8;
use decouplegs::render::twins::post_process::{calibrated, over_sky};
use decouplegs::render::{ColorFormat, OutputBuffers, Outputs};
use decouplegs::scene::{Camera, Photometry, SkyMap};
use glam::{DMat3, DVec3, Mat3, Vec2, Vec3};

use super::scenes::rig;
use super::{ROUNDOFF, Random, open, run, upload};
use crate::device::Validated;
use crate::frames::sky::{noise, ppisp_photometry, some_photometry};

/// Rounded operations between a ray and its color: 2 for the ray, 5 for its turn to the cube, 4 for
/// the position on a face, where a texel is up to 2^3 of the coordinate's unit, and 6 to
/// interpolate; then 20 for the calibration, whose exponents need a logarithm of up to 16 units.
const OPERATIONS: f64 = 2.0 + 5.0 + 4.0 * 8.0 + 6.0 + 20.0 + 16.0;

/// Factor by which colors follow the position and what comes before: differences of neighboring
/// texels times texels of a face, and the gain of the calibration.
const STEEPNESS: f64 = 32.0;

/// Two cameras, the second of which reads its rays from a table, every 7th of which is none.
struct Case {
    cameras: Vec<Camera>,
    view: View,
    blended: Vec<[f32; 4]>,
    rays: Vec<[f32; 3]>,
    photometry: Vec<PhotometryRecord>,
}

impl Case {
    fn new(photometry: [Photometry; 2]) -> Self {
        let cameras = rig()[..2].to_vec();
        let view = View::new(&cameras, DVec3::ZERO, 1.0).unwrap();
        let mut random = Random(17);
        let blended = (0..view.pixels)
            .map(|_| std::array::from_fn(|_| random.between(0.0, 1.2).min(1.0)))
            .collect();
        let rays = (0..cameras[1].intrinsics.pixels() as usize)
            .map(|pixel| match pixel % 7 {
                0 => [0.0; 3],
                _ => std::array::from_fn(|_| random.between(-1.0, 1.0)),
            })
            .collect();
        Self {
            cameras,
            view,
            blended,
            rays,
            photometry: photometry.iter().map(PhotometryRecord::new).collect(),
        }
    }

    fn turn(&self, sky: &SkyMap, camera: usize) -> Mat3 {
        let rotation = DMat3::from_quat(self.cameras[camera].world_from_camera.rotation);
        (sky.sky_from_world() * rotation).as_mat3()
    }

    fn draw(&self, gpu: &Validated, sky: Option<&SkyMap>, color: ColorFormat) -> OutputBuffers {
        let sky_buffers = sky.map(|sky| SkyBuffers::upload(gpu, sky).unwrap());
        let views = [0, 1].map(|camera| ProcessedView {
            sky_from_camera: sky
                .map_or(Mat3::IDENTITY, |sky| self.turn(sky, camera))
                .to_cols_array_2d(),
            pixels: self.cameras[camera].intrinsics.pixels() as usize,
            rays: (camera == 1 && sky.is_some()).then(|| upload(gpu, &self.rays)),
        });
        let outputs = Outputs {
            color,
            ..Outputs::default()
        };
        let images = OutputBuffers::new(gpu, self.view.pixels, 0, &outputs).unwrap();
        let stage = PostProcess::new(gpu, &outputs).unwrap();
        let (cameras, photometry) = (
            upload(gpu, &self.view.cameras),
            upload(gpu, &self.photometry),
        );
        let blended = upload(gpu, &self.blended);
        run(gpu, |r| {
            let inputs = PostProcessInputs {
                cameras: &cameras,
                photometry: &photometry,
                views: &views,
                sky: sky_buffers.as_ref(),
            };
            stage.record(r, inputs, &blended, &images);
        });
        images
    }

    fn twin(&self, sky: Option<&SkyMap>) -> Vec<[f32; 4]> {
        let pixel = |camera: usize, pixel: usize| {
            let record = &self.view.cameras[camera];
            let width = record.size_px[0] as usize;
            let center_px = Vec2::new((pixel % width) as f32, (pixel / width) as f32) + 0.5;
            let on_plane = (center_px - Vec2::from_array(record.principal_px))
                / Vec2::from_array(record.focal_px);
            let ray = match camera {
                0 => on_plane.extend(1.0),
                _ => Vec3::from_array(self.rays[pixel]),
            };
            let blended = self.blended[record.first_pixel as usize + pixel];
            let [red, green, blue, alpha] = match sky {
                Some(sky) => over_sky(sky, blended, self.turn(sky, camera) * ray),
                None => blended,
            };
            let color = Vec3::new(red, green, blue);
            let color = calibrated(&self.photometry[camera], color, center_px);
            color.extend(alpha).to_array()
        };
        let pixels = |camera: usize| self.cameras[camera].intrinsics.pixels() as usize;
        (0..2)
            .flat_map(|camera| (0..pixels(camera)).map(move |at| (camera, at)))
            .map(|(camera, at)| pixel(camera, at))
            .collect()
    }
}

/// Largest difference of a channel.
fn error(found: &[[f32; 4]], twin: &[[f32; 4]]) -> f64 {
    let pairs = found.as_flattened().iter().zip(twin.as_flattened());
    pairs
        .map(|(a, b)| f64::from((a - b).abs()))
        .fold(0.0, f64::max)
}

#[test]
fn every_pixel_has_the_sky_of_its_ray_and_the_color_of_its_camera() {
    let gpu = open();
    let mut clamped = noise(8, DMat3::from_rotation_y(0.4));
    (clamped.clamps, clamped.clamps_splats) = (true, true);
    let open_sky = noise(8, DMat3::from_rotation_y(0.4));
    let plain = [Photometry::IDENTITY; 2];
    let own = [some_photometry(0.6), some_photometry(1.0)];
    let bound = OPERATIONS * STEEPNESS * ROUNDOFF;
    let mut seen: Vec<Vec<[f32; 4]>> = Vec::new();
    for (sky, photometry) in [
        (Some(&open_sky), plain),
        (Some(&clamped), plain),
        (None, own),
        (Some(&open_sky), own),
        (Some(&open_sky), [ppisp_photometry(), some_photometry(0.6)]),
    ] {
        let case = Case::new(photometry);
        let twin = case.twin(sky);
        let images = case.draw(&gpu, sky, ColorFormat::F32);
        let found = gpu.read(&images.images_f32).unwrap();
        let worst = error(&found, &twin);
        assert!(worst <= bound, "{worst:e}, at most {bound:e}");
        // The comparison finds a case drawn otherwise.
        assert!(seen.iter().all(|other| error(other, &twin) > 100.0 * bound));
        seen.push(found);

        let images = case.draw(&gpu, sky, ColorFormat::U8);
        let bytes = gpu.read(&images.images_u8).unwrap();
        let off = |(found, twin): (&u32, &[f32; 4])| {
            let pairs = found.to_le_bytes().into_iter();
            let pairs = pairs.zip(pack_unorm_4x8(*twin).to_le_bytes());
            pairs.map(|(a, b)| a.abs_diff(b)).max().unwrap()
        };
        assert!(bytes.iter().zip(&twin).map(off).max().unwrap() <= 1);
    }
}

/// Colors stay to the last bit without a sky and with calibrations that change nothing.
#[test]
fn the_identity_changes_no_bit() {
    let gpu = open();
    let case = Case::new([Photometry::IDENTITY; 2]);
    let images = case.draw(&gpu, None, ColorFormat::F32);
    assert!(gpu.read(&images.images_f32).unwrap() == case.blended);
}
