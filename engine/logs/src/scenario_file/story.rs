//! Checks of the story of a scenario.

use std::collections::HashSet;

use decouplegs_scene::story::{Action, LightController, Limits, Story, TrackedAgent, When, Who};
use toml::Value;

use super::check::{Fault, Table, check_name, check_size};

/// Events, acts, actions, conditions, variables, and points of a story.
const PARTS_MAX: usize = 10_000;
const POINTS_MAX: usize = 200_000;
/// Phases of a controller, and their durations, seconds: those of a traffic light.
const PHASES_MAX: usize = 100;
const PHASE_S: std::ops::RangeInclusive<f64> = 0.1..=3600.0;
/// Numbers and letters of a story.
const NUMBER_MAX: f64 = 1e9;
const TEXT_BYTES_MAX: usize = 1000;

fn fault(field: &'static str, reason: String) -> Fault {
    Fault::new(Table::Story, field, reason)
}

/// First fault of a story, if any. `names` are those of the other agents.
pub(super) fn check_story<'a>(story: &'a Story, names: &mut HashSet<&'a str>) -> Result<(), Fault> {
    for actor in &story.actors {
        check_name(Table::Story, &actor.name)?;
        check_size(Table::Story, actor.size())?;
        check_limits(&actor.limits)?;
        if !names.insert(actor.name.as_str()) {
            let reason = format!("'{}' is taken; names must differ", actor.name);
            return Err(fault("name", reason));
        }
    }
    check_tracks(&story.tracks.agents, names)?;
    let (tasks, conditions) = (story.tasks(), story.conditions());
    for (field, count, most) in [
        ("act", story.acts.len(), PARTS_MAX),
        ("event", story.events.len(), PARTS_MAX),
        ("actions", tasks.clone().count(), PARTS_MAX),
        ("start", conditions.clone().count(), PARTS_MAX),
        ("variables", story.variables.len(), PARTS_MAX),
        (
            "points_m",
            tasks.clone().map(|task| points(&task.action)).sum(),
            POINTS_MAX,
        ),
    ] {
        if count > most {
            return Err(fault(
                field,
                format!("{count} of them; expected at most {most}"),
            ));
        }
    }
    check_controllers(&story.controllers)?;
    let is_known = |who: Who| who.0 <= story.actors.len();
    for task in tasks {
        if !is_known(task.of) {
            return Err(fault("of", format!("there is no actor {}", task.of.0)));
        }
        if let Action::Profile {
            times_s,
            speeds_mps,
            ..
        } = &task.action
            && times_s.len() != speeds_mps.len()
        {
            return Err(fault("times_s", "expected as many times as speeds".into()));
        }
        if let Action::Profile { limits, .. }
        | Action::KeepGap { limits, .. }
        | Action::KeepBeside { limits, .. } = &task.action
        {
            check_limits(limits)?;
        }
    }
    for task in story.events.iter().flat_map(|event| &event.actions) {
        if let Action::Attack {
            ahead_s,
            every_s,
            best,
        } = task.action
        {
            let is_sound =
                (0.1..=60.0).contains(&ahead_s) && (0.02..=ahead_s).contains(&every_s) && best > 0;
            if !is_sound {
                let reason =
                    "expected ahead_s of 0.1 to 60, every_s of 0.02 to ahead_s, best of 1 or more";
                return Err(fault("attack", reason.into()));
            }
        }
    }
    if let Some(event) = story
        .events
        .iter()
        .find(|event| event.act >= story.acts.len())
    {
        return Err(fault("act", format!("there is no act {}", event.act)));
    }
    for condition in conditions {
        match &condition.when {
            When::Events { events, .. } => {
                if let Some(event) = events.iter().find(|event| **event >= story.events.len()) {
                    return Err(fault("events", format!("there is no event {event}")));
                }
            }
            When::Value { of, .. } => {
                if let Some(who) = of.iter().find(|who| !is_known(**who)) {
                    return Err(fault("of", format!("there is no actor {}", who.0)));
                }
            }
            _ => {}
        }
    }
    let values = Value::try_from(story).map_err(|error| fault("story", error.to_string()))?;
    check_values(&values)
}

/// First limit below zero, if any.
fn check_limits(limits: &Limits) -> Result<(), Fault> {
    let all = [
        limits.speed_mps,
        limits.acceleration_mps2,
        limits.deceleration_mps2,
        limits.acceleration_rate_mps3,
        limits.deceleration_rate_mps3,
    ];
    match all.into_iter().flatten().find(|limit| *limit < 0.0) {
        Some(limit) => Err(fault("limits", format!("{limit}; expected 0 or more"))),
        None => Ok(()),
    }
}

/// First fault of the controllers of traffic lights, if any.
fn check_controllers(controllers: &[LightController]) -> Result<(), Fault> {
    if controllers.len() > PARTS_MAX {
        let reason = format!(
            "{} of them; expected at most {PARTS_MAX}",
            controllers.len()
        );
        return Err(fault("controller", reason));
    }
    for controller in controllers {
        let count = controller.phases.len();
        if !(1..=PHASES_MAX).contains(&count) {
            let reason = format!("{count} of them; expected 1 to {PHASES_MAX}");
            return Err(fault("phases", reason));
        }
        let mut durations_s = controller.phases.iter().map(|(_, duration_s)| *duration_s);
        if let Some(duration_s) = durations_s.find(|duration_s| !PHASE_S.contains(duration_s)) {
            let (from, to) = (PHASE_S.start(), PHASE_S.end());
            let reason = format!("{duration_s} s; expected {from} to {to}");
            return Err(fault("phases", reason));
        }
    }
    Ok(())
}

fn check_tracks<'a>(agents: &'a [TrackedAgent], names: &mut HashSet<&'a str>) -> Result<(), Fault> {
    let poses: usize = agents.iter().map(|agent| agent.poses.len()).sum();
    if poses > POINTS_MAX {
        let reason = format!("{poses} of them; expected at most {POINTS_MAX}");
        return Err(fault("poses", reason));
    }
    for agent in agents {
        check_name(Table::Story, &agent.name)?;
        check_size(Table::Story, agent.size())?;
        agent
            .check()
            .map_err(|error| fault("tracks", error.into()))?;
        if !names.insert(agent.name.as_str()) {
            let reason = format!("'{}' is taken; names must differ", agent.name);
            return Err(fault("name", reason));
        }
    }
    Ok(())
}

fn points(action: &Action) -> usize {
    match action {
        Action::Follow {
            points_m, places, ..
        } => {
            let spots = places.iter().map(|place| place.spots().len());
            points_m.len() + spots.sum::<usize>()
        }
        Action::Route { points_m } => points_m.len(),
        Action::Profile { times_s, .. } => times_s.len(),
        _ => 0,
    }
}

/// Numbers that have a meaning, and texts of a usual length.
fn check_values(values: &Value) -> Result<(), Fault> {
    match values {
        Value::Float(number) if number.is_nan() || number.abs() > NUMBER_MAX => {
            let reason = format!("a number of {number}; expected -1e9 to 1e9");
            Err(fault("story", reason))
        }
        Value::String(text) if text.len() > TEXT_BYTES_MAX => {
            let reason = format!("a text of {} bytes; expected at most 1000", text.len());
            Err(fault("story", reason))
        }
        Value::Array(list) => list.iter().try_for_each(check_values),
        Value::Table(table) => table.values().try_for_each(check_values),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::Scenario;

    use crate::scenario_file::{parse, to_toml};

    /// A scenario whose story has an action and a condition of each kind.
    const TEXT: &str = include_str!("../../../asset/fuzz/seeds/scenario_file/story.toml");

    #[test]
    fn limits_below_zero_are_refused() {
        for (from, to) in [
            ("speed_mps = 30.0", "speed_mps = -30.0"),
            (
                "limits = { acceleration_mps2 = 2.0 }",
                "limits = { deceleration_mps2 = -2.0 }",
            ),
            (
                "acceleration_rate_mps3 = 1.0",
                "acceleration_rate_mps3 = -1.0",
            ),
        ] {
            assert!(TEXT.contains(from), "{from}");
            let refused = parse(&TEXT.replace(from, to)).unwrap_err().to_string();
            assert!(refused.contains("expected 0 or more"), "{refused}");
        }
    }

    #[test]
    fn stories_are_read_and_written() {
        let scenario: Scenario = parse(TEXT).unwrap();
        let story = &scenario.story;
        assert_eq!((story.actors.len(), story.events[0].actions.len()), (1, 16));
        assert_eq!(story.stop.len(), 2);
        assert_eq!(scenario.agent(0).0, "b");
        assert_eq!(parse(&to_toml(&scenario).unwrap()).unwrap(), scenario);
    }

    /// A car with three poses.
    const TRACKS: &str = r#"
[story.tracks]
handover = "all"

[[story.tracks.agent]]
name = "365"
kind = "car"
asset = 0
size_m = [4.5, 1.8, 1.5]
times_s = [-0.1, 0.0, 0.1]
poses = [[0.0, 1.0, 0.1], [1.0, 1.1, 0.1], [2.0, 1.2, 0.1]]
"#;

    #[test]
    fn recorded_tracks_are_read_and_written() {
        let text = format!("{TEXT}{TRACKS}");
        let scenario: Scenario = parse(&text).unwrap();
        assert_eq!(scenario.agent(1).0, "365");
        assert_eq!(scenario.agent_sizes().len(), scenario.agent_count());
        assert_eq!(parse(&to_toml(&scenario).unwrap()).unwrap(), scenario);
        for (from, to, reason) in [
            ("[-0.1, 0.0", "[-0.1, -0.1", "is not after the one before"),
            ("[-0.1, 0.0", "[0.0", "expected as many"),
            ("1.2, 0.1]", "1.2, inf]", "not finite"),
            ("\"365\"", "\"b\"", "'b' is taken"),
            ("\"all\"", "\"some\"", "some"),
        ] {
            assert!(text.contains(from), "{from}");
            let error = parse(&text.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(reason), "{to}: {error}");
        }
    }

    #[test]
    fn stories_without_a_meaning_are_refused() {
        for (from, to, reason) in [
            ("name = \"b\"", "name = \"b c\"", "names files"),
            ("kind = \"bus\"", "kind = \"ship\"", "'ship' is unknown"),
            ("speed_mps = -1.0", "speed_mps = nan", "a number of NaN"),
            ("size_m = [10.0", "size_m = [-1.0", "size_m"),
            ("of = [0, 1]", "of = [0, 2]", "no actor 2"),
            ("events = [0]", "events = [7]", "no event 7"),
            ("act = 0", "act = 4", "no act 4"),
            (
                "{ of = 1, action = { show",
                "{ of = 9, action = { show",
                "no actor 9",
            ),
            (
                "speeds_mps = [2.0]",
                "speeds_mps = []",
                "as many times as speeds",
            ),
            ("is_shown = false", "is_gone = false", "is_gone"),
            (
                "phases = [[\"go\", 10.0]",
                "phases = [[\"go\", 0.0]",
                "phases: 0 s",
            ),
            ("color = \"red\"", "color = \"blue\"", "blue"),
            (
                "every_s = 0.5",
                "every_s = 5.0",
                "every_s of 0.02 to ahead_s",
            ),
        ] {
            assert!(TEXT.contains(from), "{from}");
            let error = parse(&TEXT.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(reason), "{to}: {error}");
        }
    }
}
