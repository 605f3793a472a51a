//! Lines that vouch for each other: each begins with a checksum over the one before it and its own
//! payload.
//!
//! XXH3 (Collet, xxHash 0.8, 2021) finds accidents of any kind, not forgeries.

use xxhash_rust::xxh3::Xxh3Default;

/// Digits of a checksum, and the space behind it.
const PREFIX_BYTES: usize = 17;

/// The checksum of the last line, in text; that of no line before the first.
#[derive(Clone, Debug)]
pub(super) struct Chain {
    checksum: [u8; 16],
}

impl Chain {
    pub(super) fn new() -> Self {
        Self {
            checksum: [b'0'; 16],
        }
    }

    fn next_checksum(&self, payload: &[u8]) -> [u8; 16] {
        let mut hasher = Xxh3Default::new();
        hasher.update(&self.checksum);
        hasher.update(payload);
        let digits = format!("{:016x}", hasher.digest());
        digits
            .as_bytes()
            .try_into()
            .expect("64 bits are 16 hex digits")
    }

    /// The line of `payload`, its end included.
    pub(super) fn seal(&mut self, payload: &str) -> String {
        self.checksum = self.next_checksum(payload.as_bytes());
        let checksum = std::str::from_utf8(&self.checksum).expect("hex digits are ASCII");
        format!("{checksum} {payload}\n")
    }

    /// The payload of `line`, which has lost its end already.
    pub(super) fn open<'a>(&mut self, line: &'a [u8]) -> Result<&'a str, String> {
        let whole = line.len() >= PREFIX_BYTES && line[PREFIX_BYTES - 1] == b' ';
        if !whole {
            return Err("does not begin with a checksum of 16 hex digits and a space".into());
        }
        let payload = &line[PREFIX_BYTES..];
        let expected = self.next_checksum(payload);
        if line[..PREFIX_BYTES - 1] != expected {
            let expected = std::str::from_utf8(&expected).expect("hex digits are ASCII");
            let found = String::from_utf8_lossy(&line[..PREFIX_BYTES - 1]).into_owned();
            return Err(format!(
                "its checksum is {found:?}, expected \"{expected}\": it was changed, or does not belong behind the line before it"
            ));
        }
        self.checksum = expected;
        std::str::from_utf8(payload).map_err(|_| "is not UTF-8".into())
    }
}
