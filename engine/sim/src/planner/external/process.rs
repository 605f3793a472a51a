//! A planner's process: started, listened to and, whatever it does, ended.

use std::collections::VecDeque;
use std::io::Read;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use super::connection::Connection;

/// Number of bytes of stderr that are kept; the last lines of them are reported.
const TAIL_BYTES: usize = 2048;
const TAIL_LINES: usize = 6;
/// Interval between checks whether the process has ended.
const LOOK: Duration = Duration::from_millis(3);

/// A running child that leads a process group of its own. Dropping it ends the group and reaps the
/// child. If this program ends in any other way, even by SIGKILL, the guardian ends the group.
#[derive(Debug)]
pub(super) struct Process {
    /// None once it is reaped: its id may be another process's by then.
    child: Option<Child>,
    guardian: Option<Child>,
    complaints: Arc<Complaints>,
}

/// The end of what it wrote to stderr.
#[derive(Debug, Default)]
struct Complaints {
    tail: Mutex<Tail>,
    ended: Condvar,
}

#[derive(Debug, Default)]
struct Tail {
    bytes: VecDeque<u8>,
    is_whole: bool,
}

impl Process {
    /// Starts `words`, a program and its arguments, its stdin and stdout joined to a connection.
    ///
    /// Both are sockets rather than pipes: a socket has deadlines for both directions, so that
    /// nobody has to wait in a thread.
    pub(super) fn start(words: &[String]) -> Result<(Self, Connection), String> {
        let (program, arguments) = words.split_first().ok_or("no program is named")?;
        let pair = || UnixStream::pair().map_err(|error| format!("cannot make a socket: {error}"));
        let ((to, stdin), (from, stdout)) = (pair()?, pair()?);
        let child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::from(OwnedFd::from(stdin)))
            .stdout(Stdio::from(OwnedFd::from(stdout)))
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn();
        let mut child = child
            .map_err(|error| format!("cannot start {program:?}: {error}; expected a program"))?;
        let guardian = guardian_of(&child);
        let complaints = Arc::new(Complaints::default());
        if let Some(stderr) = child.stderr.take() {
            let kept = Arc::clone(&complaints);
            std::thread::spawn(move || kept.listen(stderr));
        }
        // Made before a failure of the guardian is told: dropping it ends the child.
        let mut process = Self {
            child: Some(child),
            guardian: None,
            complaints,
        };
        process.guardian = Some(guardian.map_err(|error| {
            format!("cannot start sh, which ends the planner with this program: {error}")
        })?);
        Ok((process, Connection::new(to, from)))
    }

    /// Ends it and all that it started, once `grace` is over or it has ended by itself: what is to
    /// be said of it.
    pub(super) fn end(&mut self, grace: Duration) -> String {
        let Some(mut child) = self.child.take() else {
            return "it was ended before".to_owned();
        };
        let ended = has_ended(&child, grace);
        if ended.is_ok() {
            // The child is not reaped yet, so its id is nobody else's. Where nobody is left in its
            // group, nothing is to be done.
            let _ = kill_process_group(Pid::from_child(&child), Signal::KILL);
        }
        // Before the child is reaped: the guardian must not end a group that has its id afterwards.
        if let Some(mut guardian) = self.guardian.take() {
            let _ = guardian.kill();
            let _ = guardian.wait();
        }
        let mut said = match (child.wait(), ended) {
            (Ok(status), Ok(true)) => format!("it ended with {status}"),
            (Ok(_), _) => "it went on running and was ended".to_owned(),
            (Err(error), _) => format!("how it ended is not known ({error})"),
        };
        let complaints = self.complaints.last_lines();
        if !complaints.is_empty() {
            said += &format!("; the last it wrote to stderr: {complaints}");
        }
        said
    }
}

/// Starts a shell that ends the process group of `child` when this program ends. It waits for the
/// end of its input, a pipe whose other end only this program has. A signal at the death of the
/// parent (PR_SET_PDEATHSIG) would reach the child alone, and come when the thread that started it
/// ends.
fn guardian_of(child: &Child) -> std::io::Result<Child> {
    Command::new("sh")
        .args(["-c", "read -r _; kill -s KILL -- \"-$0\""])
        .arg(child.id().to_string())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .process_group(0)
        .spawn()
}

/// True if `child` ends within `grace`; it is not reaped.
fn has_ended(child: &Child, grace: Duration) -> rustix::io::Result<bool> {
    let deadline = Instant::now() + grace;
    let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    loop {
        let ended = waitid(WaitId::Pid(Pid::from_child(child)), options)?.is_some();
        if ended || Instant::now() >= deadline {
            return Ok(ended);
        }
        std::thread::sleep(LOOK);
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.end(Duration::ZERO);
    }
}

impl Complaints {
    fn listen(&self, mut stderr: ChildStderr) {
        let mut piece = [0; 4096];
        while let Ok(count @ 1..) = stderr.read(&mut piece) {
            let mut tail = self.tail.lock().unwrap_or_else(PoisonError::into_inner);
            tail.bytes.extend(&piece[..count]);
            let excess = tail.bytes.len().saturating_sub(TAIL_BYTES);
            tail.bytes.drain(..excess);
        }
        self.tail
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .is_whole = true;
        self.ended.notify_all();
    }

    /// The last lines in one, without control characters. A moment is given to what is still on its
    /// way.
    fn last_lines(&self) -> String {
        let tail = self.tail.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self
            .ended
            .wait_timeout_while(tail, Duration::from_secs(1), |tail| !tail.is_whole);
        let tail = waited.unwrap_or_else(PoisonError::into_inner).0;
        let bytes: Vec<u8> = tail.bytes.iter().copied().collect();
        let text = String::from_utf8_lossy(&bytes);
        let lines: Vec<&str> = text
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty())
            .collect();
        let last = lines[lines.len().saturating_sub(TAIL_LINES)..].join(" | ");
        last.chars()
            .map(|c| if c.is_control() { ' ' } else { c })
            .collect()
    }
}
