//! `decouplegs conform`: asks any sensorsim server what simulators ask, and judges the answers.
//!
//! Every judgment follows from the contract and from other answers of the same server: it needs no
//! reference images and knows nothing of the scene.

mod answers;
mod check;
mod images;
mod motion;
mod report;
mod rgb_image;
mod sweeps;
mod target;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::Args;
use decouplegs_cli::outputs::Force;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint};

pub use check::{Check, Outcome};
pub use report::Report;

use target::Target;

/// Bytes of the largest answer that is taken.
const MESSAGE_BYTES_MAX: usize = 64 << 20;

/// Ask a sensorsim server (AlpaSim, NuRec, decouplegs-server) what simulators ask, and judge its
/// answers
///
/// Each check follows from the contract and from other answers of the same server: it needs no
/// reference image. Checks of calls that the server does not have are skipped, but for those that
/// every simulator needs. Exits with 1 if a check fails.
#[derive(Args, Clone, Debug)]
pub struct ConformOptions {
    /// Server: HOST:PORT, or https://HOST:PORT for TLS, with --ca-cert
    #[arg(long, value_name = "HOST:PORT")]
    pub target: String,
    /// Scene to ask for (default: the first that the server lists)
    #[arg(long, value_name = "ID")]
    pub scene: Option<String>,
    /// Camera to look through (default: the first of the scene)
    #[arg(long, value_name = "ID")]
    pub camera: Option<String>,
    /// Track id of an object of the scene; the contract does not list them. Without one, checks of
    /// objects are skipped
    #[arg(long, value_name = "ID")]
    pub object: Option<String>,
    /// Package (.usdz) that the simulator reads beside the server: poses of cameras, names and
    /// times are compared with it. Without one, that check is skipped
    #[arg(long, value_name = "FILE.usdz")]
    pub package: Option<PathBuf>,
    /// File with a token, sent as `authorization: Bearer TOKEN`
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Certificate (PEM) of the authority that signed the server's, for https
    #[arg(long, value_name = "FILE")]
    pub ca_cert: Option<PathBuf>,
    /// Longest wait for one answer, seconds. The first image may wait for the scene to load
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 300.0, value_parser = seconds)]
    pub timeout: f64,
    /// Write the results to this JSON file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Permission to replace files
    #[command(flatten)]
    pub force: Force,
}

impl ConformOptions {
    /// The defaults for the server at `target`.
    #[must_use]
    pub fn of_target(target: String) -> Self {
        Self {
            target,
            scene: None,
            camera: None,
            object: None,
            package: None,
            token_file: None,
            ca_cert: None,
            timeout: 300.0,
            json: None,
            force: Force::default(),
        }
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    let value = text
        .parse()
        .ok()
        .filter(|&s: &f64| s > 0.0 && s <= 86_400.0);
    value.ok_or_else(|| format!("expected seconds, above 0 and at most 86400, found {text:?}"))
}

/// Runs all checks; `said` is told the result of each as it is known.
///
/// # Errors
/// Returns an error if there is no server, or it names no scene or camera to look at.
pub fn run(options: &ConformOptions, said: &mut dyn FnMut(Check, &Outcome)) -> Result<Report> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("no threads")?;
    runtime.block_on(judge(options, &Check::ALL, said))
}

/// Runs `checks`, for callers in a runtime.
///
/// # Errors
/// Returns the errors of [`run`].
pub async fn judge(
    options: &ConformOptions,
    checks: &[Check],
    said: &mut dyn FnMut(Check, &Outcome),
) -> Result<Report> {
    let channel = connect(options).await?;
    let mut target = Target::new(channel, options).await?;
    let mut results = Vec::new();
    for &check in checks {
        let outcome = check.judge(&mut target).await;
        said(check, &outcome);
        results.push((check, outcome));
    }
    Ok(Report {
        target: options.target.clone(),
        scene: target.scene.clone(),
        camera: target.camera.logical_id.clone(),
        results,
    })
}

async fn connect(options: &ConformOptions) -> Result<Channel> {
    let uri = match options.target.contains("://") {
        true => options.target.clone(),
        false => format!("http://{}", options.target),
    };
    let mut endpoint = Endpoint::from_shared(uri.clone())
        .with_context(|| format!("--target {:?} is no HOST:PORT", options.target))?
        .tcp_nodelay(true)
        .timeout(Duration::from_secs_f64(options.timeout));
    if let Some(path) = &options.ca_cert {
        let pem = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem));
        endpoint = endpoint.tls_config(tls)?;
    }
    endpoint
        .connect()
        .await
        .with_context(|| format!("no server answers at {}", options.target))
}
