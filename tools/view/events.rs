//! Events and messages between the server and the thread that serves its clients.

use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::Duration;

use tokio::sync::oneshot::Sender;
use tokio::time::sleep;

use crate::draw_thread::Done;
use crate::drive_thread::Driven;
use crate::protocol::Request;
use crate::source::Source;

/// Messages to a client.
#[derive(Debug)]
pub enum Outgoing {
    /// JSON text.
    Text(String),
    /// An image with its header.
    Image(Vec<u8>),
}

/// Way to a client. A client that leaves hundreds of messages unread is dropped.
pub type Outbox = tokio::sync::mpsc::Sender<Outgoing>;

/// Events for the thread that serves the clients.
pub enum Event {
    /// A client came.
    Joined(u64, Outbox),
    /// A client went.
    Left(u64),
    /// A page asks for the splats of a source; none if there is no such source.
    Splats(usize, Sender<Option<Arc<[u8]>>>),
    /// A file that a page sent was read, and takes the place of what is shown; a sentence where
    /// that cannot be.
    Show(Box<Source>, Sender<Result<(), String>>),
    /// A client sent a command.
    Command(u64, Request),
    /// The thread that draws has done some work.
    Done(Done),
    /// An episode was driven on.
    Driven(Driven),
    /// The program ends.
    Stop,
}

/// Sends `event` to the thread that serves the clients, and waits while that has too many already.
/// False if it is gone.
pub async fn post(events: &SyncSender<Event>, event: Event) -> bool {
    let mut event = event;
    loop {
        match events.try_send(event) {
            Ok(()) => return true,
            Err(TrySendError::Disconnected(_)) => return false,
            Err(TrySendError::Full(unsent)) => event = unsent,
        }
        sleep(Duration::from_millis(5)).await;
    }
}
