//! Curved shapes of trajectories, as points: clothoids and NURBS.

use decouplegs_asset::DecodeError;
use glam::DVec2;

use super::Skipped;
use super::catalogs::Catalogs;
use super::parameters::Node;
use super::positions::{self, Position};
use super::routes::TimedPoints;

/// Distance between points of a clothoid, meters, and most points of one curve.
const STEP_M: f64 = 0.5;
const POINTS_MAX: usize = 2000;
/// Steps of the integration between two points.
const PARTS: usize = 8;
/// Points between two knots of a NURBS, its control points and its degree at most.
const POINTS_OF_SPAN: usize = 16;
const CONTROLS_MAX: usize = 200;
const ORDER_MAX: usize = 8;
/// Steps of the search for the value at which a control point counts most.
const PEAK_STEPS: usize = 60;

/// Points of a `<Clothoid>`, `<ClothoidSpline>` or `<Nurbs>` in a `<Shape>`; `None` if it has none
/// or they cannot be read.
pub(super) fn read(
    shape: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<TimedPoints>, DecodeError> {
    if let Some(clothoid) = shape.first("Clothoid") {
        let rates = ["curvaturePrime", "curvatureDot"];
        let mut rate = 0.0;
        for name in rates {
            rate = clothoid.number_or(name, rate)?;
        }
        let (from, length_m) = (clothoid.number("curvature")?, clothoid.number("length")?);
        let Some(start) = positions::read(clothoid.needed("Position")?, catalogs, skipped)? else {
            return Ok(None);
        };
        let mut curve = Curve::new(start);
        curve.append([from, from + rate * length_m], length_m);
        let times_s = match clothoid.attribute("stopTime")? {
            Some(_) => Some([
                clothoid.number_or("startTime", 0.0)?,
                clothoid.number("stopTime")?,
            ]),
            None => None,
        };
        return Ok(Some(curve.timed(times_s)));
    }
    if let Some(spline) = shape.first("ClothoidSpline") {
        return clothoids(spline, catalogs, skipped);
    }
    match shape.first("Nurbs") {
        Some(nurbs) => spline(nurbs, catalogs, skipped),
        None => Ok(None),
    }
}

fn clothoids(
    spline: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<TimedPoints>, DecodeError> {
    let mut curve: Option<Curve> = None;
    for segment in spline.all("ClothoidSplineSegment") {
        if let Some(place) = segment.first("PositionStart") {
            let Some(start) = positions::read(place, catalogs, skipped)? else {
                return Ok(None);
            };
            let next = Curve::new(start);
            curve = Some(match curve {
                Some(before) => before.before(next),
                None => next,
            });
        }
        // Without a start it begins where the entity is.
        let curve = curve.get_or_insert_with(|| Curve::new(Position::own()));
        curve.heading_rad += segment.number_or("hOffset", 0.0)?;
        let ends = [
            segment.number("curvatureStart")?,
            segment.number("curvatureEnd")?,
        ];
        curve.append(ends, segment.number("length")?);
    }
    Ok(curve.map(|curve| curve.timed(None)))
}

/// Curve as points that are seen from the place where it starts.
struct Curve {
    start: Position,
    at_m: DVec2,
    heading_rad: f64,
    length_m: f64,
    /// Points, and the length of the curve up to each.
    points: Vec<(Position, f64)>,
}

impl Curve {
    fn new(start: Position) -> Self {
        Self {
            points: vec![(start.clone(), 0.0)],
            start,
            at_m: DVec2::ZERO,
            heading_rad: 0.0,
            length_m: 0.0,
        }
    }

    /// The points of this one, then those of `next`.
    fn before(mut self, mut next: Self) -> Self {
        next.length_m = self.length_m;
        next.points[0].1 = self.length_m;
        self.points.append(&mut next.points);
        next.points = self.points;
        next
    }

    /// Appends a part whose curvature changes evenly.
    fn append(&mut self, [from, to]: [f64; 2], length_m: f64) {
        let length_m = length_m.clamp(0.0, 1e5);
        let count = ((length_m / STEP_M).ceil().max(1.0) as usize).min(POINTS_MAX);
        let step_m = length_m / (count * PARTS) as f64;
        let begin_rad = self.heading_rad;
        let heading_rad = |at_m: f64| {
            begin_rad + from * at_m + 0.5 * (to - from) * at_m * at_m / length_m.max(1e-9)
        };
        for point in 0..count {
            for part in 0..PARTS {
                let at_m = ((point * PARTS + part) as f64 + 0.5) * step_m;
                self.at_m += step_m * DVec2::from_angle(heading_rad(at_m));
            }
            self.length_m += step_m * PARTS as f64;
            let place = Position::Beside {
                of: Box::new(self.start.clone()),
                offset_m: self.at_m,
            };
            self.points.push((place, self.length_m));
        }
        self.heading_rad = heading_rad(length_m);
    }

    /// Points of the curve, with times between two of them.
    fn timed(self, times_s: Option<[f64; 2]>) -> TimedPoints {
        let whole_m = self.length_m.max(1e-9);
        let time_s = |way_m: f64| times_s.map(|[from, to]| from + (to - from) * way_m / whole_m);
        let points = self.points.into_iter();
        points
            .map(|(place, way_m)| (place, time_s(way_m)))
            .collect()
    }
}

fn spline(
    nurbs: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<TimedPoints>, DecodeError> {
    let order = nurbs.number("order")?.clamp(0.0, 100.0) as usize;
    let (mut controls, mut weights, mut times_s, mut knots) = (vec![], vec![], vec![], vec![]);
    for control in nurbs.all("ControlPoint") {
        let Some(place) = positions::read(control.needed("Position")?, catalogs, skipped)? else {
            return Ok(None);
        };
        controls.push(place);
        weights.push(control.number_or("weight", 1.0)?);
        times_s.push(match control.attribute("time")? {
            Some(_) => Some(control.number("time")?),
            None => None,
        });
        if controls.len() > CONTROLS_MAX {
            break;
        }
    }
    for knot in nurbs.all("Knot").take(CONTROLS_MAX + ORDER_MAX + 1) {
        knots.push(knot.number("value")?);
    }
    let fits = (2..=ORDER_MAX).contains(&order)
        && (order..=CONTROLS_MAX).contains(&controls.len())
        && knots.len() == controls.len() + order
        && knots.is_sorted();
    if !fits {
        skipped.add(
            nurbs,
            "expected an order of 2 to 8, at most 200 control points, and as many rising knots as both together",
        );
        return Ok(None);
    }
    let mut points = Vec::new();
    let inner = order - 1..controls.len();
    // The time of a control point is that of the place where it counts most.
    let times_s: Option<Vec<f64>> = times_s.into_iter().collect();
    let reached = times_s.map(|times_s| {
        let peaks = (0..controls.len()).map(|control| peak(&knots, order, control));
        peaks.zip(times_s).collect::<Vec<(f64, f64)>>()
    });
    for span in inner.clone().filter(|&span| knots[span + 1] > knots[span]) {
        let is_last = span + 1 == inner.end;
        for part in 0..POINTS_OF_SPAN + usize::from(is_last) {
            let share = part as f64 / POINTS_OF_SPAN as f64;
            let at = knots[span] + share * (knots[span + 1] - knots[span]);
            let basis = basis(&knots, order, span, at);
            let first = span + 1 - order;
            let weighted: Vec<f64> = (0..order).map(|i| basis[i] * weights[first + i]).collect();
            let sum: f64 = weighted.iter().sum();
            if sum <= 0.0 {
                skipped.add(nurbs, "its weights leave a point without a place");
                return Ok(None);
            }
            let shares: Vec<f64> = weighted.iter().map(|weight| weight / sum).collect();
            let of = controls[first..=span].to_vec();
            let time_s = reached.as_ref().map(|reached| time_at(reached, at));
            points.push((Position::Between { of, shares }, time_s));
        }
    }
    if !skipped.counts_points(points.len() * order, super::routes::POINTS_MAX) {
        return Err(nurbs.fault("routes and trajectories have too many points together"));
    }
    Ok(Some(points))
}

/// Value at which a control point counts most.
fn peak(knots: &[f64], order: usize, control: usize) -> f64 {
    let count = knots.len() - order;
    let weight = |at: f64| {
        // The last span that is not empty holds the end.
        let span = knots[..count].partition_point(|&knot| knot <= at);
        let span = span.saturating_sub(1).max(order - 1);
        let first = span + 1 - order;
        let basis = basis(knots, order, span, at);
        control
            .checked_sub(first)
            .and_then(|at| basis.get(at).copied())
            .unwrap_or(0.0)
    };
    let within = |at: f64| at.clamp(knots[order - 1], knots[count]);
    let (mut low, mut high) = (within(knots[control]), within(knots[control + order]));
    // It rises and falls once.
    for _ in 0..PEAK_STEPS {
        let (left, right) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if weight(left) < weight(right) {
            low = left;
        } else {
            high = right;
        }
    }
    0.5 * (low + high)
}

/// Time at a value, between those that are reached at others, seconds.
fn time_at(reached: &[(f64, f64)], at: f64) -> f64 {
    let next = reached.partition_point(|(value, _)| *value <= at);
    let next = next.clamp(1, reached.len() - 1);
    let ((from, from_s), (to, to_s)) = (reached[next - 1], reached[next]);
    let share = if to > from {
        (at - from) / (to - from)
    } else {
        0.0
    };
    from_s + share.clamp(0.0, 1.0) * (to_s - from_s)
}

/// Values of the basis functions of an order that are not 0 between a knot and the next one
/// (Cox and de Boor).
fn basis(knots: &[f64], order: usize, span: usize, at: f64) -> Vec<f64> {
    let mut values = vec![1.0];
    for degree in 1..order {
        let mut next = vec![0.0; degree + 1];
        for (index, value) in values.iter().enumerate() {
            let left = span + 1 + index - degree;
            let (low, high) = (knots[left], knots[left + degree]);
            let share = if high > low {
                (at - low) / (high - low)
            } else {
                0.0
            };
            next[index] += value * (1.0 - share);
            next[index + 1] += value * share;
        }
        values = next;
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world() -> Position {
        Position::World {
            at_m: DVec2::new(3.0, 4.0),
            heading_rad: 0.0,
        }
    }

    #[test]
    fn an_arc_ends_where_a_circle_does() {
        let mut curve = Curve::new(world());
        curve.append([0.1, 0.1], 5.0 * std::f64::consts::PI);
        // A quarter of a circle of 10 m.
        assert!(
            curve.at_m.distance(DVec2::new(10.0, 10.0)) < 1e-3,
            "{}",
            curve.at_m
        );
        assert!((curve.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let points = curve.timed(Some([1.0, 3.0]));
        assert_eq!(points.first().unwrap().1, Some(1.0));
        assert_eq!(points.last().unwrap().1, Some(3.0));
        assert_eq!(points[16].1, Some(2.0));
    }

    #[test]
    fn control_points_are_reached_where_they_count_most() {
        // Quadratic, clamped: the middle one of three peaks in the middle.
        let knots = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
        for (control, expected) in [(0, 0.0), (1, 0.5), (2, 1.0)] {
            assert!((peak(&knots, 3, control) - expected).abs() < 1e-6);
        }
        // Of order 2 each is reached at its knot, whatever the spaces between them.
        let knots = [0.0, 0.0, 0.2, 0.7, 1.0, 1.0];
        for (control, expected) in [0.0, 0.2, 0.7, 1.0].into_iter().enumerate() {
            assert!((peak(&knots, 2, control) - expected).abs() < 1e-6);
        }
        let reached = [(0.0, 1.0), (0.5, 2.0), (1.0, 4.0)];
        let times_s = [-1.0, 0.0, 0.25, 0.5, 0.75, 1.0, 2.0].map(|at| time_at(&reached, at));
        assert_eq!(times_s, [1.0, 1.0, 1.5, 2.0, 3.0, 4.0, 4.0]);
    }

    #[test]
    fn basis_functions_are_those_of_bernstein_between_full_knots() {
        let knots = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
        let found = basis(&knots, 4, 3, 0.25);
        let expected = [0.421875, 0.421875, 0.140625, 0.015625];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
    }
}
