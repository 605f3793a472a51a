//! Numeric requirements of each level.
//!
//! Counts, light and behaviors are those of the paper's supplement ("Definition of Evaluation
//! Scenarios"). Speeds and distances it does not give: they are ours.

use decouplegs_scene::scenario::DriverKind;
use decouplegs_scene::{Level, Weather};

/// Agents nearer than this to the ego at the start are those that a level counts, meters from
/// middle to middle.
pub const NEAR_M: f64 = 50.0;

/// Least and greatest number of agents within [`NEAR_M`] of the ego at the start.
#[must_use]
pub const fn agents_near(level: Level) -> (usize, usize) {
    match level {
        Level::Easy => (1, 3),
        Level::Medium => (4, 8),
        Level::Hard => (9, 15),
        Level::Extreme => (16, 24),
    }
}

/// The light of a level: one of these.
#[must_use]
pub const fn weathers(level: Level) -> &'static [Weather] {
    match level {
        Level::Easy => &[Weather::Clear],
        Level::Medium => &[Weather::Clear, Weather::Overcast],
        Level::Hard => &[Weather::Dusk, Weather::Overcast],
        // Dusk is the one with the sun low ahead: glare.
        Level::Extreme => &[Weather::Night, Weather::Dusk],
    }
}

/// Levels from which parts of a scenario's difficulty are taken, where these differ from the level
/// of the scenario. Light, route and start of the ego are always those of its own level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Difficulty {
    /// Number of vehicles and their speed, and whether crossings are full.
    pub density: Option<Level>,
    /// Drivers, injected behaviors, pedestrians, and the speed of the vehicle ahead.
    pub surprise: Option<Level>,
    /// Time limit.
    pub time: Option<Level>,
}

/// Further differences between levels. Pairs are least and most; shares of speed are of what a lane
/// allows.
pub(super) struct LevelRequirements {
    /// Agents within [`NEAR_M`] of the ego.
    pub near: (usize, usize),
    /// Agents that come along from farther away.
    pub far: (usize, usize),
    pub drivers: &'static [DriverKind],
    /// Share of the agents that may change lanes voluntarily.
    pub lane_change_share: f64,
    pub ego_speed_share: (f64, f64),
    /// Share of the ego's speed, not of what the lane allows.
    pub lead_speed_share: (f64, f64),
    /// Share of the scenarios in which a vehicle drives ahead of the ego.
    pub lead_share: f64,
    pub flow_speed_share: (f64, f64),
    /// Initial distance of the ego's front from a crossing, meters.
    pub before_crossing_m: (f64, f64),
    /// Fraction of scenarios whose ego starts before an intersection.
    pub crossing_share: f64,
    /// True if the ways to the crossing are full.
    pub congested: bool,
    pub cut_ins: usize,
    /// True if the vehicle ahead brakes hard.
    pub lead_brakes: bool,
    pub swerves: (usize, usize),
    /// Pedestrians where the scenarios have them, and those of them who do not wait for a gap.
    pub pedestrians: (usize, usize),
    pub stepping_out: usize,
    pub time: TimeBudget,
}

/// Time limit of an episode by the duration of a reference drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeBudget {
    /// Factor on the reference.
    pub factor: f64,
    /// Time to wait for others, seconds.
    pub waiting_s: f64,
}

impl TimeBudget {
    const fn new(factor: f64, waiting_s: f64) -> Self {
        Self { factor, waiting_s }
    }

    /// The limit, whole seconds.
    pub fn budget_s(self, reference_s: f64) -> f64 {
        (self.factor * reference_s + self.waiting_s).ceil()
    }
}

impl LevelRequirements {
    /// The requirements of `level`, with parts of other levels.
    pub fn new(level: Level, difficulty: Difficulty) -> Self {
        let density = Self::for_one_level(difficulty.density.unwrap_or(level));
        let surprise = Self::for_one_level(difficulty.surprise.unwrap_or(level));
        let Self {
            before_crossing_m,
            crossing_share,
            ego_speed_share,
            lead_share,
            ..
        } = Self::for_one_level(level);
        Self {
            near: density.near,
            far: density.far,
            flow_speed_share: density.flow_speed_share,
            congested: density.congested,
            time: Self::for_one_level(difficulty.time.unwrap_or(level)).time,
            before_crossing_m,
            crossing_share,
            ego_speed_share,
            lead_share,
            ..surprise
        }
    }

    fn for_one_level(level: Level) -> Self {
        use DriverKind::{Aggressive, Calm, Hurried, Normal};
        let easy = Self {
            near: agents_near(Level::Easy),
            far: (0, 2),
            drivers: &[Calm, Normal],
            lane_change_share: 0.0,
            ego_speed_share: (0.7, 0.9),
            lead_speed_share: (0.9, 1.0),
            lead_share: 0.7,
            flow_speed_share: (0.7, 0.9),
            before_crossing_m: (40.0, 90.0),
            crossing_share: 0.5,
            congested: false,
            cut_ins: 0,
            lead_brakes: false,
            swerves: (0, 0),
            pedestrians: (0, 1),
            stepping_out: 0,
            time: TimeBudget::new(2.0, 30.0),
        };
        let medium = Self {
            near: agents_near(Level::Medium),
            pedestrians: (1, 2),
            far: (2, 4),
            drivers: &[Calm, Normal, Normal, Normal],
            lane_change_share: 0.6,
            ego_speed_share: (0.8, 1.0),
            lead_speed_share: (0.3, 0.6),
            lead_share: 1.0,
            flow_speed_share: (0.6, 0.9),
            before_crossing_m: (30.0, 70.0),
            crossing_share: 0.8,
            time: TimeBudget::new(1.5, 15.0),
            ..easy
        };
        let hard = Self {
            near: agents_near(Level::Hard),
            pedestrians: (2, 3),
            stepping_out: 1,
            far: (4, 8),
            drivers: &[Normal, Normal, Hurried],
            lane_change_share: 0.7,
            lead_speed_share: (0.25, 0.5),
            flow_speed_share: (0.3, 0.7),
            // Nearer than this, the vehicle ahead finds no room before the crossing.
            before_crossing_m: (24.0, 38.0),
            crossing_share: 1.0,
            congested: true,
            cut_ins: 1,
            time: TimeBudget::new(1.25, 18.0),
            ..medium
        };
        match level {
            Level::Easy => easy,
            Level::Medium => medium,
            Level::Hard => hard,
            Level::Extreme => Self {
                near: agents_near(Level::Extreme),
                pedestrians: (3, 4),
                stepping_out: 2,
                far: (6, 10),
                drivers: &[Normal, Hurried, Aggressive],
                lane_change_share: 0.9,
                lead_speed_share: (0.2, 0.4),
                lead_brakes: true,
                swerves: (1, 3),
                time: TimeBudget::new(1.0, 17.0),
                ..hard
            },
        }
    }
}
