//! Metrics, and their text for Prometheus.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tonic::Code;

/// Upper ends of the histogram's buckets, seconds.
const BUCKETS_S: [f64; 16] = [
    0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0,
    60.0,
];

/// Metrics of the server.
#[derive(Default)]
pub struct Metrics {
    methods: Mutex<BTreeMap<&'static str, Method>>,
    /// One for each device.
    devices: Mutex<Vec<OfDevice>>,
    queue: AtomicI64,
    submissions: AtomicU64,
    unknown_objects: AtomicU64,
    connections: AtomicI64,
    connections_refused: AtomicU64,
}

#[derive(Clone, Default)]
struct OfDevice {
    scenes: Vec<String>,
    cache_bytes: u64,
    images: u64,
}

#[derive(Default)]
struct Method {
    by_status: BTreeMap<i32, u64>,
    buckets: [u64; BUCKETS_S.len()],
    seconds: f64,
}

impl Metrics {
    /// A request was answered with `code` after `took`.
    pub fn answered(&self, method: &'static str, code: Code, took: Duration) {
        let mut methods = lock(&self.methods);
        let method = methods.entry(method).or_default();
        *method.by_status.entry(code as i32).or_default() += 1;
        let seconds = took.as_secs_f64();
        method.seconds += seconds;
        if let Some(bucket) = BUCKETS_S.iter().position(|end| seconds <= *end) {
            method.buckets[bucket] += 1;
        }
    }

    /// Says how many devices draw.
    pub fn with_devices(&self, count: usize) {
        lock(&self.devices).resize(count, OfDevice::default());
    }

    /// Adds `more` to the number of queued jobs.
    pub fn queued(&self, more: i64) {
        self.queue.fetch_add(more, Ordering::Relaxed);
    }

    /// One submission to `device` drew so many images, and objects were asked for that the scene
    /// has not.
    pub fn drew(&self, device: usize, images: usize, unknown_objects: usize) {
        self.submissions.fetch_add(1, Ordering::Relaxed);
        lock(&self.devices)[device].images += images as u64;
        self.unknown_objects
            .fetch_add(unknown_objects as u64, Ordering::Relaxed);
    }

    /// The scenes on `device`, and their bytes.
    pub fn cached(&self, device: usize, scenes: Vec<String>, bytes: u64) {
        let of_device = &mut lock(&self.devices)[device];
        of_device.scenes = scenes;
        of_device.cache_bytes = bytes;
    }

    /// The scenes on all devices, and on how many of them each is.
    pub fn scenes(&self) -> Vec<(String, u64)> {
        let devices = lock(&self.devices);
        let mut scenes: Vec<(String, u64)> = Vec::new();
        for name in devices.iter().flat_map(|device| &device.scenes) {
            match scenes.iter_mut().find(|(known, _)| known == name) {
                Some((_, copies)) => *copies += 1,
                None => scenes.push((name.clone(), 1)),
            }
        }
        scenes
    }

    /// Images that each device drew so far.
    pub fn images(&self) -> Vec<u64> {
        let devices = lock(&self.devices);
        devices.iter().map(|device| device.images).collect()
    }

    /// Adds `more` to the number of open connections.
    pub fn connected(&self, more: i64) {
        self.connections.fetch_add(more, Ordering::Relaxed);
    }

    /// A connection was closed because there were too many.
    pub fn refused_connection(&self) {
        self.connections_refused.fetch_add(1, Ordering::Relaxed);
    }

    /// Submissions so far: one draws all cameras of a batch.
    pub fn submissions(&self) -> u64 {
        self.submissions.load(Ordering::Relaxed)
    }

    /// All of it, as Prometheus reads it.
    pub fn text(&self) -> String {
        let mut text = String::new();
        self.write_methods(&mut text);
        let (signed, unsigned) = (
            |value: &AtomicI64| value.load(Ordering::Relaxed).max(0) as u64,
            |value: &AtomicU64| value.load(Ordering::Relaxed),
        );
        let devices = lock(&self.devices).clone();
        let sum = |of: fn(&OfDevice) -> u64| devices.iter().map(of).sum();
        let scenes = sum(|device| device.scenes.len() as u64);
        for (name, kind, meaning, value) in [
            (
                "images_total",
                "counter",
                "Images drawn.",
                sum(|device| device.images),
            ),
            (
                "submissions_total",
                "counter",
                "Frames submitted to the device.",
                unsigned(&self.submissions),
            ),
            (
                "unknown_objects_total",
                "counter",
                "Objects asked for that a scene does not have.",
                unsigned(&self.unknown_objects),
            ),
            (
                "queue_depth",
                "gauge",
                "Jobs that wait to be drawn or are being drawn.",
                signed(&self.queue),
            ),
            ("scenes_cached", "gauge", "Scenes on the device.", scenes),
            (
                "scene_cache_bytes",
                "gauge",
                "Device memory of the scenes in the cache.",
                sum(|device| device.cache_bytes),
            ),
            (
                "connections",
                "gauge",
                "Open connections.",
                signed(&self.connections),
            ),
            (
                "connections_refused_total",
                "counter",
                "Connections closed at the limit.",
                unsigned(&self.connections_refused),
            ),
        ] {
            // Writing to a string cannot fail.
            let _ = write!(
                text,
                "# HELP decouplegs_{name} {meaning}\n# TYPE decouplegs_{name} {kind}\ndecouplegs_{name} {value}\n"
            );
        }
        if devices.len() > 1 {
            write_devices(&mut text, &devices);
        }
        text
    }

    fn write_methods(&self, text: &mut String) {
        let methods = lock(&self.methods);
        text.push_str("# HELP decouplegs_requests_total Requests answered.\n# TYPE decouplegs_requests_total counter\n");
        for (name, method) in methods.iter() {
            for (code, count) in &method.by_status {
                let code = Code::from_i32(*code);
                let _ = writeln!(
                    text,
                    "decouplegs_requests_total{{method=\"{name}\",status=\"{code:?}\"}} {count}"
                );
            }
        }
        text.push_str("# HELP decouplegs_request_seconds Time to answer.\n# TYPE decouplegs_request_seconds histogram\n");
        for (name, method) in methods.iter() {
            let mut below = 0;
            for (end, count) in BUCKETS_S.iter().zip(method.buckets) {
                below += count;
                let _ = writeln!(
                    text,
                    "decouplegs_request_seconds_bucket{{method=\"{name}\",le=\"{end}\"}} {below}"
                );
            }
            let all: u64 = method.by_status.values().sum();
            let _ = writeln!(
                text,
                "decouplegs_request_seconds_bucket{{method=\"{name}\",le=\"+Inf\"}} {all}"
            );
            let _ = writeln!(
                text,
                "decouplegs_request_seconds_sum{{method=\"{name}\"}} {}",
                method.seconds
            );
            let _ = writeln!(
                text,
                "decouplegs_request_seconds_count{{method=\"{name}\"}} {all}"
            );
        }
    }
}

/// Writes the values of each of several devices.
fn write_devices(text: &mut String, devices: &[OfDevice]) {
    type Value = fn(&OfDevice) -> u64;
    let values: [(&str, &str, &str, Value); 3] = [
        (
            "images_total",
            "counter",
            "Images that a device drew.",
            |device| device.images,
        ),
        ("scenes_cached", "gauge", "Scenes on a device.", |device| {
            device.scenes.len() as u64
        }),
        (
            "scene_cache_bytes",
            "gauge",
            "Memory of the scenes on a device.",
            |device| device.cache_bytes,
        ),
    ];
    for (name, kind, meaning, value) in values {
        let _ = writeln!(
            text,
            "# HELP decouplegs_device_{name} {meaning}\n# TYPE decouplegs_device_{name} {kind}"
        );
        for (position, device) in devices.iter().enumerate() {
            let value = value(device);
            let _ = writeln!(
                text,
                "decouplegs_device_{name}{{device=\"{position}\"}} {value}"
            );
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_add_up_and_every_line_has_a_value() {
        let metrics = Metrics::default();
        for milliseconds in [1, 4, 4, 100_000] {
            metrics.answered("render_rgb", Code::Ok, Duration::from_millis(milliseconds));
        }
        metrics.answered(
            "render_rgb",
            Code::InvalidArgument,
            Duration::from_millis(1),
        );
        metrics.with_devices(2);
        metrics.drew(0, 2, 2);
        metrics.drew(1, 4, 0);
        let text = metrics.text();
        for line in [
            "decouplegs_requests_total{method=\"render_rgb\",status=\"Ok\"} 4",
            "decouplegs_requests_total{method=\"render_rgb\",status=\"InvalidArgument\"} 1",
            "decouplegs_request_seconds_bucket{method=\"render_rgb\",le=\"0.005\"} 4",
            "decouplegs_request_seconds_bucket{method=\"render_rgb\",le=\"60\"} 4",
            "decouplegs_request_seconds_bucket{method=\"render_rgb\",le=\"+Inf\"} 5",
            "decouplegs_images_total 6",
            "decouplegs_device_images_total{device=\"1\"} 4",
            "decouplegs_unknown_objects_total 2",
        ] {
            assert!(
                text.lines().any(|written| written == line),
                "{line} is not in\n{text}"
            );
        }
        let values = text
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| line.rsplit(' ').next().map(str::parse::<f64>));
        assert!(values.flatten().all(|value| value.is_ok()));
    }
}
