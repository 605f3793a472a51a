//! Handles: numbers that stand for what C programs hold.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{
    Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard, TryLockError,
};

use crate::boundary::Call;
use crate::status::{DgsStatus, Failure};

/// The next handle of any kind. Odd, so that none is ever equal to a pointer to something aligned;
/// none is given out twice.
static NEXT: AtomicUsize = AtomicUsize::new(1);

/// Objects behind the handles of one kind.
pub struct Registry<T> {
    /// The kind, as errors name it.
    kind: &'static str,
    held: Mutex<BTreeMap<usize, Held<T>>>,
}

struct Held<T> {
    object: Arc<T>,
    /// A call with it was stopped midway.
    poison: Arc<AtomicBool>,
}

impl<T> Registry<T> {
    pub const fn new(kind: &'static str) -> Self {
        Self {
            kind,
            held: Mutex::new(BTreeMap::new()),
        }
    }

    /// A handle for `object`, typed as the C program sees it.
    pub fn add<Handle>(&self, object: T) -> *mut Handle {
        let handle = NEXT.fetch_add(2, Ordering::Relaxed);
        self.lock().insert(
            handle,
            Held {
                object: Arc::new(object),
                poison: Arc::default(),
            },
        );
        std::ptr::without_provenance_mut(handle)
    }

    /// Object behind `handle`. It stays alive while it is used, even if it is closed.
    pub fn find<Handle>(&self, call: &mut Call, handle: *const Handle) -> Result<Arc<T>, Failure> {
        let held = self.lock();
        let found = held
            .get(&handle.addr())
            .ok_or_else(|| self.unknown(handle.addr()))?;
        if found.poison.load(Ordering::Relaxed) {
            let text = format!(
                "this {} was in a call that a fault of the library stopped midway: close it",
                self.kind
            );
            return Err(Failure::new(DgsStatus::Poisoned, text));
        }
        call.uses(found.poison.clone());
        Ok(found.object.clone())
    }

    /// Releases what `handle` stands for; of nothing where it is NULL.
    pub fn close<Handle>(&self, handle: *mut Handle) -> Result<(), Failure> {
        if handle.is_null() {
            return Ok(());
        }
        // Taken out under the lock and dropped without it: it may take a while.
        let held = self.lock().remove(&handle.addr());
        held.map(drop).ok_or_else(|| self.unknown(handle.addr()))
    }

    fn unknown(&self, handle: usize) -> Failure {
        let text = match handle {
            0 => format!("a {} was expected, found NULL", self.kind),
            _ => format!(
                "{handle:#x} is no {}: it was closed, or is something else",
                self.kind
            ),
        };
        Failure::new(DgsStatus::InvalidHandle, text)
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<usize, Held<T>>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Locks an object that one thread may use at a time. A second caller gets an error instead of a
/// wait: it made a mistake. There is no wait, because a second caller is a mistake.
///
/// Locks of the standard library are poisoned by panics too. That is passed over here: handles know
/// which calls were stopped midway.
pub fn alone<'a, T>(kind: &str, lock: &'a Mutex<T>) -> Result<MutexGuard<'a, T>, Failure> {
    free(kind, lock.try_lock())
}

/// Locks an object for reading; several threads may read it.
pub fn to_read<'a, T>(kind: &str, lock: &'a RwLock<T>) -> Result<RwLockReadGuard<'a, T>, Failure> {
    free(kind, lock.try_read())
}

/// Locks an object for changes.
pub fn to_change<'a, T>(
    kind: &str,
    lock: &'a RwLock<T>,
) -> Result<RwLockWriteGuard<'a, T>, Failure> {
    free(kind, lock.try_write())
}

fn free<Guard>(kind: &str, tried: Result<Guard, TryLockError<Guard>>) -> Result<Guard, Failure> {
    match tried {
        Ok(guard) => Ok(guard),
        Err(TryLockError::Poisoned(guard)) => Ok(guard.into_inner()),
        Err(TryLockError::WouldBlock) => Err(Failure::new(
            DgsStatus::Busy,
            format!("another thread is using this {kind}: use it from one at a time"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_never_given_out_is_refused() {
        static LEFT: Registry<u8> = Registry::new("left");
        static RIGHT: Registry<u8> = Registry::new("right");
        let (one, other) = (LEFT.add::<u8>(1), RIGHT.add::<u8>(2));
        let mut call = Call::default();
        let mut refused = |handle: *const u8| LEFT.find(&mut call, handle).unwrap_err();
        assert!(refused(other).message.contains("is no left"));
        assert!(refused(std::ptr::null()).message.contains("found NULL"));
        assert_eq!(refused(&7_u8).status, DgsStatus::InvalidHandle);
        LEFT.close(one).unwrap();
        assert_eq!(
            LEFT.close(one).unwrap_err().status,
            DgsStatus::InvalidHandle,
            "closed twice"
        );
        assert_eq!(refused(one).status, DgsStatus::InvalidHandle);
        assert_ne!(LEFT.add::<u8>(3), one, "no handle is given out twice");
        LEFT.close::<u8>(std::ptr::null_mut()).unwrap();
    }

    #[test]
    fn who_is_in_use_outlives_its_handle() {
        static TEXTS: Registry<String> = Registry::new("text");
        let handle = TEXTS.add::<u8>("here".into());
        let mut call = Call::default();
        let text = TEXTS.find(&mut call, handle).unwrap();
        TEXTS.close(handle).unwrap();
        assert_eq!(*text, "here");
    }

    #[test]
    fn who_comes_second_is_told_so() {
        let busy = |failure: Failure| {
            failure.status == DgsStatus::Busy && failure.message.contains("this thing")
        };
        let one = Mutex::new(1);
        let held = alone("thing", &one).unwrap();
        assert!(alone("thing", &one).is_err_and(busy));
        drop(held);
        assert_eq!(*alone("thing", &one).unwrap(), 1);

        let many = RwLock::new(2);
        let readers = [
            to_read("thing", &many).unwrap(),
            to_read("thing", &many).unwrap(),
        ];
        assert!(to_change("thing", &many).is_err_and(busy));
        drop(readers);
        let writer = to_change("thing", &many).unwrap();
        assert!(
            to_read("thing", &many).is_err_and(busy) && to_change("thing", &many).is_err_and(busy)
        );
        drop(writer);
        assert_eq!(*to_read("thing", &many).unwrap(), 2);
    }
}
