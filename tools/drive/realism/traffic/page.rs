//! The report of compared traffic as one HTML page.

use std::path::Path;

use super::features::Quantity;
use super::motion::Model;
use super::report::{AFTER_S, Compared, Result, shown};
use crate::page::{Figure, Page, Table};
use crate::plot::{Axis, Plot, Series};

/// The page.
pub fn page(compared: &Compared, tracks: &Path) -> String {
    let mut page = Page::new("Realism of traffic");
    page.note(&format!(
        "{}: {} vehicles on lanes at the beginnings of parts of {} s. Each part is simulated from its beginning. {}.",
        tracks.display(),
        compared.vehicles(),
        compared.part_s,
        compared.told_of_drivers()
    ));
    page.heading("One number per quantity");
    page.note("Kolmogorov-Smirnov distance of simulated from recorded values: 0 is the same distribution, 1 is no value in common.");
    page.table(&distances(compared));
    page.heading("Distance from where vehicles were recorded");
    page.table(&displacements(compared));
    page.heading("Likelihood of what was recorded");
    page.note("Meta-metric of the Waymo Open Sim Agents Challenge and its parts (Montali et al., NeurIPS 2023; bins and weights of 2025): 1 is best.");
    page.table(&likelihoods(compared));
    page.heading("Distributions");
    page.row(Quantity::ALL.map(|quantity| Figure::flexible_svg(&curves(compared, quantity))));
    page.heading("How to read this");
    page.text(
        "\"lanes\" are normal drivers on the lanes of the map, as in generated scenarios, from where vehicles were recorded and with their speeds; vehicles that stand nearer to each other than these drivers can are left out. \
         \"tracks\" are drivers on the recorded lines of vehicles, handed over at the start, as with drive --handover all. \
         \"constant velocity\" goes straight on. \"agents\", where it stands, is the program of --agents, which drives all vehicles and is told their recorded lines as ways. Values count at moments at which a vehicle is there both in the recording and in the simulation. \
         Vehicles that come later are in the recording and in \"tracks\" alone. \
         A vehicle ahead is the nearest one in the straight trail of the box, within 100 m; a headway is told from 2 m/s on; times to collision of more than 5 s count as 5 s. \
         Where the map has no speed limits, drivers on lanes take 50 km/h.",
    );
    page.finish()
}

fn header(compared: &Compared, first: &str) -> Vec<String> {
    let names = compared
        .results
        .iter()
        .map(|result| result.model.name().to_owned());
    std::iter::once(first.to_owned()).chain(names).collect()
}

fn distances(compared: &Compared) -> Table {
    let mut columns = header(compared, "quantity");
    columns.push("recorded: 5, 25, 50, 75, 95 %".into());
    columns.push("lanes: 5, 25, 50, 75, 95 %".into());
    let mut table = Table::new(columns);
    let lanes = compared
        .results
        .iter()
        .find(|result| result.model == Model::Lanes);
    for quantity in Quantity::ALL {
        let at = quantity as usize;
        let mut cells = vec![quantity.name().to_owned()];
        let distances = compared
            .results
            .iter()
            .map(|result| shown(result.distance(quantity)));
        cells.extend(distances);
        cells.extend(lanes.map(|result| result.recorded[at].to_text()));
        cells.extend(lanes.map(|result| result.simulated[at].to_text()));
        table.row(cells);
    }
    let count = |name: &str, value: fn(&Result) -> String| {
        let values = compared.results.iter().map(value);
        std::iter::once(name.to_owned())
            .chain(values)
            .collect::<Vec<_>>()
    };
    let none = || ["".to_owned(), "".to_owned()];
    let rows = [
        count("vehicles placed", |result| {
            format!("{} of {}", result.placed, result.vehicles)
        }),
        count("simulations", |result| result.rollouts.to_string()),
        count("lane changes in a minute", |result| {
            let [recorded, simulated] = result.changes_per_minute().map(shown);
            format!("{simulated} (recorded {recorded})")
        }),
    ];
    for row in rows {
        table.row(row.into_iter().chain(none()));
    }
    table
}

fn displacements(compared: &Compared) -> Table {
    let mut table = Table::new(header(compared, "mean and median, m"));
    for (at, after_s) in AFTER_S.iter().enumerate() {
        let cell = |result: &Result| {
            let sample = &result.displacement[at];
            format!("{} / {}", shown(sample.mean()), shown(sample.quantile(0.5)))
        };
        let cells = compared.results.iter().map(cell);
        table.row(std::iter::once(format!("after {after_s} s")).chain(cells));
    }
    table
}

fn likelihoods(compared: &Compared) -> Table {
    let mut columns = header(compared, "feature");
    columns.insert(1, "weight".into());
    let mut table = Table::new(columns);
    let all: Vec<Vec<_>> = compared
        .results
        .iter()
        .map(|result| result.likelihood.features().collect())
        .collect();
    for (at, (name, weight, _)) in all[0].iter().enumerate() {
        let cells = all.iter().map(|features| shown(features[at].2));
        let named = [(*name).to_owned(), weight.to_string()];
        table.row(named.into_iter().chain(cells));
    }
    let metas = compared
        .results
        .iter()
        .map(|result| shown(result.likelihood.meta()));
    let named = ["meta-metric".to_owned(), "1".to_owned()];
    table.row_that_stands_out(true, named.into_iter().chain(metas));
    table
}

/// Shares of values up to a value, recorded and of each model.
fn curves(compared: &Compared, quantity: Quantity) -> String {
    let at = quantity as usize;
    let mut series = Vec::new();
    for (color, result) in compared.results.iter().enumerate() {
        if color == 0 {
            series.push(Series::curve("recorded", 0, result.recorded[at].curve()));
        }
        let points = result.simulated[at].curve();
        series.push(Series::curve(result.model.name(), color + 1, points));
    }
    Plot {
        title: quantity.name(),
        x: Axis::linear(quantity.name()),
        y: Axis::from_zero("share of values up to it"),
        series,
    }
    .to_svg()
}
