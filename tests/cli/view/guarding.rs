//! Only its own page speaks with the viewer, and no client holds up another.

use super::*;

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
