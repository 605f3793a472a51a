//! Scenes taken apart into layers, and edited while they are shown: six cameras, against what the
//! files say and the definition.

use std::path::Path;

use decouplegs::asset::scene_file::editing::{begun_at, shifted};
use decouplegs::asset::{
    CodedAsset, Layer, LightTransferFile, LoadedScene, Provenance, SceneAgent, SceneFile,
    SceneLight, inria_ply, read_splats, write_coded, write_light_transfer,
};
use decouplegs::render::metrics::Difference;
use decouplegs::render::{Image, RenderOptions, Renderer, reference};
use decouplegs::scene::light::{AmbientOptions, CastingLights, RelightOptions, ShadowOptions, Sun};
use decouplegs::scene::{
    AmbientDescriptor, Camera, LightTransfer, Pose, Presence, Rules, ShFrame, TimedPose, Trajectory,
};
use decouplegs::session::{Session, SessionError, SessionOptions, World, WorldView};
use decouplegs::synth::street::{Street, StreetOptions};
use glam::DVec3;

use super::agents::coded_car;
use super::{ERROR_MAX, PSNR_MIN_DB, all_outputs};
use crate::device::Validated;
use crate::stages::Random;

const SIZE: (u32, u32) = (160, 90);

/// Largest depth of a splat of an agent in any camera, meters.
const AGENTS_DEPTH_MAX_M: f64 = 12.0;

/// Radius around the ego vehicle within which the background is removed, meters.
const CLEARED_M: f64 = 22.0;

/// A street with a car of plain splats and five coded ones around the ego vehicle, one of which
/// drives, in a folder.
pub struct Site {
    pub folder: tempfile::TempDir,
    pub file: SceneFile,
}

impl Site {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let options = StreetOptions {
            background: 12_000,
            agents: 1,
            agent_splats: 800,
            sh_degree: 1,
            ..StreetOptions::default()
        };
        let street = Street::generate(&options);
        inria_ply::write(&at("background.ply"), &street.background).unwrap();
        inria_ply::write(&at("plain.ply"), &street.assets[0]).unwrap();
        for (name, seed) in [("red", 2), ("blue", 3), ("green", 4)] {
            let cloud = coded_car(500, seed);
            write_coded(
                &at(&format!("{name}.safetensors")),
                &CodedAsset {
                    cloud,
                    provenance: Provenance::default(),
                },
            )
            .unwrap();
        }
        let transfer = LightTransferFile {
            transfer: some_theta(),
            tool_version: "0".into(),
            sources: Default::default(),
            settings: Default::default(),
        };
        write_light_transfer(&at("light.safetensors"), &transfer).unwrap();
        let ego = street.ego[0].1;
        let beside = |x: f64, y: f64, yaw_rad: f64| {
            Trajectory::standing(ego.then(&Pose::from_yaw(yaw_rad, DVec3::new(x, y, 0.0))))
        };
        let drives = Trajectory::new(vec![
            TimedPose {
                time_s: 0.0,
                pose: ego.then(&Pose::from_yaw(0.1, DVec3::new(7.5, -2.5, 0.0))),
            },
            TimedPose {
                time_s: 2.0,
                pose: ego.then(&Pose::from_yaw(0.3, DVec3::new(9.5, -2.0, 0.0))),
            },
        ]);
        let agent = |name: &str, asset: &str, trajectory| SceneAgent {
            name: name.into(),
            class: None,
            asset: asset.into(),
            sh_frame: None,
            trajectory,
            present: Presence::ALWAYS,
        };
        let mut rig = street.rig.clone();
        rig.cameras_mut()
            .for_each(|camera| camera.intrinsics = camera.intrinsics.resized(SIZE.0, SIZE.1));
        let file = SceneFile {
            sky: street.sky,
            rig,
            ego: Some(Trajectory::standing(ego)),
            agents: vec![
                agent("ahead", "red.safetensors", drives.unwrap()),
                agent("plain", "plain.ply", beside(6.0, 5.5, 2.0)),
                agent("left", "blue.safetensors", beside(0.5, 7.0, 1.2)),
                agent("right", "red.safetensors", beside(1.0, -7.5, -0.4)),
                agent("behind", "blue.safetensors", beside(-8.0, 0.5, 0.2)),
                agent("behind left", "red.safetensors", beside(-5.0, 6.0, -2.0)),
            ],
            light: Some(SceneLight {
                transfer: Some("light.safetensors".into()),
                relighting: RelightOptions::default(),
                ambient: AmbientOptions::default(),
                // A slab that reaches the wheels of the plain car: its splats are darkened in every
                // layer that has them.
                shadows: Some(ShadowOptions {
                    slab_m: 0.5,
                    ..ShadowOptions::default()
                }),
                casting: CastingLights::default(),
            }),
            ..SceneFile::of_background("background.ply")
        };
        Self { folder, file }
    }

    fn without_shadows(mut self) -> Self {
        self.file.light.as_mut().unwrap().shadows = None;
        self
    }

    fn by_normals(mut self) -> Self {
        let light = self.file.light.as_mut().unwrap();
        light.transfer = None;
        light.relighting.by_normals = true;
        light.casting.sun = Some(Sun {
            towards: DVec3::new(-0.6, 0.5, 0.7),
            share: 0.7,
        });
        self
    }

    fn cleared(self) -> Self {
        let (path, ego) = (
            self.folder.path().join("background.ply"),
            self.file.ego.as_ref().unwrap().at(0.0).translation,
        );
        let cloud = read_splats(&path).unwrap();
        let far = |splat: &u32| {
            DVec3::from_array(cloud.means[*splat as usize].map(f64::from)).distance(ego) > CLEARED_M
        };
        let kept: Vec<u32> = (0..cloud.len() as u32).filter(far).collect();
        inria_ply::write(&path, &cloud.select(&kept)).unwrap();
        self
    }

    pub fn loaded(&self) -> LoadedScene {
        loaded(&self.file, self.folder.path())
    }
}

/// `file` as it is read back.
pub fn loaded(file: &SceneFile, folder: &Path) -> LoadedScene {
    let path = folder.join("scene.toml");
    file.write(&path).unwrap();
    SceneFile::read(&path).unwrap().load(folder, 0.0).unwrap()
}

/// A calibration in which the colors follow every number of the light a little.
fn some_theta() -> LightTransfer {
    let mut random = Random(5);
    let mut row = |scale: f32, constant: f32| {
        (
            std::array::from_fn(|_| random.between(-scale, scale)),
            constant,
        )
    };
    let rows = 3 * 16;
    LightTransfer {
        sh_degree: 3,
        gain: (0..rows).map(|_| row(0.2, 1.0)).collect(),
        offset: (0..rows).map(|_| row(0.1, 0.0)).collect(),
        neutral: AmbientDescriptor::uniform([0.5; 3]),
        confidence: None,
    }
}

pub fn cameras(loaded: &LoadedScene) -> Vec<Camera> {
    loaded.rig.at(&loaded.ego.at(0.0))
}

fn draw_by(
    gpu: &Validated,
    loaded: &LoadedScene,
    layer: Layer,
    options: RenderOptions,
) -> Vec<Image> {
    let mut renderer = Renderer::new(gpu, options);
    let session = Session::on(gpu, &options.into());
    let scene = session.add_layer(loaded, layer).unwrap();
    World::new(&scene)
        .lend(|splats| renderer.render(splats, &cameras(loaded)))
        .unwrap();
    renderer.read_images().unwrap()
}

pub fn options() -> RenderOptions {
    RenderOptions {
        outputs: all_outputs(),
        ..RenderOptions::default()
    }
}

fn draw(gpu: &Validated, loaded: &LoadedScene, layer: Layer) -> Vec<Image> {
    draw_by(gpu, loaded, layer, options())
}

#[test]
fn the_background_is_a_scene_that_never_had_agents() {
    let gpu = Validated::open();
    let site = Site::new();
    let mut empty = site.file.clone();
    for agent in &site.file.agents {
        empty.remove_agent(&agent.name).unwrap();
    }
    let expected = draw(&gpu, &loaded(&empty, site.folder.path()), Layer::All);
    let whole = site.loaded();
    assert!(draw(&gpu, &whole, Layer::Background) == expected);
    let all = draw(&gpu, &whole, Layer::All);
    assert!(
        all.iter()
            .zip(&expected)
            .all(|(all, expected)| all != expected),
        "every camera sees an agent"
    );
}

/// Pixels whose color, alpha or depth is not the same to the last bit.
fn differing(a: &Image, b: &Image) -> Vec<bool> {
    let bits = |image: &Image, at: usize| {
        let [r, g, b] = image.rgb[at].map(f32::to_bits);
        [
            r,
            g,
            b,
            image.alpha[at].to_bits(),
            image.depth().unwrap()[at].to_bits(),
        ]
    };
    (0..a.alpha.len())
        .map(|at| bits(a, at) != bits(b, at))
        .collect()
}

/// Differences between the whole scene and the background in pixels without agents, in one camera.
#[derive(Debug)]
struct Uncovered {
    pixels: usize,
    differing: usize,
    /// Number of them with transmittance left behind.
    differing_open: usize,
    error_max: f32,
}

fn uncovered(gpu: &Validated, site: &Site, options: RenderOptions) -> Vec<Uncovered> {
    let loaded = site.loaded();
    let [all, background, agents] = [Layer::All, Layer::Background, Layer::Agents]
        .map(|layer| draw_by(gpu, &loaded, layer, options));
    let rows = all
        .iter()
        .zip(&background)
        .zip(&agents)
        .map(|((all, background), agents)| {
            let covered = agents.alpha.iter().filter(|alpha| **alpha > 0.0).count();
            assert!(
                covered > 200,
                "an agent is in view of every camera, found {covered} pixels of it"
            );
            let differs = differing(all, background);
            let free: Vec<usize> = (0..all.alpha.len())
                .filter(|at| agents.alpha[*at] == 0.0)
                .collect();
            let error = |at: &usize| {
                (0..3).fold(0f32, |worst, c| {
                    worst.max((all.rgb[*at][c] - background.rgb[*at][c]).abs())
                })
            };
            Uncovered {
                pixels: free.len(),
                differing: free.iter().filter(|at| differs[**at]).count(),
                differing_open: free
                    .iter()
                    .filter(|at| differs[**at] && background.alpha[**at] < 0.9999)
                    .count(),
                error_max: free.iter().map(error).fold(0.0, f32::max),
            }
        });
    rows.collect()
}

#[test]
fn where_agents_have_no_alpha_the_whole_is_the_background_to_the_last_bit() {
    let gpu = Validated::open();
    let site = Site::new().without_shadows();
    // By these rules a pixel stops by itself.
    let exact = uncovered(
        &gpu,
        &site,
        RenderOptions {
            rules: Rules::GSPLAT15,
            segment_pairs: u32::MAX,
            ..options()
        },
    );
    println!("gsplat15, whole lists: {exact:?}");
    assert!(
        exact
            .iter()
            .all(|camera| camera.pixels > 1000 && camera.differing == 0),
        "{exact:?}"
    );
    // By the default ones a pixel that is full takes splats as long as one beside it is not, at
    // most 2e-5 of their light.
    let whole_lists = uncovered(
        &gpu,
        &site,
        RenderOptions {
            segment_pairs: u32::MAX,
            ..options()
        },
    );
    println!("default, whole lists: {whole_lists:?}");
    assert!(
        whole_lists
            .iter()
            .all(|camera| camera.differing_open == 0 && camera.error_max <= 4e-5),
        "{whole_lists:?}"
    );
    // Where a list is cut depends on what else is in it, and rounding on where it is cut.
    for rules in [Rules::DEFAULT, Rules::GSPLAT15] {
        let cut = uncovered(&gpu, &site, RenderOptions { rules, ..options() });
        println!("{rules:?}: {cut:?}");
        assert!(cut.iter().all(|camera| camera.error_max <= 4e-5), "{cut:?}");
    }
    let shaded = uncovered(
        &gpu,
        &Site::new(),
        RenderOptions {
            rules: Rules::GSPLAT15,
            ..options()
        },
    );
    println!("with shadows: {shaded:?}");
    let seen = |camera: &Uncovered| camera.differing > 0 && camera.error_max > 0.01;
    assert!(
        shaded.iter().any(seen),
        "shadows lie where no agent is, and are seen to"
    );
}

#[test]
fn agents_laid_over_the_background_are_the_whole() {
    let gpu = Validated::open();
    let loaded = Site::new().without_shadows().cleared().loaded();
    let [all, background, agents] =
        [Layer::All, Layer::Background, Layer::Agents].map(|layer| draw(&gpu, &loaded, layer));
    // Where the background has nothing up to the depth of the farthest agent, leaving that out
    // changes nothing.
    let rules = Rules {
        near_m: AGENTS_DEPTH_MAX_M,
        ..loaded.splat_scene.rules
    };
    let beyond = draw_by(
        &gpu,
        &loaded,
        Layer::Background,
        RenderOptions { rules, ..options() },
    );
    let [mut sum, mut sum_opaque, mut channels, mut worst] = [0.0f64; 4];
    for camera in 0..6 {
        let (all, background, agents) = (&all[camera], &background[camera], &agents[camera]);
        let in_front = |at: &usize| {
            let same = background.rgb[*at]
                .iter()
                .zip(&beyond[camera].rgb[*at])
                .all(|(a, b)| (a - b).abs() < 1e-6);
            agents.alpha[*at] > 0.0 && same
        };
        let seen: Vec<usize> = (0..all.alpha.len()).filter(in_front).collect();
        assert!(
            seen.len() > 50,
            "camera {camera} sees agents before everything in {} pixels",
            seen.len()
        );
        for at in seen {
            for channel in 0..3 {
                let (front, behind) = (agents.rgb[at][channel], background.rgb[at][channel]);
                let expected = f64::from(all.rgb[at][channel]);
                let error = f64::from(front + (1.0 - agents.alpha[at]) * behind) - expected;
                sum += error * error;
                sum_opaque += (f64::from(front) - expected).powi(2);
                worst = worst.max(error.abs());
                channels += 1.0;
            }
        }
    }
    let [composed_db, opaque_db] = [sum, sum_opaque].map(|sum| -10.0 * (sum / channels).log10());
    println!(
        "{} pixels: {composed_db:.1} dB, max {worst:.6}; as if opaque {opaque_db:.1} dB",
        channels / 3.0
    );
    // What blending leaves out once a pixel is full: 1e-4 of what is behind.
    assert!(
        composed_db >= PSNR_MIN_DB && worst <= 2e-4,
        "{composed_db:.2} dB, {worst}"
    );
    assert!(opaque_db < 60.0, "alpha matters: without it {opaque_db} dB");
}

/// The layers of `loaded` by definition; those drawn are the same.
fn layers_as_defined(gpu: &Validated, loaded: &LoadedScene) -> [Vec<Image>; 3] {
    [Layer::All, Layer::Background, Layer::Agents].map(|layer| {
        let world = loaded.baked_layer(0.0, layer);
        let truth = |camera: &Camera| reference::render(&world, camera, &world.rules).to_image();
        let truths: Vec<Image> = cameras(loaded).iter().map(truth).collect();
        for (image, truth) in draw(gpu, loaded, layer).iter().zip(&truths) {
            let difference = Difference::between(image, truth).unwrap();
            let alpha_error = image
                .alpha
                .iter()
                .zip(&truth.alpha)
                .fold(0f32, |worst, (a, b)| worst.max((a - b).abs()));
            println!(
                "{layer:?}: {:.1} dB, max {:.5}, alpha {alpha_error:.5}",
                difference.psnr_db, difference.max_abs
            );
            assert!(
                difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX,
                "{layer:?}: {difference:?}"
            );
            assert!(
                f64::from(alpha_error) <= ERROR_MAX,
                "{layer:?}: {alpha_error}"
            );
        }
        truths
    })
}

#[test]
fn every_layer_is_its_definition() {
    let gpu = Validated::open();
    let relit = layers_as_defined(&gpu, &Site::new().loaded());
    let by_normals = layers_as_defined(&gpu, &Site::new().by_normals().loaded());
    // The comparison can fail: layers are different images, and so is other light.
    for (all, other) in [(&relit[0], &relit[1]), (&by_normals[0], &relit[0])] {
        for (all, other) in all.iter().zip(other) {
            assert!(Difference::between(all, other).unwrap().psnr_db < 60.0);
        }
    }
}

/// The same images, and in each pixel agents of the same name.
fn assert_same(world: (&[Image], &World), fresh: (&[Image], &LoadedScene), step: &str) {
    let plain = |instance: u16| {
        fresh
            .1
            .agent_labels
            .get(usize::from(instance).wrapping_sub(1))
            .map(|label| label.name.clone())
    };
    let named = |instance: u16| {
        let agents = world.1.agents();
        let found = agents
            .iter()
            .find(|agent| agent.placed.instance == instance);
        found.map(|agent| agent.name.clone())
    };
    for (camera, (shown, fresh)) in world.0.iter().zip(fresh.0).enumerate() {
        assert!(
            !differing(shown, fresh).contains(&true),
            "{step}: camera {camera} differs"
        );
        let ids = shown.instance().unwrap().iter();
        for (shown, fresh) in ids.zip(fresh.instance().unwrap()) {
            // A plain agent is no agent of the world; in this one it keeps its place.
            assert_eq!(
                named(*shown).or_else(|| plain(*shown)),
                plain(*fresh),
                "{step}: camera {camera}"
            );
        }
    }
}

#[test]
fn a_world_edited_while_it_is_shown_is_the_edited_file_loaded() {
    let gpu = Validated::open();
    let site = Site::new();
    let (mut file, folder) = (site.file.clone(), site.folder.path());
    let loaded_first = site.loaded();
    let session = Session::on(
        &gpu,
        &SessionOptions {
            render: options(),
            ..SessionOptions::default()
        },
    );
    let scene = session.add_scene(&loaded_first).unwrap();
    let (mut renderer, mut world) = (session.batch_renderer(), World::new(&scene));
    let green = scene.add_asset(&folder.join("green.safetensors")).unwrap();
    let views = cameras(&loaded_first);
    let mut shown = Vec::new();
    let mut check = |world: &World, file: &SceneFile, step: &str| {
        let view = WorldView {
            world,
            cameras: &views,
        };
        let images = renderer.draw_images(&[view]).unwrap().0.remove(0);
        let fresh = loaded(file, folder);
        assert_same(
            (&images, world),
            (&draw(&gpu, &fresh, Layer::All), &fresh),
            step,
        );
        assert!(!shown.contains(&images), "{step} is seen");
        shown.push(images);
    };
    check(&world, &file, "as loaded");

    let way = begun_at(
        &file.agent("ahead").unwrap().trajectory,
        DVec3::new(1.0, 2.0, 0.0) + views[0].world_from_camera.translation,
        0.4,
    )
    .unwrap();
    world.move_to("ahead", way.at(0.0)).unwrap();
    file.set_trajectory("ahead", way).unwrap();
    check(&world, &file, "moved");

    let shift = Pose::from_yaw(0.3, DVec3::new(1.5, -0.5, 0.0));
    let way = shifted(&file.agent("left").unwrap().trajectory, &shift).unwrap();
    world.move_to("left", way.at(0.0)).unwrap();
    file.shift_agent("left", &shift).unwrap();
    check(&world, &file, "shifted");

    let pose = file.agent("right").unwrap().trajectory.at(0.0);
    world.place("right", green, pose, None).unwrap();
    file.swap_asset("right", "green.safetensors").unwrap();
    check(&world, &file, "swapped");

    let taken = world.remove("left").unwrap();
    assert_eq!(taken.placed.instance, 3);
    let ids: Vec<u16> = world
        .agents()
        .iter()
        .map(|agent| agent.placed.instance)
        .collect();
    assert_eq!(ids, [1, 4, 5, 6], "those of the others stay");
    let trajectory = file.remove_agent("left").unwrap().trajectory;
    check(&world, &file, "removed");

    let pose = trajectory.at(0.0);
    assert_eq!(
        world
            .place("new", green, pose, Some(ShFrame::World))
            .unwrap(),
        7
    );
    file.add_agent(SceneAgent {
        name: "new".into(),
        class: None,
        asset: "green.safetensors".into(),
        sh_frame: Some(ShFrame::World),
        trajectory,
        present: Presence::ALWAYS,
    })
    .unwrap();
    check(&world, &file, "added");
}

#[test]
fn agents_of_plain_splats_stay_and_the_background_has_none() {
    let gpu = Validated::open();
    let loaded = Site::new().loaded();
    let session = Session::on(&gpu, &SessionOptions::default());
    let scene = session.add_scene(&loaded).unwrap();
    let mut world = World::new(&scene);
    let before = world.agents().to_vec();
    for error in [
        world.move_to("plain", Pose::IDENTITY).unwrap_err(),
        world.place("plain", 0, Pose::IDENTITY, None).unwrap_err(),
        world.remove("plain").unwrap_err(),
    ] {
        assert!(matches!(error, SessionError::PlainSplats { .. }), "{error}");
    }
    assert_eq!(world.agents(), before);
    let background = session.add_layer(&loaded, Layer::Background).unwrap();
    assert!(background.agents().is_empty() && background.plain_agents().is_empty());
}
