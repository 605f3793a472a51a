//! Dropping of large values beside other work.

use std::thread::Builder;

/// Drops `value` on another thread: the operating system takes a gigabyte back in a tenth of a
/// second.
///
/// Without a thread for it, `value` is dropped before this returns.
pub fn release<T: Send + 'static>(value: T) {
    // A thread that does not start drops what it was given.
    let _ = Builder::new()
        .name("release".into())
        .spawn(move || drop(value));
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::time::Duration;

    use super::release;

    #[test]
    fn what_is_released_is_dropped() {
        let (sender, receiver) = channel::<()>();
        release((vec![0u8; 1 << 20], sender));
        // The last sender is gone.
        let ended = receiver.recv_timeout(Duration::from_secs(60));
        assert_eq!(ended, Err(std::sync::mpsc::RecvTimeoutError::Disconnected));
    }
}
