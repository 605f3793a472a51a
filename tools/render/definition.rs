//! Images by the f64 definition, and images that are exposed for a time.

use std::borrow::Cow;

use anyhow::Result;
use decouplegs_asset::memory;
use decouplegs_render::reference::geometry::depth_median;
use decouplegs_render::reference::rays::{RayRules, render_rays};
use decouplegs_render::rendered_image::Image;
use decouplegs_render::rendered_image::exposure::{ExposureSum, sub_exposures_s};
use decouplegs_render::{Plane, PlaneValues, reference};
use decouplegs_scene::Camera;

use super::{Arguments, ImageWriter};
use crate::progress;
use crate::scene_source::DrawInput;

/// About the memory that the reference takes for each pixel.
const REFERENCE_PIXEL_BYTES: u64 = 96;

/// Renders every camera by the f64 definition, on the CPU.
pub fn render_by_definition(
    input: &DrawInput,
    arguments: &Arguments,
    writer: &mut ImageWriter,
) -> Result<()> {
    let layer = arguments.layer.into();
    let bar = progress::bar("reference", input.cameras.len());
    input.loaded.check_baked()?;
    let most = input
        .cameras
        .iter()
        .map(|camera| camera.intrinsics.pixels())
        .max()
        .unwrap_or(0);
    memory::require_product(
        "a reference image of this size",
        &[most],
        REFERENCE_PIXEL_BYTES,
    )?;
    let splat_scene = input.loaded.baked_layer(input.time_s, layer);
    let world_at = |later_s: f64| match later_s {
        0.0 => Cow::Borrowed(&splat_scene),
        _ => Cow::Owned(input.loaded.baked_layer(input.time_s + later_s, layer)),
    };
    for camera in input.cameras.chunks(1) {
        let images = exposed(input, arguments, camera, |later_s, cameras| {
            let world_at = |row_s: f64| world_at(later_s + row_s);
            let render = |camera: &Camera| match arguments.along_rays {
                true => render_rays(&world_at(0.0), camera, &RayRules::NUREC).to_image(),
                false => reference::render_moving(&world_at, camera, &splat_scene.rules).to_image(),
            };
            Ok(cameras.iter().map(render).collect())
        })?;
        for (camera, mut image) in camera.iter().zip(images) {
            if writer.boxes.is_some() {
                let depths_m = depth_median(&splat_scene, &camera.at_rest(0.0), &splat_scene.rules);
                (image.planes).insert(Plane::DepthMedian, PlaneValues::F32(depths_m));
            }
            writer.add(camera, image)?;
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok(())
}

/// Images of `cameras`, blurred if `arguments` ask for it. `draw` gives sharp images at a time,
/// seconds after that of the scene, of cameras that stand where they are then.
pub fn exposed(
    input: &DrawInput,
    arguments: &Arguments,
    cameras: &[Camera],
    mut draw: impl FnMut(f64, &[Camera]) -> Result<Vec<Image>>,
) -> Result<Vec<Image>> {
    let sharp = draw(0.0, cameras)?;
    let Some(exposure_s) = arguments.exposure else {
        return Ok(sharp);
    };
    let sum = |camera: &Camera| {
        let photometry = input.loaded.splat_scene.photometry_of(&camera.intrinsics);
        ExposureSum::new(camera.intrinsics.pixels() as usize, photometry.curve)
    };
    let mut sums: Vec<ExposureSum> = cameras.iter().map(sum).collect();
    for later_s in sub_exposures_s(exposure_s, arguments.sub_exposures) {
        let later: Vec<Camera> = cameras.iter().map(|camera| camera.later(later_s)).collect();
        for (sum, image) in sums.iter_mut().zip(draw(later_s, &later)?) {
            sum.add(&image);
        }
    }
    let images = sums.into_iter().zip(sharp);
    Ok(images.map(|(sum, sharp)| sum.applied(sharp)).collect())
}
