//! Light and air at the start: time of day, sun, clouds and fog.

use std::f64::consts::TAU;

use decouplegs_asset::DecodeError;

use super::Skipped;
use super::catalogs::Catalogs;
use super::parameters::Node;

/// Light and air, as far as scenes can show them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Environment {
    /// Hour of the day, 0 to 24.
    pub hour: Option<f64>,
    /// Elevation of the sun over the horizon, radians.
    pub sun_rad: Option<f64>,
    /// Share of the sky that clouds cover, 0 to 1.
    pub clouds: Option<f64>,
    /// Distance up to which something is seen, meters, where fog ends it.
    pub visibility_m: Option<f64>,
}

/// Visibility from which on there is no fog, meters: files write 100,000 for clear air.
const CLEAR_M: f64 = 20_000.0;

/// The environment of an `<EnvironmentAction>`; `None` if its catalog is not there.
pub(super) fn read(
    action: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Environment>, DecodeError> {
    if let Some(reference) = action.first("CatalogReference") {
        let found = catalogs.with_entry(reference, skipped, environment)?;
        if found.is_none() {
            skipped.add(reference, "the catalog of its environment was not found");
        }
        return Ok(found);
    }
    environment(action.needed("Environment")?, skipped).map(Some)
}

fn environment(node: Node, skipped: &mut Skipped) -> Result<Environment, DecodeError> {
    let mut found = Environment::default();
    if let Some(time) = node.first("TimeOfDay") {
        let text = time.needed_attribute("dateTime")?;
        found.hour = hour_of(&text);
        if found.hour.is_none() {
            skipped.add(time, "its dateTime is none; expected YYYY-MM-DDThh:mm:ss");
        }
        if time.truth("animation")? {
            skipped.add(time, "the time of day stands still");
        }
    }
    if let Some(weather) = node.first("Weather") {
        found.clouds = clouds(weather)?;
        if let Some(sun) = weather.first("Sun") {
            let sun_rad = sun.number("elevation")?;
            found.sun_rad = (-TAU..=TAU).contains(&sun_rad).then_some(sun_rad);
        }
        if let Some(fog) = weather.first("Fog") {
            let visible_m = fog.number("visualRange")?;
            found.visibility_m = (visible_m < CLEAR_M).then(|| visible_m.max(1.0));
        }
        let falls = weather.first("Precipitation");
        let is_dry = |falls: &Node| falls.is("precipitationType", "dry");
        if let Some(falls) = falls
            && !is_dry(&falls)?
        {
            skipped.add(falls, "rain and snow are not shown");
        }
    }
    if let Some(road) = node.first("RoadCondition")
        && (road.number("frictionScaleFactor")? - 1.0).abs() > 1e-9
    {
        skipped.add(road, "all roads have the same friction");
    }
    Ok(found)
}

/// Share of the sky that clouds cover.
fn clouds(weather: Node) -> Result<Option<f64>, DecodeError> {
    const OKTAS: [&str; 10] = [
        "zeroOktas",
        "oneOktas",
        "twoOktas",
        "threeOktas",
        "fourOktas",
        "fiveOktas",
        "sixOktas",
        "sevenOktas",
        "eightOktas",
        "nineOktas",
    ];
    if let Some(cover) = weather.attribute("fractionalCloudCover")? {
        let oktas = OKTAS.iter().position(|name| *name == cover);
        // Nine oktas: the sky cannot be seen.
        return Ok(oktas.map(|oktas| (oktas as f64 / 8.0).min(1.0)));
    }
    Ok(match weather.attribute("cloudState")?.as_deref() {
        Some("free") => Some(0.0),
        Some("cloudy") => Some(0.5),
        Some("overcast" | "rainy") => Some(1.0),
        _ => None,
    })
}

/// Hour of the day of a date and time, its zone left out.
fn hour_of(date_time: &str) -> Option<f64> {
    let (_, time) = date_time.split_once('T')?;
    let mut parts = time.splitn(3, ':');
    let mut next = || parts.next()?.get(..2)?.parse::<u32>().ok();
    let (hour, minute) = (next()?, next()?);
    (hour < 24 && minute < 60).then(|| f64::from(hour) + f64::from(minute) / 60.0)
}

#[cfg(test)]
mod tests {
    use super::hour_of;

    #[test]
    fn hours_are_those_of_the_place() {
        assert_eq!(hour_of("2020-10-01T18:30:30"), Some(18.5));
        assert_eq!(hour_of("2020-10-01T06:00:00.000+09:00"), Some(6.0));
        for none in [
            "",
            "18:30:30",
            "2020-10-01T",
            "2020-10-01T25:00:00",
            "T\u{e9}:00",
        ] {
            assert_eq!(hour_of(none), None, "{none:?}");
        }
    }
}
