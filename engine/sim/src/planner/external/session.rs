//! A conversation with a planner: questions and answers, each within its time.

use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::connection::{Connection, Fault, LINE_BYTES_MAX};
use super::message::{self, Answer, Introduction, beginning};
use super::process::Process;
use super::{Timeouts, Transport};
use crate::planner::PlannerError;

/// Time that a closing process has to end, so that its exit status can be reported.
const EXIT_GRACE: Duration = Duration::from_secs(1);
/// Time limit for the last message: a planner that ends is not worth a longer wait.
const FAREWELL: Duration = Duration::from_millis(200);

/// A connection, and the process behind it where we started it.
#[derive(Debug)]
pub(super) struct Session {
    connection: Connection,
    process: Option<Process>,
    /// Program in the sentences about it.
    who: &'static str,
    /// True while there was no error: a planner that keeps to the protocol is told of the end and
    /// given time for it.
    is_sound: bool,
}

impl Session {
    /// Starts or connects to the planner and has it introduce itself.
    pub(super) fn open(
        attachment: &Transport,
        timeouts: &Timeouts,
    ) -> Result<(Self, Introduction), PlannerError> {
        let who = "the external planner";
        let (mut session, answer) = Self::greeted(attachment, timeouts, &message::hello(), who)?;
        match answer {
            Answer::Hello(introduction) => Ok((session, introduction)),
            Answer::AgentsHello(_) => Err(session
                .broken("introduced itself as a driver of agents; expected a planner of the ego")),
            other => Err(session.broken(&format!(
                "answered hello with {}; expected hello",
                other.word()
            ))),
        }
    }

    /// Starts or connects to a program and says `hello`: the session, and its answer.
    pub(super) fn greeted(
        attachment: &Transport,
        timeouts: &Timeouts,
        hello: &Value,
        who: &'static str,
    ) -> Result<(Self, Answer), PlannerError> {
        let (process, connection) = match attachment {
            Transport::Command(words) => {
                Process::start(words).map(|(process, connection)| (Some(process), connection))
            }
            Transport::Socket(path) => {
                connect(path, timeouts.hello).map(|connection| (None, connection))
            }
        }
        .map_err(|fault| PlannerError(format!("{who}: {fault}")))?;
        let mut session = Self {
            connection,
            process,
            who,
            is_sound: true,
        };
        let answer = session.ask(hello, &[], timeouts.hello)?;
        Ok((session, answer))
    }

    /// True if it is connected and sent nothing unasked.
    pub(super) fn is_open(&mut self) -> bool {
        self.is_sound
            && !matches!(
                self.connection.is_silent(),
                Err(Fault::Closed | Fault::System(_))
            )
    }

    /// Sends `header` and `payload` and waits for the answer, all within `time`.
    pub(super) fn ask(
        &mut self,
        header: &Value,
        payload: &[&[u8]],
        time: Duration,
    ) -> Result<Answer, PlannerError> {
        let asked = header["type"].as_str().unwrap_or_default();
        let line = format!("{header}\n");
        let mut parts = vec![line.as_bytes()];
        parts.extend_from_slice(payload);
        let deadline = Instant::now() + time;
        let silent = self.connection.is_silent();
        if let Err(fault) = silent.and_then(|()| self.connection.send(&parts, deadline)) {
            return Err(self.faulty(&fault, &format!("did not take `{asked}`"), time));
        }
        let line = match self.connection.read_line(deadline) {
            Ok(line) => line,
            Err(fault) => {
                return Err(self.faulty(&fault, &format!("did not answer `{asked}`"), time));
            }
        };
        Answer::from_line(&line).map_err(|fault| self.broken(&fault))
    }

    /// The session ends with a sentence about what the planner did.
    pub(super) fn broken(&mut self, what: &str) -> PlannerError {
        self.fails(what, Duration::ZERO)
    }

    fn faulty(&mut self, fault: &Fault, undone: &str, time: Duration) -> PlannerError {
        let what = match fault {
            Fault::Late => format!("{undone} within {} s", time.as_secs_f64()),
            Fault::Closed => {
                return self.fails(&format!("{undone} and closed the connection"), EXIT_GRACE);
            }
            Fault::Endless(line) => {
                format!(
                    "sent a line of more than {LINE_BYTES_MAX} bytes, which begins with {}",
                    beginning(line)
                )
            }
            Fault::Unasked(bytes) => format!("spoke without being asked: {}", beginning(bytes)),
            Fault::System(error) => format!("{undone}: {error}"),
        };
        self.broken(&what)
    }

    fn fails(&mut self, what: &str, grace: Duration) -> PlannerError {
        self.is_sound = false;
        let end = self
            .process
            .as_mut()
            .map_or_else(String::new, |process| format!(" ({})", process.end(grace)));
        PlannerError(format!("{} {what}{end}", self.who))
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if self.is_sound {
            // Who no longer listens has no use for it.
            let _ = self.connection.send(
                &[format!("{}\n", message::end()).as_bytes()],
                Instant::now() + FAREWELL,
            );
            self.connection.close();
            if let Some(process) = &mut self.process {
                process.end(EXIT_GRACE);
            }
        }
    }
}

/// Connects to a listening planner. A queue that is full makes the system wait without a deadline,
/// so that a thread does the waiting.
fn connect(path: &Path, time: Duration) -> Result<Connection, String> {
    let (done, connected) = mpsc::channel();
    let to: PathBuf = path.to_owned();
    std::thread::spawn(move || {
        // Nobody waits any longer where it took too long.
        let _ = done.send(UnixStream::connect(to));
    });
    let shown = path.display();
    let stream = connected
        .recv_timeout(time)
        .map_err(|_| format!("{shown} took no connection within {} s", time.as_secs_f64()))?;
    let connection = stream.and_then(|stream| Ok(Connection::new(stream.try_clone()?, stream)));
    connection.map_err(|error| {
        format!("cannot connect to {shown}: {error}; expected a planner that listens there")
    })
}
