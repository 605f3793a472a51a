//! The server, from start to end.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use decouplegs::asset::read_bytes;
use decouplegs::gpu::{DeviceOptions, Gpu};
use glam::DVec3;
use tokio::net::TcpListener;
use tokio::sync::{oneshot, watch};
use tokio::time::timeout;
use tonic::transport::{Identity, Server, ServerTlsConfig};
use tonic_health::ServingStatus;
use tonic_health::server::{HealthReporter, health_reporter};

use crate::ego_masks::EgoMasks;
use crate::metrics::Metrics;
use crate::names::{LIDAR, PHYSICS, PHYSICS_ALSO, SENSORSIM, SENSORSIM_ALSO};
use crate::options::ServerOptions;
use crate::physics::Physics;
use crate::read_ahead::ReadAhead;
use crate::render_queue::RenderQueue;
use crate::request_guard::GateLayer;
use crate::scene_registry::SceneRegistry;
use crate::sensorsim::Sensorsim;
use crate::{incoming, metrics_page};
use decouplegs_alpasim::encoding::Encoders;
use decouplegs_alpasim::wire::lidar::lidar_server::LidarServer;
use decouplegs_alpasim::wire::physics::physics_service_server::PhysicsServiceServer;
use decouplegs_alpasim::wire::sensorsim::sensorsim_service_server::SensorsimServiceServer;

/// Streams that one connection may have open at a time.
const STREAMS_MAX: u32 = 128;
/// Bytes that a client may send ahead of what is read, of a stream and of a connection.
const WINDOW_BYTES: u32 = 1 << 20;
/// Interval at which a connection is asked whether it is still there.
const KEEPALIVE: Duration = Duration::from_secs(30);
/// Time without an answer after which it is closed.
const KEEPALIVE_PATIENCE: Duration = Duration::from_secs(20);
/// Time for the frame that is being drawn when the server ends.
const FRAME_PATIENCE: Duration = Duration::from_secs(60);
/// A token shorter than this can be guessed.
const TOKEN_BYTES_MIN: usize = 8;

/// A server that answers.
pub struct Running {
    /// Address of the server.
    pub address: SocketAddr,
    /// Address of its metrics.
    pub metrics_address: Option<SocketAddr>,
    stop: Option<oneshot::Sender<()>>,
    done: tokio::task::JoinHandle<Result<()>>,
    metrics: Arc<Metrics>,
}

impl Running {
    /// Lets what has begun finish, takes nothing new, and waits for the end.
    ///
    /// # Errors
    /// Returns an error if it had failed.
    pub async fn stop(mut self) -> Result<()> {
        if let Some(stop) = self.stop.take() {
            // It may have ended already.
            let _ = stop.send(());
        }
        self.done.await.context("the server panicked")?
    }

    /// Images that each device drew so far.
    #[must_use]
    pub fn images_by_device(&self) -> Vec<u64> {
        self.metrics.images()
    }

    /// Frames submitted to the device so far: one draws all cameras of a batch.
    #[must_use]
    pub fn submissions(&self) -> u64 {
        self.metrics.submissions()
    }

    /// Runs until `end`, and then as [`Running::stop`]. Ends by itself only when it fails.
    ///
    /// # Errors
    /// Returns an error if it failed, or its device was lost.
    pub async fn until(mut self, end: impl Future<Output = ()>) -> Result<()> {
        tokio::select! {
            () = end => self.stop().await,
            done = &mut self.done => done.context("the server panicked")?,
        }
    }
}

/// Starts a server: it answers when this returns.
///
/// # Errors
/// Returns an error if there are no scenes, no device, a file cannot be read, or the address is
/// taken.
pub async fn start(options: &ServerOptions) -> Result<Running> {
    let rig_origin = options.rig_origin.map(DVec3::from_array);
    let registry = Arc::new(SceneRegistry::new(
        &options.scenes,
        &options.artifact_glob,
        rig_origin,
    )?);
    let token = options.token_file.as_deref().map(token_of).transpose()?;
    let tls = tls_of(options)?;
    warn_of_openness(options);
    let ignored = options.of_nurec.given();
    if !ignored.is_empty() {
        tracing::warn!(
            "without effect, as they are for the NuRec renderer or AlpaSim's physics: {}",
            ignored.join(", ")
        );
    }
    let listener = listen(SocketAddr::new(options.host, options.port)).await?;
    let page = match options.metrics_port {
        Some(port) => Some(listen(SocketAddr::new(options.host, port)).await?),
        None => None,
    };
    let ahead = ReadAhead::begin(&registry);
    let gpus = opened(options)?;
    let scenes = registry.ids().len();
    for gpu in &gpus {
        tracing::info!(device = %gpu.info(), scenes, "ready");
    }
    let (limits, metrics) = (
        Arc::new(options.limits.clone()),
        Arc::new(Metrics::default()),
    );
    let (render_queue, painting) = RenderQueue::start(
        &gpus,
        options.render(),
        Arc::clone(&registry),
        ahead,
        &limits,
        Arc::clone(&metrics),
    )?;
    if options.preload {
        render_queue.preload(
            registry
                .ids()
                .into_iter()
                .take(limits.cache_size as usize * gpus.len()),
        );
    }
    let address = listener.local_addr()?;
    let metrics_address = page.as_ref().map(TcpListener::local_addr).transpose()?;
    let page = page.map(|page| tokio::spawn(metrics_page::serve(page, Arc::clone(&metrics))));
    let (stop, stopped) = oneshot::channel();
    let services = Services {
        sensorsim: Sensorsim {
            registry: Arc::clone(&registry),
            render_queue: render_queue.clone(),
            encoders: Encoders::new(limits.encoders)?,
            limits: Arc::clone(&limits),
            metrics: Arc::clone(&metrics),
            ego_masks: ego_masks(options),
        },
        physics: Physics::new(registry, limits),
        guard: GateLayer::new(&options.limits, token, Arc::clone(&metrics)),
        tls,
    };
    let counted = Arc::clone(&metrics);
    let done = tokio::spawn(async move {
        let served = services.serve(listener, counted, stopped).await;
        render_queue.stop();
        if let Some(page) = page {
            page.abort();
        }
        let painted = tokio::task::spawn_blocking(move || painting.join());
        let painted = timeout(FRAME_PATIENCE, painted)
            .await
            .context("the last frame does not end: it is given up")??;
        painted.and(served)
    });
    Ok(Running {
        address,
        metrics_address,
        stop: Some(stop),
        done,
        metrics,
    })
}

/// The devices that are asked for: several, or one.
fn opened(options: &ServerOptions) -> Result<Vec<Gpu>> {
    if let Some(gpus) = options.devices.open()? {
        return Ok(gpus);
    }
    let gpu = Gpu::open(&DeviceOptions {
        choice: options.device.clone(),
        ..DeviceOptions::default()
    })?;
    Ok(vec![gpu])
}

struct Services {
    sensorsim: Sensorsim,
    physics: Physics,
    guard: GateLayer,
    tls: Option<ServerTlsConfig>,
}

impl Services {
    async fn serve(
        self,
        listener: TcpListener,
        metrics: Arc<Metrics>,
        stopped: oneshot::Receiver<()>,
    ) -> Result<()> {
        let limits = Arc::clone(&self.sensorsim.limits);
        let render_queue = self.sensorsim.render_queue.clone();
        let mut lost = render_queue.lost();
        let (reporter, health) = health_reporter();
        report(&reporter, ServingStatus::Serving).await;
        let mut server = Server::builder()
            .layer(self.guard)
            .max_concurrent_streams(STREAMS_MAX)
            .initial_stream_window_size(WINDOW_BYTES)
            .initial_connection_window_size(WINDOW_BYTES)
            .http2_keepalive_interval(Some(KEEPALIVE))
            .http2_keepalive_timeout(Some(KEEPALIVE_PATIENCE));
        if let Some(tls) = self.tls {
            server = server
                .tls_config(tls.timeout(limits.handshake()))
                .context("the certificate or its key cannot be used")?;
        }
        let lidar = LidarServer::new(self.sensorsim.clone())
            .max_decoding_message_size(limits.request_bytes)
            .max_encoding_message_size(limits.message_bytes);
        let sensorsim = SensorsimServiceServer::new(self.sensorsim)
            .max_decoding_message_size(limits.request_bytes)
            .max_encoding_message_size(limits.message_bytes);
        let physics = PhysicsServiceServer::new(self.physics)
            .max_decoding_message_size(limits.request_bytes)
            .max_encoding_message_size(limits.message_bytes);
        let router = server
            .add_service(sensorsim)
            .add_service(lidar)
            .add_service(physics)
            .add_service(health);
        let (close, closing) = watch::channel(false);
        let connections = incoming::accept(listener, &limits, closing, metrics);
        let (end, ending) = oneshot::channel();
        let ended = async {
            // The sender is gone: that too is an end.
            let _ = ending.await;
        };
        let mut serving = tokio::spawn(router.serve_with_incoming_shutdown(connections, ended));
        let is_lost = tokio::select! {
            _ = stopped => false,
            _ = lost.wait_for(|lost| *lost) => true,
            served = &mut serving => return Ok(served.context("the server panicked")??),
        };
        report(&reporter, ServingStatus::NotServing).await;
        // It listens for as long as it serves.
        let _ = end.send(());
        match timeout(limits.grace(), &mut serving).await {
            Ok(served) => served.context("the server panicked")??,
            Err(_) => {
                render_queue.refuse_waiting();
                serving.abort();
                close.send_replace(true);
                tracing::warn!(
                    seconds = limits.grace,
                    "requests that had begun are cut off"
                );
            }
        }
        ensure!(
            !is_lost,
            "nothing can be drawn any more (the log says why): start the server again"
        );
        Ok(())
    }
}

async fn report(reporter: &HealthReporter, status: ServingStatus) {
    for name in ["", SENSORSIM, LIDAR, PHYSICS]
        .into_iter()
        .chain(SENSORSIM_ALSO)
        .chain(PHYSICS_ALSO)
    {
        reporter.set_service_status(name, status).await;
    }
}

async fn listen(address: SocketAddr) -> Result<TcpListener> {
    TcpListener::bind(address)
        .await
        .with_context(|| format!("cannot listen on {address}: choose another --host or --port"))
}

/// Warns of what a network can read or reach. The loopback is no network.
fn warn_of_openness(options: &ServerOptions) {
    if options.host.is_loopback() {
        return;
    }
    let (has_token, has_tls) = (options.token_file.is_some(), options.tls_cert.is_some());
    if has_token && !has_tls {
        tracing::warn!("the token travels in the clear: use --tls-cert and --tls-key");
    }
    if !has_token {
        tracing::warn!(host = %options.host, "every machine that reaches this address may use the server: use --token-file");
    }
    if options.metrics_port.is_some() {
        tracing::warn!(host = %options.host, "the metrics page asks for no token, and is not encrypted");
    }
}

/// The token in `path`, without the end of its line.
fn token_of(path: &Path) -> Result<String> {
    let text = String::from_utf8(read_bytes(path)?)
        .with_context(|| format!("{} is not UTF-8", path.display()))?;
    let token = text.trim_end_matches(['\r', '\n']);
    let is_sendable =
        token.len() >= TOKEN_BYTES_MIN && token.bytes().all(|byte| byte.is_ascii_graphic());
    ensure!(
        is_sendable,
        "{}: expected one line of at least {TOKEN_BYTES_MIN} visible ASCII characters",
        path.display()
    );
    Ok(token.to_owned())
}

fn tls_of(options: &ServerOptions) -> Result<Option<ServerTlsConfig>> {
    let (Some(certificate), Some(key)) = (&options.tls_cert, &options.tls_key) else {
        return Ok(None);
    };
    let read = |path: &Path| read_bytes(path);
    Ok(Some(ServerTlsConfig::new().identity(Identity::from_pem(
        read(certificate)?,
        read(key)?,
    ))))
}
/// Masks of the folder that was named, if one was.
fn ego_masks(options: &ServerOptions) -> EgoMasks {
    let Some(folder) = &options.egocar_hood_dir else {
        return EgoMasks::default();
    };
    let masks = EgoMasks::in_folder(folder);
    if masks.count() == 0 {
        let folder = folder.display();
        tracing::warn!(%folder, "has no ego masks (RIG/CAMERA.png): images show the scene alone");
    }
    masks
}
