//! Actions of entities, and global ones that concern them.

use decouplegs_asset::DecodeError;
use decouplegs_scene::LightColor;
use decouplegs_scene::story::{Change, Dynamics, Extent, Limits, Shape, Side};

use super::catalogs::Catalogs;
use super::parameters::Node;
use super::positions::{self, Position};
use super::{Skipped, global_actions, profiles, routes};

/// Acceleration and deceleration without a limit in the file, m/s^2.
pub(super) const USUAL_MPS2: f64 = 5.0;
/// Lateral acceleration of a change of offset without one, m/s^2.
const LATERAL_MPS2: f64 = 0.5;

/// A speed.
#[derive(Clone, Debug, PartialEq)]
pub enum TargetSpeed {
    /// Speed, m/s.
    Absolute(f64),
    /// The speed of another entity, times a factor, plus a difference.
    Relative {
        /// Name of the other entity.
        entity: String,
        /// Factor of that speed.
        factor: f64,
        /// Difference, m/s.
        plus_mps: f64,
        /// True if it follows that speed without end.
        continuous: bool,
    },
}

/// Lane that a vehicle changes to.
#[derive(Clone, Debug, PartialEq)]
pub enum TargetLane {
    /// Id of the OpenDRIVE lane.
    Absolute(i64),
    /// Lanes to the left of an entity, negative to the right.
    Relative {
        /// Name of the entity.
        entity: String,
        /// Lanes to its left.
        lanes: i64,
    },
}

/// Action of an entity.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Has another speed from then on.
    Speed {
        /// The new speed.
        target: TargetSpeed,
        /// Transition to it.
        dynamics: Dynamics,
    },
    /// Has one speed after the other.
    Profile {
        /// Durations of the parts, seconds; 0 for a first part that lasts as long as `limits` need.
        times_s: Vec<f64>,
        /// Speeds at their ends, m/s.
        speeds_mps: Vec<f64>,
        /// Limits of parts without a time.
        limits: Limits,
    },
    /// Changes lanes.
    ChangeLane {
        /// The new lane.
        target: TargetLane,
        /// Offset from its middle, meters, to the left of the reference line.
        offset_m: f64,
        /// Transition to it.
        dynamics: Dynamics,
    },
    /// Moves aside on its lane.
    Offset {
        /// Offset, meters: from the lane's middle to the left of the reference line, or from
        /// another entity to its left.
        offset_m: f64,
        /// Name of the other entity.
        from: Option<String>,
        /// Transition to it.
        dynamics: Dynamics,
        /// True if it holds without end.
        continuous: bool,
    },
    /// Keeps a distance along the road.
    KeepGap {
        /// Name of the other entity.
        to: String,
        /// Distance, meters, or time, seconds.
        gap: f64,
        /// True if it is a time.
        is_time: bool,
        /// True if it is between boxes.
        between_boxes: bool,
        /// Side of the other.
        side: Side,
        /// True if it holds without end.
        continuous: bool,
        /// Limits of the changes of speed.
        limits: Limits,
    },
    /// Keeps a distance across the road.
    KeepBeside {
        /// Name of the other entity.
        to: String,
        /// Distance, meters.
        distance_m: f64,
        /// True if it is between boxes.
        between_boxes: bool,
        /// Side of the other.
        side: Side,
        /// True if it holds without end.
        continuous: bool,
        /// Limits of the motion aside.
        limits: Limits,
    },
    /// Arrives when another does.
    Arrive {
        /// Name of the other entity.
        with: String,
        /// Place of the entity.
        at: Position,
        /// Place of the other.
        other_at: Position,
        /// Distances within which the entity and the other have arrived, meters.
        tolerances_m: [f64; 2],
        /// Speed at the arrival.
        speed: Option<TargetSpeed>,
        /// Way at the end that is driven at that speed, meters.
        steady_m: f64,
    },
    /// Follows a trajectory.
    Follow {
        /// Points of its line.
        points: Vec<Position>,
        /// Times at them, seconds; `None`: at its own speed.
        times_s: Option<Vec<f64>>,
        /// True if times count from the start of the episode.
        is_absolute: bool,
    },
    /// Goes along a route.
    Route(Vec<Position>),
    /// Is put to a position.
    Teleport(Position),
    /// Is shown, or hidden if false.
    Show(bool),
    /// Gives a variable or parameter a value.
    Set {
        /// Name in the file.
        variable: String,
        /// The value.
        value: String,
        /// Arithmetic with the old value.
        by: Change,
    },
    /// Gives a traffic signal a color.
    Signal {
        /// Id of the signal in the map.
        signal: String,
        /// The color.
        color: LightColor,
    },
    /// Begins a phase of a controller of traffic signals.
    Phase {
        /// Name of the controller.
        controller: String,
        /// Name of the phase.
        phase: String,
    },
    /// Does what nothing here shows.
    Unseen,
}

/// Actions that were read, each with the entity that it names itself; `None` if they are of a kind
/// that is not read.
pub(super) type Read = Option<Vec<(Option<String>, Action)>>;

impl Action {
    /// Names the entity that the action is about where its places count from it.
    pub(super) fn name_own(&mut self, name: &str) {
        if let Self::Follow { points, .. } = self {
            points.iter_mut().for_each(|point| point.name_own(name));
        }
    }
}

/// An action in a `<PrivateAction>`, `<GlobalAction>` or `<UserDefinedAction>`,; one that names
/// its entity itself may be two.
pub(super) fn read(
    holder: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Read, DecodeError> {
    let one = |action: Action| Ok(Some(vec![(None, action)]));
    if holder.name() == "UserDefinedAction" {
        return one(Action::Unseen);
    }
    let Some(kind) = holder.elements().next() else {
        return Err(holder.fault("it is empty; expected an action"));
    };
    let inner = kind.elements().next();
    let unknown = |skipped: &mut Skipped| {
        skipped.add(inner.unwrap_or(kind), "actions of this kind are not read");
        Ok(None)
    };
    if holder.name() == "GlobalAction" {
        return global_actions::read(kind, inner, catalogs, skipped);
    }
    let read = match (kind.name(), inner) {
        ("LongitudinalAction", Some(inner)) => longitudinal(inner, skipped)?,
        ("LateralAction", Some(inner)) => lateral(inner)?,
        ("TeleportAction", Some(place)) if place.name() == "Position" => {
            positions::read(place, catalogs, skipped)?.map(Action::Teleport)
        }
        ("RoutingAction", Some(routing)) => path(routing, catalogs, skipped)?,
        ("SynchronizeAction", _) => arrive(kind, catalogs, skipped)?,
        ("VisibilityAction", _) => {
            let is_shown = match kind.attribute("graphics")? {
                Some(_) => kind.truth("graphics")?,
                None => true,
            };
            Some(Action::Show(is_shown))
        }
        // Lamps and limbs do not move here; controls are for controllers, which are not run.
        ("AppearanceAction", _) => Some(Action::Unseen),
        ("ControllerAction", Some(inner)) if inner.name() == "OverrideControllerValueAction" => {
            Some(Action::Unseen)
        }
        ("ControllerAction", _) | ("ActivateControllerAction", _) if hands_back(kind)? => {
            Some(Action::Unseen)
        }
        _ => return unknown(skipped),
    };
    match read {
        Some(action) => one(action),
        None => Ok(None),
    }
}

/// True for a `<ControllerAction>` that only deactivates controllers: none is active here.
fn hands_back(kind: Node) -> Result<bool, DecodeError> {
    let mut actions = match kind.name() {
        "ControllerAction" => kind.elements().collect(),
        _ => vec![kind],
    };
    actions.retain(|action| action.name() != "CatalogReference");
    let mut is_all = !actions.is_empty();
    for action in actions {
        is_all &= action.name() == "ActivateControllerAction"
            && !action.truth("longitudinal")?
            && !action.truth("lateral")?;
    }
    Ok(is_all)
}

fn longitudinal(action: Node, skipped: &mut Skipped) -> Result<Option<Action>, DecodeError> {
    match action.name() {
        "SpeedAction" => {
            let Some(target) = speed_of(action.needed("SpeedActionTarget")?)? else {
                skipped.add(action, "the target speed is of a kind that is not read");
                return Ok(None);
            };
            let dynamics = transition(action.first("SpeedActionDynamics"))?;
            Ok(Some(Action::Speed { target, dynamics }))
        }
        "SpeedProfileAction" => profiles::read(action, skipped),
        "LongitudinalDistanceAction" => {
            let is_time = action.attribute("timeGap")?.is_some();
            Ok(Some(Action::KeepGap {
                to: action.needed_attribute("entityRef")?.into_owned(),
                gap: action.number(if is_time { "timeGap" } else { "distance" })?,
                is_time,
                between_boxes: action.truth("freespace")?,
                side: match action.attribute("displacement")?.as_deref() {
                    Some("any") => Side::Any,
                    Some("leadingReferencedEntity") => Side::RightOrAhead,
                    _ => Side::LeftOrBehind,
                },
                continuous: action.truth("continuous")?,
                limits: limits(action.first("DynamicConstraints"), true)?,
            }))
        }
        _ => {
            skipped.add(action, "actions of this kind are not read");
            Ok(None)
        }
    }
}

fn lateral(action: Node) -> Result<Option<Action>, DecodeError> {
    match action.name() {
        "LaneChangeAction" => {
            let holder = action.needed("LaneChangeTarget")?;
            let target = if let Some(absolute) = holder.first("AbsoluteTargetLane") {
                TargetLane::Absolute(positions::lanes(absolute.number("value")?))
            } else {
                let relative = holder.needed("RelativeTargetLane")?;
                TargetLane::Relative {
                    entity: relative.needed_attribute("entityRef")?.into_owned(),
                    lanes: positions::lanes(relative.number("value")?),
                }
            };
            Ok(Some(Action::ChangeLane {
                target,
                offset_m: action.number_or("targetLaneOffset", 0.0)?,
                dynamics: transition(action.first("LaneChangeActionDynamics"))?,
            }))
        }
        "LaneOffsetAction" => {
            let holder = action.needed("LaneOffsetTarget")?;
            let (offset_m, from) = match holder.first("AbsoluteTargetLaneOffset") {
                Some(absolute) => (absolute.number("value")?, None),
                None => {
                    let relative = holder.needed("RelativeTargetLaneOffset")?;
                    let from = relative.needed_attribute("entityRef")?.into_owned();
                    (relative.number("value")?, Some(from))
                }
            };
            let dynamics = action.first("LaneOffsetActionDynamics");
            let most_mps2 = match dynamics {
                Some(dynamics) => dynamics.number_or("maxLateralAcc", LATERAL_MPS2)?,
                None => LATERAL_MPS2,
            };
            Ok(Some(Action::Offset {
                offset_m,
                from,
                dynamics: Dynamics {
                    shape: shape(dynamics)?,
                    extent: Extent::LateralMps2(most_mps2.max(1e-3)),
                },
                continuous: action.truth("continuous")?,
            }))
        }
        "LateralDistanceAction" => Ok(Some(Action::KeepBeside {
            to: action.needed_attribute("entityRef")?.into_owned(),
            distance_m: action.number_or("distance", 0.0)?,
            between_boxes: action.truth("freespace")?,
            side: match action.attribute("displacement")?.as_deref() {
                Some("leftToReferencedEntity") => Side::LeftOrBehind,
                Some("rightToReferencedEntity") => Side::RightOrAhead,
                _ => Side::Any,
            },
            continuous: action.truth("continuous")?,
            limits: limits(action.first("DynamicConstraints"), false)?,
        })),
        _ => Err(action.fault("an unknown action; expected one of lanes or offsets")),
    }
}

/// Limits in a `<DynamicConstraints>`; along the road, those that it does not give are usual ones.
pub(super) fn limits(constraints: Option<Node>, along: bool) -> Result<Limits, DecodeError> {
    let Some(node) = constraints else {
        return Ok(Limits::default());
    };
    let of = |name: &str| -> Result<Option<f64>, DecodeError> {
        match node.attribute(name)? {
            Some(_) => node.number(name).map(|value| Some(value.abs())),
            None => Ok(None),
        }
    };
    let usual = |found: Option<f64>| found.or(along.then_some(USUAL_MPS2));
    Ok(Limits {
        speed_mps: of("maxSpeed")?,
        acceleration_mps2: usual(of("maxAcceleration")?),
        deceleration_mps2: usual(of("maxDeceleration")?),
        acceleration_rate_mps3: of("maxAccelerationRate")?,
        deceleration_rate_mps3: of("maxDecelerationRate")?,
    })
}

/// Speed in a `<SpeedActionTarget>` or `<FinalSpeed>`.
pub(super) fn speed_of(target: Node) -> Result<Option<TargetSpeed>, DecodeError> {
    for name in ["AbsoluteTargetSpeed", "AbsoluteSpeed"] {
        if let Some(absolute) = target.first(name) {
            return Ok(Some(TargetSpeed::Absolute(absolute.number("value")?)));
        }
    }
    let relative = ["RelativeTargetSpeed", "RelativeSpeedToMaster"];
    let Some(relative) = relative.into_iter().find_map(|name| target.first(name)) else {
        return Ok(None);
    };
    let value = relative.number("value")?;
    let is_factor = relative.is("speedTargetValueType", "factor")?;
    let entity = relative.attribute("entityRef")?.unwrap_or_default();
    Ok(Some(TargetSpeed::Relative {
        entity: entity.into_owned(),
        factor: if is_factor { value } else { 1.0 },
        plus_mps: if is_factor { 0.0 } else { value },
        continuous: relative.truth("continuous")?,
    }))
}

fn shape(dynamics: Option<Node>) -> Result<Shape, DecodeError> {
    let shape = match dynamics {
        Some(dynamics) => dynamics.attribute("dynamicsShape")?,
        None => None,
    };
    Ok(match shape.as_deref() {
        Some("linear") => Shape::Linear,
        Some("cubic") => Shape::Cubic,
        Some("sinusoidal") => Shape::Sinusoidal,
        _ => Shape::Step,
    })
}

fn transition(dynamics: Option<Node>) -> Result<Dynamics, DecodeError> {
    let shape = shape(dynamics)?;
    let Some(dynamics) = dynamics.filter(|_| shape != Shape::Step) else {
        return Ok(Dynamics::STEP);
    };
    let value = dynamics.number_or("value", 0.0)?;
    let extent = match dynamics.attribute("dynamicsDimension")?.as_deref() {
        Some("rate") if value != 0.0 => Extent::RatePerS(value.abs()),
        _ if value <= 0.0 => return Ok(Dynamics::STEP),
        Some("distance") => Extent::DistanceM(value),
        _ => Extent::TimeS(value),
    };
    Ok(Dynamics { shape, extent })
}

fn arrive(
    kind: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Action>, DecodeError> {
    let with = kind.needed_attribute("masterEntityRef")?.into_owned();
    let other_at = positions::read(kind.needed("TargetPositionMaster")?, catalogs, skipped)?;
    let at = positions::read(kind.needed("TargetPosition")?, catalogs, skipped)?;
    let (Some(at), Some(other_at)) = (at, other_at) else {
        return Ok(None);
    };
    // The standard names no tolerance for files without one.
    let tolerance_m = |name: &str| kind.number_or(name, 0.0);
    let tolerances_m = [
        tolerance_m("targetTolerance")?,
        tolerance_m("targetToleranceMaster")?,
    ];
    let (mut speed, mut steady_m) = (None, 0.0);
    if let Some(holder) = kind.first("FinalSpeed") {
        speed = speed_of(holder)?;
        if let Some(TargetSpeed::Relative { entity, .. }) = &mut speed {
            entity.clone_from(&with);
        }
        let steady = holder
            .elements()
            .find_map(|target| target.elements().next());
        match steady.map(|steady| (steady.name(), steady)) {
            Some(("TargetDistanceSteadyState", steady)) => steady_m = steady.number("distance")?,
            Some(("TargetTimeSteadyState", steady)) => match &speed {
                Some(TargetSpeed::Absolute(mps)) => steady_m = mps * steady.number("time")?,
                _ => skipped.add(steady, "a steady time at a relative speed is not read"),
            },
            _ => {}
        }
    }
    Ok(Some(Action::Arrive {
        with,
        at,
        other_at,
        tolerances_m,
        speed,
        steady_m,
    }))
}

/// Positions of a routing action.
fn path(
    routing: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Action>, DecodeError> {
    let points = match routing.name() {
        "AcquirePositionAction" => {
            let mut points = Vec::new();
            for place in routing.all("Position") {
                match positions::read(place, catalogs, skipped)? {
                    Some(position) => points.push(position),
                    None => return Ok(None),
                }
            }
            Some(points)
        }
        "AssignRouteAction" => routes::route(routing, catalogs, skipped)?,
        "FollowTrajectoryAction" => {
            let holder = routing.first("TrajectoryRef").unwrap_or(routing);
            let Some(read) = routes::trajectory(holder, catalogs, skipped)? else {
                return Ok(None);
            };
            let timing = routing
                .first("TimeReference")
                .and_then(|reference| reference.first("Timing"));
            let mut times_s: Option<Vec<f64>> = None;
            let mut is_absolute = false;
            if let Some(timing) = timing {
                let scale = timing.number_or("scale", 1.0)?;
                let offset_s = timing.number_or("offset", 0.0)?;
                is_absolute = timing.is("domainAbsoluteRelative", "absolute")?;
                let scaled = |time_s: Option<f64>| Some(time_s? * scale + offset_s);
                times_s = read.iter().map(|(_, time_s)| scaled(*time_s)).collect();
            }
            let points = read.into_iter().map(|(position, _)| position).collect();
            return Ok(Some(Action::Follow {
                points,
                times_s,
                is_absolute,
            }));
        }
        _ => {
            skipped.add(routing, "actions of this kind are not read");
            None
        }
    };
    Ok(points
        .filter(|points| !points.is_empty())
        .map(Action::Route))
}
