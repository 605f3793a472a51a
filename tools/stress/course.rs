//! Which moments are drawn from where.

use decouplegs::asset::LoadedScene;
use decouplegs::scene::Camera;

/// The drive that every mode makes.
pub struct Course {
    /// The moment of the first frame, seconds.
    pub start_s: f64,
    /// From one frame to the next, seconds.
    pub step_s: f64,
    /// Frames before those that are timed.
    pub warm_up: u32,
    /// Frames that are timed.
    pub frames: u32,
    /// Moments among them at which pictures are compared.
    pub samples: u32,
    /// How many of the rig's cameras are drawn.
    pub cameras_used: usize,
    /// Cameras that stand, instead of the rig's.
    pub standing: Option<Vec<Camera>>,
}

impl Course {
    pub fn time_s(&self, frame: u32) -> f64 {
        self.start_s + f64::from(frame) * self.step_s
    }

    /// All frames, warm-up included.
    pub fn frame_count(&self) -> u32 {
        self.warm_up + self.frames
    }

    /// The middle of the timed frames, seconds: where agents stand that cannot drive.
    pub fn middle_s(&self) -> f64 {
        self.time_s(self.warm_up + self.frames / 2)
    }

    /// The cameras at `time_s`.
    pub fn cameras(&self, scene: &LoadedScene, time_s: f64) -> Vec<Camera> {
        let mut cameras = self.all_cameras(scene, time_s);
        cameras.truncate(self.cameras_used);
        cameras
    }

    /// The frames whose pictures are compared: timed ones, evenly spread.
    pub fn sample_frames(&self) -> Vec<u32> {
        let count = self.samples.min(self.frames);
        let place = |at: u32| ((2 * u64::from(at) + 1) * u64::from(self.frames) / (2 * u64::from(count))) as u32;
        (0..count).map(|at| self.warm_up + place(at)).collect()
    }

    /// `count` moments spread over all of the ego's way, seconds: more than the drive sees where that is short.
    pub fn way_moments_s(&self, scene: &LoadedScene, count: u32) -> Vec<f64> {
        let (start_s, end_s) = (scene.ego.start_s(), scene.ego.end_s());
        (0..count).map(|at| start_s + (f64::from(at) + 0.5) / f64::from(count) * (end_s - start_s)).collect()
    }

    /// All cameras at `time_s`, those that are not drawn too.
    pub fn all_cameras(&self, scene: &LoadedScene, time_s: f64) -> Vec<Camera> {
        self.standing.clone().unwrap_or_else(|| scene.rig.at(&scene.ego.at(time_s)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_timed_frames_and_spread() {
        let course =
            |frames, samples| Course { start_s: 1.0, step_s: 0.5, warm_up: 10, frames, samples, cameras_used: 1, standing: None };
        assert_eq!(course(6, 3).sample_frames(), [11, 13, 15]);
        assert_eq!(course(2, 5).sample_frames(), [10, 11]);
        assert_eq!(course(7, 1).sample_frames(), [13]);
        assert!(course(4, 0).sample_frames().is_empty());
        assert_eq!((course(6, 3).middle_s(), course(6, 3).frame_count()), (7.5, 16));
    }
}
