//! Actions of a file as those of its story.

use decouplegs_logs::open_scenario::{
    self as file, Along, Entity, Position, StoryTask, TargetSpeed,
};
use decouplegs_scene::story::{Action, Dynamics, Extent, Place, Speed, TargetLane, Task, Who};
use glam::DVec2;

use super::cast::{Cast, Lost};

/// Usual width of a lane, meters.
const LANE_M: f64 = 3.5;

impl Cast<'_, '_> {
    fn speed(&self, speed: &TargetSpeed) -> Lost<Speed> {
        Ok(match speed {
            TargetSpeed::Absolute(mps) => Speed::Mps(*mps),
            TargetSpeed::Relative {
                entity,
                factor,
                plus_mps,
                continuous,
            } => Speed::Of {
                who: self.who(entity)?,
                factor: *factor,
                plus_mps: *plus_mps,
                continuous: *continuous,
            },
        })
    }

    /// The action of a task; of the ego, its duration alone. `None` if nothing is to be done.
    pub(super) fn task(&self, task: &StoryTask, ego_mps: &mut f64) -> Lost<Option<Task>> {
        if let file::Action::Set {
            variable,
            value,
            by,
        } = &task.action
        {
            let (variable, value, by) = (variable.clone(), value.clone(), *by);
            let action = Action::Set {
                variable,
                value,
                by,
            };
            return Ok(Some(Task {
                of: Who::EGO,
                action,
            }));
        }
        let about_lights = match &task.action {
            file::Action::Unseen => return Ok(None),
            file::Action::Signal { signal, color } => Some(Action::Light {
                light: signal.clone(),
                color: *color,
            }),
            file::Action::Phase { controller, phase } => {
                self.check_phase(controller, phase)?;
                Some(Action::Phase {
                    controller: controller.clone(),
                    phase: phase.clone(),
                })
            }
            _ => None,
        };
        if let Some(action) = about_lights {
            let of = Who::EGO;
            return Ok(Some(Task { of, action }));
        }
        let index = self.index(&task.actor)?;
        if index == self.import.ego {
            let duration_s = self.duration_s(&task.action, ego_mps);
            let action = Action::Wait { duration_s };
            return Ok(Some(Task {
                of: Who::EGO,
                action,
            }));
        }
        let of = self.who(&task.actor)?;
        let action = self.action(&task.action, &self.import.file.entities[index])?;
        Ok(Some(Task { of, action }))
    }

    fn action(&self, action: &file::Action, entity: &Entity) -> Lost<Action> {
        let sign = self.sign(&entity.name);
        Ok(match action {
            file::Action::Speed { target, dynamics } => Action::Speed {
                target: self.speed(target)?,
                dynamics: *dynamics,
            },
            file::Action::Profile {
                times_s,
                speeds_mps,
                limits,
            } => Action::Profile {
                times_s: times_s.clone(),
                speeds_mps: speeds_mps.clone(),
                limits: *limits,
            },
            file::Action::ChangeLane {
                target,
                offset_m,
                dynamics,
            } => Action::ChangeLane {
                target: match target {
                    file::TargetLane::Absolute(id) => TargetLane::Id(*id),
                    file::TargetLane::Relative { entity, lanes } => TargetLane::Beside {
                        who: self.who(entity)?,
                        lanes: *lanes,
                    },
                },
                offset_m: sign * offset_m,
                dynamics: *dynamics,
            },
            file::Action::Offset {
                offset_m,
                from,
                dynamics,
                continuous,
            } => Action::Offset {
                offset_m: if from.is_some() {
                    *offset_m
                } else {
                    sign * offset_m
                },
                from: from.as_ref().map(|name| self.who(name)).transpose()?,
                dynamics: *dynamics,
                continuous: *continuous,
            },
            file::Action::KeepGap { .. }
            | file::Action::KeepBeside { .. }
            | file::Action::Arrive { .. } => self.beside_another(action)?,
            file::Action::Follow {
                points,
                times_s,
                is_absolute,
            } => {
                let line = self.line(points)?;
                Action::Follow {
                    points_m: line.points_m,
                    seen_from: line.seen_from,
                    on_lanes: line.on_lanes,
                    places: line.places,
                    times_s: times_s.clone().unwrap_or_default(),
                    is_absolute: *is_absolute,
                }
            }
            file::Action::Route(points) => Action::Route {
                points_m: self.points_m(points)?,
            },
            file::Action::Teleport(place) => Action::Teleport {
                to: self.spot(place)?,
            },
            file::Action::Show(is_shown) => Action::Show {
                is_shown: *is_shown,
            },
            file::Action::Set { .. }
            | file::Action::Signal { .. }
            | file::Action::Phase { .. }
            | file::Action::Unseen => {
                return Err("the action is about no entity".into());
            }
        })
    }

    /// An action whose motion depends on that of another.
    fn beside_another(&self, action: &file::Action) -> Lost<Action> {
        Ok(match action {
            file::Action::KeepGap {
                to,
                gap,
                is_time,
                between_boxes,
                side,
                continuous,
                limits,
            } => Action::KeepGap {
                to: self.who(to)?,
                gap: *gap,
                is_time: *is_time,
                between_boxes: *between_boxes,
                side: *side,
                continuous: *continuous,
                limits: *limits,
            },
            file::Action::KeepBeside {
                to,
                distance_m,
                between_boxes,
                side,
                continuous,
                limits,
            } => Action::KeepBeside {
                to: self.who(to)?,
                distance_m: *distance_m,
                between_boxes: *between_boxes,
                side: *side,
                continuous: *continuous,
                limits: *limits,
            },
            file::Action::Arrive {
                with,
                at,
                other_at,
                tolerances_m,
                speed,
                steady_m,
            } => Action::Arrive {
                with: self.who(with)?,
                at: self.spot(at)?,
                other_at: self.spot(other_at)?,
                tolerance_m: tolerances_m[0],
                other_tolerance_m: tolerances_m[1],
                speed: speed.as_ref().map(|speed| self.speed(speed)).transpose()?,
                steady_m: *steady_m,
            },
            _ => return Err("the action counts from no entity".into()),
        })
    }

    /// Points of a line.
    fn line(&self, points: &[Position]) -> Lost<Line> {
        let ahead =
            |place: &Position| seen_from(place).map(|(name, at_m, _)| (name.to_owned(), at_m));
        if let Some((who, points_m)) = self.all_from(points, ahead)? {
            return Ok(Line {
                seen_from: Some(who),
                points_m,
                ..Line::default()
            });
        }
        if let Some((who, points_m)) = self.all_from(points, |place| self.along_lanes(place))? {
            return Ok(Line {
                seen_from: Some(who),
                on_lanes: true,
                points_m,
                ..Line::default()
            });
        }
        if points.iter().any(|place| self.moves(place)) {
            let places = points.iter().map(|point| self.place(point));
            return Ok(Line {
                places: places.collect::<Lost<_>>()?,
                ..Line::default()
            });
        }
        Ok(Line {
            points_m: self.points_m(points)?,
            ..Line::default()
        })
    }

    /// A point that counts from entities.
    fn place(&self, position: &Position) -> Lost<Place> {
        Ok(match position {
            Position::Beside { of, offset_m } => Place::Beside {
                of: self.spot(of)?,
                turn_rad: turn_rad(of)?,
                offset_m: offset_m.to_array(),
            },
            Position::Between { of, shares } => Place::Between {
                of: of
                    .iter()
                    .map(|place| self.spot(place))
                    .collect::<Lost<_>>()?,
                shares: shares.clone(),
            },
            place => Place::At(self.spot(place)?),
        })
    }

    /// The entity that all points are seen from, as `place_of` finds it, and where they are.
    fn all_from(
        &self,
        points: &[Position],
        place_of: impl Fn(&Position) -> Option<(String, DVec2)>,
    ) -> Lost<Option<(Who, Vec<[f64; 2]>)>> {
        let (mut from, mut points_m) = (None, Vec::with_capacity(points.len()));
        for point in points {
            let Some((name, at_m)) = place_of(point) else {
                return Ok(None);
            };
            if *from.get_or_insert_with(|| name.clone()) != name {
                return Ok(None);
            }
            points_m.push(at_m.to_array());
        }
        let who = from.map(|name| self.who(&name)).transpose()?;
        Ok(who.map(|who| (who, points_m)))
    }

    /// The entity on whose lane a place is, the way along it and the offset to its left, meters.
    fn along_lanes(&self, place: &Position) -> Option<(String, DVec2)> {
        match place {
            Position::RelativeLane {
                entity,
                lanes: 0,
                along: Along::Lane(ds_m),
                offset_m,
                ..
            } => Some((entity.clone(), DVec2::new(*ds_m, *offset_m))),
            Position::Between { of, shares } => {
                let (mut name, mut mean_m) = (None, DVec2::ZERO);
                for (place, share) in of.iter().zip(shares) {
                    let (entity, at_m) = self.along_lanes(place)?;
                    if *name.get_or_insert_with(|| entity.clone()) != entity {
                        return None;
                    }
                    mean_m += *share * at_m;
                }
                Some((name?, mean_m))
            }
            _ => None,
        }
    }

    /// True for a place that counts from an entity that moves.
    fn moves(&self, place: &Position) -> bool {
        match place {
            Position::Beside { of, .. } => self.moves(of),
            Position::Between { of, .. } => of.iter().any(|place| self.moves(place)),
            place => place.other().is_some_and(|name| self.who(name).is_ok()),
        }
    }

    fn points_m(&self, points: &[Position]) -> Lost<Vec<[f64; 2]>> {
        let import = self.import;
        let located = points
            .iter()
            .map(|point| import.locator.locate(point, &import.located));
        located.map(|place| Ok(place?.point_m.to_array())).collect()
    }

    /// Duration of an action of the ego, which drives otherwise; it is that which the file gives.
    fn duration_s(&self, action: &file::Action, ego_mps: &mut f64) -> f64 {
        let of = |dynamics: &Dynamics, change: f64, speed_mps: f64| match dynamics.extent {
            _ if *dynamics == Dynamics::STEP => 0.0,
            Extent::TimeS(time_s) => time_s,
            Extent::RatePerS(rate) => change.abs() / rate,
            Extent::DistanceM(way_m) => way_m / speed_mps,
            Extent::LateralMps2(most) => (6.0 * change.abs() / most).sqrt(),
        };
        let duration_s = match action {
            file::Action::Speed { target, dynamics } => {
                let to_mps = self.import.speed_of(Some(target));
                let from_mps = std::mem::replace(ego_mps, to_mps);
                of(dynamics, to_mps - from_mps, 0.5 * (from_mps + to_mps))
            }
            file::Action::Profile {
                times_s,
                speeds_mps,
                limits,
            } => {
                let last_mps = speeds_mps.last().copied().unwrap_or(*ego_mps);
                let from_mps = std::mem::replace(ego_mps, last_mps);
                let first_mps = speeds_mps.first().copied().unwrap_or(from_mps);
                limits.least_s(from_mps, first_mps) + times_s.iter().sum::<f64>()
            }
            file::Action::ChangeLane { dynamics, .. } => of(dynamics, LANE_M, *ego_mps),
            file::Action::Offset {
                dynamics, offset_m, ..
            } => of(dynamics, *offset_m, *ego_mps),
            file::Action::Follow {
                times_s: Some(times_s),
                ..
            } => times_s.last().copied().unwrap_or(0.0),
            _ => 0.0,
        };
        if duration_s.is_finite() {
            duration_s.max(0.0)
        } else {
            0.0
        }
    }
}

/// Points of a line, meters: in world coordinates, or as an entity sees them, along its lanes or
/// not, or else one by one.
#[derive(Default)]
struct Line {
    points_m: Vec<[f64; 2]>,
    seen_from: Option<Who>,
    on_lanes: bool,
    places: Vec<Place>,
}

/// Turn of a place from the heading that an entity gives it, radians.
fn turn_rad(place: &Position) -> Lost<f64> {
    let heading = match place {
        Position::RelativeEntity { heading, .. }
        | Position::RelativeLane { heading, .. }
        | Position::RelativeRoad { heading, .. } => *heading,
        _ => None,
    };
    match heading {
        Some(heading) if !heading.is_relative => {
            Err("a curve that starts at an entity with a heading of the world is not read".into())
        }
        heading => Ok(heading.map_or(0.0, |heading| heading.rad)),
    }
}

/// The entity that a place is seen from, the offset ahead and to its left, meters, and the turn of
/// the place, radians; `None` if it is seen from none.
fn seen_from(place: &Position) -> Option<(&str, DVec2, f64)> {
    match place {
        Position::RelativeEntity {
            entity,
            offset_m,
            is_in_its_frame: true,
            heading,
        } => match heading {
            Some(heading) if !heading.is_relative => None,
            heading => Some((
                entity,
                *offset_m,
                heading.map_or(0.0, |heading| heading.rad),
            )),
        },
        Position::Beside { of, offset_m } => {
            let (entity, at_m, turn_rad) = seen_from(of)?;
            let offset_m = DVec2::from_angle(turn_rad).rotate(*offset_m);
            Some((entity, at_m + offset_m, turn_rad))
        }
        _ => None,
    }
}
