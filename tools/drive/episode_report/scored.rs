//! An episode that was scored, without its steps.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use decouplegs::drive::score::{
    CommandedAgents, Conduct, EpisodeScore, ExtendedPdmScore, Infraction, InfractionKind, PdmScore,
};
use decouplegs::episode::StepTime;
use decouplegs::logs::read_episode_log;
use decouplegs::scene::Level;
use decouplegs::scene::episode::{Episode, EpisodeEnd, EpisodeHead, EpisodeTick};
use decouplegs::scene::scenario::Place;
use glam::DVec2;

use crate::seen::Seen;

/// An episode and what it is worth.
///
/// Runs have many thousand: what took place in each step is read from its log again by the few that
/// show it.
pub struct Scored {
    pub head: EpisodeHead,
    /// Number of the ego among those of the log, from 0.
    ego: usize,
    /// Name of the scenario, followed by that of the ego where there are several.
    name: String,
    pub end: EpisodeEnd,
    /// Positions of the ego over time, the start included.
    pub way: Vec<WayPoint>,
    pub taken: Taken,
    pub score: EpisodeScore,
    pub pdm: PdmScore,
    pub extended_pdm: ExtendedPdmScore,
    /// Rules that are scored beside the driving score.
    pub conduct: Conduct,
    /// Agents that another program drove, if one did.
    pub commanded: Option<CommandedAgents>,
    pub log: PathBuf,
    /// Folder of its images, if there are any.
    pub images: PathBuf,
    /// Record of what was seen of a captured place.
    pub seen: Seen,
    /// Times of its steps; none if it was driven before.
    pub times: Option<Vec<StepTime>>,
}

/// The ego at a time.
#[derive(Clone, Copy)]
pub struct WayPoint {
    pub time_s: f64,
    pub position_m: DVec2,
}

/// Numbers of images and sweeps that were taken.
#[derive(Clone, Copy, Default)]
pub struct Taken {
    pub images: usize,
    pub sweeps: usize,
}

impl Taken {
    fn by(episode: &Episode) -> Self {
        let lidars = &episode.head.planner.lidars;
        let readings = || episode.steps.iter().flat_map(|step| &step.readings);
        let is_sweep = |sensor: &String| lidars.contains(sensor);
        let sweeps = readings().filter(|one| is_sweep(&one.sensor)).count();
        Self {
            images: readings().count() - sweeps,
            sweeps,
        }
    }
}

impl Scored {
    /// Each ego of `episode`. Images of several egos are in folders of their names, in `images`.
    pub fn egos(
        mut episode: Episode,
        log: &Path,
        images: &Path,
        times: Option<&Vec<StepTime>>,
    ) -> Result<Vec<Self>> {
        let others = std::mem::take(&mut episode.others);
        let several = !others.is_empty();
        let egos = std::iter::once(episode).chain(others).enumerate();
        egos.map(|(ego, episode)| {
            let own = &episode.head.scenario.egos.own.name;
            let images = match several {
                true => images.join(own),
                false => images.to_owned(),
            };
            // Times of steps are those of all egos together.
            let times = times.filter(|_| ego == 0).cloned();
            let scored = Self::new(episode, log.to_owned(), images, times)?;
            Ok(Self { ego, ..scored })
        })
        .collect()
    }

    fn new(
        episode: Episode,
        log: PathBuf,
        images: PathBuf,
        times: Option<Vec<StepTime>>,
    ) -> Result<Self> {
        let scenario = &episode.head.scenario;
        let name = match scenario.egos.others.as_slice() {
            [] => scenario.name.clone(),
            _ => format!("{}/{}", scenario.name, scenario.egos.own.name),
        };
        let score = EpisodeScore::new(&episode);
        let way_point = |instant: &EpisodeTick| WayPoint {
            time_s: instant.time_s,
            position_m: instant.ego.position_m,
        };
        let (pdm, conduct) = (
            PdmScore::new(&episode, &score),
            Conduct::new(&episode, &score),
        );
        let reference = &conduct.reference;
        Ok(Self {
            extended_pdm: ExtendedPdmScore::new(&episode, &score, &pdm, reference),
            pdm,
            conduct,
            score,
            commanded: CommandedAgents::new(&episode),
            seen: Seen::beside(&log)?,
            way: episode.instants().map(way_point).collect(),
            taken: Taken::by(&episode),
            head: episode.head,
            ego: 0,
            name,
            end: episode.end,
            log,
            images,
            times,
        })
    }

    /// The episode, with all its steps, from its log.
    ///
    /// # Errors
    /// Returns an error if the log cannot be read any more.
    pub fn whole(&self) -> Result<Episode> {
        let mut episode = read_episode_log(&self.log)?;
        ensure!(
            self.ego <= episode.others.len(),
            "{} is another log than it was: drive the episode again",
            self.log.display()
        );
        Ok(match self.ego {
            0 => episode,
            ego => episode.others.swap_remove(ego - 1),
        })
    }

    /// Name of the episode, followed by that of the ego where there are several.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Name of the episode, which its files have.
    pub fn scenario_name(&self) -> &str {
        &self.head.scenario.name
    }

    /// The place, as it is where nothing is drawn: all weathers and sizes have the same lanes.
    pub fn place(&self) -> Place {
        match &self.head.scenario.place {
            Place::Street { weather, seed, .. } => Place::Street {
                weather: *weather,
                background: 0,
                agent_splats: 0,
                seed: *seed,
            },
            place => place.clone(),
        }
    }

    /// True if the ego was at fault.
    pub fn at_fault(&self) -> bool {
        self.score.infractions.iter().any(Infraction::at_fault)
    }

    pub fn level(&self) -> Option<Level> {
        self.head.scenario.level
    }

    /// Reason of its end, for people.
    pub fn ending(&self) -> String {
        let warm_up_s = self.score.warm_up_s;
        let how = self.how_it_ended();
        if warm_up_s > 0.0 {
            return format!("{how} (the planner had no plan yet for {warm_up_s:.1} s)");
        }
        how
    }

    fn how_it_ended(&self) -> String {
        match &self.end {
            EpisodeEnd::RouteDone => "route done".into(),
            EpisodeEnd::Collision { agent } => {
                let name = self.head.scenario.agent(*agent).0;
                let hit = |infraction: &Infraction| match infraction.kind {
                    InfractionKind::Collision {
                        agent: other,
                        fault,
                        ..
                    } if other == *agent => Some(fault.why()),
                    _ => None,
                };
                let why = self
                    .score
                    .infractions
                    .iter()
                    .find_map(hit)
                    .unwrap_or("nobody knows why");
                format!("collision with {name}: {why}")
            }
            EpisodeEnd::Obstacle { obstacle } => {
                format!("collision with a {}", obstacle.kind.name())
            }
            EpisodeEnd::OffRoad => "off the road for good".into(),
            EpisodeEnd::OffRoute => "too far from the route".into(),
            EpisodeEnd::Story => "end of the story".into(),
            EpisodeEnd::Time => "time over".into(),
            EpisodeEnd::Planner { reason } => format!("planner failed: {reason}"),
        }
    }
}

impl Scored {
    /// Position of the ego at a time, or at the last moment before it, meters.
    pub fn place_m(&self, time_s: f64) -> DVec2 {
        let before = self.way.iter();
        let before = before.take_while(|point| point.time_s <= time_s + 1e-9);
        // An episode has a start.
        before.last().unwrap_or(&self.way[0]).position_m
    }

    /// The PDM score as a product of its terms.
    pub fn pdm_explained(&self) -> String {
        let PdmScore {
            no_collision,
            drivable_area,
            progress,
            time_to_collision,
            comfort,
            pdm_score,
        } = self.pdm;
        format!(
            "PDMS {pdm_score:.3} = NC {no_collision:.1} × DAC {drivable_area:.0} × (5 EP {progress:.3} + 5 TTC {time_to_collision:.0} + 2 C {comfort:.0}) / 12"
        )
    }

    /// Time that was lost, by what; `None` where it is less than half a second.
    pub fn time_lost(&self) -> Option<String> {
        let lost = &self.score.time_lost;
        let mut parts = Vec::new();
        let mut add = |what: &str, lost_s: f64| {
            if lost_s >= 0.05 {
                parts.push(format!("{what} {lost_s:.1} s"));
            }
        };
        add("red light", lost.light_s);
        add("behind others", lost.behind_all_s());
        if let Some((agent, behind_s)) = lost.longest_behind() {
            let name = self.head.scenario.agent(agent).0;
            add(&format!("of it behind {name}"), behind_s);
        }
        add("yielding", lost.yielding_s);
        add("other", lost.other_s);
        let sum_s = lost.sum_s();
        (sum_s >= 0.5).then(|| format!("{sum_s:.1} s lost: {}", parts.join(", ")))
    }

    /// The driving score as a product, each factor with its infraction and its moment.
    pub fn explained(&self) -> String {
        let factor = |infraction: &Infraction| {
            format!(
                " × {:.2} ({} at {:.1} s)",
                infraction.factor(),
                infraction.describe(&self.head),
                infraction.time_s
            )
        };
        let factors: String = self.score.infractions.iter().map(factor).collect();
        let lost = match &self.end {
            EpisodeEnd::RouteDone => "",
            EpisodeEnd::Story => &format!(
                " (counts as {:.3}: the story was over)",
                self.score.counted_completion
            ),
            EpisodeEnd::Time => " (time over)",
            EpisodeEnd::Collision { .. } if self.score.ended_by_other => {
                " (counts as 1.000: ended by a collision that was not its fault)"
            }
            EpisodeEnd::Collision { .. } | EpisodeEnd::Obstacle { .. } => {
                " (ended by the collision)"
            }
            EpisodeEnd::OffRoad => " (off the road for good)",
            EpisodeEnd::OffRoute => " (too far from the route)",
            EpisodeEnd::Planner { .. } => " (the planner failed)",
        };
        format!(
            "DS {:.3} = RC {:.3}{lost}{factors}",
            self.score.driving_score, self.score.route_completion
        )
    }
}
