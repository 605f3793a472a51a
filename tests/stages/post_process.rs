//! `post_process.comp`: the sky map behind what was blended.

use decouplegs::render::layout::View;
use decouplegs::render::sky::{SkyBuffers, SkyCamera};
use decouplegs::render::stages::PostProcess;
use decouplegs::render::twins::output::pack_unorm_4x8;
use decouplegs::render::twins::post_process::post_process;
use decouplegs::render::{ColorFormat, OutputBuffers, Outputs};
use decouplegs::scene::SkyMap;
use glam::{DMat3, DVec3, Vec3};

use super::scenes::rig;
use super::{ROUNDOFF, Random, open, run, upload};
use crate::frames::sky::noise;

/// Rounded operations between a ray and its color: 2 for the ray, 5 for its turn to the cube, 4 for
/// the place on a face, where a texel is up to 2^3 of the coordinate's unit, and 6 to interpolate.
const OPERATIONS: f64 = 2.0 + 5.0 + 4.0 * 8.0 + 6.0;

/// Largest difference of neighboring texels times texels from edge to edge of a face: how fast a
/// color follows the place.
const STEEPNESS: f64 = 16.0;

#[test]
fn every_pixel_has_the_sky_of_its_ray_behind_it() {
    let gpu = open();
    let cameras = &rig()[..2];
    let view = View::new(cameras, DVec3::ZERO, 1.0).unwrap();
    let mut random = Random(17);
    let blended: Vec<[f32; 4]> = (0..view.pixels)
        .map(|_| std::array::from_fn(|_| random.between(0.0, 1.2).min(1.0)))
        .collect();
    for clamps in [false, true] {
        let mut sky = noise(8, DMat3::from_rotation_y(0.4));
        (sky.clamps, sky.clamps_splats) = (clamps, clamps);
        let sky_buffers = SkyBuffers::upload(&gpu, &sky).unwrap();
        // The second camera reads its rays from a table, every 7th of which is none.
        let turn = |camera: usize| {
            let rotation = DMat3::from_quat(cameras[camera].world_from_camera.rotation);
            (sky.sky_from_world() * rotation).as_mat3()
        };
        let pixels = |camera: usize| cameras[camera].intrinsics.pixels() as usize;
        let table: Vec<[f32; 3]> = (0..pixels(1))
            .map(|pixel| match pixel % 7 {
                0 => [0.0; 3],
                _ => std::array::from_fn(|_| random.between(-1.0, 1.0)),
            })
            .collect();
        let seen_by = [0, 1].map(|camera| SkyCamera {
            sky_from_camera: turn(camera).to_cols_array_2d(),
            pixels: pixels(camera),
            rays: (camera == 1).then(|| upload(&gpu, &table)),
        });
        for color in [ColorFormat::F32, ColorFormat::U8] {
            let outputs = Outputs {
                color,
                ..Outputs::default()
            };
            let images = OutputBuffers::new(&gpu, view.pixels, 0, &outputs).unwrap();
            let stage = PostProcess::new(&gpu, &outputs).unwrap();
            let (camera_buffer, input) = (upload(&gpu, &view.cameras), upload(&gpu, &blended));
            run(&gpu, |r| {
                stage.record(r, &camera_buffer, &seen_by, &sky_buffers, &input, &images);
            });
            let twin: Vec<[f32; 4]> = (0..2)
                .flat_map(|camera| (0..pixels(camera)).map(move |pixel| (camera, pixel)))
                .map(|(camera, pixel)| {
                    let record = &view.cameras[camera];
                    let width = record.size_px[0] as usize;
                    let center = [pixel % width, pixel / width].map(|at| at as f32 + 0.5);
                    let [x, y] = std::array::from_fn(|axis| {
                        (center[axis] - record.principal_px[axis]) / record.focal_px[axis]
                    });
                    let ray = match camera {
                        0 => Vec3::new(x, y, 1.0),
                        _ => Vec3::from_array(table[pixel]),
                    };
                    let place = record.first_pixel as usize + pixel;
                    post_process(&sky, blended[place], turn(camera) * ray)
                })
                .collect();
            if color == ColorFormat::U8 {
                let found = gpu.read(&images.images_u8).unwrap();
                let off = |(found, twin): (&u32, &[f32; 4])| {
                    let bytes = found.to_le_bytes().into_iter();
                    let pairs = bytes.zip(pack_unorm_4x8(*twin).to_le_bytes());
                    pairs.map(|(a, b)| a.abs_diff(b)).max().unwrap()
                };
                assert!(found.iter().zip(&twin).map(off).max().unwrap() <= 1);
                continue;
            }
            let found = gpu.read(&images.images_f32).unwrap();
            let error = found
                .as_flattened()
                .iter()
                .zip(twin.as_flattened())
                .map(|(a, b)| f64::from((a - b).abs()))
                .fold(0.0, f64::max);
            assert!(error <= OPERATIONS * STEEPNESS * ROUNDOFF, "{error:e}");
            let flat = post_process(&sky, blended[0], turn(0) * Vec3::Z);
            let moved = found.iter().filter(|value| value[..3] != flat[..3]).count();
            assert!(moved > view.pixels / 2, "the sky is seen");
        }
    }
}

/// Skies that are equal but for one texel differ where that is seen.
#[test]
fn one_texel_is_seen() {
    let one = |value: f32| {
        let mut texels = [[0.0; 3]; 6];
        texels[4] = [value; 3];
        SkyMap::new(1, &texels, DMat3::IDENTITY).unwrap()
    };
    let at = |sky: &SkyMap| post_process(sky, [0.0; 4], Vec3::Z);
    assert_eq!(at(&one(0.0)), [0.0; 4]);
    assert_eq!(at(&one(0.75)), [0.75, 0.75, 0.75, 0.0]);
}
