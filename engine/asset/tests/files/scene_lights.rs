//! The light of scene files: the documented one, complaints, and a scene baked in it.

use std::path::Path;

use decouplegs_asset::{
    LightTransferFile, SceneFile, SceneLight, inria_ply, open_scene, write_coded,
    write_light_transfer,
};
use decouplegs_scene::light::{AmbientOptions, Lamps, ShadowOptions};
use decouplegs_scene::{AmbientDescriptor, LightTransfer, SplatScene};
use glam::DVec3;

use crate::sample::{cloud, coded_cone};
use crate::scene_files::{example, write_views};

/// The example of the page with the light that it shows.
pub fn lit_example() -> String {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("scene-file.md"))
        .unwrap();
    let from = page
        .find("```toml\n[light]")
        .expect("the page shows a light")
        + "```toml\n".len();
    let length = page[from..].find("```").expect("the light ends");
    format!("{}\n{}", example(), &page[from..from + length])
}

#[test]
fn the_documented_light_is_the_default_one() {
    let light = SceneFile::parse(&lit_example()).unwrap().light.unwrap();
    assert_eq!(light.transfer.unwrap().to_str(), Some("light.safetensors"));
    assert_eq!(
        (light.ambient, light.shadows),
        (AmbientOptions::default(), Some(ShadowOptions::default()))
    );
    let bare = SceneFile::parse(&format!("{}\n[light]\n[light.shadows]\n", example()))
        .unwrap()
        .light
        .unwrap();
    let expected = SceneLight {
        shadows: Some(ShadowOptions::default()),
        ..SceneLight::default()
    };
    assert_eq!(bare, expected);
    let complaint = |from: &str, to: &str| {
        SceneFile::parse(&lit_example().replacen(from, to, 1))
            .unwrap_err()
            .to_string()
    };
    assert!(complaint("sigma_m = 4.0", "sigma_m = -1.0").contains("light.sigma_m"));
    assert!(complaint("decay = 1.5", "decay = inf").contains("light.shadows.decay"));
    assert!(complaint("floor = 0.8", "flor = 0.8").contains("flor"));
    let both = complaint("by_normals = false", "by_normals = true");
    assert!(
        both.contains("light.by_normals") && both.contains("transfer"),
        "{both}"
    );
    assert!(
        complaint("# ground_albedo = 0.13", "ground_albedo = 1.3").contains("light.ground_albedo")
    );
}

/// The documented lights that cast shadows, and what is wrong with others.
#[test]
fn casting_lights_are_read_and_faults_named() {
    let page = include_str!("../../scene-file.md");
    let from = page.find("```toml\n[light.sun]").unwrap() + "```toml\n".len();
    let casting = &page[from..from + page[from..].find("```").unwrap()];
    let text = format!("{}\n{casting}", lit_example());
    let light = SceneFile::parse(&text).unwrap().light.unwrap();
    let sun = light.casting.sun.unwrap();
    assert_eq!(
        (sun.towards, sun.share),
        (DVec3::new(-0.50, -0.36, 0.79), 0.75)
    );
    let lamps = Lamps {
        positions: vec![DVec3::new(12.0, 5.0, 7.2)],
        ..Lamps::default()
    };
    assert_eq!(
        light.casting.lamps, lamps,
        "the documented range is the default one"
    );
    let complaint = |from: &str, to: &str| {
        assert!(text.contains(from));
        SceneFile::parse(&text.replacen(from, to, 1))
            .unwrap_err()
            .to_string()
    };
    for (from, to, expected) in [
        ("share = 0.75", "share = 1.0", "light.sun.share"),
        ("share = 0.75", "", "share"),
        ("[-0.50, -0.36, 0.79]", "[0, 0, 0]", "light.sun.towards"),
        (
            "[[12.0, 5.0, 7.2]]",
            "[[nan, 5.0, 7.2]]",
            "light.lamps.places",
        ),
        ("range_m = 30.0", "range_m = -1", "light.lamps.range_m"),
        ("range_m = 30.0", "radius_m = 30.0", "radius_m"),
    ] {
        let found = complaint(from, to);
        assert!(found.contains(expected), "{found}");
    }
    let without_shadows = format!("{}\n[light]\n{casting}", example());
    let found = SceneFile::parse(&without_shadows).unwrap_err().to_string();
    assert!(
        found.contains("light.sun") && found.contains("[light.shadows]"),
        "{found}"
    );
}

/// A lit scene baked is the scene without light, its agents relit and the ground about them darker.
#[test]
fn a_lit_scene_is_baked_in_its_light() {
    let directory = tempfile::tempdir().unwrap();
    write_views(directory.path());
    let mut ground = cloud(400, 1);
    for (splat, mean) in ground.means.iter_mut().enumerate() {
        *mean = [
            (splat % 20) as f32 * 0.25 + 10.0,
            (splat / 20) as f32 * 0.25 + 1.0,
            0.0,
        ];
    }
    inria_ply::write(&directory.path().join("street.ply"), &ground).unwrap();
    write_coded(&directory.path().join("cone.safetensors"), &coded_cone()).unwrap();
    let row = ([0.0; AmbientDescriptor::LEN], 0.0);
    let rows = 3 * decouplegs_scene::sh::coefficient_count(coded_cone().cloud.sh_degree);
    let mut transfer = LightTransfer {
        sh_degree: coded_cone().cloud.sh_degree,
        gain: vec![([0.0; AmbientDescriptor::LEN], 1.0); rows],
        offset: vec![row; rows],
        neutral: AmbientDescriptor::uniform([0.5; 3]),
        confidence: None,
    };
    transfer.offset[0].1 = 0.25;
    let file = LightTransferFile {
        transfer,
        tool_version: "0".into(),
        sources: std::collections::BTreeMap::new(),
        settings: std::collections::BTreeMap::new(),
    };
    write_light_transfer(&directory.path().join("light.safetensors"), &file).unwrap();
    let open = |text: String| {
        let path = directory.path().join("scene.toml");
        std::fs::write(
            &path,
            text.replace("car.ply", "cone.safetensors")
                .replace("112.75", "112.5"),
        )
        .unwrap();
        open_scene(&path, 0.0)
    };
    let (plain, lit) = (
        open(example()).unwrap().baked(0.0),
        open(lit_example()).unwrap().baked(0.0),
    );
    assert_eq!(lit.splats.means, plain.splats.means);
    for splat in 400..lit.splats.len() {
        let (dc, without) = (lit.splats.sh_dc[splat], plain.splats.sh_dc[splat]);
        assert!(
            (dc[0] - without[0] - 0.25).abs() < 1e-6 && (dc[1] - without[1]).abs() < 1e-6,
            "{dc:?} {without:?}"
        );
    }
    let darker = (0..400)
        .filter(|&splat| lit.splats.sh_dc[splat][0] < plain.splats.sh_dc[splat][0])
        .count();
    assert!((20..400).contains(&darker), "{darker} splats are in shadow");
    let by_normals = lit_example()
        .replacen("transfer =", "# transfer =", 1)
        .replacen("by_normals = false", "by_normals = true", 1);
    let shaded = open(by_normals).unwrap().baked(0.0);
    assert_eq!(shaded.splats.means, plain.splats.means);
    let factor = |splat: usize, channel: usize| {
        let shown = |scene: &SplatScene| {
            f64::from(scene.splats.sh_dc[splat][channel]) + decouplegs_scene::sh::DC_SHIFT
        };
        shown(&shaded) / shown(&plain)
    };
    let factors: Vec<f64> = (400..shaded.splats.len())
        .map(|splat| factor(splat, 0))
        .collect();
    let (least, most) = (
        factors.iter().copied().fold(f64::INFINITY, f64::min),
        factors.iter().copied().fold(0.0, f64::max),
    );
    assert!(
        least > 0.1 && most / least > 1.2,
        "sides are lit alike: {least} to {most}"
    );
    std::fs::remove_file(directory.path().join("light.safetensors")).unwrap();
    assert!(
        open(lit_example())
            .unwrap_err()
            .to_string()
            .contains("light.safetensors")
    );
}
