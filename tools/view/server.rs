//! Web server: the page, and a WebSocket for each client.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::Duration;

use axum::Router;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use subtle::ConstantTimeEq;
use tokio::sync::mpsc;

use crate::events::{Event, Outgoing};
use crate::protocol::{COMMAND_BYTES_MAX, Refused, parse};

/// Messages that wait for a client before it is dropped.
const OUTBOX: usize = 256;
/// Commands that are no commands before a client is dropped.
const FAULTS_MAX: u32 = 100;
/// Longest wait until a client has read why its connection is closed.
const FAREWELL: Duration = Duration::from_secs(2);

const JAVASCRIPT: &str = "text/javascript; charset=utf-8";
const PAGE: [(&str, &str, &str); 12] = [
    (
        "index.html",
        "text/html; charset=utf-8",
        include_str!("page/index.html"),
    ),
    (
        "style.css",
        "text/css; charset=utf-8",
        include_str!("page/style.css"),
    ),
    ("cameras.js", JAVASCRIPT, include_str!("page/cameras.js")),
    ("compare.js", JAVASCRIPT, include_str!("page/compare.js")),
    (
        "connection.js",
        JAVASCRIPT,
        include_str!("page/connection.js"),
    ),
    ("geometry.js", JAVASCRIPT, include_str!("page/geometry.js")),
    ("main.js", JAVASCRIPT, include_str!("page/main.js")),
    ("overlays.js", JAVASCRIPT, include_str!("page/overlays.js")),
    ("panels.js", JAVASCRIPT, include_str!("page/panels.js")),
    ("state.js", JAVASCRIPT, include_str!("page/state.js")),
    ("timeline.js", JAVASCRIPT, include_str!("page/timeline.js")),
    ("views.js", JAVASCRIPT, include_str!("page/views.js")),
];

/// State that requests are answered from.
#[derive(Clone)]
pub struct Service {
    /// Way to the thread that renders.
    pub events: SyncSender<Event>,
    /// Secret that requests need; none on loopback addresses, if none was given.
    pub token: Option<Arc<str>>,
    /// Number of the next client.
    pub next_client: Arc<AtomicU64>,
    /// True if only this machine can connect.
    pub loopback: bool,
}

/// Routes of the server.
pub fn router(service: Service) -> Router {
    Router::new()
        .route("/", get(|| async { file("index.html") }))
        .route(
            "/page/{name}",
            get(|Path(name): Path<String>| async move { file(&name) }),
        )
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

/// Refuses requests from pages of other sites, and those without the token.
async fn guard(State(service): State<Service>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    let host = text(header::HOST).unwrap_or("");
    // A foreign name that resolves to this machine (DNS rebinding) is no name of it.
    if service.loopback && !is_local(host) {
        let reason = "this viewer answers to localhost alone: give --address and --token";
        return (StatusCode::FORBIDDEN, reason).into_response();
    }
    if let Some(origin) = text(header::ORIGIN)
        && origin
            .split_once("://")
            .is_none_or(|(_, site)| site != host)
    {
        return (StatusCode::FORBIDDEN, "pages of other sites are refused").into_response();
    }
    let query = request.uri().query().unwrap_or("");
    let from_query = query
        .split('&')
        .find_map(|pair| pair.strip_prefix("token="));
    let mut cookie = None;
    if let Some(token) = &service.token {
        let fits = |given: &str| bool::from(given.as_bytes().ct_eq(token.as_bytes()));
        if from_query.is_some_and(fits) {
            cookie = Some(format!(
                "decouplegs_token={token}; HttpOnly; SameSite=Strict; Path=/"
            ));
        } else if !token_of_cookie(headers).is_some_and(fits) {
            let reason =
                "the token is missing or wrong: open the address that 'decouplegs view' printed";
            return (StatusCode::UNAUTHORIZED, reason).into_response();
        }
    }
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

fn token_of_cookie(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get(header::COOKIE)?.to_str().ok()?;
    let mut cookies = cookies.split(';').map(str::trim);
    cookies.find_map(|cookie| cookie.strip_prefix("decouplegs_token="))
}

/// True if `host`, with or without a port, is this machine.
fn is_local(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    matches!(name, "localhost" | "127.0.0.1" | "[::1]")
}

async fn socket(State(service): State<Service>, upgrade: WebSocketUpgrade) -> Response {
    upgrade
        .max_message_size(COMMAND_BYTES_MAX)
        .max_frame_size(COMMAND_BYTES_MAX)
        .on_upgrade(move |socket| serve(socket, service))
}

async fn serve(mut socket: WebSocket, service: Service) {
    let id = service.next_client.fetch_add(1, Ordering::Relaxed);
    let (outbox, mut messages) = mpsc::channel(OUTBOX);
    if !post(&service, Event::Joined(id, outbox)).await {
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
                    Ok(request) => if !post(&service, Event::Command(id, request)).await {
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
    post(&service, Event::Left(id)).await;
}

/// Sends `event` to the thread that renders, and waits while that has too many already. False if it
/// is gone.
async fn post(service: &Service, event: Event) -> bool {
    let mut event = event;
    loop {
        match service.events.try_send(event) {
            Ok(()) => return true,
            Err(TrySendError::Disconnected(_)) => return false,
            Err(TrySendError::Full(unsent)) => event = unsent,
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
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
}
