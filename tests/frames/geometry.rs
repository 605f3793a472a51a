//! Planes of geometry against the f64 definition.

use std::borrow::Cow;

use decouplegs::render::reference::geometry::{Geometry64, render_geometry};
use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, Image, Outputs, Plane, Planes, RenderOptions,
    Renderer, reference,
};
use decouplegs::scene::{
    AgentPlacement, Camera, Intrinsics, Motion, Pose, Rules, ShFrame, SplatScene,
};
use glam::{DQuat, DVec2, DVec3};

use super::agents::{background, camera_towards, coded_car};
use super::hard_cases::crowd;
use super::{Splat, camera_at, world_of};
use crate::device::Validated;
use crate::stages::scenes::lens_rig;

const INTERVAL_S: f64 = 0.05;

const GEOMETRY: [Plane; 7] = [
    Plane::Range,
    Plane::Normal,
    Plane::FlowForward,
    Plane::FlowBackward,
    Plane::SceneFlow,
    Plane::DepthMedian,
    Plane::RangeMedian,
];

/// A world with agents, cars that all look the same.
struct Moving {
    world: SplatScene,
    cars: Vec<(Pose, Motion)>,
}

impl Moving {
    /// The world `time_s` later, of splats alone.
    fn at(&self, time_s: f64) -> SplatScene {
        let mut world = self.world.clone();
        let car = coded_car(500, 2).decoded(0);
        for (index, (pose, motion)) in self.cars.iter().enumerate() {
            let placement = AgentPlacement {
                name: index.to_string(),
                asset: 0,
                world_from_agent: pose.moved(motion, time_s),
                sh_frame: ShFrame::Canonical,
            };
            world.bake_agent(&car, &placement).unwrap();
        }
        world
    }

    fn draw(&self, gpu: &Validated, camera: &Camera, planes: Planes, rules: Rules) -> Image {
        let options = RenderOptions {
            rules,
            outputs: Outputs {
                planes,
                ..Outputs::default()
            },
            flow_interval_s: INTERVAL_S,
            ..RenderOptions::default()
        };
        let mut renderer = Renderer::new(gpu, options);
        let resident = renderer.upload(&self.world).unwrap();
        let mut pool = AssetPool::new(gpu).unwrap();
        let asset = pool.add(&coded_car(500, 2)).unwrap();
        let agents: Vec<Agent> = self
            .cars
            .iter()
            .zip(1..)
            .map(|(&(pose, motion), instance)| Agent {
                motion,
                ..Agent::new(asset, pose, instance)
            })
            .collect();
        let frame_agents = FrameAgents::new(&agents[..]);
        let scene = FrameSplats::with_agents(&resident, &pool, &frame_agents);
        renderer
            .render(scene, std::slice::from_ref(camera))
            .unwrap();
        renderer.read_images().unwrap().remove(0)
    }

    fn truth(&self, camera: &Camera, rules: &Rules) -> Geometry64 {
        let world_at = |time_s: f64| Cow::Owned(self.at(time_s));
        render_geometry(&world_at, camera, rules, INTERVAL_S)
    }
}

fn values(image: &Image, plane: Plane) -> &[f32] {
    image.planes[&plane].as_f32().unwrap()
}

/// Differences of `plane` from `truth` by pixel, in the order of size.
fn differences(image: &Image, plane: Plane, truth: &[DVec3]) -> Vec<f64> {
    let channels = plane.channels();
    let pixels = values(image, plane).chunks_exact(channels).zip(truth);
    let mut differences: Vec<f64> = pixels
        .map(|(found, truth)| {
            let off = |channel: usize| (f64::from(found[channel]) - truth[channel]).abs();
            (0..channels).map(off).fold(0.0, f64::max)
        })
        .collect();
    differences.sort_by(f64::total_cmp);
    differences
}

fn planes_of(truth: &Geometry64) -> [(Plane, Vec<DVec3>); 7] {
    let flow = |flow: &[[f64; 2]]| flow.iter().map(|&[x, y]| DVec3::new(x, y, 0.0)).collect();
    let scalar = |values: &[f64]| values.iter().map(|&value| DVec3::X * value).collect();
    [
        (Plane::Range, scalar(&truth.range)),
        (Plane::DepthMedian, scalar(&truth.depth_median)),
        (Plane::RangeMedian, scalar(&truth.range_median)),
        (Plane::Normal, truth.normal.clone()),
        (Plane::FlowForward, flow(&truth.flow_forward)),
        (Plane::FlowBackward, flow(&truth.flow_backward)),
        (Plane::SceneFlow, truth.scene_flow.clone()),
    ]
}

/// Largest allowed difference for all but one pixel in a hundred, whose last weights f32 decides.
fn tolerance(plane: Plane) -> f64 {
    match plane {
        Plane::Range | Plane::DepthMedian | Plane::RangeMedian => 2e-4,
        Plane::Normal => 2e-4,
        Plane::SceneFlow => 5e-3,
        _ => 1e-3,
    }
}

fn assert_near(moving: &Moving, camera: &Camera, rules: Rules) {
    let gpu = Validated::open();
    let image = moving.draw(&gpu, camera, GEOMETRY.into(), rules);
    for (plane, truth) in planes_of(&moving.truth(camera, &rules)) {
        let differences = differences(&image, plane, &truth);
        let most = differences[differences.len() * 99 / 100];
        let (name, last) = (plane.name(), differences[differences.len() - 1]);
        println!(
            "{}: {name}: 99 % within {most:.2e}, all within {last:.2e}",
            camera.name
        );
        assert!(most <= tolerance(plane), "{}: {name}: {most}", camera.name);
    }
}

fn some_cars() -> Vec<(Pose, Motion)> {
    let motion = |x_mps: f64, y_mps: f64, turn: f64| Motion {
        velocity_mps: DVec3::new(x_mps, y_mps, 0.3),
        turn_rad_per_s: DVec3::new(0.0, 0.1, turn),
    };
    let at = |yaw_rad: f64, x: f64, y: f64| Pose::from_yaw(yaw_rad, DVec3::new(x, y, 0.0));
    vec![
        (at(1.5, 9.0, 1.0), motion(0.0, 15.0, 0.0)),
        (at(0.4, 11.0, -3.0), motion(5.0, -2.0, 0.5)),
        (at(0.0, 8.0, 4.0), Motion::REST),
    ]
}

fn driving(camera: Camera) -> Camera {
    Camera {
        motion: Motion {
            velocity_mps: DVec3::new(12.0, 0.5, 0.0),
            turn_rad_per_s: DVec3::new(0.05, 0.4, 0.0),
        },
        ..camera
    }
}

#[test]
fn planes_of_cars_and_a_camera_in_motion() {
    let eye = DVec3::new(0.0, 0.0, 0.3);
    let ahead = camera_towards("ahead", eye, DVec3::new(10.0, 0.5, 0.0), (120, 80));
    let moving = Moving {
        // Needles and discs have one thinnest axis; others have several, and no normal.
        world: background(0, 1),
        cars: some_cars(),
    };
    for rules in [Rules::DEFAULT, Rules::INRIA, Rules::NUREC] {
        assert_near(&moving, &driving(ahead.clone()), rules);
    }
    let lens = |index: usize| Camera {
        intrinsics: lens_rig()[index].intrinsics.resized(120, 80),
        name: format!("lens {index}"),
        ..ahead.clone()
    };
    for index in [1, 2] {
        assert_near(&moving, &driving(lens(index)), Rules::DEFAULT);
    }
}

#[test]
fn planes_of_a_crowd() {
    let mut splats = crowd(300);
    for (index, splat) in splats.iter_mut().enumerate() {
        splat.scale_m[index % 3] *= 0.1;
    }
    let moving = Moving {
        world: world_of(&splats),
        cars: vec![],
    };
    let camera = driving(camera_at(DVec3::ZERO, 96, 64));
    assert_near(&moving, &camera, Rules::DEFAULT);
}

#[test]
fn color_depth_and_instances_do_not_depend_on_planes_of_geometry() {
    let gpu = Validated::open();
    let moving = Moving {
        world: background(400, 2),
        cars: some_cars(),
    };
    let eye = DVec3::new(0.0, 0.0, 0.3);
    let camera = camera_towards("ahead", eye, DVec3::new(10.0, 0.5, 0.0), (120, 80));
    for rules in [Rules::DEFAULT, Rules::GSPLAT16, Rules::NUREC] {
        let plain = moving.draw(&gpu, &camera, Planes::BESIDE_COLOR, rules);
        let mut all = moving.draw(&gpu, &camera, Planes::ALL, rules);
        all.planes
            .retain(|plane, _| Planes::BESIDE_COLOR.contains(*plane));
        assert!(plain == all, "{rules:?}");
    }
}

#[test]
fn a_wall_has_the_normal_range_and_flow_of_a_plane() {
    let gpu = Validated::open();
    // Discs of a wall through (0, 0, 6), turned by 0.5 rad about y.
    let turn = DQuat::from_rotation_y(0.5);
    let splats: Vec<Splat> = (-60..=60)
        .flat_map(|column| (-40..=40).map(move |row| (column, row)))
        .map(|(column, row)| {
            let position = DVec3::new(0.1 * f64::from(column), 0.1 * f64::from(row), 0.0);
            let at = (DVec3::Z * 6.0 + turn * position).as_vec3();
            Splat {
                mean_m: at.to_array(),
                scale_m: [0.08, 0.08, 0.002],
                rotation: [turn.w, turn.x, turn.y, turn.z].map(|number| number as f32),
                opacity: 0.9,
                rgb: [0.5; 3],
            }
        })
        .collect();
    let moving = Moving {
        world: world_of(&splats),
        cars: vec![],
    };
    let still = camera_at(DVec3::ZERO, 96, 64);
    let camera = driving(still.clone());
    let image = moving.draw(&gpu, &camera, GEOMETRY.into(), Rules::DEFAULT);
    let normal = turn * -DVec3::Z;
    let k: Intrinsics = camera.intrinsics;
    let later = camera.at_rest(INTERVAL_S).world_from_camera.inverse();
    let mut flow_px = 0.0f64;
    for (pixel, &alpha) in image.alpha.iter().enumerate() {
        let (column, row) = (pixel as u32 % image.width, pixel as u32 / image.width);
        if alpha < 0.99 || !(8..88).contains(&column) || !(8..56).contains(&row) {
            continue;
        }
        let at_px = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let ray = k.unproject(at_px).unwrap();
        let range_m = 6.0 * normal.z / normal.dot(ray);
        let found = f64::from(values(&image, Plane::Range)[pixel]);
        assert!(
            // Nearer discs of several that overlap weigh more.
            (found / range_m - 1.0).abs() < 0.02,
            "{found} m instead of {range_m} m"
        );
        let found = &values(&image, Plane::Normal)[3 * pixel..3 * pixel + 3];
        let found = DVec3::new(found[0].into(), found[1].into(), found[2].into());
        assert!(found.normalize().angle_between(normal) < 2f64.to_radians());
        assert!(found.length() > 0.999, "all discs agree");
        let expected = k.project(later.transform(range_m * ray)).unwrap() - at_px;
        let found = &values(&image, Plane::FlowForward)[2 * pixel..2 * pixel + 2];
        let found = DVec2::new(found[0].into(), found[1].into());
        flow_px = flow_px.max((found - expected).length());
        assert!(expected.length() > 1.0, "the wall moves in the image");
    }
    println!("flow is off by at most {flow_px:.3} px");
    assert!(flow_px < 0.25, "{flow_px} px");
    // Medians are those of single discs.
    let medians = values(&image, Plane::RangeMedian).iter();
    let off = |(median, mean): (&f32, &f32)| (median / mean - 1.0).abs();
    let means = values(&image, Plane::Range).iter();
    let middle = image
        .alpha
        .iter()
        .zip(medians.zip(means))
        .filter(|(alpha, _)| **alpha > 0.99);
    let worst = middle.map(|(_, pair)| off(pair)).fold(0.0, f32::max);
    assert!(worst < 0.05, "{worst}");
    // A camera at rest sees no flow.
    let image = moving.draw(&gpu, &still, GEOMETRY.into(), Rules::DEFAULT);
    for plane in [Plane::FlowForward, Plane::FlowBackward, Plane::SceneFlow] {
        assert!(values(&image, plane).iter().all(|&value| value == 0.0));
    }
}

/// Lists that are cut into short segments have the medians of those that are not, but for pixels
/// in which rounding decides which splat takes half of the light.
#[test]
fn medians_do_not_depend_on_segments() {
    let gpu = Validated::open();
    let world = world_of(&crowd(4000));
    let camera = camera_at(DVec3::ZERO, 96, 64);
    let draw = |rules: Rules, segment_pairs: u32| {
        let options = RenderOptions {
            rules,
            segment_pairs,
            outputs: Outputs {
                planes: [Plane::DepthMedian, Plane::RangeMedian].into(),
                ..Outputs::default()
            },
            ..RenderOptions::default()
        };
        let mut renderer = Renderer::new(&gpu, options);
        let scene = renderer.upload(&world).unwrap();
        let statistics = renderer
            .render(&scene, std::slice::from_ref(&camera))
            .unwrap();
        let image = renderer.read_images().unwrap().remove(0);
        (image, statistics.required.partials)
    };
    let (whole, uncut) = draw(Rules::DEFAULT, 100_000);
    let truth = render_geometry(
        &|_| Cow::Borrowed(&world),
        &camera,
        &Rules::DEFAULT,
        INTERVAL_S,
    );
    for segment_pairs in [16, 70] {
        let (cut, partials) = draw(Rules::DEFAULT, segment_pairs);
        assert!(partials > uncut + 4, "{partials} partial results");
        for (plane, truth) in [
            (Plane::DepthMedian, &truth.depth_median),
            (Plane::RangeMedian, &truth.range_median),
        ] {
            let (cut, whole) = (values(&cut, plane), values(&whole, plane));
            let other = cut
                .iter()
                .zip(whole)
                .filter(|(cut, whole)| cut != whole)
                .count();
            let wrong = cut
                .iter()
                .zip(truth)
                .filter(|(cut, truth)| (f64::from(**cut) - **truth).abs() > 1e-3)
                .count();
            println!(
                "{segment_pairs}: {other} others, {wrong} wrong of {}",
                cut.len()
            );
            assert!(other * 500 <= cut.len() && wrong * 500 <= cut.len());
            assert!(cut.iter().filter(|value| **value > 0.0).count() > cut.len() / 4);
        }
    }
}

#[test]
fn a_comparator_finds_wrong_planes() {
    let moving = Moving {
        world: world_of(&crowd(50)),
        cars: vec![],
    };
    let camera = driving(camera_at(DVec3::ZERO, 48, 32));
    let truth = moving.truth(&camera, &Rules::DEFAULT);
    let gpu = Validated::open();
    let still = Camera {
        motion: Motion::REST,
        ..camera
    };
    let image = moving.draw(&gpu, &still, GEOMETRY.into(), Rules::DEFAULT);
    for (plane, truth) in planes_of(&truth) {
        if matches!(plane, Plane::FlowForward | Plane::FlowBackward) {
            let differences = differences(&image, plane, &truth);
            assert!(differences[differences.len() - 1] > 100.0 * tolerance(plane));
        }
    }
    // The f64 image of the same splats is one of color.
    let colors = reference::render(&moving.world, &still, &Rules::DEFAULT);
    assert_eq!(colors.alpha.len(), truth.range.len());
}
