//! Built kernels, kept on disk from one start to the next, so that a second start compiles nothing.
//!
//! The driver says what it keeps, and checks itself whether it can use it again. A file is named
//! after the device and the driver's UUID: another driver finds none. A file that is damaged, or
//! that says it belongs to another driver, is ignored and written anew.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use ash::vk;
use xxhash_rust::xxh3::xxh3_64;

/// Begins every file.
const MAGIC: [u8; 8] = *b"DGSKERN1";
/// Magic, length and hash of what follows, little-endian.
const HEADER_BYTES: usize = 24;
/// Largest size of a file that is read, bytes.
const BYTES_MAX: usize = 64 << 20;
/// Bytes of `VkPipelineCacheHeaderVersionOne`, which what a driver keeps begins with.
const DRIVER_HEADER_BYTES: usize = 32;

/// Folder in which built kernels are kept.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum KernelCache {
    /// Folder `decouplegs/kernels` of the user's folder for caches (`XDG_CACHE_HOME`, else `.cache`
    /// in `HOME`); nowhere without one.
    #[default]
    User,
    /// Folder at this path, which is made if it does not exist.
    Folder(PathBuf),
    /// Kernels are not kept.
    Off,
}

impl KernelCache {
    fn folder(&self) -> Option<PathBuf> {
        let absolute = |name: &str| {
            std::env::var_os(name)
                .map(PathBuf::from)
                .filter(|path| path.is_absolute())
        };
        match self {
            Self::User => {
                let caches = absolute("XDG_CACHE_HOME")
                    .or_else(|| absolute("HOME").map(|home| home.join(".cache")));
                caches.map(|caches| caches.join("decouplegs/kernels"))
            }
            Self::Folder(folder) => Some(folder.clone()),
            Self::Off => None,
        }
    }
}

/// Numbers of kernels: all that were built, and those of them that were not compiled again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KernelCounts {
    /// Kernels that were built.
    pub built: u32,
    /// Number of kernels that the driver found in the cache, if it reports that.
    pub found: u32,
}

/// Pipeline cache of an open device, and its file.
pub(crate) struct PipelineStore {
    pub(crate) cache: vk::PipelineCache,
    path: Option<PathBuf>,
    /// Hash of what was read; None where nothing was.
    read_hash: Option<u64>,
    built: AtomicU32,
    found: AtomicU32,
}

impl PipelineStore {
    /// Makes the store of `device`, with what `kept` holds for it. Without a file, or where the
    /// driver does not take it, the store is empty.
    pub(crate) fn open(
        device: &ash::Device,
        properties: &vk::PhysicalDeviceProperties,
        kept: &KernelCache,
    ) -> Self {
        let identity = Identity::new(properties);
        let path = kept
            .folder()
            .map(|folder| folder.join(identity.file_name()));
        let data = path
            .as_deref()
            .and_then(read)
            .filter(|data| identity.owns(data));
        let make = |data: &[u8]| {
            let create = vk::PipelineCacheCreateInfo::default().initial_data(data);
            // SAFETY: `data` outlives the call, and is empty or begins with the header of this very
            // driver, which checks the rest.
            unsafe { device.create_pipeline_cache(&create, None) }
        };
        let read = data
            .as_deref()
            .and_then(|data| Some((make(data).ok()?, Some(xxh3_64(data)))));
        // Without a cache kernels are built all the same.
        let (cache, read_hash) = read.unwrap_or_else(|| (make(&[]).unwrap_or_default(), None));
        Self {
            cache,
            path,
            read_hash,
            built: AtomicU32::new(0),
            found: AtomicU32::new(0),
        }
    }

    /// Notes a kernel that was built, and whether the driver had it.
    pub(crate) fn count(&self, feedback: vk::PipelineCreationFeedbackFlags) {
        use vk::PipelineCreationFeedbackFlags as Flags;
        let found = feedback.contains(Flags::VALID | Flags::APPLICATION_PIPELINE_CACHE_HIT);
        self.built.fetch_add(1, Ordering::Relaxed);
        self.found.fetch_add(u32::from(found), Ordering::Relaxed);
    }

    pub(crate) fn counts(&self) -> KernelCounts {
        KernelCounts {
            built: self.built.load(Ordering::Relaxed),
            found: self.found.load(Ordering::Relaxed),
        }
    }

    /// True if what it began with came from a file.
    pub(crate) fn was_read(&self) -> bool {
        self.read_hash.is_some()
    }

    /// Writes what is new to the file, and ends. A file that cannot be written costs the next start
    /// some time, and nothing else.
    pub(crate) fn close(&self, device: &ash::Device) {
        if self.counts().built > 0 && self.cache != vk::PipelineCache::null() {
            // SAFETY: the cache is of this device and live.
            let data = unsafe { device.get_pipeline_cache_data(self.cache) };
            if let (Some(path), Ok(data)) = (&self.path, data)
                && self.read_hash != Some(xxh3_64(&data))
            {
                let _ = write(path, &data);
            }
        }
        // SAFETY: made from this device, destroyed once, and nothing is built any more; null is
        // allowed.
        unsafe { device.destroy_pipeline_cache(self.cache, None) };
    }
}

/// Device and driver that built kernels belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Identity {
    vendor: u32,
    device: u32,
    /// Changes with the driver.
    uuid: [u8; 16],
}

impl Identity {
    fn new(properties: &vk::PhysicalDeviceProperties) -> Self {
        Self {
            vendor: properties.vendor_id,
            device: properties.device_id,
            uuid: properties.pipeline_cache_uuid,
        }
    }

    fn file_name(&self) -> String {
        let uuid: String = self.uuid.iter().map(|byte| format!("{byte:02x}")).collect();
        format!("{:04x}-{:04x}-{uuid}", self.vendor, self.device)
    }

    /// True if `data` says that it comes from this driver (Vulkan specification,
    /// `VkPipelineCacheHeaderVersionOne`).
    fn owns(&self, data: &[u8]) -> bool {
        let word = |at: usize| {
            data.get(4 * at..4 * at + 4)
                .and_then(|bytes| bytes.try_into().ok())
                .map(u32::from_le_bytes)
        };
        data.len() >= DRIVER_HEADER_BYTES
            && word(0).is_some_and(|bytes| bytes as usize >= DRIVER_HEADER_BYTES)
            && word(1) == Some(1)
            && word(2) == Some(self.vendor)
            && word(3) == Some(self.device)
            && data[16..DRIVER_HEADER_BYTES] == self.uuid
    }
}

/// Content of the file at `path`, without its header. None if the file is absent, damaged or too
/// large.
fn read(path: &Path) -> Option<Vec<u8>> {
    let file = File::open(path).ok()?;
    let metadata = file.metadata().ok()?;
    if !metadata.is_file() || metadata.len() > (BYTES_MAX + HEADER_BYTES) as u64 {
        return None;
    }
    let mut bytes = Vec::new();
    file.take((BYTES_MAX + HEADER_BYTES) as u64)
        .read_to_end(&mut bytes)
        .ok()?;
    unpack(&bytes).map(<[u8]>::to_vec)
}

/// Writes the file at `path`, whole or not at all.
fn write(path: &Path, data: &[u8]) -> std::io::Result<()> {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else {
        return Ok(());
    };
    if data.len() > BYTES_MAX {
        return Ok(());
    }
    fs::create_dir_all(folder)?;
    let unfinished = folder.join(format!(
        ".{}.{}",
        name.to_string_lossy(),
        std::process::id()
    ));
    let written = File::create(&unfinished).and_then(|mut file| file.write_all(&pack(data)));
    let renamed = written.and_then(|()| fs::rename(&unfinished, path));
    if renamed.is_err() {
        let _ = fs::remove_file(&unfinished);
    }
    renamed
}

fn pack(data: &[u8]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend((data.len() as u64).to_le_bytes());
    bytes.extend(xxh3_64(data).to_le_bytes());
    bytes.extend(data);
    bytes
}

fn unpack(bytes: &[u8]) -> Option<&[u8]> {
    let (header, data) = bytes.split_at_checked(HEADER_BYTES)?;
    let word = |at: usize| {
        header
            .get(at..at + 8)
            .and_then(|bytes| bytes.try_into().ok())
            .map(u64::from_le_bytes)
    };
    let is_whole = header.starts_with(&MAGIC)
        && word(8) == Some(data.len() as u64)
        && word(16) == Some(xxh3_64(data));
    is_whole.then_some(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DRIVER: Identity = Identity {
        vendor: 0x10de,
        device: 0x2335,
        uuid: *b"driver 580.159.0",
    };

    fn kept() -> Vec<u8> {
        let words = [32, 1, DRIVER.vendor, DRIVER.device].map(u32::to_le_bytes);
        [words.as_flattened(), &DRIVER.uuid, b"built kernels"].concat()
    }

    #[test]
    fn another_driver_or_device_is_not_given_it() {
        assert!(DRIVER.owns(&kept()));
        for other in [
            Identity {
                vendor: 1,
                ..DRIVER
            },
            Identity {
                device: 1,
                ..DRIVER
            },
            Identity {
                uuid: [7; 16],
                ..DRIVER
            },
        ] {
            assert!(!other.owns(&kept()));
            assert_ne!(other.file_name(), DRIVER.file_name());
        }
        assert!((0..DRIVER_HEADER_BYTES).all(|bytes| !DRIVER.owns(&kept()[..bytes])));
    }

    proptest! {
        #[test]
        fn what_was_damaged_is_nothing(data in prop::collection::vec(any::<u8>(), 0..200), at in any::<prop::sample::Index>(), bit in 0u8..8) {
            let packed = pack(&data);
            prop_assert_eq!(unpack(&packed), Some(&data[..]));
            let mut damaged = packed.clone();
            damaged[at.index(packed.len())] ^= 1 << bit;
            prop_assert_eq!(unpack(&damaged), None);
            prop_assert_eq!(unpack(&packed[..at.index(packed.len())]), None);
            damaged = [&packed[..], &[0]].concat();
            prop_assert_eq!(unpack(&damaged), None);
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_no_failure() {
        let file = std::env::temp_dir().join(format!("decouplegs-kernels-{}", std::process::id()));
        fs::write(&file, b"no folder").unwrap();
        assert!(write(&file.join("kernels"), &kept()).is_err());
        assert_eq!(read(&file.join("kernels")), None);
        assert_eq!(read(&file), None);
        fs::remove_file(&file).unwrap();
    }
}
