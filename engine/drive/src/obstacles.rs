//! Static obstacles by position.

use decouplegs_scene::Obstacle;

use crate::grid::Grid;
use crate::oriented_box::OrientedBox;

/// Obstacles of a site, indexed by position: a box is compared with those near it alone.
#[derive(Clone, Debug, Default)]
pub struct Obstacles {
    obstacles: Vec<Obstacle>,
    boxes: Vec<OrientedBox>,
    grid: Grid,
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
        Self {
            grid: Grid::new(&boxes),
            obstacles,
            boxes,
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
        let mut near = Vec::new();
        self.grid.near(outline, &mut near);
        let first = near
            .into_iter()
            .find(|&number| self.boxes[number as usize].overlaps(outline))?;
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

#[cfg(test)]
mod tests {
    use decouplegs_scene::ObstacleKind;
    use decouplegs_scene::random::{next, unit};
    use glam::DVec2;

    use super::*;

    #[test]
    fn the_index_finds_what_a_search_through_all_finds() {
        let mut state = 7;
        let mut random = |low: f64, high: f64| low + (high - low) * unit(next(&mut state));
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
