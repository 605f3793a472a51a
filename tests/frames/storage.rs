//! Compact storage of the background: what rounding alone does to images, in f64 without a GPU, and
//! images of the GPU against the definition of the splats that were stored.

use decouplegs::asset::read_splats;
use decouplegs::gpu::MemoryReport;
use decouplegs::render::metrics::Difference;
use decouplegs::render::{Image, RenderOptions, Renderer, Storage, reference};
use decouplegs::scene::{Camera, Rules, SplatCloud, SplatScene, sh};
use glam::DVec3;

use super::hard_cases::crowd;
use super::scenes::around;
use super::{PSNR_MIN_DB, all_outputs, camera_at, world_of};
use crate::data;
use crate::device::Validated;
use crate::stages::scenes::hard_world;

/// Least PSNR of an image of rounded splats against that of the originals, both in f64.
const ROUNDED_PSNR_MIN_DB: f64 = 97.0;

const HARD: &str = "hard splats";

/// A part of a splat, by name, and the cloud in which that part alone is rounded.
type Rounding = (&'static str, fn(&SplatCloud, SplatCloud) -> SplatCloud);

const ROUNDINGS: [Rounding; 4] = [
    ("scales and rotations", |original, stored| SplatCloud {
        scales: stored.scales,
        rotations: stored.rotations,
        ..original.clone()
    }),
    ("DC", |original, stored| SplatCloud {
        sh_dc: stored.sh_dc,
        ..original.clone()
    }),
    ("bands 1 to 3", |original, stored| SplatCloud {
        sh_rest: stored.sh_rest,
        ..original.clone()
    }),
    ("all", |_, stored| stored),
];

/// Many splats of all kinds with colors of degree 3.
fn colored_crowd() -> SplatScene {
    let mut world = world_of(&crowd(4000));
    let donor = hard_world(4000, 5);
    world.splats.sh_degree = 3;
    world.splats.sh_rest = donor.splats.sh_rest;
    world
}

/// Worlds to draw, with a camera each: hard splats, and captured objects where their files are.
fn subjects() -> Vec<(&'static str, SplatScene, Camera)> {
    let front = camera_at(DVec3::ZERO, 200, 120);
    let mut subjects = vec![
        ("crowd", colored_crowd(), front.clone()),
        (HARD, hard_world(4000, 3), front),
    ];
    for file in ["splats/hfk_keys.ply", "splats/statue_angel.sog"] {
        if let Some(path) = data::file("compact storage of captured objects", file) {
            let cloud = read_splats(&path).unwrap();
            let camera = around(&cloud, -DVec3::Y).remove(0);
            subjects.push((file, SplatScene::from_splats(cloud), camera));
        }
    }
    subjects
}

fn truth(world: &SplatScene, camera: &Camera) -> Image {
    reference::render(world, camera, &Rules::DEFAULT).to_image()
}

fn stored(world: &SplatScene, storage: Storage) -> SplatScene {
    SplatScene {
        splats: storage.stored_cloud(&world.splats),
        ..world.clone()
    }
}

fn draw(
    gpu: &Validated,
    world: &SplatScene,
    camera: &Camera,
    storage: Storage,
) -> (Image, MemoryReport) {
    let options = RenderOptions {
        outputs: all_outputs(),
        storage,
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(gpu, options);
    let resident = renderer.upload(world).unwrap();
    renderer
        .render(&resident, std::slice::from_ref(camera))
        .unwrap();
    let memory = gpu.memory();
    (renderer.read_images().unwrap().remove(0), memory)
}

#[test]
fn compact_storage_rounds_by_less_than_a_step_of_a_byte() {
    let mut all = vec![];
    for (subject, world, camera) in subjects() {
        let expected = truth(&world, &camera);
        let rounded = Storage::Compact.stored_cloud(&world.splats);
        for (part, with) in ROUNDINGS {
            let world = SplatScene {
                splats: with(&world.splats, rounded.clone()),
                ..world.clone()
            };
            let difference = Difference::between(&truth(&world, &camera), &expected).unwrap();
            println!(
                "{subject}, {part}: {:.1} dB, max {:.6}",
                difference.psnr_db, difference.max_abs
            );
            assert!(
                difference.psnr_db >= ROUNDED_PSNR_MIN_DB && difference.max_abs < 1.0 / 255.0,
                "{subject}, {part}: {difference:?}"
            );
            if part == "all" {
                all.push(difference.psnr_db);
            }
        }
        // The mark is one that coarser storage misses: scales that are 1e-3 too long.
        let mut coarse = world.clone();
        coarse
            .splats
            .scales
            .iter_mut()
            .flatten()
            .for_each(|s| *s *= 1.001);
        let difference = Difference::between(&truth(&coarse, &camera), &expected).unwrap();
        assert!(
            difference.psnr_db < ROUNDED_PSNR_MIN_DB,
            "{subject}: {difference:?}"
        );
    }
    all.sort_by(f64::total_cmp);
    assert!(all[all.len() / 2] >= 100.0, "{all:?}");
}

#[test]
fn the_device_draws_the_splats_that_were_stored() {
    let gpu = Validated::open();
    for (subject, world, camera) in subjects() {
        if subject == HARD {
            continue; // opacities at the very edge of 1/255: f32 decides otherwise than f64
        }
        let (image, _) = draw(&gpu, &world, &camera, Storage::Compact);
        for (against, world) in [
            ("stored", stored(&world, Storage::Compact)),
            ("original", world),
        ] {
            let difference = Difference::between(&image, &truth(&world, &camera)).unwrap();
            println!(
                "{subject} on the device against the {against} splats: {:.1} dB, max {:.6}",
                difference.psnr_db, difference.max_abs
            );
            assert!(
                difference.psnr_db >= PSNR_MIN_DB,
                "{subject}, {against}: {difference:?}"
            );
        }
    }
}

#[test]
fn compact_storage_takes_32_bytes_less_per_splat() {
    let gpu = Validated::open();
    let count = 40_000;
    let mut world = world_of(&crowd(count));
    world.splats.sh_degree = 3;
    world.splats.sh_rest = vec![[0.01; 3]; count * (sh::coefficient_count(3) - 1)];
    let camera = camera_at(DVec3::ZERO, 16, 16);
    let bytes = [Storage::Exact, Storage::Compact].map(|storage| {
        let (_, memory) = draw(&gpu, &world, &camera, storage);
        memory.bytes_by_purpose["scene"]
    });
    let saved = (bytes[0] - bytes[1]) as f64 / count as f64;
    println!("{bytes:?} bytes of a scene, {saved:.2} saved per splat");
    assert!((31.5..=32.5).contains(&saved), "{bytes:?}");
}
