//! `render` with motion, planes and boxes: what sensors see, and what is true.

use decouplegs::asset::SceneFile;
use decouplegs::render::metrics::Difference;
use decouplegs::scene::Trajectory;

use super::*;

/// Planes of geometry are arrays of their own shape, with previews, and cost color nothing.
#[test]
fn planes_of_geometry_are_written_beside_the_images() {
    let folder = tempfile::tempdir().unwrap();
    let (street, out) = (folder.path().join("street"), folder.path().join("out"));
    coded_street(&street);
    let scene = street.join("scene.toml");
    let render = |more: &[&str]| {
        let scene = [
            "render",
            text(&scene),
            "--size",
            "96x54",
            "--time",
            "1",
            "--force",
            "--out",
            text(&out),
        ];
        succeed(&[&scene[..], more].concat());
        fs::read(out.join("front.png")).unwrap()
    };
    let plain = render(&[]);
    let all = "range,normal,flow_forward,flow_backward,scene_flow";
    let with = render(&[
        "--planes",
        all,
        "--plane-previews",
        "--flow-interval",
        "0.05",
    ]);
    assert!(plain == with, "planes change no color");
    for (plane, shape) in [
        ("range", "(54, 96)"),
        ("normal", "(54, 96, 3)"),
        ("flow_forward", "(54, 96, 2)"),
        ("flow_backward", "(54, 96, 2)"),
        ("scene_flow", "(54, 96, 3)"),
    ] {
        let array = fs::read(out.join(format!("front.{plane}.npy"))).unwrap();
        let header = String::from_utf8_lossy(&array[..128]).into_owned();
        assert!(header.contains(&format!("'shape': {shape}, ")), "{header}");
        let values = array[128..].chunks_exact(4);
        let largest = values.map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()).abs());
        assert!(largest.fold(0.0, f32::max) > 0.1, "{plane} is empty");
        let preview = Image::read(&out.join(format!("front.{plane}.png"))).unwrap();
        assert_eq!((preview.width, preview.height), (96, 54));
    }
    let scene = text(&scene);
    let refused = [
        "render",
        scene,
        "--reference",
        "--planes",
        "normal",
        "--force",
        "--out",
        text(&out),
    ];
    assert!(fail(1, &refused).contains("leave out --reference"));
    let refused = ["render", scene, "--flow-interval", "0", "--out", text(&out)];
    assert!(fail(2, &refused).contains("above 0"));
}

/// A rolling shutter of a scene file is in images and in those of the reference.
#[test]
fn rolling_shutters_of_scene_files_are_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let (street, out) = (folder.path().join("street"), folder.path().join("out"));
    small_street(&street);
    let scene = street.join("scene.toml");
    let rolling = street.join("rolling.toml");
    let file = fs::read_to_string(&scene).unwrap();
    let shutter = "[[rig]]\nshutter = { direction = \"top_to_bottom\", readout_s = 0.03 }";
    fs::write(&rolling, file.replace("[[rig]]", shutter)).unwrap();
    let render = |scene: &Path, more: &[&str]| {
        let scene = [
            "render",
            text(scene),
            "--size",
            "96x54",
            "--time",
            "2",
            "--force",
            "--out",
            text(&out),
        ];
        succeed(&[&scene[..], more].concat());
        Image::read(&out.join("front_left.png")).unwrap()
    };
    let warned = decouplegs(&[
        "render",
        text(&rolling),
        "--size",
        "96x54",
        "--out",
        text(&out),
    ]);
    let warned = String::from_utf8_lossy(&warned.stderr).into_owned();
    assert!(warned.contains("2 agents are plain splats"), "{warned}");
    let (still, rolled) = (render(&scene, &[]), render(&rolling, &[]));
    let truth = render(&rolling, &["--reference"]);
    let psnr_db = |image: &Image| Difference::between(image, &truth).unwrap().psnr_db;
    let (rolled_db, still_db) = (psnr_db(&rolled), psnr_db(&still));
    assert!(
        rolled_db > 40.0 && still_db < rolled_db - 8.0,
        "{rolled_db} dB, {still_db} dB"
    );
}

/// Boxes of agents: tight ones lie in amodal ones, and an absent agent has none.
#[test]
fn boxes_of_agents_are_written_beside_the_images() {
    let folder = tempfile::tempdir().unwrap();
    let (street, out) = (folder.path().join("street"), folder.path().join("out"));
    small_street(&street);
    let (scene, timed) = (street.join("scene.toml"), street.join("timed.toml"));
    let file = SceneFile::read(&scene).unwrap();
    let first = file.agents[0].name.clone();
    let render = |scene: &Path| -> Value {
        let scene = [
            "render",
            text(scene),
            "--boxes",
            "--size",
            "192x108",
            "--force",
            "--out",
            text(&out),
        ];
        assert!(succeed(&scene).contains("boxes.json"));
        serde_json::from_slice(&fs::read(out.join("boxes.json")).unwrap()).unwrap()
    };
    let found = render(&scene);
    let images = found["images"].as_array().unwrap();
    assert_eq!(images.len(), 6);
    let edges = |of: &Value| -> Vec<f64> {
        let edges = of.as_array().unwrap().iter();
        edges.map(|edge| edge.as_f64().unwrap()).collect()
    };
    let agents = |found: &Value| -> Vec<Value> {
        let images = found["images"].as_array().unwrap().iter();
        images
            .flat_map(|image| image["agents"].as_array().unwrap().clone())
            .collect()
    };
    let (mut seen, mut amodal) = (0, 0);
    for agent in agents(&found) {
        let is_seen = agent["visible_pixels"].as_u64().unwrap() > 0;
        assert_eq!(agent["class"], "car");
        assert_eq!(is_seen, !agent["tight_px"].is_null());
        seen += usize::from(is_seen);
        if agent["amodal_px"].is_null() {
            continue;
        }
        amodal += 1;
        for share in ["visible_fraction", "truncated_fraction"] {
            let share = agent[share].as_f64().unwrap_or(0.0);
            assert!((0.0..=1.0).contains(&share), "{agent}");
        }
        let is_whole = agent["amodal_px"] == agent["amodal_in_image_px"];
        assert!(
            !is_whole || agent["truncated_fraction"].as_f64().unwrap_or(0.0) < 0.1,
            "{agent}"
        );
        let (inside, whole) = (
            edges(&agent["amodal_in_image_px"]),
            edges(&agent["amodal_px"]),
        );
        assert!(inside[0] >= whole[0] && inside[3] <= whole[3]);
        if is_seen {
            // Soft edges of splats reach a little beyond the box.
            let tight = edges(&agent["tight_px"]);
            assert!(
                tight[0] >= whole[0] - 6.0 && tight[2] <= whole[2] + 6.0,
                "{agent}"
            );
            assert!(
                tight[1] >= whole[1] - 6.0 && tight[3] <= whole[3] + 6.0,
                "{agent}"
            );
        }
    }
    assert!(seen > 0 && amodal >= seen, "{seen} seen, {amodal} amodal");
    succeed(&[
        "edit",
        text(&scene),
        "--out",
        text(&timed),
        "--present",
        &format!("{first}=100,101"),
    ]);
    let of_first = |found: &Value| {
        let named = |agent: &Value| agent["name"] == first.as_str();
        agents(found).iter().filter(|agent| named(agent)).count()
    };
    let without = render(&timed);
    assert_eq!(of_first(&without), 0);
    println!("{} boxes of {first} before", of_first(&found));
}

/// Class and moving mask of each pixel are those of its instance.
#[test]
fn planes_of_labels_follow_instances() {
    let folder = tempfile::tempdir().unwrap();
    let (street, out) = (folder.path().join("street"), folder.path().join("out"));
    small_street(&street);
    let path = street.join("scene.toml");
    let mut file = SceneFile::read(&path).unwrap();
    // The first is a truck that stands, the second of unknown class and drives.
    file.agents[0].class = Some("truck".into());
    let pose = file.agents[0].trajectory.at(0.0);
    file.agents[0].trajectory = Trajectory::standing(pose);
    file.agents[1].class = None;
    file.write(&path).unwrap();
    let said = succeed(&[
        "render",
        text(&path),
        "--planes",
        "instance,class,moving",
        "--plane-previews",
        "--size",
        "192x108",
        "--time",
        "0.5",
        "--out",
        text(&out),
    ]);
    assert!(
        said.contains("classes.json") && said.contains("front.class.png"),
        "{said}"
    );
    let classes = fs::read_to_string(out.join("classes.json")).unwrap();
    let classes: Vec<String> = serde_json::from_str(&classes).unwrap();
    assert_eq!(classes, ["background", "truck", "unknown"]);
    let mut seen = std::collections::BTreeSet::new();
    for camera in file.rig.cameras() {
        let plane = |name: &str| -> Vec<u16> {
            let bytes = fs::read(out.join(format!("{}.{name}.npy", camera.name))).unwrap();
            assert!(bytes.windows(4).any(|part| part == b"'<u2"), "{name}");
            let (values, _) = bytes[bytes.len() - 2 * 192 * 108..].as_chunks::<2>();
            values
                .iter()
                .map(|value| u16::from_le_bytes(*value))
                .collect()
        };
        let (instances, classes, moving) = (plane("instance"), plane("class"), plane("moving"));
        for (pixel, &instance) in instances.iter().enumerate() {
            let expected = match instance {
                0 => (0, 0),
                1 => (1, 0),
                _ => (2, 1),
            };
            assert_eq!(
                (classes[pixel], moving[pixel]),
                expected,
                "instance {instance}"
            );
            seen.insert(instance);
        }
    }
    assert_eq!(seen.len(), 3, "{seen:?}");
}

/// Blurred images come near to those of many more sub-exposures, and the reference blurs alike.
#[test]
fn exposures_blur_what_moves() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let scene = street.join("scene.toml");
    let images = |name: &str, options: &[&str]| -> Vec<Image> {
        let out = folder.path().join(name);
        let own = ["render", text(&scene), "--size", "64x36", "--time", "0.5"];
        let own = [&own[..], &["--format", "npy", "--out", text(&out)], options].concat();
        succeed(&own);
        let cameras = SceneFile::read(&scene).unwrap().rig;
        cameras
            .cameras()
            .map(|camera| Image::read(&out.join(format!("{}.npy", camera.name))).unwrap())
            .collect()
    };
    let exposure = ["--exposure", "0.3"];
    let sharp = images("sharp", &[]);
    let few = images("few", &exposure);
    let many = images(
        "many",
        &[&exposure[..], &["--sub-exposures", "64"]].concat(),
    );
    let truth = images("truth", &[&exposure[..], &["--reference"]].concat());
    let db = |a: &[Image], b: &[Image]| {
        let pairs = a.iter().zip(b);
        let db = pairs.map(|(a, b)| Difference::between(a, b).unwrap().psnr_db);
        db.fold(f64::INFINITY, f64::min)
    };
    println!(
        "8 and 64: {:.1} dB, reference {:.1} dB, sharp {:.1} dB",
        db(&few, &many),
        db(&few, &truth),
        db(&sharp, &many)
    );
    assert!(db(&few, &many) >= 45.0 && db(&few, &truth) >= 90.0);
    assert!(db(&sharp, &many) < 40.0, "the camera moves");
    // Light is kept: it moves across the edges of the image alone.
    let light = |images: &[Image]| -> f64 {
        let values = images.iter().flat_map(|image| image.rgb.as_flattened());
        values
            .map(|value| f64::from(*value).max(0.0).powf(2.2))
            .sum()
    };
    assert!((light(&few) / light(&many) - 1.0).abs() < 1e-3);
    assert!((light(&few) / light(&sharp) - 1.0).abs() < 2e-2);
}
