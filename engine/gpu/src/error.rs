//! Errors of the environment, as sentences: expected, found, remedy.

use ash::vk;
use thiserror::Error;

/// A failure that the program did not cause: a missing driver, a device that cannot do the work,
/// memory used up, a device lost.
///
/// Wrong programs (a binding name that the shader does not have, a push constant of the wrong size)
/// assert instead.
#[derive(Clone, Debug, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// The Vulkan loader library could not be opened.
    #[error(
        "no Vulkan loader found ({detail}): install libvulkan1 and a driver (on Debian or Ubuntu: apt-get install libvulkan1 mesa-vulkan-drivers)"
    )]
    LoaderMissing {
        /// Message of the operating system.
        detail: String,
    },
    /// Validation was asked for and its layer is not installed.
    #[error(
        "validation was asked for but VK_LAYER_KHRONOS_validation is not installed: install vulkan-validationlayers, or open the device without validation"
    )]
    ValidationMissing,
    /// The loader works and no driver offers a device.
    #[error(
        "no Vulkan device found: install a driver (mesa-vulkan-drivers has one that runs on the CPU) or check VK_ICD_FILENAMES"
    )]
    NoDevice,
    /// The device asked for is not among those found.
    #[error("no device matches {wanted}: found {found}")]
    UnknownDevice {
        /// The choice, as text.
        wanted: String,
        /// The devices found, as text.
        found: String,
    },
    /// The device, or its driver, lacks something that is needed.
    #[error(
        "{device} lacks {feature}, which {needed_by} needs: choose another device or update its driver"
    )]
    MissingFeature {
        /// The device's name.
        device: String,
        /// The feature or extension, by its Vulkan name.
        feature: String,
        /// Name of the part that needs it.
        needed_by: String,
    },
    /// A buffer longer than a shader may bind on this device.
    #[error(
        "buffer {name}: {wanted_bytes} bytes wanted, but a storage buffer has at most {limit_bytes} bytes on this device: draw smaller images or fewer splats, or choose another device"
    )]
    BufferTooLarge {
        /// The buffer's name.
        name: &'static str,
        /// Requested length.
        wanted_bytes: u64,
        /// The device's `maxStorageBufferRange`.
        limit_bytes: u64,
    },
    /// A file of kernels that replace the program's cannot be used.
    #[error("{}: {reason}", path.display())]
    Trial {
        /// The file or folder.
        path: std::path::PathBuf,
        /// Expected and found.
        reason: String,
    },
    /// The device has no memory left.
    #[error(
        "out of device memory: buffer {name} ({purpose}) wants {wanted_bytes} bytes, in use are {used_bytes} bytes ({used_by_purpose}) of a heap of {heap_bytes} bytes: render less or choose a device with more memory"
    )]
    OutOfMemory {
        /// The buffer's name.
        name: &'static str,
        /// Allocation tag of the buffer.
        purpose: &'static str,
        /// Requested size.
        wanted_bytes: u64,
        /// Total size of all buffers of this device.
        used_bytes: u64,
        /// Size of those buffers by purpose, as text.
        used_by_purpose: String,
        /// The largest device-local heap.
        heap_bytes: u64,
    },
    /// A kernel that this device cannot run, or a module that cannot be reflected.
    #[error("kernel {kernel}: {reason}")]
    Kernel {
        /// The kernel's name.
        kernel: &'static str,
        /// Reason, a sentence.
        reason: String,
    },
    /// The device was opened by another process, of which this one is a fork.
    #[error(
        "the device was opened before the process forked, and a driver's threads are not copied: open it in the child, or start children by spawn instead of fork"
    )]
    Forked,
    /// The device stopped answering for good.
    #[error(
        "device lost during {during}; {progress}. Most likely a kernel read or wrote out of bounds, or ran too long"
    )]
    DeviceLost {
        /// The Vulkan call that said so.
        during: &'static str,
        /// The last stage known to have finished, where stages are timed, as a clause.
        progress: String,
    },
    /// Submitted work did not finish in a time that no frame takes.
    #[error(
        "device work did not finish within {seconds} s; {progress}. A kernel hangs, or the device is overloaded"
    )]
    Hang {
        /// Time waited.
        seconds: u64,
        /// The last stage known to have finished, where stages are timed, as a clause.
        progress: String,
    },
    /// Any other refusal of the driver.
    #[error("{call} failed: {code}")]
    Driver {
        /// The Vulkan call.
        call: &'static str,
        /// Result code.
        code: String,
    },
}

impl GpuError {
    /// True if the device will never answer again.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::DeviceLost { .. } | Self::Hang { .. })
    }

    /// True if the device has no memory left for the work.
    #[must_use]
    pub fn is_full(&self) -> bool {
        match self {
            Self::OutOfMemory { .. } => true,
            Self::Driver { code, .. } => code == "ERROR_OUT_OF_DEVICE_MEMORY",
            _ => false,
        }
    }
}

/// Turns a result code of `call` into an error; for calls that can lose the device where no stage
/// is known.
pub(crate) fn failed(call: &'static str) -> impl FnOnce(vk::Result) -> GpuError {
    move |code| match code {
        vk::Result::ERROR_DEVICE_LOST => GpuError::DeviceLost {
            during: call,
            progress: "no stage is known to have finished".into(),
        },
        _ => GpuError::Driver {
            call,
            code: format!("{code:?}"),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_say_what_to_install() {
        let loader = GpuError::LoaderMissing {
            detail: "libvulkan.so.1: cannot open shared object file".into(),
        }
        .to_string();
        assert!(
            loader.contains("libvulkan1")
                && loader.contains("mesa-vulkan-drivers")
                && loader.contains("libvulkan.so.1")
        );
        assert!(
            GpuError::ValidationMissing
                .to_string()
                .contains("vulkan-validationlayers")
        );
        assert!(
            GpuError::NoDevice
                .to_string()
                .contains("mesa-vulkan-drivers")
        );
    }

    #[test]
    fn a_lost_device_is_told_from_other_codes() {
        assert!(matches!(
            failed("vkQueueSubmit2")(vk::Result::ERROR_DEVICE_LOST),
            GpuError::DeviceLost {
                during: "vkQueueSubmit2",
                ..
            }
        ));
        let other = failed("vkCreateBuffer")(vk::Result::ERROR_FRAGMENTATION).to_string();
        assert!(
            other.contains("vkCreateBuffer") && other.contains("FRAGMENTATION"),
            "{other}"
        );
    }
}
