//! The TOML form of a LiDAR.

use decouplegs_scene::LidarModel;
use decouplegs_scene::lidar::{
    BEAMS_MAX, Beam, FiringTime, LidarPattern, LidarRow, ROWS_MAX, ReturnMode, Spin,
};
use glam::DVec3;
use serde::Deserialize;

use crate::toml_text::{syntax_error, text_of};
use crate::{DecodeError, SceneError};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Form {
    name: String,
    row_elevations_deg: Option<Vec<f64>>,
    row_azimuth_offsets_deg: Option<Vec<f64>>,
    row_ids: Option<Vec<u16>>,
    columns: Option<u32>,
    first_azimuth_deg: Option<f64>,
    field_deg: Option<f64>,
    direction: Option<String>,
    firing_time: Option<String>,
    rays: Option<Vec<[f64; 4]>>,
    rate_hz: f64,
    range_m: [f64; 2],
    returns: Option<String>,
    #[serde(default)]
    range_noise_m: f64,
}

fn malformed<T>(reason: String) -> Result<T, DecodeError> {
    Err(DecodeError::Malformed(reason))
}

/// The model in the bytes of a TOML file.
pub(super) fn decode(bytes: &[u8]) -> Result<LidarModel, DecodeError> {
    let malformed = |error: SceneError| DecodeError::Malformed(error.to_string());
    let text = text_of(bytes).map_err(malformed)?;
    let form: Form = toml::from_str(text).map_err(|error| malformed(syntax_error(text, &error)))?;
    Ok(LidarModel {
        pattern: match &form.rays {
            Some(rays) => form.explicit(rays)?,
            None => form.spinning()?,
        },
        sweep_s: 1.0 / form.rate_hz,
        range_m: form.range_m,
        returns: named("returns", form.returns.as_deref(), &ReturnMode::NAMED)?.unwrap_or_default(),
        range_noise_m: form.range_noise_m,
        name: form.name,
    })
}

/// The value that `names` have for `found`; `None` where it is left out.
fn named<T: Copy>(
    key: &str,
    found: Option<&str>,
    names: &[(&str, T)],
) -> Result<Option<T>, DecodeError> {
    let Some(found) = found else {
        return Ok(None);
    };
    match names.iter().find(|(name, _)| *name == found) {
        Some((_, value)) => Ok(Some(*value)),
        None => {
            let known: Vec<&str> = names.iter().map(|(name, _)| *name).collect();
            malformed(format!(
                "{key} is '{found}'; expected {}",
                known.join(" or ")
            ))
        }
    }
}

impl Form {
    fn spinning(&self) -> Result<LidarPattern, DecodeError> {
        let (Some(elevations), Some(columns)) = (&self.row_elevations_deg, self.columns) else {
            return malformed(
                "row_elevations_deg or columns is missing; expected both, or rays".to_owned(),
            );
        };
        let count = elevations.len();
        if count > ROWS_MAX {
            return malformed(format!("{count} rows; expected at most {ROWS_MAX}"));
        }
        let fits = |key: &str, found: Option<usize>| match found {
            Some(found) if found != count => malformed(format!(
                "{key} has {found} values, row_elevations_deg {count}; expected as many"
            )),
            _ => Ok(()),
        };
        let (offsets, ids) = (&self.row_azimuth_offsets_deg, &self.row_ids);
        fits("row_azimuth_offsets_deg", offsets.as_ref().map(Vec::len))?;
        fits("row_ids", ids.as_ref().map(Vec::len))?;
        let row = |(index, elevation_deg): (usize, &f64)| LidarRow {
            elevation_rad: elevation_deg.to_radians(),
            azimuth_offset_rad: offsets
                .as_ref()
                .map_or(0.0, |offsets| offsets[index].to_radians()),
            laser: ids.as_ref().map_or(index as u16, |ids| ids[index]),
        };
        let spins = [("cw", Spin::Clockwise), ("ccw", Spin::CounterClockwise)];
        let times = [
            ("middle", FiringTime::Middle),
            ("start", FiringTime::Start),
            ("ncore", FiringTime::Ncore),
        ];
        Ok(LidarPattern::Spinning {
            rows: elevations.iter().enumerate().map(row).collect(),
            columns,
            first_azimuth_rad: self.first_azimuth_deg.unwrap_or(180.0).to_radians(),
            field_rad: self.field_deg.unwrap_or(360.0).to_radians(),
            spin: named("direction", self.direction.as_deref(), &spins)?.unwrap_or(Spin::Clockwise),
            firing_time: named("firing_time", self.firing_time.as_deref(), &times)?
                .unwrap_or_default(),
        })
    }

    fn explicit(&self, rays: &[[f64; 4]]) -> Result<LidarPattern, DecodeError> {
        let spinning = [
            ("row_elevations_deg", self.row_elevations_deg.is_some()),
            (
                "row_azimuth_offsets_deg",
                self.row_azimuth_offsets_deg.is_some(),
            ),
            ("row_ids", self.row_ids.is_some()),
            ("columns", self.columns.is_some()),
            ("first_azimuth_deg", self.first_azimuth_deg.is_some()),
            ("field_deg", self.field_deg.is_some()),
            ("direction", self.direction.is_some()),
            ("firing_time", self.firing_time.is_some()),
        ];
        if let Some((key, _)) = spinning.iter().find(|(_, given)| *given) {
            return malformed(format!("both rays and {key}; expected one of the two"));
        }
        if rays.len() > BEAMS_MAX {
            return malformed(format!("{} rays; expected at most {BEAMS_MAX}", rays.len()));
        }
        let beam = |(index, &[azimuth_deg, elevation_deg, offset_us, ring]): (usize, &[f64; 4])| {
            if !(ring.fract() == 0.0 && (0.0..ROWS_MAX as f64).contains(&ring)) {
                return malformed(format!(
                    "ray {index} has ring {ring}; expected a whole number below {ROWS_MAX}"
                ));
            }
            let (sin, cos) = azimuth_deg.to_radians().sin_cos();
            let (up, level) = elevation_deg.to_radians().sin_cos();
            Ok(Beam {
                direction: DVec3::new(level * cos, level * sin, up),
                time_s: 1e-6 * offset_us,
                ring: ring as u16,
                laser: ring as u16,
                column: index as u32,
            })
        };
        let beams: Result<Vec<Beam>, DecodeError> = rays.iter().enumerate().map(beam).collect();
        Ok(LidarPattern::Rays(beams?))
    }
}
