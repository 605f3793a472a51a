//! L(x) over a background: its definition, and a field that gives it at any position in
//! microseconds.

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use crate::{Invalid, SplatCloud, sh};
use glam::{DVec3, IVec3, ivec3};
use rayon::prelude::*;

use crate::light::AmbientDescriptor;

mod ground;
mod open;

pub use ground::GroundPatch;
use ground::facing_up_m2;

/// Grid points on either side of the origin, along an axis.
const CELLS_MAX: f64 = 1e9;

/// Numbers of a sum: 27 of light and their weight, then RGB of the ground and its weight.
const SUM: usize = GROUND + 4;

/// Sum of weights up to which a mean counts as undefined.
const WEIGHT_MIN: f64 = 1e-12;

/// Index of the weight of all splats in a sum.
const WEIGHT: usize = AmbientDescriptor::LEN;

/// Index of the ground's color in a sum; its weight comes after it.
const GROUND: usize = WEIGHT + 1;

/// Options for gathering the light around a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmbientOptions {
    /// Standard deviation of the weight with distance, meters.
    pub sigma_m: f64,
    /// Splats farther away count nothing, meters.
    pub radius_m: f64,
    /// Distance between probes of a baked field, meters.
    pub spacing_m: f64,
}

impl Default for AmbientOptions {
    fn default() -> Self {
        Self {
            sigma_m: 4.0,
            radius_m: 12.0,
            spacing_m: 1.0,
        }
    }
}

impl AmbientOptions {
    /// Checks the options and describes the first fault.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let values = [
            ("sigma_m", self.sigma_m),
            ("radius_m", self.radius_m),
            ("spacing_m", self.spacing_m),
        ];
        match values
            .iter()
            .find(|(_, value)| !(value.is_finite() && *value > 0.0))
        {
            Some((name, value)) => Err(Invalid::new(format!(
                "{name} is {value}; expected a number of meters above zero"
            ))),
            None if self.radius_m > 100.0 * self.sigma_m
                || self.radius_m > 50.0 * self.spacing_m =>
            {
                Err(Invalid::new(format!(
                    "radius_m is {}, out of proportion to sigma_m, {}, or spacing_m, {}",
                    self.radius_m, self.sigma_m, self.spacing_m
                )))
            }
            None => Ok(()),
        }
    }

    fn weight(&self, distance2_m2: f64) -> f64 {
        if distance2_m2 > self.radius_m * self.radius_m {
            0.0
        } else {
            (-0.5 * distance2_m2 / (self.sigma_m * self.sigma_m)).exp()
        }
    }
}

/// The ambient descriptor at `position`, relative to the cloud's origin: the mean of the splats'
/// spherical harmonics of bands 0 to 2, weighted by `V exp(-|x - mu|^2 / (2 sigma^2))` (DecoupleGS,
/// section 3.4). `None` without a splat within range.
///
/// V of bands 1 and 2 is the opacity. V of DC is the opacity times the area that the splat turns
/// to the sky (`facing_up_m2`): roads are of one gray, so they tell how bright and of which hue the
/// light is. Facades, leaves and parked cars mostly tell their own color. Where no splat faces up,
/// V is the opacity for DC too. `normals` are those of [`crate::SplatScene::normals`].
///
/// This is the definition, summed over all splats; [`AmbientField`] is what a frame asks.
#[must_use]
pub fn ambient_by_definition(
    cloud: &SplatCloud,
    normals: &[[f32; 3]],
    position: DVec3,
    options: &AmbientOptions,
) -> Option<AmbientDescriptor> {
    let mut sum = [0.0; SUM];
    for splat in 0..cloud.len() {
        let mean = DVec3::from_array(cloud.means[splat].map(f64::from));
        let weight =
            options.weight(mean.distance_squared(position)) * f64::from(cloud.opacities[splat]);
        if weight > 0.0 {
            add(&mut sum, weight, (cloud, normals), splat);
        }
    }
    descriptor(&sum)
}

/// The 27 numbers of a splat, DC as of a plain expansion.
fn light_of(cloud: &SplatCloud, splat: usize) -> [f64; AmbientDescriptor::LEN] {
    let rest = cloud.rest_of(splat);
    std::array::from_fn(|number| match number / 3 {
        0 => f64::from(cloud.sh_dc[splat][number]) + sh::DC_SHIFT,
        k => rest
            .get(k - 1)
            .map_or(0.0, |coefficient| f64::from(coefficient[number % 3])),
    })
}

/// Adds a splat to `sum`. `weight` is its opacity times the factor of distance.
fn add(
    sum: &mut [f64; SUM],
    weight: f64,
    (cloud, normals): (&SplatCloud, &[[f32; 3]]),
    splat: usize,
) {
    let light = light_of(cloud, splat);
    for (sum, light) in sum.iter_mut().zip(&light) {
        *sum += weight * light;
    }
    sum[WEIGHT] += weight;
    let ground = weight * facing_up_m2(cloud, normals, splat);
    for (sum, light) in sum[GROUND..].iter_mut().zip(&light[..3]) {
        *sum += ground * light;
    }
    sum[SUM - 1] += ground;
}

fn descriptor(sum: &[f64; SUM]) -> Option<AmbientDescriptor> {
    let (weight, ground) = (sum[WEIGHT], sum[SUM - 1]);
    let coefficient = |k: usize, channel: usize| match k {
        0 if ground > WEIGHT_MIN => sum[GROUND + channel] / ground,
        k => sum[3 * k + channel] / weight,
    };
    // Written so that a NaN fails.
    (weight > WEIGHT_MIN).then(|| AmbientDescriptor {
        coefficients: std::array::from_fn(|k| {
            std::array::from_fn(|channel| coefficient(k, channel) as f32)
        }),
    })
}

/// Splats of one cube, summed up.
struct Voxel {
    /// Weighted mean of their positions.
    center: DVec3,
    sum: [f32; SUM],
}

/// The ambient light over a background, ready to be asked anywhere.
///
/// Splats are summed up in cubes of a fifth of sigma, and [`AmbientField::bake`] sums the cubes up
/// at the points of a grid, between which sums are interpolated. Positions that were not baked are
/// summed from the cubes. Measured against the definition: see the tests.
pub struct AmbientField {
    options: AmbientOptions,
    /// World coordinates of the point that everything below is relative to.
    origin: DVec3,
    voxel_m: f64,
    /// Voxels sorted by column, and by height within one.
    voxels: Vec<Voxel>,
    columns: HashMap<(i32, i32), Range<usize>>,
    /// Sums at the points of the grid.
    probes: HashMap<IVec3, [f32; SUM]>,
}

impl AmbientField {
    /// The field of the first `splats` of `cloud`, whose means are relative to `origin`. Nothing is
    /// baked yet.
    ///
    /// Splats without a finite mean, opacity or color are left out.
    #[must_use]
    pub fn new(cloud: &SplatCloud, splats: usize, origin: DVec3, options: &AmbientOptions) -> Self {
        Self::with_normals((cloud, &[]), splats, origin, options)
    }

    /// The same where a file stores normals of splats: see [`crate::SplatScene::normals`].
    #[must_use]
    pub fn with_normals(
        (cloud, normals): (&SplatCloud, &[[f32; 3]]),
        splats: usize,
        origin: DVec3,
        options: &AmbientOptions,
    ) -> Self {
        let voxel_m = 0.2 * options.sigma_m;
        let key = |splat: usize| {
            let cell = (DVec3::from_array(cloud.means[splat].map(f64::from)) / voxel_m)
                .floor()
                .as_ivec3();
            let usable = cloud.defect_of(splat).is_none() && cloud.opacities[splat] > 0.0;
            usable.then_some((cell.x, cell.y, cell.z, splat as u32))
        };
        let mut keys: Vec<(i32, i32, i32, u32)> =
            (0..splats).into_par_iter().filter_map(key).collect();
        keys.par_sort_unstable();
        let runs: Vec<&[(i32, i32, i32, u32)]> = keys
            .chunk_by(|a, b| (a.0, a.1, a.2) == (b.0, b.1, b.2))
            .collect();
        let voxels = runs
            .par_iter()
            .map(|run| voxel((cloud, normals), run))
            .collect();
        let mut columns: HashMap<(i32, i32), Range<usize>> = HashMap::new();
        for (index, run) in runs.iter().enumerate() {
            columns
                .entry((run[0].0, run[0].1))
                .or_insert(index..index)
                .end = index + 1;
        }
        Self {
            options: *options,
            origin,
            voxel_m,
            voxels,
            columns,
            probes: HashMap::new(),
        }
    }

    /// Sums up the probes about `positions`, world coordinates, between which light is interpolated
    /// from then on. Returns how many there are now.
    pub fn bake(&mut self, positions: impl IntoIterator<Item = DVec3>) -> usize {
        let cells: HashSet<IVec3> = positions
            .into_iter()
            .map(|position| self.cell(position))
            .collect();
        let corners = cells
            .iter()
            .flat_map(|cell| (0..8).map(move |corner| *cell + corner_offset(corner)));
        let missing: HashSet<IVec3> = corners
            .filter(|probe| !self.probes.contains_key(probe))
            .collect();
        let spacing_m = self.options.spacing_m;
        let baked: Vec<(IVec3, [f32; SUM])> = missing
            .into_par_iter()
            .map(|probe| {
                (
                    probe,
                    self.sum_at(probe.as_dvec3() * spacing_m)
                        .map(|sum| sum as f32),
                )
            })
            .collect();
        self.probes.extend(baked);
        self.probes.len()
    }

    /// True if light at `position` is interpolated between baked probes.
    #[must_use]
    pub fn is_baked(&self, position: DVec3) -> bool {
        let cell = self.cell(position);
        (0..8).all(|corner| self.probes.contains_key(&(cell + corner_offset(corner))))
    }

    /// L(x) at `position`, world coordinates: interpolated where it was baked, else summed from the
    /// cubes. `None` where no splat is within range.
    #[must_use]
    pub fn at(&self, position: DVec3) -> Option<AmbientDescriptor> {
        descriptor(
            &self
                .interpolated(position)
                .unwrap_or_else(|| self.sum_at(position - self.origin)),
        )
    }

    /// Probes that were baked, and the cubes that they were summed from.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.probes.len(), self.voxels.len())
    }

    /// The grid point below `position`.
    fn cell(&self, position: DVec3) -> IVec3 {
        // No farther than a neighbor can still be counted: an agent may claim to stand anywhere.
        let cell = ((position - self.origin) / self.options.spacing_m).floor();
        cell.clamp(DVec3::splat(-CELLS_MAX), DVec3::splat(CELLS_MAX))
            .as_ivec3()
    }

    fn interpolated(&self, position: DVec3) -> Option<[f64; SUM]> {
        let cell = self.cell(position);
        let share = (position - self.origin) / self.options.spacing_m - cell.as_dvec3();
        let mut sum = [0.0; SUM];
        for corner in 0..8 {
            let offset = corner_offset(corner);
            let probe = self.probes.get(&(cell + offset))?;
            let along = |axis: usize| {
                if offset[axis] == 1 {
                    share[axis]
                } else {
                    1.0 - share[axis]
                }
            };
            let weight = along(0) * along(1) * along(2);
            sum.iter_mut()
                .zip(probe)
                .for_each(|(sum, value)| *sum += weight * f64::from(*value));
        }
        Some(sum)
    }

    /// The sum over all cubes within range of `position`, relative to the origin.
    fn sum_at(&self, position: DVec3) -> [f64; SUM] {
        let (low, high) = (
            (position - self.options.radius_m) / self.voxel_m,
            (position + self.options.radius_m) / self.voxel_m,
        );
        let (low, high) = (low.floor().as_ivec3(), high.floor().as_ivec3());
        let mut sum = [0.0; SUM];
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                let Some(column) = self.columns.get(&(x, y)) else {
                    continue;
                };
                for voxel in &self.voxels[column.clone()] {
                    let weight = self.options.weight(voxel.center.distance_squared(position));
                    if weight > 0.0 {
                        sum.iter_mut()
                            .zip(&voxel.sum)
                            .for_each(|(sum, value)| *sum += weight * f64::from(*value));
                    }
                }
            }
        }
        sum
    }
}

/// Offset of corner 0 to 7 of a cube.
fn corner_offset(corner: i32) -> IVec3 {
    ivec3(corner & 1, corner >> 1 & 1, corner >> 2)
}

fn voxel(splats: (&SplatCloud, &[[f32; 3]]), run: &[(i32, i32, i32, u32)]) -> Voxel {
    let cloud = splats.0;
    let mut sum = [0.0; SUM];
    let mut center = DVec3::ZERO;
    for &(.., splat) in run {
        let splat = splat as usize;
        let weight = f64::from(cloud.opacities[splat]);
        add(&mut sum, weight, splats, splat);
        center += weight * DVec3::from_array(cloud.means[splat].map(f64::from));
    }
    Voxel {
        center: center / sum[WEIGHT],
        sum: sum.map(|value| value as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ground, a wall that is red, and noise; lighter towards +x.
    pub(super) fn street(count: usize) -> SplatCloud {
        let mut state = 9u64;
        let mut unit = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / 16_777_216.0
        };
        let mut cloud = SplatCloud::with_degree(2);
        for i in 0..count {
            let (x, y) = (60.0 * unit() - 30.0, 24.0 * unit() - 12.0);
            let wall = i % 3 == 0;
            cloud.means.push(if wall {
                [x, 12.0, 8.0 * unit()]
            } else {
                [x, y, 0.1 * unit()]
            });
            // Disks: on the ground they lie, on the wall they stand.
            cloud.scales.push(if wall {
                [0.1, 0.01, 0.1]
            } else {
                [0.1, 0.1, 0.01]
            });
            cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
            cloud.opacities.push(0.1 + 0.9 * unit());
            let bright = 0.02 * x + 0.4 * (unit() - 0.5);
            cloud.sh_dc.push(if wall {
                [bright + 1.0, bright - 0.5, bright - 0.5]
            } else {
                [bright; 3]
            });
            cloud.sh_rest.extend((0..8).map(|k| {
                if k == 2 {
                    [-0.1; 3]
                } else {
                    [0.05 * (unit() - 0.5); 3]
                }
            }));
        }
        cloud
    }

    #[test]
    fn the_field_is_the_definition_but_for_a_little() {
        let (cloud, origin) = (street(60_000), DVec3::new(4.5e6, 7e5, 20.0));
        let options = AmbientOptions::default();
        let mut field = AmbientField::new(&cloud, cloud.len(), origin, &options);
        let positions: Vec<DVec3> = (0..40)
            .map(|i| {
                DVec3::new(
                    1.3 * f64::from(i) - 26.0,
                    f64::from(i % 7) * 3.0 - 9.0,
                    0.5 + 0.05 * f64::from(i),
                )
            })
            .collect();
        let error = |field: &AmbientField| {
            let of = |position: &DVec3| {
                let (found, truth) = (
                    field.at(origin + *position).unwrap(),
                    ambient_by_definition(&cloud, &[], *position, &options).unwrap(),
                );
                let off = found
                    .to_vector()
                    .iter()
                    .zip(truth.to_vector())
                    .fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs()));
                off / f64::from(truth.coefficients[0][0])
            };
            positions.iter().map(of).fold(0.0, f64::max)
        };
        let summed = error(&field);
        assert_eq!(field.size().0, 0);
        let probes = field.bake(positions.iter().map(|position| origin + *position));
        let baked = error(&field);
        println!("of the mean light: {summed:.2e} from cubes, {baked:.2e} from {probes} probes");
        assert!(summed < 1e-3 && baked < 2e-3, "{summed} {baked}");
        assert!(
            summed > 0.0 && baked != summed,
            "the three are not the same computation"
        );
    }

    #[test]
    fn light_is_that_of_what_stands_near() {
        let (cloud, options) = (street(30_000), AmbientOptions::default());
        let field = AmbientField::new(&cloud, cloud.len(), DVec3::ZERO, &options);
        let mean = |x: f64, y: f64| field.at(DVec3::new(x, y, 0.8)).unwrap().mean();
        assert!(
            mean(20.0, 0.0)[1] > mean(-20.0, 0.0)[1] + 0.1,
            "lighter towards +x"
        );
        let [red, green, _] = mean(0.0, 10.0);
        assert!(
            (red - green).abs() < 1e-3,
            "the red wall does not color the light: {red} {green}"
        );
        // Without level splats, upright ones count.
        let mut upright = cloud.clone();
        upright.scales.fill([0.1, 0.01, 0.1]);
        let upright = AmbientField::new(&upright, upright.len(), DVec3::ZERO, &options);
        let [red, green, _] = upright.at(DVec3::new(0.0, 10.0, 0.8)).unwrap().mean();
        assert!(red > green + 0.1, "red beside the wall: {red} {green}");
        assert!(
            field.at(DVec3::new(0.0, 0.0, 500.0)).is_none(),
            "nothing within range"
        );
        // All splats have the same band 1 term along x: the light has it as well, and nothing of y.
        let light = field.at(DVec3::ZERO).unwrap();
        assert!(
            (light.coefficients[3][0] + 0.1).abs() < 1e-3 && light.coefficients[1][0].abs() < 2e-3
        );
    }

    #[test]
    fn places_beyond_all_measure_are_dark() {
        let cloud = street(300);
        let mut field =
            AmbientField::new(&cloud, cloud.len(), DVec3::ZERO, &AmbientOptions::default());
        for position in [
            DVec3::splat(1e12),
            DVec3::splat(-f64::MAX),
            DVec3::splat(f64::NAN),
            DVec3::new(f64::INFINITY, 0.0, 0.0),
        ] {
            assert!(field.at(position).is_none(), "{position}");
            field.bake([position]);
            assert!(field.at(position).is_none(), "{position}");
        }
    }

    #[test]
    fn defects_are_left_out_and_options_checked() {
        let mut cloud = street(300);
        cloud.means[7][0] = f32::NAN;
        cloud.opacities[9] = f32::NAN;
        cloud.sh_dc[11][2] = f32::INFINITY;
        let field = AmbientField::new(&cloud, cloud.len(), DVec3::ZERO, &AmbientOptions::default());
        assert!(
            field
                .at(DVec3::ZERO)
                .unwrap()
                .to_vector()
                .iter()
                .all(|value| value.is_finite())
        );
        AmbientOptions::default().check().unwrap();
        let zero = AmbientOptions {
            sigma_m: 0.0,
            ..AmbientOptions::default()
        };
        assert!(zero.check().unwrap_err().reason().contains("sigma_m is 0"));
        assert!(
            AmbientOptions {
                radius_m: 1e9,
                ..AmbientOptions::default()
            }
            .check()
            .unwrap_err()
            .reason()
            .contains("proportion")
        );
    }
}
