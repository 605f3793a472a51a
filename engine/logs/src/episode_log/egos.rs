//! Lines of the egos beside the first: what the lines of the others do not tell.

use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{Episode, EpisodeEnd, EpisodeHead, EpisodeStep, VehicleState};
use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::instant::{InstantForm, instant};
use super::record::{
    DrawnByForm, EndForm, HeadForm, LineForm, PlannerForm, StepForm, drawn_by, line, planner_record,
};

/// The first line of an ego beside the first.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OtherHeadForm {
    ego: usize,
    planner: PlannerForm,
    drawn_by: Option<DrawnByForm>,
    route_m: Vec<[f64; 2]>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    stop_lines: Vec<LineForm>,
    start: InstantForm,
}

/// The last line of an ego beside the first.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OtherEndForm {
    pub(super) ego: usize,
    pub(super) end: EndForm,
}

impl OtherEndForm {
    pub(super) fn from_end(ego: usize, end: &EpisodeEnd) -> Self {
        Self {
            ego,
            end: EndForm::from_end(end),
        }
    }
}

impl HeadForm {
    /// Part of it that the head of ego `ego` beside the first tells.
    pub(super) fn of_other(self, ego: usize) -> OtherHeadForm {
        OtherHeadForm {
            ego,
            planner: self.planner,
            drawn_by: self.drawn_by,
            route_m: self.route_m,
            stop_lines: self.stop_lines,
            start: self.start.without_agents(),
        }
    }
}

impl OtherHeadForm {
    /// The head of ego `ego`, where `first` is that of the first, and its start without agents.
    ///
    /// # Errors
    /// A sentence, when it is that of another ego.
    pub(super) fn into_head(
        self,
        first: &EpisodeHead,
        ego: usize,
    ) -> Result<(EpisodeHead, EpisodeTick), String> {
        if self.ego != ego {
            return Err(format!(
                "is the head of ego {}; expected ego {ego}",
                self.ego
            ));
        }
        let mut agent_sizes = first.agent_sizes.clone();
        let others = first.scenario.egos.others.len();
        let slot = agent_sizes.len().checked_sub(others).map(|at| at + ego - 1);
        if let Some(size) = slot.and_then(|slot| agent_sizes.get_mut(slot)) {
            *size = first.scenario.ego.size;
        }
        let head = EpisodeHead {
            scenario: first.scenario.for_ego(ego),
            planner: planner_record(self.planner),
            drawn_by: self.drawn_by.map(drawn_by),
            route_m: self.route_m.into_iter().map(DVec2::from_array).collect(),
            agent_sizes,
            stop_lines: self.stop_lines.into_iter().map(line).collect(),
            ..first.clone()
        };
        Ok((head, instant(self.start)))
    }
}

/// Moments of a step that lines before have told, each as one ego saw it.
#[derive(Clone, Debug, Default)]
pub(super) struct Told {
    /// Number of egos.
    egos: usize,
    /// Number of the step after the one that is told; 0: the start.
    step: u32,
    /// Egos that told, and moments.
    instants: Vec<(usize, EpisodeTick)>,
    /// The step as the first of its lines tells it, without moments.
    world: Option<EpisodeStep>,
}

impl Told {
    /// The start of the first of several egos.
    pub(super) fn from_start(egos: usize, start: &EpisodeTick) -> Self {
        Self {
            egos,
            instants: vec![(0, start.clone())],
            ..Self::default()
        }
    }

    /// The head and the start of ego `ego`, from those of the `first`.
    ///
    /// # Errors
    /// A sentence, if the form tells another start.
    pub(super) fn head(
        &self,
        first: &EpisodeHead,
        ego: usize,
        form: OtherHeadForm,
    ) -> Result<(EpisodeHead, EpisodeTick), String> {
        let (head, mut start) = form.into_head(first, ego)?;
        self.complete(ego, 0, &mut start)?;
        Ok((head, start))
    }

    /// The form of the head of ego `ego`, whose start has been told.
    ///
    /// # Errors
    /// A sentence, if the start is another one than that which was told.
    pub(super) fn head_form(&self, ego: usize, episode: &Episode) -> Result<OtherHeadForm, String> {
        self.check(ego, 0, &episode.start)?;
        let form = HeadForm::from_head(&episode.head, &episode.start)?;
        Ok(form.of_other(ego))
    }

    /// Goes on to a step. What was told of the one before is forgotten.
    fn enter(&mut self, step: u32) {
        let after = step.saturating_add(1);
        if self.step != after {
            *self = Self {
                egos: self.egos,
                step: after,
                ..Self::default()
            };
        }
    }

    /// The form of `step` of ego `ego`.
    ///
    /// # Errors
    /// A sentence, if it is another world than that which was told.
    pub(super) fn step_form(
        &mut self,
        ego: usize,
        step: &EpisodeStep,
        version: u32,
    ) -> Result<StepForm, String> {
        self.enter(step.step);
        let told = self.instants.len();
        for (index, instant) in step.instants.iter().take(told).enumerate() {
            self.check(ego, index, instant)?;
        }
        let form = StepForm::from_step(step, version);
        let form = form.of_ego(ego, told, self.world.is_some());
        self.note(ego, step);
        Ok(form)
    }

    /// Adds to `step` of ego `ego` what its line leaves out.
    ///
    /// # Errors
    /// A sentence, if its line leaves out what no line has told.
    pub(super) fn complete_step(
        &mut self,
        ego: usize,
        step: &mut EpisodeStep,
    ) -> Result<(), String> {
        self.enter(step.step);
        for (index, instant) in step.instants.iter_mut().enumerate() {
            if index < self.instants.len() {
                self.complete(ego, index, instant)?;
            }
        }
        if let Some(world) = &self.world {
            step.handovers.clone_from(&world.handovers);
            step.commands.clone_from(&world.commands);
            step.lights.clone_from(&world.lights);
        }
        Ok(())
    }

    fn note(&mut self, ego: usize, step: &EpisodeStep) {
        let new = step.instants.iter().skip(self.instants.len());
        self.instants
            .extend(new.map(|instant| (ego, instant.clone())));
        self.world.get_or_insert_with(|| EpisodeStep {
            instants: Vec::new(),
            ..step.clone()
        });
    }

    /// Agents at moment `index` as ego `ego` sees them.
    fn agents_for(&self, ego: usize, index: usize) -> Vec<Option<VehicleState>> {
        let (teller, instant) = &self.instants[index];
        instant.agents_for(self.egos, *teller, ego)
    }

    fn complete(&self, ego: usize, index: usize, instant: &mut EpisodeTick) -> Result<(), String> {
        instant.agents = self.agents_for(ego, index);
        self.check(ego, index, instant)
    }

    fn check(&self, ego: usize, index: usize, instant: &EpisodeTick) -> Result<(), String> {
        let (teller, told) = &self.instants[index];
        let own = told.ego_state(self.egos, *teller, ego);
        if told.time_s == instant.time_s
            && own == Some(instant.ego)
            && self.agents_for(ego, index) == instant.agents
        {
            return Ok(());
        }
        Err(format!(
            "ego {ego} is in another world than ego {teller} at {} s",
            instant.time_s
        ))
    }
}
