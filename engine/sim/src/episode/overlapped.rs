//! Steps of a planner that uses no readings: the device draws the images of a step, and they
//! are hashed, while that step and the next one are driven.

use std::time::{Duration, Instant};

use decouplegs_scene::episode::ReadingRecord;

use super::{EpisodeError, EpisodeObserver, ObservationRenderer, Rollout, StepTime, ask, laps};
use crate::planner::Planner;

/// The images of steps, one step behind the steps.
pub(super) struct Overlapped<'a> {
    renderer: &'a mut ObservationRenderer,
    /// False if images are only hashed.
    is_watched: bool,
    /// The step whose images are not finished, and whether it has some.
    waiting: Option<(u32, bool)>,
}

impl<'a> Overlapped<'a> {
    /// Steps without images yet. `renderer` has no LiDARs, whose sweeps are not traced ahead.
    /// Unless the observer uses them (`is_watched`), images stay on the device.
    pub(super) fn new(renderer: &'a mut ObservationRenderer, is_watched: bool) -> Self {
        Self {
            renderer,
            is_watched,
            waiting: None,
        }
    }

    /// Time of the device for the images that were finished last.
    pub(super) fn device_time(&self) -> Duration {
        self.renderer.device_time()
    }

    /// One step: its images are submitted, it is planned and driven, and the step before is handed
    /// to `observer` with its readings. The time of drawing is what the step waited for.
    pub(super) fn step(
        &mut self,
        rollout: &mut Rollout,
        planner: &mut dyn Planner,
        observer: &mut dyn EpisodeObserver,
    ) -> Result<StepTime, EpisodeError> {
        let number = rollout.next_step();
        let mut time = StepTime::default();
        let mut lap = laps();
        let is_drawn = self.renderer.submit(rollout.simulation(), number)?;
        time.draw = lap();
        let before = self.waiting.take();
        let (renderer, is_watched) = (&mut *self.renderer, self.is_watched);
        let (is_driven, finished) = std::thread::scope(|scope| {
            let finishing = before.map(|(step, is_drawn)| {
                let finish = move || {
                    let finished = renderer.finish(is_drawn, is_watched);
                    finished.map(|()| (step, renderer.hashes()))
                };
                scope.spawn(finish)
            });
            let answer = ask(rollout, 0, planner, &[]);
            time.plan = lap();
            let is_driven = match answer {
                Ok(plan) => {
                    rollout.step(plan, Vec::new(), planner.is_warming_up());
                    true
                }
                Err(error) => {
                    rollout.fail(0, error.to_string());
                    false
                }
            };
            time.advance = lap();
            let finished = finishing.map(|thread| thread.join().expect("drawing does not panic"));
            (is_driven, finished)
        });
        let finished = finished.transpose()?;
        time.draw += lap();
        if let Some((step, hashes)) = finished {
            self.hand_over(step, hashes, rollout, observer)?;
        }
        time.observer = lap();
        match is_driven {
            true => self.waiting = Some((number, is_drawn)),
            // A step that was not driven has no images either.
            false => self.renderer.finish(is_drawn, self.is_watched)?,
        }
        Ok(time)
    }

    /// Finishes the last step. The time that this takes.
    pub(super) fn finish(
        &mut self,
        rollout: &mut Rollout,
        observer: &mut dyn EpisodeObserver,
    ) -> Result<Duration, EpisodeError> {
        let since = Instant::now();
        if let Some((step, is_drawn)) = self.waiting.take() {
            self.renderer.finish(is_drawn, self.is_watched)?;
            self.hand_over(step, self.renderer.hashes(), rollout, observer)?;
        }
        Ok(since.elapsed())
    }

    /// Hands `step`, whose readings are finished, to `observer`.
    fn hand_over(
        &self,
        step: u32,
        hashes: Vec<ReadingRecord>,
        rollout: &mut Rollout,
        observer: &mut dyn EpisodeObserver,
    ) -> Result<(), EpisodeError> {
        let step = rollout.set_readings(step, hashes);
        observer.step(step, &self.renderer.readings())
    }
}
