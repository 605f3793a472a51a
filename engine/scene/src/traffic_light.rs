//! Traffic lights: stop lines and the phases in which vehicles may pass them.

use serde::{Deserialize, Serialize};

/// Color of a traffic light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightColor {
    /// Vehicles may pass, after those with the right of way.
    Green,
    /// Vehicles that can stop comfortably stop.
    Yellow,
    /// Vehicles stop.
    Red,
}

impl LightColor {
    /// All colors in the order in which lights show them.
    pub const ALL: [Self; 3] = [Self::Green, Self::Yellow, Self::Red];

    /// Name in files and in the protocol of planners.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Green => "green",
            Self::Yellow => "yellow",
            Self::Red => "red",
        }
    }

    /// The color that a file names so.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|color| color.name() == name)
    }
}

/// Part of a light's cycle with one color.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightPhase {
    /// Color of the light.
    pub color: LightColor,
    /// Duration, seconds, above 0.
    pub duration_s: f64,
}

/// Position on a lane before which vehicles stop.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StopLine {
    /// Lane, by id.
    pub lane: String,
    /// Position on the lane, meters along it.
    pub at_m: f64,
    /// Successors of the lane, by id, towards which vehicles stop; none: towards all of them.
    pub towards: Vec<String>,
}

impl StopLine {
    /// True if it stops a vehicle that goes on to the lane `next`. One whose way ends is stopped by
    /// the lines alone that are towards all lanes.
    #[must_use]
    pub fn binds(&self, next: Option<&str>) -> bool {
        let is_named = |next| self.towards.iter().any(|lane| lane == next);
        self.towards.is_empty() || next.is_some_and(is_named)
    }
}

/// Traffic light, or a group of lights that always show the same color.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrafficLight {
    /// Unique in its scenario or map.
    pub name: String,
    /// Stop lines that it controls.
    pub stop_lines: Vec<StopLine>,
    /// Phases of a cycle, in order. Empty only in maps that do not tell them.
    pub phases: Vec<LightPhase>,
    /// Position in the cycle at time 0, seconds.
    pub offset_s: f64,
    /// Changes by events of an episode, in the order of their times. Empty before it begins, and
    /// in files of scenarios and maps.
    pub changes: Vec<LightChange>,
}

/// Change of a light by an event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightChange {
    /// Time since the start of the episode, seconds.
    pub time_s: f64,
    /// Course of the light from then on.
    pub course: LightCourse,
}

/// Course of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightCourse {
    /// The same color all the time.
    Held(LightColor),
    /// The phases, with another position in the cycle at time 0, seconds.
    Cycle {
        /// That position.
        offset_s: f64,
    },
}

impl TrafficLight {
    /// Duration of a cycle, seconds.
    #[must_use]
    pub fn cycle_s(&self) -> f64 {
        self.phases.iter().map(|phase| phase.duration_s).sum()
    }

    /// Color at a time, and the seconds until the next phase or change; infinite where none comes.
    /// A light without phases is green.
    #[must_use]
    pub fn phase_at(&self, time_s: f64) -> (LightColor, f64) {
        let after = self
            .changes
            .partition_point(|change| change.time_s <= time_s);
        let (before, later) = self.changes.split_at(after);
        let next_s = later
            .first()
            .map_or(f64::INFINITY, |change| change.time_s - time_s);
        let (color, rest_s) = match before.last().map(|change| change.course) {
            Some(LightCourse::Held(color)) => (color, f64::INFINITY),
            Some(LightCourse::Cycle { offset_s }) => self.phase_at_position(time_s + offset_s),
            None => self.phase_at_position(time_s + self.offset_s),
        };
        (color, rest_s.min(next_s))
    }

    /// Color at a position in the cycle, seconds, and the seconds until the next phase.
    fn phase_at_position(&self, position_s: f64) -> (LightColor, f64) {
        let Some(last) = self.phases.last() else {
            return (LightColor::Green, f64::INFINITY);
        };
        let mut rest_s = position_s.rem_euclid(self.cycle_s());
        for phase in &self.phases {
            if rest_s < phase.duration_s {
                return (phase.color, phase.duration_s - rest_s);
            }
            rest_s -= phase.duration_s;
        }
        // Rounding at the end of the cycle.
        (last.color, 0.0)
    }

    /// Color at a time, seconds since the start.
    #[must_use]
    pub fn color_at(&self, time_s: f64) -> LightColor {
        self.phase_at(time_s).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_follow_each_other_in_a_cycle() {
        let phase = |color, duration_s| LightPhase { color, duration_s };
        let light = TrafficLight {
            phases: vec![
                phase(LightColor::Green, 10.0),
                phase(LightColor::Yellow, 3.0),
                phase(LightColor::Red, 12.0),
            ],
            offset_s: 9.0,
            ..TrafficLight::default()
        };
        assert_eq!(light.cycle_s(), 25.0);
        assert_eq!(light.phase_at(0.0), (LightColor::Green, 1.0));
        assert_eq!(light.phase_at(1.0), (LightColor::Yellow, 3.0));
        assert_eq!(light.phase_at(4.0), (LightColor::Red, 12.0));
        assert_eq!(light.phase_at(16.0), (LightColor::Green, 10.0));
        assert_eq!(light.phase_at(-10.0), (LightColor::Red, 1.0));
        assert_eq!(light.phase_at(25.0), light.phase_at(0.0));
        assert_eq!(TrafficLight::default().color_at(3.0), LightColor::Green);
    }

    #[test]
    fn changes_count_from_their_time_on() {
        let phase = |color| LightPhase {
            color,
            duration_s: 10.0,
        };
        let change = |time_s, course| LightChange { time_s, course };
        let light = TrafficLight {
            phases: vec![phase(LightColor::Green), phase(LightColor::Red)],
            changes: vec![
                change(4.0, LightCourse::Held(LightColor::Red)),
                change(7.0, LightCourse::Cycle { offset_s: 11.0 }),
                change(40.0, LightCourse::Held(LightColor::Yellow)),
            ],
            ..TrafficLight::default()
        };
        assert_eq!(light.phase_at(1.0), (LightColor::Green, 3.0));
        assert_eq!(light.phase_at(4.0), (LightColor::Red, 3.0));
        assert_eq!(light.phase_at(7.0), (LightColor::Red, 2.0));
        assert_eq!(light.phase_at(9.5), (LightColor::Green, 9.5));
        assert_eq!(light.phase_at(39.5), (LightColor::Red, 0.5));
        assert_eq!(light.phase_at(41.0), (LightColor::Yellow, f64::INFINITY));
    }
}
