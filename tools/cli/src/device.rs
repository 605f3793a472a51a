//! The device that a command draws on, or several.

use std::io::Write;
use std::panic::resume_unwind;
use std::str::FromStr;
use std::thread;

use anyhow::{Result, bail};
use decouplegs_gpu::{DeviceChoice, DeviceOptions, DeviceSet, Drill, Gpu};

/// The argument of every command that draws on a device.
#[derive(clap::Args)]
pub struct DeviceArguments {
    /// Device to render on: an index, a part of its name or its UUID, as `devices` lists them
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,
}

impl DeviceArguments {
    /// The argument as it is typed; nothing if no device was named.
    #[must_use]
    pub fn words(&self) -> Vec<String> {
        match &self.device {
            DeviceChoice::Automatic => Vec::new(),
            named => vec!["--device".into(), named.to_string()],
        }
    }

    /// The device, said on standard error: which one made an image matters to its readers
    /// later.
    pub fn open(&self) -> Result<Gpu> {
        self.open_with(DeviceOptions::default())
    }

    /// The device, opened by `options` but for the choice; said on standard error.
    pub fn open_with(&self, options: DeviceOptions) -> Result<Gpu> {
        let gpu = Gpu::open(&self.choice(options))?;
        say(&gpu);
        Ok(gpu)
    }

    /// The device, opened on a thread of its own while `work` goes on, which takes as long for a
    /// large scene; said on standard error when the work is done.
    ///
    /// # Errors
    /// Returns the error of `work`, or else that of the device.
    pub fn open_beside<T>(&self, work: impl FnOnce() -> Result<T>) -> Result<(Gpu, T)> {
        let options = self.choice(DeviceOptions::default());
        let (gpu, done) = thread::scope(|scope| {
            let gpu = scope.spawn(|| Gpu::open(&options));
            let done = work();
            (gpu.join(), done)
        });
        let done = done?;
        let gpu = gpu.unwrap_or_else(|panic| resume_unwind(panic))?;
        say(&gpu);
        Ok((gpu, done))
    }

    fn choice(&self, options: DeviceOptions) -> DeviceOptions {
        DeviceOptions {
            choice: self.device.clone(),
            ..options
        }
    }
}

/// Says on standard error what is drawn on. It is only for information.
fn say(gpu: &Gpu) {
    let _ = writeln!(std::io::stderr(), "on {}", gpu.info());
}

/// The arguments of a command that divides its work between devices.
#[derive(clap::Args, Clone, Debug)]
pub struct DevicesArguments {
    /// Devices to divide the work between: all, or a list such as 0,1 of what --device takes
    #[arg(long, value_name = "all|DEVICE,...", conflicts_with = "device")]
    pub devices: Option<DeviceSet>,
    /// Fault of one of the devices on purpose, such as 1:lost:40: after 40 submissions to the
    /// second one. To test recovery
    #[arg(
        long,
        hide = true,
        value_name = "POSITION:FAULT:N",
        requires = "devices"
    )]
    pub drill: Vec<PlacedDrill>,
}

impl DevicesArguments {
    /// True if devices were named, one or several.
    pub fn are_named(&self) -> bool {
        self.devices.is_some()
    }

    /// The devices that were named, in this order; `None` if none were.
    pub fn open(&self) -> Result<Option<Vec<Gpu>>> {
        let Some(devices) = &self.devices else {
            return Ok(None);
        };
        let drill = |position| {
            let mut drills = self.drill.iter();
            let placed = drills.find(|placed| placed.position == position);
            placed.map(|placed| placed.drill)
        };
        let opened = Gpu::open_all(devices, |position| DeviceOptions {
            drill: drill(position),
            ..DeviceOptions::default()
        })?;
        for (position, gpu) in opened.iter().enumerate() {
            let _ = writeln!(std::io::stderr(), "device {position}: {}", gpu.info());
        }
        Ok(Some(opened))
    }
}

/// A drill of the device at a position in the list, counted from 0.
#[derive(Clone, Copy, Debug)]
pub struct PlacedDrill {
    position: usize,
    drill: Drill,
}

impl FromStr for PlacedDrill {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (position, drill) = text.split_once(':').unwrap_or((text, ""));
        let position = position
            .parse()
            .map_err(|_| format!("expected the position of a device, found {position:?}"))?;
        let drill = drill.parse()?;
        Ok(Self { position, drill })
    }
}

/// Name and UUID of a device, for people.
pub fn name_of(gpu: &Gpu) -> String {
    let info = gpu.info();
    format!("{} ({})", info.name, DeviceChoice::Uuid(info.uuid))
}

/// Fails with what the validation layers reported, if they were on (`DECOUPLEGS_VALIDATION=1`) and
/// had something to say.
pub fn check_validation(gpu: &Gpu) -> Result<()> {
    let messages = gpu.take_validation_messages();
    if messages.is_empty() {
        return Ok(());
    }
    bail!(
        "the Vulkan validation layers reported {} faults, the first: {}",
        messages.len(),
        messages[0]
    )
}
