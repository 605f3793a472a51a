//! `decouplegs view`: a scene in the browser.
//!
//! | module | content |
//! |---|---|
//! | `protocol` | commands, acknowledgements and image headers |
//! | `source` | the scene at a time: worlds, cameras, boxes |
//! | `log` | an episode at a time, and its score |
//! | `session` | the thread that renders |
//! | `server` | HTTP, WebSockets, and who may connect |
#![forbid(unsafe_code)]

mod log;
mod protocol;
mod server;
mod session;
mod source;

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::mpsc;

use anyhow::{Context, Result, ensure};
use decouplegs::gpu::Gpu;
use decouplegs::scene::Rules;
use decouplegs::session::Session;
use decouplegs_cli::arguments::print;
use decouplegs_cli::device::{DeviceArguments, check_validation};
use decouplegs_cli::progress;
use decouplegs_cli::scene_source::{Scene, SceneArguments};

use log::{LogArguments, OpenLog};
use protocol::Channel;
use server::{Service, router};
use session::{Event, Viewer};
use source::Source;

/// Commands that wait for the thread that renders.
const EVENTS_MAX: usize = 1024;

/// Look into a scene or the log of an episode (.log) in the browser: fly, play, step, switch
/// cameras and kinds of images
///
/// Images are rendered here and sent to the page, so it works from a machine without a display:
/// ssh -L 8090:localhost:8090. While something moves images may be smaller; at rest they are those
/// of 'decouplegs render', bit for bit. Ctrl-C ends it
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    #[command(flatten)]
    log: LogArguments,
    /// Port; 0 takes a free one
    #[arg(long, default_value_t = 8090)]
    port: u16,
    /// Address to listen on. All but loopback addresses need --token
    #[arg(long, value_name = "IP", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    address: IpAddr,
    /// Secret that the page needs, letters and digits: it is part of the printed address
    #[arg(long, value_parser = token)]
    token: Option<String>,
    #[command(flatten)]
    device: DeviceArguments,
}

/// Shortest token that is accepted.
const TOKEN_CHARACTERS_MIN: usize = 8;

fn token(text: &str) -> Result<String, String> {
    let fits = |character: char| character.is_ascii_alphanumeric() || "-_".contains(character);
    if text.len() >= TOKEN_CHARACTERS_MIN && text.chars().all(fits) {
        return Ok(text.to_owned());
    }
    Err(format!(
        "expected at least {TOKEN_CHARACTERS_MIN} letters, digits, '-' or '_'"
    ))
}

/// Serves the page until Ctrl-C.
///
/// # Errors
/// Returns an error if the scene is at fault, there is no device, or the port is taken.
pub fn run(arguments: &Arguments) -> Result<()> {
    let address = SocketAddr::new(arguments.address, arguments.port);
    ensure!(
        address.ip().is_loopback() || arguments.token.is_some(),
        "{} can be reached from other machines: give --token, or leave out --address",
        address.ip()
    );
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .context("the threads of the server cannot be started")?;
    // Before the scene is read: a port that is taken is said at once.
    let listener = runtime
        .block_on(tokio::net::TcpListener::bind(address))
        .with_context(|| format!("{address} cannot be listened on: give another --port"))?;
    let address = listener.local_addr()?;
    let (gpu, rules, session, source) = open(arguments)?;
    let mut viewer = Viewer::new(&gpu, rules, source, session.batch_renderer());
    let (events, inbox) = mpsc::sync_channel(EVENTS_MAX);
    let renders = std::thread::Builder::new()
        .name("viewer".into())
        .spawn(move || viewer.run(&inbox))
        .context("the thread that renders cannot be started")?;
    let query = arguments
        .token
        .as_ref()
        .map(|token| format!("?token={token}"));
    let url = format!("http://{address}/{}", query.unwrap_or_default());
    print(&format!("{url}\n"))?;
    let _ = writeln!(
        std::io::stderr(),
        "open this address in a browser; Ctrl-C ends the viewer"
    );
    let service = Service {
        events: events.clone(),
        token: arguments.token.as_deref().map(Arc::from),
        next_client: Arc::new(AtomicU64::new(1)),
        loopback: address.ip().is_loopback(),
    };
    runtime.block_on(async {
        let served = axum::serve(listener, router(service));
        tokio::select! {
            ended = served => ended.context("the server failed"),
            signal = tokio::signal::ctrl_c() => signal.context("Ctrl-C cannot be waited for"),
        }
    })?;
    let _ = events.send(Event::Stop);
    drop(events);
    ensure!(renders.join().is_ok(), "the thread that renders failed");
    check_validation(&gpu)
}

/// Opens the scene or the log, on the device.
fn open(arguments: &Arguments) -> Result<(Gpu, Rules, Session, Source)> {
    let path = arguments.scene.path();
    let is_log = path.extension().is_some_and(|extension| extension == "log");
    let on = |rules: Rules| -> Result<(Gpu, Session)> {
        let gpu = arguments.device.open()?;
        let session = Session::on(&gpu, &session::options(rules, Channel::Color));
        Ok((gpu, session))
    };
    if !is_log {
        ensure!(
            !arguments.log.is_given(),
            "{}: --base and --light are for logs of episodes",
            path.display()
        );
        let scene = Scene::open(&arguments.scene)?;
        let rules = scene.rules();
        let (gpu, session) = on(rules)?;
        let copying = progress::spinner("copying the scene to the device".to_owned());
        let source = Source::of_scene(scene, &session)?;
        copying.finish_and_clear();
        return Ok((gpu, rules, session, source));
    }
    ensure!(
        !arguments.scene.has_options(),
        "{}: a log has its own cameras, sizes and rules: leave out the options of scenes",
        path.display()
    );
    let opening = progress::spinner(format!("opening {} and its place", path.display()));
    let log = OpenLog::open(path, &arguments.log)?;
    let rules = log.site.loaded.world.rules;
    let (gpu, session) = on(rules)?;
    let (played, on_device) = log.play(&session)?;
    opening.finish_and_clear();
    Ok((gpu, rules, session, Source::of_log(played, on_device)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_can_be_part_of_an_address() {
        assert_eq!(token("abcDEF-_12"), Ok("abcDEF-_12".into()));
        for unfit in ["", "short", "with space", "semi;colon", "a&token=b"] {
            assert!(token(unfit).is_err(), "{unfit}");
        }
    }
}
