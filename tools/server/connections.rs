//! Connections: how many there may be, and how long one may say nothing.

use std::io::{Error, ErrorKind, Result};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Sleep, sleep};
use tokio_stream::wrappers::TcpListenerStream;
use tokio_stream::{Stream, StreamExt};
use tonic::transport::server::{Connected, TcpConnectInfo};

use crate::metrics::Metrics;

/// Bytes that a client says before anything else: the preface of HTTP/2, or more of a TLS handshake.
const PREFACE_BYTES: usize = 24;

/// A connection that counts.
pub struct Connection {
    stream: TcpStream,
    /// Runs until the client has said as much as every client does.
    patience: Option<Pin<Box<Sleep>>>,
    heard_bytes: usize,
    metrics: Arc<Metrics>,
    _place: OwnedSemaphorePermit,
}

/// Connections from `listener`, at most `connections_max` at a time: further ones are closed. One that says nothing for
/// `handshake` after it was opened is closed too.
pub fn accept(
    listener: TcpListener,
    connections_max: usize,
    handshake: Duration,
    metrics: Arc<Metrics>,
) -> impl Stream<Item = Result<Connection>> {
    let places = Arc::new(Semaphore::new(connections_max));
    TcpListenerStream::new(listener).filter_map(move |accepted| {
        let stream = match accepted {
            Ok(stream) => stream,
            Err(error) => return Some(Err(error)),
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            metrics.refused();
            return None;
        };
        // Pictures are written whole: waiting for more to send only delays them. Refused where the client has gone already.
        let _ = stream.set_nodelay(true);
        metrics.connected(1);
        let patience = Some(Box::pin(sleep(handshake)));
        Some(Ok(Connection { stream, patience, heard_bytes: 0, metrics: Arc::clone(&metrics), _place: place }))
    })
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.metrics.connected(-1);
    }
}

impl Connected for Connection {
    type ConnectInfo = TcpConnectInfo;

    fn connect_info(&self) -> TcpConnectInfo {
        self.stream.connect_info()
    }
}

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<Result<()>> {
        if let Some(patience) = &mut self.patience
            && patience.as_mut().poll(context).is_ready()
        {
            return Poll::Ready(Err(Error::new(ErrorKind::TimedOut, "the client opened a connection and said nothing")));
        }
        let before = buffer.filled().len();
        ready!(Pin::new(&mut self.stream).poll_read(context, buffer))?;
        if self.patience.is_some() {
            self.heard_bytes += buffer.filled().len() - before;
            if self.heard_bytes >= PREFACE_BYTES {
                self.patience = None;
            }
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[std::io::IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
