//! The viewer as its page speaks to it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::time::Duration;

use serde_json::json;
use tungstenite::{Message, WebSocket};

use super::ground_truth::coded_street;
use super::*;

/// Bytes of the header before each image.
const HEADER_BYTES: usize = 32;
const FLAG_LAST: u8 = 2;
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(60);

/// A running viewer, ended when dropped.
struct Viewer {
    program: Child,
    /// Host and port.
    host: String,
}

impl Viewer {
    fn start(arguments: &[&str]) -> Self {
        let mut program = Command::new(env!("CARGO_BIN_EXE_decouplegs"))
            .args(["view", "--port", "0"])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let mut url = String::new();
        let stdout = program.stdout.take().expect("it is piped");
        BufReader::new(stdout).read_line(&mut url).expect("text");
        let host = url.trim().trim_start_matches("http://");
        let host = host.split('/').next().unwrap_or_default().to_owned();
        assert!(host.starts_with("127.0.0.1:"), "{url:?}");
        Self { program, host }
    }

    /// Status line, headers and body of the answer to `GET path`.
    fn get(&self, path: &str, headers: &str) -> String {
        let mut stream = TcpStream::connect(&self.host).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let request = format!("GET {path} HTTP/1.1\r\nConnection: close\r\n{headers}\r\n");
        stream.write_all(request.as_bytes()).expect("it reads");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("text");
        answer
    }

    fn connect(&self) -> Page {
        self.connect_with_facts().0
    }

    /// A client, and what it is sent of the scene.
    fn connect_with_facts(&self) -> (Page, Value) {
        let stream = TcpStream::connect(&self.host).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let url = format!("ws://{}/socket", self.host);
        let (socket, _) = tungstenite::client(url, stream).expect("it upgrades");
        let mut page = Page {
            socket,
            sequence: 0,
        };
        let facts = page.text();
        assert_eq!(facts["type"], "scene");
        (page, facts)
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

/// One client.
struct Page {
    socket: WebSocket<TcpStream>,
    sequence: u64,
}

/// State and images of an update.
struct Update {
    state: Value,
    images: Vec<Vec<u8>>,
}

impl Update {
    /// 8-bit RGB of an image, and the bits of its header.
    fn rgb(&self, folder: &Path, index: usize) -> Vec<[u8; 3]> {
        let file = folder.join("seen.png");
        fs::write(&file, &self.images[index][HEADER_BYTES..]).unwrap();
        rgb_of(&file)
    }
}

fn rgb_of(file: &Path) -> Vec<[u8; 3]> {
    let byte = |value: f32| (value * 255.0).round() as u8;
    let image = Image::read(file).expect("an image");
    image.rgb.iter().map(|rgb| rgb.map(byte)).collect()
}

impl Page {
    fn send(&mut self, command: &str, mut fields: Value) {
        self.sequence += 1;
        fields["sequence"] = self.sequence.into();
        fields["command"] = command.into();
        let sent = self.socket.send(Message::text(fields.to_string()));
        sent.expect("it reads");
    }

    /// The next message, JSON.
    fn text(&mut self) -> Value {
        match self.socket.read().expect("it answers") {
            Message::Text(text) => serde_json::from_str(&text).expect("JSON"),
            other => panic!("expected text, found {other:?}"),
        }
    }

    /// The next complete update; acknowledgements before it must be of success.
    fn update(&mut self) -> Update {
        let state = loop {
            let message = self.text();
            match message["type"].as_str() {
                Some("frame") => break message,
                Some("ack") if message["error"].is_null() => {}
                _ => panic!("{message}"),
            }
        };
        let mut images: Vec<Vec<u8>> = Vec::new();
        while images.last().is_none_or(|image| image[7] & FLAG_LAST == 0) {
            match self.socket.read().expect("it answers") {
                Message::Binary(bytes) => images.push(bytes.to_vec()),
                other => panic!("expected an image, found {other:?}"),
            }
        }
        Update { state, images }
    }

    /// Shows updates until one is of `time_s`.
    fn update_of(&mut self, time_s: f64) -> Update {
        loop {
            let update = self.update();
            self.send("shown", json!({"update": update.state["update"]}));
            if (update.state["time_s"].as_f64().unwrap() - time_s).abs() < 1e-9 {
                return update;
            }
        }
    }

    /// Reason that the viewer closes the connection for.
    fn closed(&mut self) -> String {
        loop {
            match self.socket.read() {
                Ok(Message::Close(frame)) => {
                    return frame.map(|f| f.reason.to_string()).unwrap_or_default();
                }
                Ok(_) => {}
                Err(error) => panic!("closed without a word: {error}"),
            }
        }
    }
}

fn named(stream: u16, name: &str, [width_px, height_px]: [u32; 2]) -> Value {
    json!({"stream": stream, "width_px": width_px, "height_px": height_px, "camera": {"kind": "named", "name": name}})
}

fn looks(panes: &[Value]) -> Value {
    json!({"panes": panes, "moving": false})
}

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
    assert_eq!(update.state["agents"].as_array().unwrap().len(), 2);
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

/// Images at the steps of a log are compared with its hashes, and the badge says so: also when the
/// scene was changed afterwards.
#[test]
fn an_episode_shows_the_bits_of_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let (scene, lanes) = (street.join("scene.toml"), street.join("lanes.json"));
    let out = folder.path().join("run");
    let place = ["drive", "--scene", text(&scene), "--map", text(&lanes)];
    let what = ["--level", "extreme", "--episodes", "1", "--size", "96x54"];
    let how = ["--planner", "constant-velocity", "--all-cameras"];
    succeed(&[&place[..], &what, &how, &["--out", text(&out)]].concat());
    let log = out.join("logs/extreme_0000.log");
    let badge = |panes: &[Value], time_s: f64| {
        let viewer = Viewer::start(&[text(&log)]);
        let (mut page, facts) = viewer.connect_with_facts();
        page.send("look", looks(panes));
        page.update_of(0.0);
        page.send("time", json!({"time_s": time_s}));
        let state = page.update_of(time_s).state;
        (state["badge"].as_str().unwrap().to_owned(), state, facts)
    };
    let all = ["front", "front_left"].map(|name| named(0, name, [96, 54]));
    let (same, state, facts) = badge(&all, 1.0);
    assert_eq!(same, "exact, same bits as the log");
    let log_facts = &facts["log"];
    assert_eq!(log_facts["planner"], "constant-velocity");
    assert_eq!(log_facts["departs_s"], Value::Null);
    assert!(!log_facts["lanes"].as_array().unwrap().is_empty());
    let speeds = log_facts["speed_mps"].as_array().unwrap();
    assert_eq!(
        speeds.len(),
        log_facts["time_to_collision_s"].as_array().unwrap().len()
    );
    let json = json(&["score", text(&log), "--json"]);
    assert!(
        json.to_string()
            .contains(&log_facts["score"]["driving_score"].to_string()),
        "{json}"
    );
    // The plan starts below the middle of the ego's box and goes ahead.
    let plan = state["plan"].as_array().unwrap();
    let ego = &state["ego"]["position_m"];
    assert!(
        plan.len() > 2 && plan[0][0] == ego[0] && plan[0][1] == ego[1],
        "{plan:?} {ego}"
    );

    // Between steps, at another size or without agents there is nothing to compare.
    assert_eq!(badge(&all, 1.1).0, "exact");
    assert_eq!(badge(&[named(0, "front", [48, 27])], 1.0).0, "exact");
    let mut bare = all[0].clone();
    bare["agents"] = false.into();
    assert_eq!(badge(&[bare], 1.0).0, "exact");

    let file = fs::read_to_string(&scene).unwrap();
    fs::write(
        &scene,
        file.replacen(r#"name = "default""#, r#"name = "inria""#, 1),
    )
    .unwrap();
    assert_eq!(badge(&all, 1.0).0, "exact, other bits than the log");
    assert!(fail(1, &["view", text(&log), "--time", "1"]).contains("leave out"));
    assert!(fail(1, &["view", text(&scene), "--base", "."]).contains("--base"));
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

#[test]
fn only_the_page_of_the_viewer_is_served_and_only_with_the_token() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    assert!(fail(1, &["view", text(&scene), "--address", "0.0.0.0"]).contains("--token"));
    assert!(fail(2, &["view", text(&scene), "--token", "short"]).contains("at least 8"));
    assert!(fail(1, &["view", "absent.toml", "--port", "0"]).contains("absent.toml"));

    let upgrade = "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n";
    let open = Viewer::start(&[text(&scene)]);
    let taken = open.host.rsplit(':').next().unwrap();
    assert!(fail(1, &["view", text(&scene), "--port", taken]).contains("--port"));
    let here = format!("Host: {}\r\n", open.host);
    let page = open.get("/", &here);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(
        page.contains("content-security-policy: default-src 'self'"),
        "{page}"
    );
    for (path, headers, status) in [
        ("/page/main.js", here.clone(), 200),
        ("/page/..%2f..%2fCargo.toml", here.clone(), 404),
        ("/page/../../../../etc/passwd", here.clone(), 404),
        ("/etc/passwd", here.clone(), 404),
        ("/", "Host: evil.example\r\n".into(), 403),
        ("/", format!("{here}Origin: http://evil.example\r\n"), 403),
        ("/", format!("{here}Origin: http://{}\r\n", open.host), 200),
        ("/socket", format!("{here}{upgrade}Origin: null\r\n"), 403),
    ] {
        let answer = open.get(path, &headers);
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status}")),
            "{path} {headers}: {answer}"
        );
    }

    let closed = Viewer::start(&[text(&scene), "--token", "open-sesame"]);
    let here = format!("Host: {}\r\n", closed.host);
    for (path, headers, status) in [
        ("/", here.clone(), 401),
        ("/?token=open-sesam", here.clone(), 401),
        ("/page/main.js", here.clone(), 401),
        ("/socket", format!("{here}{upgrade}"), 401),
        (
            "/page/main.js",
            format!("{here}Cookie: a=b; decouplegs_token=open-sesame\r\n"),
            200,
        ),
        (
            "/page/main.js",
            format!("{here}Cookie: decouplegs_token=open-sesame2\r\n"),
            401,
        ),
    ] {
        let answer = closed.get(path, &headers);
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status}")),
            "{path} {headers}: {answer}"
        );
    }
    let page = closed.get("/?token=open-sesame", &here);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(page.contains("HttpOnly; SameSite=Strict"), "{page}");
}

#[test]
fn hostile_slow_and_dead_clients_hold_up_nobody() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let viewer = Viewer::start(&[text(&folder.path().join("scene.toml"))]);
    let mut good = viewer.connect();
    good.send("look", looks(&[named(0, "front", [48, 27])]));
    good.update_of(0.0);

    // Messages that are no commands: some are answered, then the connection is closed.
    let mut nonsense = viewer.connect();
    for index in 0..200 {
        let text = format!("{{\"sequence\": {index}, \"command\": \"look\", \"panes\": [{{");
        if nonsense.socket.send(Message::text(text)).is_err() {
            break;
        }
    }
    assert!(nonsense.closed().contains("no commands"));
    let mut binary = viewer.connect();
    binary.socket.send(Message::binary(vec![0; 64])).unwrap();
    assert!(binary.closed().contains("text"));

    // Clients that never say that they have shown an update get two, and those that are dead none.
    let mut silent: Vec<Page> = (0..98).map(|_| viewer.connect()).collect();
    for page in &mut silent {
        page.send("look", looks(&[named(0, "front", [48, 27])]));
    }
    drop(silent.split_off(50));
    for tenth in 1..=8 {
        let time_s = 0.1 * f64::from(tenth);
        good.send("time", json!({"time_s": time_s}));
        good.update_of(time_s);
    }
    let first = &mut silent[0];
    let updates = [first.update(), first.update()];
    assert_eq!(updates[1].state["update"], 2);
    first.send("shown", json!({"update": 2}));
    // The third is the newest state: what was between is skipped.
    let third = first.update();
    assert_eq!(third.state["update"], 3);
    assert!(
        (third.state["time_s"].as_f64().unwrap() - 0.8).abs() < 1e-9,
        "{}",
        third.state
    );
}
