//! Points of a survey as a ground.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use decouplegs::asset::read_bytes;
use decouplegs::drive::Survey;
use decouplegs::scene::SplatCloud;
use glam::DVec3;

/// A table of x, y and z in meters, one point a line below a line of these names, as round splats
/// about their first point.
pub fn read(path: &Path) -> Result<(SplatCloud, DVec3)> {
    let text = String::from_utf8(read_bytes(path)?)
        .with_context(|| format!("{} is not UTF-8", path.display()))?;
    parse(&text).with_context(|| format!("{} is no table of points", path.display()))
}

fn parse(text: &str) -> Result<(SplatCloud, DVec3)> {
    let mut lines = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty());
    let header = lines
        .next()
        .context("it is empty; expected a first line of x,y,z")?
        .1;
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    let column = |name: &str| {
        names
            .iter()
            .position(|found| found.trim_end_matches("_m") == name)
    };
    let (Some(x), Some(y), Some(z)) = (column("x"), column("y"), column("z")) else {
        bail!("line 1 names the columns {header:?}; expected x, y and z among them");
    };
    let mut points: Vec<DVec3> = Vec::new();
    for (at, line) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let number = |column: usize| {
            cells
                .get(column)
                .and_then(|cell| cell.parse().ok())
                .filter(|number: &f64| number.is_finite())
        };
        let (Some(x), Some(y), Some(z)) = (number(x), number(y), number(z)) else {
            bail!(
                "line {}: {line:?}; expected a number in each of x, y and z",
                at + 1
            );
        };
        points.push(DVec3::new(x, y, z));
    }
    ensure!(!points.is_empty(), "it has no points below its first line");
    let origin = points[0];
    let survey = Survey { points_m: points };
    Ok((survey.cloud(origin), origin))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_keep_their_places_and_lines_at_fault_are_named() {
        let (cloud, origin) =
            parse("z_m, name ,x,y\n1.5,a,500000.25,7\n2,b,500001.25,8\n\n").unwrap();
        assert_eq!(
            (cloud.means[1], origin),
            ([1.0, 1.0, 0.5], DVec3::new(500_000.25, 7.0, 1.5))
        );
        let said = |text: &str| format!("{:#}", parse(text).unwrap_err());
        assert!(
            said("").contains("empty")
                && said("x,y\n1,2").contains("x, y and z")
                && said("x,y,z\n").contains("no points")
        );
        assert!(
            said("x,y,z\n1,2,3\n1,two,3").contains("line 3")
                && said("x,y,z\n1,2,inf").contains("line 2")
        );
    }
}
