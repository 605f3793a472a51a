//! Web server: the page, and a WebSocket for each client.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::Duration;

use axum::Router;
use axum::body::Bytes;
use axum::extract::connect_info::Connected;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{ConnectInfo, Extension, Path, Request, State};
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, put};
use axum::serve::{IncomingStream, Listener};
use decouplegs_connections::{Acceptor, Connection, ConnectionInfo, ConnectionLimits, OpenRequest};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot, watch};

use crate::events::{Event, Outgoing, post};
use crate::page_files::PAGE;
use crate::protocol::{COMMAND_BYTES_MAX, Refused, parse};
use crate::uploads::{self, Uploads};

/// Messages that wait for a client before it is dropped.
const OUTBOX: usize = 256;
/// Commands that are no commands before a client is dropped.
const FAULTS_MAX: u32 = 100;
/// Time for a connection until its first request has arrived whole, and until its next one. A
/// WebSocket is a request without an end.
const REQUEST_PATIENCE: Duration = Duration::from_secs(10);
/// Longest wait until a client has read why its connection is closed.
const FAREWELL: Duration = Duration::from_secs(2);

/// State that requests are answered from.
#[derive(Clone)]
pub struct Service {
    /// Way to the thread that serves the clients.
    pub events: SyncSender<Event>,
    /// Secret that requests need; `None` if none is asked for.
    pub secret: Option<Secret>,
    /// Number of the next client.
    pub next_client: Arc<AtomicU64>,
    /// True if only this machine can connect.
    pub loopback: bool,
    /// Files that pages send.
    pub uploads: Arc<Uploads>,
}

/// The secret of a viewer, and the cookie by which a page shows that it had it.
#[derive(Clone)]
pub struct Secret {
    token: Arc<str>,
    /// Name and value. Browsers send cookies to all ports of a host: the name tells viewers apart,
    /// and the value is no token.
    cookie: [Arc<str>; 2],
}

impl Secret {
    /// The secret `token` of the viewer at `port`. A viewer that is started again with both knows
    /// the pages of the one before.
    pub fn new(token: &str, port: u16) -> Self {
        let digest = Sha256::digest(format!("decouplegs view, port {port}, token {token}"));
        let value: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        Self {
            token: token.into(),
            cookie: [format!("decouplegs_{port}").into(), value.into()],
        }
    }

    fn is_token(&self, given: &str) -> bool {
        given.as_bytes().ct_eq(self.token.as_bytes()).into()
    }

    fn is_in_cookies(&self, headers: &HeaderMap) -> bool {
        let [name, value] = &self.cookie;
        let lists = headers.get_all(header::COOKIE).iter();
        let mut cookies = lists
            .filter_map(|list| list.to_str().ok())
            .flat_map(|list| list.split(';'))
            .filter_map(|cookie| cookie.trim().split_once('='));
        cookies.any(|(given, held)| {
            given == &**name && bool::from(held.as_bytes().ct_eq(value.as_bytes()))
        })
    }
}

/// Connections of the web server.
pub struct Connections(Acceptor);

impl Connections {
    /// Accepts from `listener` within the limits that the render server has.
    pub fn new(listener: TcpListener) -> Self {
        let limits = ConnectionLimits {
            idle: REQUEST_PATIENCE,
            ..ConnectionLimits::default()
        };
        // They end with the program.
        let (_, closing) = watch::channel(false);
        Self(Acceptor::new(listener, limits, closing, Arc::new(())))
    }
}

impl Listener for Connections {
    type Io = Connection;
    type Addr = std::net::SocketAddr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        let connection = self.0.accept().await;
        let address = connection.peer();
        (connection, address)
    }

    fn local_addr(&self) -> std::io::Result<Self::Addr> {
        self.0.local_addr()
    }
}

/// The connection that a request came by.
#[derive(Clone)]
pub struct Peer(ConnectionInfo);

impl Connected<IncomingStream<'_, Connections>> for Peer {
    fn connect_info(stream: IncomingStream<'_, Connections>) -> Self {
        Self(stream.io().info())
    }
}

/// Routes of the server.
pub fn router(service: Service) -> Router {
    let files = Arc::clone(&service.uploads);
    Router::new()
        .route("/", get(|| async { file("index.html") }))
        .route(
            "/page/{name}",
            get(|Path(name): Path<String>| async move { file(&name) }),
        )
        .route("/splats/{source}", get(splats))
        .route("/files/{name}", put(uploads::put).with_state(files))
        .route("/socket", get(socket))
        .layer(middleware::from_fn_with_state(service.clone(), guard))
        .with_state(service)
}

fn file(name: &str) -> Response {
    match PAGE.iter().find(|(known, ..)| *known == name) {
        Some((_, kind, text)) => ([(header::CONTENT_TYPE, *kind)], *text).into_response(),
        None => (StatusCode::NOT_FOUND, "there is no such file").into_response(),
    }
}

/// Refuses requests from pages of other sites, and those without the token. A connection whose
/// request is refused is closed.
async fn guard(
    State(service): State<Service>,
    ConnectInfo(Peer(connection)): ConnectInfo<Peer>,
    mut request: Request,
    next: Next,
) -> Response {
    let open = Arc::new(connection.begin());
    request.extensions_mut().insert(Arc::clone(&open));
    let cookie = match admitted(&service, &request) {
        Ok(cookie) => cookie,
        Err((status, reason)) => {
            return (status, [(header::CONNECTION, "close")], reason).into_response();
        }
    };
    let mut response = next.run(request).await;
    let mut set = |name, value: &str| {
        if let Ok(value) = value.parse() {
            response.headers_mut().insert(name, value);
        }
    };
    set(
        header::CONTENT_SECURITY_POLICY,
        "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'",
    );
    set(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(header::REFERRER_POLICY, "no-referrer");
    set(header::CACHE_CONTROL, "no-store");
    if let Some(cookie) = cookie {
        set(header::SET_COOKIE, &cookie);
    }
    response
}

/// The cookie that is due to the client of a request, or why the request is refused.
fn admitted(
    service: &Service,
    request: &Request,
) -> Result<Option<String>, (StatusCode, &'static str)> {
    let headers = request.headers();
    let host = only(headers, header::HOST).flatten().unwrap_or("");
    // A foreign name that resolves to this machine (DNS rebinding) is no name of it.
    if service.loopback && !is_local(host) {
        let reason = "this viewer answers to localhost alone: give --address and --token";
        return Err((StatusCode::FORBIDDEN, reason));
    }
    // Programs that are no browsers send none.
    let is_own = match only(headers, header::ORIGIN) {
        Some(origin) => origin.is_none_or(|origin| is_page_of(origin, host)),
        None => false,
    };
    if !is_own {
        return Err((StatusCode::FORBIDDEN, "pages of other sites are refused"));
    }
    let Some(secret) = &service.secret else {
        return Ok(None);
    };
    let query = request.uri().query().unwrap_or("");
    let mut from_query = query
        .split('&')
        .filter_map(|pair| pair.strip_prefix("token="));
    if from_query.any(|given| secret.is_token(given)) {
        let [name, value] = &secret.cookie;
        return Ok(Some(format!(
            "{name}={value}; HttpOnly; SameSite=Strict; Path=/"
        )));
    }
    if secret.is_in_cookies(headers) {
        return Ok(None);
    }
    let reason = "the token is missing or wrong: open the address that 'decouplegs view' printed";
    Err((StatusCode::UNAUTHORIZED, reason))
}

/// The value of a header that is there at most once; `None` if it is there more often, or is not
/// ASCII.
fn only(headers: &HeaderMap, name: HeaderName) -> Option<Option<&str>> {
    let mut values = headers.get_all(name).iter();
    match (values.next(), values.next()) {
        (None, _) => Some(None),
        (Some(value), None) => value.to_str().ok().map(Some),
        (Some(_), Some(_)) => None,
    }
}

/// True if `origin` is that of a page which `host` served.
fn is_page_of(origin: &str, host: &str) -> bool {
    let site = origin
        .strip_prefix("http://")
        .or_else(|| origin.strip_prefix("https://"));
    site == Some(host)
}

/// True if `host`, with or without a port, is this machine.
fn is_local(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    matches!(name, "localhost" | "127.0.0.1" | "[::1]")
}

/// Splats of a source, as `splat_stream` writes them: all pages share one copy.
async fn splats(State(service): State<Service>, Path(source): Path<usize>) -> Response {
    let (answer, answered) = oneshot::channel();
    post(&service.events, Event::Splats(source, answer)).await;
    match answered.await {
        Ok(Some(bytes)) => {
            let body = Bytes::from_owner(bytes);
            ([(header::CONTENT_TYPE, "application/octet-stream")], body).into_response()
        }
        Ok(None) => (StatusCode::NOT_FOUND, "there is no such source").into_response(),
        Err(_) => (StatusCode::SERVICE_UNAVAILABLE, "the viewer ends").into_response(),
    }
}

async fn socket(
    State(service): State<Service>,
    Extension(open): Extension<Arc<OpenRequest>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    upgrade
        .max_message_size(COMMAND_BYTES_MAX)
        .max_frame_size(COMMAND_BYTES_MAX)
        .on_upgrade(async move |socket| {
            serve(socket, service).await;
            drop(open);
        })
}

async fn serve(mut socket: WebSocket, service: Service) {
    let id = service.next_client.fetch_add(1, Ordering::Relaxed);
    let (outbox, mut messages) = mpsc::channel(OUTBOX);
    if !post(&service.events, Event::Joined(id, outbox)).await {
        return;
    }
    let mut faults = 0;
    let reason = loop {
        tokio::select! {
            message = messages.recv() => {
                let message = match message {
                    Some(Outgoing::Text(text)) => Message::Text(text.into()),
                    Some(Outgoing::Image(bytes)) => Message::Binary(bytes.into()),
                    None => break Some("the viewer ends, or this client left too much unread"),
                };
                if socket.send(message).await.is_err() {
                    break None;
                }
            }
            message = socket.recv() => {
                let text = match message {
                    Some(Ok(Message::Text(text))) => text,
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => continue,
                    Some(Ok(Message::Binary(_))) => break Some("commands are text"),
                    Some(Ok(Message::Close(_)) | Err(_)) | None => break None,
                };
                match parse(&text) {
                    Ok(request) => if !post(&service.events, Event::Command(id, request)).await {
                        break Some("the viewer ends");
                    },
                    Err(Refused { sequence, reason }) => {
                        faults += 1;
                        if faults > FAULTS_MAX {
                            break Some("too many messages were no commands");
                        }
                        let answer = serde_json::json!({"type": "ack", "sequence": sequence, "error": reason});
                        if socket.send(Message::Text(answer.to_string().into())).await.is_err() {
                            break None;
                        }
                    }
                }
            }
        }
    };
    if let Some(reason) = reason {
        let frame = CloseFrame {
            code: close_code::POLICY,
            reason: reason.into(),
        };
        let _ = socket.send(Message::Close(Some(frame))).await;
        // What the client sent meanwhile is read: a socket that is closed with unread data resets
        // the connection, and the reason is lost.
        let rest = async { while socket.recv().await.is_some_and(|message| message.is_ok()) {} };
        let _ = tokio::time::timeout(FAREWELL, rest).await;
    }
    post(&service.events, Event::Left(id)).await;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_machine_are_local() {
        for host in [
            "localhost",
            "localhost:8090",
            "127.0.0.1:1",
            "[::1]:8090",
            "[::1]",
        ] {
            assert!(is_local(host), "{host}");
        }
        for host in [
            "",
            "evil.example",
            "localhost.evil.example:8090",
            "127.0.0.1.nip.io",
            "localhost:80:x",
        ] {
            assert!(!is_local(host), "{host}");
        }
    }

    #[test]
    fn a_cookie_tells_no_token_and_counts_for_its_port_alone() {
        let secret = Secret::new("open-sesame", 8090);
        let [name, value] = &secret.cookie;
        assert_eq!(&**name, "decouplegs_8090");
        assert!(!value.contains("open-sesame"), "{value}");
        let given = |cookie: String| {
            let headers = HeaderMap::from_iter([(header::COOKIE, cookie.parse().unwrap())]);
            secret.is_in_cookies(&headers)
        };
        assert!(given(format!("a=b; {name}={value}")));
        for other in [
            Secret::new("open-sesame", 8091),
            Secret::new("open-sesama", 8090),
        ] {
            assert!(!given(format!("{name}={}", other.cookie[1])));
        }
        assert!(!given(format!("{name}=open-sesame")));
        assert!(!given("nothing".into()));
    }

    #[test]
    fn only_pages_of_the_host_itself_are_its_pages() {
        let here = "127.0.0.1:8090";
        for origin in ["http://127.0.0.1:8090", "https://127.0.0.1:8090"] {
            assert!(is_page_of(origin, here), "{origin}");
        }
        for origin in [
            "null",
            "",
            "127.0.0.1:8090",
            "chrome-extension://127.0.0.1:8090",
            "http://127.0.0.1",
            "http://http://127.0.0.1:8090",
        ] {
            assert!(!is_page_of(origin, here), "{origin}");
        }
        let mut headers = HeaderMap::new();
        assert_eq!(only(&headers, header::ORIGIN), Some(None));
        headers.append(header::ORIGIN, "http://a".parse().unwrap());
        assert_eq!(only(&headers, header::ORIGIN), Some(Some("http://a")));
        headers.append(header::ORIGIN, "http://a".parse().unwrap());
        assert_eq!(only(&headers, header::ORIGIN), None);
        let raw = axum::http::HeaderValue::from_bytes(b"http://\xff").unwrap();
        let headers = HeaderMap::from_iter([(header::ORIGIN, raw)]);
        assert_eq!(only(&headers, header::ORIGIN), None);
    }
}
