//! The viewer as its page speaks to it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::json;
use tungstenite::{Message, WebSocket};

use super::*;

mod cameras;
mod editing;
mod episodes;
mod first_time;
mod guarding;
mod looking;
mod splats;
mod waiting;

/// Bytes of the header before each image.
const HEADER_BYTES: usize = 32;
const FLAG_LAST: u8 = 2;
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(60);

/// A running viewer.
struct Viewer {
    program: Child,
    /// Host and port.
    host: String,
    /// Query with the token that the printed address had, or empty.
    query: String,
}

impl Viewer {
    fn start(arguments: &[&str]) -> Self {
        Self::start_in(Path::new("."), arguments)
    }

    /// A viewer that was started in `folder`.
    fn start_in(folder: &Path, arguments: &[&str]) -> Self {
        let mut program = Command::new(env!("CARGO_BIN_EXE_decouplegs"))
            .args(["view", "--port", "0"])
            .args(arguments)
            .current_dir(folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let mut url = String::new();
        let stdout = program.stdout.take().expect("it is piped");
        BufReader::new(stdout).read_line(&mut url).expect("text");
        let printed = url.trim().trim_start_matches("http://");
        let (host, query) = printed.split_once('/').expect("an address");
        assert!(host.starts_with("127.0.0.1:"), "{url:?}");
        Self {
            program,
            host: host.to_owned(),
            query: query.to_owned(),
        }
    }

    /// Status line, headers and body of the answer to `GET path`.
    fn get(&self, path: &str, headers: &str) -> String {
        String::from_utf8_lossy(&self.get_bytes(path, headers)).into_owned()
    }

    fn get_bytes(&self, path: &str, headers: &str) -> Vec<u8> {
        let mut stream = TcpStream::connect(&self.host).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let then = match headers.contains("Upgrade: ") {
            true => "Upgrade",
            false => "close",
        };
        let request = format!("GET {path} HTTP/1.1\r\nConnection: {then}\r\n{headers}\r\n");
        stream.write_all(request.as_bytes()).expect("it reads");
        let mut answer = Vec::new();
        let mut part = [0; 4096];
        loop {
            let length = stream.read(&mut part).expect("it answers");
            answer.extend_from_slice(&part[..length]);
            // After an upgrade there is no end.
            if length == 0 || answer.starts_with(b"HTTP/1.1 101") {
                return answer;
            }
        }
    }

    fn connect(&self) -> Page {
        self.connect_with_facts().0
    }

    /// A client, and what it is sent of the scene, with what changes as `change`.
    fn connect_with_facts(&self) -> (Page, Value) {
        let stream = TcpStream::connect(&self.host).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        // As browsers do: the test's own messages do not wait for each other.
        stream.set_nodelay(true).unwrap();
        let url = format!("ws://{}/socket{}", self.host, self.query);
        let (socket, _) = tungstenite::client(url, stream).expect("it upgrades");
        let mut page = Page {
            socket,
            sequence: 0,
        };
        let mut facts = page.text();
        assert_eq!(facts["type"], "scene");
        facts["change"] = page.text();
        assert_eq!(facts["change"]["type"], "change");
        (page, facts)
    }
}

/// Ends it as Ctrl-C does: then messages of the validation layers count as failure.
impl Drop for Viewer {
    fn drop(&mut self) {
        let id = self.program.id().to_string();
        let asked = Command::new("kill").args(["-INT", &id]).status();
        let ended = self.program.wait().expect("it ends");
        assert!(asked.is_ok_and(|status| status.success()));
        assert!(std::thread::panicking() || ended.success(), "{ended}");
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
                Some("change" | "clock" | "recording") => {}
                _ => panic!("{message}"),
            }
        };
        let images = self.images(state["images"].as_u64().unwrap());
        Update { state, images }
    }

    /// Result of a command; a sentence where it is refused. Updates meanwhile are shown and
    /// dropped.
    fn ask(&mut self, command: &str, fields: Value) -> Result<Value, String> {
        self.send(command, fields);
        let asked = self.sequence;
        loop {
            let message = match self.socket.read().expect("it answers") {
                Message::Text(text) => serde_json::from_str::<Value>(&text).expect("JSON"),
                _ => continue,
            };
            if message["type"] == "frame" {
                self.send("shown", json!({"update": message["update"]}));
            }
            if message["type"] == "ack" && message["sequence"] == asked {
                return match message["error"].as_str() {
                    Some(error) => Err(error.to_owned()),
                    None => Ok(message["result"].clone()),
                };
            }
        }
    }

    /// The next sentence that the viewer says; errors before it fail the test.
    fn said(&mut self) -> String {
        loop {
            if let Message::Text(text) = self.socket.read().unwrap() {
                let message: Value = serde_json::from_str(&text).unwrap();
                assert_eq!(message["error"], Value::Null, "{message}");
                if let Some(said) = message["said"].as_str() {
                    return said.to_owned();
                }
            }
        }
    }

    /// The update that follows a view of `panes` at rest; one of an earlier view may be in work.
    fn look(&mut self, panes: &[Value]) -> Update {
        self.send("look", looks(panes));
        let asked = self.sequence;
        loop {
            match self.socket.read().expect("it answers") {
                Message::Text(text) => {
                    let message: Value = serde_json::from_str(&text).expect("JSON");
                    if message["type"] == "ack" && message["sequence"] == asked {
                        assert_eq!(message["error"], Value::Null, "{message}");
                    }
                    if message["type"] == "frame" {
                        self.send("shown", json!({"update": message["update"]}));
                        if message["look"] == asked {
                            let images = self.images(message["images"].as_u64().unwrap());
                            let state = message;
                            return Update { state, images };
                        }
                    }
                }
                Message::Binary(_) => {}
                other => panic!("{other:?}"),
            }
        }
    }

    /// The next `count` images.
    fn images(&mut self, count: u64) -> Vec<Vec<u8>> {
        let mut next = || match self.socket.read().expect("it answers") {
            Message::Binary(bytes) => bytes.to_vec(),
            other => panic!("expected an image, found {other:?}"),
        };
        let images: Vec<Vec<u8>> = (0..count).map(|_| next()).collect();
        assert!(
            images
                .iter()
                .rev()
                .skip(1)
                .all(|image| image[7] & FLAG_LAST == 0)
        );
        assert!(images.last().is_none_or(|image| image[7] & FLAG_LAST != 0));
        images
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
