//! Use of devices: which one drove which episode, and how much they did together.

use std::collections::HashMap;
use std::time::Duration;

use serde_json::{Value, json};

use super::Scored;
use crate::page::{Page, Table};

/// Record of the devices that were named for a run.
pub struct DeviceUse {
    /// Devices of this run, by position.
    pub devices: Vec<Value>,
    /// Lines of `devices.jsonl`: episodes that were driven and faults, this run's and those of
    /// runs before that drove into the same folder.
    pub lines: Vec<Value>,
    /// Number of the first lines, which are of runs before.
    pub before: usize,
    /// Time from the first episode's start to now.
    pub took: Duration,
}

/// Sums over episodes.
#[derive(Clone, Copy, Default)]
struct Sums {
    episodes: usize,
    images: usize,
    sweeps: usize,
}

impl Sums {
    fn add(&mut self, scored: &Scored) {
        self.images += scored.taken.images;
        self.sweeps += scored.taken.sweeps;
        self.episodes += 1;
    }
}

impl DeviceUse {
    /// The device that drove each episode, by name.
    pub fn by_episode(&self) -> HashMap<&str, &Value> {
        // A later line is of an episode that was driven again, as its log was damaged.
        let driven = self.lines.iter().filter(|line| line["fault"].is_null());
        driven
            .filter_map(|line| Some((line["episode"].as_str()?, &line["device"])))
            .collect()
    }

    /// Each device, its sums over `scored`, and its fault in this run if it has one: devices of
    /// this run, then those of runs before.
    fn rows(&self, scored: &[Scored]) -> Vec<(Value, Sums, Value)> {
        let mut devices = self.devices.clone();
        for line in &self.lines {
            if !devices.contains(&line["device"]) {
                devices.push(line["device"].clone());
            }
        }
        let by_episode = self.by_episode();
        let row = |device: Value| {
            let mut sums = Sums::default();
            for scored in scored {
                if by_episode.get(scored.scenario_name()).copied() == Some(&device) {
                    sums.add(scored);
                }
            }
            let faults = self.lines[self.before..].iter();
            let faults = faults.filter(|line| line["device"] == device);
            let fault = faults
                .map(|line| &line["fault"])
                .find(|fault| !fault.is_null());
            (device, sums, fault.cloned().unwrap_or_default())
        };
        devices.into_iter().map(row).collect()
    }

    /// Sums over the episodes that were driven in this run.
    fn driven_now(scored: &[Scored]) -> Sums {
        let mut sums = Sums::default();
        let driven = scored.iter().filter(|scored| scored.times.is_some());
        driven.for_each(|scored| sums.add(scored));
        sums
    }

    pub fn to_json(&self, scored: &[Scored]) -> Value {
        let row = |(mut device, sums, fault): (Value, Sums, Value)| {
            device["episodes"] = sums.episodes.into();
            device["images"] = sums.images.into();
            device["sweeps"] = sums.sweeps.into();
            device["fault"] = fault;
            device
        };
        let (sums, took_s) = (Self::driven_now(scored), self.took.as_secs_f64());
        json!({
            "devices": self.rows(scored).into_iter().map(row).collect::<Vec<_>>(),
            "driven": json!({
                "episodes": sums.episodes, "images": sums.images, "sweeps": sums.sweeps, "seconds": took_s,
            }),
        })
    }

    /// A line for all devices and one for each.
    pub fn text(&self, scored: &[Scored]) -> String {
        let mut text = String::new();
        let (sums, took_s) = (Self::driven_now(scored), self.took.as_secs_f64());
        if sums.episodes > 0 && took_s > 0.0 {
            let rate = |count: usize| count as f64 / took_s;
            text = format!(
                "{} episodes in {took_s:.2} s: {:.0} episodes/h, {:.1} images/s, {:.1} sweeps/s\n",
                sums.episodes,
                3600.0 * rate(sums.episodes),
                rate(sums.images),
                rate(sums.sweeps)
            );
        }
        for (device, sums, fault) in self.rows(scored) {
            let out = fault
                .as_str()
                .map_or(String::new(), |fault| format!("; out of the run: {fault}"));
            text.push_str(&format!(
                "  device {}: {} episodes, {} images, {} sweeps{out}\n",
                named(&device),
                sums.episodes,
                sums.images,
                sums.sweeps
            ));
        }
        text
    }

    /// Adds those figures to a page.
    pub fn part(&self, page: &mut Page, scored: &[Scored]) {
        page.heading("Devices");
        let mut table =
            Table::new(["device", "episodes", "images", "sweeps", "fault"]).with_text_in(4);
        for (device, sums, fault) in self.rows(scored) {
            table.row([
                named(&device),
                sums.episodes.to_string(),
                sums.images.to_string(),
                sums.sweeps.to_string(),
                fault.as_str().unwrap_or("-").to_owned(),
            ]);
        }
        page.table(&table);
        page.note("report.json says which device drove which episode.");
    }
}

/// Position, name and UUID of a device.
fn named(device: &Value) -> String {
    let text = |key: &str| device[key].as_str().unwrap_or_default().to_owned();
    format!(
        "{}, {} ({})",
        device["position"],
        text("name"),
        text("uuid")
    )
}
