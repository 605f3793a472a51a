//! Splat files that pages send, which take the place of what is shown.
//!
//! `PUT /files/NAME` has the bytes of the file as its body. They go to a file in a folder of their
//! own, which is removed when they are read; folders that killed programs left are removed when
//! the viewer starts, and before the next file. Of the name the ending alone is used for files.

use std::error::Error;
use std::fs::{File, OpenOptions};
use std::future::poll_fn;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Path as Segment, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use decouplegs::asset::{SplatFormat, UnfinishedFolder};
use decouplegs::explain::explain;
use decouplegs::session::Session;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot};
use tokio::time::timeout;

use crate::events::{Event, post};
use crate::open::dropped;
use crate::source::Source;

/// Bytes of a file that is taken.
pub const BYTES_MAX: u64 = 2 << 30;
/// Bytes of a name, and of its ending.
const NAME_BYTES_MAX: usize = 255;
const ENDING_BYTES_MAX: usize = 16;
/// Longest wait for more of a file.
const PATIENCE: Duration = Duration::from_secs(30);
/// Pieces of a file that wait to be written.
const PIECES: usize = 4;
/// Longest time for which a file that is refused is read on: a connection that is closed with
/// unread data is reset, and the reason is lost.
const FAREWELL: Duration = Duration::from_secs(2);
/// Endings of what is a scene, an episode or a part of them: those name other files, which a page
/// is not to choose.
const SCENES: [&str; 4] = ["toml", "usdz", "log", "json"];
/// Beginning of the names of folders.
const FOLDER: &str = "decouplegs-view";

/// Place for one file, and who shows it.
pub struct Uploads {
    session: Arc<Session>,
    events: SyncSender<Event>,
    place: Arc<Semaphore>,
}

/// Reason why a file is not taken.
#[derive(Debug)]
struct Refused(StatusCode, String);

/// File on the disk that is removed with its folder. It keeps the place for a file.
struct Received {
    path: PathBuf,
    _folder: UnfinishedFolder,
    _place: OwnedSemaphorePermit,
}

/// Name of a file that was sent.
#[derive(Debug)]
struct Name {
    whole: String,
    ending: String,
}

impl Uploads {
    /// Uploads that are copied to the device of `session`, and shown by who takes `events`.
    pub fn new(session: Arc<Session>, events: SyncSender<Event>) -> Self {
        // What killed viewers left is removed.
        drop(folder());
        Self {
            session,
            events,
            place: Arc::new(Semaphore::new(1)),
        }
    }
}

fn folder() -> Result<UnfinishedFolder, String> {
    let folder = UnfinishedFolder::begin(&std::env::temp_dir().join(FOLDER));
    folder.map_err(|error| {
        let reason = sentence(&error);
        format!("there is no place for the file on the machine of the viewer: {reason}")
    })
}

/// An error and its causes, in one line.
fn sentence(error: &(dyn Error + 'static)) -> String {
    let lines = explain(error);
    let lines = lines.trim().trim_start_matches("error: ");
    lines.replace("\n  because: ", ": ")
}

impl Name {
    fn new(whole: &str) -> Result<Self, Refused> {
        let refused = |reason: String| Err(Refused(StatusCode::UNSUPPORTED_MEDIA_TYPE, reason));
        let is_name = !whole.is_empty()
            && whole.len() <= NAME_BYTES_MAX
            && !whole.contains(|c: char| c.is_control() || c == '/' || c == '\\');
        if !is_name {
            return refused("expected the name of a file, without folders".into());
        }
        let ending = whole.rsplit_once('.').map_or("", |(_, ending)| ending);
        let ending = ending.to_ascii_lowercase();
        if SCENES.contains(&ending.as_str()) {
            return refused(format!(
                "{whole} is no file of splats ({}): scenes and episodes are opened by 'decouplegs view {whole}'",
                SplatFormat::EXTENSIONS
            ));
        }
        let fits = ending.len() <= ENDING_BYTES_MAX
            && ending.bytes().all(|byte| byte.is_ascii_alphanumeric());
        Ok(Self {
            whole: whole.to_owned(),
            ending: if fits { ending } else { String::new() },
        })
    }
}

/// Takes a file, reads it, and shows it in the place of what is shown.
pub async fn put(
    State(uploads): State<Arc<Uploads>>,
    Segment(name): Segment<String>,
    headers: HeaderMap,
    mut body: Body,
) -> Response {
    let shown = take(&uploads, &name, &headers, &mut body).await;
    match shown {
        Ok(()) => StatusCode::NO_CONTENT.into_response(),
        Err(Refused(status, reason)) => {
            let rest = async { while next(&mut body).await.is_ok_and(|piece| piece.is_some()) {} };
            let _ = timeout(FAREWELL, rest).await;
            (status, [(header::CONNECTION, "close")], reason).into_response()
        }
    }
}

async fn take(
    uploads: &Uploads,
    name: &str,
    headers: &HeaderMap,
    body: &mut Body,
) -> Result<(), Refused> {
    let name = Name::new(name)?;
    let length = headers.get(header::CONTENT_LENGTH);
    let length: Option<u64> = length.and_then(|length| length.to_str().ok()?.parse().ok());
    if length.is_some_and(|length| length > BYTES_MAX) {
        return Err(too_large(BYTES_MAX));
    }
    let place = Arc::clone(&uploads.place).try_acquire_owned();
    let place = place.map_err(|_| {
        let reason = "another file is being opened: wait until it is shown";
        Refused(StatusCode::CONFLICT, reason.into())
    })?;
    let folder = folder().map_err(|reason| Refused(StatusCode::INSUFFICIENT_STORAGE, reason))?;
    // The name says nothing but its ending.
    let path = folder.path().join("splats").with_extension(&name.ending);
    let received = Received {
        path,
        _folder: folder,
        _place: place,
    };
    receive(body, &received.path, BYTES_MAX).await?;
    let whole = name.whole;
    let session = Arc::clone(&uploads.session);
    let reading = tokio::task::spawn_blocking(move || read(&received, &whole, &session));
    let read = reading
        .await
        .unwrap_or_else(|_| Err("it cannot be read".into()));
    let unreadable = |reason: String| Refused(StatusCode::UNPROCESSABLE_ENTITY, reason);
    let source = read.map_err(unreadable)?;
    let (answer, answered) = oneshot::channel();
    post(&uploads.events, Event::Show(Box::new(source), answer)).await;
    let busy = |reason: String| Refused(StatusCode::CONFLICT, reason);
    let shown = answered.await;
    shown
        .unwrap_or_else(|_| Err("the viewer ends".into()))
        .map_err(busy)
}

fn too_large(most: u64) -> Refused {
    let reason = format!(
        "the file is larger than {} GiB, and a page sends no more: open it by 'decouplegs view FILE'",
        most >> 30
    );
    Refused(StatusCode::PAYLOAD_TOO_LARGE, reason)
}

/// The next piece of a body; `None` at its end.
async fn next(body: &mut Body) -> Result<Option<Bytes>, Refused> {
    let lost = |reason: &str| Refused(StatusCode::REQUEST_TIMEOUT, reason.into());
    loop {
        let frame = poll_fn(|context| Pin::new(&mut *body).poll_frame(context));
        match timeout(PATIENCE, frame).await {
            Ok(None) => return Ok(None),
            // Others are trailers, which say nothing.
            Ok(Some(Ok(frame))) => match frame.into_data() {
                Ok(piece) => return Ok(Some(piece)),
                Err(_) => continue,
            },
            Ok(Some(Err(_))) => return Err(lost("the file did not arrive whole: send it again")),
            Err(_) => return Err(lost("nothing of the file came for 30 s: send it again")),
        }
    }
}

/// Writes `body` to a new file at `path`, piece by piece, at most `most` bytes.
async fn receive(body: &mut Body, path: &Path, most: u64) -> Result<(), Refused> {
    let unwritten = |error: std::io::Error| {
        let reason = format!("the file cannot be kept on the machine of the viewer: {error}");
        Refused(StatusCode::INSUFFICIENT_STORAGE, reason)
    };
    // Other users of this machine cannot read it.
    let mut options = OpenOptions::new();
    let file = options.write(true).create_new(true).mode(0o600).open(path);
    let file = file.map_err(unwritten)?;
    let (pieces, waiting) = mpsc::channel::<Bytes>(PIECES);
    let writing = tokio::task::spawn_blocking(move || write(file, waiting));
    let mut bytes = 0;
    while let Some(piece) = next(body).await? {
        bytes += piece.len() as u64;
        if bytes > most {
            return Err(too_large(most));
        }
        if pieces.send(piece).await.is_err() {
            // It says why below.
            break;
        }
    }
    drop(pieces);
    let written = writing
        .await
        .unwrap_or_else(|error| Err(std::io::Error::other(error)));
    written.map_err(unwritten)
}

fn write(mut file: File, mut pieces: mpsc::Receiver<Bytes>) -> std::io::Result<()> {
    while let Some(piece) = pieces.blocking_recv() {
        file.write_all(&piece)?;
    }
    Ok(())
}

/// The splats that were received, on the device. Errors are sentences with the name of the file.
fn read(received: &Received, name: &str, session: &Session) -> Result<Source, String> {
    dropped(&received.path, name, session).map_err(|error| {
        let path = received.path.display().to_string();
        sentence(error.as_ref()).replace(&path, name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn in_runtime<T>(future: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        runtime.unwrap().block_on(future)
    }

    #[test]
    fn of_a_name_the_ending_alone_is_used() {
        let ending = |name: &str| Name::new(name).map(|name| name.ending);
        assert_eq!(ending("my garden.PLY").unwrap(), "ply");
        assert_eq!(ending("a.compressed.ply").unwrap(), "ply");
        assert_eq!(ending("plain").unwrap(), "");
        assert_eq!(ending("a.b c").unwrap(), "");
        assert_eq!(ending(&format!("a.{}", "x".repeat(99))).unwrap(), "");
        for unfit in [
            "",
            "../a.ply",
            "a\\b.ply",
            "a\0.ply",
            "a\n.ply",
            "scene.toml",
            "x.LOG",
        ] {
            let refused = ending(unfit).unwrap_err();
            assert_eq!(refused.0, StatusCode::UNSUPPORTED_MEDIA_TYPE, "{unfit}");
        }
    }

    #[test]
    fn a_file_without_a_length_is_counted_as_it_comes() {
        let folder = folder().unwrap();
        let path = folder.path().join("splats.ply");
        let mut body = Body::from(vec![7; 1000]);
        in_runtime(receive(&mut body, &path, 1000)).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), vec![7; 1000]);
        let again = in_runtime(receive(&mut Body::from("x"), &path, 1000));
        assert_eq!(again.unwrap_err().0, StatusCode::INSUFFICIENT_STORAGE);
        let other = folder.path().join("other.ply");
        let refused = in_runtime(receive(&mut Body::from(vec![7; 1001]), &other, 1000));
        assert_eq!(refused.unwrap_err().0, StatusCode::PAYLOAD_TOO_LARGE);
    }

    #[test]
    fn a_file_and_its_folder_are_removed() {
        let first = folder().unwrap();
        let path = first.path().to_owned();
        std::fs::write(path.join("splats.ply"), "ply").unwrap();
        drop(first);
        assert!(!path.exists());
    }
}
