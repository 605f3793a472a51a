//! The report as one HTML page.

use anyhow::Result;
use decouplegs_calibrate::{Calibration, ColorError, Comparison, HUE_FLOOR, LIGHTS_MIN};

use super::{Subject, views};
use crate::page::{Figure, Page, Table};
use crate::plot::{Axis, Plot, Series};

/// The page.
pub fn page(subject: &Subject, calibration: &Calibration) -> Result<String> {
    let mut page = Page::new("Light transfer: colors in light that the fit was not shown");
    page.text(&summary(subject, calibration));
    page.heading("Probes left out");
    probes_left_out(&mut page, subject, calibration);
    for held_out in &calibration.held_out {
        page.subheading(&subject.probes[held_out.probe].name);
        if let Some(row) = views::row(subject, held_out) {
            let images = row.captions.iter().zip(&row.images);
            let figures = images.map(|(caption, image)| Figure::image(caption, image));
            page.row(figures.collect::<Result<Vec<_>>>()?);
        }
    }
    if !calibration.held_out_assets.is_empty() {
        page.heading("Assets left out");
        let mut table = empty_table();
        for held_out in &calibration.held_out_assets {
            let name = &subject.assets[held_out.asset].0;
            table.row(cells(name, &held_out.comparison));
        }
        page.table(&table);
    }
    page.heading("The neutral light");
    let [plain, relit] = &views::neutral(subject, calibration);
    page.row([
        Figure::image("as it is", plain)?,
        Figure::image("relit", relit)?,
    ]);
    if !calibration.tried.is_empty() {
        page.heading("Ridge");
        page.row([ridges(calibration)]);
    }
    page.heading("How to read this");
    page.list(HOW_TO_READ);
    Ok(page.finish())
}

const HOW_TO_READ: [&str; 3] = [
    "Truth is what the calibration takes for it: matt surfaces, each splat facing along its shortest axis, lit by the probe above the \
     horizon and by the reference ground below it, without shadows of the asset on itself. The errors are those of one affine \
     transfer for the whole asset against this truth, not against photographs.",
    "Each row is a fit without that probe, in all its turns, reflections and exposures. The ridge was chosen without it, too. The \
     assets are those of the fit. A row of an asset is a fit to the other assets, in all lights.",
    "<i>Best affine</i> is fitted to each light of the probe that was left out: what one factor and one summand for each coefficient \
     can do at best.",
];

fn summary(subject: &Subject, calibration: &Calibration) -> String {
    let assets: Vec<&str> = subject
        .assets
        .iter()
        .map(|(name, _)| name.as_str())
        .collect();
    format!(
        "Degree {}, {} splats of {}, {} lights from {} probes, objective {}, ridge {:.1e}. Rank {} of \
         {LIGHTS_MIN}, condition number {:.0}. The neutral light changes colors by {:.4} (RMSE).",
        calibration.transfer.sh_degree,
        calibration.samples,
        assets.join(", "),
        calibration.lights,
        subject.probes.len(),
        subject.options.objective,
        calibration.ridge,
        calibration.rank,
        calibration.smallest_over_largest.recip(),
        calibration.neutral.relit.rmse()
    )
}

fn probes_left_out(page: &mut Page, subject: &Subject, calibration: &Calibration) {
    if calibration.held_out.is_empty() {
        page.text("No probe could be left out: the others do not determine a fit without it.");
        return;
    }
    let mut table = empty_table();
    for held_out in &calibration.held_out {
        let name = &subject.probes[held_out.probe].name;
        table.row(cells(name, &held_out.comparison));
    }
    table.row(cells("all", &calibration.total()));
    page.table(&table);
    page.note(&format!(
        "Display-referred colors as seen, 0 to 1. Angles between RGB vectors in degrees, where the largest channel of the truth is at \
         least {HUE_FLOOR}."
    ));
}

fn empty_table() -> Table {
    let methods = ["not relit", "relit", "best affine"].map(|method| {
        let rmse = format!("{method}: RMSE");
        [rmse, "angle, mean".into(), "angle, p95".into()]
    });
    Table::new(std::iter::once("left out".to_owned()).chain(methods.into_iter().flatten()))
}

fn cells(name: &str, comparison: &Comparison) -> Vec<String> {
    let figures = |error: &ColorError| {
        [
            format!("{:.4}", error.rmse()),
            format!("{:.2}", error.angle_mean_deg()),
            format!("{:.2}", error.angle_p95_deg()),
        ]
    };
    let methods = [&comparison.none, &comparison.relit, &comparison.affine];
    std::iter::once(name.to_owned())
        .chain(methods.into_iter().flat_map(figures))
        .collect()
}

fn ridges(calibration: &Calibration) -> Figure {
    let plot = Plot {
        title: "Ridge",
        x: Axis::logarithmic("ridge"),
        y: Axis::linear("RMSE by the objective, probes left out"),
        series: vec![Series::curve(
            "probes left out",
            0,
            calibration.tried.clone(),
        )],
    };
    Figure::svg(&plot.to_svg())
}
