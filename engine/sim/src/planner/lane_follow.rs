//! Lane-following planner with privileged state: the Intelligent Driver Model along the route, slow
//! in bends, yielding to vehicles that will be in the way. The baseline of planners that see
//! images.

mod corridor;
mod lights;
mod signs;

use decouplegs_drive::traffic::idm::{BRAKING_MPS2, IdmParameters, Leader};
use decouplegs_scene::plan::Plan;

use self::corridor::{Corridor, PredictedPath, Span};
use super::cadence::{HORIZON_S, plan_through};
use super::{
    Cameras, EpisodeInfo, KnownAgent, Observation, ObservationRequest, Planner, PlannerError,
    Privileged, state_needed,
};

/// Sideways acceleration that is borne in bends.
const LATERAL_MPS2: f64 = 2.0;
/// Deceleration for curves.
const BEND_MPS2: f64 = 2.0;
/// Time step of the prediction, seconds.
const TICK_S: f64 = 0.2;
/// A vehicle that will be on the strip within this time is followed as if it were there, seconds.
const FORESIGHT_S: f64 = 2.0;
/// Room that a crossing vehicle is given, meters.
const CROSSING_M: f64 = 1.0;
/// Being off the route's middle decays along this much of it, meters.
const RETURN_M: f64 = 8.0;
/// Ways to slow down that are tried, the most comfortable first.
const BRAKES_MPS2: [f64; 6] = [0.0, 1.0, 2.0, 3.5, 5.0, BRAKING_MPS2];

/// Driving style of [`LaneFollow`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DrivingStyle {
    /// Headway of 1.5 s, and the cruise speed.
    #[default]
    Normal,
    /// Headway of 2.2 s, 85 % of the cruise speed, earlier and softer braking, more time before
    /// vehicles that cross.
    Cautious,
    /// Headway of 1 s, later and harder braking, less time before vehicles that cross. It is told
    /// of others one observation late.
    Brisk,
}

impl DrivingStyle {
    /// All styles.
    pub const ALL: [Self; 3] = [Self::Normal, Self::Cautious, Self::Brisk];

    /// Name of the planner of this style.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Normal => "lane-follow",
            Self::Cautious => "lane-follow-cautious",
            Self::Brisk => "lane-follow-brisk",
        }
    }

    /// Style of the planner of this name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|style| style.name() == name)
    }

    const fn parameters(self) -> StyleParameters {
        let normal = StyleParameters {
            headway_s: 1.5,
            acceleration_mps2: 1.5,
            comfort_mps2: 2.0,
            cruise_share: 1.0,
            crossing_s: 0.6,
            is_late: false,
        };
        match self {
            Self::Normal => normal,
            Self::Cautious => StyleParameters {
                headway_s: 2.2,
                comfort_mps2: 1.5,
                cruise_share: 0.85,
                crossing_s: 1.0,
                ..normal
            },
            Self::Brisk => StyleParameters {
                headway_s: 1.0,
                acceleration_mps2: 2.0,
                comfort_mps2: 3.0,
                crossing_s: 0.4,
                is_late: true,
                ..normal
            },
        }
    }
}

/// Numbers of a driving style.
#[derive(Clone, Copy, Debug)]
struct StyleParameters {
    /// Headway to the vehicle ahead, seconds.
    headway_s: f64,
    /// Acceleration: livelier than Treiber's 1 m/s^2, as the ego has a route to finish.
    acceleration_mps2: f64,
    /// Deceleration for others, with comfort.
    comfort_mps2: f64,
    /// Share of the cruise speed that is driven.
    cruise_share: f64,
    /// Time by which a crossing vehicle may be earlier or later, seconds.
    crossing_s: f64,
    /// True if it drives by the agents of the observation before.
    is_late: bool,
}

/// Follows the lanes of its route. Privileged: it is told the states of all vehicles.
#[derive(Clone, Debug, Default)]
pub struct LaneFollow {
    style: DrivingStyle,
    /// Agents of the last observation, for a style that is late.
    seen: Option<Vec<KnownAgent>>,
    /// Position along the route at the last observation, meters.
    arc_m: Option<f64>,
    /// Stop line at which it stops, meters along the route.
    hold_m: Option<f64>,
    /// Line of the stop sign at which it has stood, meters along the route.
    stood_m: Option<f64>,
}

/// An agent as it is expected to go on: a span for each tick.
struct Expected {
    way: PredictedPath,
    spans: Vec<Span>,
}

/// Knowledge for the choice of a trajectory.
struct Outlook {
    ego_arc_m: f64,
    half_length_m: f64,
    idm: IdmParameters,
    /// Time by which a crossing vehicle may be earlier or later, seconds.
    crossing_s: f64,
    /// Stop line at which it stops, meters along the route.
    hold_m: Option<f64>,
    /// Highest speed at each meter ahead.
    bend_mps: Vec<f64>,
    agents: Vec<Expected>,
}

/// Positions along the route, one a tick, and the first time at which a vehicle is met on them.
struct Candidate {
    arcs_m: Vec<f64>,
    met_s: Option<f64>,
}

impl LaneFollow {
    /// A planner of this style.
    #[must_use]
    pub fn new(style: DrivingStyle) -> Self {
        Self {
            style,
            ..Self::default()
        }
    }
}

impl Planner for LaneFollow {
    fn name(&self) -> String {
        self.style.name().into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest {
            cameras: Cameras::None,
            privileged: true,
            ..ObservationRequest::default()
        }
    }

    fn uses_readings(&self) -> bool {
        false
    }

    fn begin(&mut self, _: &EpisodeInfo) -> Result<(), PlannerError> {
        *self = Self::new(self.style);
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let known = state_needed(observation, self.style.name())?;
        let corridor = Corridor::new(
            &known.route_m,
            known.ego.position_m,
            known.ego_size.width_m,
            self.arc_m,
        )
        .ok_or_else(|| {
            PlannerError("lane-follow needs a route of at least two positions, all finite".into())
        })?;
        self.arc_m = Some(corridor.ego_arc_m);
        let light_m = lights::hold_m(&corridor, known, self.hold_m);
        self.hold_m = light_m;
        let sign_m = signs::hold_m(&corridor, known, &mut self.stood_m);
        let hold_m = light_m.into_iter().chain(sign_m).min_by(f64::total_cmp);
        let style = self.style.parameters();
        let cruise_mps = style.cruise_share * observation.guidance.cruise_mps;
        let before = style
            .is_late
            .then(|| self.seen.replace(known.agents.clone()))
            .flatten();
        let agents = before.as_ref().unwrap_or(&known.agents);
        let outlook = Outlook::new(&corridor, (known, agents), (style, cruise_mps), hold_m);
        let course = outlook.choose(known.ego.speed_mps);
        plan_through(|time_s| {
            let arc_m = course.at(time_s);
            let lateral_m =
                corridor.ego_lateral_m * (-(arc_m - corridor.ego_arc_m) / RETURN_M).exp();
            known.ego.to_local(corridor.place(arc_m, lateral_m))
        })
    }
}

/// Ticks from the observation to the end of the plan, that of the observation included.
fn ticks() -> usize {
    (HORIZON_S / TICK_S).round() as usize + 1
}

impl Outlook {
    fn new(
        corridor: &Corridor,
        (known, agents): (&Privileged, &[KnownAgent]),
        (style, cruise_mps): (StyleParameters, f64),
        hold_m: Option<f64>,
    ) -> Self {
        let times_s: Vec<f64> = (0..ticks()).map(|tick| tick as f64 * TICK_S).collect();
        let near = |speed_mps: f64| 40.0 + HORIZON_S * (known.ego.speed_mps + speed_mps);
        let agents = agents.iter().filter(|KnownAgent { state, .. }| {
            state.position_m.distance(known.ego.position_m) < near(state.speed_mps)
        });
        let agents = agents.map(|KnownAgent { state, size, .. }| {
            let (way, spans) = corridor.spans(state, size, &times_s);
            // Those before a red light on another road will not be in the way.
            let stays = way == PredictedPath::Across && lights::stops(known, state);
            (!stays).then_some(Expected { way, spans })
        });
        Self {
            ego_arc_m: corridor.ego_arc_m,
            half_length_m: 0.5 * known.ego_size.length_m,
            idm: IdmParameters {
                speed_mps: cruise_mps,
                headway_s: style.headway_s,
                acceleration_mps2: style.acceleration_mps2,
                braking_mps2: style.comfort_mps2,
                ..IdmParameters::default()
            },
            crossing_s: style.crossing_s,
            hold_m,
            bend_mps: bend_speeds(corridor, known.ego.speed_mps.max(cruise_mps)),
            // Vehicles behind on the same road watch the ego, not the ego them.
            agents: agents
                .flatten()
                .filter(|agent| {
                    !(agent.way == PredictedPath::Along
                        && agent.spans[0].front_m < corridor.ego_arc_m)
                })
                .collect(),
        }
    }

    /// The most comfortable course on which no vehicle is met, else the one on which one is met
    /// last.
    fn choose(&self, speed_mps: f64) -> Candidate {
        let mut best: Option<Candidate> = None;
        for brake_mps2 in BRAKES_MPS2 {
            let course = self.roll(speed_mps, brake_mps2);
            let met_s = course.met_s.unwrap_or(f64::INFINITY);
            if best
                .as_ref()
                .is_none_or(|best| met_s >= best.met_s.unwrap_or(f64::INFINITY))
            {
                best = Some(course);
            }
            if met_s == f64::INFINITY {
                break;
            }
        }
        best.expect("there are ways to slow down")
    }

    /// Simulates the ego's motion when it follows and brakes with at least `brake_mps2`.
    fn roll(&self, speed_mps: f64, brake_mps2: f64) -> Candidate {
        let (mut arc_m, mut speed_mps) = (self.ego_arc_m, speed_mps);
        let mut course = Candidate {
            arcs_m: vec![arc_m],
            met_s: None,
        };
        for tick in 0..ticks() - 1 {
            let mut rate_mps2 = self.rate(tick, arc_m, speed_mps);
            if brake_mps2 > 0.0 {
                rate_mps2 = rate_mps2.min(-brake_mps2);
            }
            let next_mps = (speed_mps + rate_mps2 * TICK_S).max(0.0);
            arc_m += 0.5 * (speed_mps + next_mps) * TICK_S;
            speed_mps = next_mps;
            course.arcs_m.push(arc_m);
            if course.met_s.is_none()
                && self
                    .agents
                    .iter()
                    .any(|agent| self.meets(agent, tick + 1, arc_m))
            {
                course.met_s = Some((tick + 1) as f64 * TICK_S);
            }
        }
        course
    }

    /// Acceleration of the ego at `arc_m` for the road and for all vehicles on it.
    fn rate(&self, tick: usize, arc_m: f64, speed_mps: f64) -> f64 {
        let meter = ((arc_m - self.ego_arc_m + speed_mps * TICK_S).round() as usize)
            .min(self.bend_mps.len() - 1);
        let bend_mps2 = (self.bend_mps[meter] - speed_mps) / (2.0 * TICK_S);
        let foresight = (FORESIGHT_S / TICK_S).round() as usize;
        let followed = self.agents.iter().filter(|agent| {
            let until = if agent.way == PredictedPath::Across {
                tick
            } else {
                (tick + foresight).min(agent.spans.len() - 1)
            };
            let ahead = 0.5 * (agent.spans[tick].rear_m + agent.spans[tick].front_m) > arc_m;
            ahead && agent.spans[tick..=until].iter().any(|span| span.inside)
        });
        let standing = self.hold_m.map(|hold_m| Leader {
            gap_m: hold_m - (arc_m + self.half_length_m),
            speed_mps: 0.0,
        });
        let hold_mps2 = standing.map_or(f64::INFINITY, |line| {
            self.idm.acceleration(speed_mps, Some(line))
        });
        let rates = followed.map(|agent| {
            let gap_m = agent.spans[tick].rear_m - (arc_m + self.half_length_m);
            self.idm.acceleration(
                speed_mps,
                Some(Leader {
                    gap_m,
                    speed_mps: agent.spans[tick].speed_mps,
                }),
            )
        });
        rates
            .fold(
                self.idm
                    .free_acceleration(speed_mps)
                    .min(bend_mps2)
                    .min(hold_mps2),
                f64::min,
            )
            .max(-BRAKING_MPS2)
    }

    /// True if the ego at `arc_m` touches the agent, or nearly does.
    fn meets(&self, agent: &Expected, tick: usize, arc_m: f64) -> bool {
        let crossing = agent.way == PredictedPath::Across;
        let slack = if crossing {
            (self.crossing_s / TICK_S).round() as usize
        } else {
            0
        };
        let room_m = self.half_length_m + if crossing { CROSSING_M } else { 0.0 };
        let until = (tick + slack).min(agent.spans.len() - 1);
        let spans = &agent.spans[tick.saturating_sub(slack)..=until];
        spans.iter().any(|span| {
            span.inside && span.rear_m < arc_m + room_m && span.front_m > arc_m - room_m
        })
    }
}

impl Candidate {
    /// Position along the route `time_s` from now, meters.
    fn at(&self, time_s: f64) -> f64 {
        let at = (time_s / TICK_S).clamp(0.0, (self.arcs_m.len() - 1) as f64);
        let before = at.floor() as usize;
        let after = (before + 1).min(self.arcs_m.len() - 1);
        self.arcs_m[before] + (self.arcs_m[after] - self.arcs_m[before]) * (at - before as f64)
    }
}

/// The highest speed at each meter ahead from which every bend is still reached slowly enough.
fn bend_speeds(corridor: &Corridor, speed_mps: f64) -> Vec<f64> {
    let count = (HORIZON_S * speed_mps + 0.5 * speed_mps * speed_mps / BEND_MPS2).clamp(1.0, 400.0)
        as usize
        + 1;
    let bend = |meter: usize| {
        (LATERAL_MPS2
            / corridor
                .curvature_at(corridor.ego_arc_m + meter as f64)
                .max(1e-6))
        .sqrt()
    };
    let mut speeds: Vec<f64> = (0..=count).map(bend).collect();
    for meter in (0..count).rev() {
        let reached_mps = (speeds[meter + 1].powi(2) + 2.0 * BEND_MPS2).sqrt();
        speeds[meter] = speeds[meter].min(reached_mps);
    }
    speeds
}
