//! Accepted TCP connections within limits: how many there may be, of all and of each address, how
//! soon a client has to say something, and how long one may have no request.
//!
//! A request that has not arrived whole is none yet: a client that sends half of a head is idle.
#![forbid(unsafe_code)]

use std::collections::HashMap;
use std::future::Future;
use std::io::{Error, ErrorKind, Result};
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::time::{Instant, Sleep, sleep, sleep_until};

/// Bytes that a client says before anything else: the preface of HTTP/2, or more of a TLS
/// handshake.
const PREFACE_BYTES: usize = 24;
/// Idle time after which a spare connection is closed.
const SPARE_IDLE: Duration = Duration::from_secs(5);
/// Time until the next attempt where no connection can be accepted: there are no free file
/// descriptors, or no memory.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Limits of connections; further ones are closed at once.
#[derive(Clone, Debug)]
pub struct ConnectionLimits {
    /// Concurrent connections.
    pub connections: usize,
    /// Concurrent connections from one address.
    pub address_connections: u32,
    /// Connections beyond [`Self::connections`] that are accepted as spare ones.
    pub spare: usize,
    /// Time for the first bytes of a connection.
    pub handshake: Duration,
    /// Time without a request after which a connection is closed, also before the first.
    pub idle: Duration,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        Self {
            connections: 256,
            address_connections: 128,
            spare: 0,
            handshake: Duration::from_secs(10),
            idle: Duration::from_secs(60),
        }
    }
}

/// Counts of connections, told as they change.
pub trait ConnectionCounts: Send + Sync + 'static {
    /// `more` connections are open: 1 or -1.
    fn opened(&self, more: i64);
    /// A connection was closed because there were too many.
    fn refused(&self);
}

/// Counts nothing.
impl ConnectionCounts for () {
    fn opened(&self, _more: i64) {}
    fn refused(&self) {}
}

/// The state of an open connection that its requests see.
#[derive(Clone)]
pub struct ConnectionInfo {
    /// True if the connection is beyond the limit: it should serve health checks alone.
    pub is_spare: bool,
    /// Number of the connection, which no other one of its listener has; from 1 on.
    pub number: u64,
    /// The place of one request, which the connection shares with no other one.
    own_place: Arc<Semaphore>,
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

    /// The connection's own place for a request; none while another request has it. A server that
    /// has places for requests beside these ones never has to refuse a client that asks for one
    /// thing at a time, whatever others do.
    #[must_use]
    pub fn own_place(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.own_place).try_acquire_owned().ok()
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
    peer: SocketAddr,
    /// Runs until the client has said as much as every client does.
    patience: Option<Pin<Box<Sleep>>>,
    heard_bytes: usize,
    info: ConnectionInfo,
    idle: Duration,
    /// Runs until the connection may have been idle for `idle`.
    idle_timer: Pin<Box<Sleep>>,
    /// Ends when all connections are to be closed.
    closing: Pin<Box<dyn Future<Output = ()> + Send>>,
    counts: Arc<dyn ConnectionCounts>,
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

/// Accepts connections within limits.
pub struct Acceptor {
    listener: TcpListener,
    limits: ConnectionLimits,
    closing: watch::Receiver<bool>,
    counts: Arc<dyn ConnectionCounts>,
    places: Arc<Semaphore>,
    spare_places: Arc<Semaphore>,
    addresses: Addresses,
    /// Connections that were ever admitted.
    admitted: AtomicU64,
}

impl Acceptor {
    /// Accepts from `listener`. A connection is closed when the client says nothing after it was
    /// opened, when it has had no request for a while, and when `closing` turns true.
    #[must_use]
    pub fn new(
        listener: TcpListener,
        limits: ConnectionLimits,
        closing: watch::Receiver<bool>,
        counts: Arc<dyn ConnectionCounts>,
    ) -> Self {
        Self {
            places: Arc::new(Semaphore::new(limits.connections)),
            spare_places: Arc::new(Semaphore::new(limits.spare)),
            addresses: Addresses::default(),
            admitted: AtomicU64::new(0),
            listener,
            limits,
            closing,
            counts,
        }
    }

    /// The address that is listened on.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn local_addr(&self) -> Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// The next connection that the limits allow. Where the system has none to give, for want of
    /// file descriptors, this waits until it has: a listener does not end by the number of its
    /// clients.
    pub async fn accept(&self) -> Connection {
        loop {
            match self.listener.accept().await {
                Ok((stream, address)) => match self.admit(stream, address) {
                    Some(connection) => return connection,
                    None => self.counts.refused(),
                },
                // The client went before it was accepted.
                Err(error)
                    if matches!(
                        error.kind(),
                        ErrorKind::ConnectionAborted
                            | ErrorKind::ConnectionReset
                            | ErrorKind::ConnectionRefused
                            | ErrorKind::Interrupted
                    ) => {}
                Err(_) => sleep(ACCEPT_PAUSE).await,
            }
        }
    }

    fn admit(&self, stream: TcpStream, peer: SocketAddr) -> Option<Connection> {
        let limits = &self.limits;
        let address_place =
            AddressPlace::take(&self.addresses, peer.ip(), limits.address_connections)?;
        let place = Arc::clone(&self.places).try_acquire_owned();
        let is_spare = place.is_err();
        let place = place
            .or_else(|_| Arc::clone(&self.spare_places).try_acquire_owned())
            .ok()?;
        // Answers are written whole: waiting for more to send only delays them. Refused where the
        // client has gone already.
        let _ = stream.set_nodelay(true);
        self.counts.opened(1);
        let idle = if is_spare { SPARE_IDLE } else { limits.idle };
        let activity = Arc::new(Activity {
            open: AtomicUsize::new(0),
            last: Mutex::new(Instant::now()),
        });
        let mut closing = self.closing.clone();
        Some(Connection {
            stream,
            peer,
            patience: Some(Box::pin(sleep(limits.handshake))),
            heard_bytes: 0,
            info: ConnectionInfo {
                is_spare,
                number: 1 + self.admitted.fetch_add(1, Ordering::Relaxed),
                own_place: Arc::new(Semaphore::new(1)),
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
            counts: Arc::clone(&self.counts),
            _place: place,
            _address_place: address_place,
        })
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.counts.opened(-1);
    }
}

impl Connection {
    /// Address of the client.
    #[must_use]
    pub fn peer(&self) -> SocketAddr {
        self.peer
    }

    /// The state of the connection that its requests see.
    #[must_use]
    pub fn info(&self) -> ConnectionInfo {
        self.info.clone()
    }

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

    /// An error where answers are not read: a client that only sends is never read from again
    /// either.
    fn check_time(&mut self, context: &mut Context<'_>) -> Result<()> {
        match self.poll_idle(context) {
            Poll::Ready(()) => Err(Error::new(
                ErrorKind::TimedOut,
                "the client does not read its answers",
            )),
            Poll::Pending => Ok(()),
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
        self.check_time(context)?;
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
        self.check_time(context)?;
        Pin::new(&mut self.stream).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;

    const IDLE: Duration = Duration::from_millis(400);

    async fn acceptor(limits: ConnectionLimits) -> (Acceptor, SocketAddr) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (_, closing) = watch::channel(false);
        let acceptor = Acceptor::new(listener, limits, closing, Arc::new(()));
        (acceptor, address)
    }

    /// Reads until the other side ends, and says how much there was.
    async fn heard(connection: &mut Connection) -> Result<usize> {
        let mut bytes = Vec::new();
        connection.read_to_end(&mut bytes).await
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn connections_beyond_the_limits_are_closed_at_once() {
        for limits in [
            ConnectionLimits {
                connections: 2,
                ..ConnectionLimits::default()
            },
            ConnectionLimits {
                address_connections: 2,
                ..ConnectionLimits::default()
            },
        ] {
            let (acceptor, address) = acceptor(limits).await;
            let mut clients = Vec::new();
            for _ in 0..3 {
                clients.push(TcpStream::connect(address).await.unwrap());
            }
            let first = acceptor.accept().await;
            let _second = acceptor.accept().await;
            // Accepting goes on only when one has gone, and meets the third before.
            let fourth = tokio::spawn(async move { acceptor.accept().await.peer() });
            let mut third = clients.pop().unwrap();
            assert_eq!(third.read(&mut [0; 1]).await.unwrap_or(0), 0);
            drop(first);
            let late = TcpStream::connect(address).await.unwrap();
            assert_eq!(fourth.await.unwrap(), late.local_addr().unwrap());
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn half_a_request_is_none() {
        let limits = ConnectionLimits {
            idle: IDLE,
            spare: 1,
            connections: 1,
            ..ConnectionLimits::default()
        };
        let (acceptor, address) = acceptor(limits).await;
        let mut client = TcpStream::connect(address).await.unwrap();
        let mut connection = acceptor.accept().await;
        assert!(!connection.info().is_spare);
        let half = b"GET / HTTP/1.1\r\nHost: localhost";
        client.write_all(half).await.unwrap();
        let since = Instant::now();
        assert_eq!(heard(&mut connection).await.unwrap(), half.len());
        assert!(since.elapsed() >= IDLE / 2, "{:?}", since.elapsed());
        // Who does not read its answers is not written to for ever either.
        assert!(connection.write(b"answer").await.is_err());
        drop(connection);

        // A request that is open keeps its connection.
        let client = TcpStream::connect(address).await.unwrap();
        let mut connection = acceptor.accept().await;
        let open = connection.info().begin();
        let since = Instant::now();
        let later = tokio::spawn(async move {
            sleep(3 * IDLE).await;
            drop(open);
            client
        });
        assert_eq!(heard(&mut connection).await.unwrap(), 0);
        assert!(since.elapsed() >= 3 * IDLE, "{:?}", since.elapsed());
        drop(later.await);
        // Beyond the limit there is one more, for health checks.
        let _client = TcpStream::connect(address).await.unwrap();
        assert!(acceptor.accept().await.info().is_spare);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_listener_outlasts_a_lack_of_file_descriptors() {
        use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

        let (acceptor, address) = acceptor(ConnectionLimits::default()).await;
        let client = TcpStream::connect(address).await.unwrap();
        let before = getrlimit(Resource::Nofile);
        let few = Rlimit {
            current: Some(64),
            ..before
        };
        setrlimit(Resource::Nofile, few).unwrap();
        let taken: Vec<std::fs::File> =
            std::iter::from_fn(|| std::fs::File::open("/dev/null").ok()).collect();
        let accepting = tokio::spawn(async move { acceptor.accept().await.peer() });
        sleep(3 * ACCEPT_PAUSE).await;
        assert!(!accepting.is_finished() && !taken.is_empty());
        drop(taken);
        let accepted = accepting.await.unwrap();
        setrlimit(Resource::Nofile, before).unwrap();
        assert_eq!(accepted, client.local_addr().unwrap());
    }
}
