//! Checks of every request: the name of its service, its token, the number of concurrent requests,
//! and its deadline.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use bytes::Bytes;
use decouplegs_connections::{ConnectionInfo, OpenRequest};
use http::uri::PathAndQuery;
use http::{Request, Response, Uri};
use http_body::{Body as HttpBody, Frame, SizeHint};
use subtle::ConstantTimeEq;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Sleep, sleep_until, timeout, timeout_at};
use tonic::body::Body;
use tonic::transport::server::TlsConnectInfo;
use tonic::{Code, Status};
use tower::{Layer, Service};

use crate::metrics::Metrics;
use crate::names::{Destination, destination_of};
use crate::options::Limits;

/// Longest time that a request waits for one of the places that all connections share.
const PLACE_WAIT: Duration = Duration::from_secs(1);

tokio::task_local! {
    /// Number of the connection that the request of a task came by.
    static CONNECTION: u64;
}

/// Number of the connection that the request of this task came by; 0 if it came by none.
pub fn connection_number() -> u64 {
    CONNECTION.try_with(|number| *number).unwrap_or_default()
}

/// Puts a [`RequestGuard`] in front of services.
#[derive(Clone)]
pub struct GateLayer {
    rules: Arc<GuardLimits>,
}

struct GuardLimits {
    metrics: Arc<Metrics>,
    token: Option<String>,
    deadline: Duration,
    places: Arc<Semaphore>,
    requests_max: u32,
}

impl GateLayer {
    /// Admits requests within `limits`, and with `token` if there is one.
    pub fn new(limits: &Limits, token: Option<String>, metrics: Arc<Metrics>) -> Self {
        let places = Arc::new(Semaphore::new(limits.requests as usize));
        let deadline = limits.deadline();
        Self {
            rules: Arc::new(GuardLimits {
                metrics,
                token,
                deadline,
                places,
                requests_max: limits.requests,
            }),
        }
    }
}

impl<S> Layer<S> for GateLayer {
    type Service = RequestGuard<S>;

    fn layer(&self, service: S) -> RequestGuard<S> {
        RequestGuard {
            service,
            rules: Arc::clone(&self.rules),
        }
    }
}

/// A service behind the guard.
#[derive(Clone)]
pub struct RequestGuard<S> {
    service: S,
    rules: Arc<GuardLimits>,
}

type Answer<E> = Pin<Box<dyn Future<Output = Result<Response<Body>, E>> + Send>>;

impl<S> Service<Request<Body>> for RequestGuard<S>
where
    S: Service<Request<Body>, Response = Response<Body>> + Clone + Send + 'static,
    S::Future: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = Answer<S::Error>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.service.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        let destination = destination_of(request.uri().path());
        let count = Count::new(&self.rules.metrics, destination.counted_as);
        let info = connection_of(&request);
        let open = info.as_ref().map(ConnectionInfo::begin);
        let is_spare = info.as_ref().is_some_and(|info| info.is_spare);
        let admitted = self.rules.check(&request, &destination, is_spare);
        let rules = Arc::clone(&self.rules);
        let number = info.as_ref().map_or(0, |info| info.number);
        if let Some(path) = destination
            .path
            .and_then(|path| PathAndQuery::try_from(path).ok())
        {
            let mut parts = std::mem::take(request.uri_mut()).into_parts();
            parts.path_and_query = Some(path);
            *request.uri_mut() = Uri::from_parts(parts).unwrap_or_default();
        }
        // The one that is ready is the one that is called.
        let clone = self.service.clone();
        let mut service = std::mem::replace(&mut self.service, clone);
        let deadline = tokio::time::Instant::now() + self.rules.deadline;
        Box::pin(async move {
            let place = match admitted {
                // A health check needs none.
                Ok(()) if destination.is_health => Ok(None),
                Ok(()) => rules.place(info.as_ref()).await.map(Some),
                Err(status) => Err(status),
            };
            let place = match place {
                Ok(place) => place,
                Err(status) => return Ok(count.refused(status)),
            };
            let served = CONNECTION.scope(number, service.call(request));
            match timeout_at(deadline, served).await {
                Ok(Ok(response)) => {
                    count.done(code_of(&response));
                    // Watching for health has no end, and keeps no connection open.
                    let open = open.filter(|_| !destination.is_health);
                    let held = |body| Held {
                        body,
                        until: Box::pin(sleep_until(deadline)),
                        place,
                        _open: open,
                    };
                    Ok(response.map(|body| Body::new(held(body))))
                }
                Ok(Err(error)) => Err(error),
                Err(_) => Ok(count.refused(Status::deadline_exceeded(
                    "the request took longer than the server allows",
                ))),
            }
        })
    }
}

impl GuardLimits {
    /// Checks who asks: health checks need no token, and spare connections serve nothing else.
    fn check(
        &self,
        request: &Request<Body>,
        destination: &Destination,
        is_for_health: bool,
    ) -> Result<(), Status> {
        if destination.is_health {
            return Ok(());
        }
        if is_for_health {
            return Err(Status::resource_exhausted(
                "there are too many connections: this one serves health checks alone",
            ));
        }
        if let Some(token) = &self.token {
            let sent = request
                .headers()
                .get(http::header::AUTHORIZATION)
                .map(http::HeaderValue::as_bytes)
                .unwrap_or_default();
            let sent = sent.strip_prefix(b"Bearer ").unwrap_or_default();
            if !bool::from(sent.ct_eq(token.as_bytes())) {
                return Err(Status::unauthenticated(
                    "the metadata needs authorization: Bearer TOKEN, with this server's token",
                ));
            }
        }
        Ok(())
    }

    /// A place for a request of the connection: its own, or one that all share, for which the
    /// request waits a moment. So clients that send many at once take no place of one that does
    /// not, and each refusal costs them a second.
    async fn place(&self, info: Option<&ConnectionInfo>) -> Result<OwnedSemaphorePermit, Status> {
        if let Some(own) = info.and_then(ConnectionInfo::own_place) {
            return Ok(own);
        }
        let shared = Arc::clone(&self.places).acquire_owned();
        match timeout(PLACE_WAIT, shared).await {
            Ok(Ok(place)) => Ok(place),
            _ => Err(Status::resource_exhausted(format!(
                "{} requests are being answered: ask again",
                self.requests_max
            ))),
        }
    }
}

/// The status that `response` ends with. One that is not in its head comes behind a body, and
/// bodies are sent for success alone.
fn code_of(response: &Response<Body>) -> Code {
    response
        .headers()
        .get("grpc-status")
        .map_or(Code::Ok, |code| Code::from_bytes(code.as_bytes()))
}

/// Counts one request, whatever becomes of it.
struct Count {
    metrics: Arc<Metrics>,
    method: &'static str,
    since: Instant,
    is_counted: bool,
}

impl Count {
    fn new(metrics: &Arc<Metrics>, method: &'static str) -> Self {
        Self {
            metrics: Arc::clone(metrics),
            method,
            since: Instant::now(),
            is_counted: false,
        }
    }

    fn done(mut self, code: Code) {
        self.is_counted = true;
        self.metrics
            .answered(self.method, code, self.since.elapsed());
    }

    fn refused(self, status: Status) -> Response<Body> {
        tracing::debug!(method = self.method, code = ?status.code(), reason = status.message(), "refused");
        self.done(status.code());
        status.into_http()
    }
}

impl Drop for Count {
    fn drop(&mut self) {
        if !self.is_counted {
            self.metrics
                .answered(self.method, Code::Cancelled, self.since.elapsed());
        }
    }
}

/// A reply that keeps its place among the requests until it is sent, and that is not waited for
/// longer than the request.
struct Held {
    body: Body,
    until: Pin<Box<Sleep>>,
    place: Option<OwnedSemaphorePermit>,
    _open: Option<OpenRequest>,
}

/// The connection that `request` came by.
fn connection_of(request: &Request<Body>) -> Option<ConnectionInfo> {
    let extensions = request.extensions();
    let of_tls = || {
        extensions
            .get::<TlsConnectInfo<ConnectionInfo>>()
            .map(TlsConnectInfo::get_ref)
    };
    extensions.get::<ConnectionInfo>().or_else(of_tls).cloned()
}

impl HttpBody for Held {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        // Watching for health has no end.
        if self.place.is_some() && self.until.as_mut().poll(context).is_ready() {
            return Poll::Ready(Some(Err(Status::deadline_exceeded(
                "the reply was not taken in time",
            ))));
        }
        let frame = ready!(Pin::new(&mut self.body).poll_frame(context));
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
