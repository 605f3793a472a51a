//! Environment probes: the light that arrives at a position from all around, as lat-long images.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

/// Brighter radiance is clamped: beyond a half float's range by far, and sums over pixels stay
/// finite.
const RADIANCE_MAX: f32 = 1e9;

/// Linear radiance from every direction, lat-long.
///
/// World: z up. The top row is the zenith; the middle column is +x, and left of it, as for one who
/// looks along +x, is +y: pixel (u, v) in \[0, 1)² lies at azimuth pi (1 - 2 u) from +x towards +y
/// and at pi v from the zenith.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Name in reports.
    pub name: String,
    width: usize,
    height: usize,
    /// Row-major from the top left, linear RGB, finite and not negative.
    radiance: Vec<[f32; 3]>,
    /// Pixels of the file that held no radiance (NaN, infinite, negative or beyond all reason) and
    /// were clamped.
    pub clamped: usize,
}

impl Probe {
    /// The probe of `radiance`, linear RGB, row-major from the top left.
    ///
    /// # Panics
    /// If there are not `width` times `height` pixels, or none.
    #[must_use]
    pub fn new(
        name: impl Into<String>,
        width: usize,
        height: usize,
        mut radiance: Vec<[f32; 3]>,
    ) -> Self {
        assert!(
            width * height == radiance.len() && !radiance.is_empty(),
            "{width} x {height} px of {}",
            radiance.len()
        );
        let mut clamped = 0;
        for pixel in &mut radiance {
            let kept = pixel.map(|value| {
                if value.is_nan() {
                    0.0
                } else {
                    value.clamp(0.0, RADIANCE_MAX)
                }
            });
            clamped += usize::from(kept != *pixel);
            *pixel = kept;
        }
        Self {
            name: name.into(),
            width,
            height,
            radiance,
            clamped,
        }
    }

    /// A probe of `width` by `width / 2` pixels of what `radiance` is at their middles.
    #[must_use]
    pub fn from_fn(
        name: impl Into<String>,
        width: usize,
        radiance: impl Fn(DVec3) -> [f32; 3],
    ) -> Self {
        let height = (width / 2).max(1);
        let blank = Self {
            name: name.into(),
            width,
            height,
            radiance: Vec::new(),
            clamped: 0,
        };
        let pixels = (0..width * height)
            .map(|pixel| radiance(blank.direction(pixel)))
            .collect();
        Self::new(blank.name, width, height, pixels)
    }

    /// Number of columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The linear RGB of all pixels, row-major from the top left.
    #[must_use]
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.radiance
    }

    /// Unit vector to the middle of a pixel, counted row by row.
    #[must_use]
    pub fn direction(&self, pixel: usize) -> DVec3 {
        let (column, row) = (pixel % self.width, pixel / self.width);
        let azimuth = PI * (1.0 - 2.0 * (column as f64 + 0.5) / self.width as f64);
        let from_zenith = PI * (row as f64 + 0.5) / self.height as f64;
        DVec3::new(
            from_zenith.sin() * azimuth.cos(),
            from_zenith.sin() * azimuth.sin(),
            from_zenith.cos(),
        )
    }

    /// Steradians that a pixel covers, exactly; 4 pi over all.
    #[must_use]
    pub fn solid_angle(&self, pixel: usize) -> f64 {
        let row = (pixel / self.width) as f64;
        let edge = |row: f64| (PI * row / self.height as f64).cos();
        TAU / self.width as f64 * (edge(row) - edge(row + 1.0))
    }

    /// Linear RGB radiance from `direction` (any length but zero): that of the pixel it falls in.
    #[must_use]
    pub fn radiance(&self, direction: DVec3) -> [f32; 3] {
        let d = direction.normalize_or(DVec3::Z);
        let u = 0.5 * (1.0 - d.y.atan2(d.x) / PI);
        let v = d.z.clamp(-1.0, 1.0).acos() / PI;
        let index = |share: f64, count: usize| ((share * count as f64) as usize).min(count - 1);
        self.radiance[index(v, self.height) * self.width + index(u, self.width)]
    }

    /// Each pixel: unit vector to its middle, steradians, linear RGB.
    pub fn rays(&self) -> impl Iterator<Item = (DVec3, f64, [f64; 3])> + '_ {
        let ray = |pixel| {
            (
                self.direction(pixel),
                self.solid_angle(pixel),
                self.radiance[pixel].map(f64::from),
            )
        };
        (0..self.radiance.len()).map(ray)
    }

    /// The same light on at most `width` columns: blocks of pixels become their mean by solid
    /// angle, so no light is lost.
    #[must_use]
    pub fn downsampled(&self, width: usize) -> Self {
        let block = self.width.div_ceil(width.max(1));
        if block == 1 {
            return self.clone();
        }
        let (columns, rows) = (self.width.div_ceil(block), self.height.div_ceil(block));
        let mut sums = vec![([0.0f64; 3], 0.0f64); columns * rows];
        for (pixel, rgb) in self.radiance.iter().enumerate() {
            let (column, row) = (pixel % self.width, pixel / self.width);
            // A width that the block does not divide: columns are spread evenly instead.
            let index = row * rows / self.height * columns + column * columns / self.width;
            let weight = self.solid_angle(pixel);
            let (sum, weights) = &mut sums[index];
            (0..3).for_each(|channel| sum[channel] += weight * f64::from(rgb[channel]));
            *weights += weight;
        }
        let radiance = sums
            .iter()
            .map(|(sum, weights)| sum.map(|value| (value / weights) as f32))
            .collect();
        Self {
            clamped: self.clamped,
            ..Self::new(self.name.clone(), columns, rows, radiance)
        }
    }
}
