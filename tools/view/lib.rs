//! `decouplegs view`: a scene or an episode in the browser.
//!
//! | module | content |
//! |---|---|
//! | `protocol`, `image_header` | commands and acknowledgements; what stands before an image |
//! | `open`, `demo` | scenes, logs and scenarios of the command line; the scene where none is named |
//! | `source`, `viewpoint` | the scene at a time: worlds, cameras, boxes, and the same as facts for the page; sizes of images |
//! | `scene_course`, `edits`, `history`, `lanes` | a scene with its tracks, edits, undo, lanes to snap to |
//! | `played`, `series`, `scenario_edits` | an episode at a time, its score and its quantities over time; a scenario that is edited and begun anew |
//! | `session`, `clock` | the thread that serves the clients; the clock that they share |
//! | `draw_thread`, `frame_state` | the thread that draws, and the state that goes with its images |
//! | `drive_thread` | the thread that drives live episodes on |
//! | `drawing`, `recording` | images of views, agents under the mouse; images as files |
//! | `render_command` | the command that renders the image of a view |
//! | `splat_stream` | splats that the page draws by itself while a camera moves |
//! | `page_export` | a scene in one file that a browser shows without a viewer |
//! | `server`, `events`, `page_files` | HTTP, WebSockets, and who may connect; the files of the page |
//! | `uploads` | splat files that pages send |
#![forbid(unsafe_code)]

mod clock;
mod demo;
mod draw_thread;
mod drawing;
mod drive_thread;
mod edits;
mod events;
mod extent;
mod frame_state;
mod history;
mod image_header;
mod lanes;
mod open;
mod page_export;
mod page_files;
mod played;
mod protocol;
mod recording;
mod render_command;
mod scenario_edits;
mod scene_course;
mod series;
mod server;
mod session;
mod source;
mod splat_stream;
mod uploads;
mod viewpoint;

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use decouplegs_cli::arguments::print;
use decouplegs_cli::background::BackgroundArguments;
use decouplegs_cli::device::{DeviceArguments, check_validation};
use decouplegs_cli::outputs::Force;

use drawing::Drawer;
use events::Event;
use open::{SourceArguments, drive_to_the_end};
use server::{Connections, Peer, Secret, Service, router};
use session::Viewer;
use uploads::Uploads;

/// Longest wait for the image that is drawn when the viewer ends.
const LAST_IMAGE: Duration = Duration::from_secs(3);
/// Events that wait for the thread that serves the clients.
const EVENTS_MAX: usize = 1024;

/// Look into a scene or an episode in the browser: fly, play, edit agents, compare
///
/// Shows splats, scenes, logs of episodes, and scenarios, which a planner drives while you look.
/// Images are rendered here and sent to the page, so it works from a machine without a display:
/// ssh -L 8090:localhost:8090. While something moves images may be smaller; at rest they are those
/// of 'decouplegs render', bit for bit. Ctrl-C ends it. With --export it writes one HTML file that
/// shows the scene by itself
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    sources: SourceArguments,
    /// Port; 0 takes a free one
    #[arg(long, default_value_t = 8090)]
    port: u16,
    /// Address to listen on. What is sent is not encrypted: prefer ssh -L to other addresses than
    /// loopback
    #[arg(long, value_name = "IP", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    address: IpAddr,
    /// Secret that the page needs, letters and digits: it is part of the printed address. A new one
    /// is made if it is left out
    #[arg(long, value_parser = token, conflicts_with = "no_token")]
    token: Option<String>,
    /// Ask for no secret: every program and user of this machine may then edit, save and record.
    /// For loopback addresses alone
    #[arg(long)]
    no_token: bool,
    /// Splats of a scene that the page is sent, to draw by itself while a camera moves: those that
    /// cover most. 0: the page draws nothing
    #[arg(long, value_name = "N", default_value_t = 500_000, value_parser = clap::value_parser!(u32).range(..=8_000_000))]
    browser_splats: u32,
    /// Write one HTML file that shows the scene without a viewer and without a network, and end:
    /// with the splats of --browser-splats, which the browser draws, and what moves. An episode is
    /// driven to its end first
    #[arg(long, value_name = "FILE.html", value_parser = page_name, conflicts_with_all = ["port", "address", "token", "no_token", "against"])]
    export: Option<PathBuf>,
    /// Replace the file of --export if it exists. The inputs are never replaced
    #[arg(long, requires = "export")]
    force: bool,
    #[command(flatten)]
    background: BackgroundArguments,
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

fn page_name(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    if ["html", "htm"].iter().any(|known| extension == *known) {
        return Ok(path);
    }
    Err("expected the name of a file that ends in .html: browsers show no others as pages".into())
}

/// A secret of 128 random bits.
fn new_token() -> Result<String> {
    let mut bits = [0; 16];
    getrandom::fill(&mut bits).context("the system has no random numbers: give a --token")?;
    Ok(bits.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Serves the page until Ctrl-C.
///
/// # Errors
/// Returns an error if the scene is at fault, there is no device, or the port is taken.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(path) = &arguments.export {
        return export(arguments, path);
    }
    let address = SocketAddr::new(arguments.address, arguments.port);
    ensure!(
        address.ip().is_loopback() || !arguments.no_token,
        "{} can be reached from other machines: leave out --no-token, or --address",
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
    let gpu = arguments.device.open()?;
    let drawer = Drawer::new(&gpu, arguments.background);
    let session = Arc::clone(drawer.session());
    let sources = arguments.sources.open(&session)?;
    let (events, inbox) = mpsc::sync_channel(EVENTS_MAX);
    let own_words = [arguments.background.words(), arguments.device.words()].concat();
    let options = arguments.sources.render_options(own_words);
    let splats_max = arguments.browser_splats as usize;
    let mut viewer = Viewer::new(drawer, sources, (options, splats_max), events.clone())
        .context("the thread that draws cannot be started")?;
    if let Some(time_s) = arguments.sources.time_s() {
        viewer.begin_at(time_s);
    }
    let ending = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&ending);
    let renders = std::thread::Builder::new()
        .name("viewer".into())
        .spawn(move || viewer.run(inbox, &told))
        .context("the thread that serves the clients cannot be started")?;
    let token = match (&arguments.token, arguments.no_token) {
        (_, true) => None,
        (Some(token), false) => Some(token.clone()),
        (None, false) => Some(new_token()?),
    };
    let query = token.as_ref().map(|token| format!("?token={token}"));
    let url = format!("http://{address}/{}", query.unwrap_or_default());
    print(&format!("{url}\n"))?;
    let _ = writeln!(
        std::io::stderr(),
        "open this address in a browser; Ctrl-C ends the viewer"
    );
    let service = Service {
        events: events.clone(),
        secret: token.map(|token| Secret::new(&token, address.port())),
        next_client: Arc::new(AtomicU64::new(1)),
        loopback: address.ip().is_loopback(),
        uploads: Arc::new(Uploads::new(session, events.clone())),
    };
    runtime.block_on(async {
        let pages = router(service).into_make_service_with_connect_info::<Peer>();
        let served = axum::serve(Connections::new(listener), pages);
        tokio::select! {
            ended = served => ended.context("the server failed"),
            signal = tokio::signal::ctrl_c() => signal.context("Ctrl-C cannot be waited for"),
        }
    })?;
    // Commands that wait are dropped, and with them what a full queue would hold up.
    ending.store(true, Ordering::SeqCst);
    let _ = events.try_send(Event::Stop);
    drop(events);
    let since = Instant::now();
    end_of(renders)?;
    // A file that is sent or read is removed with the task that has it.
    runtime.shutdown_timeout(LAST_IMAGE.saturating_sub(since.elapsed()));
    check_validation(&gpu)
}

/// Writes the page of `--export` to `path`.
fn export(arguments: &Arguments, path: &Path) -> Result<()> {
    let splats_max = arguments.browser_splats as usize;
    if splats_max == 0 {
        let text =
            "--export writes a page that draws its splats: give --browser-splats at least 1\n";
        clap::Error::raw(clap::error::ErrorKind::ArgumentConflict, text).exit();
    }
    let inputs: Vec<&Path> = arguments.sources.file().into_iter().collect();
    let force = Force {
        force: arguments.force,
    };
    force.files(&inputs, [&path.to_owned()])?;
    let gpu = arguments.device.open()?;
    let drawer = Drawer::new(&gpu, arguments.background);
    let mut sources = arguments.sources.open(drawer.session())?;
    let source = &mut sources[0];
    drive_to_the_end(source)?;
    let written = page_export::export(source, path, splats_max)?;
    print(&format!("{}: {written}\n", path.display()))?;
    drop(sources);
    check_validation(&gpu)
}

/// Waits until the threads have ended, and no longer than for an image: where a planner
/// does not answer, the program ends without its plan, and its process with the program.
fn end_of(renders: JoinHandle<()>) -> Result<()> {
    let since = Instant::now();
    while !renders.is_finished() {
        if since.elapsed() > LAST_IMAGE {
            let _ = writeln!(
                std::io::stderr(),
                "a planner, or an image, was not waited for"
            );
            // Nothing is written at this point but new files, which are whole or absent.
            std::process::exit(0);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    ensure!(renders.join().is_ok(), "a thread of the viewer failed");
    Ok(())
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

    #[test]
    fn pages_have_names_of_pages() {
        assert_eq!(page_name("a/b.HTML"), Ok("a/b.HTML".into()));
        for unfit in ["page", "page.png", ".html", "html"] {
            assert!(page_name(unfit).is_err(), "{unfit}");
        }
    }
}
