//! The report as one HTML page that needs nothing beside it.

use std::fmt::Write;

use anyhow::Result;
use decouplegs::render::rendered_image::Image;
use decouplegs::train::calibrate::{Calibration, ColorError, Comparison, HUE_FLOOR, LIGHTS_MIN};

use super::{Subject, views};
use crate::data_uri;
use crate::plot::{self, Axis, Plot, Series, Shape, escaped};

/// The page.
pub fn page(subject: &Subject, calibration: &Calibration) -> Result<String> {
    let mut html = plot::page_start("Light transfer: colors in light that the fit was not shown");
    html.push_str(&summary(subject, calibration));
    html.push_str("<h2>Probes left out</h2>");
    html.push_str(&table(subject, calibration));
    for held_out in &calibration.held_out {
        let name = escaped(&subject.probes[held_out.probe].name);
        let _ = write!(html, "<h3>{name}</h3><div class=\"row\">");
        if let Some(row) = views::row(subject, held_out) {
            for (caption, image) in row.captions.iter().zip(&row.images) {
                figure(&mut html, caption, image)?;
            }
        }
        html.push_str("</div>");
    }
    html.push_str(&assets_left_out(subject, calibration));
    html.push_str("<h2>The neutral light</h2><div class=\"row\">");
    for (caption, image) in ["as it is", "relit"]
        .iter()
        .zip(&views::neutral(subject, calibration))
    {
        figure(&mut html, caption, image)?;
    }
    html.push_str("</div>");
    html.push_str(&ridges(calibration));
    html.push_str(HOW_TO_READ);
    html.push_str("</html>\n");
    Ok(html)
}

const HOW_TO_READ: &str = "<h2>How to read this</h2><ul>\
    <li>Truth is what the calibration takes for it: matt surfaces, each splat facing along its shortest axis, lit by the probe \
    above the horizon and by the reference ground below it, without shadows of the asset on itself. The errors are those of one affine transfer for the whole asset against \
    this truth, not against photographs.</li>\
    <li>Each row is a fit without that probe, in all its turns, reflections and exposures; the ridge was chosen without it, too. \
    The assets are those of the fit. A row of an asset is a fit to the other assets, in all lights.</li>\
    <li><i>Best affine</i> is fitted to each light of the probe that was left out: what one factor and one summand for each \
    coefficient can do at best.</li></ul>";

fn summary(subject: &Subject, calibration: &Calibration) -> String {
    let assets: Vec<String> = subject
        .assets
        .iter()
        .map(|(name, _)| escaped(name))
        .collect();
    format!(
        "<p>Degree {}, {} splats of {}, {} lights from {} probes, objective {}, ridge {:.1e}. Rank {} of \
         {LIGHTS_MIN}, condition number {:.0}. The neutral light changes colors by {:.4} (RMSE).</p>",
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

fn table(subject: &Subject, calibration: &Calibration) -> String {
    if calibration.held_out.is_empty() {
        return "<p>No probe could be left out: the others do not determine a fit without it.</p>"
            .into();
    }
    let mut html = table_head();
    for held_out in &calibration.held_out {
        table_row(
            &mut html,
            &escaped(&subject.probes[held_out.probe].name),
            &held_out.comparison,
        );
    }
    table_row(&mut html, "all", &calibration.total());
    let _ = write!(
        html,
        "</table><p class=\"dim\">Display-referred colors as seen, 0 to 1. Angles between RGB vectors in degrees, where the truth's \
         largest channel is at least {HUE_FLOOR}.</p>"
    );
    html
}

fn table_head() -> String {
    let mut html = String::from("<table><tr><th>left out");
    for method in ["not relit", "relit", "best affine"] {
        let _ = write!(html, "<th>RMSE, {method}<th>PSNR, dB<th>angle, mean<th>p95");
    }
    html
}

/// Table of assets, each relit by a fit to the others; empty for one asset.
fn assets_left_out(subject: &Subject, calibration: &Calibration) -> String {
    if calibration.held_out_assets.is_empty() {
        return String::new();
    }
    let mut html = format!("<h2>Assets left out</h2>{}", table_head());
    for held_out in &calibration.held_out_assets {
        let name = escaped(&subject.assets[held_out.asset].0);
        table_row(&mut html, &name, &held_out.comparison);
    }
    html.push_str("</table>");
    html
}

fn table_row(html: &mut String, name: &str, comparison: &Comparison) {
    let _ = write!(html, "<tr><td>{name}");
    let mut cells = |error: &ColorError| {
        let _ = write!(
            html,
            "<td>{:.4}<td>{:.2}<td>{:.2}<td>{:.2}",
            error.rmse(),
            error.psnr_db(),
            error.angle_mean_deg(),
            error.angle_p95_deg()
        );
    };
    [&comparison.none, &comparison.relit, &comparison.affine]
        .into_iter()
        .for_each(&mut cells);
}

fn figure(html: &mut String, caption: &str, image: &Image) -> Result<()> {
    let _ = write!(
        html,
        "<figure><img class=\"pixels\" src=\"{}\" alt=\"{caption}\"><figcaption>{caption}</figcaption></figure>",
        data_uri::png(image)?
    );
    Ok(())
}

fn ridges(calibration: &Calibration) -> String {
    if calibration.tried.is_empty() {
        return String::new();
    }
    let plot = Plot {
        title: "Ridge",
        x: Axis {
            label: "ridge",
            log: true,
            ..Axis::default()
        },
        y: Axis {
            label: "RMSE by the objective, probes left out",
            ..Axis::default()
        },
        series: vec![Series {
            name: "probes left out".into(),
            color: 0,
            points: calibration.tried.clone(),
            shape: Shape::Curve,
            end: None,
        }],
    };
    format!("<h2>Ridge</h2><figure>{}</figure>", plot.to_svg())
}
