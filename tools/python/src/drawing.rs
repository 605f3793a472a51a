//! Drawing to the host: images of a call, gathered as arrays want them.

use decouplegs::render::{
    ColorFormat, FrameStatistics, Image, Outputs, Plane, PlaneType, PlaneValues,
};
use decouplegs::scene::Camera;
use decouplegs::session::{BatchRenderer, HostImages, SessionError, World, WorldView};

use crate::array::Values;

/// Worlds and their cameras, copied, so that a call draws what was there when it was made.
pub struct Views(pub Vec<(World, Vec<Camera>)>);

impl Views {
    pub fn borrowed(&self) -> Vec<WorldView<'_>> {
        self.0
            .iter()
            .map(|(world, cameras)| WorldView { world, cameras })
            .collect()
    }

    /// View and camera of every image, in order.
    pub fn indices(&self) -> Vec<(usize, usize)> {
        let of_view = |(view, (_, cameras)): (usize, &(World, Vec<Camera>))| {
            (0..cameras.len()).map(move |camera| (view, camera))
        };
        self.0.iter().enumerate().flat_map(of_view).collect()
    }

    /// Width and height of an image.
    pub fn size_px(&self, (view, camera): (usize, usize)) -> [u32; 2] {
        let lens = &self.0[view].1[camera].intrinsics;
        [lens.width_px, lens.height_px]
    }
}

/// Images one after the other, rows from the top.
pub struct Layers {
    /// Four values per pixel.
    pub color: Values,
    /// The planes that the session has.
    pub planes: Vec<(Plane, Values)>,
}

/// Draws `views` and returns, for each of `groups`, its images.
pub fn draw(
    renderer: &mut BatchRenderer,
    views: &Views,
    groups: &[Vec<(usize, usize)>],
    bytes: &mut HostImages,
) -> Result<(Vec<Layers>, Vec<FrameStatistics>), SessionError> {
    let outputs = renderer.options().outputs;
    if outputs.color == ColorFormat::U8 && outputs.planes.is_empty() {
        let statistics = renderer.draw(&views.borrowed(), bytes)?;
        let gather = |group: &Vec<(usize, usize)>| {
            let images: Vec<&[u8]> = group
                .iter()
                .map(|&(view, camera)| bytes.rgba(view, camera))
                .collect();
            Layers {
                color: Values::U8(images.concat()),
                planes: Vec::new(),
            }
        };
        return Ok((groups.iter().map(gather).collect(), statistics));
    }
    let (images, statistics) = renderer.draw_images(&views.borrowed())?;
    let gather = |group: &Vec<(usize, usize)>| {
        let images: Vec<&Image> = group
            .iter()
            .map(|&(view, camera)| &images[view][camera])
            .collect();
        gathered(&images, &outputs)
    };
    Ok((groups.iter().map(gather).collect(), statistics))
}

fn gathered(images: &[&Image], outputs: &Outputs) -> Layers {
    let colors = images
        .iter()
        .flat_map(|image| image.rgb.iter().zip(&image.alpha));
    let color = match outputs.color {
        ColorFormat::F32 => Values::F32(
            colors
                .flat_map(|(&[r, g, b], &alpha)| [r, g, b, alpha])
                .collect(),
        ),
        ColorFormat::U8 => {
            // They were bytes on the device: rounding brings these back.
            let byte = |value: f32| (255.0 * value).round() as u8;
            Values::U8(
                colors
                    .flat_map(|(&[r, g, b], &alpha)| [r, g, b, alpha].map(byte))
                    .collect(),
            )
        }
    };
    let planes = outputs.planes.iter();
    Layers {
        color,
        planes: planes
            .map(|plane| (plane, plane_of_all(images, plane)))
            .collect(),
    }
}

/// Values of `plane` of all `images`, one after the other. NumPy and DLPack share no unsigned type
/// of 16 bits with every consumer: such values are int32.
fn plane_of_all(images: &[&Image], plane: Plane) -> Values {
    let values = images.iter().filter_map(|image| image.planes.get(&plane));
    match plane.value_type() {
        PlaneType::F32 => Values::F32(
            values
                .filter_map(PlaneValues::as_f32)
                .flatten()
                .copied()
                .collect(),
        ),
        PlaneType::U16 => {
            let values = values.filter_map(PlaneValues::as_u16).flatten();
            Values::I32(values.map(|&value| i32::from(value)).collect())
        }
    }
}
