//! Memory limits, in one place: small files must not ask for large memory, and large scenes must
//! fit before they are expanded.
//!
//! A failed allocation ends a Rust program with SIGABRT. Code that expands its input therefore asks
//! [`require`] first and gets a sentence instead.

use decouplegs_scene::{Invalid, sh};

/// Most splats of one world after agents are placed in it. The renderer numbers splats with 27
/// bits.
pub const SPLATS_MAX: u64 = 1 << 27;

/// Bytes that a decoder may take however small the file is.
const DECODED_BYTES_ALWAYS: u64 = 64 << 20;
/// Further bytes that a decoder may take for each byte of the file.
pub(crate) const DECODED_BYTES_PER_FILE_BYTE: u64 = 8;
/// Share of the free memory that one request may take, in percent. The rest is for buffers that
/// nobody counts.
const SHARE_PERCENT: u64 = 90;

/// Memory of `splats` splats of degree `sh_degree` in a [`decouplegs_scene::SplatCloud`], bytes.
#[must_use]
pub fn cloud_bytes(splats: u64, sh_degree: u8) -> u64 {
    // Mean, scale, rotation and opacity are 11 floats; each coefficient is 3.
    splats.saturating_mul(4 * (11 + 3 * sh::coefficient_count(sh_degree) as u64))
}

/// Largest size of the decoded splats of a file of `file_bytes`, bytes.
pub(crate) fn decoded_bytes_max(file_bytes: usize) -> u64 {
    DECODED_BYTES_ALWAYS + DECODED_BYTES_PER_FILE_BYTE * file_bytes as u64
}

/// Checks that `what` may take `bytes` of memory now. `what` begins the sentence, as in "a
/// background of 5 splats".
///
/// # Errors
/// A sentence with the bytes needed and the bytes free.
pub fn require(what: &str, bytes: u64) -> Result<(), Invalid> {
    Ok(require_of(what, bytes, free_bytes())?)
}

/// [`require`] for numbers that multiply: `counts` of each other, and `bytes_each` for each of all.
/// Files and arguments state the numbers one by one, and each may be harmless.
///
/// # Errors
/// Returns the errors of [`require`]; a product of more than 64 bits is beyond every memory.
pub fn require_product(what: &str, counts: &[u64], bytes_each: u64) -> Result<(), Invalid> {
    require(
        what,
        counts.iter().copied().fold(bytes_each, u64::saturating_mul),
    )
}

fn require_of(what: &str, bytes: u64, free: Option<u64>) -> Result<(), String> {
    match free {
        Some(free) if bytes > free / 100 * SHARE_PERCENT => Err(format!(
            "{what} needs about {} of memory, and {} are free: use fewer or smaller inputs, or a machine with more memory",
            mebibytes(bytes),
            mebibytes(free)
        )),
        _ => Ok(()),
    }
}

fn mebibytes(bytes: u64) -> String {
    format!("{} MiB", bytes.div_ceil(1 << 20))
}

/// Memory that this process may still take: what the system has free, less if a limit of address
/// space (`ulimit -v`) or of the control group is nearer. None where the system does not say.
fn free_bytes() -> Option<u64> {
    let system = std::fs::read_to_string("/proc/meminfo")
        .ok()
        .and_then(|text| available_of(&text));
    [system, below_address_limit(), below_group_limit()]
        .into_iter()
        .flatten()
        .min()
}

/// `MemAvailable` of /proc/meminfo, bytes.
fn available_of(meminfo: &str) -> Option<u64> {
    let line = meminfo
        .lines()
        .find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim()
        .strip_suffix("kB")?
        .trim()
        .parse::<u64>()
        .ok()
        .map(|kibibytes| kibibytes * 1024)
}

fn below_address_limit() -> Option<u64> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::As).current?;
    let pages = std::fs::read_to_string("/proc/self/statm")
        .ok()?
        .split(' ')
        .next()?
        .parse::<u64>()
        .ok()?;
    Some(limit.saturating_sub(pages * rustix::param::page_size() as u64))
}

fn below_group_limit() -> Option<u64> {
    let number = |name: &str| {
        std::fs::read_to_string(format!("/sys/fs/cgroup/{name}"))
            .ok()?
            .trim()
            .parse::<u64>()
            .ok()
    };
    Some(number("memory.max")?.saturating_sub(number("memory.current")?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_beyond_the_free_memory_is_a_sentence() {
        assert_eq!(require_of("a cloud", 900, Some(1000)), Ok(()));
        assert_eq!(require_of("a cloud", u64::MAX, None), Ok(()));
        let message = require_of("a cloud", 2 << 30, Some(1 << 30)).unwrap_err();
        assert!(
            message.starts_with("a cloud needs about 2048 MiB of memory, and 1024 MiB are free"),
            "{message}"
        );
    }

    #[test]
    fn this_system_tells_its_free_memory() {
        assert_eq!(
            available_of("MemTotal: 9 kB\nMemAvailable:   24 kB\n"),
            Some(24 * 1024)
        );
        assert_eq!(available_of("MemTotal: 9 kB\n"), None);
        #[cfg(target_os = "linux")]
        assert!(free_bytes().is_some_and(|bytes| bytes > 1 << 20));
        assert!(require("everything", u64::MAX).is_err());
        assert!(require_product("all squares of all boxes", &[1 << 20, 1 << 16], 1 << 10).is_err());
        assert!(require_product("more than a number", &[1 << 40, 1 << 40], 24).is_err());
        assert!(require_product("nothing", &[1 << 40, 0, 1 << 40], 24).is_ok());
    }

    #[test]
    fn a_splat_of_degree_3_takes_59_floats() {
        assert_eq!(cloud_bytes(1, 3), 59 * 4);
        assert_eq!(cloud_bytes(u64::MAX, 0), u64::MAX);
    }
}
