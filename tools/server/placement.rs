//! Choice of the device that draws a scene: by load first, then by what fits, then by size.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Devices of a server, and the scenes that each of them has.
pub struct Placement {
    state: Mutex<State>,
    limits: PlacementLimits,
}

/// Limits of a placement.
#[derive(Clone, Copy, Debug)]
pub struct PlacementLimits {
    /// Scenes that one device keeps.
    pub scenes_max: usize,
    /// Bytes that the scenes of one device may take.
    pub bytes_max: u64,
    /// Devices that may have the same scene.
    pub copies_max: usize,
}

struct State {
    devices: Vec<DeviceState>,
    /// Devices of each scene that is on one or on its way to it.
    scenes: HashMap<String, Vec<Held>>,
    /// Scenes that left a device, or that it could not load: it gets no further copy of them.
    left: HashSet<(usize, String)>,
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
    /// False while the scene is on its way.
    is_there: bool,
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

/// Place of a request.
pub struct Placed {
    /// The device that draws it.
    pub device: usize,
    /// The request as a load of the device.
    pub load: Load,
    /// Devices that are to load a copy of the scene now.
    pub copies: Vec<usize>,
}

impl Placement {
    /// Placement on `devices` devices.
    pub fn new(devices: usize, limits: PlacementLimits) -> Self {
        Self {
            state: Mutex::new(State {
                devices: vec![DeviceState::default(); devices],
                scenes: HashMap::new(),
                left: HashSet::new(),
            }),
            limits,
        }
    }

    /// Place of a request for `scene` on none of the devices `refused`. A scene that is nowhere is
    /// placed, and takes about the bytes of `estimate`. `None` if no device is left.
    pub fn place(
        self: &Arc<Self>,
        scene: &str,
        refused: &[usize],
        estimate: impl FnOnce() -> u64,
    ) -> Option<Placed> {
        let draws = |state: &State, device: usize| {
            !state.devices[device].is_out && !refused.contains(&device)
        };
        let held = |state: &State| {
            let held = state.scenes.get(scene)?.iter();
            let held = held.filter(|held| draws(state, held.device));
            // The scene is there, or soon; then by what the devices have to do.
            held.min_by_key(|held| (!held.is_there, state.devices[held.device].requests))
                .map(|held| held.device)
        };
        let mut state = self.state();
        let are_several = state.devices.len() > 1;
        if held(&state).is_none() && are_several {
            // Sizes are found without the lock; meanwhile another request may have placed it.
            drop(state);
            let bytes = estimate();
            state = self.state();
            if held(&state).is_none() {
                let devices = (0..state.devices.len()).filter(|&device| draws(&state, device));
                let device = devices.min_by_key(|&device| self.cost(&state, device, bytes))?;
                let first = Held {
                    device,
                    bytes,
                    is_there: false,
                };
                state.scenes.insert(scene.to_owned(), vec![first]);
            }
        }
        let copies = match are_several {
            true => self.add_copies(&mut state, scene, refused),
            false => Vec::new(),
        };
        // One device needs no choice.
        let only = draws(&state, 0).then_some(0);
        let device = held(&state).or(only)?;
        state.devices[device].requests += 1;
        let load = Load {
            placement: Arc::clone(self),
            device,
        };
        Some(Placed {
            device,
            load,
            copies,
        })
    }

    /// Chooses devices for further copies of `scene`, as far as it may have some and they need not
    /// give up another scene.
    fn add_copies(&self, state: &mut State, scene: &str, refused: &[usize]) -> Vec<usize> {
        let mut added = Vec::new();
        loop {
            let held = state.scenes.get(scene).map_or(&[][..], Vec::as_slice);
            let Some(bytes) = held.first().map(|held| held.bytes) else {
                return added;
            };
            if held.len() >= self.limits.copies_max {
                return added;
            }
            let is_free = |device: &usize| {
                !state.devices[*device].is_out
                    && !refused.contains(device)
                    && held.iter().all(|held| held.device != *device)
                    && !state.left.contains(&(*device, scene.to_owned()))
                    && !self.is_full(state, *device, bytes)
            };
            let free = (0..state.devices.len()).filter(is_free);
            let Some(device) = free.min_by_key(|&device| self.cost(state, device, bytes)) else {
                return added;
            };
            let copy = Held {
                device,
                bytes,
                is_there: false,
            };
            state.scenes.entry(scene.to_owned()).or_default().push(copy);
            added.push(device);
        }
    }

    /// Order in which devices are chosen for a scene of `bytes`, the least first: those that have
    /// fewer requests, those that need not give up another scene, those whose scenes are smaller.
    fn cost(&self, state: &State, device: usize, bytes: u64) -> (usize, bool, u64, usize) {
        let (_, held_bytes) = state.held_by(device);
        let requests = state.devices[device].requests;
        let is_full = self.is_full(state, device, bytes);
        (requests, is_full, held_bytes, device)
    }

    /// True if `device` has to give up another scene for one of `bytes`.
    fn is_full(&self, state: &State, device: usize, bytes: u64) -> bool {
        let (scenes, held_bytes) = state.held_by(device);
        scenes >= self.limits.scenes_max || held_bytes.saturating_add(bytes) > self.limits.bytes_max
    }

    /// Says that `scene` takes `bytes` on `device`.
    pub fn holds(&self, device: usize, scene: &str, bytes: u64) {
        let mut state = self.state();
        if state.devices.len() == 1 {
            return;
        }
        let there = Held {
            device,
            bytes,
            is_there: true,
        };
        let held = state.scenes.entry(scene.to_owned()).or_default();
        match held.iter_mut().find(|held| held.device == device) {
            Some(held) => *held = there,
            None => {
                held.truncate(self.limits.copies_max - 1);
                held.push(there);
            }
        }
    }

    /// Says that `scene` is not on `device`: it has left, or could not be loaded.
    pub fn left(&self, device: usize, scene: &str) {
        let mut state = self.state();
        if let Some(held) = state.scenes.get_mut(scene) {
            held.retain(|held| held.device != device);
            if held.is_empty() {
                state.scenes.remove(scene);
            }
        }
        if self.limits.copies_max > 1 {
            state.left.insert((device, scene.to_owned()));
        }
    }

    /// Number of devices that `scene` is on.
    pub fn copies(&self, scene: &str) -> usize {
        let state = self.state();
        let held = state.scenes.get(scene).map_or(&[][..], Vec::as_slice);
        held.iter().filter(|held| held.is_there).count()
    }

    /// Scenes that all devices keep together at most.
    pub fn scenes_max(&self) -> u64 {
        (self.limits.scenes_max * self.state().devices.len()) as u64
    }

    /// Takes a device out for good, with all its scenes. True if others are left.
    pub fn take_out(&self, device: usize) -> bool {
        let mut state = self.state();
        state.devices[device].is_out = true;
        state.scenes.retain(|_, held| {
            held.retain(|held| held.device != device);
            !held.is_empty()
        });
        state.devices.iter().any(|device| !device.is_out)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Number and bytes of the scenes on `device`.
    fn held_by(&self, device: usize) -> (usize, u64) {
        let held = self.scenes.values().flatten();
        let held = held.filter(|held| held.device == device);
        held.fold((0, 0), |(scenes, bytes), held| {
            (scenes + 1, bytes + held.bytes)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placement(devices: usize, limits: (usize, u64, usize)) -> Arc<Placement> {
        let (scenes_max, bytes_max, copies_max) = limits;
        let limits = PlacementLimits {
            scenes_max,
            bytes_max,
            copies_max,
        };
        Arc::new(Placement::new(devices, limits))
    }

    fn placed(placement: &Arc<Placement>, scene: &str, bytes: u64) -> Option<(usize, Load)> {
        let placed = placement.place(scene, &[], || bytes)?;
        Some((placed.device, placed.load))
    }

    #[test]
    fn scenes_are_spread_by_load_and_by_size() {
        let placement = placement(2, (2, 100, 1));
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
        let placement = placement(2, (8, 100, 1));
        let refused = |refused: &[usize]| {
            let placed = placement.place("town", refused, || 1);
            placed.map(|placed| placed.device)
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
        let placement = placement(1, (1, 1, 1));
        let unasked = || -> u64 { unreachable!("nobody asks how large it is") };
        for scene in ["a", "b", "c"] {
            let placed = placement.place(scene, &[], unasked);
            assert_eq!(placed.map(|placed| placed.device), Some(0));
        }
        assert!(placement.place("a", &[0], unasked).is_none());
        assert!(!placement.take_out(0) && placement.place("a", &[], unasked).is_none());
    }

    #[test]
    fn copies_share_the_requests_of_their_scene() {
        let placement = placement(3, (2, 100, 2));
        let first = placement.place("town", &[], || 60).unwrap();
        assert_eq!((first.device, &first.copies[..]), (0, &[1][..]));
        let second = placed(&placement, "town", 60).unwrap();
        assert_eq!(second.0, 1, "the first device has a request already");
        placement.holds(0, "town", 60);
        assert_eq!(placement.copies("town"), 1, "the second is on its way");
        let third = placed(&placement, "town", 60).unwrap();
        assert_eq!(third.0, 0, "the scene is there");
        placement.holds(1, "town", 60);
        assert_eq!(placement.copies("town"), 2);
        let fourth = placed(&placement, "town", 60).unwrap();
        assert_eq!(fourth.0, 1, "the other has two requests");
        drop((first.load, second, third, fourth));
        // The third device alone need not give up a scene for this one: no other gets a copy.
        let large = placement.place("large", &[], || 90).unwrap();
        assert_eq!((large.device, large.copies.len()), (2, 0));
    }

    #[test]
    fn a_copy_that_left_does_not_come_back() {
        let placement = placement(2, (8, 100, 2));
        let copies = |refused: &[usize]| placement.place("town", refused, || 1).unwrap().copies;
        assert_eq!(copies(&[]), [1]);
        assert_eq!(copies(&[]), [] as [usize; 0]);
        placement.holds(0, "town", 1);
        placement.left(1, "town");
        assert_eq!(
            copies(&[]),
            [] as [usize; 0],
            "it could not be loaded there"
        );
        assert_eq!(placement.copies("town"), 1);
        // It is still drawn there where nothing else is left.
        assert!(placement.take_out(0));
        assert_eq!(
            placed(&placement, "town", 1).map(|(device, _)| device),
            Some(1)
        );
    }
}
