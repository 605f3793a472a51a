//! Moments and cameras of the measurement.

use std::collections::VecDeque;
use std::iter;
use std::time::{Duration, Instant};

use anyhow::Result;
use decouplegs::asset::LoadedScene;
use decouplegs::gpu::DeviceKind;
use decouplegs::render::{FrameStatistics, Renderer};
use decouplegs::scene::Camera;

/// The clocks of a GPU that idled rise within some 100 ms of work; frames before that take twice as
/// long.
const CLOCKS_RISE: Duration = Duration::from_millis(500);

/// A drive of more frames is not made once as a warm-up.
const REHEARSED_FRAMES_MAX: u32 = 240;

/// Frames drawn once more with every stage timed: stages that are timed do not overlap, and a frame
/// may take longer.
const FRAMES_BY_STAGE_MAX: u32 = 10;

/// The drive that every mode makes.
pub struct DriveSchedule {
    /// The moment of the first timed frame, seconds.
    pub start_s: f64,
    /// Interval between frames, seconds.
    pub step_s: f64,
    /// Least number of frames before those that are timed.
    pub warm_up: u32,
    /// Frames that are timed.
    pub frames: u32,
    /// Moments among them at which images are compared.
    pub samples: u32,
    /// Number of the rig's cameras that are rendered.
    pub cameras_used: usize,
    /// Cameras that stand, instead of the rig's.
    pub standing: Option<Vec<Camera>>,
}

/// Frames before the timed frames.
pub struct WarmUp {
    /// One turn of it: frames of the schedule, drawn backwards so that the timed ones go on where
    /// it ends.
    pub turn: Vec<u32>,
    /// Least total time for which turns are repeated.
    pub least: Duration,
}

/// Times of a drive.
pub struct Driven {
    /// The timed frames.
    pub frames: Vec<FrameStatistics>,
    /// Wall clock from the end of the frame before to that of each, milliseconds.
    pub steps_ms: Vec<f64>,
    /// Frames before the timed ones.
    pub warm_up_frames: usize,
}

impl WarmUp {
    /// The frames to draw, and whether they are timed: the warm-up from now on, then the schedule
    /// of `frames`.
    pub fn then(self, frames: u32) -> impl Iterator<Item = (u32, bool)> {
        let begun = Instant::now();
        let mut turns = 0;
        let warm_up = iter::from_fn(move || {
            turns += 1;
            (turns == 1 || begun.elapsed() < self.least).then(|| self.turn.clone())
        });
        warm_up
            .flatten()
            .map(|frame| (frame, false))
            .chain((0..frames).map(|frame| (frame, true)))
    }
}

impl DriveSchedule {
    pub fn time_s(&self, frame: u32) -> f64 {
        self.start_s + f64::from(frame) * self.step_s
    }

    /// The warm-up on a device of `kind`. A GPU draws every frame of the schedule at least once, so
    /// that no list outgrows its buffer while it is timed, and long enough for its clocks to rise;
    /// software, which has no clocks of its own and takes long for a frame, draws as many as were
    /// asked for.
    pub fn warm_up_on(&self, kind: DeviceKind) -> WarmUp {
        let is_software = kind == DeviceKind::Cpu;
        let rehearsed = if is_software || self.frames > REHEARSED_FRAMES_MAX {
            0
        } else {
            self.frames
        };
        let turn = (1..=self.warm_up.max(rehearsed))
            .rev()
            .map(|ahead| ahead % self.frames)
            .collect();
        WarmUp {
            turn,
            least: if is_software {
                Duration::ZERO
            } else {
                CLOCKS_RISE
            },
        }
    }

    /// The warm-up and then the schedule, as far ahead as frames may be in flight; `submit` draws
    /// the moment it is given, seconds.
    pub fn drive(
        &self,
        renderer: &mut Renderer,
        mut submit: impl FnMut(&mut Renderer, f64) -> Result<()>,
    ) -> Result<Driven> {
        let mut driven = Driven {
            frames: Vec::new(),
            steps_ms: Vec::new(),
            warm_up_frames: 0,
        };
        let depth = renderer.options().frames_in_flight;
        // One follows the other without a pause, so that the first timed frame finds the device as
        // busy as the others do.
        let mut moments = self
            .warm_up_on(renderer.gpu().info().kind)
            .then(self.frames);
        // Of the frames in flight, oldest first, whether they are timed.
        let mut in_flight = VecDeque::with_capacity(depth);
        let mut last = Instant::now();
        loop {
            let next = moments.next();
            if let Some((frame, is_timed)) = next {
                submit(renderer, self.time_s(frame))?;
                in_flight.push_back(is_timed);
            }
            if in_flight.len() < depth && next.is_some() {
                continue;
            }
            let Some(is_timed) = in_flight.pop_front() else {
                return Ok(driven);
            };
            let statistics = renderer.finish()?;
            let now = Instant::now();
            let step_ms = (now - std::mem::replace(&mut last, now)).as_secs_f64() * 1e3;
            if is_timed {
                driven.frames.push(statistics);
                driven.steps_ms.push(step_ms);
            } else {
                driven.warm_up_frames += 1;
            }
        }
    }

    /// The last frames of the schedule, drawn once more with every stage timed.
    pub fn drive_by_stage(
        &self,
        renderer: &mut Renderer,
        mut submit: impl FnMut(&mut Renderer, f64) -> Result<()>,
    ) -> Result<Vec<FrameStatistics>> {
        renderer.time_stages(true);
        let last = self.frames.saturating_sub(FRAMES_BY_STAGE_MAX)..self.frames;
        let draw = |frame: u32| {
            submit(renderer, self.time_s(frame))?;
            Ok(renderer.finish()?)
        };
        last.map(draw).collect()
    }

    /// The middle of the timed frames, seconds: where agents stand that cannot drive.
    pub fn middle_s(&self) -> f64 {
        self.time_s(self.frames / 2)
    }

    /// The cameras at `time_s`.
    pub fn cameras(&self, scene: &LoadedScene, time_s: f64) -> Vec<Camera> {
        let mut cameras = self.all_cameras(scene, time_s);
        cameras.truncate(self.cameras_used);
        cameras
    }

    /// The frames whose images are compared: timed ones, evenly spread.
    pub fn sample_frames(&self) -> Vec<u32> {
        let count = self.samples.min(self.frames);
        let place = |at: u32| {
            ((2 * u64::from(at) + 1) * u64::from(self.frames) / (2 * u64::from(count))) as u32
        };
        (0..count).map(place).collect()
    }

    /// `count` moments spread over all of the ego's way, seconds: more than the drive sees where
    /// that is short.
    pub fn way_moments_s(&self, scene: &LoadedScene, count: u32) -> Vec<f64> {
        let (start_s, end_s) = (scene.ego.start_s(), scene.ego.end_s());
        (0..count)
            .map(|at| start_s + (f64::from(at) + 0.5) / f64::from(count) * (end_s - start_s))
            .collect()
    }

    /// All cameras at `time_s`, those that are not drawn too.
    pub fn all_cameras(&self, scene: &LoadedScene, time_s: f64) -> Vec<Camera> {
        self.standing
            .clone()
            .unwrap_or_else(|| scene.rig.at(&scene.ego.at(time_s)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schedule(warm_up: u32, frames: u32, samples: u32) -> DriveSchedule {
        DriveSchedule {
            start_s: 1.0,
            step_s: 0.5,
            warm_up,
            frames,
            samples,
            cameras_used: 1,
            standing: None,
        }
    }

    #[test]
    fn samples_are_timed_frames_and_spread() {
        assert_eq!(schedule(10, 6, 3).sample_frames(), [1, 3, 5]);
        assert_eq!(schedule(10, 2, 5).sample_frames(), [0, 1]);
        assert_eq!(schedule(10, 7, 1).sample_frames(), [3]);
        assert!(schedule(10, 4, 0).sample_frames().is_empty());
    }

    #[test]
    fn the_drive_does_not_depend_on_the_warm_up() {
        for warm_up in [1, 10, 1000] {
            let schedule = schedule(warm_up, 6, 3);
            assert_eq!(
                (
                    schedule.time_s(0),
                    schedule.middle_s(),
                    schedule.sample_frames()
                ),
                (1.0, 2.5, vec![1, 3, 5])
            );
        }
    }

    #[test]
    fn software_warms_up_by_what_was_asked_for_and_a_gpu_by_all_of_a_short_course() {
        let [software, gpu] = [DeviceKind::Cpu, DeviceKind::Discrete];
        assert_eq!(schedule(2, 6, 0).warm_up_on(software).turn, [2, 1]);
        assert_eq!(
            schedule(8, 6, 0).warm_up_on(software).turn,
            [2, 1, 0, 5, 4, 3, 2, 1]
        );
        assert_eq!(schedule(3, 1, 0).warm_up_on(software).turn, [0, 0, 0]);
        assert_eq!(schedule(2, 6, 0).warm_up_on(gpu).turn, [0, 5, 4, 3, 2, 1]);
        assert_eq!(schedule(2, 241, 0).warm_up_on(gpu).turn, [2, 1]);
        assert_eq!(schedule(2, 6, 0).warm_up_on(software).least, Duration::ZERO);
        assert!(schedule(2, 241, 0).warm_up_on(gpu).least >= Duration::from_millis(500));
    }

    #[test]
    fn a_warm_up_is_repeated_in_whole_turns_until_its_time_has_passed() {
        let all = |least| {
            let warm_up = WarmUp {
                turn: vec![2, 1],
                least,
            };
            let begun = Instant::now();
            let moments: Vec<(u32, bool)> = warm_up
                .then(3)
                .inspect(|_| std::thread::sleep(Duration::from_millis(1)))
                .collect();
            (moments, begun.elapsed())
        };
        let timed = [(0, true), (1, true), (2, true)];
        assert_eq!(
            all(Duration::ZERO).0,
            [[(2, false), (1, false)].as_slice(), &timed].concat()
        );
        let (moments, took) = all(Duration::from_millis(20));
        let (warm_up, rest) = moments.split_at(moments.len() - 3);
        assert!(
            took >= Duration::from_millis(20) && warm_up.len() >= 4,
            "{moments:?} in {took:?}"
        );
        assert!(
            warm_up
                .chunks(2)
                .all(|turn| turn == [(2, false), (1, false)])
                && rest == timed,
            "{moments:?}"
        );
    }
}
