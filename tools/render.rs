//! `decouplegs render`: one image for each camera.

mod boxes;
mod coverage;
mod definition;
mod labels;

use std::collections::HashSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use decouplegs_asset::{Layer, write_atomically};
use decouplegs_gpu::Gpu;
use decouplegs_render::rendered_image::{Image, ImageFileFormat, contact_sheet, preview};
use decouplegs_render::{ColorFormat, Outputs, Plane, Planes, RenderOptions};
use decouplegs_scene::{Camera, Photometry, release};
use decouplegs_session::{Session, SessionOptions, World, WorldView};

use self::boxes::BoxList;
use self::coverage::Counter;
use self::definition::{exposed, render_by_definition};
use self::labels::{Labels, WrittenPlane};
use crate::arguments::{
    pixels, print, seconds_above_zero, warn, write_image, write_image_with_alpha,
};
use crate::background::BackgroundArguments;
use crate::camera_path::CameraPath;
use crate::device::{DeviceArguments, check_validation};
use crate::outputs::Force;
use crate::progress;
use crate::scene_source::{DrawInput, SceneArguments};

/// Render a scene for every camera, one image each, named by the camera; the files are listed as
/// they are written
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    /// Follow this way of a camera, a file that the viewer saves: one image for each time of it,
    /// path_00000 and so on, of the scene as it is then
    #[arg(long, value_name = "FILE", conflicts_with_all = ["cameras", "orbit", "view", "time", "boxes", "exposure", "reference"])]
    camera_path: Option<PathBuf>,
    /// Images for each second of the camera path
    #[arg(long, value_name = "HZ", allow_negative_numbers = true, requires = "camera_path", default_value_t = 10.0, value_parser = images_per_second)]
    rate: f64,
    /// Folder for the images; created if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Image file format
    #[arg(long, value_enum, default_value_t = Format::Png)]
    format: Format,
    /// Part of the scene to render
    #[arg(long, value_enum, default_value_t = LayerName::All)]
    layer: LayerName,
    /// Render agents at the coarsest level of detail whose splats are at most this many pixels
    /// apart (default: always the finest)
    #[arg(long, value_name = "PIXELS", allow_negative_numbers = true, conflicts_with = "reference", value_parser = pixels)]
    level_pitch: Option<f64>,
    /// Write these planes beside each image too, as NAME.PLANE.npy with one or more values per
    /// pixel, float32 where nothing else is said. depth: expected depth along the camera's z,
    /// meters, 0 where nothing is. depth_median, range_median: those of the splat in which half of
    /// a pixel's light is gone, 0 where more is left. instance: 0 the background, k the k-th agent,
    /// uint16. range: distance from the camera, meters. normal: 3 values, world axes, towards the
    /// camera. flow_forward, flow_backward: 2 values, pixels that the content moves in
    /// --flow-interval to later and to earlier. scene_flow: 3 values, velocity in m/s, world axes.
    /// class: uint16, place in the list of classes.json, which is written too. moving: uint16, 1
    /// where an agent moves
    #[arg(long, value_name = "PLANE,...", value_delimiter = ',', value_parser = WrittenPlane::parser())]
    planes: Vec<WrittenPlane>,
    /// Write a preview of each plane too, as NAME.PLANE.png
    #[arg(long, requires = "planes")]
    plane_previews: bool,
    /// Interval of optical flow, seconds: the camera and agents go on with their motion
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 0.1, value_parser = seconds_above_zero)]
    flow_interval: f64,
    /// Write boxes.json too: for each image the 3D, amodal and tight boxes of its agents, their
    /// visible pixels, and the shares of them that are visible and beyond the edges of the image
    #[arg(long)]
    boxes: bool,
    /// Blur what moves: expose each pixel for this time, seconds, around that of its sharp image.
    /// Planes and boxes stay those of the sharp image
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = seconds_above_zero)]
    exposure: Option<f64>,
    /// Sharp images whose light is averaged for one exposure
    #[arg(long, value_name = "N", allow_negative_numbers = true, requires = "exposure", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=1024))]
    sub_exposures: u32,
    #[command(flatten)]
    background: BackgroundArguments,
    #[command(flatten)]
    device: DeviceArguments,
    /// Render with the f64 reference on the CPU: exact and slow
    #[arg(long, conflicts_with_all = ["device", "storage", "background_pitch"])]
    reference: bool,
    /// Evaluate splats along the ray of each pixel, as 3DGUT and NuRec do, with their least
    /// response, stop and near plane; with --reference
    #[arg(long, requires = "reference", conflicts_with_all = ["planes", "boxes", "rules", "antialias"])]
    along_rays: bool,
    /// Write all images side by side to this file too, which ends with .png
    #[arg(long, value_name = "FILE", value_parser = png_path)]
    contact_sheet: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

fn images_per_second(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok();
    let rate = rate.filter(|rate: &f64| (0.1..=240.0).contains(rate));
    rate.ok_or_else(|| format!("expected 0.1 to 240 images per second, found {text:?}"))
}

fn png_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_png = ImageFileFormat::of_path(&path) == Some(ImageFileFormat::Png);
    if is_png {
        Ok(path)
    } else {
        Err(format!(
            "expected a name that ends with .png, found {text:?}"
        ))
    }
}

/// Image file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// 8 bits per channel, clamped; no alpha, but for `--layer agents`: RGBA, colors divided by
    /// alpha
    Png,
    /// float32 RGBA as blended: premultiplied by alpha in `--layer agents`
    Exr,
    /// float32 [height, width, 4]: RGB as blended, unclamped, and alpha
    Npy,
}

impl From<Format> for ImageFileFormat {
    fn from(format: Format) -> Self {
        match format {
            Format::Png => Self::Png,
            Format::Exr => Self::Exr,
            Format::Npy => Self::Npy,
        }
    }
}

/// Part of the scene to render.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum LayerName {
    /// Background and agents
    All,
    /// The scene without agents and their shadows
    Background,
    /// The agents without background, in the light of the whole scene, with their coverage as alpha
    Agents,
}

impl From<LayerName> for Layer {
    fn from(name: LayerName) -> Self {
        match name {
            LayerName::All => Self::All,
            LayerName::Background => Self::Background,
            LayerName::Agents => Self::Agents,
        }
    }
}

/// Images in a row of a contact sheet: a rig's front row stands above its back row.
const SHEET_COLUMNS: u32 = 3;

/// Size of images along a camera path where nothing is said, pixels.
const PATH_SIZE_PX: [u32; 2] = [1280, 720];

/// Time that images may take before files of them are seen.
const FIRST_SEEN: Duration = Duration::from_secs(1);

/// Cameras whose images are held at once. A rig has fewer; a file of training cameras has hundreds,
/// whose images no device holds.
const CAMERAS_AT_ONCE: usize = 8;

pub fn run(arguments: &Arguments) -> Result<()> {
    let mut outputs = arguments.force.outputs(&[]);
    outputs.folder(&arguments.out)?;
    if let Some(sheet) = &arguments.contact_sheet {
        outputs.file(sheet)?;
    }
    let path = arguments.camera_path.as_deref();
    let path = path.map(CameraPath::read).transpose()?;
    let read = || DrawInput::open(&arguments.scene);
    let (gpu, mut input) = match arguments.reference {
        true => (None, read()?),
        false => {
            let (gpu, input) = arguments.device.open_beside(read)?;
            (Some(gpu), input)
        }
    };
    let times_s = match &path {
        Some(path) => follow(path, &mut input, arguments)?,
        None => {
            input.warn_of_shapes();
            Vec::new()
        }
    };
    check_names(&input.cameras)?;
    if arguments.contact_sheet.is_some() {
        let format = ImageFileFormat::from(arguments.format);
        let images = input.cameras.iter();
        images
            .map(|camera| image_path(&arguments.out, camera, format))
            .try_for_each(|image| outputs.file(&image))?;
    }
    if arguments.layer == LayerName::Agents {
        // What is laid over another image has the colors of the scene.
        let cameras = input.cameras.iter_mut();
        cameras.for_each(|camera| camera.intrinsics.photometry = Photometry::IDENTITY);
    }
    let input = input;
    warn_of_plain_agents(&input, arguments);
    let labels = Labels::new(&input);
    let counter = || match &gpu {
        Some(gpu) => Counter::on(gpu, &input),
        None => Counter::Reference,
    };
    let mut writer = ImageWriter {
        out: &arguments.out,
        format: arguments.format.into(),
        planes: &arguments.planes,
        previews: arguments.plane_previews,
        transparent: arguments.layer == LayerName::Agents,
        kept: arguments.contact_sheet.as_ref().map(|_| vec![]),
        boxes: arguments
            .boxes
            .then(|| BoxList::new(&input, &labels, counter())),
        labels: &labels,
    };
    match &gpu {
        Some(gpu) => render_on_gpu(gpu, &input, &times_s, arguments, &mut writer)?,
        None => {
            let planes = arguments.planes.iter();
            if let Some(plane) = planes
                .copied()
                .find(|plane| !Planes::BESIDE_COLOR.contains(plane.rendered()))
            {
                bail!(
                    "the reference renders no plane of geometry, such as {}: leave out --reference",
                    plane.name()
                );
            }
            render_by_definition(&input, arguments, &mut writer)?;
        }
    }
    if arguments.planes.contains(&WrittenPlane::Class) {
        print(&format!("{}\n", labels.write(&arguments.out)?.display()))?;
    }
    if let Some(boxes) = &writer.boxes {
        let path = arguments.out.join("boxes.json");
        boxes.write(&path)?;
        print(&format!("{}\n", path.display()))?;
    }
    if let (Some(path), Some(images)) = (&arguments.contact_sheet, &writer.kept) {
        let sheet = contact_sheet(images, SHEET_COLUMNS)
            .context("there is no camera, so there is no image")?;
        writer.write(path, &sheet, ImageFileFormat::Png)?;
        print(&format!("{}\n", path.display()))?;
    }
    drop(writer);
    // The program need not wait for its memory to be given back.
    release(input);
    Ok(())
}

/// Gives `input` the cameras of `path`. Returns the time of each, seconds.
fn follow(path: &CameraPath, input: &mut DrawInput, arguments: &Arguments) -> Result<Vec<f64>> {
    ensure!(
        !arguments.planes.contains(&WrittenPlane::Moving),
        "--planes moving is that of one time, and a camera path has many: leave it out"
    );
    let size_px = arguments.scene.size_px().unwrap_or(PATH_SIZE_PX);
    let times_s = path.times_s(arguments.rate);
    let times_s = times_s.map_err(|reason| anyhow::anyhow!("--rate: {reason}"))?;
    let camera = |(index, &time_s): (usize, &f64)| {
        let name = format!("path_{index:05}");
        path.at(time_s).view().camera(&name, size_px)
    };
    input.cameras = times_s.iter().enumerate().map(camera).collect();
    Ok(times_s)
}

/// Says that agents of plain splats stand still where motion is asked for.
fn warn_of_plain_agents(input: &DrawInput, arguments: &Arguments) {
    let rolls = |camera: &Camera| !camera.intrinsics.shutter.is_global();
    let shows_motion = |plane: &WrittenPlane| {
        matches!(
            plane.rendered(),
            Plane::FlowForward | Plane::FlowBackward | Plane::SceneFlow
        )
    };
    let count = input.loaded.plain_agents.len();
    let asks = arguments.exposure.is_some()
        || arguments.planes.iter().any(shows_motion)
        || input.cameras.iter().any(rolls);
    if count > 0 && asks {
        warn(&format!(
            "{count} agents are plain splats, which are part of the background: they count as at \
             rest in flow, exposures and under rolling shutters; 'decouplegs compress' makes agents that move"
        ));
    }
}

/// Destination of images. Images are written one after the other: hundreds of them need not be in
/// memory together.
struct ImageWriter<'a> {
    out: &'a Path,
    format: ImageFileFormat,
    /// Planes that are written beside them.
    planes: &'a [WrittenPlane],
    /// Labels of agents.
    labels: &'a Labels,
    /// True if each plane has a preview.
    previews: bool,
    /// True if there is no background behind the rendered splats.
    transparent: bool,
    /// The images so far, where a contact sheet is asked for.
    kept: Option<Vec<Image>>,
    /// Bounding boxes, where they are asked for.
    boxes: Option<BoxList<'a>>,
}

/// The file of the image of `camera` in the folder `out`.
fn image_path(out: &Path, camera: &Camera, format: ImageFileFormat) -> PathBuf {
    out.join(format!("{}.{}", camera.name, format.extension()))
}

impl ImageWriter<'_> {
    fn add(&mut self, camera: &Camera, image: Image) -> Result<()> {
        fs::create_dir_all(self.out)
            .with_context(|| format!("{} cannot be made", self.out.display()))?;
        let path = image_path(self.out, camera, self.format);
        self.write(&path, &image, self.format)?;
        print(&format!("{}\n", path.display()))?;
        for plane in self.planes {
            self.add_plane(camera, &image, *plane)?;
        }
        if let Some(boxes) = &mut self.boxes {
            boxes.add(camera, &image)?;
        }
        if let Some(kept) = &mut self.kept {
            kept.push(image);
        }
        Ok(())
    }

    fn add_plane(&self, camera: &Camera, image: &Image, written: WrittenPlane) -> Result<()> {
        let (name, plane) = (written.name(), written.rendered());
        let image = &self.labels.applied(image, written);
        let bytes = image.encode_plane(plane);
        let bytes = bytes.with_context(|| format!("the image of {} has no {name}", camera.name))?;
        let path = self.out.join(format!("{}.{name}.npy", camera.name));
        write_atomically(&path, |file| file.write_all(&bytes))?;
        print(&format!("{}\n", path.display()))?;
        if let Some(preview) = preview(image, plane).filter(|_| self.previews) {
            let path = self.out.join(format!("{}.{name}.png", camera.name));
            write_image(&path, &preview, ImageFileFormat::Png)?;
            print(&format!("{}\n", path.display()))?;
        }
        Ok(())
    }

    fn write(&self, path: &Path, image: &Image, format: ImageFileFormat) -> Result<()> {
        let write = if self.transparent {
            write_image_with_alpha
        } else {
            write_image
        };
        write(path, image, format)
    }
}

/// Renders every camera on a device. `times_s`: the time of each, where cameras have their own.
fn render_on_gpu(
    gpu: &Gpu,
    input: &DrawInput,
    times_s: &[f64],
    arguments: &Arguments,
    writer: &mut ImageWriter,
) -> Result<()> {
    let bar = progress::bar("images", input.cameras.len());
    // What a PNG can hold takes a quarter of the memory; divided by alpha it would show the steps
    // of 8 bits.
    let color = match writer.format {
        ImageFileFormat::Png if !writer.transparent && arguments.exposure.is_none() => {
            ColorFormat::U8
        }
        _ => ColorFormat::F32,
    };
    let outputs = Outputs {
        color,
        planes: arguments
            .planes
            .iter()
            .map(|plane| plane.rendered())
            .chain(BoxList::PLANES.into_iter().filter(|_| arguments.boxes))
            .collect(),
        ..Outputs::default()
    };
    let mut options = SessionOptions {
        render: RenderOptions {
            outputs,
            level_pitch_px: arguments.level_pitch,
            flow_interval_s: arguments.flow_interval,
            ..RenderOptions::default()
        },
        rules: Some(input.rules()),
        bakes_light_on_demand: false,
        ..SessionOptions::default()
    };
    arguments.background.apply_to(&mut options.render);
    let session = Session::on(gpu, &options);
    let copying = progress::spinner("copying the scene to the device".into());
    let on_device = session.add_layer(&input.loaded, arguments.layer.into())?;
    copying.finish_and_clear();
    let mut world = World::new(&on_device);
    let mut renderer = session.batch_renderer();
    let (mut left, mut count) = (input.cameras.as_slice(), 1);
    while !left.is_empty() {
        let begun = Instant::now();
        let own_s = times_s.get(input.cameras.len() - left.len());
        let time_s = *own_s.unwrap_or(&input.time_s);
        let (cameras, rest) = left.split_at(count.min(left.len()));
        left = rest;
        let images = exposed(input, arguments, cameras, |later_s, cameras| {
            world.set_time(time_s + later_s);
            let view = WorldView {
                world: &world,
                cameras,
            };
            let (images, _) = renderer.draw_images(&[view])?;
            Ok(images.into_iter().flatten().collect())
        })?;
        for (camera, image) in cameras.iter().zip(images) {
            writer.add(camera, image)?;
            bar.inc(1);
        }
        // Cameras with times of their own do not see one world.
        if own_s.is_none() {
            count = cameras_next(cameras.len(), begun.elapsed());
        }
    }
    bar.finish_and_clear();
    check_validation(gpu)
}

/// Cameras that are drawn at once after `count`, which took `time`: fewer on slow devices, so that
/// images are there to see before all are drawn.
fn cameras_next(count: usize, time: Duration) -> usize {
    let per_second = FIRST_SEEN.as_secs_f64() * count as f64 / time.as_secs_f64().max(1e-9);
    (per_second as usize).clamp(1, CAMERAS_AT_ONCE)
}

/// Refuses names that would write outside the folder, or over another camera's image.
fn check_names(cameras: &[Camera]) -> Result<()> {
    let mut taken = HashSet::new();
    for Camera { name, .. } in cameras {
        let plain = !name.is_empty() && !name.contains(['/', '\\', '\0']) && !name.starts_with('.');
        ensure!(
            plain,
            "the camera {name:?} cannot name an image: use letters, digits, '-' and '_'"
        );
        ensure!(
            taken.insert(name.to_lowercase()),
            "two cameras are called {name:?}: the second image would replace the first"
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::Motion;
    use decouplegs_scene::{Intrinsics, Pose};

    fn cameras(names: &[&str]) -> Vec<Camera> {
        let intrinsics = Intrinsics::from_horizontal_fov(2, 2, 1.0);
        names
            .iter()
            .map(|&name| Camera {
                name: name.into(),
                intrinsics,
                world_from_camera: Pose::IDENTITY,
                motion: Motion::REST,
            })
            .collect()
    }

    #[test]
    fn images_stay_in_their_folder_and_apart() {
        assert!(check_names(&cameras(&["front", "front left", "0001.v2"])).is_ok());
        for bad in ["", "..", "../front", "a/b", "a\\b", ".hidden"] {
            let error = check_names(&cameras(&["front", bad]))
                .unwrap_err()
                .to_string();
            assert!(error.contains(&format!("{bad:?}")), "{error}");
        }
        assert!(
            check_names(&cameras(&["front", "Front"]))
                .unwrap_err()
                .to_string()
                .contains("replace")
        );
    }

    #[test]
    fn slow_devices_show_views_one_by_one() {
        let after = |count, time_s| cameras_next(count, Duration::from_secs_f64(time_s));
        assert_eq!((after(1, 7.0), after(1, 0.4), after(1, 0.0)), (1, 2, 8));
        assert_eq!((after(8, 16.0), after(8, 0.1)), (1, 8));
    }

    #[test]
    fn a_contact_sheet_is_a_png() {
        assert!(png_path("a/sheet.PNG").is_ok());
        for other in ["sheet", "sheet.exr", ".png"] {
            assert!(png_path(other).unwrap_err().contains(other));
        }
    }
}
