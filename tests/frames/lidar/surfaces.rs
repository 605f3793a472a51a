//! Sweeps of surfaces whose positions are known.

use std::sync::Arc;

use decouplegs::render::layout::BeamState;
use decouplegs::render::{Outputs, Plane, PlaneValues, RenderOptions, Renderer};
use decouplegs::scene::lidar::{PointFrame, ReturnMode, ReturnOptions, Spin};
use decouplegs::scene::{Lidar, Motion, Pose, SplatScene};
use decouplegs::synth::street::{Street, StreetOptions};
use glam::{DQuat, DVec3};

use super::{spinning, trace, uniform};
use crate::device::Validated;
use crate::frames::agents::camera_towards;
use crate::frames::{Splat, world_of};

/// Thin opaque splats of standard deviation `size_m` at `points` with their normals.
fn surface(size_m: f32, points: impl Iterator<Item = (DVec3, DVec3)>) -> Vec<Splat> {
    let splat = |(point, normal): (DVec3, DVec3)| {
        let turn = DQuat::from_rotation_arc(DVec3::Z, normal);
        Splat {
            mean_m: point.as_vec3().to_array(),
            scale_m: [size_m, size_m, 0.001],
            rotation: [turn.w, turn.x, turn.y, turn.z].map(|value| value as f32),
            opacity: 0.99,
            rgb: [0.5; 3],
        }
    };
    points.map(splat).collect()
}

/// Positions of a square grid with `step_m` from -`half_m` to `half_m`.
fn grid(half_m: f64, step_m: f64) -> impl Iterator<Item = (f64, f64)> {
    let count = (2.0 * half_m / step_m).round() as i32;
    let at = move |index: i32| -half_m + step_m * f64::from(index);
    (0..=count).flat_map(move |i| (0..=count).map(move |j| (at(i), at(j))))
}

/// Distance along a ray from the origin to the nearest side of a cube around it, and the cosine of
/// the angle of incidence.
fn to_cube(direction: DVec3, half_m: f64) -> (f64, f64) {
    let largest = direction.abs().max_element();
    (half_m / largest, largest)
}

/// Distance along `direction` to a sphere.
fn to_sphere(direction: DVec3, center: DVec3, radius_m: f64) -> Option<(f64, f64)> {
    let middle = direction.dot(center);
    let half2 = radius_m * radius_m - (center - middle * direction).length_squared();
    (half2 > 0.0 && middle > 0.0).then(|| (middle - half2.sqrt(), half2.sqrt() / radius_m))
}

#[test]
fn ranges_of_known_surfaces_are_within_2_cm() {
    let gpu = Validated::open();
    let half_m = 4.0;
    let sides = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| {
        [axis, -axis].into_iter().flat_map(move |normal| {
            let (u, v) = normal.any_orthonormal_pair();
            grid(half_m, 0.07).map(move |(a, b)| (half_m * normal + a * u + b * v, -normal))
        })
    });
    let (center, radius_m) = (DVec3::new(2.0, 0.6, -0.3), 0.8);
    let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
    let ball = (0..30_000).map(|index| {
        let z = 1.0 - 2.0 * (f64::from(index) + 0.5) / 30_000.0;
        let (sin, cos) = (golden * f64::from(index)).sin_cos();
        let level = (1.0 - z * z).sqrt();
        let normal = DVec3::new(level * cos, level * sin, z);
        (center + radius_m * normal, normal)
    });
    // Small on the ball: flat splats stand off a curved surface by the square of their size.
    let splats = [surface(0.07, sides), surface(0.02, ball)].concat();
    let mut world = world_of(&splats);
    world.splats = world.splats.in_spatial_order();
    let model = spinning(&uniform(40, 40.0, -40.0), 180, 360.0, Spin::Clockwise);
    let lidar = Lidar {
        name: "middle".into(),
        model: Arc::new(model),
        rig_from_lidar: Pose::IDENTITY,
        world_from_rig: Pose::IDENTITY,
        motion: Motion::REST,
    };
    let traced = trace(&gpu, &world, &lidar, 8);
    let mode_of = [
        ReturnMode::Median,
        ReturnMode::Expected,
        ReturnMode::Strongest,
    ];
    for mode in mode_of {
        let (mut on_ball, mut worst) = (0, 0.0f64);
        for (beam, state) in traced.beams.iter().zip(&traced.states) {
            let (mut exact_m, mut cosine) = to_cube(beam.direction, half_m);
            let ball = to_sphere(beam.direction, center, radius_m);
            // Beams past the edge of the ball meet its splats as well: a surface has no edge there.
            if to_sphere(beam.direction, center, radius_m + 0.25).is_some() && ball.is_none() {
                continue;
            }
            // Likewise at the edges of the cube, where its sides end.
            let mut sizes = beam.direction.abs().to_array();
            sizes.sort_by(f64::total_cmp);
            if ball.is_none() && sizes[1] > 0.95 * sizes[2] {
                continue;
            }
            if let Some((ball_m, ball_cosine)) = ball {
                (exact_m, cosine) = (ball_m, ball_cosine);
                on_ball += usize::from(cosine > 75f64.to_radians().cos());
            }
            if cosine < 75f64.to_radians().cos() {
                continue;
            }
            let (range_m, _) = state.range(mode).expect("the cube is closed");
            worst = worst.max((f64::from(range_m) - exact_m).abs());
        }
        println!(
            "{}: {worst:.4} m at most, {on_ball} beams on the ball",
            mode.name()
        );
        assert!(on_ball > 200);
        assert!(worst < 0.02, "{}: {worst} m", mode.name());
    }
}

#[test]
fn a_camera_and_a_lidar_agree_on_opaque_surfaces() {
    let gpu = Validated::open();
    // Walls without gaps. Planes have the ranges of splats' means, so their splats are small.
    let wall = |half_m: f64, middle: DVec3, normal: DVec3| {
        let (u, v) = normal.any_orthonormal_pair();
        grid(half_m, 0.008).map(move |(a, b)| (middle + a * u + b * v, normal))
    };
    let slanted = DVec3::new(-1.0, 0.6, 0.1).normalize();
    let walls = wall(0.9, DVec3::new(4.0, 0.8, 0.0), DVec3::NEG_X);
    let walls = walls.chain(wall(0.7, DVec3::new(3.5, -1.2, 0.0), slanted));
    let mut world = world_of(&surface(0.008, walls));
    world.splats = world.splats.in_spatial_order();
    let position = DVec3::new(0.3, -0.2, 0.1);
    let lidar = Lidar {
        name: "roof".into(),
        model: Arc::new(spinning(
            &uniform(64, 12.0, -12.0),
            1800,
            360.0,
            Spin::Clockwise,
        )),
        rig_from_lidar: Pose::IDENTITY,
        world_from_rig: Pose::from_yaw(0.1, position),
        motion: Motion::REST,
    };
    let traced = trace(&gpu, &world, &lidar, 8);
    let sweep = traced.returns(&ReturnOptions::for_model(&lidar.model));
    let mut camera = camera_towards(
        "front",
        position,
        position + DVec3::new(1.0, 0.0, -0.1),
        (1280, 720),
    );
    camera.name = "front".into();
    let planes = [Plane::RangeMedian].into_iter().collect();
    let options = RenderOptions {
        outputs: Outputs {
            planes,
            ..Outputs::default()
        },
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(&gpu, options);
    let resident = renderer.upload(&world).unwrap();
    renderer.render(&resident, &[camera.clone()]).unwrap();
    let image = renderer.read_images().unwrap().remove(0);
    let Some(PlaneValues::F32(ranges_m)) = image.planes.get(&Plane::RangeMedian) else {
        panic!("the plane was asked for")
    };
    let camera_from_world = camera.world_from_camera.inverse();
    let (mut compared, mut agree) = (0, 0);
    for point in sweep.points(PointFrame::World) {
        let seen = camera_from_world.transform(point.position_m);
        let Some(at) = camera.intrinsics.project(seen).filter(|_| seen.z > 0.0) else {
            continue;
        };
        let (width, height) = (f64::from(image.width), f64::from(image.height));
        if !(at.x > 1.0 && at.y > 1.0 && at.x < width - 1.0 && at.y < height - 1.0) {
            continue;
        }
        // The plane has the ranges of pixels' centers: between the four around the point, straight.
        let corner = (at - 0.5).floor();
        let share = at - 0.5 - corner;
        let range_m = |x: f64, y: f64| {
            let (column, row) = (corner.x + x, corner.y + y);
            f64::from(ranges_m[row as usize * image.width as usize + column as usize])
        };
        let top = range_m(0.0, 0.0) * (1.0 - share.x) + range_m(1.0, 0.0) * share.x;
        let bottom = range_m(0.0, 1.0) * (1.0 - share.x) + range_m(1.0, 1.0) * share.x;
        let expected_m = top * (1.0 - share.y) + bottom * share.y;
        let found_m = seen.length();
        // At edges the four pixels show different things.
        let four = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(x, y)| range_m(x, y));
        let [low, high] = four
            .iter()
            .fold([f64::INFINITY, 0.0], |[low, high], &range| {
                [range.min(low), range.max(high)]
            });
        if high - low > 0.05 {
            continue;
        }
        compared += 1;
        agree += usize::from((found_m - expected_m).abs() <= 0.01 + 1e-3 * found_m);
    }
    println!("{agree} of {compared} points agree");
    assert!(compared > 5000);
    assert!(agree * 100 >= compared * 99, "{agree} of {compared}");
}

#[test]
fn ranges_from_a_moving_sensor_are_those_of_each_beams_own_place() {
    let gpu = Validated::open();
    let half_m = 3.0;
    let side = |normal: DVec3| {
        let (u, v) = normal.any_orthonormal_pair();
        grid(half_m, 0.1).map(move |(a, b)| (half_m * normal + a * u + b * v, -normal))
    };
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let sides = axes.into_iter().flat_map(|axis| [axis, -axis]);
    let mut world = world_of(&surface(0.07, sides.flat_map(side)));
    world.splats = world.splats.in_spatial_order();
    let model = spinning(&uniform(40, 40.0, -40.0), 180, 360.0, Spin::Clockwise);
    // 1.8 m and 0.3 rad in one sweep, inside of the cube.
    let motion = Motion {
        velocity_mps: DVec3::new(18.0, 0.0, 0.0),
        turn_rad_per_s: DVec3::new(0.0, 0.0, 3.0),
    };
    let lidar = Lidar {
        name: "fast".into(),
        model: Arc::new(model),
        rig_from_lidar: Pose::IDENTITY,
        world_from_rig: Pose::from_yaw(0.0, DVec3::new(-0.9, 0.1, 0.0)),
        motion,
    };
    let to_sides = |from: DVec3, direction: DVec3| {
        let along = |axis: usize| {
            let sign = direction[axis].signum();
            (half_m * sign - from[axis]) / direction[axis]
        };
        let mut ranges = [0, 1, 2].map(|axis| (along(axis), direction[axis].abs()));
        ranges.sort_by(|a, b| a.0.total_cmp(&b.0));
        ranges
    };
    let traced = trace(&gpu, &world, &lidar, 8);
    let (mut worst_m, mut compared, mut at_rest_m) = (0.0f64, 0, 0.0f64);
    for (beam, state) in traced.beams.iter().zip(&traced.states) {
        let pose = lidar.pose_at(beam.time_s);
        let direction = pose.rotation * beam.direction;
        let [(exact_m, cosine), (next_m, _), _] = to_sides(pose.translation, direction);
        // Neither at the edges of the cube nor at grazing incidence.
        if cosine < 75f64.to_radians().cos() || next_m - exact_m < 0.3 {
            continue;
        }
        let (range_m, _) = state.range(ReturnMode::Median).expect("the cube is closed");
        worst_m = worst_m.max((f64::from(range_m) - exact_m).abs());
        let start = &lidar.world_from_rig;
        let [(start_m, _), ..] = to_sides(start.translation, start.rotation * beam.direction);
        at_rest_m = at_rest_m.max((f64::from(range_m) - start_m).abs());
        compared += 1;
    }
    println!(
        "{compared} beams: {worst_m:.4} m at most, {at_rest_m:.2} m from the pose at the start"
    );
    assert!(compared > 3000 && worst_m < 0.02, "{worst_m} m");
    assert!(at_rest_m > 1.0, "the motion counts");
    let other = trace(&gpu, &world, &lidar, 32);
    let apart = |(a, b): (&BeamState, &BeamState)| (a.median_m - b.median_m).abs();
    let mut apart: Vec<f32> = traced.states.iter().zip(&other.states).map(apart).collect();
    apart.sort_by(f32::total_cmp);
    let most = apart[apart.len() * 999 / 1000];
    println!("8 and 32 sectors: {most} m apart at the 99.9th percentile");
    assert!(most < 0.01, "{most} m between 8 and 32 sectors");
}

#[test]
fn the_road_of_the_street_is_where_it_is() {
    let gpu = Validated::open();
    let street = Street::generate(&StreetOptions {
        background: 100_000,
        agents: 0,
        ..StreetOptions::default()
    });
    let mut world = SplatScene::from_splats(street.background);
    world.splats = world.splats.in_spatial_order();
    let model = spinning(&uniform(64, 5.0, -25.0), 720, 360.0, Spin::Clockwise);
    let height_m = 1.9;
    let lidar = Lidar {
        name: "roof".into(),
        model: Arc::new(model),
        rig_from_lidar: Pose::IDENTITY,
        world_from_rig: Pose::from_yaw(0.3, DVec3::new(-20.0, -1.75, height_m)),
        motion: Motion::REST,
    };
    let sweep = trace(&gpu, &world, &lidar, 8).returns(&ReturnOptions::for_model(&lidar.model));
    let mut by_incidence = [Vec::new(), Vec::new()];
    for point in sweep.points(PointFrame::World) {
        // Within the lanes, which are level at 0.
        if point.position_m.y.abs() > 5.0 || point.position_m.z > 0.3 {
            continue;
        }
        let cosine = height_m / f64::from(point.measured.range_m);
        let is_grazing = cosine < 75f64.to_radians().cos();
        by_incidence[usize::from(is_grazing)].push(point.position_m.z.abs());
    }
    for (heights_m, incidence) in by_incidence.iter_mut().zip(["below", "above"]) {
        heights_m.sort_by(f64::total_cmp);
        let [half, most] = [50, 95].map(|percent| heights_m[heights_m.len() * percent / 100]);
        let count = heights_m.len();
        println!(
            "incidence {incidence} 75 degrees: {count} points on the road, {half:.3} m off in the median, {most:.3} m at the 95th percentile"
        );
    }
    let steep = &by_incidence[0];
    assert!(steep.len() > 2000, "{} points", steep.len());
    assert!(steep[steep.len() / 2] < 0.02 && steep[steep.len() * 95 / 100] < 0.06);
}
