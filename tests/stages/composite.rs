//! `composite.comp`: segments are joined and pixels written.

use decouplegs::render::layout::{COARSE_PIXELS, Composite, FINE_TILES, RequiredCounts, View};
use decouplegs::render::stages::{
    CompositeSegments, IndirectArguments, PartialResults, PixelEnd, Plan, Projected,
    RecordContents, Segments, Target, Views,
};
use decouplegs::render::twins::Median;
use decouplegs::render::twins::color_code::COLOR_CODE_ERROR;
use decouplegs::render::twins::output::{
    Images, PIXEL_EMPTY, Pixel, camera_of_bin, coarse_tile_origin, pack_unorm_4x8, pixel_offset,
    pixels_of_tile, write_pixel,
};
use decouplegs::render::{ColorFormat, OutputBuffers, Outputs, Plane, Planes, twins};
use decouplegs::scene::Rules;
use glam::{DVec3, Vec3};

use super::attributes::{check_means, check_partials, outputs as all_outputs};
use super::scenes::rig;
use super::{
    ROUNDOFF, Random, TILE_PIXELS, UNTOUCHED, coded, counters, depth_and_range_of, identical, open,
    read_partials, room_for_partials, run, upload, within, write_partials,
};
use crate::device::Validated;
use decouplegs::render::twins::planes::PlaneSums;

const SKY: [f32; 3] = [0.2, 0.5, 1.3];

/// Records that medians are of.
const RECORDS: u32 = 1000;

/// Workgroups that share the pixels of a coarse tile.
const COMPOSITE_GROUPS: usize = COARSE_PIXELS / 256;

/// Partial results of cut coarse tiles.
struct Case {
    view: View,
    composites: Vec<Composite>,
    partials: Vec<Pixel>,
}

impl Case {
    /// Every second coarse tile of two cameras, cut into 2 to 100 segments of random pixels.
    fn new(seed: u64) -> Self {
        let view = View::new(&rig()[..2], DVec3::ZERO, 1.0).unwrap();
        let mut random = Random(seed);
        let mut first_partial = 0;
        let mut composites = Vec::new();
        for bin in (0..view.bins).step_by(2) {
            let partials = 2 + if bin % 8 == 0 {
                random.below(99)
            } else {
                random.below(4)
            };
            for part in 0..twins::composite_runs(partials) {
                composites.push(Composite {
                    bin,
                    first_partial,
                    partials,
                    part,
                });
            }
            first_partial += partials;
        }
        let mut partials: Vec<Pixel> = (0..first_partial as usize * COARSE_PIXELS)
            .map(|_| random_pixel(&mut random))
            .collect();
        for pixels in partials.chunks_exact_mut(COARSE_PIXELS) {
            // Of the fine tiles, some have nothing drawn in them.
            for tile in (0..FINE_TILES).filter(|_| random.below(3) == 0) {
                pixels_of_tile(tile).for_each(|index| pixels[index] = PIXEL_EMPTY);
            }
        }
        Self {
            view,
            composites,
            partials,
        }
    }

    /// The cut coarse tiles, each once.
    fn tiles(&self) -> impl Iterator<Item = &Composite> {
        (self.composites.iter()).filter(|composite| composite.part == 0)
    }

    /// Output of the kernel, with colors in bytes if requested.
    fn kernel(&self, gpu: &Validated, color: ColorFormat) -> (Images, Vec<u32>) {
        let outputs = Outputs {
            color,
            planes: Planes::BESIDE_COLOR,
            ..Outputs::default()
        };
        let (images, bytes, _) = self.kernel_by(gpu, PixelEnd::Full, outputs);
        (images, bytes)
    }

    /// Output of the kernel for pixels that end at `end`, and the partial results that it leaves.
    fn kernel_by(
        &self,
        gpu: &Validated,
        end: PixelEnd,
        outputs: Outputs,
    ) -> (Images, Vec<u32>, PartialResults) {
        let Self {
            view,
            composites,
            partials,
        } = self;
        let required = RequiredCounts {
            composites: composites.len() as u32,
            ..RequiredCounts::default()
        };
        let counters = counters(
            gpu,
            required,
            &[(
                IndirectArguments::Composite,
                composites.len() * COMPOSITE_GROUPS,
            )],
        );
        let room = room_for_partials(partials.len() / COARSE_PIXELS);
        let plan = Plan::new(gpu, &room, view.bins).unwrap();
        gpu.write(&plan.composites, 0, composites).unwrap();
        // Rules by which pixels are finished.
        let rules = match end {
            PixelEnd::Full => Rules::DEFAULT,
            PixelEnd::Exclusive => Rules::GSPLAT15,
            PixelEnd::Inclusive => Rules::NUREC,
        };
        let on_device = PartialResults::new(
            gpu,
            &room_for_partials(partials.len() / COARSE_PIXELS),
            &rules,
            &outputs,
        )
        .unwrap();
        gpu.write(
            &on_device.unfinished,
            0,
            &vec![0; on_device.unfinished.len()],
        )
        .unwrap();
        write_partials(gpu, &on_device, partials, outputs.planes);
        gpu.write(
            &on_device.transmittances,
            0,
            &largest_transmittances(partials),
        )
        .unwrap();
        let images = OutputBuffers::new(gpu, view.pixels, 0, &outputs).unwrap();
        gpu.write(&images.planes, 0, &vec![UNTOUCHED; images.planes.len()])
            .unwrap();
        let (cameras, lenses) = (upload(gpu, &view.cameras), upload(gpu, &view.lenses));
        let views = Views {
            cameras: &cameras,
            lenses: &lenses,
            count: view.cameras.len(),
        };
        let segments = Segments {
            counters: &counters,
            plan: &plan,
            partials: &on_device,
        };
        let target = Target {
            images: &images,
            sky: SKY,
        };
        let contents = RecordContents::for_outputs(&outputs);
        let projected = Projected::new(gpu, RECORDS as usize, 0, contents).unwrap();
        if contents.depths {
            let depths: Vec<_> = (0..RECORDS).map(depth_and_range_of).collect();
            gpu.write(&projected.depths, 0, &depths).unwrap();
        }
        gpu.write(
            &on_device.medians_unfinished,
            0,
            &vec![0; on_device.medians_unfinished.len()],
        )
        .unwrap();
        let composite = CompositeSegments::new(gpu, end, &outputs).unwrap();
        run(gpu, |r| {
            composite.record(r, views, &projected, segments, target);
        });
        let floats = Images {
            images_f32: gpu.read(&images.images_f32).unwrap(),
            planes: gpu.read(&images.planes).unwrap(),
        };
        (floats, gpu.read(&images.images_u8).unwrap(), on_device)
    }

    /// The twin's images, and for each pixel how many segments it was joined from: 0 where it was
    /// not written.
    fn twin(&self) -> (Images, Vec<u32>) {
        self.twin_by(PixelEnd::Full, false)
    }

    fn twin_by(&self, end: PixelEnd, counts: bool) -> (Images, Vec<u32>) {
        let pixels = self.view.pixels;
        let mut images = Images::filled(pixels, UNTOUCHED);
        let mut segments = vec![0; pixels];
        for composite in self.tiles() {
            let camera = &self.view.cameras[camera_of_bin(&self.view.cameras, composite.bin)];
            let origin = coarse_tile_origin(composite.bin, camera);
            for (index, pixel) in twins::composite(composite, &self.partials, end, counts)
                .0
                .iter()
                .enumerate()
            {
                let [x, y] = pixel_offset(index);
                let at = [origin[0] + x, origin[1] + y];
                write_pixel(&mut images, camera, at, pixel, Vec3::from_array(SKY));
                if at[0] < camera.size_px[0] && at[1] < camera.size_px[1] {
                    segments[(camera.first_pixel + at[1] * camera.size_px[0] + at[0]) as usize] =
                        composite.partials;
                }
            }
        }
        (images, segments)
    }

    /// The fine tiles that are to be finished in each segment, and their pixels as they are before
    /// it.
    fn check_unfinished(
        &self,
        gpu: &Validated,
        left: &PartialResults,
        end: PixelEnd,
        counts: bool,
    ) -> Result<(), String> {
        let mut tiles = vec![0u32; left.unfinished.len()];
        let left_pixels = read_partials(gpu, left);
        let mut found = 0;
        for composite in self.tiles() {
            let camera = &self.view.cameras[camera_of_bin(&self.view.cameras, composite.bin)];
            let origin = coarse_tile_origin(composite.bin, camera);
            for unfinished in twins::composite(composite, &self.partials, end, counts).1 {
                let twins::Unfinished {
                    slot,
                    index,
                    before,
                } = unfinished;
                let [x, y] = pixel_offset(index);
                if origin[0] + x >= camera.size_px[0] || origin[1] + y >= camera.size_px[1] {
                    continue;
                }
                tiles[slot] |= 1 << (y / 8 * 8 + x / 8);
                let at = slot * COARSE_PIXELS + index;
                let relative =
                    8.0 * ROUNDOFF * f64::from(slot as u32 - composite.first_partial + 2);
                let values = |pixel: &Pixel| {
                    let Vec3 {
                        x: red,
                        y: green,
                        z: blue,
                    } = pixel.color;
                    let depth = pixel.planes.weighted_depth;
                    [red, green, blue, pixel.transmittance, depth]
                };
                let expected = values(&before);
                let mut bounds = expected.map(|value| relative * f64::from(value.abs()));
                // Colors are rounded to a code.
                let rounding = f64::from(COLOR_CODE_ERROR * before.color.max_element());
                bounds[..3].iter_mut().for_each(|bound| *bound += rounding);
                within(
                    &format!("pixel {index} of slot {slot}"),
                    &values(&left_pixels[at]),
                    &expected,
                    &bounds,
                )?;
                identical(
                    "instances",
                    &[left_pixels[at].planes.best_instance],
                    &[before.planes.best_instance],
                )?;
                found += 1;
            }
        }
        println!("{found} pixels are to be finished");
        identical(
            "fine tiles to be finished",
            &gpu.read(&left.unfinished).unwrap(),
            &tiles,
        )
    }

    /// Every segment adds a product to a sum of positive terms: 4 roundings of the whole a segment
    /// at most, on both sides. A depth is a quotient by alpha, whose error is relative to 1.
    fn check(kernel: &Images, twin: &Images, segments: &[u32]) -> Result<(), String> {
        let mut worst = 0.0f64;
        let instances = [kernel, twin].map(|images| images.plane(Plane::Instance));
        identical("instances", instances[0], instances[1])?;
        for (index, &count) in segments.iter().enumerate().filter(|(_, count)| **count > 0) {
            let relative = 8.0 * ROUNDOFF * f64::from(count + 2);
            let (k, t) = (kernel.images_f32[index], twin.images_f32[index]);
            let colors = [0, 1, 2].map(|channel| relative * f64::from(t[channel]));
            let depth = if t[3] > 0.0 {
                2.0 * relative * f64::from(twin.depth_m(index)) / f64::from(t[3])
            } else {
                0.0
            };
            let bounds = [colors[0], colors[1], colors[2], relative, depth];
            let what = format!("pixel {index}");
            let [k, t] = [(k, kernel), (t, twin)]
                .map(|(value, side)| [value[0], value[1], value[2], value[3], side.depth_m(index)]);
            worst = worst.max(within(&what, &k, &t, &bounds)?);
        }
        println!("{worst:.3} of the bound");
        Ok(())
    }
}

/// Bits of the largest transmittance of each segment and fine tile, as blend leaves them: those of
/// every third segment are not known.
fn largest_transmittances(partials: &[Pixel]) -> Vec<[u32; FINE_TILES]> {
    let largest = |pixels: &[Pixel], tile: usize| {
        let left = pixels_of_tile(tile).map(|index| pixels[index].transmittance.max(0.0));
        left.fold(f32::MIN_POSITIVE, f32::max).to_bits()
    };
    let slots = partials.chunks_exact(COARSE_PIXELS).enumerate();
    slots
        .map(|(slot, pixels)| {
            std::array::from_fn(|tile| match slot % 3 {
                0 => 0,
                _ => largest(pixels, tile),
            })
        })
        .collect()
}

fn random_pixel(random: &mut Random) -> Pixel {
    // One in five saw nothing; transmittance is at most one, and the depth a mean times alpha.
    if random.below(5) == 0 {
        return PIXEL_EMPTY;
    }
    let transmittance = if random.below(3) == 0 {
        random.across_scales(1e-5, 1.0)
    } else {
        random.between(0.5, 0.996)
    };
    let alpha = 1.0 - transmittance;
    Pixel {
        color: coded(Vec3::from_array(std::array::from_fn(|_| {
            alpha * random.between(0.0, 1.0)
        }))),
        transmittance,
        planes: PlaneSums {
            weighted_depth: alpha * random.between(0.5, 100.0),
            best_weight: alpha * random.between(0.1, 1.0),
            best_instance: random.below(5),
        },
        median: random.below(RECORDS),
    }
}

#[test]
fn segments_are_joined_front_to_back() {
    let gpu = open();
    let case = Case::new(1);
    let (twin, segments) = case.twin();
    Case::check(&case.kernel(&gpu, ColorFormat::F32).0, &twin, &segments).unwrap();
}

#[test]
fn attributes_are_joined_as_depth_is() {
    let gpu = open();
    for end in [PixelEnd::Full, PixelEnd::Exclusive] {
        let case = Case::new(5);
        let (images, _, left) = case.kernel_by(&gpu, end, all_outputs());
        let written = check_means(&images.planes, case.view.pixels).unwrap();
        let sums = check_partials(&gpu, &left).unwrap();
        assert!(written > 1000 && sums > 1000, "{written}, {sums}");
    }
}

#[test]
fn bytes_are_rounded() {
    let gpu = open();
    let case = Case::new(2);
    let (twin, segments) = case.twin();
    let bytes = case.kernel(&gpu, ColorFormat::U8).1;
    for (index, value) in twin
        .images_f32
        .iter()
        .enumerate()
        .filter(|(index, _)| segments[*index] > 0)
    {
        let packed = pack_unorm_4x8(*value).to_le_bytes();
        for (channel, (&a, &b)) in bytes[index].to_le_bytes().iter().zip(&packed).enumerate() {
            // Half-way values may be rounded either way.
            let half_way =
                ((f64::from(value[channel].clamp(0.0, 1.0)) * 255.0).fract() - 0.5).abs() < 0.01;
            assert!(
                a == b || (half_way && a.abs_diff(b) == 1),
                "pixel {index}, channel {channel}: {a}, the twin has {b}"
            );
        }
    }
}

#[test]
fn segments_in_another_order_are_seen() {
    let gpu = open();
    let mut case = Case::new(3);
    let (kernel, _) = case.kernel(&gpu, ColorFormat::F32);
    let (twin, segments) = case.twin();
    Case::check(&kernel, &twin, &segments).unwrap();
    let first = case.composites[0].first_partial as usize * COARSE_PIXELS;
    for index in 0..COARSE_PIXELS {
        case.partials
            .swap(first + index, first + COARSE_PIXELS + index);
    }
    let (twin, segments) = case.twin();
    assert!(Case::check(&kernel, &twin, &segments).is_err());
    let mut kernel = kernel;
    let pixels = kernel.images_f32.len();
    kernel.planes[pixels..].copy_from_slice(twin.plane(Plane::Instance));
    assert!(
        Case::check(&kernel, &twin, &segments)
            .unwrap_err()
            .starts_with("pixel")
    );
}

/// The state before a segment is stored for pixels that end in it. Where weights are counted, it is
/// stored in every segment but the first.
#[test]
fn pixels_are_left_to_be_finished_where_they_end() {
    let gpu = open();
    for (end, counts) in [
        (PixelEnd::Exclusive, false),
        (PixelEnd::Exclusive, true),
        (PixelEnd::Inclusive, false),
        (PixelEnd::Inclusive, true),
        (PixelEnd::Full, true),
    ] {
        let stops = end != PixelEnd::Full;
        let mut case = Case::new(4);
        let mut random = Random(6);
        for composite in case
            .composites
            .iter()
            .filter(|composite| composite.part == 0)
        {
            // Some pixels end in the first segment, which tells by the sign.
            let first = composite.first_partial as usize * COARSE_PIXELS;
            for pixel in &mut case.partials[first..first + COARSE_PIXELS] {
                pixel.transmittance *= if stops && random.below(8) == 0 {
                    -1.0
                } else {
                    1.0
                };
            }
        }
        let outputs = Outputs {
            planes: Planes::BESIDE_COLOR,
            contributions: counts,
            ..Outputs::default()
        };
        let (images, _, left) = case.kernel_by(&gpu, end, outputs);
        let (twin, segments) = case.twin_by(end, counts);
        Case::check(&images, &twin, &segments).unwrap();
        case.check_unfinished(&gpu, &left, end, counts).unwrap();
        assert!(
            case.check_unfinished(&gpu, &left, end, !counts).is_err(),
            "other pixels would be seen"
        );
    }
}

/// Medians that need nothing before their segment are written, the others left to be finished.
#[test]
fn medians_are_found_in_their_segment() {
    let gpu = open();
    let mut case = Case::new(7);
    let outputs = Outputs {
        planes: [
            Plane::Depth,
            Plane::Instance,
            Plane::DepthMedian,
            Plane::RangeMedian,
        ]
        .into(),
        ..Outputs::default()
    };
    let (images, _, left) = case.kernel_by(&gpu, PixelEnd::Full, outputs);
    let counts = case.check_medians(&gpu, &images, &left).unwrap();
    println!("without median, written, to be finished: {counts:?}");
    assert!(counts.iter().all(|&count| count > 1000));
    // Records and transmittances of others are seen.
    for pixel in &mut case.partials {
        pixel.median += u32::from(*pixel != PIXEL_EMPTY);
    }
    assert!(case.check_medians(&gpu, &images, &left).is_err());
    for pixel in &mut case.partials {
        pixel.median -= u32::from(*pixel != PIXEL_EMPTY);
        pixel.transmittance *= 0.99;
    }
    assert!(case.check_medians(&gpu, &images, &left).is_err());
}

impl Case {
    /// Compares medians with those of the twin: returns how many pixels have none, have one, and
    /// are to be finished.
    fn check_medians(
        &self,
        gpu: &Validated,
        images: &Images,
        left: &PartialResults,
    ) -> Result<[usize; 3], String> {
        let pixels = self.view.pixels;
        let tiles = gpu.read(&left.tiles).unwrap();
        let medians = gpu.read(&left.medians).unwrap();
        let mut unfinished = vec![0u32; tiles.len()];
        let mut counts = [0; 3];
        for composite in self.tiles() {
            let camera = &self.view.cameras[camera_of_bin(&self.view.cameras, composite.bin)];
            let origin = coarse_tile_origin(composite.bin, camera);
            let found = twins::medians(composite, &self.partials);
            for (index, median) in found.into_iter().enumerate() {
                let [x, y] = pixel_offset(index);
                let at = [origin[0] + x, origin[1] + y];
                if at[0] >= camera.size_px[0] || at[1] >= camera.size_px[1] {
                    continue;
                }
                let target = (camera.first_pixel + at[1] * camera.size_px[0] + at[0]) as usize;
                let written = [0, 1].map(|plane| images.planes[(2 + plane) * pixels + target]);
                let expected = match median {
                    Median::None => [0; 2],
                    Median::Record(record) => depth_and_range_of(record).map(f32::to_bits),
                    Median::Unfinished(..) => [UNTOUCHED; 2],
                };
                identical(&format!("median of pixel {target}"), &written, &expected)?;
                counts[match median {
                    Median::None => 0,
                    Median::Record(_) => 1,
                    Median::Unfinished(..) => 2,
                }] += 1;
                if let Median::Unfinished(slot, before) = median {
                    let tile = (y / 8 * 8 + x / 8) as usize;
                    unfinished[slot] |= 1 << tile;
                    let held = tiles[slot];
                    let earlier = (held.tiles & ((1 << tile) - 1)).count_ones();
                    let place = pixels_of_tile(tile)
                        .position(|pixel| pixel == index)
                        .unwrap();
                    let word = medians[(held.first + earlier) as usize * TILE_PIXELS + place];
                    identical("before the segment", &[word], &[(-before).to_bits()])?;
                }
            }
        }
        let found = gpu.read(&left.medians_unfinished).unwrap();
        identical("tiles with medians to be finished", &found, &unfinished)?;
        Ok(counts)
    }
}
