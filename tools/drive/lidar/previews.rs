//! Previews of sweeps.

use std::path::{Path, PathBuf};

use anyhow::Result;
use decouplegs::asset::LoadedScene;
use decouplegs::render::rendered_image::{Image, ImageFileFormat, distance_color};
use decouplegs::render::{FrameSplats, Renderer};
use decouplegs::scene::lidar::PointFrame;
use decouplegs::scene::{Camera, LidarSweep};
use decouplegs::session::World;

use crate::arguments::write_image;

/// Kinds of images of sweeps, as files are named.
pub const ABOVE: &str = "above";
pub const RANGES: &str = "ranges";

/// Side of the view from above, pixels, and its side in the world, meters.
const ABOVE_PX: u32 = 900;
const ABOVE_M: f64 = 100.0;

/// Least height of an image of ranges, pixels: rows of sensors with few are repeated.
const RANGES_HEIGHT_PX: usize = 160;

/// Writes previews of sweeps.
pub struct Previews<'a> {
    renderer: Renderer,
    world: World,
    loaded: &'a LoadedScene,
}

impl<'a> Previews<'a> {
    /// Previews of a scene, whose images `renderer` draws.
    pub fn new(renderer: Renderer, world: World, loaded: &'a LoadedScene) -> Self {
        Self {
            renderer,
            world,
            loaded,
        }
    }

    /// Writes the previews of a sweep that began at `time_s`; returns their paths.
    pub fn write(&mut self, stem: &Path, sweep: &LidarSweep, time_s: f64) -> Result<Vec<PathBuf>> {
        let mut previews = vec![
            (ABOVE.to_owned(), from_above(sweep)),
            (RANGES.to_owned(), ranges(sweep)),
        ];
        let end_s = time_s + sweep.lidar.model.sweep_s;
        let cameras = self.loaded.rig.driving(&self.loaded.ego, end_s);
        self.world.set_time(end_s);
        let agents = self.world.frame_agents();
        // One by one: the images of a whole rig may be more than a buffer holds.
        for camera in &cameras {
            let render = |splats: FrameSplats<'_>| {
                self.renderer.render(splats, std::slice::from_ref(camera))
            };
            self.world.scene().lend(&agents, render)?;
            for image in self.renderer.read_images()? {
                previews.push((camera.name.clone(), over_image(sweep, camera, image)));
            }
        }
        let write = |(name, image): (String, Image)| {
            let path = stem.with_added_extension(format!("{name}.png"));
            write_image(&path, &image, ImageFileFormat::Png)?;
            Ok(path)
        };
        previews.into_iter().map(write).collect()
    }
}

fn set(image: &mut Image, column: i64, row: i64, rgb: [f32; 3]) {
    let (width, height) = (i64::from(image.width), i64::from(image.height));
    if (0..width).contains(&column) && (0..height).contains(&row) {
        image.rgb[(row * width + column) as usize] = rgb;
    }
}

/// Points from above, the sensor in the middle and ahead at the top, brighter with intensity.
pub fn from_above(sweep: &LidarSweep) -> Image {
    let mut image = Image::filled(ABOVE_PX, ABOVE_PX, [0.04; 3]);
    let px_per_m = f64::from(ABOVE_PX) / ABOVE_M;
    let middle = 0.5 * f64::from(ABOVE_PX);
    for point in sweep.points(PointFrame::EgoAt(sweep.lidar.model.sweep_s)) {
        let column = (middle - px_per_m * point.position_m.y).floor() as i64;
        let row = (middle - px_per_m * point.position_m.x).floor() as i64;
        set(
            &mut image,
            column,
            row,
            distance_color(point.measured.range_m),
        );
    }
    image
}

/// Ranges by column and row, the first column at the left.
pub fn ranges(sweep: &LidarSweep) -> Image {
    let model = &sweep.lidar.model;
    let (rows, columns) = (model.rings(), model.columns());
    let repeats = RANGES_HEIGHT_PX.div_ceil(rows);
    let mut image = Image::filled(columns as u32, (rows * repeats) as u32, [0.0; 3]);
    for found in &sweep.returns {
        let beam = &sweep.beams[found.beam as usize];
        for repeat in 0..repeats {
            let row = usize::from(beam.ring) * repeats + repeat;
            let color = distance_color(found.range_m);
            set(&mut image, i64::from(beam.column), row as i64, color);
        }
    }
    image
}

/// Points over the image of a camera, 3 x 3 pixels each.
fn over_image(sweep: &LidarSweep, camera: &Camera, mut image: Image) -> Image {
    let camera_from_world = camera.world_from_camera.inverse();
    for point in sweep.points(PointFrame::World) {
        let seen = camera_from_world.transform(point.position_m);
        let Some(place) = camera.intrinsics.project(seen).filter(|_| seen.z > 0.0) else {
            continue;
        };
        let color = distance_color(point.measured.range_m);
        for (x, y) in (-1..=1).flat_map(|x| (-1..=1).map(move |y| (x, y))) {
            let (column, row) = (place.x.floor() as i64 + x, place.y.floor() as i64 + y);
            set(&mut image, column, row, color);
        }
    }
    image
}
