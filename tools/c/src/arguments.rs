//! Conversion of C's pointers to Rust's types, once, when a call begins.
//!
//! All functions here trust one thing, which the header asks for and no library can see: a pointer
//! that is not NULL points to as much as its type and count say, for as long as the call lasts, and
//! nobody changes it meanwhile. That is what `unsafe` means below.

use std::ffi::{CStr, c_char};
use std::marker::PhantomData;

use crate::status::{DgsStatus, Failure};

/// Bytes of a struct that no version will need.
const STRUCT_BYTES_MAX: usize = 4096;

/// A pointer through which the caller wants a value written.
pub struct Out<'a, T> {
    pointer: *mut T,
    caller: PhantomData<&'a mut T>,
}

impl<T> Out<'_, T> {
    pub fn write(self, value: T) {
        // SAFETY: the creator of this promised that the pointer is valid for writes, and it
        // was seen to be aligned.
        unsafe { self.pointer.write(value) };
    }
}

/// Checks that `pointer` may point to a value of type `T`.
fn check<T>(what: &str, pointer: *const T) -> Result<(), Failure> {
    if pointer.is_null() {
        return Err(Failure::argument(format!("{what} is NULL")));
    }
    if !pointer.is_aligned() {
        let text = format!(
            "{what} is {pointer:?}, which is not aligned to {} bytes",
            align_of::<T>()
        );
        return Err(Failure::argument(text));
    }
    Ok(())
}

/// Output location for the argument `what`.
///
/// # Safety
/// `pointer` is as the header asks.
pub unsafe fn out<'a, T>(what: &str, pointer: *mut T) -> Result<Out<'a, T>, Failure> {
    check(what, pointer)?;
    Ok(Out {
        pointer,
        caller: PhantomData,
    })
}

/// Output location for a handle; it is set to NULL first.
///
/// # Safety
/// `pointer` is as the header asks.
pub unsafe fn out_handle<'a, T>(
    what: &str,
    pointer: *mut *mut T,
) -> Result<Out<'a, *mut T>, Failure> {
    check(what, pointer)?;
    // SAFETY: promised to be the caller's to be written, and seen to be aligned.
    unsafe { pointer.write(std::ptr::null_mut()) };
    Ok(Out {
        pointer,
        caller: PhantomData,
    })
}

/// `count` structs; the pointer may be NULL where there are none.
///
/// # Safety
/// `first` is as the header asks, and every pattern of bits is a `T`.
pub unsafe fn array<'a, T>(what: &str, first: *const T, count: usize) -> Result<&'a [T], Failure> {
    if count == 0 {
        return Ok(&[]);
    }
    check(what, first)?;
    if count > isize::MAX as usize / size_of::<T>().max(1) {
        return Err(Failure::argument(format!(
            "{count} {what} are more than memory has"
        )));
    }
    // SAFETY: not NULL, aligned, of a length that an allocation can have, and promised to be there.
    Ok(unsafe { std::slice::from_raw_parts(first, count) })
}

/// One struct.
///
/// # Safety
/// `pointer` is as the header asks, and every pattern of bits is a `T`.
pub unsafe fn one<T: Copy>(what: &str, pointer: *const T) -> Result<T, Failure> {
    check(what, pointer)?;
    // SAFETY: not NULL, aligned, and promised to be there.
    Ok(unsafe { pointer.read() })
}

/// A text.
///
/// # Safety
/// `first` is as the header asks.
pub unsafe fn text<'a>(what: &str, first: *const c_char) -> Result<&'a str, Failure> {
    check(what, first)?;
    // SAFETY: promised to end with a NUL.
    let bytes = unsafe { CStr::from_ptr(first) };
    bytes.to_str().map_err(|error| {
        Failure::argument(format!(
            "{what} is not UTF-8 from byte {} on",
            error.valid_up_to()
        ))
    })
}

/// Copies `text` and a NUL to `buffer`, and its length to `length` unless that is NULL. Without a
/// buffer, the length alone.
///
/// # Safety
/// `buffer` and `length` are as the header asks.
pub unsafe fn give_text(
    text: &str,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> Result<(), Failure> {
    if !length.is_null() {
        // SAFETY: promised by our caller.
        unsafe { out("length", length) }?.write(text.len());
    }
    if buffer.is_null() && capacity == 0 {
        return Ok(());
    }
    check("buffer", buffer)?;
    if capacity <= text.len() {
        let needs = format!(
            "{text:?} and its NUL are {} bytes, the buffer has {capacity}",
            text.len() + 1
        );
        return Err(Failure::new(DgsStatus::TooSmall, needs));
    }
    // SAFETY: the buffer is promised to have `capacity` bytes, which is more than the text has.
    unsafe {
        std::ptr::copy_nonoverlapping(text.as_ptr(), buffer.cast(), text.len());
        buffer.add(text.len()).write(0);
    }
    Ok(())
}

/// A struct that begins with its size, as a `u32`, and may have got fields since the caller was
/// compiled: those that it lacks are as in `default`. Fields that we lack must be zero, for we
/// could not heed them.
///
/// # Safety
/// `pointer` points to as many bytes as the first four of them say, and every pattern of bits is a
/// `T`.
pub unsafe fn growing<T: Copy>(
    what: &str,
    pointer: *const T,
    first_bytes: usize,
    default: T,
) -> Result<T, Failure> {
    check(what, pointer)?;
    // SAFETY: not NULL, aligned, and promised to begin with its size.
    let theirs = unsafe { struct_bytes::<T>(what, pointer, first_bytes) }?;
    let ours = size_of::<T>();
    // SAFETY: as many bytes are there as the size says.
    let beyond = unsafe {
        std::slice::from_raw_parts(
            pointer.cast::<u8>().add(theirs.min(ours)),
            theirs.saturating_sub(ours),
        )
    };
    if beyond.iter().any(|&byte| byte != 0) {
        let text = format!(
            "{what} has fields that this version of the library ({ours} bytes) does not know: leave them zero"
        );
        return Err(Failure::new(DgsStatus::Unsupported, text));
    }
    let mut value = default;
    // SAFETY: neither is written beyond its end, and the value is ours alone.
    unsafe {
        std::ptr::copy_nonoverlapping(
            pointer.cast::<u8>(),
            (&raw mut value).cast(),
            theirs.min(ours),
        );
    };
    Ok(value)
}

/// Writes `value` to a struct that begins with its size, as far as that goes; what it has beyond
/// becomes zero.
///
/// # Safety
/// `pointer` points to as many bytes as the first four of them say.
pub unsafe fn give_growing<T: Copy>(
    what: &str,
    pointer: *mut T,
    first_bytes: usize,
    value: &T,
) -> Result<(), Failure> {
    const SIZE_BYTES: usize = size_of::<u32>();
    check(what, pointer)?;
    // SAFETY: not NULL, aligned, and promised to begin with its size.
    let theirs = unsafe { struct_bytes::<T>(what, pointer, first_bytes) }?;
    let written = theirs.min(size_of::<T>());
    // SAFETY: neither is touched beyond its end. The size itself stays as it is.
    unsafe {
        let (to, from) = (pointer.cast::<u8>(), std::ptr::from_ref(value).cast::<u8>());
        std::ptr::copy_nonoverlapping(
            from.add(SIZE_BYTES),
            to.add(SIZE_BYTES),
            written - SIZE_BYTES,
        );
        to.add(written).write_bytes(0, theirs - written);
    }
    Ok(())
}

/// The size with which the struct at `pointer` begins.
///
/// # Safety
/// `pointer` points to a `u32` at least, and is aligned for it.
unsafe fn struct_bytes<T>(
    what: &str,
    pointer: *const T,
    first_bytes: usize,
) -> Result<usize, Failure> {
    // SAFETY: promised by our caller.
    let bytes = unsafe { pointer.cast::<u32>().read() } as usize;
    if !(first_bytes..=STRUCT_BYTES_MAX).contains(&bytes) {
        let text = format!(
            "struct_bytes of {what} is {bytes}: set it to sizeof the struct, {} in this version",
            size_of::<T>()
        );
        return Err(Failure::argument(text));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Version 1 had no `b`, version 2 has.
    #[repr(C)]
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Two {
        struct_bytes: u32,
        a: u32,
        b: u32,
    }

    const FIRST_BYTES: usize = 8;
    const DEFAULT: Two = Two {
        struct_bytes: 12,
        a: 1,
        b: 2,
    };

    fn read(words: &[u32]) -> Result<Two, Failure> {
        // SAFETY: the tests write no size that is beyond the words.
        unsafe { growing("two", words.as_ptr().cast(), FIRST_BYTES, DEFAULT) }
    }

    #[test]
    fn older_and_newer_programs_are_understood() {
        assert_eq!(
            read(&[8, 5]).unwrap(),
            Two {
                struct_bytes: 8,
                a: 5,
                b: 2
            }
        );
        assert_eq!(
            read(&[12, 5, 6]).unwrap(),
            Two {
                struct_bytes: 12,
                a: 5,
                b: 6
            }
        );
        assert_eq!(read(&[16, 5, 6, 0]).unwrap().b, 6);
        assert_eq!(
            read(&[16, 5, 6, 7]).unwrap_err().status,
            DgsStatus::Unsupported
        );
        for bytes in [0, 4, 7, 4097, u32::MAX] {
            let refused = read(&[bytes, 5]).unwrap_err();
            assert!(
                refused
                    .message
                    .contains(&format!("struct_bytes of two is {bytes}")),
                "{}",
                refused.message
            );
        }
    }

    #[test]
    fn what_is_given_fills_what_there_is() {
        let mut words = [[8, 9, 9, 9], [12, 9, 9, 9], [16, 9, 9, 9], [3, 9, 9, 9]];
        let given = words.each_mut().map(|words| {
            // SAFETY: the sizes are within the words.
            unsafe { give_growing("two", words.as_mut_ptr().cast(), FIRST_BYTES, &DEFAULT) }.is_ok()
        });
        assert_eq!(given, [true, true, true, false]);
        assert_eq!(
            words,
            [[8, 1, 9, 9], [12, 1, 2, 9], [16, 1, 2, 0], [3, 9, 9, 9]]
        );
    }

    #[test]
    fn text_is_given_whole_or_not_at_all() {
        let mut buffer = [1; 5];
        let mut length = 0;
        let mut give = |text: &str, capacity| {
            // SAFETY: no capacity below is beyond the buffer.
            unsafe { give_text(text, buffer.as_mut_ptr(), capacity, &mut length) }
                .map_err(|failure| failure.status)
        };
        assert_eq!(
            [give("abcd", 4), give("abcde", 5)],
            [Err(DgsStatus::TooSmall); 2]
        );
        assert_eq!(give("abcd", 5), Ok(()));
        assert_eq!(give("", 1), Ok(()));
        assert_eq!((buffer.map(|byte| byte as u8), length), (*b"\0bcd\0", 0));
        // SAFETY: nothing is written.
        unsafe { give_text("abc", std::ptr::null_mut(), 0, &mut length) }.unwrap();
        assert_eq!(length, 3);
        // SAFETY: nothing is written.
        let nowhere = unsafe { give_text("abc", std::ptr::null_mut(), 9, std::ptr::null_mut()) };
        assert_eq!(nowhere.unwrap_err().status, DgsStatus::InvalidArgument);
    }

    #[test]
    fn pointers_that_cannot_be_are_refused() {
        let words = [0_u64; 2];
        // SAFETY: neither pointer is followed.
        let (crooked, endless) = unsafe {
            (
                one("word", words.as_ptr().wrapping_byte_add(1)),
                array("words", words.as_ptr(), usize::MAX),
            )
        };
        assert!(
            crooked
                .unwrap_err()
                .message
                .contains("not aligned to 8 bytes")
        );
        assert!(
            endless
                .unwrap_err()
                .message
                .contains("more than memory has")
        );
        // SAFETY: the text ends with a NUL.
        let broken = unsafe { text("name", c"ab\xff".as_ptr()) };
        assert!(
            broken
                .unwrap_err()
                .message
                .contains("not UTF-8 from byte 2 on")
        );
    }
}
