//! Commands are answered while an image is drawn.

use super::*;

/// Sides of an image whose drawing and encoding takes far longer than an answer, pixels.
const LARGE_PX: [u32; 2] = [4096, 2048];

/// True if each of the commands `asked` was answered before the image of the view `look`, in
/// `messages` in the order in which they came.
fn answered_before_image(messages: &[Value], asked: &[u64], look: u64) -> bool {
    let is_image = |message: &&Value| message["type"] == "frame" && message["look"] == look;
    let before = messages.iter().take_while(|message| !is_image(message));
    let answered: Vec<u64> = before
        .filter(|message| message["type"] == "ack")
        .filter_map(|message| message["sequence"].as_u64())
        .collect();
    asked.iter().all(|one| answered.contains(one))
}

#[test]
fn commands_are_answered_while_an_image_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    coded_street(folder.path());
    let viewer = Viewer::start(&[text(&folder.path().join("scene.toml"))]);
    let mut page = viewer.connect();
    page.look(&[named(0, "front", [48, 27])]);
    let camera =
        json!({"kind": "free", "position_m": [0, 0, 2], "rotation": [0, 0, 0, 1], "fov_deg": 60});
    let large =
        json!({"stream": 0, "width_px": LARGE_PX[0], "height_px": LARGE_PX[1], "camera": camera});
    page.send("look", looks(&[large]));
    let look = page.sequence;
    let mut messages: Vec<Value> = Vec::new();
    let mut next = |page: &mut Page| -> Value {
        loop {
            if let Message::Text(text) = page.socket.read().expect("it answers") {
                let message: Value = serde_json::from_str(&text).expect("JSON");
                messages.push(message.clone());
                return message;
            }
        }
    };
    let mut answer = |page: &mut Page, command: &str, fields: Value| -> Value {
        page.send(command, fields);
        let asked = page.sequence;
        loop {
            let message = next(page);
            if message["type"] == "ack" && message["sequence"] == asked {
                return message["result"].clone();
            }
        }
    };
    let begun = loop {
        let state = answer(&mut page, "state", json!({}));
        if state["drawing"] == true {
            break state;
        }
    };
    // The large image is in work from here on.
    let first = page.sequence + 1;
    answer(&mut page, "time", json!({"time_s": 0.5}));
    answer(&mut page, "step", json!({"by": 1}));
    answer(
        &mut page,
        "play",
        json!({"playing": true, "speed": 0.1, "looping": false}),
    );
    let playing = answer(&mut page, "state", json!({}));
    answer(
        &mut page,
        "play",
        json!({"playing": false, "speed": 1, "looping": false}),
    );
    let state = answer(&mut page, "state", json!({}));
    let asked: Vec<u64> = (first..=page.sequence).collect();
    assert_eq!(state["drawing"], true, "{state}");
    assert_eq!(state["drawn"], begun["drawn"], "the image is still in work");
    assert_eq!(playing["playing"], true);
    let time_s = state["time_s"].as_f64().unwrap();
    assert!((0.6 - 1e-9..1.0).contains(&time_s), "{time_s}");
    let frame = loop {
        let message = next(&mut page);
        if message["type"] == "frame" && message["look"] == look {
            break message;
        }
    };
    assert_eq!(frame["time_s"], 0.0, "it shows the state at its beginning");
    // The page is told of the clock without an image.
    let before = messages.iter().take_while(|message| **message != frame);
    let mut clocks = before.filter(|message| message["type"] == "clock");
    let told = clocks.any(|clock| clock["time_s"].as_f64().unwrap() >= 0.5);
    assert!(told, "{messages:?}");
    assert!(answered_before_image(&messages, &asked, look));

    // What would be late is found.
    let mut late = messages;
    let at = late.iter().position(|message| *message == frame).unwrap();
    late.swap(0, at);
    assert!(!answered_before_image(&late, &asked, look));
}
