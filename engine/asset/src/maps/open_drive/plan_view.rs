//! The reference line of a road, seen from above: lines, arcs, spirals and cubic curves.

use glam::DVec2;

use super::cubic::{slope, value};
use crate::DecodeError;
use crate::xml::Element;

/// A road of more is no road, meters.
const LENGTH_MAX_M: f64 = 1e6;
/// A curve that turns by more winds up, radians; it would also cost as much to follow.
const TURN_MAX_RAD: f64 = 30.0;
/// A longer spiral or cubic is no road's; the positions on them are integrals, which would cost as
/// much as they are long, meters.
const INTEGRATED_MAX_M: f64 = 1e4;

/// A piece of a reference line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Geometry {
    /// Start along the road, meters.
    pub(super) start_m: f64,
    /// Length, meters.
    pub(super) length_m: f64,
    origin: DVec2,
    heading_rad: f64,
    shape: Shape,
}

/// Curve of a piece, in the frame of its start: u forward, v to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shape {
    Line,
    /// Curvature in 1/m.
    Arc(f64),
    /// Curvature at the start and at the end, linear in between.
    Spiral(f64, f64),
    /// v as a cubic of u.
    Poly3([f64; 4]),
    /// u and v as cubics of a parameter, which runs so far over the whole length.
    ParamPoly3([f64; 4], [f64; 4], f64),
}

/// A position on a reference line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OnLine {
    /// Position on the plane, meters.
    pub(super) position: DVec2,
    /// Direction of travel along the line.
    pub(super) heading_rad: f64,
}

/// The pieces of a road's reference line, in order.
pub(super) fn read(road: Element) -> Result<Vec<Geometry>, DecodeError> {
    let plan_view = road.needed("planView")?;
    let mut pieces = plan_view
        .all("geometry")
        .map(read_geometry)
        .collect::<Result<Vec<_>, _>>()?;
    pieces.sort_by(|a, b| a.start_m.total_cmp(&b.start_m));
    match pieces.last() {
        None => Err(plan_view.fault("it has no <geometry>")),
        Some(last) if pieces[0].start_m < 0.0 || last.start_m + last.length_m > LENGTH_MAX_M => {
            Err(plan_view.fault(format!(
                "a reference line must run from 0 to at most {LENGTH_MAX_M} m"
            )))
        }
        _ => Ok(pieces),
    }
}

fn read_geometry(element: Element) -> Result<Geometry, DecodeError> {
    let length_m = element.number("length")?;
    if !(0.0..=LENGTH_MAX_M).contains(&length_m) {
        return Err(element.fault(format!(
            "a length of {length_m} m; expected 0 to {LENGTH_MAX_M}"
        )));
    }
    let shape = element
        .elements()
        .find_map(|shape| read_shape(shape, length_m).transpose());
    let shape = shape
        .ok_or_else(|| element.fault("it has no line, arc, spiral, poly3 or paramPoly3"))??;
    Ok(Geometry {
        start_m: element.number("s")?,
        length_m,
        origin: DVec2::new(element.number("x")?, element.number("y")?),
        heading_rad: element.number("hdg")?,
        shape,
    })
}

/// The shape that `element` is, if it is one.
fn read_shape(element: Element, length_m: f64) -> Result<Option<Shape>, DecodeError> {
    let factors = |names: [&str; 4]| -> Result<[f64; 4], DecodeError> {
        let mut factors = [0.0; 4];
        for (factor, name) in factors.iter_mut().zip(names) {
            *factor = element.number(name)?;
        }
        Ok(factors)
    };
    let shape = match element.name() {
        "line" => Shape::Line,
        "arc" => Shape::Arc(element.number("curvature")?),
        "spiral" => Shape::Spiral(element.number("curvStart")?, element.number("curvEnd")?),
        "poly3" => Shape::Poly3(factors(["a", "b", "c", "d"])?),
        "paramPoly3" => {
            // Without the attribute the parameter is normalized: so says version 1.4, which brought
            // it.
            let range = if element.attribute("pRange") == Some("arcLength") {
                length_m
            } else {
                1.0
            };
            Shape::ParamPoly3(
                factors(["aU", "bU", "cU", "dU"])?,
                factors(["aV", "bV", "cV", "dV"])?,
                range,
            )
        }
        _ => return Ok(None),
    };
    let curvature = match shape {
        Shape::Arc(curvature) => curvature.abs(),
        Shape::Spiral(start, end) => start.abs().max(end.abs()),
        _ => 0.0,
    };
    if curvature * length_m > TURN_MAX_RAD {
        let turn_rad = curvature * length_m;
        return Err(element.fault(format!(
            "it would turn by {turn_rad} rad; expected at most {TURN_MAX_RAD}"
        )));
    }
    if matches!(shape, Shape::Spiral(..) | Shape::Poly3(_)) && length_m > INTEGRATED_MAX_M {
        return Err(element.fault(format!(
            "{length_m} m of one curve; expected at most {INTEGRATED_MAX_M}"
        )));
    }
    Ok(Some(shape))
}

impl Geometry {
    /// The position at `s_m` along the road.
    pub(super) fn at(&self, s_m: f64) -> OnLine {
        let way_m = s_m - self.start_m;
        let (local, turn_rad) = match self.shape {
            Shape::Line => (DVec2::new(way_m, 0.0), 0.0),
            Shape::Arc(curvature) => along_arc(curvature, way_m),
            Shape::Spiral(start, end) => {
                let change = if self.length_m > 0.0 {
                    (end - start) / self.length_m
                } else {
                    0.0
                };
                along_spiral(start, change, way_m)
            }
            Shape::Poly3(factors) => {
                let u = abscissa(&factors, way_m);
                (DVec2::new(u, value(&factors, u)), slope(&factors, u).atan())
            }
            Shape::ParamPoly3(u, v, range) => {
                let parameter = if self.length_m > 0.0 {
                    way_m / self.length_m * range
                } else {
                    0.0
                };
                let turn_rad = slope(&v, parameter).atan2(slope(&u, parameter));
                (
                    DVec2::new(value(&u, parameter), value(&v, parameter)),
                    turn_rad,
                )
            }
        };
        OnLine {
            position: self.origin + DVec2::from_angle(self.heading_rad).rotate(local),
            heading_rad: self.heading_rad + turn_rad,
        }
    }
}

fn along_arc(curvature: f64, way_m: f64) -> (DVec2, f64) {
    let half_turn = 0.5 * curvature * way_m;
    // The chord, exact for the straight line, too.
    let sinc = if half_turn.abs() < 1e-8 {
        1.0
    } else {
        half_turn.sin() / half_turn
    };
    (DVec2::from_angle(half_turn) * way_m * sinc, 2.0 * half_turn)
}

/// Offset along a curve whose curvature starts as given and changes by `change` with every meter:
/// the Fresnel integrals, by quadrature in pieces that turn by a radian at most, which leaves an
/// error far below a micrometer.
fn along_spiral(curvature: f64, change: f64, way_m: f64) -> (DVec2, f64) {
    let heading = |at_m: f64| at_m * (curvature + 0.5 * change * at_m);
    let turn_rad = way_m.abs() * curvature.abs().max((curvature + change * way_m).abs());
    let panels = turn_rad.min(2.0 * TURN_MAX_RAD).ceil().max(1.0);
    let position = integral(way_m, panels as usize, |at_m| {
        DVec2::from_angle(heading(at_m))
    });
    (position, heading(way_m))
}

/// Abscissa up to which a cubic is `way_m` long.
fn abscissa(factors: &[f64; 4], way_m: f64) -> f64 {
    /// Cubics of roads bend little: so few pieces follow them to a micrometer.
    const PANELS: usize = 16;
    /// Four or five do for a road.
    const NEWTON_STEPS_MAX: usize = 40;
    let speed = |u: f64| slope(factors, u).hypot(1.0);
    let length_m = |u: f64| integral(u, PANELS, |at| DVec2::new(speed(at), 0.0)).x;
    // A curve is at least as long as its axis: the answer lies between, and Newton's steps stay
    // there or are halved.
    let (mut low, mut high) = (way_m.min(0.0), way_m.max(0.0));
    let mut u = way_m;
    for _ in 0..NEWTON_STEPS_MAX {
        let excess_m = length_m(u) - way_m;
        if excess_m.abs() < 1e-9 {
            break;
        }
        *(if excess_m > 0.0 { &mut high } else { &mut low }) = u;
        let newton = u - excess_m / speed(u);
        u = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
    }
    u
}

/// The integral from 0 to `end` by Gauss and Legendre, five points in each of `panels` pieces.
fn integral(end: f64, panels: usize, integrand: impl Fn(f64) -> DVec2) -> DVec2 {
    const NODES: [(f64, f64); 5] = [
        (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
        (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (0.0, 0.568_888_888_888_888_9),
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (0.906_179_845_938_664, 0.236_926_885_056_189_1),
    ];
    let half = 0.5 * end / panels as f64;
    let panel = |panel: usize| {
        let middle = half * (2 * panel + 1) as f64;
        NODES
            .iter()
            .map(|(node, weight)| *weight * integrand(middle + half * node))
            .sum::<DVec2>()
    };
    half * (0..panels).map(panel).sum::<DVec2>()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry(shape: Shape, length_m: f64) -> Geometry {
        Geometry {
            start_m: 0.0,
            length_m,
            origin: DVec2::ZERO,
            heading_rad: 0.0,
            shape,
        }
    }

    #[test]
    fn an_arc_is_on_its_circle() {
        let quarter = geometry(Shape::Arc(0.1), 10.0 * std::f64::consts::FRAC_PI_2)
            .at(10.0 * std::f64::consts::FRAC_PI_2);
        assert!(
            (quarter.position - DVec2::new(10.0, 10.0)).length() < 1e-12,
            "{quarter:?}"
        );
        assert!((quarter.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let nearly_straight = geometry(Shape::Arc(1e-13), 100.0).at(100.0).position;
        assert!((nearly_straight - DVec2::new(100.0, 5e-10)).length() < 1e-11);
    }

    #[test]
    fn a_spiral_ends_where_fresnel_says() {
        // Curvature 0 to pi over the length 1: x + iy = C(1) + i S(1) of the normalized integrals
        // (Abramowitz and Stegun, table 7.7).
        let end = geometry(Shape::Spiral(0.0, std::f64::consts::PI), 1.0).at(1.0);
        let expected = DVec2::new(0.779_893_400_376_823, 0.438_259_147_390_355);
        assert!((end.position - expected).length() < 1e-9, "{end:?}");
        assert!((end.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        // C(2) and S(2): two radians of curvature a meter more.
        let end = geometry(Shape::Spiral(0.0, 2.0 * std::f64::consts::PI), 2.0)
            .at(2.0)
            .position;
        assert!(
            (end - DVec2::new(0.488_253_406_075_341, 0.343_415_678_363_698)).length() < 1e-9,
            "{end}"
        );
        // From curved to straight is the same spiral from its other end.
        let back = geometry(Shape::Spiral(std::f64::consts::PI, 0.0), 1.0).at(1.0);
        let turned = DVec2::from_angle(std::f64::consts::FRAC_PI_2)
            .rotate(DVec2::new(expected.x, -expected.y));
        assert!(
            (back.position - turned).length() < 1e-9,
            "{back:?} {turned}"
        );
        // Of constant curvature it is an arc.
        let (spiral, arc) = (
            geometry(Shape::Spiral(0.05, 0.05), 80.0).at(77.0),
            geometry(Shape::Arc(0.05), 80.0).at(77.0),
        );
        assert!((spiral.position - arc.position).length() < 1e-9);
    }

    #[test]
    fn a_cubic_is_walked_by_its_length() {
        // v = u: after the way s the position is (s, s) / sqrt(2).
        let straight = geometry(Shape::Poly3([0.0, 1.0, 0.0, 0.0]), 10.0).at(10.0);
        assert!(
            (straight.position - DVec2::splat(50.0_f64.sqrt())).length() < 1e-8,
            "{straight:?}"
        );
        // v = u²/2: the length up to u is (u sqrt(1 + u²) + asinh u) / 2.
        let u = 3.0_f64;
        let way_m = 0.5 * (u * u.hypot(1.0) + u.asinh());
        let parabola = geometry(Shape::Poly3([0.0, 0.0, 0.5, 0.0]), way_m).at(way_m);
        assert!(
            (parabola.position - DVec2::new(3.0, 4.5)).length() < 1e-6,
            "{parabola:?}"
        );
        assert!((parabola.heading_rad - 3.0_f64.atan()).abs() < 1e-6);
    }

    #[test]
    fn a_parametric_cubic_has_two_ranges() {
        let (u, v) = ([0.0, 20.0, 0.0, 0.0], [0.0, 0.0, 4.0, 0.0]);
        let normalized = geometry(Shape::ParamPoly3(u, v, 1.0), 20.0).at(10.0);
        assert!((normalized.position - DVec2::new(10.0, 1.0)).length() < 1e-12);
        let by_length = geometry(
            Shape::ParamPoly3([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.01, 0.0], 20.0),
            20.0,
        )
        .at(10.0);
        assert!((by_length.position - DVec2::new(10.0, 1.0)).length() < 1e-12);
        for found in [normalized, by_length] {
            assert!(
                (found.heading_rad - 0.2_f64.atan()).abs() < 1e-12,
                "{found:?}"
            );
        }
    }
}
