//! Opening devices, and what is said when that fails.

use std::collections::BTreeSet;
use std::process::Command;

use decouplegs_gpu::{DeviceChoice, DeviceOptions, Gpu, GpuError, QueueUse};

use crate::Watched;

/// Set in a process of its own, whose environment hides drivers or layers from the loader.
const CHILD: &str = "DECOUPLEGS_GPU_TEST_CHILD";

#[test]
fn the_device_found_can_be_named_by_index_name_and_uuid() {
    let found = Gpu::list().unwrap();
    for device in &found {
        println!("{}: {device}", device.index);
        let choices = [
            DeviceChoice::Index(device.index),
            DeviceChoice::Uuid(device.uuid),
            DeviceChoice::Name(device.name.to_uppercase()),
        ];
        for choice in choices {
            let options = DeviceOptions {
                choice,
                ..DeviceOptions::default()
            };
            // Not every device that is listed can do the work; one that is opened is the one asked
            // for.
            match Gpu::open(&options) {
                Ok(gpu) => assert_eq!(gpu.info().name, device.name),
                Err(error) => assert!(matches!(error, GpuError::MissingFeature { .. }), "{error}"),
            }
        }
    }
}

#[test]
fn limits_are_those_that_vulkan_guarantees_or_better() {
    let gpu = Watched::open();
    let limits = gpu.limits();
    println!("{limits:?}");
    assert!(limits.subgroup_size.is_power_of_two() && limits.subgroup_size <= 128);
    assert!(limits.shared_memory_bytes >= 16 << 10 && limits.workgroup_threads_max >= 128);
    assert!(limits.storage_buffer_bytes_max >= 1 << 27 && limits.push_constant_bytes_max >= 128);
    assert!(limits.workgroup_subgroups_max * limits.subgroup_size >= 128);
    assert!(
        limits
            .dispatch_groups_max
            .iter()
            .all(|&groups| groups >= 65535)
    );
    assert!(limits.device_memory_bytes > 0 && limits.timestamp_period_ns > 0.0);
}

#[test]
fn one_queue_is_enough_where_it_is_asked_for() {
    assert!(!Watched::open_with(QueueUse::One).has_update_queue());
}

#[test]
fn an_unknown_device_is_refused_with_those_found() {
    let options = DeviceOptions {
        choice: DeviceChoice::Name("voodoo 2".into()),
        ..DeviceOptions::default()
    };
    let text = Gpu::open(&options).unwrap_err().to_string();
    assert!(
        text.contains("voodoo 2") && text.contains(&Gpu::list().unwrap()[0].name),
        "{text}"
    );
}

#[test]
fn without_a_driver_the_error_says_what_to_install() {
    if std::env::var_os(CHILD).is_some() {
        println!("{}", Gpu::list().unwrap_err());
        return;
    }
    let text = in_a_child(
        "without_a_driver_the_error_says_what_to_install",
        &["VK_ICD_FILENAMES", "VK_DRIVER_FILES"],
    );
    assert!(
        text.contains("no Vulkan device found") && text.contains("mesa-vulkan-drivers"),
        "{text}"
    );
}

#[test]
fn without_its_layer_validation_is_refused() {
    if std::env::var_os(CHILD).is_some() {
        println!(
            "{}",
            Gpu::open(&DeviceOptions {
                validation: true,
                ..DeviceOptions::default()
            })
            .unwrap_err()
        );
        return;
    }
    let text = in_a_child(
        "without_its_layer_validation_is_refused",
        &["VK_LAYER_PATH"],
    );
    assert!(text.contains("install vulkan-validationlayers"), "{text}");
}

/// Output of test `name` in a process whose Vulkan loader is redirected to a path that does not
/// exist.
fn in_a_child(name: &str, hidden: &[&str]) -> String {
    let mut child = Command::new(std::env::current_exe().unwrap());
    child
        .args(["--exact", &format!("opening::{name}"), "--nocapture"])
        .env(CHILD, "1");
    for variable in hidden {
        child.env(variable, "/nonexistent/vulkan");
    }
    let output = child.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Threads that called a driver may end after the last device is gone, and run destructors of it.
#[cfg(target_os = "linux")]
#[test]
fn drivers_stay_loaded() {
    let libraries = || -> BTreeSet<String> {
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
        let paths = maps
            .lines()
            .filter_map(|line| Some(line[line.find('/')?..].to_owned()));
        paths.filter(|path| path.contains(".so")).collect()
    };
    let gpu = Watched::open();
    let with = libraries();
    assert!(
        with.iter().any(|path| path.contains("libvulkan")),
        "{with:?}"
    );
    drop(gpu);
    let after = libraries();
    let gone: Vec<_> = with.difference(&after).collect();
    assert!(gone.is_empty(), "{gone:?} were unloaded");
}
