//! `decouplegs devices`: what Vulkan finds on this machine.

use anyhow::Result;
use decouplegs_gpu::{DeviceChoice, DeviceInfo, DeviceKind, Gpu};
use serde_json::json;

use crate::arguments::print;

/// List the Vulkan devices of this machine, with the numbers that --device takes
#[derive(clap::Args)]
pub struct Arguments {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let devices = Gpu::list()?;
    if arguments.json {
        let values: Vec<_> = devices.iter().map(to_json).collect();
        return print(&format!("{:#}\n", json!(values)));
    }
    print(&devices.iter().map(to_text).collect::<String>())
}

fn to_text(device: &DeviceInfo) -> String {
    let memory_gib = device.device_memory_bytes as f64 / f64::from(1 << 30);
    let uuid = DeviceChoice::Uuid(device.uuid);
    format!(
        "{}  {device}\n   {}, {memory_gib:.1} GiB, {uuid}\n",
        device.index,
        kind_name(device.kind)
    )
}

fn to_json(device: &DeviceInfo) -> serde_json::Value {
    json!({
        "index": device.index,
        "name": device.name,
        "driver": device.driver,
        "api_version": device.api_version,
        "kind": kind_name(device.kind),
        "uuid": DeviceChoice::Uuid(device.uuid).to_string(),
        "device_memory_bytes": device.device_memory_bytes,
    })
}

fn kind_name(kind: DeviceKind) -> &'static str {
    match kind {
        DeviceKind::Discrete => "discrete",
        DeviceKind::Integrated => "integrated",
        DeviceKind::Virtual => "virtual",
        DeviceKind::Cpu => "cpu",
        DeviceKind::Other => "other",
    }
}
