//! The report of a scene as one HTML page.

use anyhow::Result;
use decouplegs::render::metrics::difference_image;

use super::report::{Compared, Realism};
use crate::page::{Figure, Page, Table};
use crate::plot::{Axis, Plot, Series};
use crate::thumbnail::thumbnail;

/// Photographs that are shown, at most: more would make the page tens of megabytes.
const SHOWN_MAX: usize = 8;
const WIDTH_PX: u32 = 420;
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
        page.note(&format!("Detector: {name}."));
    }
    page.heading("Photographs");
    if realism.compared.len() > 1 {
        page.row([Figure::flexible_svg(&chart(realism))]);
    }
    for one in shown(realism) {
        images(&mut page, one)?;
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

fn images(page: &mut Page, one: &Compared) -> Result<()> {
    let difference = difference_image(&one.photograph.image, &one.rendered, DIFFERENCE_GAIN)?;
    let figures = [
        (
            format!("{}: photograph", one.photograph.name),
            &one.photograph.image,
        ),
        (
            format!("scene, {:.2} dB", one.difference.psnr_db),
            &one.rendered,
        ),
        (format!("difference, times {DIFFERENCE_GAIN}"), &difference),
    ];
    let figures =
        figures.map(|(caption, image)| Figure::image(&caption, &thumbnail(image, WIDTH_PX)));
    page.row(figures.into_iter().collect::<Result<Vec<_>>>()?);
    Ok(())
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
