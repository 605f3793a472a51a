//! Truths of the integrals, and the experiment.

use std::path::{Path, PathBuf};

use decouplegs::asset::{probe_paths, read_probe};
use decouplegs::scene::LightTransfer;
use decouplegs::scene::light::{Probe, Surroundings};
use decouplegs::synth::street::{AssetLight, Street, StreetOptions};
use decouplegs::train::calibrate::{CalibrateOptions, calibrate};
use glam::DVec3;
use rayon::prelude::*;

use super::body::{Body, Surfel};
use super::experiment::{Light, Row, Subject};
use super::mesh;
use super::rays::{Solid, Triangle};
use super::skylight::{Scene, environment, on_open_ground};

/// Display values of a reference ground at night, at dusk and by day; in white light it is 0.42.
const DISPLAYS: [f64; 3] = [0.12, 0.25, 0.4];

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("DECOUPLEGS_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    if folder.is_dir() {
        return Some(folder);
    }
    println!(
        "SKIPPED: {} is not there; set DECOUPLEGS_DATA to the folder of test files",
        folder.display()
    );
    None
}

fn even(light: f32) -> Probe {
    Probe::from_fn("even", 64, |_| [light; 3])
}

fn alone(normal: DVec3, triangles: Vec<Triangle>) -> Body {
    Body {
        name: "one surfel".to_owned(),
        surfels: vec![Surfel {
            position: 1.0 * DVec3::Z,
            normal,
            albedo: [0.5; 3],
        }],
        solid: Solid::new(triangles),
    }
}

/// A square of 2 km that stands on edge in the plane x = `x`.
fn wall(x: f64) -> Vec<Triangle> {
    let corner = |y: f64, z: f64| 1000.0 * DVec3::new(0.0, y, z) + x * DVec3::X;
    let [a, b, c, d] = [
        corner(-1.0, -1.0),
        corner(1.0, -1.0),
        corner(1.0, 1.0),
        corner(-1.0, 1.0),
    ];
    vec![Triangle::new([a, b, c]), Triangle::new([a, c, d])]
}

#[test]
fn light_on_open_surfaces_is_that_of_the_books() {
    let sky = environment(&even(0.8), 0);
    let up = on_open_ground(&sky)[0];
    assert!((up - 0.8).abs() < 1e-3, "{up}");
    // Upright: half sky, half ground. Downward: all ground.
    for (normal, albedo, expected) in [
        (DVec3::Z, 0.2, 0.8),
        (DVec3::X, 0.2, 0.4 + 0.4 * 0.2),
        (DVec3::NEG_Z, 0.5, 0.4),
    ] {
        let lit = Scene::new(&alone(normal, vec![])).lit(&sky, albedo)[0][1];
        assert!(
            (lit - expected).abs() < 2e-3,
            "{normal}: {lit} for {expected}"
        );
    }
}

#[test]
fn a_wall_hides_half_the_sky_of_the_ground_at_its_foot() {
    let scene = Scene::new(&alone(DVec3::Z, wall(-1e-3)));
    let lit = scene.lit(&environment(&even(1.0), 0), 0.0)[0][0];
    assert!((lit - 0.5).abs() < 2e-3, "{lit}");
    // And a sun behind it altogether.
    let sun = Probe::from_fn("sun", 64, |direction| {
        [if direction.x < -0.5 { 1.0 } else { 0.0 }; 3]
    });
    assert_eq!(scene.lit(&environment(&sun, 0), 0.0)[0][0], 0.0);
    assert!(scene.lit(&environment(&sun, 2), 0.0)[0][0] > 0.1);
}

#[test]
fn the_hierarchy_lets_no_ray_through_that_a_triangle_stops() {
    let triangle = |index: usize| {
        let at = |k: usize| {
            let turn = (index * 7 + k * 3) as f64;
            DVec3::new(turn.sin(), (1.7 * turn).cos(), (0.6 * turn).sin())
        };
        Triangle::new([at(0), at(0) + 0.3 * at(1), at(0) + 0.3 * at(2)])
    };
    let triangles: Vec<Triangle> = (0..60).map(triangle).collect();
    let all = Solid::new(triangles.clone());
    let each: Vec<Solid> = triangles.iter().map(|&one| Solid::new(vec![one])).collect();
    let (mut open, mut closed) = (0, 0);
    for ray in 0..2000 {
        let turn = f64::from(ray);
        let direction = DVec3::new(turn.sin(), turn.cos(), (0.37 * turn).sin()).normalize();
        let found = all.open(0.1 * direction, direction);
        let expected = each.iter().all(|one| one.open(0.1 * direction, direction));
        assert_eq!(found, expected, "ray {ray}");
        *if found { &mut open } else { &mut closed } += 1;
    }
    assert!(open > 100 && closed > 100, "{open} open, {closed} closed");
}

#[test]
fn the_mesh_of_the_test_data_is_a_car_on_the_ground() {
    let Some(data) = data() else { return };
    let car = mesh::car(&data.join("meshes/lamborghini_huracan_gt3.glb"));
    let triangles = car.solid.triangles();
    assert_eq!(triangles.len(), 145_917);
    let heights = triangles.iter().flat_map(|triangle| triangle.corners);
    let top = heights.map(|corner| corner.z).fold(0.0, f64::max);
    assert!((0.9..2.2).contains(&top), "{top} m high");
}

/// Cars of a synthetic street in neutral light.
fn cars(seed: u64, count: usize) -> Vec<decouplegs::SplatCloud> {
    let options = StreetOptions {
        background: 1000,
        agents: count,
        agent_splats: 20_000,
        seed,
        asset_light: AssetLight::Neutral,
        ..StreetOptions::default()
    };
    Street::generate(&options).assets
}

fn probes(data: &Path) -> Vec<Probe> {
    let paths = ["hdr", "hdr-small"].map(|folder| probe_paths(&data.join(folder)).unwrap());
    let paths = paths.concat();
    paths.iter().map(|path| read_probe(path).unwrap()).collect()
}

/// A light transfer fitted without every probe whose index leaves `fold` over after division by
/// `folds`.
fn fitted(
    probes: &[Probe],
    (fold, folds): (usize, usize),
    options: &CalibrateOptions,
) -> LightTransfer {
    let cars = cars(7, 6);
    let named: Vec<_> = cars.iter().map(|car| ("car".to_owned(), car)).collect();
    let kept = probes.iter().enumerate();
    let kept = kept.filter(|(index, _)| index % folds != fold);
    let kept: Vec<Probe> = kept.map(|(_, probe)| probe.clone()).collect();
    calibrate(&named, &kept, options, &|_| {}).unwrap().transfer
}

#[test]
#[ignore = "takes minutes: the table of benches/README.md"]
fn relighting_bodies_of_known_shape() {
    let Some(data) = data() else { return };
    let probes = probes(&data);
    let mut bodies = vec![mesh::car(&data.join("meshes/lamborghini_huracan_gt3.glb"))];
    let others = cars(11, 2);
    bodies.extend(
        others
            .iter()
            .enumerate()
            .map(|(index, car)| Body::of_splats(&format!("car {index}"), car)),
    );
    let subjects: Vec<Subject> = bodies.into_iter().map(Subject::new).collect();
    let folds = 4;
    for (albedo, gloss) in [(0.15, 0.0), (0.15, 0.35), (0.10, 0.0), (0.22, 0.0)] {
        let _ = (albedo, gloss);
    }
    let transfers: Vec<LightTransfer> = (0..folds)
        .map(|fold| fitted(&probes, (fold, folds), &CalibrateOptions::default()))
        .collect();
    println!("calibrated");
    for (albedo, gloss) in [(0.15, 0.0), (0.15, 0.35), (0.10, 0.0), (0.22, 0.0)] {
        let ground = Surroundings { albedo, gloss };
        for subject in &subjects {
            for display in DISPLAYS {
                let of_probe = |(index, probe): (usize, &Probe)| -> Vec<(String, Row)> {
                    (0..4)
                        .map(|quarters| {
                            let light = Light::new(probe, quarters, display, &ground);
                            (
                                probe.name.clone(),
                                subject.compare(&transfers[index % folds], &light, albedo),
                            )
                        })
                        .collect()
                };
                let rows: Vec<_> = probes
                    .par_iter()
                    .enumerate()
                    .flat_map_iter(of_probe)
                    .collect();
                let mean = |value: &dyn Fn(&Row) -> f64| {
                    rows.iter().map(|(_, row)| value(row)).sum::<f64>() / rows.len() as f64
                };
                let worst = rows
                    .iter()
                    .min_by(|a, b| {
                        (a.1.relit_db - a.1.none_db).total_cmp(&(b.1.relit_db - b.1.none_db))
                    })
                    .unwrap();
                println!(
                    "albedo {albedo} gloss {gloss} {} {display}: none {:.2} relit {:.2} affine {:.2} p95 {:.1} {:.1} worse {} of {} worst {:.2} ({} none {:.2})",
                    subject.name(),
                    mean(&|r| r.none_db),
                    mean(&|r| r.relit_db),
                    mean(&|r| r.affine_db),
                    mean(&|r| r.none_p95_deg),
                    mean(&|r| r.relit_p95_deg),
                    rows.iter()
                        .filter(|(_, row)| row.relit_db < row.none_db - 0.1)
                        .count(),
                    rows.len(),
                    worst.1.relit_db - worst.1.none_db,
                    worst.0,
                    worst.1.none_db
                );
            }
        }
    }
}
