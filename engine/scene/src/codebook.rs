//! Splats whose shapes and colors are entries of codebooks: what an agent's asset is made of.
//!
//! A splat is 12 bytes: a position on a 16-bit grid over the asset's box, 8 bits of opacity, 8 bits
//! of size, a shape (9 bits), a color (10 bits) and what the color's DC term is off by (13 bits).
//! The same words are in memory, in the file and on the device. Work that is linear per agent, such
//! as turning covariances, is done on the entries, not on the splats (vector quantization of
//! Gaussians: Navaneet et al., CompGS, 2023; Niedermayr et al., Compressed 3D Gaussian Splatting,
//! 2024).

use crate::{Bounds, Invalid, ShFrame, SplatCloud, sh, shape};
use rayon::prelude::*;

/// Shapes that an index can name.
pub const SHAPES_MAX: usize = 1 << 9;
/// Colors that an index can name.
pub const COLORS_MAX: usize = 1 << 10;
/// Levels of detail that an asset can have.
pub const LEVELS_MAX: usize = 8;

/// One splat, packed.
///
/// Word 0: position x (low half) and y. Word 1: position z (low half), opacity (8 bits), size (high
/// 8 bits). Word 2: shape (low 9 bits), color (10), DC residual: luma (5), orange (4), green (high
/// 4), each offset by half its range.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct CodedSplat(pub [u32; 3]);

/// The fields of a [`CodedSplat`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SplatCodes {
    /// Place on the grid over the box, 0 its lower corner, 65535 its upper.
    pub position: [u16; 3],
    /// Opacity in 255ths.
    pub opacity: u8,
    /// Size, in steps of the binary logarithm.
    pub size: u8,
    /// Entry of the shape codebook, below [`SHAPES_MAX`].
    pub shape: u16,
    /// Entry of the color codebook, below [`COLORS_MAX`].
    pub color: u16,
    /// Residual of the entry's DC term: luma (-16 to 15), orange and green (-8 to 7), in steps.
    pub dc_residual: [i8; 3],
}

impl From<SplatCodes> for CodedSplat {
    fn from(codes: SplatCodes) -> Self {
        let [x, y, z] = codes.position.map(u32::from);
        let [luma, orange, green] = codes.dc_residual;
        let offset = |value: i8, half: i32| (i32::from(value).clamp(-half, half - 1) + half) as u32;
        let color = offset(luma, 16) | offset(orange, 8) << 5 | offset(green, 8) << 9;
        Self([
            x | y << 16,
            z | u32::from(codes.opacity) << 16 | u32::from(codes.size) << 24,
            u32::from(codes.shape) & 0x1ff | (u32::from(codes.color) & 0x3ff) << 9 | color << 19,
        ])
    }
}

impl From<CodedSplat> for SplatCodes {
    fn from(CodedSplat([xy, z_opacity_size, codes]): CodedSplat) -> Self {
        let field = |shift: u32, bits: u32| codes >> shift & ((1 << bits) - 1);
        Self {
            position: [xy as u16, (xy >> 16) as u16, z_opacity_size as u16],
            opacity: (z_opacity_size >> 16) as u8,
            size: (z_opacity_size >> 24) as u8,
            shape: field(0, 9) as u16,
            color: field(9, 10) as u16,
            dc_residual: [
                field(19, 5) as i8 - 16,
                field(24, 4) as i8 - 8,
                field(28, 4) as i8 - 8,
            ],
        }
    }
}

/// A cloud of coded splats with its codebooks, in an asset's own frame, at one or more levels of
/// detail.
#[derive(Clone, Debug, PartialEq)]
pub struct CodedCloud {
    /// Box of the position grid, meters.
    pub bounds: Bounds,
    /// Binary logarithm of the size that code 0 stands for.
    pub log2_size_min: f32,
    /// Binary logarithm of the ratio between one size and the next.
    pub log2_size_step: f32,
    /// Steps of the DC residual: luma, orange, green.
    pub dc_residual_step: [f32; 3],
    /// All levels of detail one after the other, the finest first.
    pub splats: Vec<CodedSplat>,
    /// Number of splats of each level; their sum is the number of splats.
    pub levels: Vec<usize>,
    /// Lower triangles L by rows (xx, yx, yy, zx, zy, zz) of splats of size 1: the covariance is
    /// size^2 L L^T.
    pub shapes: Vec<[f32; 6]>,
    /// Degree of the colors, 0 to 3.
    pub sh_degree: u8,
    /// Coefficients, DC included, `[entry][coefficient][rgb]` flattened over the first two.
    pub colors: Vec<[f32; 3]>,
    /// Frame of the colors.
    pub sh_frame: ShFrame,
    /// Length, width and height of what it shows, meters.
    pub dims_m: [f32; 3],
}

impl CodedCloud {
    /// Entries of the color codebook.
    #[must_use]
    pub fn color_count(&self) -> usize {
        self.colors.len() / sh::coefficient_count(self.sh_degree)
    }

    /// The coefficients of one color, DC first.
    #[must_use]
    pub fn color(&self, entry: usize) -> &[[f32; 3]] {
        let stride = sh::coefficient_count(self.sh_degree);
        &self.colors[entry * stride..(entry + 1) * stride]
    }

    /// The splats of one level of detail, 0 the finest.
    #[must_use]
    pub fn level(&self, level: usize) -> &[CodedSplat] {
        let first: usize = self.levels[..level].iter().sum();
        &self.splats[first..first + self.levels[level]]
    }

    /// Meters from one place of the position grid to the next.
    #[must_use]
    pub fn position_step_m(&self) -> [f32; 3] {
        std::array::from_fn(|axis| (self.bounds.max[axis] - self.bounds.min[axis]) / 65_535.0)
    }

    /// Checks the cloud and describes the first fault: indices beyond their codebooks, values that
    /// are not finite, counts that do not add up. Every other method needs a cloud that passes.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let coefficients = sh::coefficient_count(self.sh_degree);
        if self.sh_degree > sh::DEGREE_MAX {
            return Err(Invalid::new(format!(
                "colors have degree {}; 0 to {} can be drawn",
                self.sh_degree,
                sh::DEGREE_MAX
            )));
        }
        let listed = self
            .levels
            .iter()
            .try_fold(0usize, |sum, &level| sum.checked_add(level));
        if self.levels.is_empty()
            || self.levels.len() > LEVELS_MAX
            || listed != Some(self.splats.len())
        {
            return Err(Invalid::new(format!(
                "levels of {:?} splats: expected 1 to {LEVELS_MAX} levels that add up to {}",
                self.levels,
                self.splats.len()
            )));
        }
        if self.shapes.is_empty() || self.shapes.len() > SHAPES_MAX {
            return Err(Invalid::new(format!(
                "{} shapes; expected 1 to {SHAPES_MAX}",
                self.shapes.len()
            )));
        }
        if !self.colors.len().is_multiple_of(coefficients)
            || self.colors.is_empty()
            || self.color_count() > COLORS_MAX
        {
            let found = self.colors.len();
            return Err(Invalid::new(format!(
                "{found} color coefficients; expected 1 to {COLORS_MAX} colors of {coefficients}"
            )));
        }
        let numbers = self
            .shapes
            .as_flattened()
            .iter()
            .chain(self.colors.as_flattened())
            .chain(&self.bounds.min);
        let numbers = numbers
            .chain(&self.bounds.max)
            .chain(&self.dc_residual_step)
            .chain(&self.dims_m);
        if let Some(value) = numbers
            .chain([&self.log2_size_min, &self.log2_size_step])
            .find(|value| !value.is_finite())
        {
            return Err(Invalid::new(format!(
                "a codebook or a bound holds {value}; expected finite numbers"
            )));
        }
        let largest = self.log2_size_min + 255.0 * self.log2_size_step;
        if !(-120.0..=120.0).contains(&self.log2_size_min)
            || !(self.log2_size_min..=120.0).contains(&largest)
        {
            return Err(Invalid::new(format!(
                "sizes from 2^{} to 2^{largest}; expected rising exponents in -120 to 120",
                self.log2_size_min
            )));
        }
        let bad = |splat: &CodedSplat| {
            let codes = SplatCodes::from(*splat);
            usize::from(codes.shape) >= self.shapes.len()
                || usize::from(codes.color) >= self.color_count()
        };
        match self.splats.par_iter().position_any(bad) {
            Some(splat) => Err(Invalid::new(format!(
                "splat {splat} names shape {} of {} and color {} of {}",
                SplatCodes::from(self.splats[splat]).shape,
                self.shapes.len(),
                SplatCodes::from(self.splats[splat]).color,
                self.color_count()
            ))),
            None => Ok(()),
        }
    }

    /// Mean of a splat, meters: each axis is rounded after the product and after the sum, here as
    /// on the device.
    #[must_use]
    pub fn mean_m(&self, codes: &SplatCodes) -> [f32; 3] {
        let step = self.position_step_m();
        std::array::from_fn(|axis| {
            self.bounds.min[axis] + f32::from(codes.position[axis]) * step[axis]
        })
    }

    /// The factor of its shape that size stands for.
    #[must_use]
    pub fn size(&self, codes: &SplatCodes) -> f32 {
        (self.log2_size_min + f32::from(codes.size) * self.log2_size_step).exp2()
    }

    /// Residual of the DC coefficients of its color, RGB.
    #[must_use]
    pub fn dc_residual(&self, codes: &SplatCodes) -> [f32; 3] {
        let [luma, orange, green] = std::array::from_fn(|axis| {
            f32::from(codes.dc_residual[axis]) * self.dc_residual_step[axis]
        });
        rgb_from_ycocg([luma, orange, green])
    }

    /// One level of detail as an ordinary cloud.
    ///
    /// # Panics
    /// Panics if there is no such level, or [`CodedCloud::check`] fails.
    #[must_use]
    pub fn decoded(&self, level: usize) -> SplatCloud {
        let shapes: Vec<shape::PrincipalAxes> =
            self.shapes.iter().map(shape::principal_axes).collect();
        let codes: Vec<SplatCodes> = self
            .level(level)
            .iter()
            .map(|&splat| splat.into())
            .collect();
        let dc = |codes: &SplatCodes| {
            let (entry, residual) = (self.color(codes.color.into())[0], self.dc_residual(codes));
            std::array::from_fn(|channel| entry[channel] + residual[channel])
        };
        let scales = |codes: &SplatCodes| {
            let size = self.size(codes);
            shapes[usize::from(codes.shape)]
                .scales
                .map(|scale| scale * size)
        };
        SplatCloud {
            means: codes.iter().map(|codes| self.mean_m(codes)).collect(),
            scales: codes.iter().map(scales).collect(),
            rotations: codes
                .iter()
                .map(|codes| shapes[usize::from(codes.shape)].rotation)
                .collect(),
            opacities: codes
                .iter()
                .map(|codes| f32::from(codes.opacity) / 255.0)
                .collect(),
            sh_degree: self.sh_degree,
            sh_dc: codes.iter().map(dc).collect(),
            sh_rest: codes
                .iter()
                .flat_map(|codes| &self.color(codes.color.into())[1..])
                .copied()
                .collect(),
        }
    }
}

/// RGB as luma, orange and green differences: Malvar and Sullivan, YCoCg-R, 2003, without the
/// lifting.
#[must_use]
pub fn ycocg_from_rgb([red, green, blue]: [f32; 3]) -> [f32; 3] {
    [
        0.25 * (red + blue) + 0.5 * green,
        0.5 * (red - blue),
        0.5 * green - 0.25 * (red + blue),
    ]
}

/// Back from [`ycocg_from_rgb`].
#[must_use]
pub fn rgb_from_ycocg([luma, orange, green]: [f32; 3]) -> [f32; 3] {
    let rest = luma - green;
    [rest + orange, luma + green, rest - orange]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cloud() -> CodedCloud {
        let codes = SplatCodes {
            position: [0, 65_535, 32_768],
            opacity: 255,
            size: 128,
            shape: 1,
            color: 2,
            dc_residual: [3, -1, 2],
        };
        CodedCloud {
            bounds: Bounds {
                min: [-2.0, -1.0, 0.0],
                max: [2.0, 1.0, 1.5],
            },
            log2_size_min: -10.0,
            log2_size_step: 0.05,
            dc_residual_step: [0.02, 0.01, 0.01],
            splats: vec![codes.into(), CodedSplat::default()],
            levels: vec![1, 1],
            shapes: vec![
                [1.0, 0.0, 1.0, 0.0, 0.0, 1.0],
                [2.0, 0.0, 1.0, 0.0, 0.0, 0.5],
            ],
            sh_degree: 1,
            colors: (0..12).map(|i| [i as f32 * 0.1, 0.0, -0.2]).collect(),
            sh_frame: ShFrame::Canonical,
            dims_m: [4.0, 2.0, 1.5],
        }
    }

    proptest! {
        #[test]
        fn packing_keeps_every_field(
            position in prop::array::uniform3(any::<u16>()), opacity: u8, size: u8, shape in 0u16..512, color in 0u16..1024,
            luma in -16i8..16, orange in -8i8..8, green in -8i8..8,
        ) {
            let codes = SplatCodes { position, opacity, size, shape, color, dc_residual: [luma, orange, green] };
            prop_assert_eq!(SplatCodes::from(CodedSplat::from(codes)), codes);
        }

        #[test]
        fn luma_and_chroma_give_the_color_back(rgb in prop::array::uniform3(-2.0f32..2.0)) {
            for (a, b) in rgb_from_ycocg(ycocg_from_rgb(rgb)).iter().zip(rgb) {
                prop_assert!((a - b).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn decoding_reads_boxes_sizes_and_both_codebooks() {
        let cloud = cloud();
        cloud.check().unwrap();
        let decoded = cloud.decoded(0);
        assert_eq!(
            (decoded.len(), decoded.sh_degree, decoded.opacities[0]),
            (1, 1, 1.0)
        );
        assert!(
            (decoded.means[0][0] + 2.0).abs() < 1e-6 && (decoded.means[0][1] - 1.0).abs() < 1e-6
        );
        let size = (-10.0f32 + 128.0 * 0.05).exp2();
        let mut scales = decoded.scales[0];
        scales.sort_by(f32::total_cmp);
        for (scale, expected) in scales.iter().zip([0.5 * size, size, 2.0 * size]) {
            assert!((scale / expected - 1.0).abs() < 1e-5);
        }
        // Luma 3 steps, orange -1, green 2: red 0.06 - 0.02 - 0.01.
        assert!((decoded.sh_dc[0][0] - (0.8 + 0.03)).abs() < 1e-6);
        assert_eq!(decoded.rest_of(0)[0], cloud.colors[9]);
    }

    #[test]
    fn what_cannot_be_drawn_is_named() {
        let broken = |change: fn(&mut CodedCloud)| {
            let mut cloud = cloud();
            change(&mut cloud);
            cloud.check().unwrap_err()
        };
        assert!(broken(|c| c.levels = vec![1]).reason().contains("add up"));
        assert!(
            broken(|c| c.levels = vec![usize::MAX, 3])
                .reason()
                .contains("add up")
        );
        assert!(
            broken(|c| c.shapes.truncate(1))
                .reason()
                .contains("shape 1 of 1")
        );
        assert!(
            broken(|c| c.colors.truncate(8))
                .reason()
                .contains("color 2 of 2")
        );
        assert!(
            broken(|c| c.colors[0][0] = f32::NAN)
                .reason()
                .contains("NaN")
        );
        assert!(broken(|c| c.log2_size_step = 1e9).reason().contains("120"));
        assert!(broken(|c| c.sh_degree = 9).reason().contains("degree"));
    }
}
