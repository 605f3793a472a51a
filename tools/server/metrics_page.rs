//! The page that Prometheus reads: as much of HTTP as that takes.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::{sleep, timeout};

use crate::metrics::Metrics;

/// Readers at a time; further ones wait.
const READERS_MAX: usize = 64;
/// A reader that takes longer is hung up on.
const PATIENCE: Duration = Duration::from_secs(2);
/// A request's head is not longer, bytes.
const HEAD_MAX: usize = 8192;

/// Answers readers until it is dropped.
pub async fn serve(listener: TcpListener, metrics: Arc<Metrics>) {
    let readers = Arc::new(Semaphore::new(READERS_MAX));
    loop {
        let Ok(permit) = Arc::clone(&readers).acquire_owned().await else {
            return;
        };
        let Ok((stream, _)) = listener.accept().await else {
            // No file descriptors left, most likely: there will be some again.
            sleep(Duration::from_millis(100)).await;
            continue;
        };
        let metrics = Arc::clone(&metrics);
        tokio::spawn(async move {
            // A reader that has gone, or is too slow, has missed something.
            let _ = timeout(PATIENCE, answer(stream, &metrics)).await;
            drop(permit);
        });
    }
}

async fn answer(mut stream: TcpStream, metrics: &Metrics) -> std::io::Result<()> {
    let mut head = Vec::new();
    while !head.windows(4).any(|end| end == b"\r\n\r\n") {
        let mut part = [0; 1024];
        let length = stream.read(&mut part).await?;
        if length == 0 || head.len() + length > HEAD_MAX {
            return Ok(());
        }
        head.extend_from_slice(&part[..length]);
    }
    let (status, body) = match head.split(|byte| *byte == b'\r').next() {
        Some(line) if line.starts_with(b"GET /metrics ") => ("200 OK", metrics.text()),
        _ => ("404 Not Found", "metrics are at /metrics\n".to_owned()),
    };
    let length = body.len();
    let head = format!(
        "HTTP/1.1 {status}\r\ncontent-type: text/plain; version=0.0.4\r\ncontent-length: {length}\r\nconnection: close\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body.as_bytes()).await?;
    stream.shutdown().await
}
