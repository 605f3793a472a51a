//! Merges and exits: lanes that narrow to nothing, or widen from nothing, beside the lane that they
//! lead to.
//!
//! The middle of such a lane ends on the border of the other one, half a lane beside its middle. A
//! vehicle that follows the middles would jump there. So the narrow lane's centerline is bent onto
//! the other's, continuous in place and heading.

use decouplegs_scene::Lane;
use glam::{DVec2, DVec3};

/// A lane is narrow at an end where it is no wider, meters.
const NARROW_M: f64 = 1.2;
/// Gaps up to this are what rounding leaves, and larger ones than half of a wide lane are no merge,
/// meters.
const GAP_M: std::ops::Range<f64> = 0.1..4.0;
/// Least length over which a centerline is bent, where the lane is long enough, meters.
const BEND_MIN_M: f64 = 40.0;
/// Share of a lane's largest width below which its centerline is bent.
const FULL_WIDTH: f64 = 0.95;
/// Share of a lane's length that may be bent.
const BEND_SHARE_MAX: f64 = 0.8;

/// Bends the centerlines of lanes that are narrow where they touch another.
pub(super) fn join_smoothly(lanes: &mut [Lane]) {
    for at in 0..lanes.len() {
        // Heights that only one of the two lanes knows are none to go to.
        let heights = |other: &Lane| {
            if lanes[at].has_height && other.has_height {
                1.0
            } else {
                0.0
            }
        };
        let next = lanes[at].successors.first().and_then(|&next| {
            let line = lanes[next].centerline.get(..2)?;
            Some((line[0], line[1] - line[0], heights(&lanes[next])))
        });
        let before = lanes[at].predecessors.first().and_then(|&before| {
            let line = &lanes[before].centerline;
            let last = line.len().checked_sub(2)?;
            Some((
                line[last + 1],
                line[last] - line[last + 1],
                heights(&lanes[before]),
            ))
        });
        if let Some((position, ahead, height)) =
            next.filter(|_| is_narrow(lanes[at].left.last(), lanes[at].right.last()))
        {
            bend_end(&mut lanes[at], position, ahead.truncate(), height);
        }
        if let Some((position, back, height)) =
            before.filter(|_| is_narrow(lanes[at].left.first(), lanes[at].right.first()))
        {
            let lane = &mut lanes[at];
            let turn = |lane: &mut Lane| {
                [&mut lane.centerline, &mut lane.left, &mut lane.right]
                    .into_iter()
                    .for_each(|line| line.reverse());
            };
            turn(lane);
            bend_end(lane, position, back.truncate(), height);
            turn(lane);
        }
    }
}

fn is_narrow(left: Option<&DVec3>, right: Option<&DVec3>) -> bool {
    left.zip(right)
        .is_some_and(|(left, right)| left.distance(*right) < NARROW_M)
}

/// Bends the end of a centerline to `position`, heading along `ahead`. `height` is 1 if its heights
/// are bent too, otherwise 0.
///
/// Points move by a cubic Hermite curve of their distance from the end: the whole gap and turn at
/// the end, nothing where the bend begins.
fn bend_end(lane: &mut Lane, position: DVec3, ahead: DVec2, height: f64) {
    let points = &lane.centerline;
    let [.., before, end] = points.as_slice() else {
        return;
    };
    let gap = (position - *end) * DVec3::new(1.0, 1.0, height);
    if !GAP_M.contains(&gap.truncate().length()) {
        return;
    }
    let turn = ahead.normalize_or_zero() - (*end - *before).truncate().normalize_or_zero();
    let from_end = distances_from_end(points);
    let length_m = from_end[0];
    let bend_m = taper_m(lane).max(BEND_MIN_M).min(BEND_SHARE_MAX * length_m);
    for (point, from_end_m) in lane.centerline.iter_mut().zip(from_end) {
        let t = 1.0 - from_end_m / bend_m;
        if t > 0.0 {
            let (placed, turned) = (t * t * (3.0 - 2.0 * t), t * t * (t - 1.0) * bend_m);
            *point += gap * placed + (turn * turned).extend(0.0);
        }
    }
}

/// Distances along a line to its end, meters, for each point.
fn distances_from_end(points: &[DVec3]) -> Vec<f64> {
    let mut from_end = vec![0.0; points.len()];
    for at in (0..points.len().saturating_sub(1)).rev() {
        from_end[at] = from_end[at + 1] + points[at].distance(points[at + 1]);
    }
    from_end
}

/// Length of the part before a lane's end in which it is not as wide as it was, meters.
fn taper_m(lane: &Lane) -> f64 {
    // Both borders were sampled at the same positions, but for a few points without length that
    // were left out of either.
    let (count, others) = (lane.left.len(), lane.right.len());
    let beside = |at: usize| lane.right[at * (others - 1) / (count - 1).max(1)];
    let widths_m: Vec<f64> = if others == 0 {
        Vec::new()
    } else {
        (0..count)
            .map(|at| beside(at).distance(lane.left[at]))
            .collect()
    };
    let full_m = FULL_WIDTH * widths_m.iter().copied().fold(0.0, f64::max);
    let narrow = widths_m
        .iter()
        .rev()
        .take_while(|width_m| **width_m < full_m)
        .count();
    distances_from_end(&lane.left)
        .get(widths_m.len().saturating_sub(narrow + 1))
        .copied()
        .unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An on-ramp of 3.5 m beside a lane along x, which narrows to nothing over its last 60 of 100
    /// m, and the lane that both continue in.
    fn merge() -> Vec<Lane> {
        let width_m = |x: f64| 3.5 * ((100.0 - x) / 60.0).clamp(0.0, 1.0);
        let line = |y: &dyn Fn(f64) -> f64, from: i32, to: i32| -> Vec<DVec3> {
            (from..=to)
                .step_by(2)
                .map(|x| DVec3::new(f64::from(x), y(f64::from(x)), 0.0))
                .collect()
        };
        let ramp = Lane {
            centerline: line(&|x| -0.5 * width_m(x), 0, 100),
            left: line(&|_| 0.0, 0, 100),
            right: line(&|x| -width_m(x), 0, 100),
            successors: vec![1],
            ..Lane::default()
        };
        let on = Lane {
            centerline: line(&|_| 1.75, 100, 200),
            left: line(&|_| 3.5, 100, 200),
            right: line(&|_| 0.0, 100, 200),
            predecessors: vec![0],
            ..Lane::default()
        };
        vec![ramp, on]
    }

    fn assert_smooth(lanes: &[Lane], order: [usize; 2]) {
        let mut way: Vec<DVec3> = lanes[order[0]].centerline.clone();
        way.extend(&lanes[order[1]].centerline[1..]);
        for three in way.windows(3) {
            let (a, b) = (
                (three[1] - three[0]).truncate(),
                (three[2] - three[1]).truncate(),
            );
            assert!(a.length() < 2.2 && b.length() < 2.2, "no jump: {three:?}");
            // The ramp's own border has a kink of 0.058 where it begins to taper: its middle has
            // half of that.
            assert!(
                a.angle_to(b).abs() < 0.03,
                "no kink: {} at {}",
                a.angle_to(b),
                three[1]
            );
        }
    }

    #[test]
    fn a_merge_is_continuous_in_place_and_heading() {
        let mut lanes = merge();
        join_smoothly(&mut lanes);
        assert!(
            lanes[0]
                .centerline
                .last()
                .unwrap()
                .distance(lanes[1].centerline[0])
                < 1e-9
        );
        assert_smooth(&lanes, [0, 1]);
        assert_eq!(
            lanes[0].centerline[..10],
            merge()[0].centerline[..10],
            "what is not narrow stays"
        );
        assert_eq!(lanes[1], merge()[1]);
    }

    #[test]
    fn heights_that_one_lane_does_not_know_are_not_bent_to() {
        for knows in [[false, true], [true, false], [true, true]] {
            let mut lanes = merge();
            [lanes[0].has_height, lanes[1].has_height] = knows;
            lanes[1]
                .centerline
                .iter_mut()
                .for_each(|point| point.z = 2.0);
            join_smoothly(&mut lanes);
            assert_eq!(
                lanes[0].centerline.last().unwrap().z,
                if knows == [true, true] { 2.0 } else { 0.0 }
            );
            assert_eq!(lanes[0].centerline[0].z, 0.0);
        }
    }

    #[test]
    fn an_exit_is_a_merge_backwards() {
        let mut lanes = merge();
        for lane in &mut lanes {
            [&mut lane.centerline, &mut lane.left, &mut lane.right]
                .into_iter()
                .for_each(|line| line.reverse());
            std::mem::swap(&mut lane.successors, &mut lane.predecessors);
        }
        join_smoothly(&mut lanes);
        assert_smooth(&lanes, [1, 0]);
    }

    #[test]
    fn wide_lanes_and_distant_ones_stay() {
        let mut lanes = merge();
        lanes[0].right.iter_mut().for_each(|point| point.y = -3.5);
        let wide = lanes.clone();
        join_smoothly(&mut lanes);
        assert_eq!(lanes, wide);
        let mut lanes = merge();
        lanes[1]
            .centerline
            .iter_mut()
            .for_each(|point| point.y += 20.0);
        let distant = lanes.clone();
        join_smoothly(&mut lanes);
        assert_eq!(lanes, distant);
    }
}
