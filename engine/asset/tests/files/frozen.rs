//! Bytes that were written once must mean the same for ever. The same files seed the fuzz targets.

use std::fmt::Write;
use std::path::Path;

use decouplegs_asset::{SceneFile, cameras};
use decouplegs_scene::SplatCloud;

use crate::errors::{Errors, SMALLEST_THREE_MAX_RAD};
use crate::sample::{self, cone, seed};

/// `cloud` as text that keeps every bit: the shortest decimals that read back as the same numbers,
/// one line per splat.
fn text_of(cloud: &SplatCloud) -> String {
    let mut text = format!("{} splats of degree {}\n", cloud.len(), cloud.sh_degree);
    for splat in 0..cloud.len() {
        let SplatCloud {
            means,
            scales,
            rotations,
            opacities,
            sh_dc,
            ..
        } = cloud;
        writeln!(
            text,
            "mean {:?} scale {:?} rotation {:?} opacity {:?} dc {:?} rest {:?}",
            means[splat],
            scales[splat],
            rotations[splat],
            opacities[splat],
            sh_dc[splat],
            cloud.rest_of(splat)
        )
        .unwrap();
    }
    text
}

#[test]
fn the_cone_in_every_format_and_version_reads_as_ever() {
    let mut changed = Vec::new();
    for (name, bytes, read) in sample::files() {
        let text = text_of(&read(&bytes).unwrap());
        let frozen = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/files/frozen")
            .join(format!("{name}.txt"));
        if !std::fs::read_to_string(&frozen).is_ok_and(|frozen| frozen == text) {
            let now = Path::new(env!("CARGO_TARGET_TMPDIR"))
                .join(format!("{}.txt", name.replace('/', ".")));
            std::fs::write(&now, text).unwrap();
            changed.push(format!("{} is now {}", frozen.display(), now.display()));
        }
    }
    assert!(
        changed.is_empty(),
        "files no longer read as they did: {changed:#?}"
    );
}

/// `cloud` after half a turn about z. A spherical harmonic of order m turns by m times that, so
/// those of odd order change their sign.
fn half_turned(mut cloud: SplatCloud) -> SplatCloud {
    for [x, y, _] in &mut cloud.means {
        (*x, *y) = (-*x, -*y);
    }
    // An axis of a splat and its opposite are one, so the turn is taken on both sides.
    for [_, x, y, _] in &mut cloud.rotations {
        (*x, *y) = (-*x, -*y);
    }
    let of_degree = |l: i32| -l..=l;
    let orders: Vec<i32> = (1..=i32::from(cloud.sh_degree))
        .flat_map(of_degree)
        .collect();
    for (at, color) in cloud.sh_rest.iter_mut().enumerate() {
        if orders[at % orders.len()] % 2 != 0 {
            *color = color.map(|value| -value);
        }
    }
    cloud
}

#[test]
fn the_cone_in_every_format_is_the_cone() {
    let files = sample::files();
    let read = |part: &str| {
        let (_, bytes, read) = files.iter().find(|(name, ..)| name.contains(part)).unwrap();
        read(bytes).unwrap()
    };
    let without_rest = || SplatCloud {
        sh_degree: 0,
        sh_rest: Vec::new(),
        ..cone()
    };
    // Largest error of mean (m), logarithm of scale, angle (rad), opacity, DC and further
    // coefficients.
    let check = |name: &str, original: &SplatCloud, bounds: [f64; 6]| {
        let errors = Errors::between(original, &read(name));
        println!("{name}: {errors:?}");
        let found = [
            errors.mean_m.into(),
            errors.scale_ln,
            errors.angle_rad,
            errors.opacity.into(),
            errors.dc.into(),
            errors.rest.into(),
        ];
        assert!(
            found
                .iter()
                .zip(bounds)
                .all(|(&found, bound): (&f64, f64)| found <= bound),
            "{name}: {errors:?}"
        );
    };
    check("cone.ply", &cone(), [0.0, 1e-6, 1e-6, 1e-7, 0.0, 0.0]);
    // Means and scales are floats, a rotation is four bytes, each off by half of 1/128.
    let byte = 0.501 / 255.0;
    let dc_of_byte = byte / decouplegs_scene::sh::Y0;
    check(
        "cone.splat",
        &without_rest(),
        [0.0, 1e-6, 2.0 / 128.0, byte, dc_of_byte, 0.0],
    );
    // Half a step of the extents of the cone: 0.375 m in 1023, a factor of 12 in 2047, DC from
    // -1.375 to 1.1875 in 255. A further coefficient is one of 256 over 8.
    let compressed = [
        0.5 * 0.376 / 1023.0,
        0.5 * 2.49 / 2047.0,
        SMALLEST_THREE_MAX_RAD,
        byte,
        0.5 * 2.57 / 255.0,
        0.5 * 8.0 / 256.0,
    ];
    check("cone.compressed", &cone(), compressed);
    let dc = 0.501 / (255.0 * 0.15);
    let first_three = [0.0, 0.501 / 16.0, 0.03, byte, dc, 0.0];
    check("cone.v1", &cone(), first_three);
    check("cone.v2", &cone(), first_three);
    check(
        "cone.v3",
        &cone(),
        [0.0, 0.501 / 16.0, SMALLEST_THREE_MAX_RAD, byte, dc, 0.0],
    );
    // 16 bits of a logarithm within 1.4, and 256 numbers that are the cone's own; 8 bits a
    // component of a rotation.
    let sog_angle_rad = 4.0 * 3f64.sqrt() * std::f64::consts::SQRT_2 / 510.0;
    check(
        "cone.sog",
        &cone(),
        [1e-4, 1e-6, sog_angle_rad, byte, 1e-6, 1e-6],
    );
    // Rotations and opacities are 16-bit integers; a node moves and halves what was doubled.
    // It was made with the axes of the cone: y is up in it, where it is down in a cloud.
    check(
        "cone.glb",
        &half_turned(cone()),
        [1e-6, 1e-6, 2e-4, 1e-5, 0.0, 0.0],
    );
    check("cone.pt", &cone(), [0.0, 1e-6, 1e-6, 1e-6, 0.0, 0.0]);
    // Versions that store a thing alike give it alike, to the bit.
    assert_eq!(read("cone.v1"), read("cone.v2"));
    assert_eq!(read("cone.v3"), read("cone.v4"));
}

#[test]
fn text_files_read_as_ever() {
    let [inria, nerfstudio] = ["inria.json", "nerfstudio.json"]
        .map(|name| std::fs::read(seed(&format!("cameras/{name}"))).unwrap());
    assert_eq!(cameras::decode(&inria, None).unwrap()[0].name, "seq_00001");
    assert_eq!(
        cameras::decode(&nerfstudio, None).unwrap()[0].name,
        "images_frame_1"
    );
    let scene = SceneFile::read(&seed("scene_file/example.toml")).unwrap();
    assert_eq!((scene.rig.sensors.len(), scene.agents.len()), (2, 2));
    let scene = SceneFile::read(&seed("scene_file/sky.toml")).unwrap();
    let camera = scene.rig.cameras().next().unwrap();
    assert!(scene.sky_map.is_some() && !camera.intrinsics.photometry.is_identity());
    assert_eq!(scene.agents[0].present.span_s(), Some((0.0, 5.5)));
}
