//! Choice of the device that draws a scene: by load first, then by what fits, then by size.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Devices of a server, and the scenes that each of them has.
pub struct Placement {
    state: Mutex<State>,
    /// Scenes that one device keeps.
    scenes_max: usize,
    /// Bytes that the scenes of one device may take.
    bytes_max: u64,
}

struct State {
    devices: Vec<DeviceState>,
    /// Device of each scene that is on one or on its way to it.
    scenes: HashMap<String, Held>,
}

#[derive(Clone, Copy, Default)]
struct DeviceState {
    is_out: bool,
    /// Requests that wait for the device or are drawn on it.
    requests: usize,
}

#[derive(Clone, Copy)]
struct Held {
    device: usize,
    /// Bytes on the device, estimated until the scene is there.
    bytes: u64,
}

/// A request that counts as load of a device until this is dropped.
pub struct Load {
    placement: Arc<Placement>,
    device: usize,
}

impl Drop for Load {
    fn drop(&mut self) {
        self.placement.state().devices[self.device].requests -= 1;
    }
}

impl Placement {
    /// Placement on `devices` devices, each of which keeps at most `scenes_max` scenes of
    /// `bytes_max` bytes together.
    pub fn new(devices: usize, scenes_max: usize, bytes_max: u64) -> Self {
        Self {
            state: Mutex::new(State {
                devices: vec![DeviceState::default(); devices],
                scenes: HashMap::new(),
            }),
            scenes_max,
            bytes_max,
        }
    }

    /// The device that draws `scene`, none of `refused`; and the request as a load of it. A scene
    /// that is nowhere is placed, and takes about the bytes of `estimate`. `None` if no device is
    /// left.
    pub fn place(
        self: &Arc<Self>,
        scene: &str,
        refused: &[usize],
        estimate: impl FnOnce() -> u64,
    ) -> Option<(usize, Load)> {
        let load = |device| Load {
            placement: Arc::clone(self),
            device,
        };
        let draws = |state: &State, device: usize| {
            !state.devices[device].is_out && !refused.contains(&device)
        };
        let held = |state: &State| {
            let device = state.scenes.get(scene)?.device;
            draws(state, device).then_some(device)
        };
        let mut state = self.state();
        if held(&state).is_none() && state.devices.len() > 1 {
            // Sizes are found without the lock; meanwhile another request may have placed it.
            drop(state);
            let bytes = estimate();
            state = self.state();
            if held(&state).is_none() {
                let devices = (0..state.devices.len()).filter(|&device| draws(&state, device));
                let device = devices.min_by_key(|&device| self.cost(&state, device, bytes))?;
                state
                    .scenes
                    .insert(scene.to_owned(), Held { device, bytes });
            }
        }
        // One device needs no choice.
        let only = draws(&state, 0).then_some(0);
        let device = held(&state).or(only)?;
        state.devices[device].requests += 1;
        Some((device, load(device)))
    }

    /// Order in which devices are chosen for a scene of `bytes`, the least first: those that have
    /// fewer requests, those that need not give up another scene, those whose scenes are smaller.
    fn cost(&self, state: &State, device: usize, bytes: u64) -> (usize, bool, u64, usize) {
        let held = state.scenes.values().filter(|held| held.device == device);
        let held_bytes: u64 = held.clone().map(|held| held.bytes).sum();
        let scenes = held.count();
        let is_full =
            scenes >= self.scenes_max || held_bytes.saturating_add(bytes) > self.bytes_max;
        let requests = state.devices[device].requests;
        (requests, is_full, held_bytes, device)
    }

    /// Says that `scene` takes `bytes` on `device`.
    pub fn holds(&self, device: usize, scene: &str, bytes: u64) {
        let mut state = self.state();
        if state.devices.len() > 1 {
            let held = Held { device, bytes };
            state.scenes.insert(scene.to_owned(), held);
        }
    }

    /// Says that `scene` is not on `device`: it has left, or could not be loaded.
    pub fn left(&self, device: usize, scene: &str) {
        let mut state = self.state();
        if state
            .scenes
            .get(scene)
            .is_some_and(|held| held.device == device)
        {
            state.scenes.remove(scene);
        }
    }

    /// Scenes that all devices keep together at most.
    pub fn scenes_max(&self) -> u64 {
        (self.scenes_max * self.state().devices.len()) as u64
    }

    /// Takes a device out for good, with all its scenes. True if others are left.
    pub fn take_out(&self, device: usize) -> bool {
        let mut state = self.state();
        state.devices[device].is_out = true;
        state.scenes.retain(|_, held| held.device != device);
        state.devices.iter().any(|device| !device.is_out)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(placement: &Arc<Placement>, scene: &str, bytes: u64) -> Option<(usize, Load)> {
        placement.place(scene, &[], || bytes)
    }

    #[test]
    fn scenes_are_spread_by_load_and_by_size() {
        let placement = Arc::new(Placement::new(2, 2, 100));
        let device = |scene, bytes| placed(&placement, scene, bytes).map(|(device, _)| device);
        assert_eq!(device("large", 60), Some(0));
        assert_eq!(device("small", 10), Some(1), "the other has more bytes");
        assert_eq!(device("second", 10), Some(1));
        assert_eq!(
            device("third", 30),
            Some(0),
            "the other has two scenes already"
        );
        // The device with fewer requests gets the next one; a scene that has a place keeps it.
        let busy = placed(&placement, "large", 60);
        placement.left(0, "third");
        assert_eq!(device("fourth", 1), Some(1));
        assert_eq!(device("large", 60), Some(0));
        drop(busy);
        placement.left(1, "fourth");
        placement.holds(1, "small", 90);
        assert_eq!(device("fifth", 1), Some(0), "sizes are those on the device");
    }

    #[test]
    fn scenes_of_a_device_that_is_gone_or_refuses_go_to_others() {
        let placement = Arc::new(Placement::new(2, 8, 100));
        let refused = |refused: &[usize]| {
            let placed = placement.place("town", refused, || 1);
            placed.map(|(device, _)| device)
        };
        assert_eq!(refused(&[]), Some(0));
        assert_eq!(refused(&[0]), Some(1));
        assert_eq!(refused(&[]), Some(1), "it stays where it could be loaded");
        assert_eq!(refused(&[0, 1]), None);
        assert!(placement.take_out(1));
        assert_eq!(refused(&[]), Some(0));
        assert!(!placement.take_out(0));
        assert_eq!(refused(&[]), None);
    }

    #[test]
    fn one_device_draws_all() {
        let placement = Arc::new(Placement::new(1, 1, 1));
        let unasked = || -> u64 { unreachable!("nobody asks how large it is") };
        for scene in ["a", "b", "c"] {
            let placed = placement.place(scene, &[], unasked);
            assert_eq!(placed.map(|(device, _)| device), Some(0));
        }
        assert!(placement.place("a", &[0], unasked).is_none());
        assert!(!placement.take_out(0) && placement.place("a", &[], unasked).is_none());
    }
}
