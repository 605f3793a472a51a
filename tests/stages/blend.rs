//! `blend.comp`: segments of lists become pixels.

mod attributes;
mod finish;
mod median;
mod rounding;

use decouplegs::render::layout::{
    BlendItem, COARSE_PIXELS, CameraRecord, NO_PARTIAL, RequiredCounts,
};
use decouplegs::render::stages::{
    Blend, BlendPass, BlendVariant, IndirectArguments, ListedSplats, PartialResults, PixelEnd,
    Plan, ProjectVariant, Projected, RecordContents, Segments, Target,
};
use decouplegs::render::twins::color_code::COLOR_CODE_ERROR;
use decouplegs::render::twins::output::{
    Images, Pixel, coarse_tile_origin, pixel_offset, write_pixel,
};
use decouplegs::render::{OutputBuffers, Outputs, Plane, Planes, twins};
use decouplegs::scene::Rules;
use glam::Vec3;

use super::project::PLAIN;
use super::scenes::{ProjectedTwin, Scene, hard_world, rig};
use super::{
    UNTOUCHED, attribute_of_depth, counters, depth_and_range_of, identical, open, read_partials,
    room_for_partials, run, upload, within, write_partials,
};
use crate::device::Validated;
use rounding::{ListedSplat, PixelBounds};

const SKY: [f32; 3] = [0.2, 0.5, 1.3];
const OUTPUTS: Outputs = Outputs {
    color: decouplegs::render::ColorFormat::F32,
    planes: Planes::BESIDE_COLOR,
    contributions: false,
    exported: false,
};

/// Records whose instance is to be found in the image.
const VARIANT: ProjectVariant = ProjectVariant {
    sh_degree: 1,
    instances: true,
    ..PLAIN
};

/// Inputs that all items of a run share.
struct Case {
    scene: Scene,
    projected: ProjectedTwin,
    /// Records front to back, which every item takes a piece of. Most do not reach a given tile:
    /// masks must leave those out.
    records: Vec<u32>,
    items: Vec<BlendItem>,
    rules: Rules,
    end: PixelEnd,
}

/// Pixels of each item, as its threads keep them.
type Blended = Vec<Vec<Pixel>>;

impl Case {
    /// The records of two cameras of the rig, their opacities scaled by `faintness`, for the first
    /// `tiles` coarse tiles of each.
    fn new(gpu: &Validated, splats: usize, faintness: f32, rules: Rules) -> Self {
        let mut world = hard_world(splats, 21);
        world
            .splats
            .opacities
            .iter_mut()
            .for_each(|opacity| *opacity *= faintness);
        let scene = Scene::new(gpu, &world, &rig()[..2]);
        let listed = scene.listed(&rules);
        let projected = scene.projected(&listed, &rules, VARIANT, listed.records.len());
        let mut records: Vec<u32> = (0..projected.keys.len() as u32).collect();
        records.sort_by_key(|&record| projected.keys[record as usize]);
        let all = records.len() as u32;
        // Every coarse tile once; lengths around batches, and tiles that are cut.
        let mut partial = 0;
        let items = (0..scene.view.bins)
            .map(|bin| {
                let length = [all, 511, 512, 513, 1, 0, 33][bin as usize % 7].min(all);
                let first_pair = (bin * 97) % (all - length + 1);
                let slot = if bin % 3 == 0 { partial } else { NO_PARTIAL };
                partial += u32::from(bin % 3 == 0);
                BlendItem {
                    bin,
                    first_pair,
                    pairs: length,
                    partial: slot,
                    segment: 0,
                }
            })
            .collect();
        Self {
            scene,
            projected,
            records,
            items,
            rules,
            end: PixelEnd::for_rules(&rules),
        }
    }

    fn slots(&self) -> usize {
        self.items
            .iter()
            .filter(|item| item.partial != NO_PARTIAL)
            .count()
    }

    /// Pixels of each item; those of cut lists begun at `before`, by slot, if that is given.
    fn twin(&self, before: Option<&Blended>) -> Blended {
        let Self {
            scene,
            projected,
            records,
            items,
            rules,
            end,
        } = self;
        let blend = |item: &BlendItem| {
            let cameras = &scene.view.cameras;
            let before = before.map(|before| {
                before
                    .get(item.partial as usize)
                    .map_or(&[][..], Vec::as_slice)
            });
            if before.is_some_and(<[Pixel]>::is_empty) {
                return Vec::new(); // lists that are not cut are not finished
            }
            twins::blend(
                cameras,
                item,
                records,
                &projected.footprints,
                &projected.labels,
                rules,
                *end,
                before,
            )
        };
        items.iter().map(blend).collect()
    }

    fn bounds(&self, item: &BlendItem, before: Option<&[Pixel]>) -> Vec<PixelBounds> {
        let camera = &self.scene.view.cameras
            [twins::output::camera_of_bin(&self.scene.view.cameras, item.bin)];
        let origin = coarse_tile_origin(item.bin, camera);
        let list = &self.records[item.first_pair as usize..(item.first_pair + item.pairs) as usize];
        let list: Vec<_> = list
            .iter()
            .map(|&record| ListedSplat::new(&self.projected, record, camera, origin))
            .collect();
        (0..COARSE_PIXELS)
            .map(|index| {
                let before = before.map(|before| &before[index]);
                PixelBounds::new(&list, pixel_offset(index), &self.rules, before)
            })
            .collect()
    }

    /// The camera and position of a pixel of an item, if it lies in the image.
    fn pixel_in_images(&self, item: &BlendItem, index: usize) -> Option<(&CameraRecord, [u32; 2])> {
        let cameras = &self.scene.view.cameras;
        let camera = &cameras[twins::output::camera_of_bin(cameras, item.bin)];
        let [left, top] = coarse_tile_origin(item.bin, camera);
        let [x, y] = pixel_offset(index);
        let at = [left + x, top + y];
        (at[0] < camera.size_px[0] && at[1] < camera.size_px[1]).then_some((camera, at))
    }

    /// The kernel's images and partial results; where there is `before`, the images of the pass
    /// that finishes it.
    fn kernel(&self, gpu: &Validated, before: Option<&Blended>) -> (Images, Blended) {
        let (images, partials) = self.kernel_by(gpu, before, &OUTPUTS);
        (images, partials_by_slot(gpu, &partials))
    }

    /// Images and partial results with the planes of `asked`. Attributes are those of
    /// [`attribute_of_depth`], depths and ranges for medians those of [`depth_and_range_of`]. Where
    /// medians are asked for, what is finished of `before` is medians.
    fn kernel_by(
        &self,
        gpu: &Validated,
        before: Option<&Blended>,
        asked: &Outputs,
    ) -> (Images, PartialResults) {
        let Self {
            scene,
            projected,
            records,
            items,
            rules,
            end,
        } = self;
        let (count, slots) = (projected.keys.len(), self.slots());
        let required = RequiredCounts {
            items: items.len() as u32,
            ..RequiredCounts::default()
        };
        let counters = counters(gpu, required, &[(IndirectArguments::Blend, items.len())]);
        let plan = Plan::new(gpu, &room_for_partials(1), items.len() as u32).unwrap();
        gpu.write(&plan.items, 0, items).unwrap();
        let contents = RecordContents::for_outputs(asked);
        let on_device = Projected::new(gpu, count, 0, contents).unwrap();
        gpu.write(&on_device.footprints, 0, &projected.footprints)
            .unwrap();
        gpu.write(&on_device.labels, 0, &projected.labels).unwrap();
        let attributes = attributes_of_depths(projected, contents);
        gpu.write(&on_device.attributes, 0, &attributes).unwrap();
        let partials = PartialResults::new(gpu, &room_for_partials(slots), rules, asked).unwrap();
        let outputs = OutputBuffers::new(gpu, scene.view.pixels, 0, asked).unwrap();
        gpu.write(&outputs.planes, 0, &vec![UNTOUCHED; outputs.planes.len()])
            .unwrap();
        let records = upload(gpu, records);
        if contents.depths {
            let depths: Vec<_> = (0..count as u32).map(depth_and_range_of).collect();
            gpu.write(&on_device.depths, 0, &depths).unwrap();
        }
        let pass = match before {
            Some(_) if asked.planes.has_medians() => BlendPass::FinishMedians,
            Some(_) => BlendPass::Finish,
            None => BlendPass::Segments,
        };
        if let Some(before) = before {
            write_partials(gpu, &partials, &before.concat(), asked.planes);
            // Every fine tile has something to be finished.
            let unfinished = match pass {
                BlendPass::FinishMedians => &partials.medians_unfinished,
                _ => &partials.unfinished,
            };
            gpu.write(unfinished, 0, &vec![u32::MAX; before.len()])
                .unwrap();
        }
        let longest = items.iter().map(|item| item.pairs).max().unwrap();
        let variant = BlendVariant {
            end: *end,
            pass,
            item_pairs_max: longest,
        };
        let blend = Blend::new(gpu, rules, asked, variant).unwrap();
        let splats = ListedSplats {
            records: &records,
            projected: &on_device,
        };
        let segments = Segments {
            counters: &counters,
            plan: &plan,
            partials: &partials,
        };
        let target = Target {
            images: &outputs,
            sky: SKY,
        };
        run(gpu, |r| {
            blend.record(r, scene.views(), splats, segments, target);
        });
        let images = Images {
            images_f32: gpu.read(&outputs.images_f32).unwrap(),
            planes: gpu.read(&outputs.planes).unwrap(),
        };
        (images, partials)
    }

    /// Partial results of cut tiles, one after the other.
    fn check_partials(&self, kernel: &Blended, twin: &Blended) -> Result<(), String> {
        let mut report = Report::default();
        for (item, twin) in self
            .items
            .iter()
            .zip(twin)
            .filter(|(item, _)| item.partial != NO_PARTIAL)
        {
            for (index, ((bounds, kernel), twin)) in self
                .bounds(item, None)
                .iter()
                .zip(&kernel[item.partial as usize])
                .zip(twin)
                .enumerate()
            {
                // Beside the image nobody reads them.
                if self.pixel_in_images(item, index).is_none() {
                    continue;
                }
                let what = format!("pixel {index} of {item:?}");
                report.add(bounds, |bounds| {
                    let values = |pixel: &Pixel| {
                        [
                            pixel.color.x,
                            pixel.color.y,
                            pixel.color.z,
                            pixel.transmittance,
                            pixel.planes.weighted_depth,
                        ]
                    };
                    let [t, d] = [bounds.transmittance, bounds.weighted_depth];
                    let coded = COLOR_CODE_ERROR * twin.color.max_element();
                    let c = bounds.color + f64::from(coded);
                    let share = within(&what, &values(kernel), &values(twin), &[c, c, c, t, d])?;
                    bounds.check_instance(
                        &what,
                        kernel.planes.best_instance,
                        twin.planes.best_instance,
                    )?;
                    Ok(share)
                })?;
            }
        }
        report.finish("partial results")
    }

    /// Pixels of tiles of one segment.
    fn check_images(&self, kernel: &Images, twin: &Blended) -> Result<(), String> {
        let mut report = Report::default();
        for (item, twin) in self
            .items
            .iter()
            .zip(twin)
            .filter(|(item, _)| item.partial == NO_PARTIAL)
        {
            self.check_written(&mut report, (item, twin), None, kernel)?;
        }
        report.finish("images")
    }

    /// Pixels that end in segments whose pixels were `before`; no others are written.
    fn check_finished(
        &self,
        before: &Blended,
        kernel: &Images,
        twin: &Blended,
    ) -> Result<(), String> {
        let mut report = Report::default();
        for (item, twin) in self
            .items
            .iter()
            .zip(twin)
            .filter(|(item, _)| item.partial != NO_PARTIAL)
        {
            self.check_written(
                &mut report,
                (item, twin),
                Some(&before[item.partial as usize]),
                kernel,
            )?;
        }
        report.finish("finished pixels")
    }

    fn check_written(
        &self,
        report: &mut Report,
        (item, twin): (&BlendItem, &[Pixel]),
        before: Option<&[Pixel]>,
        kernel: &Images,
    ) -> Result<(), String> {
        for (index, (bounds, pixel)) in self.bounds(item, before).iter().zip(twin).enumerate() {
            let Some((camera, at)) = self.pixel_in_images(item, index) else {
                continue;
            };
            let target = (camera.first_pixel + at[1] * camera.size_px[0] + at[0]) as usize;
            let what = format!("column and row {at:?} of {item:?}");
            // Of a segment that is finished, the pixels that end in it.
            let is_written = before.is_none() || pixel.transmittance < 0.0;
            report.add(bounds, |bounds| {
                if !is_written {
                    let untouched = kernel.plane(Plane::Instance)[target] == UNTOUCHED;
                    return if untouched {
                        Ok(0.0)
                    } else {
                        Err(format!("{what}: written, though it does not end here"))
                    };
                }
                let written = written_alone(&Pixel {
                    transmittance: pixel.transmittance.abs(),
                    ..*pixel
                });
                let [r, g, b, a] = written.images_f32[0];
                let (depth, k) = (written.depth_m(0), kernel.images_f32[target]);
                let c = bounds.color + 1.3 * bounds.transmittance + 8.0 * super::ROUNDOFF;
                let t = bounds.transmittance + super::ROUNDOFF;
                let d = bounds.depth_m(depth, a);
                let share = within(
                    &what,
                    &[k[0], k[1], k[2], k[3], kernel.depth_m(target)],
                    &[r, g, b, a, depth],
                    &[c, c, c, t, d],
                )?;
                bounds.check_instance(
                    &what,
                    kernel.plane(Plane::Instance)[target],
                    written.plane(Plane::Instance)[0],
                )?;
                Ok(share)
            })?;
        }
        Ok(())
    }
}

/// Attributes of records, vector by vector: [`attribute_of_depth`].
fn attributes_of_depths(projected: &ProjectedTwin, contents: RecordContents) -> Vec<[f32; 4]> {
    let vectors = contents.attribute_vectors;
    let of_record = |record: usize| {
        let word = move |word| attribute_of_depth(word, projected.depth_m(record));
        (0..vectors).map(move |vector| std::array::from_fn(|part| word(4 * vector + part)))
    };
    (0..projected.keys.len()).flat_map(of_record).collect()
}

/// Images that the twin writes for `pixel` alone.
fn written_alone(pixel: &Pixel) -> Images {
    let mut image = Images::filled(1, 0);
    let camera = CameraRecord {
        size_px: [1, 1],
        ..bytemuck::Zeroable::zeroed()
    };
    write_pixel(&mut image, &camera, [0, 0], pixel, Vec3::from_array(SKY));
    image
}

/// Statistics of a comparison of pixels.
#[derive(Default)]
struct Report {
    pixels: usize,
    unsettled: usize,
    worst: f64,
}

impl Report {
    /// Compares one pixel, unless rounding decides whether a splat counts there.
    fn add(
        &mut self,
        bounds: &PixelBounds,
        compare: impl FnOnce(&PixelBounds) -> Result<f64, String>,
    ) -> Result<(), String> {
        self.pixels += 1;
        if bounds.unsettled {
            self.unsettled += 1;
        } else {
            self.worst = self.worst.max(compare(bounds)?);
        }
        Ok(())
    }

    fn finish(&self, what: &str) -> Result<(), String> {
        let Self {
            pixels,
            unsettled,
            worst,
        } = self;
        println!(
            "{what}: {pixels} pixels, {unsettled} left to rounding, the others use {worst:.3} of their bound at most"
        );
        if unsettled * 20 > *pixels {
            Err(format!(
                "{what}: {unsettled} of {pixels} pixels are left to rounding"
            ))
        } else {
            Ok(())
        }
    }
}

fn partials_by_slot(gpu: &Validated, partials: &PartialResults) -> Blended {
    read_partials(gpu, partials)
        .chunks_exact(COARSE_PIXELS)
        .map(<[Pixel]>::to_vec)
        .collect()
}

fn compare(splats: usize, faintness: f32, rules: Rules) {
    let gpu = open();
    compare_case(&gpu, &Case::new(&gpu, splats, faintness, rules));
}

fn compare_case(gpu: &Validated, case: &Case) {
    let (images, partials) = case.kernel(gpu, None);
    let twin = case.twin(None);
    println!("{} records, {} items", case.records.len(), case.items.len());
    case.check_images(&images, &twin).unwrap();
    case.check_partials(&partials, &twin).unwrap();
}

#[test]
fn opaque_splats_that_fill_pixels() {
    compare(1200, 1.0, Rules::DEFAULT);
}

#[test]
fn segments_of_one_batch() {
    // Subgroups take their shares from a counter there.
    let gpu = open();
    for (faintness, rules) in [
        (1.0, Rules::DEFAULT),
        (0.1, Rules::DEFAULT),
        (1.0, Rules::GSPLAT16),
        (1.0, Rules::NUREC),
    ] {
        let mut case = Case::new(&gpu, 1200, faintness, rules);
        case.items
            .iter_mut()
            .for_each(|item| item.pairs = item.pairs.min(128 - item.bin % 3));
        compare_case(&gpu, &case);
    }
}

#[test]
fn faint_splats_that_all_count() {
    compare(2000, 0.1, Rules::DEFAULT);
}

#[test]
fn stopping_before_the_splat_that_would_fill_a_pixel() {
    compare(1200, 1.0, Rules::GSPLAT15);
    compare(1200, 1.0, Rules::INRIA);
}

#[test]
fn stopping_behind_the_splat_that_fills_a_pixel() {
    compare(1200, 1.0, Rules::NUREC);
    compare(2000, 0.1, Rules::NUREC);
}

#[test]
fn every_pixel_is_written_once_and_no_other() {
    // Tiles that were cut leave their pixels to composite; edges of the images cut through coarse
    // tiles.
    let gpu = open();
    let case = Case::new(&gpu, 300, 1.0, Rules::DEFAULT);
    let (images, _) = case.kernel(&gpu, None);
    let mut expected = vec![true; case.scene.view.pixels];
    for item in case.items.iter().filter(|item| item.partial != NO_PARTIAL) {
        for (camera, at) in (0..COARSE_PIXELS).filter_map(|index| case.pixel_in_images(item, index))
        {
            expected[(camera.first_pixel + at[1] * camera.size_px[0] + at[0]) as usize] = false;
        }
    }
    let written: Vec<bool> = images
        .plane(Plane::Instance)
        .iter()
        .map(|&id| id != UNTOUCHED)
        .collect();
    identical("pixels written", &written, &expected).unwrap();
}

#[test]
fn one_changed_pixel_is_seen() {
    let gpu = open();
    let case = Case::new(&gpu, 300, 1.0, Rules::DEFAULT);
    let (images, partials) = case.kernel(&gpu, None);
    case.check_images(&images, &case.twin(None)).unwrap();
    case.check_partials(&partials, &case.twin(None)).unwrap();
    let index = |item: &BlendItem| {
        case.bounds(item, None)
            .iter()
            .position(|bounds| !bounds.unsettled)
            .unwrap()
    };
    for (i, item) in case.items.iter().enumerate().take(2) {
        let mut twin = case.twin(None);
        twin[i][index(item)].color.y += 0.001;
        let seen = if item.partial == NO_PARTIAL {
            case.check_images(&images, &twin)
        } else {
            case.check_partials(&partials, &twin)
        };
        assert!(seen.unwrap_err().contains("value 1"));
        twin[i][index(item)].color.y -= 0.001;
        twin[i][index(item)].planes.best_instance = 7;
        let seen = if item.partial == NO_PARTIAL {
            case.check_images(&images, &twin)
        } else {
            case.check_partials(&partials, &twin)
        };
        assert!(seen.unwrap_err().contains("instance"));
    }
}
