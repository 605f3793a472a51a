//! Only its own page speaks with the viewer, and no client holds up another.

use super::*;

#[test]
fn only_the_page_of_the_viewer_is_served_and_only_with_the_token() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let beyond = ["--address", "0.0.0.0", "--no-token"];
    assert!(fail(1, &[&["view", text(&scene)], &beyond[..]].concat()).contains("--no-token"));
    assert!(fail(2, &["view", text(&scene), "--token", "short"]).contains("at least 8"));
    fail(2, &["view", "--token", "open-sesame", "--no-token"]);
    assert!(fail(1, &["view", "absent.toml", "--port", "0"]).contains("absent.toml"));

    let upgrade = "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n";
    let open = Viewer::start(&[text(&scene), "--no-token"]);
    assert_eq!(open.query, "");
    let taken = open.host.rsplit(':').next().unwrap();
    assert!(fail(1, &["view", text(&scene), "--port", taken]).contains("--port"));
    let here = format!("Host: {}\r\n", open.host);
    let page = open.get("/", &here);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(
        page.contains("content-security-policy: default-src 'self'"),
        "{page}"
    );
    let own = format!("Origin: http://{}\r\n", open.host);
    for (path, headers, status) in [
        ("/page/main.js", here.clone(), 200),
        ("/page/..%2f..%2fCargo.toml", here.clone(), 404),
        ("/page/../../../../etc/passwd", here.clone(), 404),
        ("/etc/passwd", here.clone(), 404),
        ("/", "Host: evil.example\r\n".into(), 403),
        ("/", format!("{here}Origin: http://evil.example\r\n"), 403),
        ("/", format!("{here}{own}"), 200),
        ("/socket", format!("{here}{upgrade}{own}"), 101),
        ("/socket", format!("{here}{upgrade}Origin: null\r\n"), 403),
        (
            "/socket",
            format!("{here}{upgrade}Origin: http://\u{ff}\r\n"),
            403,
        ),
        ("/socket", format!("{here}{upgrade}{own}{own}"), 403),
        (
            "/socket",
            format!("{here}{upgrade}Origin: ftp://{}\r\n", open.host),
            403,
        ),
    ] {
        let answer = open.get(path, &headers);
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status}")),
            "{path} {headers}: {answer}"
        );
    }

    // Without an option there is a token, another for each viewer.
    let made = Viewer::start(&[text(&scene)]);
    assert!(made.query.len() == "?token=".len() + 32, "{}", made.query);
    let here = format!("Host: {}\r\n", made.host);
    assert!(made.get("/", &here).starts_with("HTTP/1.1 401"));
    assert!(
        made.get(&format!("/{}", made.query), &here)
            .starts_with("HTTP/1.1 200")
    );

    let closed = Viewer::start(&[text(&scene), "--token", "open-sesame"]);
    assert_eq!(closed.query, "?token=open-sesame");
    let here = format!("Host: {}\r\n", closed.host);
    let page = closed.get("/?token=open-sesame", &here);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(page.contains("HttpOnly; SameSite=Strict"), "{page}");
    let cookie = page
        .lines()
        .find_map(|line| line.strip_prefix("set-cookie: "))
        .and_then(|set| set.split(';').next())
        .expect("the page sets a cookie");
    // Browsers send it to every port of this machine.
    let port = closed.host.rsplit(':').next().unwrap();
    assert!(
        cookie.starts_with(&format!("decouplegs_{port}=")),
        "{cookie}"
    );
    assert!(!cookie.contains("sesame"), "{cookie}");
    for (path, headers, status) in [
        ("/", here.clone(), 401),
        ("/?token=open-sesam", here.clone(), 401),
        ("/page/main.js", here.clone(), 401),
        ("/socket", format!("{here}{upgrade}"), 401),
        (
            "/page/main.js",
            format!("{here}Cookie: a=b; {cookie}\r\n"),
            200,
        ),
        ("/page/main.js", format!("{here}Cookie: {cookie}0\r\n"), 401),
        (
            "/page/main.js",
            format!("{here}Cookie: decouplegs_{port}=open-sesame\r\n"),
            401,
        ),
    ] {
        let answer = closed.get(path, &headers);
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status}")),
            "{path} {headers}: {answer}"
        );
    }
}

/// Clients that open connections and do not finish a request get no more than their share of them,
/// and not for long.
#[test]
fn silent_connections_lock_nobody_out() {
    const ADDRESS_CONNECTIONS: usize = 128;
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let viewer = Viewer::start(&[text(&folder.path().join("scene.toml"))]);
    let mut good = viewer.connect();
    let silent: Vec<TcpStream> = (0..ADDRESS_CONNECTIONS + 20)
        .map(|index| {
            let mut stream = TcpStream::connect(&viewer.host).expect("it listens");
            if index % 2 == 0 {
                let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: loc");
            }
            stream
        })
        .collect();
    // Those beyond the limit are closed at once, all others after ten seconds.
    let closed_within = |mut stream: &TcpStream, patience: Duration| {
        stream.set_read_timeout(Some(patience)).unwrap();
        let read = stream.read(&mut [0; 64]);
        !read.is_err_and(|error| {
            let kind = error.kind();
            kind == std::io::ErrorKind::WouldBlock || kind == std::io::ErrorKind::TimedOut
        })
    };
    let at_once = silent[ADDRESS_CONNECTIONS..].iter();
    assert!(
        at_once
            .clone()
            .all(|stream| closed_within(stream, Duration::from_secs(5)))
    );
    assert!(silent.iter().all(|stream| closed_within(stream, PATIENCE)));
    // Who speaks meanwhile stays.
    good.send("look", looks(&[named(0, "front", [48, 27])]));
    good.update_of(0.0);
    let here = format!("Host: {}\r\n", viewer.host);
    let page = viewer.get(&format!("/{}", viewer.query), &here);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
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
