//! Makes splats of surfaces, with the statistics of trained driving scenes.

use decouplegs_scene::{SplatCloud, sh};
use glam::{DVec3, Quat, Vec3};
use rayon::prelude::*;

use super::focus::Focus;
use super::footprint::Footprint;
use super::light::Light;
use super::random::Stream;
use super::surface::Element;

/// Share of splats with an opacity below [`FAINT_OPACITY_MAX`]: what densification leaves behind in
/// trained scenes.
pub(super) const FAINT_SHARE: f32 = 0.45;

/// Opacity below what any pixel shows (1/255), yet with a finite logit.
const OPACITY_MIN: f32 = 0.003;

/// Upper end of the faint mode.
pub(super) const FAINT_OPACITY_MAX: f32 = 0.15;

/// Largest outward distance of splats from their surface: wheels must not sink into the road.
/// Inward they may stray freely.
const OUTWARD_MAX_M: f32 = 0.015;

/// Splats sampled by one task; large enough that finding the element costs nothing.
const CHUNK: usize = 2048;

/// Splats for each element, in proportion to area times density, summing to exactly `total`
/// (largest remainder).
fn allocate(elements: &[Element], total: usize) -> Vec<usize> {
    let weights: Vec<f64> = elements
        .iter()
        .map(|e| f64::from(e.shape.area_m2()) * f64::from(e.density))
        .collect();
    let sum: f64 = weights.iter().sum();
    assert!(sum.is_finite(), "a surface without a finite area");
    if sum <= 0.0 {
        return vec![0; elements.len()];
    }
    let shares: Vec<f64> = weights
        .iter()
        .map(|weight| weight / sum * total as f64)
        .collect();
    let mut counts: Vec<usize> = shares.iter().map(|share| share.floor() as usize).collect();
    let mut order: Vec<usize> = (0..elements.len()).collect();
    order.sort_by(|&a, &b| {
        shares[b]
            .fract()
            .total_cmp(&shares[a].fract())
            .then(a.cmp(&b))
    });
    let missing = total.saturating_sub(counts.iter().sum());
    // Rounding leaves fewer missing than there are elements.
    order
        .iter()
        .take(missing)
        .for_each(|&element| counts[element] += 1);
    counts
}

/// Properties of a splat that do not depend on its neighbors' arrays.
struct Splat {
    mean: Vec3,
    scales: Vec3,
    rotation: Quat,
    opacity: f32,
    dc: Vec3,
}

/// Exactly `total` splats over `elements`, the same for the same `seed` whatever the threads.
///
/// Splats close to where `focus` has cameras pass stay small. With no surface to put them on, the
/// cloud is empty.
pub(super) fn emit(
    elements: &[Element],
    total: usize,
    sh_degree: u8,
    seed: u64,
    light: &Light,
    focus: &Focus,
) -> SplatCloud {
    let counts = allocate(elements, total);
    let mut offsets = Vec::with_capacity(elements.len() + 1);
    offsets.push(0usize);
    counts
        .iter()
        .for_each(|count| offsets.push(offsets[offsets.len() - 1] + count));
    let total = offsets[elements.len()];
    let stride = sh::coefficient_count(sh_degree) - 1;
    let mut cloud = SplatCloud {
        means: vec![[0.0; 3]; total],
        scales: vec![[0.0; 3]; total],
        rotations: vec![[0.0; 4]; total],
        opacities: vec![0.0; total],
        sh_degree,
        sh_dc: vec![[0.0; 3]; total],
        sh_rest: vec![[0.0; 3]; total * stride],
    };
    let SplatCloud {
        means,
        scales,
        rotations,
        opacities,
        sh_dc,
        sh_rest,
        ..
    } = &mut cloud;
    // Degree 0 has no rest; a stand-in of empty chunks keeps the zip below the same.
    let rest_chunks: Vec<&mut [[f32; 3]]> = if stride == 0 {
        (0..total.div_ceil(CHUNK))
            .map(|_| Default::default())
            .collect()
    } else {
        sh_rest.chunks_mut(CHUNK * stride).collect()
    };
    means
        .par_chunks_mut(CHUNK)
        .zip(scales.par_chunks_mut(CHUNK))
        .zip(rotations.par_chunks_mut(CHUNK))
        .zip(opacities.par_chunks_mut(CHUNK))
        .zip(sh_dc.par_chunks_mut(CHUNK))
        .zip(rest_chunks)
        .enumerate()
        .for_each(
            |(chunk, (((((means, scales), rotations), opacities), dc), rest))| {
                for slot in 0..means.len() {
                    let index = chunk * CHUNK + slot;
                    let element = offsets.partition_point(|&first| first <= index) - 1;
                    let item = index - offsets[element];
                    let mut random = Stream::new(seed, element as u64, item as u64);
                    let rest = &mut rest[slot * stride..(slot + 1) * stride];
                    let splat = splat(
                        &elements[element],
                        &Item {
                            index: item,
                            count: counts[element],
                            faint: is_faint(index),
                        },
                        light,
                        focus,
                        &mut random,
                        rest,
                    );
                    means[slot] = splat.mean.to_array();
                    scales[slot] = splat.scales.to_array();
                    let q = splat.rotation;
                    rotations[slot] = [q.w, q.x, q.y, q.z];
                    opacities[slot] = splat.opacity;
                    dc[slot] = splat.dc.to_array();
                }
            },
        );
    cloud
}

/// True if splat `index` of the cloud is of the faint mode. A golden-ratio sequence: faint splats
/// never leave a gap of more than two along a row, and elements of one splat are faint as often as
/// others.
fn is_faint(index: usize) -> bool {
    ((index as f64 + 0.5) * 0.618_033_988_749_894_9).fract() < f64::from(FAINT_SHARE)
}

/// One of the splats on an element.
struct Item {
    /// Number of the splat on the element, from 0.
    index: usize,
    /// Number of splats on the element.
    count: usize,
    /// True if it is of the faint mode.
    faint: bool,
}

/// The splat `item` of `element`.
fn splat(
    element: &Element,
    item: &Item,
    light: &Light,
    focus: &Focus,
    random: &mut Stream,
    rest: &mut [[f32; 3]],
) -> Splat {
    let &Item {
        index,
        count,
        faint,
    } = item;
    let point = element.shape.sample(index, count, random);
    let mut texel = (element.texture)(&point);
    let spacing_m = (element.shape.area_m2() / (count as f32 * (1.0 - FAINT_SHARE))).sqrt();

    let position = element.rotation * point.position + element.translation;
    let normal = element.rotation * point.normal;
    // Shadows have no depth: they must not reach into the road.
    let depth = if texel.sheer > 0.0 { 0.0 } else { 1.0 };
    let off_surface_m =
        (depth * (if faint { 0.25 } else { 0.02 }) * random.normal() * spacing_m.min(1.0))
            .min(OUTWARD_MAX_M);
    let footprint = Footprint::new(
        element,
        &point,
        &texel,
        (spacing_m, focus.largest_m(position)),
        random,
    );
    let (scales, rotation) = footprint.disc(point.normal, random);
    texel.albedo = footprint.mean_albedo(element, &point, &texel);

    if let Some(weather) = element.weather.as_ref().filter(|_| texel.weathered) {
        texel.albedo *= weather(&point);
    }
    let lit = light.shade(&texel, position, normal, random);
    let color = (lit.color * (1.0 + 0.035 * random.normal()) + 0.012 * random.signed3())
        .clamp(Vec3::ZERO, Vec3::ONE);
    view_dependence(
        rest,
        color,
        normal,
        (light.towards_sun(), texel.gloss * lit.sheen),
        random,
    );
    Splat {
        mean: position + normal * off_surface_m,
        scales,
        rotation: (element.rotation * rotation).normalize(),
        opacity: (opacity_of(faint, random) * (1.0 - texel.sheer)).max(OPACITY_MIN),
        dc: (color - 0.5) / sh::Y0 as f32,
    }
}

/// Two modes: faint ones crowd towards zero, the others mostly above 0.7 with some between.
fn opacity_of(faint: bool, random: &mut Stream) -> f32 {
    let unit = random.unit();
    if faint {
        OPACITY_MIN + (FAINT_OPACITY_MAX - 0.004) * unit * unit
    } else if random.chance(0.1) {
        0.2 + 0.5 * unit
    } else {
        0.999 - 0.28 * unit * unit
    }
}

/// Coefficients after DC: a sheen where the sun is mirrored, and noise that falls by band.
fn view_dependence(
    rest: &mut [[f32; 3]],
    color: Vec3,
    normal: Vec3,
    (towards_sun, sheen): (Vec3, Vec3),
    random: &mut Stream,
) {
    if rest.is_empty() {
        return;
    }
    // The view direction (camera to splat) in which the camera stands in the mirrored sunbeam.
    let mirrored = towards_sun - 2.0 * normal.dot(towards_sun) * normal;
    let strength = sheen * normal.dot(towards_sun).max(0.0);
    let lobe = if strength != Vec3::ZERO {
        sh::basis(mirrored.as_dvec3().normalize_or(DVec3::Z))
    } else {
        [0.0; 16]
    };
    for (index, coefficient) in rest.iter_mut().enumerate() {
        // Noise and lobe by band; index 0 is the first of band 1.
        let (noise, lobe_weight) = match index {
            0..=2 => (0.030, 0.10),
            3..=7 => (0.018, 0.07),
            _ => (0.010, 0.045),
        };
        let gray = noise * random.normal() * (0.3 + 0.7 * color.max_element());
        let sheen = strength * lobe_weight * lobe[index + 1] as f32;
        *coefficient = (Vec3::splat(gray) + sheen + 0.35 * noise * random.signed3()).to_array();
    }
}

#[cfg(test)]
mod tests {
    use glam::Mat3;

    use super::*;
    use crate::street::surface::{Shape, Texel};
    use crate::street::weather::{Air, Weather};

    fn wall(width_m: f32, density: f32) -> Element {
        let shape = Shape::Rectangle {
            corner: Vec3::ZERO,
            along: Vec3::X * width_m,
            up: Vec3::Z,
        };
        Element::new(shape, density, |_| Texel::matt(Vec3::splat(0.2)))
    }

    #[test]
    fn counts_follow_area_times_density_and_sum_exactly() {
        let elements = [wall(1.0, 1.0), wall(2.0, 3.0), wall(3.0, 0.0)];
        for total in [0, 1, 2, 5, 7001] {
            let counts = allocate(&elements, total);
            assert_eq!(counts.iter().sum::<usize>(), total);
            assert_eq!(counts[2], 0);
            assert!((counts[1] as f64 - total as f64 * 6.0 / 7.0).abs() <= 1.0);
        }
        assert_eq!(allocate(&[], 5), Vec::<usize>::new());
    }

    #[test]
    fn a_wall_has_the_promised_scales_and_closes() {
        let light = Light::new(
            Air {
                towards_sun: Vec3::new(0.0, -1.0, 1.0),
                ..Air::for_weather(Weather::Clear)
            },
            vec![],
        );
        let cloud = emit(&[wall(8.0, 1.0)], 20_000, 0, 3, &light, &Focus::nowhere());
        let (mut ln_scales, mut flatness) = (vec![], vec![]);
        for (mean, scale) in cloud.means.iter().zip(&cloud.scales) {
            let mut sorted = *scale;
            sorted.sort_by(f32::total_cmp);
            flatness.push((sorted[1] * sorted[2]).sqrt() / sorted[0]);
            if (0.2..0.8).contains(&mean[2]) && (0.2..7.8).contains(&mean[0]) {
                ln_scales.extend([f64::from(sorted[1]).ln(), f64::from(sorted[2]).ln()]);
            }
        }
        assert!(flatness.iter().all(|ratio| (4.9..20.1).contains(ratio)));
        let mean = ln_scales.iter().sum::<f64>() / ln_scales.len() as f64;
        let sigma = (ln_scales.iter().map(|x| (x - mean).powi(2)).sum::<f64>()
            / ln_scales.len() as f64)
            .sqrt();
        assert!((0.5..0.7).contains(&sigma), "spread of ln scale {sigma}");
        let (mean, worst) = transmittance(&cloud);
        assert!(
            mean < 0.01 && worst < 0.2,
            "light passes: {mean} in the mean, {worst} at worst"
        );
    }

    /// Mean and most light that passes the wall at right angles, over 400 points away from its
    /// border.
    fn transmittance(cloud: &SplatCloud) -> (f32, f32) {
        let points = (0..40).flat_map(|i| {
            (0..10).map(move |j| (1.0 + 6.0 * i as f32 / 40.0, 0.3 + 0.04 * j as f32))
        });
        let passing = |(x, z): (f32, f32)| {
            let alpha = |splat: usize| {
                let [w, qx, qy, qz] = cloud.rotations[splat];
                let axes = Mat3::from_quat(Quat::from_xyzw(qx, qy, qz, w));
                // Marginalizing over the line of sight drops its row and column from the
                // covariance.
                let scaled = axes * Mat3::from_diagonal(Vec3::from_array(cloud.scales[splat]));
                let covariance = scaled * scaled.transpose();
                let (a, b, c) = (
                    covariance.x_axis.x,
                    covariance.x_axis.z,
                    covariance.z_axis.z,
                );
                let (dx, dz) = (x - cloud.means[splat][0], z - cloud.means[splat][2]);
                let q = (c * dx * dx - 2.0 * b * dx * dz + a * dz * dz) / (a * c - b * b);
                cloud.opacities[splat] * (-0.5 * q).exp()
            };
            (0..cloud.len())
                .map(|splat| 1.0 - alpha(splat))
                .product::<f32>()
        };
        points.map(passing).fold((0.0, 0.0), |(mean, worst), t| {
            (mean + t / 400.0, t.max(worst))
        })
    }
}
