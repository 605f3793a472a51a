//! Traffic lights and their controllers, as a story directs them.

use std::sync::Arc;

use decouplegs_scene::episode::LightChangeRecord;
use decouplegs_scene::story::{Action, LightController, Story, When};
use decouplegs_scene::{Invalid, LightChange, LightColor, LightCourse};

use crate::lights::TrafficLights;

/// Traffic lights of a story.
#[derive(Clone, Debug, Default)]
pub(super) struct Signals {
    /// Lights as they are now.
    pub lights: Arc<TrafficLights>,
    /// Changes that were not yet taken.
    pub changes: Vec<LightChangeRecord>,
    /// Controllers, and their positions in the cycle at time 0, seconds.
    controllers: Vec<(LightController, f64)>,
}

impl Signals {
    /// # Errors
    /// A sentence if there is no light or controller of a name.
    pub(super) fn new(story: &Story, lights: &Arc<TrafficLights>) -> Result<Self, Invalid> {
        let signals = Self {
            lights: Arc::clone(lights),
            changes: Vec::new(),
            controllers: story
                .controllers
                .iter()
                .map(|controller| (controller.clone(), controller.offset_s))
                .collect(),
        };
        for action in story.tasks().map(|task| &task.action) {
            match action {
                Action::Light { light, .. } => signals.check_light(light)?,
                Action::Phase { controller, .. } => signals.check_controller(controller)?,
                _ => {}
            }
        }
        for condition in story.conditions() {
            match &condition.when {
                When::Light { light, .. } => signals.check_light(light)?,
                When::Phase { controller, .. } => signals.check_controller(controller)?,
                _ => {}
            }
        }
        Ok(signals)
    }

    fn check_light(&self, name: &str) -> Result<(), Invalid> {
        let no_light = || {
            Invalid::new(format!(
                "the story names a traffic light {name}; there is none"
            ))
        };
        self.lights.find(name).map(drop).ok_or_else(no_light)
    }

    fn check_controller(&self, name: &str) -> Result<(), Invalid> {
        let none = || {
            Invalid::new(format!(
                "the story names a controller {name}; there is none"
            ))
        };
        self.find(name).map(drop).ok_or_else(none)
    }

    fn find(&self, controller: &str) -> Option<usize> {
        let mut all = self.controllers.iter();
        all.position(|(known, _)| known.name == controller)
    }

    /// True if a light has a color.
    pub(super) fn shows(&self, light: &str, color: LightColor, time_s: f64) -> bool {
        let light = self.lights.find(light);
        light.is_some_and(|light| self.lights.color_at(light, time_s) == color)
    }

    /// True if a controller is in a phase.
    pub(super) fn is_in(&self, controller: &str, phase: &str, time_s: f64) -> bool {
        self.find(controller).is_some_and(|at| {
            let (controller, offset_s) = &self.controllers[at];
            controller.phase_at(time_s + offset_s) == Some(phase)
        })
    }

    /// Gives a light a color.
    pub(super) fn hold(&mut self, light: &str, color: LightColor, time_s: f64) {
        self.change(light, time_s, LightCourse::Held(color));
    }

    /// Begins a phase of a controller.
    pub(super) fn begin(&mut self, controller: &str, phase: &str, time_s: f64) {
        let Some(at) = self.find(controller) else {
            return;
        };
        let (controller, offset_s) = &mut self.controllers[at];
        let Some(begin_s) = controller.begin_of(phase) else {
            return;
        };
        *offset_s = begin_s - time_s;
        let course = LightCourse::Cycle {
            offset_s: *offset_s,
        };
        for light in controller.lights.clone() {
            self.change(&light, time_s, course);
        }
    }

    fn change(&mut self, light: &str, time_s: f64, course: LightCourse) {
        let Some(light) = self.lights.find(light) else {
            return;
        };
        let change = LightChange { time_s, course };
        Arc::make_mut(&mut self.lights).change(light, change);
        self.changes.push(LightChangeRecord { light, change });
    }
}
