//! Connections: how many there may be, and how long one may be idle.

use std::collections::HashMap;
use std::future::Future;
use std::io::{Error, ErrorKind, Result};
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::time::{Instant, Sleep, sleep, sleep_until};
use tokio_stream::wrappers::TcpListenerStream;
use tokio_stream::{Stream, StreamExt};
use tonic::transport::server::Connected;

use crate::metrics::Metrics;
use crate::options::Limits;

/// Bytes that a client says before anything else: the preface of HTTP/2, or more of a TLS
/// handshake.
const PREFACE_BYTES: usize = 24;
/// Connections beyond the limit that are kept for health checks.
const HEALTH_CONNECTIONS: usize = 8;
/// Idle time after which a connection for health checks is closed.
const HEALTH_IDLE: Duration = Duration::from_secs(5);

/// The state of an open connection that its requests see.
#[derive(Clone)]
pub struct ConnectionInfo {
    /// True if there are so many connections that this one serves health checks alone.
    pub is_for_health: bool,
    activity: Arc<Activity>,
}

/// Requests of one connection.
struct Activity {
    open: AtomicUsize,
    last: Mutex<Instant>,
}

/// A request that is being answered. Its connection is not idle while this lives.
pub struct OpenRequest(Arc<Activity>);

impl ConnectionInfo {
    /// Counts a request of this connection.
    pub fn begin(&self) -> OpenRequest {
        self.activity.open.fetch_add(1, Ordering::SeqCst);
        OpenRequest(Arc::clone(&self.activity))
    }
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        *lock(&self.0.last) = Instant::now();
        self.0.open.fetch_sub(1, Ordering::SeqCst);
    }
}

/// An accepted connection, counted until it is dropped.
pub struct Connection {
    stream: TcpStream,
    /// Runs until the client has said as much as every client does.
    patience: Option<Pin<Box<Sleep>>>,
    heard_bytes: usize,
    info: ConnectionInfo,
    idle: Duration,
    /// Runs until the connection may have been idle for `idle`.
    idle_timer: Pin<Box<Sleep>>,
    /// Ends when all connections are to be closed.
    closing: Pin<Box<dyn Future<Output = ()> + Send>>,
    metrics: Arc<Metrics>,
    _place: OwnedSemaphorePermit,
    _address_place: AddressPlace,
}

/// Open connections per address.
type Addresses = Arc<Mutex<HashMap<IpAddr, u32>>>;

/// One of the connections that an address may have.
struct AddressPlace {
    address: IpAddr,
    addresses: Addresses,
}

impl AddressPlace {
    fn take(addresses: &Addresses, address: IpAddr, most: u32) -> Option<Self> {
        let mut counts = lock(addresses);
        let count = counts.entry(address).or_default();
        (*count < most).then(|| {
            *count += 1;
            Self {
                address,
                addresses: Arc::clone(addresses),
            }
        })
    }
}

impl Drop for AddressPlace {
    fn drop(&mut self) {
        let mut counts = lock(&self.addresses);
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

/// Accepts connections from `listener` within `limits`; further ones are closed, but for a few that
/// serve health checks alone. A connection is closed when the client says nothing after it was
/// opened, when it has had no request for a while, and when `closing` turns true.
pub fn accept(
    listener: TcpListener,
    limits: &Limits,
    closing: &watch::Receiver<bool>,
    metrics: Arc<Metrics>,
) -> impl Stream<Item = Result<Connection>> + use<> {
    let places = Arc::new(Semaphore::new(limits.connections as usize));
    let health_places = Arc::new(Semaphore::new(HEALTH_CONNECTIONS));
    let addresses = Addresses::default();
    let (limits, closing) = (limits.clone(), closing.clone());
    TcpListenerStream::new(listener).filter_map(move |accepted| {
        let stream = match accepted {
            Ok(stream) => stream,
            Err(error) => return Some(Err(error)),
        };
        let address = stream.peer_addr().map(|address| address.ip()).ok();
        let address_place = address.and_then(|address| {
            AddressPlace::take(&addresses, address, limits.address_connections)
        });
        let place = Arc::clone(&places).try_acquire_owned();
        let is_for_health = place.is_err();
        let place = place.or_else(|_| Arc::clone(&health_places).try_acquire_owned());
        let (Ok(_place), Some(_address_place)) = (place, address_place) else {
            metrics.refused();
            return None;
        };
        // Images are written whole: waiting for more to send only delays them. Refused where the
        // client has gone already.
        let _ = stream.set_nodelay(true);
        metrics.connected(1);
        let idle = if is_for_health {
            HEALTH_IDLE
        } else {
            limits.idle()
        };
        let activity = Arc::new(Activity {
            open: AtomicUsize::new(0),
            last: Mutex::new(Instant::now()),
        });
        let mut closing = closing.clone();
        Some(Ok(Connection {
            stream,
            patience: Some(Box::pin(sleep(limits.handshake()))),
            heard_bytes: 0,
            info: ConnectionInfo {
                is_for_health,
                activity,
            },
            idle,
            idle_timer: Box::pin(sleep(idle)),
            closing: Box::pin(async move {
                // A sender that is gone has nothing more to say.
                if closing.wait_for(|closing| *closing).await.is_err() {
                    std::future::pending::<()>().await;
                }
            }),
            metrics: Arc::clone(&metrics),
            _place,
            _address_place,
        }))
    })
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.metrics.connected(-1);
    }
}

impl Connected for Connection {
    type ConnectInfo = ConnectionInfo;

    fn connect_info(&self) -> ConnectionInfo {
        self.info.clone()
    }
}

impl Connection {
    /// Ready when there has been no request for as long as a connection may be idle.
    fn poll_idle(&mut self, context: &mut Context<'_>) -> Poll<()> {
        loop {
            ready!(self.idle_timer.as_mut().poll(context));
            let is_busy = self.info.activity.open.load(Ordering::SeqCst) > 0;
            let since = if is_busy {
                Instant::now()
            } else {
                *lock(&self.info.activity.last)
            };
            if since.elapsed() >= self.idle {
                return Poll::Ready(());
            }
            self.idle_timer = Box::pin(sleep_until(since + self.idle));
        }
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<Result<()>> {
        if let Some(patience) = &mut self.patience
            && patience.as_mut().poll(context).is_ready()
        {
            return Poll::Ready(Err(Error::new(
                ErrorKind::TimedOut,
                "the client opened a connection and said nothing",
            )));
        }
        if self.closing.as_mut().poll(context).is_ready() {
            return Poll::Ready(Err(Error::new(
                ErrorKind::ConnectionAborted,
                "the server ends",
            )));
        }
        if self.poll_idle(context).is_ready() {
            // As if the client had closed it: nothing is read.
            return Poll::Ready(Ok(()));
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

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<Result<usize>> {
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
