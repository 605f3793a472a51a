//! Sweeps of LiDARs against their f64 definition.

mod surfaces;
mod worlds;

use std::sync::Arc;

use decouplegs::render::layout::BeamState;
use decouplegs::render::reference::lidar::{BeamHit64, LidarSplats64, SplatGroup};
use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, LidarOptions, LidarRenderer, ResidentSplats,
    Storage, TracedSweep,
};
use decouplegs::scene::lidar::{
    Beam, FiringTime, LidarPattern, LidarRow, ReturnMode, ReturnOptions, Spin,
};
use decouplegs::scene::{Lidar, LidarModel, Motion, Pose, Rules, SplatCloud, SplatScene};
use glam::{DQuat, DVec3};

use super::agents::coded_car;
use super::{Splat, world_of};
use crate::device::Validated;
use crate::stages::Random;

/// A spinning LiDAR whose rows have the given elevations and azimuth offsets, degrees.
pub fn spinning(rows: &[(f64, f64)], columns: u32, field_deg: f64, spin: Spin) -> LidarModel {
    let row = |(laser, &(elevation_deg, offset_deg)): (usize, &(f64, f64))| LidarRow {
        elevation_rad: elevation_deg.to_radians(),
        azimuth_offset_rad: offset_deg.to_radians(),
        laser: laser as u16,
    };
    LidarModel {
        name: "test".into(),
        pattern: LidarPattern::Spinning {
            rows: rows.iter().enumerate().map(row).collect(),
            columns,
            first_azimuth_rad: match spin {
                Spin::Clockwise => 0.5 * field_deg,
                Spin::CounterClockwise => -0.5 * field_deg,
            }
            .to_radians(),
            field_rad: field_deg.to_radians(),
            spin,
            firing_time: FiringTime::Middle,
        },
        sweep_s: 0.1,
        range_m: [0.3, 200.0],
        returns: ReturnMode::Median,
        range_noise_m: 0.0,
    }
}

/// Rows at equal steps from `top_deg` down to `bottom_deg`.
pub fn uniform(count: usize, top_deg: f64, bottom_deg: f64) -> Vec<(f64, f64)> {
    let step = (top_deg - bottom_deg) / (count as f64 - 1.0);
    (0..count)
        .map(|row| (top_deg - step * row as f64, 0.0))
        .collect()
}

/// LiDARs of every kind: uniform rows, rows at uneven steps with azimuth offsets, a field of 120
/// degrees, both directions, and explicit rays.
pub fn models() -> Vec<(&'static str, LidarModel)> {
    let uneven: Vec<(f64, f64)> = uniform(24, 1.0, -1.0)
        .iter()
        .enumerate()
        .map(|(row, &(position, _))| {
            let offset_deg = [-4.2, -1.4, 1.4, 4.2][row % 4];
            (25.0 * position.powi(3) - 2.0 + 4.0 * position, offset_deg)
        })
        .collect();
    let mut random = Random(5);
    let rays = (0..4000)
        .map(|index| {
            let direction = DVec3::new(
                f64::from(random.between(-1.0, 1.0)),
                f64::from(random.between(-1.0, 1.0)),
                f64::from(random.between(-0.8, 0.8)),
            );
            Beam {
                direction: direction.normalize(),
                time_s: 0.1 * f64::from(index) / 4000.0,
                ring: (index % 4) as u16,
                laser: 0,
                column: index / 4,
            }
        })
        .collect();
    let clockwise = Spin::Clockwise;
    vec![
        (
            "uniform",
            spinning(&uniform(32, 10.67, -30.67), 120, 360.0, clockwise),
        ),
        (
            "uneven",
            spinning(&uneven, 150, 360.0, Spin::CounterClockwise),
        ),
        (
            "field of 120 degrees",
            spinning(&uneven, 100, 120.0, clockwise),
        ),
        (
            "rays",
            LidarModel {
                pattern: LidarPattern::Rays(rays),
                ..spinning(&uneven, 100, 360.0, clockwise)
            },
        ),
    ]
}

/// Splats all around a sensor at the origin: ground, walls, scattered ones, needles, discs, one
/// that contains the sensor, one straight above, one behind the seam.
pub fn surroundings(count: usize, seed: u64) -> SplatScene {
    let mut random = Random(seed);
    let mut splats: Vec<Splat> = (0..count)
        .map(|index| {
            let azimuth = random.between(-3.15, 3.15);
            let (sin, cos) = azimuth.sin_cos();
            let range_m = random.across_scales(2.0, 60.0);
            let common = Splat {
                mean_m: [
                    range_m * cos,
                    range_m * sin,
                    random.between(-0.4, 0.3) * range_m,
                ],
                scale_m: std::array::from_fn(|_| random.across_scales(0.02, 0.6)),
                rotation: std::array::from_fn(|_| random.between(-1.0, 1.0)),
                opacity: random.between(0.05, 1.0),
                rgb: std::array::from_fn(|_| random.between(0.0, 1.0)),
            };
            let [x, y, z] = common.mean_m;
            match index % 8 {
                0 => Splat {
                    mean_m: [x, y, -1.8],
                    scale_m: [0.5, 0.5, 0.01],
                    rotation: [1.0, 0.0, 0.0, 0.0],
                    opacity: 0.95,
                    ..common
                },
                1 => Splat {
                    mean_m: [30.0 * cos, 30.0 * sin, z],
                    scale_m: [0.7; 3],
                    opacity: 0.99,
                    ..common
                },
                2 => Splat {
                    scale_m: [random.between(0.5, 2.0), 1e-4, 1e-4],
                    ..common
                },
                3 => Splat {
                    scale_m: [random.between(0.1, 1.0), random.between(0.1, 1.0), 0.0],
                    ..common
                },
                _ => common,
            }
        })
        .collect();
    let special = |mean_m, size_m, opacity| Splat {
        mean_m,
        scale_m: [size_m; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity,
        rgb: [0.5; 3],
    };
    splats.push(special([0.2, 0.1, 0.0], 1.5, 0.1));
    splats.push(special([0.0, 0.0, 3.0], 1.0, 0.9));
    splats.push(special([-9.0, 0.0, -1.0], 0.8, 0.97));
    let mut world = world_of(&splats);
    world.splats = world.splats.in_spatial_order();
    world
}

/// Sweep of `model` from a vehicle at `origin` that moves with `motion`.
pub fn lidar_at(model: LidarModel, origin: DVec3, motion: Motion) -> Lidar {
    Lidar {
        name: "roof".into(),
        model: Arc::new(model),
        rig_from_lidar: Pose::new(DQuat::from_rotation_y(0.02), DVec3::new(0.4, 0.0, 0.2)),
        world_from_rig: Pose::from_yaw(0.7, origin),
        motion,
    }
}

/// Greatest differences between a sweep and its definition.
#[derive(Debug, Default)]
struct Agreement {
    beams: usize,
    /// Beams with a median in one and not in the other.
    masks: usize,
    /// Beams with a median in both.
    both: usize,
    /// Beams with a median in both whose ranges are farther apart than the limit.
    far: usize,
    /// Beams with a median in both whose instances differ.
    instances: usize,
    /// Root mean square of the differences of mean ranges where half of the beam is taken, meters.
    expected_rms_m: f64,
    intensity_max: f64,
}

impl Agreement {
    fn new(states: &[BeamState], truth: &[BeamHit64], limit_m: f64) -> Self {
        let mut found = Self {
            beams: truth.len(),
            ..Self::default()
        };
        let (mut squares, mut means) = (0.0, 0);
        for (state, hit) in states.iter().zip(truth) {
            let median = state.range(ReturnMode::Median);
            found.masks += usize::from(median.is_some() != hit.median.is_some());
            if let (Some((range_m, instance)), Some((truth_m, truth_instance))) =
                (median, hit.median)
            {
                found.both += 1;
                found.far += usize::from((f64::from(range_m) - truth_m).abs() > limit_m);
                found.instances += usize::from(instance != truth_instance);
            }
            if hit.transmittance < 0.5
                && let Some((mean_m, _)) = state.range(ReturnMode::Expected)
            {
                squares += (f64::from(mean_m) - hit.expected_m).powi(2);
                means += 1;
                let intensity = (f64::from(state.intensity()) - hit.intensity).abs();
                found.intensity_max = found.intensity_max.max(intensity);
            }
        }
        found.expected_rms_m = (squares / f64::from(means.max(1))).sqrt();
        found
    }

    /// Asserts the limits of a sweep, as shares of beams.
    fn assert(&self, what: &str, share: f64) {
        println!("{what}: {self:?}");
        assert!(
            self.both * 5 > self.beams,
            "{what}: too few returns: {self:?}"
        );
        let limit = |of: usize| (share * of as f64).ceil() as usize;
        assert!(self.masks <= limit(self.beams), "{what}: {self:?}");
        assert!(self.far <= limit(self.both), "{what}: {self:?}");
        assert!(self.instances <= limit(self.both), "{what}: {self:?}");
    }
}

fn group(splats: &SplatCloud, origin: DVec3) -> SplatGroup<'_> {
    SplatGroup {
        splats,
        instances: &[],
        instance: 0,
        world_from_splats: Pose::new(DQuat::IDENTITY, origin),
        motion: Motion::REST,
    }
}

fn trace(gpu: &Validated, world: &SplatScene, lidar: &Lidar, sectors: usize) -> TracedSweep {
    let options = LidarOptions {
        rules: world.rules,
        sectors,
    };
    let resident = ResidentSplats::upload(gpu, world, Storage::Exact).unwrap();
    let mut renderer = LidarRenderer::new(gpu, options);
    renderer
        .trace(&resident, lidar, ReturnMode::Median)
        .unwrap()
}

fn truth_of(world: &SplatScene, lidar: &Lidar, beams: &[Beam]) -> Vec<BeamHit64> {
    let scene = LidarSplats64 {
        groups: vec![group(&world.splats, world.origin)],
        rules: world.rules,
    };
    scene.hits(lidar, beams)
}

#[test]
fn sweeps_of_every_kind_of_sensor_are_their_definition() {
    let gpu = Validated::open();
    let mut world = surroundings(3000, 1);
    world.origin = DVec3::new(4.5e6, 0.7e6, 30.0);
    for (what, model) in models() {
        for rules in [
            Rules::DEFAULT,
            Rules {
                antialias: true,
                ..Rules::GSPLAT15
            },
        ] {
            world.rules = rules;
            let lidar = lidar_at(model.clone(), world.origin, Motion::REST);
            let traced = trace(&gpu, &world, &lidar, 8);
            let truth = truth_of(&world, &lidar, &traced.beams);
            let found = Agreement::new(&traced.states, &truth, 1e-3);
            found.assert(what, 1e-3);
            assert!(found.expected_rms_m < 1e-3, "{what}: {found:?}");
            assert!(found.intensity_max < 2e-3, "{what}: {found:?}");
        }
    }
}

#[test]
fn splats_of_the_sky_are_seen_and_not_met() {
    let gpu = Validated::open();
    let mut world = surroundings(3000, 1);
    let (_, model) = models().swap_remove(0);
    let lidar = lidar_at(model, world.origin, Motion::REST);
    let all = trace(&gpu, &world, &lidar, 8);
    let splats = world.splats.len();
    world.sky_splats = (0..splats as u32).step_by(2).collect();
    let met = world.without_sky_splats().into_owned();
    let traced = trace(&gpu, &world, &lidar, 8);
    assert_eq!(traced.states, trace(&gpu, &met, &lidar, 8).states);
    assert_ne!(traced.states, all.states);
    let resident = ResidentSplats::upload(&gpu, &world, Storage::Exact).unwrap();
    assert_eq!(resident.splats, splats);
    assert_eq!(resident.for_lidar().splats, splats / 2);
}

#[test]
fn dual_returns_are_their_definition() {
    let gpu = Validated::open();
    let world = surroundings(3000, 4);
    let resident = ResidentSplats::upload(&gpu, &world, Storage::Exact).unwrap();
    let mut renderer = LidarRenderer::new(&gpu, LidarOptions::default());
    for (what, model) in models() {
        let lidar = lidar_at(model, world.origin, Motion::REST);
        let traced = renderer.trace(&resident, &lidar, ReturnMode::Dual).unwrap();
        // Echoes cost the other returns nothing, and buffers of earlier sweeps leave no trace.
        let single = renderer
            .trace(&resident, &lidar, ReturnMode::Median)
            .unwrap();
        assert!(
            traced.states == single.states && single.echoes.is_empty(),
            "{what}"
        );
        let truth = truth_of(&world, &lidar, &traced.beams);
        let [mut returns, mut seconds, mut masks, mut far, mut instances] = [0; 5];
        for (echoes, hit) in traced.echoes.iter().zip(&truth) {
            for (number, pair) in echoes.found().into_iter().zip(hit.dual()).enumerate() {
                match pair {
                    (Some(found), Some(exact)) => {
                        returns += 1;
                        seconds += number;
                        far += usize::from((f64::from(found.range_m) - exact.range_m).abs() > 1e-3);
                        instances += usize::from(found.instance != exact.instance);
                        assert!((f64::from(found.intensity) - exact.intensity).abs() < 1e-2);
                    }
                    (None, None) => {}
                    _ => masks += 1,
                }
            }
        }
        println!(
            "{what}: {returns} returns, {seconds} of them second ones; {masks} in one alone, {far} farther than 1 mm, {instances} of another instance"
        );
        let limit = traced.beams.len().div_ceil(1000);
        assert!(seconds * 50 > returns, "{what}: {seconds} of {returns}");
        assert!(
            masks <= limit && far <= limit && instances <= limit,
            "{what}"
        );
        let sweep = traced.returns(&ReturnOptions {
            mode: ReturnMode::Dual,
            ..ReturnOptions::for_model(&lidar.model)
        });
        let of_two: Vec<_> = sweep
            .returns
            .iter()
            .filter(|found| found.count == 2)
            .collect();
        assert!(of_two.chunks(2).all(|pair| {
            (pair[0].beam, pair[0].number, pair[1].number) == (pair[1].beam, 1, 2)
        }));
        assert!(
            of_two.len() > returns / 50,
            "{what}: {} returns",
            of_two.len()
        );
    }
}

#[test]
#[should_panic(expected = "traced without echoes")]
fn dual_returns_of_a_single_sweep_are_refused() {
    let gpu = Validated::open();
    let (_, model) = models().swap_remove(0);
    let lidar = lidar_at(model, DVec3::ZERO, Motion::REST);
    let traced = trace(&gpu, &surroundings(200, 5), &lidar, 8);
    let _ = traced.returns(&ReturnOptions {
        mode: ReturnMode::Dual,
        ..ReturnOptions::for_model(&lidar.model)
    });
}

#[test]
#[should_panic(expected = "shifted: Agreement")]
fn splats_that_stand_2_mm_off_are_noticed() {
    let gpu = Validated::open();
    let mut world = surroundings(1500, 1);
    let (_, model) = models().swap_remove(0);
    let lidar = lidar_at(model, world.origin, Motion::REST);
    let traced = trace(&gpu, &world, &lidar, 8);
    for mean_m in &mut world.splats.means {
        mean_m[0] += 2e-3;
    }
    let truth = truth_of(&world, &lidar, &traced.beams);
    Agreement::new(&traced.states, &truth, 1e-3).assert("shifted", 1e-3);
}

#[test]
fn sweeps_in_motion_are_their_definition() {
    let gpu = Validated::open();
    let world = surroundings(400, 2);
    let driving = Motion {
        velocity_mps: DVec3::new(24.0, 18.0, 0.0),
        turn_rad_per_s: DVec3::new(0.05, -0.1, 1.0),
    };
    let cars = [coded_car(3000, 2), coded_car(2000, 3)];
    let moving = [
        (
            Pose::from_yaw(0.3, DVec3::new(7.0, 6.0, -0.5)),
            Motion {
                velocity_mps: DVec3::new(-12.0, 16.0, 0.0),
                turn_rad_per_s: DVec3::ZERO,
            },
        ),
        (
            Pose::from_yaw(-2.0, DVec3::new(-5.0, 5.0, -0.6)),
            Motion {
                velocity_mps: DVec3::new(2.0, 0.0, 0.0),
                turn_rad_per_s: DVec3::new(0.0, 0.0, 0.5),
            },
        ),
    ];
    let resident = ResidentSplats::upload(&gpu, &world, Storage::Exact).unwrap();
    let mut pool = AssetPool::new(&gpu).unwrap();
    let agents: Vec<Agent> = (cars.iter().zip(moving).enumerate())
        .map(|(index, (car, (pose, motion)))| Agent {
            motion,
            ..Agent::new(pool.add(car).unwrap(), pose, index as u16 + 1)
        })
        .collect();
    let decoded = cars.each_ref().map(|car| car.decoded(0));
    let mut groups = vec![group(&world.splats, world.origin)];
    for (index, (splats, (pose, motion))) in decoded.iter().zip(moving).enumerate() {
        groups.push(SplatGroup {
            splats,
            instances: &[],
            instance: index as u16 + 1,
            world_from_splats: pose,
            motion,
        });
    }
    let scene = LidarSplats64 {
        groups,
        rules: world.rules,
    };
    for (what, model) in models() {
        let lidar = lidar_at(model, world.origin, driving);
        for sectors in [8, 32] {
            let options = LidarOptions {
                sectors,
                ..LidarOptions::default()
            };
            let mut renderer = LidarRenderer::new(&gpu, options);
            let frame_agents = FrameAgents::new(&agents[..]);
            let with_agents = FrameSplats::with_agents(&resident, &pool, &frame_agents);
            let traced = renderer
                .trace(with_agents, &lidar, ReturnMode::Dual)
                .unwrap();
            let truth = scene.hits(&lidar, &traced.beams);
            let on_agents = truth
                .iter()
                .filter(|hit| hit.median.is_some_and(|(_, id)| id > 0));
            assert!(on_agents.count() > 20, "{what}: no beam meets an agent");
            let found = Agreement::new(&traced.states, &truth, 1e-2);
            found.assert(what, 4e-3);
        }
    }
}

#[test]
fn sweeps_repeat_and_do_not_depend_on_sectors() {
    let gpu = Validated::open();
    let world = surroundings(2000, 3);
    for (what, model) in models() {
        let lidar = lidar_at(model.clone(), world.origin, Motion::REST);
        let traced = trace(&gpu, &world, &lidar, 8);
        assert_eq!(
            traced.states,
            trace(&gpu, &world, &lidar, 8).states,
            "{what}"
        );
        for sectors in [1, 3, 32] {
            let other = trace(&gpu, &world, &lidar, sectors);
            let pairs = || traced.states.iter().zip(&other.states);
            let median = |state: &BeamState| state.range(ReturnMode::Median);
            let masks = pairs().filter(|(a, b)| median(a).is_some() != median(b).is_some());
            assert_eq!(masks.count(), 0, "{what} in {sectors} sectors");
            let apart = |(a, b): (&BeamState, &BeamState)| (a.median_m - b.median_m).abs();
            let most = pairs().map(apart).fold(0.0, f32::max);
            println!("{what}: {sectors} sectors are {most} m from 8 at most");
            assert!(most < 1e-3, "{what}: {most} m in {sectors} sectors");
        }
        // A sensor whose poses say that it moves, but does not, finds the same.
        let standing = Motion {
            velocity_mps: DVec3::X * 1e-12,
            ..Motion::REST
        };
        let moving = trace(&gpu, &world, &lidar_at(model, world.origin, standing), 8);
        let apart = |(a, b): (&BeamState, &BeamState)| (a.median_m - b.median_m).abs();
        let most = (traced.states.iter().zip(&moving.states)).map(apart);
        assert!(most.fold(0.0, f32::max) < 1e-3, "{what}");
        let seeded = |seed| {
            let options = ReturnOptions::for_model(&lidar.model);
            traced.returns(&ReturnOptions { seed, ..options }).returns
        };
        assert_eq!(seeded(1), seeded(2), "{what}: noise without a deviation");
    }
    let (_, model) = models().swap_remove(0);
    let noisy = LidarModel {
        range_noise_m: 0.02,
        ..model
    };
    let lidar = lidar_at(noisy, world.origin, Motion::REST);
    let traced = trace(&gpu, &world, &lidar, 8);
    let returns = |seed| {
        let options = ReturnOptions::for_model(&lidar.model);
        traced.returns(&ReturnOptions { seed, ..options }).returns
    };
    assert_eq!(returns(7), returns(7));
    assert_ne!(returns(7), returns(8));
    let errors: Vec<f64> = (returns(7).iter())
        .map(|found| f64::from(found.range_m - traced.states[found.beam as usize].median_m))
        .collect();
    let deviation = |values: &[f64]| {
        (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
    };
    assert!((deviation(&errors) / 0.02 - 1.0).abs() < 0.05);
}
