//! Entry and exit of every call from C.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use decouplegs::explain::one_line;

use crate::status::{DgsStatus, Failure};

/// The version of functions and structs that this header describes.
pub const DGS_ABI_VERSION: u32 = 1;

thread_local! {
    /// Message of the thread's last call.
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// Context of a call: the handles that it uses.
#[derive(Default)]
pub struct Call {
    poison: Vec<Arc<AtomicBool>>,
}

impl Call {
    /// Marks the handle with this flag as unusable if the call panics from here on.
    pub fn uses(&mut self, poison: Arc<AtomicBool>) {
        self.poison.push(poison);
    }
}

/// Does the work of a call. No panic leaves it: what it was working with is poisoned instead, for
/// nobody knows in what state it is.
pub fn guarded(work: impl FnOnce(&mut Call) -> Result<(), Failure>) -> DgsStatus {
    let mut call = Call::default();
    let outcome = catch_unwind(AssertUnwindSafe(|| work(&mut call))).unwrap_or_else(|panic| {
        call.poison
            .iter()
            .for_each(|poison| poison.store(true, Ordering::Relaxed));
        Err(Failure::new(
            DgsStatus::Panic,
            format!("a fault of the library: {}", said(&*panic)),
        ))
    });
    let (status, message) = match outcome {
        Ok(()) => (DgsStatus::Ok, String::new()),
        Err(failure) => (failure.status, failure.message),
    };
    remember(message);
    status
}

/// Message of a panic.
fn said(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("it did not say which")
}

fn remember(mut message: String) {
    message.retain(|character| character != '\0');
    let message = one_line(&message);
    // A thread that is ending has no place for it any more, and nobody who would ask.
    let _ = LAST_ERROR.try_with(|last| last.replace(CString::new(message).unwrap_or_default()));
}

/// Message of the last call of this thread that returned a DgsStatus: a sentence, or empty text
/// after success. Never NULL. Valid until this thread's next such call.
#[unsafe(no_mangle)]
pub extern "C" fn dgs_last_error() -> *const c_char {
    LAST_ERROR
        .try_with(|last| last.borrow().as_ptr())
        .unwrap_or(c"".as_ptr())
}

/// The version of the library's functions and structs. Programs compare it with DGS_ABI_VERSION
/// before anything else.
#[unsafe(no_mangle)]
pub extern "C" fn dgs_abi_version() -> u32 {
    DGS_ABI_VERSION
}

/// The version of the library, such as "0.1.0". Valid for ever.
#[unsafe(no_mangle)]
pub extern "C" fn dgs_version() -> *const c_char {
    const VERSION: &CStr =
        match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
            Ok(text) => text,
            Err(_) => panic!("a version has no NUL"),
        };
    VERSION.as_ptr()
}

/// A status in a word or two, such as "invalid handle"; "unknown" for a number that is none. Valid
/// for ever.
#[unsafe(no_mangle)]
pub extern "C" fn dgs_status_name(status: i32) -> *const c_char {
    let known = usize::try_from(status)
        .ok()
        .and_then(|status| DgsStatus::ALL.get(status));
    known.map_or(c"unknown", |status| status.name()).as_ptr()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::handles::Registry;

    fn last_error() -> String {
        // SAFETY: the text is this thread's own, and no call comes between.
        unsafe { CStr::from_ptr(dgs_last_error()) }
            .to_str()
            .unwrap()
            .to_owned()
    }

    #[test]
    fn a_panic_becomes_a_status_and_poisons_what_was_in_use() {
        static NUMBERS: Registry<u32> = Registry::new("number");
        let [used, unused] = [7, 8].map(|number| NUMBERS.add::<u32>(number));
        let failing = guarded(|call| {
            NUMBERS.find(call, used)?;
            panic!("the {}th of them", 13)
        });
        assert_eq!(failing, DgsStatus::Panic);
        assert!(
            last_error().contains("the 13th of them"),
            "{}",
            last_error()
        );
        assert_eq!(
            guarded(|call| NUMBERS.find(call, used).map(drop)),
            DgsStatus::Poisoned
        );
        assert!(last_error().contains("number"), "{}", last_error());
        assert_eq!(
            guarded(|call| NUMBERS
                .find(call, unused)
                .map(|number| assert_eq!(*number, 8))),
            DgsStatus::Ok
        );
        assert_eq!(last_error(), "", "success takes the sentence away");
        assert_eq!(
            guarded(|_| NUMBERS.close(used)),
            DgsStatus::Ok,
            "who is poisoned can still be closed"
        );
        assert_eq!(
            guarded(|call| NUMBERS.find(call, used).map(drop)),
            DgsStatus::InvalidHandle
        );
    }

    #[test]
    fn a_panic_may_carry_anything() {
        assert_eq!(guarded(|_| std::panic::panic_any(13_u8)), DgsStatus::Panic);
        assert!(last_error().contains("did not say"));
        assert_eq!(
            guarded(|_| Err(Failure::argument("a\0b"))),
            DgsStatus::InvalidArgument
        );
        assert_eq!(last_error(), "ab");
    }

    #[test]
    fn statuses_have_their_numbers_and_names() {
        for (number, status) in DgsStatus::ALL.iter().enumerate() {
            assert_eq!(*status as usize, number);
        }
        let name = |status| {
            // SAFETY: names are static text.
            unsafe { CStr::from_ptr(dgs_status_name(status)) }
                .to_str()
                .unwrap()
        };
        assert_eq!(
            [name(0), name(13), name(14), name(-1), name(i32::MIN)],
            ["ok", "poisoned", "unknown", "unknown", "unknown"]
        );
    }
}
