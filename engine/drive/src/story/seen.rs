//! Road users of a story as others see them, and distances between them.

use decouplegs_scene::story::{Direction, End, Place, Spot, Who};
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use super::roads::{OnLane, Roads};
use crate::oriented_box::OrientedBox;

/// Road user at a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub state: VehicleState,
    pub size: VehicleSize,
    /// Way from its reference point to the middle of its box, meters.
    pub center_m: f64,
    /// Speed, below zero backwards.
    pub speed_mps: f64,
    /// Place of its reference point; `None` off the lanes.
    pub place: Option<OnLane>,
}

impl Seen {
    pub(super) fn point_m(&self) -> DVec2 {
        self.state.position_m - self.center_m * self.state.ahead()
    }

    pub(super) fn outline(&self) -> OrientedBox {
        OrientedBox::for_vehicle(&self.state, &self.size)
    }

    fn velocity_mps(&self) -> DVec2 {
        self.speed_mps * self.state.ahead()
    }
}

/// All road users of a story at a time: the ego, then the actors. Hidden ones are seen too.
pub(super) struct Scene<'a> {
    pub roads: &'a Roads,
    pub all: &'a [Option<Seen>],
}

/// Distance from a road user to another end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gap {
    /// Signed distance in its direction: below zero behind or to the right, meters; without sign if
    /// it is straight.
    pub signed_m: f64,
    /// Length that both boxes take off it, meters.
    boxes_m: f64,
    /// Speed at which it shrinks, m/s.
    closing_mps: f64,
}

impl Gap {
    /// Distance, never below zero.
    pub(super) fn distance_m(&self) -> f64 {
        (self.signed_m.abs() - self.boxes_m).max(0.0)
    }

    /// Time until it is closed, seconds; `None` while it grows.
    pub(super) fn closes_s(&self) -> Option<f64> {
        let distance_m = self.distance_m();
        if distance_m == 0.0 {
            return Some(0.0);
        }
        (self.closing_mps > 1e-9).then(|| distance_m / self.closing_mps)
    }
}

impl Scene<'_> {
    pub(super) fn get(&self, who: Who) -> Option<&Seen> {
        self.all.get(who.0)?.as_ref()
    }

    /// Point and heading of a place; `None` where it is on no lane.
    pub(super) fn spot(&self, spot: &Spot) -> Option<(DVec2, f64)> {
        match *spot {
            Spot::Point { at_m, heading_rad } => {
                let at_m = DVec2::from_array(at_m);
                let heading_rad = heading_rad
                    .or_else(|| {
                        let place = self.roads.at(at_m, 0.0)?;
                        let along = OnLane {
                            is_against: false,
                            ..place
                        };
                        Some(self.roads.pose(&along).1)
                    })
                    .unwrap_or(0.0);
                Some((at_m, heading_rad))
            }
            Spot::From {
                who,
                offset_m,
                turns,
            } => {
                let seen = self.get(who)?;
                let offset_m = DVec2::from_array(offset_m);
                let offset_m = match turns {
                    true => seen.state.ahead().rotate(offset_m),
                    false => offset_m,
                };
                Some((seen.point_m() + offset_m, seen.state.yaw_rad))
            }
            Spot::Lane {
                who,
                lanes,
                ahead_m,
                on_road,
                left_m,
            } => {
                let own = self.get(who)?.place?;
                let (point_m, heading_rad) = self.roads.pose(&own);
                let sign = if on_road {
                    self.roads.road_sign(&own)
                } else {
                    1.0
                };
                let lane = self.roads.beside(&own, sign as i64 * lanes)?;
                // Left and ahead are those of the road user, also on a lane that runs against it.
                let mut place = self.roads.on(lane, point_m, heading_rad)?;
                let left_m = left_m.map_or(own.sign() * own.left_m, |left_m| sign * left_m);
                place.left_m = place.sign() * left_m;
                if on_road {
                    self.roads.advance_on_road(&mut place, sign * ahead_m);
                } else {
                    self.roads.advance(&mut place, ahead_m, &[]);
                }
                Some(self.roads.pose(&place))
            }
            Spot::Road {
                who,
                along_m,
                left_m,
            } => {
                let mut place = self.get(who)?.place?;
                let sign = self.roads.road_sign(&place);
                place.left_m += place.sign() * sign * left_m;
                self.roads.advance_on_road(&mut place, sign * along_m);
                Some(self.roads.pose(&place))
            }
        }
    }

    /// Point of a line; `None` where it counts from what is on no lane.
    pub(super) fn place(&self, place: &Place) -> Option<DVec2> {
        match place {
            Place::At(spot) => Some(self.spot(spot)?.0),
            Place::Beside {
                of,
                turn_rad,
                offset_m,
            } => {
                let (point_m, heading_rad) = self.spot(of)?;
                let ahead = DVec2::from_angle(heading_rad + turn_rad);
                Some(point_m + ahead.rotate(DVec2::from_array(*offset_m)))
            }
            Place::Between { of, shares } => {
                let weighted = of.iter().zip(shares);
                weighted
                    .map(|(spot, share)| Some(*share * self.spot(spot)?.0))
                    .sum()
            }
        }
    }

    /// Distance from `of` to an end; `None` where it has none.
    pub(super) fn gap(
        &self,
        of: &Seen,
        to: &End,
        direction: Direction,
        between_boxes: bool,
    ) -> Option<Gap> {
        let other = match to {
            End::Who(who) => Some(self.get(*who)?),
            End::At(_) => None,
        };
        let point_m = match to {
            End::Who(_) => other?.point_m(),
            End::At(spot) => self.spot(spot)?.0,
        };
        let ahead = of.state.ahead();
        let velocity_mps = of.velocity_mps() - other.map_or(DVec2::ZERO, Seen::velocity_mps);
        // Between boxes their middles count, and what each reaches along the axis.
        let middle = |seen: &Seen| seen.state.position_m;
        let (from_m, to_m) = match between_boxes {
            true => (middle(of), other.map_or(point_m, middle)),
            false => (of.point_m(), point_m),
        };
        let apart_m = to_m - from_m;
        let half_m = |axis: DVec2| {
            let of_box = |seen: &Seen| {
                let own = seen.state.ahead();
                0.5 * (seen.size.length_m * own.dot(axis).abs()
                    + seen.size.width_m * own.perp_dot(axis).abs())
            };
            if between_boxes {
                of_box(of) + other.map_or(0.0, of_box)
            } else {
                0.0
            }
        };
        let along = |axis: DVec2| {
            let signed_m = apart_m.dot(axis);
            Gap {
                signed_m,
                boxes_m: half_m(axis),
                closing_mps: velocity_mps.dot(axis) * signed_m.signum(),
            }
        };
        Some(match direction {
            Direction::Ahead => along(ahead),
            Direction::Beside => along(ahead.perp()),
            Direction::Straight => {
                let distance_m = match other {
                    Some(other) if between_boxes => of.outline().distance_m(&other.outline()),
                    _ => apart_m.length(),
                };
                let towards = apart_m.normalize_or_zero();
                Gap {
                    signed_m: distance_m,
                    boxes_m: 0.0,
                    closing_mps: velocity_mps.dot(towards),
                }
            }
            Direction::AlongLanes | Direction::AcrossLanes => {
                let place = of.place?;
                let found = self.roads.along(&place, to_m, &[])?;
                if direction == Direction::AcrossLanes {
                    let signed_m = found.y - place.sign() * place.left_m;
                    return Some(Gap {
                        signed_m,
                        ..along(ahead.perp())
                    });
                }
                let behind_m = if between_boxes { of.center_m } else { 0.0 };
                let signed_m = found.x - behind_m;
                let other_mps = other.map_or(0.0, |other| {
                    other.speed_mps * other.state.ahead().dot(ahead).signum()
                });
                Gap {
                    signed_m,
                    boxes_m: half_m(ahead),
                    closing_mps: (of.speed_mps - other_mps) * signed_m.signum(),
                }
            }
        })
    }
}
