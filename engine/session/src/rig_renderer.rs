//! One rig over several devices: the cameras and LiDARs of a step are divided between them.

use std::path::Path;
use std::sync::Arc;

use decouplegs_asset::open_scene;
use decouplegs_render::TracedSweep;
use decouplegs_scene::lidar::ReturnMode;
use decouplegs_scene::{Camera, Lidar};

use super::{BatchRenderer, HostImages, Scene, Session, SessionError, World, WorldView};

/// Pixels of a camera that take about as long as one beam of a LiDAR. Six cameras and two LiDARs
/// are divided alike for any number between 8 and 40.
const PIXELS_PER_BEAM: u64 = 16;

/// A sweep to trace: the LiDAR, the time of the world since the start of the sweep (see
/// [`BatchRenderer::trace`]), and its returns.
#[derive(Clone, Debug)]
pub struct RigSweep {
    /// LiDAR and its way during the sweep.
    pub lidar: Lidar,
    /// Time of the world after the start of the sweep, seconds.
    pub world_s: f64,
    /// Returns that can be made of the sweep.
    pub mode: ReturnMode,
}

/// Draws one world by several devices at once, each of which has the scene. Images and sweeps are
/// the same bytes as those of one device of the same kind, as no camera depends on others. Light
/// that is baked on demand ([`super::SessionOptions::bakes_light_on_demand`]) is an exception: it
/// depends on what a device has drawn before.
pub struct RigRenderer {
    devices: Vec<RigDevice>,
    /// Device, and index on it, of each camera.
    images: Vec<(usize, usize)>,
    /// Device, and index on it, of each sweep.
    sweeps: Vec<(usize, usize)>,
}

struct RigDevice {
    scene: Arc<Scene>,
    renderer: BatchRenderer,
    images: HostImages,
    sweeps: Vec<TracedSweep>,
}

impl RigRenderer {
    /// A renderer on `sessions`, each with its own copy of the scene at `path`, which is read once.
    ///
    /// # Errors
    /// Returns an error if a file is missing or wrong, or a device has not the memory.
    ///
    /// # Panics
    /// Panics if there is no session.
    pub fn open(sessions: &[Session], path: &Path) -> Result<Self, SessionError> {
        let loaded = open_scene(path, 0.0)?;
        let add = |session: &Session| session.add_scene(&loaded);
        let scenes: Vec<_> = std::thread::scope(|scope| {
            let add = &add;
            let threads = sessions
                .iter()
                .map(|session| scope.spawn(move || add(session)));
            let threads: Vec<_> = threads.collect();
            let ends = threads.into_iter().map(|thread| thread.join());
            ends.map(|end| end.expect("a scene is added without a panic"))
                .collect::<Result<_, _>>()
        })?;
        Ok(Self::new(sessions, scenes))
    }

    /// A renderer on `sessions`, each with the scene of the same place in `scenes`. They have to
    /// show the same.
    ///
    /// # Panics
    /// Panics if there is no session, or not one scene for each.
    #[must_use]
    pub fn new(sessions: &[Session], scenes: Vec<Arc<Scene>>) -> Self {
        assert!(!sessions.is_empty(), "a rig is drawn by one device or more");
        assert_eq!(sessions.len(), scenes.len(), "each session has its scene");
        let device = |(session, scene): (&Session, Arc<Scene>)| RigDevice {
            scene,
            renderer: session.batch_renderer(),
            images: HostImages::default(),
            sweeps: Vec::new(),
        };
        Self {
            devices: sessions.iter().zip(scenes).map(device).collect(),
            images: Vec::new(),
            sweeps: Vec::new(),
        }
    }

    /// The scene on the first device, over which worlds are made.
    #[must_use]
    pub fn scene(&self) -> &Arc<Scene> {
        &self.devices[0].scene
    }

    /// Draws what `cameras` see of `world` and traces `sweeps`, on all devices at once, and waits
    /// for them. `world` is over the scene of any of the devices.
    ///
    /// # Errors
    /// Returns an error if a camera, a LiDAR or an agent cannot be drawn, a scene lacks an asset of
    /// the world, or a device has not the memory or was lost.
    pub fn draw(
        &mut self,
        world: &World,
        cameras: &[Camera],
        sweeps: &[RigSweep],
    ) -> Result<(), SessionError> {
        let pixels = cameras.iter().map(|camera| camera.intrinsics.pixels());
        let beams = sweeps.iter().map(|sweep| {
            let model = &sweep.lidar.model;
            PIXELS_PER_BEAM * (model.rings() * model.columns()) as u64
        });
        let costs: Vec<u64> = pixels.chain(beams).collect();
        let devices = divided(&costs, self.devices.len());
        let (of_cameras, of_sweeps) = devices.split_at(cameras.len());
        (self.images, self.sweeps) = (numbered(of_cameras), numbered(of_sweeps));
        std::thread::scope(|scope| {
            let mut threads = Vec::new();
            for (position, device) in self.devices.iter_mut().enumerate() {
                let cameras = chosen(cameras, of_cameras, position);
                let sweeps = chosen(sweeps, of_sweeps, position);
                threads.push(scope.spawn(move || device.draw(world, &cameras, &sweeps)));
            }
            let ends = threads.into_iter().map(|thread| thread.join());
            // All of them are waited for, whatever the first one says.
            let ends: Vec<_> = ends.collect();
            ends.into_iter()
                .try_for_each(|end| end.expect("a device draws without a panic"))
        })
    }

    /// Width and height of a camera's image, pixels.
    ///
    /// # Panics
    /// Panics if the last step had no such camera.
    #[must_use]
    pub fn size_px(&self, camera: usize) -> [u32; 2] {
        let (device, index) = self.images[camera];
        self.devices[device].images.size_px(0, index)
    }

    /// The image of a camera of the last step: four bytes per pixel, rows from the top.
    ///
    /// # Panics
    /// Panics if the last step had no such camera.
    #[must_use]
    pub fn rgba(&self, camera: usize) -> &[u8] {
        let (device, index) = self.images[camera];
        self.devices[device].images.rgba(0, index)
    }

    /// A sweep of the last step.
    ///
    /// # Panics
    /// Panics if the last step had no such sweep.
    #[must_use]
    pub fn sweep(&self, sweep: usize) -> &TracedSweep {
        let (device, index) = self.sweeps[sweep];
        &self.devices[device].sweeps[index]
    }

    /// The device that drew each camera of the last step, by position.
    pub fn devices_of_cameras(&self) -> impl Iterator<Item = usize> {
        self.images.iter().map(|(device, _)| *device)
    }
}

impl RigDevice {
    fn draw(
        &mut self,
        world: &World,
        cameras: &[Camera],
        sweeps: &[RigSweep],
    ) -> Result<(), SessionError> {
        self.images.clear();
        let world = &world.over(&self.scene)?;
        // The device draws while the host prepares the first sweep.
        if !cameras.is_empty() {
            self.renderer.submit(&[WorldView { world, cameras }])?;
        }
        let traced = (self.renderer).trace_all(world, sweeps, &mut self.sweeps);
        if !cameras.is_empty() {
            self.renderer.finish(&mut self.images)?;
        }
        traced
    }
}

/// The device of each item: the most expensive first, each to the device with the least to do.
fn divided(costs: &[u64], devices: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..costs.len()).collect();
    order.sort_by_key(|&item| std::cmp::Reverse(costs[item]));
    let (mut sums, mut chosen) = (vec![0_u64; devices], vec![0; costs.len()]);
    for item in order {
        let device = (0..devices).min_by_key(|&device| sums[device]);
        let device = device.unwrap_or(0);
        sums[device] = sums[device].saturating_add(costs[item]);
        chosen[item] = device;
    }
    chosen
}

/// Each item's device, and its number among the items of that device.
fn numbered(devices: &[usize]) -> Vec<(usize, usize)> {
    let number = |item: usize| {
        let before = devices[..item].iter();
        before.filter(|device| **device == devices[item]).count()
    };
    let items = devices.iter().enumerate();
    items
        .map(|(item, device)| (*device, number(item)))
        .collect()
}

/// Items of one device.
fn chosen<T: Clone>(items: &[T], devices: &[usize], position: usize) -> Vec<T> {
    let items = items.iter().zip(devices);
    items
        .filter(|(_, device)| **device == position)
        .map(|(item, _)| item.clone())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rig_is_divided_by_what_its_sensors_cost() {
        let (camera, lidar) = (1600 * 900, PIXELS_PER_BEAM * 460_800);
        let rig = [camera, camera, camera, camera, camera, camera, lidar, lidar];
        let mut sums = [[0; 2]; 2];
        for (item, device) in divided(&rig, 2).into_iter().enumerate() {
            sums[device][usize::from(item >= 6)] += 1;
        }
        assert_eq!(sums, [[3, 1], [3, 1]]);
        assert_eq!(divided(&rig, 1), [0; 8]);
        assert_eq!(divided(&[], 2), [0; 0]);
        assert_eq!(numbered(&[1, 0, 1, 1]), [(1, 0), (0, 0), (1, 1), (1, 2)]);
        assert_eq!(chosen(&['a', 'b', 'c'], &[1, 0, 1], 1), ['a', 'c']);
    }
}
