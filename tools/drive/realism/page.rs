//! The report of a scene as one HTML page.

use anyhow::Result;
use decouplegs::render::metrics::difference_image;
use decouplegs::render::rendered_image::Image;

use super::detections::Detections;
use super::report::{Compared, ComparedDetections, Realism};
use crate::page::{Figure, Page, Table};
use crate::plot::{Axis, Plot, Series};
use crate::thumbnail::thumbnail;

/// Photographs that are shown, at most: more would make the page tens of megabytes.
const SHOWN_MAX: usize = 8;
const WIDTH_PX: u32 = 420;
/// Color of boxes.
const BOX_RGB: [f32; 3] = [1.0, 0.1, 0.1];
/// Amplification of shown differences.
const DIFFERENCE_GAIN: f32 = 4.0;

/// The page.
pub fn page(realism: &Realism) -> Result<String> {
    let mut page = Page::new("Realism of a scene");
    page.note(&format!(
        "{}, drawn without agents at the poses of {} photographs of {} views, on {}.",
        realism.scene.display(),
        realism.compared.len(),
        realism.views,
        realism.device
    ));
    page.heading("One number per gap");
    page.table(&gaps(realism));
    page.list(
        realism
            .not_measured()
            .iter()
            .map(|sentence| format!("Not measured: {sentence}")),
    );
    let detector = realism.detections.as_ref();
    if let Some(name) = detector.and_then(|found| found.detector.as_ref()) {
        page.note(&format!("Detector: {name}. Its boxes are drawn in red."));
    }
    page.heading("Photographs");
    if realism.compared.len() > 1 {
        page.row([Figure::flexible_svg(&chart(realism))]);
    }
    for one in shown(realism) {
        images(&mut page, one, realism.detections.as_ref())?;
    }
    page.table(&by_image(realism));
    if !realism.scans.is_empty() {
        page.heading("Scans of a LiDAR");
    }
    for scan in &realism.scans {
        page.subheading(&scan.name);
        let caption = "Ranges of the scan, of the scene, and their difference: red is too far, blue too near, white without a return";
        page.row([Figure::image(caption, &scan.comparison.image())?]);
        let mut table = Table::new([
            "range, m, or class",
            "beams",
            "missing",
            "bias, m",
            "median, m",
            "95 %, m",
            "within 0.2 m",
        ]);
        let bins = scan.comparison.by_distance().into_iter();
        let bins =
            bins.map(|([from_m, to_m], errors)| (format!("{from_m:.0} to {to_m:.0}"), errors));
        let classes = scan.comparison.by_class().into_iter();
        let classes = classes.map(|(name, errors)| (name.to_owned(), errors));
        for (name, errors) in bins.chain(classes) {
            table.row([
                name,
                errors.beams.to_string(),
                format!("{:.1} %", 100.0 * errors.missing),
                format!("{:.3}", errors.bias_m),
                format!("{:.3}", errors.median_m),
                format!("{:.2}", errors.p95_m),
                format!("{:.1} %", 100.0 * errors.right),
            ]);
        }
        page.table(&table);
    }
    page.heading("How to read this");
    page.text(
        "PSNR and SSIM compare each photograph with the image of the scene from the same pose, both clamped to what a display shows; pixels that a mask leaves out do not count. \
         Cameras choose exposure and white balance image by image, which splats do not know: the second figures allow one factor per image and color. \
         Photographs that the scene was trained on look better than it is: compare those that were held out. \
         An opacity of the lower half below 0.9 means that the camera looks where the scene was not seen.",
    );
    Ok(page.finish())
}

/// Figure of each gap and its interval.
fn gaps(realism: &Realism) -> Table {
    let mut table = Table::new(["gap", "figure and 95 % confidence interval"]);
    for gap in realism.gaps() {
        let text = gap.text();
        table.row([gap.name, text]);
    }
    table
}

/// Ratios by photograph, as it is and after the gain.
fn chart(realism: &Realism) -> String {
    let points = |value: fn(&Compared) -> f64| {
        let values = realism.compared.iter().map(value).enumerate();
        values
            .filter(|(_, value)| value.is_finite())
            .map(|(at, value)| (at as f64, value))
            .collect()
    };
    Plot {
        title: "PSNR of each photograph",
        x: Axis::linear("photograph"),
        y: Axis::linear("PSNR, dB"),
        series: vec![
            Series::curve("as it is", 0, points(|one| one.difference.psnr_db)),
            Series::curve(
                "after the gain",
                1,
                points(|one| one.difference.gained_psnr_db),
            ),
        ],
    }
    .to_svg()
}

/// The photographs that are shown, evenly chosen.
fn shown(realism: &Realism) -> impl Iterator<Item = &Compared> {
    let count = realism.compared.len().min(SHOWN_MAX);
    (0..count).map(move |place| &realism.compared[place * realism.compared.len() / count])
}

fn images(page: &mut Page, one: &Compared, found: Option<&ComparedDetections>) -> Result<()> {
    let name = &one.photograph.name;
    let boxes = |detections: fn(&ComparedDetections) -> &Detections| {
        let rectangles = found.map(|found| detections(found).in_image(name));
        rectangles.into_iter().flatten().collect::<Vec<_>>()
    };
    let difference = difference_image(&one.photograph.image, &one.rendered, DIFFERENCE_GAIN)?;
    let figures = [
        (
            format!("{}: photograph", one.photograph.name),
            &with_boxes(&one.photograph.image, &boxes(|found| &found.in_photographs)),
        ),
        (
            format!("scene, {:.2} dB", one.difference.psnr_db),
            &with_boxes(&one.rendered, &boxes(|found| &found.in_rendered)),
        ),
        (format!("difference, times {DIFFERENCE_GAIN}"), &difference),
    ];
    let figures =
        figures.map(|(caption, image)| Figure::image(&caption, &thumbnail(image, WIDTH_PX)));
    page.row(figures.into_iter().collect::<Result<Vec<_>>>()?);
    Ok(())
}

/// `image` with the outlines of rectangles (left, top, width, height), as thick as a thumbnail
/// shows.
fn with_boxes(image: &Image, rectangles: &[[f64; 4]]) -> Image {
    let mut image = image.clone();
    let thick_px = f64::from(image.width.div_ceil(WIDTH_PX));
    let (width, height) = (image.width as usize, image.height as usize);
    for [left, top, wide, high] in rectangles {
        let range = |from: f64, to: f64, side: usize| {
            (from.max(0.0) as usize).min(side)..(to.max(0.0).ceil() as usize).min(side)
        };
        let (right, bottom) = (left + wide, top + high);
        for [from_x, to_x, from_y, to_y] in [
            [*left, right, *top, top + thick_px],
            [*left, right, bottom - thick_px, bottom],
            [*left, left + thick_px, *top, bottom],
            [right - thick_px, right, *top, bottom],
        ] {
            for row in range(from_y, to_y, height) {
                let pixels = range(from_x, to_x, width);
                image.rgb[row * width..][pixels].fill(BOX_RGB);
            }
        }
    }
    image
}

fn by_image(realism: &Realism) -> Table {
    let mut table = Table::new([
        "photograph",
        "pixels",
        "PSNR, dB",
        "after gain",
        "SSIM",
        "after gain",
        "gain, R G B",
        "lower half",
    ]);
    let ssim = |ssim: Option<f64>| ssim.map_or("-".into(), |ssim| format!("{ssim:.3}"));
    for one in &realism.compared {
        let found = &one.difference;
        let [red, green, blue] = found.gain;
        table.row([
            one.photograph.name.clone(),
            found.pixels.to_string(),
            format!("{:.2}", found.psnr_db),
            format!("{:.2}", found.gained_psnr_db),
            ssim(found.ssim),
            ssim(found.gained_ssim),
            format!("{red:.2} {green:.2} {blue:.2}"),
            format!("{:.3}", found.lower_half_opacity),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_outlines_inside_the_image() {
        let image = Image::filled(40, 20, [0.0; 3]);
        let drawn = with_boxes(&image, &[[10.0, 5.0, 8.0, 6.0], [-5.0, -5.0, 100.0, 1e9]]);
        let at = |column: usize, row: usize| drawn.rgb[row * 40 + column];
        for (column, row) in [(10, 5), (17, 5), (10, 10), (17, 10)] {
            assert_eq!(at(column, row), BOX_RGB);
        }
        assert_eq!([at(11, 6), at(18, 5), at(9, 5)], [[0.0; 3]; 3]);
        assert_eq!(drawn.rgb.iter().filter(|rgb| **rgb == BOX_RGB).count(), 24);
    }
}
