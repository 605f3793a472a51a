//! Agents that are edited in the viewer: what is saved renders as it was shown.

use decouplegs::asset::{SceneFile, read_map};
use decouplegs::drive::LaneIndex;
use decouplegs::scene::{Camera, Intrinsics, Motion, Pose, RayMap};
use glam::{DQuat, DVec2, DVec3};

use super::*;

/// Camera above `at`, that looks straight down, and the image that it takes.
fn above(at: DVec3) -> (Value, Camera) {
    let rotation = DQuat::from_rotation_x(std::f64::consts::PI);
    let position_m = at + DVec3::new(0.0, 0.0, 60.0);
    let camera = json!({"kind": "free", "position_m": position_m.to_array(), "rotation": rotation.to_array(), "fov_deg": 60});
    let pane = json!({"stream": 4, "width_px": 200, "height_px": 200, "camera": camera});
    let intrinsics = Intrinsics::from_horizontal_fov(200, 200, 60f64.to_radians());
    let camera = Camera {
        name: "view".into(),
        intrinsics,
        world_from_camera: Pose::new(rotation, position_m),
        motion: Motion::REST,
    };
    (pane, camera)
}

/// Shares of the image at which `camera` sees `at`.
fn share_of(camera: &Camera, at: DVec3) -> [f64; 2] {
    let ray = camera.world_from_camera.inverse().transform(at);
    let pixel = RayMap::new(&camera.intrinsics)
        .project(ray)
        .expect("it is in the image");
    (pixel / 200.0).to_array()
}

fn place_of(update: &Update, name: &str) -> Option<Pose> {
    let agents = update.state["sources"][0]["agents"].as_array().unwrap();
    let agent = agents.iter().find(|agent| agent["name"] == name)?;
    let numbers = |key: &str| -> Vec<f64> {
        let values = agent["pose"][key].as_array().unwrap().iter();
        values.map(|x| x.as_f64().unwrap()).collect()
    };
    let (at, turn) = (numbers("position_m"), numbers("rotation"));
    let turn: [f64; 4] = turn.try_into().unwrap();
    Some(Pose::new(DQuat::from_array(turn), DVec3::from_slice(&at)))
}

/// Renders agents that move and agents of plain splats, in the light of the street.
#[test]
fn an_edited_scene_renders_as_it_was_shown() {
    for kind in ["movable", "plain", "lit"] {
        let folder = tempfile::tempdir().unwrap();
        match kind {
            "plain" => small_street(folder.path()),
            _ => coded_street(folder.path()),
        }
        let scene = folder.path().join("scene.toml");
        if kind == "lit" {
            let file = fs::read_to_string(&scene).unwrap();
            fs::write(&scene, format!("{file}\n[light]\n[light.shadows]\n")).unwrap();
        }
        let original = fs::read(&scene).unwrap();
        let viewer = Viewer::start(&[text(&scene)]);
        let (mut page, facts) = viewer.connect_with_facts();
        let edits = &facts["change"]["sources"][0]["edits"];
        assert_eq!(edits["undo"], Value::Null);
        let other = edits["assets"][1].clone();
        let all = ["front", "back"].map(|name| named(0, name, [48, 27]));
        page.ask("time", json!({"time_s": 0.0})).unwrap();
        let before = page.look(&all);
        let seen = |update: &Update| [0, 1].map(|index| update.rgb(folder.path(), index));

        let edit = |page: &mut Page, kind: &str, mut fields: Value| {
            fields["edit"] = kind.into();
            page.ask("edit", fields)
        };
        edit(&mut page, "duplicate", json!({"agent": "car_000"})).unwrap();
        edit(
            &mut page,
            "turn",
            json!({"agent": "car_000 copy", "by_rad": 0.7}),
        )
        .unwrap();
        let shift = json!({"agent": "car_000", "later_s": 0.3, "forward_m": 3.0, "left_m": -2.0});
        edit(&mut page, "shift", shift).unwrap();
        edit(
            &mut page,
            "swap",
            json!({"agent": "car_000", "asset": other}),
        )
        .unwrap();
        edit(&mut page, "remove", json!({"agent": "car_001"})).unwrap();
        let after = page.look(&all);
        assert!(seen(&after) != seen(&before), "{kind}");
        assert!(place_of(&after, "car_001").is_none());
        assert!(place_of(&after, "car_000 copy").is_some());
        let saved = edit(&mut page, "save", json!({"file": "edited.toml"})).unwrap();
        assert!(saved["said"].as_str().unwrap().contains("edited.toml"));

        let out = folder.path().join("out");
        let edited = folder.path().join("edited.toml");
        succeed(&["render", text(&edited), "--out", text(&out), "--time", "0"]);
        let rendered = ["front", "back"].map(|name| rgb_of(&out.join(format!("{name}.png"))));
        assert!(seen(&after) == rendered, "{kind}");

        for _ in 0..5 {
            edit(&mut page, "undo", json!({})).unwrap();
        }
        assert!(
            edit(&mut page, "undo", json!({}))
                .unwrap_err()
                .contains("nothing to undo")
        );
        assert!(seen(&page.look(&all)) == seen(&before), "{kind}");
        for _ in 0..5 {
            edit(&mut page, "redo", json!({})).unwrap();
        }
        assert!(seen(&page.look(&all)) == seen(&after), "{kind}");

        // A link that leads nowhere is a name that is taken.
        let link = folder.path().join("linked.toml");
        let _ = fs::remove_file(&link);
        let elsewhere = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink(elsewhere.path().join("away.toml"), &link).unwrap();

        // What is refused changes nothing.
        for (kind, fields, word) in [
            ("remove", json!({"agent": "nobody"}), "nobody"),
            (
                "swap",
                json!({"agent": "car_000", "asset": "/etc/passwd"}),
                "no asset",
            ),
            (
                "turn",
                json!({"agent": "car_000", "by_rad": 1e300}),
                "by_rad",
            ),
            ("save", json!({"file": "../up.toml"}), "expected a name"),
            ("save", json!({"file": "scene.toml"}), "exists already"),
            ("save", json!({"file": "linked.toml"}), "exists already"),
            ("save", json!({"file": "background.ply"}), ".toml"),
        ] {
            let error = edit(&mut page, kind, fields).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
        assert!(seen(&page.look(&all)) == seen(&after), "{kind}");
        assert_eq!(fs::read_dir(elsewhere.path()).unwrap().count(), 0);
        assert_eq!(
            fs::read(&scene).unwrap(),
            original,
            "the scene itself is left as it is"
        );
    }
}

#[test]
fn a_dragged_agent_follows_the_lane_and_is_found_under_the_mouse() {
    let folder = tempfile::tempdir().unwrap();
    coded_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let viewer = Viewer::start(&[text(&scene)]);
    let mut page = viewer.connect();
    page.ask("time", json!({"time_s": 0.0})).unwrap();
    let start = page.look(&[named(0, "front", [48, 27])]);
    let from = place_of(&start, "car_001").unwrap();
    let (pane, camera) = above(from.translation);
    let first = page.look(std::slice::from_ref(&pane));
    let (lanes, index) = {
        let map = read_map(&folder.path().join("lanes.json")).unwrap();
        let index = LaneIndex::new(&map);
        (map, index)
    };
    let lane = |at: DVec2| {
        index.nearest(at, |point| {
            lanes.lanes[point.lane].kind == decouplegs::scene::LaneKind::Driving
        })
    };

    let picked = page.ask(
        "pick",
        json!({"stream": 4, "at": share_of(&camera, from.translation)}),
    );
    let picked = picked.unwrap();
    assert_eq!(picked["agent"], "car_001");
    let z_m = picked["position_m"][2].as_f64().unwrap();
    assert!((z_m - from.translation.z).abs() < 1.5, "{picked}");
    let beside = from.translation + DVec3::new(0.0, 9.0, 0.0);
    let road = page.ask(
        "pick",
        json!({"stream": 4, "at": share_of(&camera, beside)}),
    );
    assert_eq!(road.unwrap()["agent"], Value::Null);

    // 4 m ahead and half a meter aside: it stays in its lane.
    let to = from.transform(DVec3::new(4.0, 0.5, 0.0));
    let mut drag = json!({
        "stream": 4, "agent": "car_001", "done": false,
        "from": share_of(&camera, from.translation), "to": share_of(&camera, to),
    });
    page.ask("drag", drag.clone()).unwrap();
    let held = page.look(std::slice::from_ref(&pane));
    drag["done"] = true.into();
    page.ask("drag", drag.clone()).unwrap();
    let dropped = page.look(std::slice::from_ref(&pane));
    let at = place_of(&dropped, "car_001").unwrap();
    assert_eq!(place_of(&held, "car_001").unwrap(), at);
    assert!(held.rgb(folder.path(), 0) == dropped.rgb(folder.path(), 0));
    let foot = lane(at.translation.truncate()).unwrap().foot;
    assert!(foot.distance_m < 0.01, "{foot:?}");
    let ahead = (at.translation - from.translation).truncate().length();
    assert!((ahead - 4.0).abs() < 0.05, "{ahead}");
    let heading = (at.rotation * DVec3::X).truncate().to_angle();
    assert!(decouplegs::drive::polyline::wrapped(heading - foot.heading_rad).abs() < 1e-6);
    assert!(dropped.rgb(folder.path(), 0) != first.rgb(folder.path(), 0));

    // Free, it is where the mouse is; undone, it is where it was, to the bit.
    page.ask("edit", json!({"edit": "undo"})).unwrap();
    let undone = page.look(std::slice::from_ref(&pane));
    assert!(undone.rgb(folder.path(), 0) == first.rgb(folder.path(), 0));
    drag["free"] = true.into();
    page.ask("drag", drag.clone()).unwrap();
    let free = place_of(&page.look(std::slice::from_ref(&pane)), "car_001").unwrap();
    assert!((free.translation - to).truncate().length() < 1e-6);
    page.ask("edit", json!({"edit": "save", "file": "edited.toml"}))
        .unwrap();
    let file = SceneFile::read(&folder.path().join("edited.toml")).unwrap();
    let saved = file.agent("car_001").unwrap().trajectory.at(0.0);
    assert!((saved.translation - free.translation).length() < 1e-6);

    // Above the horizon there is no ground: an agent that is released there goes back.
    let from_above = std::slice::from_ref(&pane);
    let rest = page.look(from_above);
    let shown = |update: &Update| (place_of(update, "car_001"), update.rgb(folder.path(), 0));
    drag["done"] = false.into();
    page.ask("drag", drag.clone()).unwrap();
    assert!(shown(&page.look(from_above)) != shown(&rest));
    page.look(&[named(4, "front", [48, 27])]);
    let sky = json!({"stream": 4, "agent": "car_001", "from": [0.5, 0.9], "to": [0.5, 0.0], "done": true});
    assert!(
        page.ask("drag", sky.clone())
            .unwrap_err()
            .contains("no ground")
    );
    assert!(shown(&page.look(from_above)) == shown(&rest));
    // So does one that is held while the scene is saved: what is shown is what is saved.
    page.ask("drag", drag).unwrap();
    page.ask("edit", json!({"edit": "save", "file": "edited.toml"}))
        .unwrap();
    assert!(shown(&page.look(from_above)) == shown(&rest));
    page.look(&[named(4, "front", [48, 27])]);
    let mut nobody = sky;
    nobody["agent"] = "nobody".into();
    assert!(page.ask("drag", nobody).unwrap_err().contains("nobody"));
}

/// Recorded images are those of `render`, with or without ffmpeg.
#[test]
fn a_recording_has_the_images_of_render() {
    let folder = tempfile::tempdir().unwrap();
    coded_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let viewer = Viewer::start_in(folder.path(), &[text(&scene)]);
    let mut page = viewer.connect();
    page.look(&[named(0, "front", [48, 27])]);
    let record = json!({"folder": "film", "span_s": [0.2, 0.5], "rate_hz": 10.0});
    page.ask("record", record.clone()).unwrap();
    let said = page.said();
    assert!(said.starts_with("4 images"), "{said}");
    for (index, time) in ["0.2", "0.3", "0.4", "0.5"].into_iter().enumerate() {
        let out = folder.path().join(time);
        succeed(&["render", text(&scene), "--out", text(&out), "--time", time]);
        let written = folder.path().join(format!("film/view0000_{index:05}.png"));
        assert!(rgb_of(&written) == rgb_of(&out.join("front.png")), "{time}");
    }
    assert!(page.ask("record", record).unwrap_err().contains("film"));
    let huge = json!({"folder": "huge", "span_s": [0.0, 1e9], "rate_hz": 100.0});
    assert!(page.ask("record", huge).unwrap_err().contains("span_s"));
    let up = json!({"folder": "../up", "span_s": [0.0, 1.0], "rate_hz": 1.0});
    assert!(page.ask("record", up).unwrap_err().contains("name"));
}
