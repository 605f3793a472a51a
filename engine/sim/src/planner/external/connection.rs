//! Bytes to and from a planner, none of which is waited for beyond a deadline.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

/// Longest line of a planner, bytes: a plan of 256 points with 17 digits a number has 17 KiB.
pub(super) const LINE_BYTES_MAX: usize = 64 * 1024;
/// Written at a time, bytes. The kernel starts its clock anew for each piece of about this size, so
/// that a larger write to a slow reader could outlast its deadline many times over.
const WRITE_BYTES: usize = 64 * 1024;
/// Read at a time, bytes.
const READ_BYTES: usize = 8 * 1024;

/// Reason for a missing line.
#[derive(Debug)]
pub(super) enum Fault {
    /// No line came before the deadline.
    Late,
    /// Peer closed the connection.
    Closed,
    /// More than a line's bytes and no end of line; how it begins.
    Endless(Vec<u8>),
    /// Bytes that were not asked for; how they begin.
    Unasked(Vec<u8>),
    /// Error of the operating system.
    System(std::io::Error),
}

/// A way there and a way back; both are sockets, as these have deadlines.
#[derive(Debug)]
pub(super) struct Connection {
    to: UnixStream,
    from: UnixStream,
}

impl Connection {
    /// Writes go to `to`, lines come from `from`.
    pub(super) fn new(to: UnixStream, from: UnixStream) -> Self {
        Self { to, from }
    }

    /// Sends all of `parts`, one after the other.
    pub(super) fn send(&mut self, parts: &[&[u8]], deadline: Instant) -> Result<(), Fault> {
        for part in parts {
            let mut rest = *part;
            while !rest.is_empty() {
                self.to
                    .set_write_timeout(Some(left_until(deadline)?))
                    .map_err(Fault::System)?;
                match self.to.write(&rest[..rest.len().min(WRITE_BYTES)]) {
                    Ok(count) => rest = &rest[count..],
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => return Err(fault_of(error)),
                }
            }
        }
        Ok(())
    }

    /// One line without its end. Whatever follows it was not asked for.
    pub(super) fn read_line(&mut self, deadline: Instant) -> Result<Vec<u8>, Fault> {
        let mut line = Vec::new();
        let mut piece = [0; READ_BYTES];
        loop {
            self.from
                .set_read_timeout(Some(left_until(deadline)?))
                .map_err(Fault::System)?;
            let count = match self.from.read(&mut piece) {
                Ok(0) => return Err(Fault::Closed),
                Ok(count) => count,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(fault_of(error)),
            };
            if let Some(end) = piece[..count].iter().position(|&byte| byte == b'\n') {
                line.extend_from_slice(&piece[..end]);
                return match &piece[end + 1..count] {
                    _ if line.len() > LINE_BYTES_MAX => Err(Fault::Endless(line)),
                    [] => Ok(line),
                    more => Err(Fault::Unasked(more.to_vec())),
                };
            }
            line.extend_from_slice(&piece[..count]);
            if line.len() > LINE_BYTES_MAX {
                return Err(Fault::Endless(line));
            }
        }
    }

    /// Checks that the other end is connected and silent, as it should be between requests.
    pub(super) fn is_silent(&mut self) -> Result<(), Fault> {
        let mut piece = [0; 256];
        self.from.set_nonblocking(true).map_err(Fault::System)?;
        let found = self.from.read(&mut piece);
        self.from.set_nonblocking(false).map_err(Fault::System)?;
        match found {
            Ok(0) => Err(Fault::Closed),
            Ok(count) => Err(Fault::Unasked(piece[..count].to_vec())),
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) =>
            {
                Ok(())
            }
            Err(error) => Err(fault_of(error)),
        }
    }

    /// Tells the other end that nothing more comes.
    pub(super) fn close(&self) {
        // It may be closed already.
        let _ = self.to.shutdown(std::net::Shutdown::Write);
    }
}

fn left_until(deadline: Instant) -> Result<Duration, Fault> {
    let left = deadline.saturating_duration_since(Instant::now());
    if left.is_zero() {
        Err(Fault::Late)
    } else {
        Ok(left)
    }
}

fn fault_of(error: std::io::Error) -> Fault {
    match error.kind() {
        // What a socket says whose time is up differs between systems.
        ErrorKind::WouldBlock | ErrorKind::TimedOut => Fault::Late,
        ErrorKind::BrokenPipe | ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted => {
            Fault::Closed
        }
        _ => Fault::System(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair() -> (Connection, UnixStream) {
        let (ours, theirs) = UnixStream::pair().unwrap();
        (Connection::new(ours.try_clone().unwrap(), ours), theirs)
    }

    fn soon() -> Instant {
        Instant::now() + Duration::from_millis(60)
    }

    #[test]
    fn who_dribbles_is_late_all_the_same() {
        let (mut connection, mut theirs) = pair();
        let dribbling = std::thread::spawn(move || {
            while theirs.write_all(b"x").is_ok() {
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        let begin = Instant::now();
        assert!(matches!(connection.read_line(soon()), Err(Fault::Late)));
        assert!(begin.elapsed() < Duration::from_secs(20));
        drop(connection);
        dribbling.join().unwrap();
    }

    #[test]
    fn who_does_not_read_or_reads_slowly_is_late() {
        let (mut connection, mut theirs) = pair();
        let frame = vec![0; 8 << 20];
        assert!(matches!(
            connection.send(&[&frame], soon()),
            Err(Fault::Late)
        ));
        let sipping = std::thread::spawn(move || {
            let mut piece = [0; 4096];
            while theirs.read(&mut piece).is_ok_and(|count| count > 0) {
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        let begin = Instant::now();
        assert!(matches!(
            connection.send(&[&frame], soon()),
            Err(Fault::Late)
        ));
        assert!(begin.elapsed() < Duration::from_secs(20));
        drop(connection);
        sipping.join().unwrap();
    }

    #[test]
    fn lines_end_where_they_end_and_nothing_follows_them() {
        let (mut connection, mut theirs) = pair();
        let mut say = |bytes: &[u8]| theirs.write_all(bytes).unwrap();
        say(b"{}\n");
        assert_eq!(connection.read_line(soon()).unwrap(), b"{}");
        connection.is_silent().unwrap();
        say(b"a\nb");
        assert!(matches!(connection.read_line(soon()), Err(Fault::Unasked(more)) if more == b"b"));
        say(b"c");
        assert!(matches!(connection.is_silent(), Err(Fault::Unasked(_))));
        say(&[b'x'; LINE_BYTES_MAX]);
        say(b"\n");
        assert_eq!(connection.read_line(soon()).unwrap().len(), LINE_BYTES_MAX);
        say(&[b'x'; LINE_BYTES_MAX + 1]);
        assert!(matches!(
            connection.read_line(soon()),
            Err(Fault::Endless(_))
        ));
        drop(theirs);
        assert!(matches!(connection.is_silent(), Err(Fault::Closed)));
        assert!(matches!(
            connection.send(&[b"x"], soon()),
            Err(Fault::Closed)
        ));
    }
}
