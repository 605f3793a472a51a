//! Images of an episode that are kept: all of them, or the few that a report shows.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::ValueEnum;
use decouplegs::episode::{EpisodeError, EpisodeObserver};
use decouplegs::logs::EpisodeLog;
use decouplegs::planner::{Frame, Reading, images, sweeps};
use decouplegs::render::Image;
use decouplegs::render::rendered_image::ImageFileFormat;
use decouplegs::scene::episode::{EpisodeEnd, EpisodeHead, EpisodeStep, EpisodeTick};
use decouplegs::scene::lidar::PointFrame;
use decouplegs::scene::{Lidar, LidarSweep};
use decouplegs_recording::point_cloud::{PointFormat, write_points};

use crate::arguments::write_image;
use crate::lidar::previews::{ABOVE, RANGES, from_above, ranges};
use crate::seen::SeenWatch;

/// Images to keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Images {
    /// None
    None,
    /// Images of the first camera and LiDAR: the first, the last and up to eight between, for the
    /// report
    Key,
    /// All images of all cameras, all sweeps as point clouds (.pcd), and the key images
    All,
}

/// The images of one episode.
pub struct ImageWriter {
    folder: PathBuf,
    keeps: Images,
    /// Images of the first camera at steps that `every` divides.
    keys: Vec<Key>,
    every: u32,
    /// Last image: any step may be the last, so this is overwritten in every step.
    last: Option<Key>,
}

/// Image of one camera at a step, four bytes per pixel, and the sweep of one LiDAR.
#[derive(Clone)]
struct Key {
    step: u32,
    size_px: [u32; 2],
    rgba: Vec<u8>,
    sweep: Option<LidarSweep>,
}

/// Distance of key frames at first, steps. It is doubled when there are too many of them.
const KEY_EVERY: u32 = 2;
const KEYS_MAX: usize = 9;

/// Name of the image of a sweep. It does not end in a step, as images of cameras do.
fn sweep_name(step: u32, kind: &str) -> String {
    format!("sweep_{step:04}.{kind}.png")
}

impl ImageWriter {
    /// True if it keeps images.
    pub fn keeps_images(&self) -> bool {
        self.keeps != Images::None
    }

    pub fn new(folder: PathBuf, keeps: Images) -> Self {
        Self {
            folder,
            keeps,
            keys: Vec::new(),
            every: KEY_EVERY,
            last: None,
        }
    }

    pub fn add(&mut self, step: u32, readings: &[Reading]) -> Result<()> {
        if self.keeps == Images::All {
            for sweep in sweeps(readings) {
                self.write_points(step, sweep)?;
            }
            for frame in images(readings) {
                self.write(
                    &format!("{}_{step:04}.png", frame.camera.name),
                    &image(&frame),
                )?;
            }
        }
        if let (Some(frame), true) = (images(readings).next(), self.keeps != Images::None) {
            let mut rgba = self.last.take().map(|last| last.rgba).unwrap_or_default();
            rgba.clear();
            rgba.extend_from_slice(frame.rgba);
            let lens = &frame.camera.intrinsics;
            let key = Key {
                step,
                size_px: [lens.width_px, lens.height_px],
                rgba,
                sweep: sweeps(readings).next().cloned(),
            };
            if step.is_multiple_of(self.every) {
                self.keys.push(key.clone());
            }
            if self.keys.len() > KEYS_MAX {
                self.every *= 2;
                self.keys.retain(|key| key.step.is_multiple_of(self.every));
            }
            self.last = Some(key);
        }
        Ok(())
    }

    /// Writes the points of a sweep, in the frame of the ego at the step.
    fn write_points(&self, step: u32, sweep: &LidarSweep) -> Result<()> {
        self.make_folder()?;
        let Lidar { name, model, .. } = &sweep.lidar;
        // Names of models may be paths.
        let name = Path::new(name).file_stem().unwrap_or_default();
        let path = self
            .folder
            .join(format!("{}_{step:04}.pcd", name.display()));
        let points = sweep.points(PointFrame::EgoAt(model.sweep_s));
        let comments = [format!(
            "sensor {}, frame of the ego at the end of the sweep",
            model.name
        )];
        write_points(&path, PointFormat::Pcd, &points, model.rings(), &comments)?;
        Ok(())
    }

    /// Writes the key frames.
    pub fn close(&mut self) -> Result<()> {
        let mut keys = std::mem::take(&mut self.keys);
        keys.extend(
            self.last
                .take()
                .filter(|last| keys.last().is_none_or(|key| key.step != last.step)),
        );
        for Key {
            step,
            size_px,
            rgba,
            sweep,
        } in keys
        {
            self.write(&format!("key_{step:04}.png"), &image_of(size_px, &rgba))?;
            if let Some(sweep) = sweep {
                self.write(&sweep_name(step, ABOVE), &from_above(&sweep))?;
                self.write(&sweep_name(step, RANGES), &ranges(&sweep))?;
            }
        }
        Ok(())
    }

    fn write(&self, name: &str, image: &Image) -> Result<()> {
        self.make_folder()?;
        write_image(&self.folder.join(name), image, ImageFileFormat::Png)
    }

    fn make_folder(&self) -> Result<()> {
        fs::create_dir_all(&self.folder)
            .with_context(|| format!("{} cannot be made", self.folder.display()))
    }
}

/// A frame as an image that can be written.
pub fn image(frame: &Frame) -> Image {
    let lens = &frame.camera.intrinsics;
    image_of([lens.width_px, lens.height_px], frame.rgba)
}

fn image_of([width_px, height_px]: [u32; 2], rgba: &[u8]) -> Image {
    let pixels = rgba.chunks_exact(4);
    let share = |byte: u8| f32::from(byte) / 255.0;
    Image {
        rgb: pixels
            .clone()
            .map(|pixel| [share(pixel[0]), share(pixel[1]), share(pixel[2])])
            .collect(),
        alpha: pixels.map(|pixel| share(pixel[3])).collect(),
        ..Image::filled(width_px, height_px, [0.0; 3])
    }
}

/// Keeps what happens: the log on disk, and the image_writer.
pub struct EpisodeImages {
    path: PathBuf,
    log: Option<EpisodeLog>,
    image_writer: ImageWriter,
    /// Watch over what was seen of a captured place.
    seen: Option<SeenWatch>,
    /// Error of writing an image. The log has priority, so it is reported after the episode.
    pub image_error: Option<anyhow::Error>,
}

impl EpisodeImages {
    pub fn new(path: PathBuf, image_writer: ImageWriter, seen: Option<SeenWatch>) -> Self {
        Self {
            path,
            log: None,
            image_writer,
            seen,
            image_error: None,
        }
    }

    fn keep(&mut self, result: Result<()>) {
        if let (Err(error), None) = (result, &self.image_error) {
            self.image_error = Some(error);
        }
    }
}

impl EpisodeObserver for EpisodeImages {
    fn uses_readings(&self) -> bool {
        self.seen.is_some() || self.image_writer.keeps_images()
    }

    fn begin(&mut self, head: &EpisodeHead, start: &EpisodeTick) -> Result<(), EpisodeError> {
        self.log = Some(EpisodeLog::create(&self.path, head, start)?);
        if let Some(seen) = &mut self.seen {
            seen.moved(start.ego, start.time_s);
        }
        Ok(())
    }

    fn step(&mut self, step: &EpisodeStep, readings: &[Reading]) -> Result<(), EpisodeError> {
        if let Some(log) = &mut self.log {
            log.append(step)?;
        }
        if let Some(seen) = &mut self.seen {
            seen.observe(readings);
            if let Some(last) = step.instants.last() {
                seen.moved(last.ego, last.time_s);
            }
        }
        let added = self.image_writer.add(step.step, readings);
        self.keep(added);
        Ok(())
    }

    fn end(&mut self, end: &EpisodeEnd) -> Result<(), EpisodeError> {
        // Images first: a log under its own name says that all of the episode is there.
        let closed = self.image_writer.close();
        self.keep(closed);
        let noted = self.seen.as_mut().map_or(Ok(()), SeenWatch::finish);
        self.keep(noted);
        if let Some(log) = self.log.take() {
            log.finish(end)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::{Intrinsics, Pose, RigCamera};

    #[test]
    fn key_frames_are_the_first_the_last_and_some_between() {
        let folder = tempfile::tempdir().unwrap();
        let intrinsics = Intrinsics::from_horizontal_fov(2, 1, 1.0);
        let camera = RigCamera {
            name: "front".into(),
            intrinsics,
            rig_from_camera: Pose::IDENTITY,
        };
        let mut image_writer = ImageWriter::new(folder.path().join("a"), Images::Key);
        for step in 0..60_u8 {
            let rgba = [step, 0, 0, 255, 0, step, 0, 255];
            image_writer
                .add(u32::from(step), &[Reading::image(&camera, &rgba)])
                .unwrap();
        }
        image_writer.close().unwrap();
        let mut names: Vec<_> = fs::read_dir(folder.path().join("a"))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        let steps = [0, 8, 16, 24, 32, 40, 48, 56, 59];
        assert_eq!(names, steps.map(|step| format!("key_{step:04}.png")));
        let last = Image::read(&folder.path().join("a/key_0059.png")).unwrap();
        assert_eq!(
            (last.rgb[0], last.rgb[1]),
            ([59.0 / 255.0, 0.0, 0.0], [0.0, 59.0 / 255.0, 0.0])
        );
    }
}
