//! Static obstacles by place.

use decouplegs_scene::Obstacle;
use glam::DVec2;

use crate::oriented_box::OrientedBox;

/// Side of a square of the index, meters: about a house.
const SQUARE_M: f64 = 16.0;

/// Obstacles of a site, indexed by place: a box is compared with those near it alone.
#[derive(Clone, Debug, Default)]
pub struct Obstacles {
    obstacles: Vec<Obstacle>,
    boxes: Vec<OrientedBox>,
    /// Square and obstacle, sorted.
    squares: Vec<([i64; 2], u32)>,
}

impl Obstacles {
    /// The index of `obstacles`. Those with a number that is not finite are left out.
    #[must_use]
    pub fn new(obstacles: Vec<Obstacle>) -> Self {
        let finite = |one: &Obstacle| {
            one.center_m.is_finite()
                && [one.yaw_rad, one.length_m, one.width_m]
                    .into_iter()
                    .all(f64::is_finite)
        };
        let obstacles: Vec<Obstacle> = obstacles.into_iter().filter(finite).collect();
        let boxes: Vec<OrientedBox> = obstacles.iter().map(outline).collect();
        let mut squares = Vec::new();
        for (number, one) in boxes.iter().enumerate() {
            squares.extend(covered(one).map(|square| (square, number as u32)));
        }
        squares.sort_unstable();
        squares.dedup();
        Self {
            obstacles,
            boxes,
            squares,
        }
    }

    /// All obstacles.
    #[must_use]
    pub fn all(&self) -> &[Obstacle] {
        &self.obstacles
    }

    /// The first obstacle, in their order, that `outline` overlaps.
    #[must_use]
    pub fn touched(&self, outline: &OrientedBox) -> Option<&Obstacle> {
        let near = covered(outline).flat_map(|square| {
            let first = self.squares.partition_point(|entry| entry.0 < square);
            let entries = self.squares[first..].iter();
            entries.take_while(move |entry| entry.0 == square)
        });
        let touched = near.filter(|entry| self.boxes[entry.1 as usize].overlaps(outline));
        let first = touched.map(|entry| entry.1).min()?;
        Some(&self.obstacles[first as usize])
    }
}

/// The box of an obstacle.
#[must_use]
pub fn outline(obstacle: &Obstacle) -> OrientedBox {
    OrientedBox {
        center_m: obstacle.center_m,
        yaw_rad: obstacle.yaw_rad,
        half_length_m: 0.5 * obstacle.length_m,
        half_width_m: 0.5 * obstacle.width_m,
    }
}

/// Squares that a box may touch.
fn covered(outline: &OrientedBox) -> impl Iterator<Item = [i64; 2]> + use<> {
    let reach_m = DVec2::splat(outline.half_length_m.hypot(outline.half_width_m));
    let square = |at_m: DVec2| (at_m / SQUARE_M).floor().as_i64vec2();
    let (low, high) = (
        square(outline.center_m - reach_m),
        square(outline.center_m + reach_m),
    );
    (low.x..=high.x).flat_map(move |x| (low.y..=high.y).map(move |y| [x, y]))
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::obstacle::ObstacleKind;

    use super::*;

    /// A number from 0 to below 1.
    fn unit(state: &mut u64) -> f64 {
        *state = decouplegs_scene::random::mix(*state);
        (*state >> 11) as f64 / (1_u64 << 53) as f64
    }

    #[test]
    fn the_index_finds_what_a_search_through_all_finds() {
        let mut state = 7;
        let mut random = |low: f64, high: f64| low + (high - low) * unit(&mut state);
        let obstacles: Vec<Obstacle> = (0..400)
            .map(|_| Obstacle {
                kind: ObstacleKind::House,
                center_m: DVec2::new(random(-150.0, 150.0), random(-150.0, 150.0)),
                yaw_rad: random(-4.0, 4.0),
                length_m: random(0.1, 30.0),
                width_m: random(0.1, 12.0),
            })
            .collect();
        let index = Obstacles::new(obstacles.clone());
        let mut hits = 0;
        for _ in 0..2000 {
            let probe = OrientedBox {
                center_m: DVec2::new(random(-170.0, 170.0), random(-170.0, 170.0)),
                yaw_rad: random(-4.0, 4.0),
                half_length_m: 2.3,
                half_width_m: 0.9,
            };
            let expected = obstacles.iter().find(|one| outline(one).overlaps(&probe));
            assert_eq!(index.touched(&probe), expected);
            hits += u32::from(expected.is_some());
        }
        assert!((200..1900).contains(&hits), "{hits} hits");
    }

    #[test]
    fn numbers_that_are_none_are_left_out() {
        let broken = Obstacle {
            kind: ObstacleKind::Post,
            center_m: DVec2::new(f64::NAN, 0.0),
            yaw_rad: 0.0,
            length_m: 1.0,
            width_m: 1.0,
        };
        assert!(Obstacles::new(vec![broken]).all().is_empty());
    }
}
