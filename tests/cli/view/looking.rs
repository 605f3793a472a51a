//! Images of the viewer are those of `render`, and commands that make no sense are refused.

use std::time::Instant;

use super::*;

#[test]
fn a_still_image_of_the_viewer_is_that_of_render() {
    let folder = tempfile::tempdir().unwrap();
    coded_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let rendered = |out: &str, rest: &[&str]| {
        let out = folder.path().join(out);
        succeed(&[&["render", text(&scene), "--out", text(&out)], rest].concat());
        ["front", "back"].map(|name| rgb_of(&out.join(format!("{name}.png"))))
    };
    let viewer = Viewer::start(&[text(&scene)]);
    let mut page = viewer.connect();
    page.send(
        "look",
        looks(&[named(0, "front", [480, 270]), named(3, "back", [32, 18])]),
    );
    page.send("time", json!({"time_s": 0.5}));
    let update = page.update_of(0.5);
    assert_eq!(update.state["badge"], "exact");
    assert_eq!(
        update.state["sources"][0]["agents"]
            .as_array()
            .unwrap()
            .len(),
        2
    );
    // A pane that is larger than the image does not enlarge it; a smaller one has a smaller image.
    assert_eq!(update.state["panes"][0]["size_px"], json!([48, 27]));
    assert_eq!(update.state["panes"][1]["size_px"], json!([32, 18]));
    assert_eq!(&update.images[1][..8], b"DGSV\x03\x00\x03\x03");
    let [front, _] = rendered("own", &["--time", "0.5"]);
    let [_, back] = rendered("small", &["--time", "0.5", "--size", "32x18"]);
    assert!(update.rgb(folder.path(), 0) == front);
    assert!(update.rgb(folder.path(), 1) == back);

    // Another moment is another image, and that of `render` too.
    page.send("step", json!({"by": 2}));
    let later = page.update_of(0.7);
    let seen = later.rgb(folder.path(), 0);
    assert!(seen != front);
    assert!(seen == rendered("later", &["--time", "0.7"])[0]);
}

#[test]
fn names_of_no_camera_or_agent_are_refused_and_nothing_else_changes() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let viewer = Viewer::start(&[text(&folder.path().join("scene.toml"))]);
    let mut page = viewer.connect();
    page.send("look", looks(&[named(0, "nowhere", [64, 36])]));
    let answer = page.text();
    assert_eq!(answer["sequence"], 1);
    assert!(answer["error"].as_str().unwrap().contains("\"nowhere\""));
    let mut attached = named(0, "", [64, 36]);
    attached["camera"] = json!({"kind": "attached", "agent": "nobody", "position_m": [0, 0, 1], "rotation": [0, 0, 0, 1], "fov_deg": 60});
    page.send("look", looks(&[attached.clone()]));
    assert!(
        page.text()["error"]
            .as_str()
            .unwrap()
            .contains("\"nobody\"")
    );
    // Every kind of image, of the ego vehicle and of cameras at the ends of what is accepted.
    attached["camera"]["agent"] = Value::Null;
    for channel in [
        "color", "depth", "range", "instance", "normal", "flow", "alpha",
    ] {
        attached["channel"] = channel.into();
        page.send("look", looks(&[attached.clone()]));
        let update = page.update();
        page.send("shown", json!({"update": update.state["update"]}));
        assert_eq!(update.images.len(), 1, "{channel}");
    }
    for (position_m, fov_deg) in [([9e8, -9e8, 9e8], 0.1), ([0.0, 0.0, -5.0], 160.0)] {
        let camera = json!({"kind": "free", "position_m": position_m, "rotation": [1e8, 1, 1e-300, 0], "fov_deg": fov_deg});
        let pane = json!({"stream": 65535, "width_px": 16, "height_px": 4096, "camera": camera});
        page.send("look", looks(&[pane]));
        let update = page.update();
        page.send("shown", json!({"update": update.state["update"]}));
        assert_eq!(update.state["panes"][0]["size_px"], json!([16, 4096]));
    }
}

/// A connection that waits until its last message has arrived before it sends the next is 40 ms
/// late with each image.
#[test]
fn images_are_sent_as_soon_as_they_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let viewer = Viewer::start(&[text(&folder.path().join("scene.toml"))]);
    let mut page = viewer.connect();
    let names = ["front", "back"];
    let look_s = |at: usize| {
        let since = Instant::now();
        page.look(&[named(0, names[at % 2], [32, 18])]);
        since.elapsed().as_secs_f64()
    };
    // The system confirms the first messages of a connection early.
    let best_s = (0..40).map(look_s).skip(20).fold(f64::INFINITY, f64::min);
    println!("{best_s:.4} s");
    assert!(best_s < 0.04, "{best_s} s");
}
