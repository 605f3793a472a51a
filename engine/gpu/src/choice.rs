//! Selection of the device and its options.

use std::{convert::Infallible, fmt, str::FromStr, time::Duration};

use crate::{DeviceInfo, DeviceKind, Drill, GpuError, KernelCache, KernelTrial};

/// Options for opening a device.
#[derive(Clone, Debug)]
pub struct DeviceOptions {
    /// Device to open.
    pub choice: DeviceChoice,
    /// Enables the Khronos validation layer with synchronization validation for every call. Slow;
    /// for tests.
    pub validation: bool,
    /// Use of the compute-only queue.
    pub queues: QueueUse,
    /// Folder for built kernels, which the next start reads.
    pub kernels: KernelCache,
    /// Time for which a wait asks the device again and again before the thread sleeps. Waking up
    /// takes longer than a small frame's copy to the host. CPU devices are not asked: they need
    /// the processor for the work itself.
    pub poll: Duration,
    /// Kernels that replace those of the program, for measurements during development. Empty by
    /// default.
    pub trial: KernelTrial,
    /// Asks the driver about each kernel that is built ([`crate::Gpu::kernel_reports`]).
    pub reports_kernels: bool,
    /// A fault on purpose. None by default.
    pub drill: Option<Drill>,
}

impl Default for DeviceOptions {
    /// The best device, all queues, built kernels in the user's folder for caches, 2 ms of polling,
    /// and validation where the environment says `DECOUPLEGS_VALIDATION=1`.
    fn default() -> Self {
        let validation = std::env::var("DECOUPLEGS_VALIDATION").is_ok_and(|value| value == "1");
        Self {
            choice: DeviceChoice::Automatic,
            validation,
            queues: QueueUse::All,
            kernels: KernelCache::User,
            poll: Duration::from_millis(2),
            trial: KernelTrial::default(),
            reports_kernels: false,
            drill: None,
        }
    }
}

/// Selection of a device.
///
/// From text: a decimal number is an index. `uuid:` and 32 hex digits, or `GPU-` and these as CUDA
/// writes it, or 32 hex digits alone (dashes allowed) are a UUID. An empty text or `auto` is
/// automatic, and anything else is a part of a name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The first that can do the work: discrete before integrated, virtual and CPU devices, then by
    /// memory.
    #[default]
    Automatic,
    /// Device at this position in [`crate::Gpu::list`].
    Index(usize),
    /// Device with this part in its name, upper and lower case alike.
    Name(String),
    /// Device with this UUID of the driver, which stays the same when other devices come and go.
    Uuid([u8; 16]),
}

/// Devices that divide work between them.
///
/// From text: `all`, or choices separated by commas, each as a [`DeviceChoice`] is written. A
/// device that is named twice is opened twice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceSet {
    /// Every device that can do the work. CPU devices count where there is no other.
    All,
    /// These, in this order.
    Each(Vec<DeviceChoice>),
}

/// Use of queues.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum QueueUse {
    /// The compute-only family too, where the device has one.
    #[default]
    All,
    /// One queue: work for [`crate::QueueRole::Update`] goes to the main queue.
    One,
}

impl FromStr for DeviceChoice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        let text = text.trim();
        if text.is_empty() || text.eq_ignore_ascii_case("auto") {
            return Ok(Self::Automatic);
        }
        // 32 decimal digits are a UUID, not an index: no machine has that many devices.
        let bare = text.strip_prefix("uuid:");
        let bare = bare.or_else(|| text.strip_prefix("GPU-")).unwrap_or(text);
        if let Some(uuid) = uuid_from_hex(bare) {
            return Ok(Self::Uuid(uuid));
        }
        let digits_only = text.bytes().all(|byte| byte.is_ascii_digit());
        Ok(match text.parse() {
            Ok(index) if digits_only => Self::Index(index),
            _ => Self::Name(text.to_owned()),
        })
    }
}

impl FromStr for DeviceSet {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.trim().eq_ignore_ascii_case("all") {
            return Ok(Self::All);
        }
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        if parts.iter().any(|part| part.is_empty()) {
            return Err(format!(
                "expected all, or devices separated by commas, found {text:?}"
            ));
        }
        let choice = |part: &str| {
            part.parse()
                .unwrap_or_else(|never: Infallible| match never {})
        };
        Ok(Self::Each(parts.into_iter().map(choice).collect()))
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Automatic => f.write_str("auto"),
            Self::Index(index) => write!(f, "{index}"),
            Self::Name(name) => f.write_str(name),
            Self::Uuid(uuid) => {
                f.write_str("uuid:")?;
                uuid.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
            }
        }
    }
}

/// 16 bytes from 32 hex digits with any dashes between them.
fn uuid_from_hex(text: &str) -> Option<[u8; 16]> {
    let mut uuid = [0; 16];
    let mut digits = 0;
    for character in text.chars().filter(|&character| character != '-') {
        let value = character.to_digit(16)?;
        *uuid.get_mut(digits / 2)? |= (value as u8) << (4 * (1 - digits % 2));
        digits += 1;
    }
    (digits == 32).then_some(uuid)
}

/// The positions in `devices` to try for `choice`, best first. A choice that names a device gives
/// that one only.
pub(crate) fn candidates(
    choice: &DeviceChoice,
    devices: &[DeviceInfo],
) -> Result<Vec<usize>, GpuError> {
    if devices.is_empty() {
        return Err(GpuError::NoDevice);
    }
    let chosen = match choice {
        DeviceChoice::Automatic => {
            let mut order: Vec<usize> = (0..devices.len()).collect();
            order.sort_by_key(|&i| {
                (
                    rank(devices[i].kind),
                    std::cmp::Reverse(devices[i].device_memory_bytes),
                    i,
                )
            });
            return Ok(order);
        }
        DeviceChoice::Index(index) => (*index < devices.len()).then_some(*index),
        DeviceChoice::Name(part) => {
            let part = part.to_lowercase();
            devices
                .iter()
                .position(|device| device.name.to_lowercase().contains(&part))
        }
        DeviceChoice::Uuid(uuid) => devices.iter().position(|device| device.uuid == *uuid),
    };
    chosen
        .map(|index| vec![index])
        .ok_or_else(|| GpuError::UnknownDevice {
            wanted: format!("'{choice}'"),
            found: sentence(devices),
        })
}

/// UUIDs of all of `devices` that [`DeviceSet::All`] stands for, each once.
pub(crate) fn all_of(devices: &[DeviceInfo]) -> Vec<[u8; 16]> {
    let is_hardware = |device: &&DeviceInfo| device.kind != DeviceKind::Cpu;
    let hardware: Vec<&DeviceInfo> = devices.iter().filter(is_hardware).collect();
    let counted = match hardware.is_empty() {
        true => devices.iter().collect(),
        false => hardware,
    };
    let mut uuids: Vec<[u8; 16]> = Vec::new();
    for device in counted {
        if !uuids.contains(&device.uuid) {
            uuids.push(device.uuid);
        }
    }
    uuids
}

fn rank(kind: DeviceKind) -> u8 {
    match kind {
        DeviceKind::Discrete => 0,
        DeviceKind::Integrated => 1,
        DeviceKind::Virtual => 2,
        DeviceKind::Cpu => 3,
        DeviceKind::Other => 4,
    }
}

fn sentence(devices: &[DeviceInfo]) -> String {
    let texts: Vec<String> = devices
        .iter()
        .map(|device| {
            format!(
                "{} = {} ({})",
                device.index,
                device.name,
                DeviceChoice::Uuid(device.uuid)
            )
        })
        .collect();
    texts.join(", ")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn device(index: usize, name: &str, kind: DeviceKind, device_memory_bytes: u64) -> DeviceInfo {
        DeviceInfo {
            index,
            name: name.into(),
            driver: "test".into(),
            api_version: [1, 3, 0],
            kind,
            uuid: [index as u8; 16],
            device_memory_bytes,
        }
    }

    fn three() -> Vec<DeviceInfo> {
        vec![
            device(0, "llvmpipe (LLVM 15)", DeviceKind::Cpu, 1 << 36),
            device(1, "NVIDIA H200", DeviceKind::Discrete, 1 << 37),
            device(2, "NVIDIA T4", DeviceKind::Discrete, 1 << 34),
        ]
    }

    #[test]
    fn automatic_prefers_discrete_then_memory() {
        assert_eq!(
            candidates(&DeviceChoice::Automatic, &three()).unwrap(),
            [1, 2, 0]
        );
    }

    #[test]
    fn all_devices_are_the_hardware_each_once() {
        let mut devices = three();
        devices.push(devices[1].clone());
        assert_eq!(all_of(&devices), [[1; 16], [2; 16]]);
        assert_eq!(
            all_of(&devices[..1]),
            [[0; 16]],
            "software where there is no other"
        );
        let set = |text: &str| text.parse::<DeviceSet>();
        assert_eq!(set(" ALL "), Ok(DeviceSet::All));
        let named = vec![DeviceChoice::Index(0), DeviceChoice::Name("T4".into())];
        assert_eq!(set("0, T4"), Ok(DeviceSet::Each(named)));
        for text in ["", "0,,1", "0,"] {
            assert!(set(text).unwrap_err().contains("all"), "{text}");
        }
    }

    #[test]
    fn a_part_of_a_name_is_enough_whatever_its_case() {
        assert_eq!(
            candidates(&DeviceChoice::Name("LLVMPIPE".into()), &three()).unwrap(),
            [0]
        );
        assert_eq!(
            candidates(&DeviceChoice::Uuid([2; 16]), &three()).unwrap(),
            [2]
        );
    }

    #[test]
    fn an_unknown_device_lists_those_found() {
        for choice in [
            DeviceChoice::Name("radeon".into()),
            DeviceChoice::Index(3),
            DeviceChoice::Uuid([9; 16]),
        ] {
            let text = candidates(&choice, &three()).unwrap_err().to_string();
            assert!(text.contains(&choice.to_string()), "{text}");
            assert!(
                text.contains("0 = llvmpipe")
                    && text.contains("1 = NVIDIA H200")
                    && text.contains("2 = NVIDIA T4"),
                "{text}"
            );
        }
        assert!(matches!(
            candidates(&DeviceChoice::Automatic, &[]),
            Err(GpuError::NoDevice)
        ));
    }

    #[test]
    fn text_means_what_the_documentation_says() {
        assert_eq!("0".parse(), Ok(DeviceChoice::Index(0)));
        assert_eq!("12".parse(), Ok(DeviceChoice::Index(12)));
        assert_eq!("auto".parse(), Ok(DeviceChoice::Automatic));
        assert_eq!("+1".parse(), Ok(DeviceChoice::Name("+1".into())));
        assert_eq!(
            "RTX 4090".parse(),
            Ok(DeviceChoice::Name("RTX 4090".into()))
        );
        let uuid = [
            0x6d, 0x65, 0x73, 0x61, 0x32, 0x32, 0x2e, 0x33, 0x2e, 0x36, 0x2d, 0, 0, 0, 0, 0xff,
        ];
        assert_eq!(
            "6d657361-3232-2e33-2e36-2d00000000ff".parse(),
            Ok(DeviceChoice::Uuid(uuid))
        );
        assert_eq!(
            "GPU-6d657361-3232-2e33-2e36-2d00000000ff".parse(),
            Ok(DeviceChoice::Uuid(uuid))
        );
        assert_eq!(
            "uuid:6D65736132322e332e362d00000000FF".parse(),
            Ok(DeviceChoice::Uuid(uuid))
        );
        assert_eq!(
            "uuid:6d65".parse(),
            Ok(DeviceChoice::Name("uuid:6d65".into()))
        );
    }

    proptest! {
        #[test]
        fn any_text_is_a_choice_and_never_a_panic(text in ".*") {
            let _: DeviceChoice = text.parse().unwrap();
        }

        #[test]
        fn a_choice_survives_being_written(uuid: [u8; 16], index in 0_usize..1_000_000, name in "[A-Za-z][A-Za-z ()]{0,20}[G-Z)]") {
            for choice in [DeviceChoice::Uuid(uuid), DeviceChoice::Index(index), DeviceChoice::Name(name), DeviceChoice::Automatic] {
                prop_assert_eq!(choice.to_string().parse::<DeviceChoice>().unwrap(), choice);
            }
        }
    }
}
