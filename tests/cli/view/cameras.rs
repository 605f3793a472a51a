//! Cameras of the user outside the viewer: commands and paths that render the same images.

use super::*;

/// Runs `command` by a shell in `folder`, as it is pasted.
fn paste(command: &str, folder: &Path) {
    let program = Path::new(env!("CARGO_BIN_EXE_decouplegs"));
    let programs = program.parent().expect("it is in a folder");
    let path = std::env::var("PATH").unwrap_or_default();
    let output = Command::new("sh")
        .args(["-c", command])
        .env("PATH", format!("{}:{path}", text(programs)))
        .current_dir(folder)
        .output()
        .expect("there is a shell");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command}: {said}");
}

fn at(stream: u16, camera: Value, [width_px, height_px]: [u32; 2]) -> Value {
    json!({"stream": stream, "width_px": width_px, "height_px": height_px, "camera": camera})
}

fn with(mut pane: Value, key: &str, value: &str) -> Value {
    pane[key] = match value {
        "false" => false.into(),
        value => value.into(),
    };
    pane
}

/// Images of `panes`, and of the commands that the viewer gives for them; each must be the same.
fn compare_with_commands(page: &mut Page, panes: &[Value], folder: &Path) -> Vec<Vec<[u8; 3]>> {
    let mut images = Vec::new();
    for (index, pane) in panes.iter().enumerate() {
        let seen = page.look(std::slice::from_ref(pane)).rgb(folder, 0);
        let copied = page.ask("render_command", json!({"stream": pane["stream"]}));
        let copied = copied.unwrap();
        let command = copied["text"].as_str().unwrap();
        let own = folder.join(format!("pasted {index}"));
        fs::create_dir(&own).unwrap();
        paste(command, &own);
        let rendered = rgb_of(&own.join(copied["image"].as_str().unwrap()));
        assert!(seen == rendered, "{command}");
        fs::remove_dir_all(&own).unwrap();
        images.push(seen);
    }
    images
}

#[test]
fn the_command_of_a_view_renders_its_image() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("a street");
    coded_street(&street);
    let scene = street.join("scene.toml");
    let viewer = Viewer::start(&[text(&scene), "--rules", "gsplat15"]);
    let mut page = viewer.connect();
    page.ask("time", json!({"time_s": 0.3})).unwrap();
    let turned = [0.1, -0.5, 0.3, 0.7];
    let free = json!({"kind": "free", "position_m": [-3.0, 0.1, 2.2], "rotation": turned, "fov_deg": 61.7});
    // Behind an agent, looking along it.
    let ahead = [0.5, -0.5, 0.5, -0.5];
    let other = json!({"kind": "attached", "agent": "car_001", "position_m": [-7.0, 1.0, 3.0], "rotation": ahead, "fov_deg": 75});
    let front = named(0, "front", [480, 270]);
    let panes = [
        front.clone(),
        named(1, "back", [32, 18]),
        at(2, free.clone(), [64, 40]),
        at(4, other, [40, 64]),
        with(front.clone(), "channel", "depth"),
        with(at(2, free, [64, 40]), "channel", "normal"),
        with(front.clone(), "agents", "false"),
    ];
    let images = compare_with_commands(&mut page, &panes, folder.path());
    // Images of other views are not the same.
    for (index, image) in images.iter().enumerate() {
        assert!(
            images[..index].iter().all(|other| other != image),
            "{index}"
        );
    }
    let opacity = with(front.clone(), "channel", "alpha");
    page.look(&[opacity]);
    let refused = page.ask("render_command", json!({"stream": 0}));
    assert!(refused.unwrap_err().contains("opacity"));
    page.look(&[front]);
    page.ask("edit", json!({"edit": "remove", "agent": "car_001"}))
        .unwrap();
    let refused = page.ask("render_command", json!({"stream": 0}));
    assert!(refused.unwrap_err().contains("edited"));
    drop(viewer);

    // A splat file, by a camera of its circle.
    let splats = street.join("background.ply");
    let viewer = Viewer::start(&[text(&splats)]);
    let mut page = viewer.connect();
    let circle = [
        named(0, "orbit_003", [80, 45]),
        named(1, "orbit_000", [1280, 720]),
    ];
    compare_with_commands(&mut page, &circle, folder.path());
}

/// A recording along keyframes, and `render --camera-path` with the same keys.
#[test]
fn a_recorded_camera_path_is_that_of_render() {
    let folder = tempfile::tempdir().unwrap();
    coded_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let key = |time_s: f64, x_m: f64, rotation: [f64; 4]| json!({"time_s": time_s, "position_m": [x_m, 0.2, 2.5], "rotation": rotation, "fov_deg": 60.0 + x_m});
    let ahead = [0.5, -0.5, 0.5, -0.5];
    let keys = json!([
        key(0.1, -8.0, ahead),
        key(0.3, -4.0, [0.45, -0.55, 0.5, -0.5]),
        key(0.6, 3.0, ahead)
    ]);
    let viewer = Viewer::start_in(folder.path(), &[text(&scene)]);
    let mut page = viewer.connect();
    let free = json!({"kind": "free", "position_m": [0, 0, 2], "rotation": ahead, "fov_deg": 60});
    page.look(&[at(0, free, [48, 32]), named(1, "front", [48, 27])]);
    let record = json!({"folder": "film", "span_s": [0.1, 0.6], "rate_hz": 5.0, "path": keys});
    page.ask("record", record.clone()).unwrap();
    let said = page.said();
    assert!(said.starts_with("3 images"), "{said}");
    let mut wrong = record;
    wrong["path"][1]["time_s"] = 0.1.into();
    wrong["folder"] = "other".into();
    assert!(page.ask("record", wrong).unwrap_err().contains("key 2"));
    drop(viewer);

    let path = folder.path().join("path.json");
    fs::write(&path, json!({"camera_path": 1, "keys": keys}).to_string()).unwrap();
    let out = folder.path().join("out");
    let what = ["render", text(&scene), "--camera-path", text(&path)];
    let how = ["--rate", "5", "--size", "48x32", "--out", text(&out)];
    succeed(&[&what[..], &how].concat());
    let rendered = [0, 1, 2].map(|index| rgb_of(&out.join(format!("path_{index:05}.png"))));
    for (index, image) in rendered.iter().enumerate() {
        let written = folder.path().join(format!("film/view0000_{index:05}.png"));
        assert!(rgb_of(&written) == *image, "{index}");
        assert!(rendered[..index].iter().all(|other| other != image));
    }
    // The camera of the vehicle stays on it.
    let front = folder.path().join("front");
    succeed(&[
        "render",
        text(&scene),
        "--time",
        "0.3",
        "--out",
        text(&front),
    ]);
    let written = rgb_of(&folder.path().join("film/view0001_00001.png"));
    assert!(written == rgb_of(&front.join("front.png")));

    let refused = fail(
        1,
        &[
            "render",
            text(&scene),
            "--camera-path",
            text(&scene),
            "--out",
            "x",
        ],
    );
    assert!(
        refused.contains("scene.toml is no camera path"),
        "{refused}"
    );
    let pair = ["--camera-path", text(&path), "--orbit", "3", "--out", "x"];
    fail(2, &[&["render", text(&scene)], &pair[..]].concat());
    let view = ["--view", "1,2,3", "--out", "x"];
    assert!(fail(2, &[&["render", text(&scene)], &view[..]].concat()).contains("QX,QY,QZ,QW"));
}
