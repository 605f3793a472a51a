//! The street as a whole: counts, statistics, bounds, determinism, cars on their wheels.

use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};

use decouplegs_scene::SplatCloud;
use glam::{DVec3, Vec3};

use super::layout::Layout;
use super::{AssetLight, Capture, Street, StreetOptions, Weather, furniture, sky};

const SMALL: StreetOptions = StreetOptions {
    background: 60_000,
    agents: 14,
    agent_splats: 4_000,
    sh_degree: 3,
    seed: 9,
    weather: Weather::Clear,
    asset_light: AssetLight::Sun,
    capture: Capture::Ego,
};

fn hash(street: &Street) -> u64 {
    let mut hasher = DefaultHasher::new();
    for cloud in std::iter::once(&street.background).chain(&street.assets) {
        let floats = [&cloud.means, &cloud.scales, &cloud.sh_dc, &cloud.sh_rest]
            .into_iter()
            .flat_map(|array| array.as_flattened());
        floats
            .chain(cloud.rotations.as_flattened())
            .chain(&cloud.opacities)
            .for_each(|value| value.to_bits().hash(&mut hasher));
    }
    format!(
        "{:?}{:?}{:?}",
        street.agents, street.agent_trajectories, street.ego
    )
    .hash(&mut hasher);
    hasher.finish()
}

fn on_threads(threads: usize, options: &StreetOptions) -> Street {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
        .install(|| Street::generate(options))
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_number_of_threads() {
    let one = hash(&on_threads(1, &SMALL));
    assert_eq!(one, hash(&on_threads(1, &SMALL)), "twice on one thread");
    assert_eq!(one, hash(&on_threads(2, &SMALL)), "one thread and two");
    assert_ne!(
        one,
        hash(&on_threads(2, &StreetOptions { seed: 10, ..SMALL })),
        "the seed must matter"
    );
    for weather in [Weather::Overcast, Weather::Dusk, Weather::Night] {
        let options = StreetOptions {
            background: 20_000,
            weather,
            ..SMALL
        };
        assert_eq!(
            hash(&on_threads(1, &options)),
            hash(&on_threads(2, &options)),
            "{weather:?}"
        );
    }
}

/// Figures of earlier releases are of this street: what is added must leave it as it was. Sums
/// rather than bits, which functions of the C library may round differently from one machine to the
/// next.
#[test]
fn the_clear_street_and_its_sunlit_cars_are_what_they_were() {
    let street = Street::generate(&SMALL);
    let frozen = [
        (
            &street.background,
            [
                -0.358_112_209,
                -0.328_467_123,
                -0.354_766_834,
                0.422_052_496,
                0.496_321_015,
                5.314_217_242,
            ],
        ),
        (
            &street.assets[0],
            [
                -0.345_663_563,
                -0.324_978_186,
                -0.297_708_669,
                0.477_371_978,
                0.488_315_753,
                0.178_925_274,
            ],
        ),
    ];
    for (cloud, expected) in frozen {
        let mean = |values: &mut dyn Iterator<Item = f32>| {
            values.map(f64::from).sum::<f64>() / cloud.len() as f64
        };
        let found = [
            mean(&mut cloud.sh_dc.iter().map(|dc| dc[0])),
            mean(&mut cloud.sh_dc.iter().map(|dc| dc[1])),
            mean(&mut cloud.sh_dc.iter().map(|dc| dc[2])),
            mean(&mut cloud.sh_rest.as_flattened().iter().map(|value| value.abs())),
            mean(&mut cloud.opacities.iter().copied()),
            mean(&mut cloud.scales.as_flattened().iter().copied()),
        ];
        let off = found
            .iter()
            .zip(expected)
            .map(|(a, b): (&f64, f64)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(off < 1e-6, "{found:?}; expected {expected:?}");
    }
}

#[test]
fn counts_are_exact_at_every_size_and_degree() {
    for (background, agents, agent_splats, sh_degree) in [
        (0, 0, 0, 0),
        (1, 1, 1, 1),
        (777, 3, 10, 2),
        (50_000, 40, 1_234, 3),
        (2_000, 500, 5, 9),
    ] {
        let street = Street::generate(&StreetOptions {
            background,
            agents,
            agent_splats,
            sh_degree,
            ..SMALL
        });
        let check = |cloud: &SplatCloud, count: usize| {
            let lengths = [
                cloud.means.len(),
                cloud.scales.len(),
                cloud.rotations.len(),
                cloud.opacities.len(),
                cloud.sh_dc.len(),
            ];
            assert_eq!(lengths, [count; 5]);
            assert_eq!(cloud.sh_degree, sh_degree.min(3));
            assert_eq!(cloud.sh_rest.len(), count * cloud.rest_stride());
        };
        check(&street.background, background);
        street
            .assets
            .iter()
            .for_each(|asset| check(asset, agent_splats));
        assert_eq!(
            (street.agents.len(), street.agent_trajectories.len()),
            (agents, agents)
        );
        assert_eq!(
            (street.assets.len(), street.asset_dims_m.len()),
            (agents.min(12), agents.min(12))
        );
        assert!(
            street
                .agents
                .iter()
                .all(|agent| agent.asset < street.assets.len())
        );
    }
}

#[test]
fn no_splat_is_defective_and_colors_are_displayable() {
    let street = Street::generate(&SMALL);
    for cloud in std::iter::once(&street.background).chain(&street.assets) {
        for splat in 0..cloud.len() {
            assert_eq!(cloud.defect_of(splat), None, "splat {splat}");
            let norm: f32 = cloud.rotations[splat].iter().map(|q| q * q).sum();
            assert!(
                (norm - 1.0).abs() < 1e-4 && cloud.scales[splat].iter().all(|&scale| scale > 0.0)
            );
            let rgb = cloud.sh_dc[splat].map(|dc| 0.5 + 0.282_094_8 * dc);
            assert!(
                rgb.iter().all(|value| (-1e-3..=1.001).contains(value)),
                "{rgb:?}"
            );
        }
    }
}

#[test]
fn opacities_have_two_modes_and_scales_are_discs() {
    let street = Street::generate(&SMALL);
    for cloud in std::iter::once(&street.background).chain(&street.assets) {
        let share = |test: fn(f32) -> bool| {
            cloud.opacities.iter().filter(|&&o| test(o)).count() as f64 / cloud.len() as f64
        };
        let (faint, strong) = (share(|o| o < 0.15), share(|o| o > 0.7));
        assert!(
            (0.43..0.47).contains(&faint) && (0.46..0.53).contains(&strong),
            "faint {faint}, strong {strong}"
        );
        for scale in &cloud.scales {
            let mut sorted = *scale;
            sorted.sort_by(f32::total_cmp);
            let flatness = (sorted[1] * sorted[2]).sqrt() / sorted[0];
            assert!((4.9..20.1).contains(&flatness), "{scale:?}");
        }
    }
}

#[test]
fn any_seed_makes_a_street() {
    let street = Street::generate(&StreetOptions {
        seed: u64::MAX,
        background: 500,
        agents: 1,
        agent_splats: 100,
        ..SMALL
    });
    assert_eq!(street.background.len(), 500);
}

#[test]
fn bands_decay_and_lower_degrees_are_the_same_street() {
    let street = Street::generate(&SMALL);
    let cloud = &street.background;
    let energy = |range: std::ops::Range<usize>| -> f64 {
        let count = (range.len() * cloud.len() * 3) as f64;
        let sum: f64 = (0..cloud.len())
            .flat_map(|s| &cloud.rest_of(s)[range.clone()])
            .flatten()
            .map(|&c| f64::from(c).powi(2))
            .sum();
        (sum / count).sqrt()
    };
    let bands = [energy(0..3), energy(3..8), energy(8..15)];
    assert!(
        bands[0] > 1.3 * bands[1]
            && bands[1] > 1.3 * bands[2]
            && bands[0] < 0.08
            && bands[2] > 0.002,
        "{bands:?}"
    );
    let flat = Street::generate(&StreetOptions {
        sh_degree: 0,
        ..SMALL
    });
    assert_eq!(flat.background.means, cloud.means);
    assert_eq!(flat.background.sh_dc, cloud.sh_dc);
}

#[test]
fn detail_is_near_the_road_and_the_shell_is_far() {
    let cloud = Street::generate(&SMALL).background;
    let bounds = cloud.bounds();
    for axis in 0..2 {
        assert!(
            bounds.max[axis] > 0.9 * sky::DOME_RADIUS_M
                && bounds.max[axis] < 1.1 * sky::DOME_RADIUS_M
        );
        assert!(
            bounds.min[axis] < -0.9 * sky::DOME_RADIUS_M
                && bounds.min[axis] > -1.1 * sky::DOME_RADIUS_M
        );
    }
    let near = cloud
        .means
        .iter()
        .filter(|m| m[0].abs() < 101.0 && m[1].abs() < 101.0 && m[2] < 32.0)
        .count();
    assert!(
        near as f64 > 0.75 * cloud.len() as f64,
        "{near} of {} in the 200 m street",
        cloud.len()
    );
    let far = cloud
        .means
        .iter()
        .filter(|m| Vec3::from_array(**m).length() > 300.0)
        .count();
    assert!(far > cloud.len() / 100, "{far} in the far shell");
}

/// Asphalt at night is bright and warm below the lamps and darker between them; under clouds it is
/// gray all over.
#[test]
fn lamps_lay_warm_pools_on_the_road_at_night() {
    let layout = Layout::new(SMALL.seed);
    let lamps: Vec<Vec3> = layout.lamps.iter().map(furniture::lamp_light).collect();
    let road = |weather: Weather, from_m: f32, to_m: f32| -> Vec3 {
        let cloud = Street::generate(&StreetOptions {
            weather,
            agents: 0,
            ..SMALL
        })
        .background;
        let (mut sum, mut count) = (Vec3::ZERO, 0.0);
        for (mean, dc) in cloud.means.iter().zip(&cloud.sh_dc) {
            let at = Vec3::from_array(*mean);
            let to_lamp_m = lamps
                .iter()
                .map(|lamp| lamp.truncate().distance(at.truncate()))
                .fold(f32::MAX, f32::min);
            if at.x.abs() < 90.0
                && at.y.abs() < 6.5
                && at.z.abs() < 0.02
                && (from_m..to_m).contains(&to_lamp_m)
            {
                sum += Vec3::from_array(*dc) * 0.282_094_8 + 0.5;
                count += 1.0;
            }
        }
        assert!(count > 100.0, "{count} splats of road");
        sum / count
    };
    let (below, away) = (
        road(Weather::Night, 0.0, 4.0),
        road(Weather::Night, 13.0, 30.0),
    );
    let (gray_below, gray_away) = (
        road(Weather::Overcast, 0.0, 4.0),
        road(Weather::Overcast, 13.0, 30.0),
    );
    for gray in [gray_below, gray_away] {
        assert!((gray.x - gray.z).abs() < 0.02, "{gray}");
    }
    // Over what clouds show of the same road: paint is not spread evenly.
    assert!(
        below.x / gray_below.x > 1.4 * away.x / gray_away.x,
        "{below} below lamps, {away} between them"
    );
    assert!(below.x > 1.4 * below.z, "{below}");
}

/// Meters from the nearest place that a camera passes, whose height over the road is 1.6 m.
fn to_the_way_m(street: &Street, mean: [f32; 3]) -> f64 {
    let mean = Vec3::from_array(mean).as_dvec3();
    street
        .ego
        .iter()
        .map(|(_, pose)| pose.translation.with_z(1.6).distance(mean))
        .fold(f64::MAX, f64::min)
}

#[test]
fn asphalt_is_finest_where_the_ego_drives() {
    let street = Street::generate(&SMALL);
    let cloud = &street.background;
    let median_scale_m = |low_m: f64, high_m: f64| {
        let mut scales: Vec<f32> = (0..cloud.len())
            .filter(|&splat| {
                let [x, y, z] = cloud.means[splat];
                y.abs() < 9.0
                    && x.abs() < 100.0
                    && z.abs() < 0.02
                    && (low_m..high_m).contains(&to_the_way_m(&street, [x, y, z]))
            })
            .map(|splat| cloud.scales[splat].into_iter().fold(0.0, f32::max))
            .collect();
        scales.sort_by(f32::total_cmp);
        assert!(scales.len() > 300, "{}", scales.len());
        scales[scales.len() / 2]
    };
    let (near_m, far_m) = (median_scale_m(0.0, 5.0), median_scale_m(20.0, 80.0));
    assert!(
        near_m < 0.7 * far_m,
        "{near_m} near the way, {far_m} far from it"
    );
}

/// A splat beside a camera's image plane that is large for its distance lies as fog over the whole
/// image.
#[test]
fn no_splat_beside_the_way_is_large_for_its_distance() {
    let street = Street::generate(&SMALL);
    let cloud = &street.background;
    for (mean, scale) in cloud.means.iter().zip(&cloud.scales) {
        let largest_m = f64::from(scale.iter().copied().fold(0.0, f32::max));
        let distance_m = to_the_way_m(&street, *mean);
        // Knots are a meter apart, and splats stray a little off their surfaces.
        assert!(
            largest_m < 0.26 * distance_m + 0.05,
            "{largest_m} m at {distance_m} m: {mean:?}"
        );
    }
}

#[test]
fn assets_carry_a_dark_and_sheer_shadow_within_their_box() {
    let street = Street::generate(&SMALL);
    for (asset, dims_m) in street.assets.iter().zip(&street.asset_dims_m) {
        let below = |splat: &usize| {
            let [x, y, z] = asset.means[*splat];
            // Beyond the wheels' inner sides lie the wheels; between them only the shadow is so
            // low.
            z + 0.5 * dims_m[2] < 0.1
                && y.abs() < 0.5 * dims_m[1] - 0.3
                && x.abs() < 0.5 * dims_m[0]
        };
        let shadow: Vec<usize> = (0..asset.len()).filter(below).collect();
        assert!(shadow.len() > asset.len() / 100, "{} splats", shadow.len());
        assert!(shadow.iter().all(|&splat| {
            asset.sh_dc[splat]
                .iter()
                .all(|dc| 0.5 + 0.282_094_8 * dc < 0.25)
        }));
        let border = |splat: &&usize| asset.means[**splat][0].abs() > 0.5 * dims_m[0] - 0.1;
        assert!(
            shadow
                .iter()
                .filter(border)
                .all(|&splat| asset.opacities[splat] < 0.5),
            "the border fades"
        );
    }
}

#[test]
fn cars_stand_on_the_road_in_their_box() {
    let street = Street::generate(&StreetOptions {
        agent_splats: 30_000,
        ..SMALL
    });
    for (asset, dims_m) in street.assets.iter().zip(&street.asset_dims_m) {
        let bounds = asset.bounds();
        assert!(
            (bounds.min[2] + 0.5 * dims_m[2]).abs() < 0.02,
            "wheels at {}, box to {}",
            bounds.min[2],
            -0.5 * dims_m[2]
        );
        for axis in [0, 2] {
            let size_m = bounds.max[axis] - bounds.min[axis];
            assert!(
                (size_m - dims_m[axis]).abs() < 0.08,
                "axis {axis}: {size_m} of {}",
                dims_m[axis]
            );
        }
    }
    for agent in &street.agents {
        let height_m = f64::from(street.asset_dims_m[agent.asset][2]);
        assert!((agent.world_from_agent.translation.z - 0.5 * height_m).abs() < 1e-6);
    }
}

#[test]
fn no_two_agents_overlap_nor_hit_the_ego() {
    let street = Street::generate(&StreetOptions {
        background: 0,
        agents: 300,
        agent_splats: 0,
        sh_degree: 0,
        seed: 2,
        ..SMALL
    });
    let footprint = |pose: &decouplegs_scene::Pose, dims: [f32; 3]| {
        let half =
            (pose.rotation * DVec3::new(f64::from(dims[0]), f64::from(dims[1]), 0.0) * 0.5).abs();
        (pose.translation - half, pose.translation + half)
    };
    // Axis-aligned footprints are exact: at time zero everyone heads along a street.
    let mut boxes: Vec<_> = street
        .agents
        .iter()
        .map(|a| footprint(&a.world_from_agent, street.asset_dims_m[a.asset]))
        .collect();
    boxes.push(footprint(&street.ego[0].1, [4.6, 1.9, 1.7]));
    for (i, a) in boxes.iter().enumerate() {
        for b in &boxes[..i] {
            let apart = a.0.x > b.1.x || b.0.x > a.1.x || a.0.y > b.1.y || b.0.y > a.1.y;
            assert!(apart, "{a:?} and {b:?}");
        }
    }
}

#[test]
fn trajectories_start_where_agents_stand_and_follow_their_heading() {
    let street = Street::generate(&SMALL);
    let mut moving = 0;
    for (agent, knots) in street.agents.iter().zip(&street.agent_trajectories) {
        assert_eq!(knots[0], (0.0, agent.world_from_agent));
        assert!(knots.len() >= 2 && knots.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let traveled = knots[knots.len() - 1].1.translation - knots[0].1.translation;
        let ahead_m = traveled.dot(agent.world_from_agent.rotation * DVec3::X);
        assert!((ahead_m - traveled.length()).abs() < 1e-3);
        moving += usize::from(ahead_m > 10.0);
    }
    assert!(moving * 2 > street.agents.len());
}
