//! Skies: light from far behind all splats.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::Invalid;

/// Largest side of a face, texels.
pub const FACE_TEXELS_MAX: usize = 2048;

/// Largest value of a color. Sums of a few stay finite in f32.
const COLOR_MAX: f32 = 1e6;

/// Samples along each side of a texel when a sky is made from a function.
const SAMPLES_PER_SIDE: usize = 2;

/// Largest difference from an orthogonal matrix that a file's rounding explains.
const ORTHOGONAL_ERROR_MAX: f64 = 1e-4;

/// Color of the sky by direction, display-referred RGB: a cube map with bilinear interpolation,
/// across the edges of its faces too, unless they are [clamped](SkyMap::with_clamped_edges).
///
/// Faces come in the order +x, -x, +y, -y, +z, -z, each row-major from the top. Where s goes right
/// and t down, both from -1 to 1, they lie in the directions (1, -t, -s), (-1, -t, s), (s, 1, t),
/// (s, -1, -t), (s, -t, 1) and (-s, -t, -1): the layout of OpenGL and of nvdiffrast ("Modular
/// Primitives for High-Performance Differentiable Rendering", Laine et al., 2020).
#[derive(Clone, Debug, PartialEq)]
pub struct SkyMap {
    face_texels: usize,
    /// Faces with a border of one texel, from the faces beside them.
    bordered: Vec<[f32; 3]>,
    sky_from_world: DMat3,
    /// True if each face is interpolated by itself.
    edges_are_clamped: bool,
    /// True if interpolated colors are clamped to 0 to 1.
    pub clamps: bool,
    /// True if the blended color of splats is clamped to at most 1 before the sky is added, as
    /// drivestudio does.
    pub clamps_splats: bool,
}

/// Direction of the point (s, t) of a face, not normalized.
fn direction_of(face: usize, s: f64, t: f64) -> DVec3 {
    match face {
        0 => DVec3::new(1.0, -t, -s),
        1 => DVec3::new(-1.0, -t, s),
        2 => DVec3::new(s, 1.0, t),
        3 => DVec3::new(s, -1.0, -t),
        4 => DVec3::new(s, -t, 1.0),
        _ => DVec3::new(-s, -t, -1.0),
    }
}

/// Face, s and t of a direction: the face of its longest component, x before y before z.
fn face_of(direction: DVec3) -> (usize, f64, f64) {
    let (d, longest) = (direction, direction.abs().max_element());
    let (face, s, t) = if d.x.abs() == longest {
        match d.x > 0.0 {
            true => (0, -d.z, -d.y),
            false => (1, d.z, -d.y),
        }
    } else if d.y.abs() == longest {
        match d.y > 0.0 {
            true => (2, d.x, d.z),
            false => (3, d.x, -d.z),
        }
    } else {
        match d.z > 0.0 {
            true => (4, d.x, -d.y),
            false => (5, -d.x, -d.y),
        }
    };
    (face, s / longest, t / longest)
}

impl SkyMap {
    /// The sky of six faces of `face_texels` squared texels each, not clamped.
    ///
    /// # Errors
    /// Returns an error if the number of texels is not that of six faces, a face is too large, a
    /// color is no number or beyond a million, or `world_from_sky` is neither a rotation nor a
    /// reflection.
    pub fn new(
        face_texels: usize,
        texels: &[[f32; 3]],
        world_from_sky: DMat3,
    ) -> Result<Self, Invalid> {
        let n = face_texels;
        if n == 0 || n > FACE_TEXELS_MAX || texels.len() != 6 * n * n {
            return Err(Invalid::new(format!(
                "faces of {n} x {n} texels and {} texels in all; expected six square faces of 1 to {FACE_TEXELS_MAX} texels a side",
                texels.len()
            )));
        }
        let is_color = |value: &f32| value.abs() <= COLOR_MAX;
        if let Some(bad) = texels
            .as_flattened()
            .iter()
            .position(|value| !is_color(value))
        {
            return Err(Invalid::new(format!(
                "texel {} has a value of {}; expected display RGB, between -{COLOR_MAX} and {COLOR_MAX}",
                bad / 3,
                texels.as_flattened()[bad]
            )));
        }
        Self::check_frame(world_from_sky)?;
        Ok(Self {
            face_texels: n,
            bordered: bordered(n, texels),
            // The inverse of what is orthogonal.
            sky_from_world: world_from_sky.transpose(),
            edges_are_clamped: false,
            clamps: false,
            clamps_splats: false,
        })
    }

    /// The same sky, each face interpolated by itself: beyond the middles of its outer texels it
    /// has their colors.
    #[must_use]
    pub fn with_clamped_edges(self) -> Self {
        let texels = self.texels();
        let (n, side) = (self.face_texels, self.face_texels + 2);
        let inner = |index: usize| index.clamp(1, n) - 1;
        let texel = |index: usize| {
            let (face, row, column) = (index / (side * side), index / side % side, index % side);
            texels[(face * n + inner(row)) * n + inner(column)]
        };
        Self {
            bordered: (0..6 * side * side).map(texel).collect(),
            edges_are_clamped: true,
            ..self
        }
    }

    /// True if each face is interpolated by itself.
    #[must_use]
    pub fn edges_are_clamped(&self) -> bool {
        self.edges_are_clamped
    }

    /// Checks that `world_from_sky` is a rotation or a reflection.
    ///
    /// # Errors
    /// Returns an error if it is not, by more than a file's rounding.
    pub fn check_frame(world_from_sky: DMat3) -> Result<(), Invalid> {
        let product = world_from_sky * world_from_sky.transpose() - DMat3::IDENTITY;
        let error = product.to_cols_array().map(f64::abs);
        if error.iter().all(|error| *error <= ORTHOGONAL_ERROR_MAX) {
            return Ok(());
        }
        Err(Invalid::new(
            "'world_from_sky' is neither a rotation nor a reflection; expected three rows of unit length at right angles",
        ))
    }

    /// The sky of `color`, a function of the unit direction in the sky's own frame: each texel is
    /// the mean of four samples.
    ///
    /// # Errors
    /// Returns the errors of [`SkyMap::new`].
    pub fn from_fn(
        face_texels: usize,
        world_from_sky: DMat3,
        color: impl Fn(DVec3) -> [f64; 3] + Sync,
    ) -> Result<Self, Invalid> {
        let samples = SAMPLES_PER_SIDE;
        let position =
            |index: usize| 2.0 * (index as f64 + 0.5) / (face_texels * samples) as f64 - 1.0;
        let texel = |index: usize| {
            let (face, row, column) = (
                index / (face_texels * face_texels),
                index / face_texels % face_texels,
                index % face_texels,
            );
            let mut sum = [0.0; 3];
            for sample in 0..samples * samples {
                let s = position(column * samples + sample % samples);
                let t = position(row * samples + sample / samples);
                let rgb = color(direction_of(face, s, t).normalize());
                sum = std::array::from_fn(|channel| sum[channel] + rgb[channel]);
            }
            sum.map(|sum| (sum / (samples * samples) as f64) as f32)
        };
        // More texels than this are refused before they are computed.
        let texels: Vec<[f32; 3]> = match face_texels {
            1..=FACE_TEXELS_MAX => (0..6 * face_texels * face_texels)
                .into_par_iter()
                .map(texel)
                .collect(),
            _ => Vec::new(),
        };
        Self::new(face_texels, &texels, world_from_sky)
    }

    /// Texels along each side of a face, without its border.
    #[must_use]
    pub fn face_texels(&self) -> usize {
        self.face_texels
    }

    /// Texels of all faces, each with a border of one texel: six squares of
    /// `face_texels + 2`, row-major.
    #[must_use]
    pub fn bordered_texels(&self) -> &[[f32; 3]] {
        &self.bordered
    }

    /// Texels of all faces without their borders, row-major.
    #[must_use]
    pub fn texels(&self) -> Vec<[f32; 3]> {
        let (n, side) = (self.face_texels, self.face_texels + 2);
        let inner = |face: &[[f32; 3]]| -> Vec<[f32; 3]> {
            let rows = face.chunks_exact(side).skip(1).take(n);
            rows.flat_map(|row| row[1..=n].iter().copied()).collect()
        };
        let faces = self.bordered.chunks_exact(side * side);
        faces.flat_map(inner).collect()
    }

    /// Texels of all faces of the same sky in a cube of another frame, `face_texels` a side: those
    /// of this one where nothing differs, else colors of the directions of their centers.
    #[must_use]
    pub fn texels_in_frame(&self, face_texels: usize, sky_from_world: DMat3) -> Vec<[f32; 3]> {
        if face_texels == self.face_texels && sky_from_world == self.sky_from_world {
            return self.texels();
        }
        let world_from_sky = sky_from_world.transpose();
        let at = |index: usize| 2.0 * (index as f64 + 0.5) / face_texels as f64 - 1.0;
        let texel = |index: usize| {
            let (face, place) = (index / face_texels.pow(2), index % face_texels.pow(2));
            let direction = direction_of(face, at(place % face_texels), at(place / face_texels));
            self.color(world_from_sky * direction)
                .map(|value| value as f32)
        };
        (0..6 * face_texels.pow(2)).map(texel).collect()
    }

    /// Rotation or reflection from world directions to those of the cube.
    #[must_use]
    pub fn sky_from_world(&self) -> DMat3 {
        self.sky_from_world
    }

    /// Color in a direction of the world, of any length but zero.
    #[must_use]
    pub fn color(&self, direction: DVec3) -> [f64; 3] {
        let (face, s, t) = face_of(self.sky_from_world * direction);
        let side = self.face_texels + 2;
        // The center of texel 0 is 1 in the bordered face.
        let position = |at: f64| 0.5 * (at + 1.0) * self.face_texels as f64 + 0.5;
        let split = |position: f64| {
            let first = (position.floor() as usize).min(self.face_texels);
            (first, position - first as f64)
        };
        let ((column, right), (row, down)) = (split(position(s)), split(position(t)));
        let at = |row: usize, column: usize| {
            self.bordered[face * side * side + row * side + column].map(f64::from)
        };
        let corners = [
            (at(row, column), (1.0 - right) * (1.0 - down)),
            (at(row, column + 1), right * (1.0 - down)),
            (at(row + 1, column), (1.0 - right) * down),
            (at(row + 1, column + 1), right * down),
        ];
        let channel = |channel: usize| -> f64 {
            let value = corners
                .iter()
                .map(|(rgb, weight)| rgb[channel] * weight)
                .sum();
            if self.clamps {
                f64::clamp(value, 0.0, 1.0)
            } else {
                value
            }
        };
        std::array::from_fn(channel)
    }
}

/// Faces of `n` texels a side with a border of one texel: the nearest texel of the face beside, and
/// in corners the mean of the three texels that meet there.
fn bordered(n: usize, texels: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let side = n + 2;
    let texel = |face: usize, row: usize, column: usize| texels[(face * n + row) * n + column];
    let center = |index: usize| 2.0 * (index as f64 + 0.5) / n as f64 - 1.0;
    // Just beyond the edge: the longest component is that of the face beside.
    let beyond = |index: usize| match index {
        0 => -1.0 - 1e-9,
        index if index == side - 1 => 1.0 + 1e-9,
        index => center(index - 1),
    };
    let beside = |face: usize, row: usize, column: usize| {
        let (face, s, t) = face_of(direction_of(face, beyond(column), beyond(row)));
        let index = |at: f64| ((0.5 * (at + 1.0) * n as f64) as usize).min(n - 1);
        texel(face, index(t), index(s))
    };
    let mut faces = Vec::with_capacity(6 * side * side);
    for face in 0..6 {
        for row in 0..side {
            for column in 0..side {
                let edge = |at: usize| at == 0 || at == side - 1;
                let inner = |at: usize| at.clamp(1, n);
                faces.push(match (edge(row), edge(column)) {
                    (false, false) => texel(face, row - 1, column - 1),
                    (true, true) => {
                        let meeting = [
                            texel(face, inner(row) - 1, inner(column) - 1),
                            beside(face, row, inner(column)),
                            beside(face, inner(row), column),
                        ];
                        std::array::from_fn(|channel| {
                            meeting.iter().map(|rgb| rgb[channel]).sum::<f32>() / 3.0
                        })
                    }
                    _ => beside(face, row, column),
                });
            }
        }
    }
    faces
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{next, unit};

    /// One color per axis: red +x, green +y, blue +z, and their complements.
    fn compass() -> SkyMap {
        let colors = [
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 1.0],
            [0.0, 1.0, 0.0],
            [1.0, 0.0, 1.0],
            [0.0, 0.0, 1.0],
            [1.0, 1.0, 0.0],
        ];
        let texels: Vec<[f32; 3]> = (0..6 * 16).map(|texel| colors[texel / 16]).collect();
        SkyMap::new(4, &texels, DMat3::IDENTITY).unwrap()
    }

    fn directions(count: usize) -> Vec<DVec3> {
        let mut state = 3;
        let mut axis = || 2.0 * unit(next(&mut state)) - 1.0;
        (0..count)
            .map(|_| DVec3::new(axis(), axis(), axis()))
            .collect()
    }

    #[test]
    fn the_six_axes_have_the_colors_of_their_faces() {
        let sky = compass();
        for (axis, color) in [
            (DVec3::X, [1.0, 0.0, 0.0]),
            (-DVec3::X, [0.0, 1.0, 1.0]),
            (DVec3::Y, [0.0, 1.0, 0.0]),
            (-DVec3::Y, [1.0, 0.0, 1.0]),
            (DVec3::Z, [0.0, 0.0, 1.0]),
            (-DVec3::Z, [1.0, 1.0, 0.0]),
        ] {
            assert_eq!(sky.color(7.0 * axis), color);
        }
        // drivestudio looks (x, z, -y) up: +y of its cube is the zenith.
        let rows = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
        let sky_from_world = DMat3::from_cols_array_2d(&rows).transpose();
        let texels: Vec<[f32; 3]> = (0..6).map(|face| [face as f32, 0.0, 0.0]).collect();
        let turned = SkyMap::new(1, &texels, sky_from_world.transpose()).unwrap();
        assert_eq!(turned.color(DVec3::Z)[0], 2.0);
        assert_eq!(turned.color(DVec3::Y)[0], 5.0);
    }

    /// Every point of a face leads back to itself: `face_of` is the inverse of `direction_of`.
    #[test]
    fn directions_and_faces_are_inverse() {
        for face in 0..6 {
            for (s, t) in [(0.2, -0.9), (-0.5, 0.4), (0.99, 0.98)] {
                let (found, found_s, found_t) = face_of(3.0 * direction_of(face, s, t));
                assert_eq!(found, face);
                assert!((found_s - s).abs() + (found_t - t).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn clamped_edges_have_the_colors_of_their_own_face() {
        let sky = compass();
        let beside = DVec3::new(1.0, 0.999, 0.0);
        assert!(sky.color(beside)[1] > 0.3);
        let clamped = sky.clone().with_clamped_edges();
        assert_eq!(clamped.color(beside), [1.0, 0.0, 0.0]);
        assert_eq!(clamped.texels(), sky.texels());
        assert_ne!(clamped, sky);
    }

    #[test]
    fn a_smooth_sky_is_met_everywhere() {
        let smooth = |d: DVec3| {
            let d = d.normalize();
            [
                0.5 + 0.4 * d.x * d.y,
                0.5 + 0.3 * d.z,
                0.5 - 0.4 * d.y * d.z,
            ]
        };
        let sky = SkyMap::from_fn(128, DMat3::IDENTITY, smooth).unwrap();
        let mut worst = 0.0f64;
        for direction in directions(100_000) {
            let (found, truth) = (sky.color(direction), smooth(direction));
            let error = (0..3)
                .map(|c| (found[c] - truth[c]).abs())
                .fold(0.0, f64::max);
            worst = worst.max(error);
        }
        assert!(worst < 1.0 / 512.0, "{worst}");
    }

    #[test]
    fn colors_are_continuous_across_edges_and_corners() {
        let mut state = 9;
        let mut value = || unit(next(&mut state)) as f32;
        let texels: Vec<[f32; 3]> = (0..6 * 25)
            .map(|_| std::array::from_fn(|_| value()))
            .collect();
        let sky = SkyMap::new(5, &texels, DMat3::IDENTITY).unwrap();
        let signs = [-1.0, 1.0];
        let mut seams = Vec::new();
        for at in (0..=40).map(|at| f64::from(at) / 20.0 - 1.0) {
            for a in signs {
                for b in signs {
                    seams.extend([
                        DVec3::new(a, b, at),
                        DVec3::new(a, at, b),
                        DVec3::new(at, a, b),
                    ]);
                }
            }
        }
        let mut worst = 0.0f64;
        for seam in seams {
            let nudges = directions(12).into_iter().map(|by| seam + 1e-7 * by);
            let colors: Vec<[f64; 3]> = nudges.map(|direction| sky.color(direction)).collect();
            for color in &colors {
                let error = (0..3).map(|c| (color[c] - colors[0][c]).abs());
                worst = error.fold(worst, f64::max);
            }
        }
        assert!(worst < 1e-5, "{worst}");
    }

    #[test]
    fn skies_that_make_no_sense_are_refused() {
        let error = |n: usize, texels: &[[f32; 3]], matrix: DMat3| {
            SkyMap::new(n, texels, matrix).unwrap_err().to_string()
        };
        assert!(error(2, &[[0.0; 3]; 23], DMat3::IDENTITY).contains("23 texels in all"));
        assert!(error(0, &[], DMat3::IDENTITY).contains("0 x 0"));
        assert!(error(1, &[[f32::NAN; 3]; 6], DMat3::IDENTITY).contains("texel 0"));
        // Three of these would be infinite, where faces meet.
        assert!(error(1, &[[3e38; 3]; 6], DMat3::IDENTITY).contains("texel 0"));
        let stretched = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 2.0));
        assert!(error(1, &[[0.5; 3]; 6], stretched).contains("world_from_sky"));
        let nan = DMat3::from_diagonal(DVec3::splat(f64::NAN));
        assert!(error(1, &[[0.5; 3]; 6], nan).contains("world_from_sky"));
        assert!(SkyMap::from_fn(FACE_TEXELS_MAX + 1, DMat3::IDENTITY, |_| [0.0; 3]).is_err());
    }

    #[test]
    fn only_a_sky_that_clamps_is_clamped() {
        let mut sky = SkyMap::new(1, &[[1.5, -0.5, 0.5]; 6], DMat3::IDENTITY).unwrap();
        assert_eq!(sky.color(DVec3::X), [1.5, -0.5, 0.5]);
        sky.clamps = true;
        assert_eq!(sky.color(DVec3::X), [1.0, 0.0, 0.5]);
    }
}
