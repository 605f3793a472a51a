//! Relit agents and shadows against the definition: colors transferred, splats darkened,
//! all baked and drawn in f64.

use decouplegs::render::metrics::Difference;
use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, Image, RenderError, RenderOptions, Renderer,
    ResidentSplats, reference,
};
use decouplegs::scene::light::{LightFrom, LitShare, SHADING_LIGHTS, Shading, bake_shadows};
use decouplegs::scene::{
    AmbientDescriptor, Camera, CodedCloud, ColorTransfer, GroundShadow, LightTransfer, Pose, Rules,
    ShFrame, SplatCloud, SplatScene, sh,
};
use glam::{DQuat, DVec3};

use super::agents::{background, camera_towards, coded_car};
use super::{ERROR_MAX, PSNR_MIN_DB, all_outputs};
use crate::device::Validated;
use crate::stages::Random;

/// A transfer that changes every coefficient, and not every channel alike.
pub fn some_transfer(seed: u64) -> ColorTransfer {
    let mut random = Random(seed);
    let mut transfer = ColorTransfer::IDENTITY;
    for (gain, offset) in transfer.gain.iter_mut().zip(&mut transfer.offset) {
        *gain = std::array::from_fn(|_| random.between(0.4, 1.6));
        *offset = std::array::from_fn(|_| random.between(-0.2, 0.2));
    }
    transfer
}

/// A shadow on ground that is tilted, below the background's middle.
pub fn shadow(at: DVec3, yaw_rad: f64, strength: f64) -> GroundShadow {
    GroundShadow {
        world_from_ground: Pose::new(
            DQuat::from_rotation_z(yaw_rad) * DQuat::from_rotation_x(0.1),
            at,
        ),
        half_size_m: [2.2, 0.9],
        strength,
        decay: 1.5,
        sharpness: 0,
        slab_m: 1.2,
    }
}

/// Contents of a frame.
struct Case {
    world: SplatScene,
    cars: Vec<CodedCloud>,
    /// Car, pose, frame of its colors, and light.
    placed: Vec<(usize, Pose, ShFrame, Option<ColorTransfer>)>,
    shadows: Vec<GroundShadow>,
    cameras: Vec<Camera>,
}

impl Case {
    fn new() -> Self {
        let mut world = background(3000, 1);
        world.origin = DVec3::new(4.5e6, 0.7e6, 30.0);
        let at = |x: f64, y: f64, z: f64| world.origin + DVec3::new(x, y, z);
        let turned = DQuat::from_rotation_z(2.1)
            * DQuat::from_rotation_x(0.4)
            * DQuat::from_rotation_y(-0.2);
        let placed = vec![
            (
                0,
                Pose::from_yaw(0.3, at(8.0, 1.0, 0.0)),
                ShFrame::Canonical,
                Some(some_transfer(1)),
            ),
            (
                1,
                Pose::new(turned, at(11.0, -3.0, 0.5)),
                ShFrame::Canonical,
                None,
            ),
            (
                0,
                Pose::new(turned, at(9.0, 2.5, 0.2)),
                ShFrame::World,
                Some(some_transfer(2)),
            ),
            (
                0,
                Pose::from_yaw(1.0, at(14.0, 0.0, 0.0)),
                ShFrame::Canonical,
                Some(some_transfer(1)),
            ),
        ];
        let shadows = vec![
            shadow(at(8.0, 1.0, -0.6), 0.3, 0.9),
            // As it is cast by a lamp.
            GroundShadow {
                sharpness: 3,
                ..shadow(at(9.5, 0.0, -0.5), 1.3, 0.7)
            },
            shadow(at(20.0, -4.0, 0.0), 0.0, 1.0),
            shadow(at(-300.0, 0.0, 0.0), 0.0, 1.0),
        ];
        let cameras = vec![
            camera_towards("ahead", at(0.0, 0.0, 0.0), at(10.0, 0.0, 0.2), (200, 120)),
            camera_towards("above", at(9.0, -7.0, 5.0), at(10.0, 0.0, 0.0), (150, 130)),
        ];
        Self {
            cars: vec![coded_car(700, 2), coded_car(300, 3)],
            world,
            placed,
            shadows,
            cameras,
        }
    }

    fn agents(&self, assets: &[decouplegs::render::AssetId]) -> Vec<Agent> {
        let agent = |(i, &(car, pose, sh_frame, relight)): (
            usize,
            &(usize, Pose, ShFrame, Option<ColorTransfer>),
        )| Agent {
            sh_frame: Some(sh_frame),
            relight,
            ..Agent::new(assets[car], pose, i as u16 + 1)
        };
        self.placed.iter().enumerate().map(agent).collect()
    }

    fn drawn(&self, gpu: &Validated) -> Vec<Image> {
        let mut stage = Stage::new(gpu, self);
        let agents = self.agents(&stage.assets);
        stage.draw(&agents, &self.shadows, &self.cameras)
    }

    /// Images by definition.
    fn truth(&self) -> Vec<Image> {
        self.truth_with(|_, cloud| cloud)
    }

    /// Images by definition, with agents as `lit` makes them, by number, of what transfers leave.
    fn truth_with(&self, lit: impl Fn(usize, SplatCloud) -> SplatCloud) -> Vec<Image> {
        let mut world = self.world.clone();
        bake_shadows(&mut world, &self.shadows);
        for (i, (car, pose, sh_frame, relight)) in self.placed.iter().enumerate() {
            let decoded = self.cars[*car].decoded(0);
            let relit = relight.map_or(decoded.clone(), |relight| relight.relit(&decoded));
            world.bake_instance(&lit(i, relit), pose, *sh_frame, i as u16 + 1);
        }
        self.cameras
            .iter()
            .map(|camera| reference::render(&world, camera, &Rules::DEFAULT).to_image())
            .collect()
    }
}

/// A world and its assets on the device.
struct Stage {
    renderer: Renderer,
    world: ResidentSplats,
    pool: AssetPool,
    assets: Vec<decouplegs::render::AssetId>,
}

impl Stage {
    fn new(gpu: &Validated, case: &Case) -> Self {
        let renderer = Renderer::new(
            gpu,
            RenderOptions {
                outputs: all_outputs(),
                ..RenderOptions::default()
            },
        );
        let world = renderer.upload(&case.world).unwrap();
        let mut pool = AssetPool::new(gpu).unwrap();
        let assets = case.cars.iter().map(|car| pool.add(car).unwrap()).collect();
        Self {
            renderer,
            world,
            pool,
            assets,
        }
    }

    fn draw(
        &mut self,
        agents: &[Agent],
        shadows: &[GroundShadow],
        cameras: &[Camera],
    ) -> Vec<Image> {
        self.relit(agents, shadows, cameras);
        self.renderer.read_images().unwrap()
    }

    /// Draws; returns how many codebooks were relit for it.
    fn relit(&mut self, agents: &[Agent], shadows: &[GroundShadow], cameras: &[Camera]) -> usize {
        let agents = FrameAgents {
            shadows: shadows.to_vec(),
            ..FrameAgents::new(agents)
        };
        let scene = FrameSplats::with_agents(&self.world, &self.pool, &agents);
        self.renderer.render(scene, cameras).unwrap().relit
    }
}

#[test]
fn lit_agents_and_their_shadows_are_the_definition() {
    let gpu = Validated::open();
    let case = Case::new();
    let (images, truth) = (case.drawn(&gpu), case.truth());
    for ((image, truth), camera) in images.iter().zip(&truth).zip(&case.cameras) {
        let difference = Difference::between(image, truth).unwrap();
        println!(
            "{}: {:.1} dB, max {:.5}",
            camera.name, difference.psnr_db, difference.max_abs
        );
        assert!(
            difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX,
            "{}: {difference:?}",
            camera.name
        );
    }
    // And they are seen: without light, or without shadows, the image is another.
    for change in [
        |case: &mut Case| case.shadows.clear(),
        |case: &mut Case| case.placed.iter_mut().for_each(|agent| agent.3 = None),
    ] {
        let mut plain = Case::new();
        change(&mut plain);
        for (image, truth) in plain.drawn(&gpu).iter().zip(&truth) {
            assert!(Difference::between(image, truth).unwrap().psnr_db < 60.0);
        }
    }
}

/// Splats lit by their normals, one agent of them relit too, against each splat's color multiplied
/// in f64. Light from the other side is the case that must fail.
#[test]
fn agents_lit_by_normals_are_the_definition() {
    let gpu = Validated::open();
    let case = Case::new();
    let shading = |red: f64, towards: DVec3| {
        let mut lights = [LightFrom::default(); SHADING_LIGHTS];
        let (towards, rgb) = (towards.normalize(), [red, 0.9, 0.3]);
        lights[0] = LightFrom { towards, rgb };
        Shading {
            up: DVec3::new(0.1, 0.2, 0.9).normalize(),
            sky: [0.3, 0.35, 0.5],
            ground: [0.1, 0.09, 0.08],
            lights,
            first: LitShare {
                middle: 0.5,
                slope_per_m: DVec3::new(0.3, -0.2, 0.1),
            },
            half_size_m: [2.2, 0.9, 0.75],
        }
    };
    let towards = DVec3::new(0.8, -0.5, 0.3);
    let shadings = [
        Some(shading(1.5, towards)),
        Some(shading(0.5, -towards)),
        None,
        None,
    ];
    let mut stage = Stage::new(&gpu, &case);
    let mut draw = |shadings: [Option<Shading>; 4]| {
        let mut agents = case.agents(&stage.assets);
        for (agent, shading) in agents.iter_mut().zip(shadings) {
            agent.shading = shading;
        }
        stage.draw(&agents, &case.shadows, &case.cameras)
    };
    let unshaded = draw([None; 4]);
    let (images, mirrored) = (draw(shadings), draw([shadings[1], shadings[0], None, None]));
    assert!(draw(shadings) == images && draw([None; 4]) == unshaded);
    let truth = case.truth_with(|agent, cloud| {
        shadings[agent].map_or(cloud.clone(), |shading| shading.relit(&cloud))
    });
    for (index, truth) in truth.iter().enumerate() {
        let difference = Difference::between(&images[index], truth).unwrap();
        println!(
            "{:.1} dB, max {:.5}",
            difference.psnr_db, difference.max_abs
        );
        assert!(
            difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX,
            "{difference:?}"
        );
        for other in [&unshaded[index], &mirrored[index]] {
            assert!(Difference::between(other, truth).unwrap().psnr_db < 60.0);
        }
    }
}

#[test]
fn codebooks_are_relit_once_for_each_light() {
    let gpu = Validated::open();
    let case = Case::new();
    let mut stage = Stage::new(&gpu, &case);
    let mut agents = case.agents(&stage.assets);
    // Two lights of one asset, of which one is shown twice. Frames that are waited for have one
    // place.
    let relit: Vec<usize> = (0..3)
        .map(|_| stage.relit(&agents, &case.shadows, &case.cameras))
        .collect();
    assert_eq!(relit, [2, 0, 0]);
    agents[0].world_from_agent.translation.x += 0.5;
    assert_eq!(
        stage.relit(&agents, &case.shadows, &case.cameras),
        0,
        "moving alone is no other light"
    );
    agents[0].relight = Some(some_transfer(9));
    agents[1].relight = Some(some_transfer(9));
    // One light, two assets; and the two that stay, since four have no room where two had.
    assert_eq!(stage.relit(&agents, &case.shadows, &case.cameras), 4);
    agents[1].relight = Some(some_transfer(8));
    assert_eq!(stage.relit(&agents, &case.shadows, &case.cameras), 1);
    let images = stage.renderer.read_images().unwrap();
    let fresh = Stage::new(&gpu, &case).draw(&agents, &case.shadows, &case.cameras);
    assert!(
        images == fresh,
        "a frame that makes one of four is the one that makes all"
    );
    agents.iter_mut().for_each(|agent| agent.relight = None);
    let unlit = stage.draw(&agents, &[], &case.cameras);
    let mut without = Stage::new(&gpu, &case);
    assert!(
        unlit == without.draw(&agents, &[], &case.cameras),
        "what was lit before is as if it never was"
    );
}

#[test]
fn world_light_and_agent_turned_together_look_the_same() {
    let gpu = Validated::open();
    let mut case = Case::new();
    case.placed.truncate(1);
    // A transfer that depends on every number of the light; the light is turned into the agent's
    // frame.
    let mut random = Random(5);
    let mut row = |scale: f32, constant: f32| {
        (
            std::array::from_fn(|_| random.between(-scale, scale)),
            constant,
        )
    };
    let rows = 3 * sh::coefficient_count(3);
    let theta = LightTransfer {
        sh_degree: 3,
        gain: (0..rows).map(|_| row(0.2, 1.0)).collect(),
        offset: (0..rows).map(|_| row(0.1, 0.0)).collect(),
        neutral: AmbientDescriptor::uniform([0.5; 3]),
        confidence: None,
    };
    theta.check().unwrap();
    let light = AmbientDescriptor {
        coefficients: std::array::from_fn(|k| [0.9 / (1.0 + k as f32), 0.2, -0.1 * k as f32]),
    };
    let turn = DQuat::from_rotation_z(0.8) * DQuat::from_rotation_y(0.3);
    let seen = |turn: DQuat| {
        let mut turned = Case::new();
        let (center, about) = (case.world.origin, Pose::new(turn, DVec3::ZERO));
        let moved = |pose: &Pose| {
            let relative = Pose {
                translation: pose.translation - center,
                ..*pose
            };
            let moved = about.then(&relative);
            Pose {
                translation: moved.translation + center,
                ..moved
            }
        };
        turned.world.splats = case.world.splats.clone().placed(&about, true);
        turned
            .shadows
            .iter_mut()
            .for_each(|shadow| shadow.world_from_ground = moved(&shadow.world_from_ground));
        turned
            .cameras
            .iter_mut()
            .for_each(|camera| camera.world_from_camera = moved(&camera.world_from_camera));
        turned.placed.truncate(1);
        let (_, pose, _, relight) = &mut turned.placed[0];
        *pose = moved(pose);
        *relight = Some(theta.at(&light.turned(turn).turned(pose.rotation.inverse())));
        turned.drawn(&gpu)
    };
    for (still, turned) in seen(DQuat::IDENTITY).iter().zip(&seen(turn)) {
        let difference = Difference::between(still, turned).unwrap();
        println!("turned: {:.1} dB", difference.psnr_db);
        assert!(difference.psnr_db >= PSNR_MIN_DB, "{difference:?}");
    }
}

#[test]
fn light_and_shadows_that_are_none_are_refused() {
    let gpu = Validated::open();
    let case = Case::new();
    let mut stage = Stage::new(&gpu, &case);
    let mut agents = case.agents(&stage.assets);
    let nowhere = GroundShadow {
        strength: f64::NAN,
        ..case.shadows[0]
    };
    let nowhere = FrameAgents {
        shadows: vec![nowhere],
        ..FrameAgents::default()
    };
    let scene = FrameSplats::with_agents(&stage.world, &stage.pool, &nowhere);
    let error = stage.renderer.render(scene, &case.cameras).unwrap_err();
    assert!(
        matches!(error, RenderError::Shadow { index: 0, .. })
            && error.to_string().contains("strength"),
        "{error}"
    );
    let mut dark = some_transfer(1);
    dark.offset[3][1] = f32::INFINITY;
    agents[2].relight = Some(dark);
    let frame_agents = FrameAgents::new(&agents[..]);
    let scene = FrameSplats::with_agents(&stage.world, &stage.pool, &frame_agents);
    let error = stage.renderer.render(scene, &case.cameras).unwrap_err();
    assert!(
        matches!(error, RenderError::AgentLight { instance: 3 }),
        "{error}"
    );
    agents[2].relight = None;
    assert_eq!(
        stage.relit(&agents, &case.shadows, &case.cameras),
        1,
        "a refused frame leaves nothing behind"
    );
}

#[test]
fn shadows_lie_on_the_background_where_no_agent_is() {
    let gpu = Validated::open();
    let mut case = Case::new();
    case.placed.clear();
    for (image, truth) in case.drawn(&gpu).iter().zip(&case.truth()) {
        let difference = Difference::between(image, truth).unwrap();
        assert!(
            difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX,
            "{difference:?}"
        );
    }
}
