//! Images of an asset in the light of a probe: the truth, relit, and as it is.

use decouplegs::render::reference;
use decouplegs::render::rendered_image::Image;
use decouplegs::scene::light::{Probe, Surroundings, to_display};
use decouplegs::scene::{AmbientDescriptor, Rules, SplatCloud, SplatScene};
use decouplegs_calibrate::{Calibration, HeldOut, Lighting, PreparedProbe, lit_cloud};

use super::Subject;
use crate::views::street;

const WIDTH_PX: u32 = 216;
const HEIGHT_PX: u32 = 132;

/// Faint splats take most of the reference's time and hardly show.
const OPACITY_MIN: f32 = 0.15;

/// Share of the asset's size that the image is farther than its middle.
const DISTANCE: f64 = 2.0;

/// Luminance of the reference ground in images.
const GROUND_DISPLAY: f64 = 0.4;

/// Angle by which the probe is turned in images, radians: not one of the turns that were fitted.
const YAW_RAD: f64 = 0.4;

/// One probe left out, drawn.
pub struct Row {
    /// Captions of the images.
    pub captions: [&'static str; 4],
    /// The probe itself, the truth, relit by a fit that was not shown the probe, and the asset as
    /// it is.
    pub images: [Image; 4],
}

/// The first asset in the light of the probe that was left out; `None` where the probe leaves the
/// ground dark.
pub fn row(subject: &Subject, held_out: &HeldOut) -> Option<Row> {
    let probe = &subject.probes[held_out.probe];
    let small = probe.downsampled(decouplegs::scene::light::PROBE_WIDTH);
    let ground: &Surroundings = &subject.options.ground;
    let prepared = PreparedProbe::new(&small, ground);
    let light = Lighting::of_probe(
        (held_out.probe, &prepared),
        ground,
        YAW_RAD,
        false,
        GROUND_DISPLAY,
    )?;
    let asset = shown(&subject.assets[0].1);
    let background = ground_color(&light.descriptor);
    let truth = lit_cloud(&asset, |normal| light.reflected_by_white(normal));
    let relit = held_out.transfer.at(&light.descriptor).relit(&asset);
    let images = [
        thumbnail(&small, light.exposure),
        image(truth, background),
        image(relit, background),
        image(asset, background),
    ];
    Some(Row {
        captions: ["the probe", "truth", "relit, probe left out", "not relit"],
        images,
    })
}

/// The first asset in the neutral light: as it is, and relit.
pub fn neutral(subject: &Subject, calibration: &Calibration) -> [Image; 2] {
    let asset = shown(&subject.assets[0].1);
    let neutral = &calibration.transfer.neutral;
    let relit = calibration.transfer.at(neutral).relit(&asset);
    [
        image(asset, ground_color(neutral)),
        image(relit, ground_color(neutral)),
    ]
}

fn shown(asset: &SplatCloud) -> SplatCloud {
    let shows = |&splat: &u32| {
        asset.opacities[splat as usize] >= OPACITY_MIN && asset.defect_of(splat as usize).is_none()
    };
    asset.select(&(0..asset.len() as u32).filter(shows).collect::<Vec<_>>())
}

fn ground_color(light: &AmbientDescriptor) -> [f32; 3] {
    light.mean().map(|value| value.clamp(0.0, 1.0))
}

fn image(cloud: SplatCloud, background: [f32; 3]) -> Image {
    let bounds = cloud.bounds();
    let size_m = bounds
        .half_extent()
        .iter()
        .map(|half| f64::from(2.0 * half))
        .fold(0.0, f64::max)
        .max(1e-3);
    let focal_px = 0.8 * DISTANCE * f64::from(WIDTH_PX);
    let cameras = street(
        &bounds,
        8,
        DISTANCE * size_m,
        focal_px,
        [WIDTH_PX, HEIGHT_PX],
    );
    let splat_scene = SplatScene {
        sky: background,
        ..SplatScene::from_splats(cloud)
    };
    reference::render(&splat_scene, &cameras[1], &Rules::DEFAULT).to_image()
}

fn thumbnail(probe: &Probe, exposure: f64) -> Image {
    let mut image = Image::filled(probe.width() as u32, probe.height() as u32, [0.0; 3]);
    for (shown, radiance) in image.rgb.iter_mut().zip(probe.pixels()) {
        *shown = radiance.map(|value| to_display(f64::from(value) * exposure) as f32);
    }
    image
}
