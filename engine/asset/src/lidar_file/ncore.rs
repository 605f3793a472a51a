//! Parameters of a spinning LiDAR as NVIDIA NCore writes them (`row-offset-spinning`), JSON.

use std::f64::consts::{PI, TAU};

use decouplegs_scene::LidarModel;
use decouplegs_scene::lidar::{FiringTime, LidarPattern, LidarRow, ROWS_MAX, ReturnMode, Spin};
use serde::Deserialize;

use crate::DecodeError;

/// Range of returns: the file tells none.
const RANGE_M: [f64; 2] = [0.3, 200.0];

/// Azimuths of columns may differ this much from equal steps, radians.
const STEP_RAD_MAX: f64 = 1e-3;

/// Fields of the model; others of the file are not needed.
#[derive(Deserialize)]
struct Form {
    spinning_frequency_hz: f64,
    spinning_direction: String,
    row_elevations_rad: Vec<f64>,
    column_azimuths_rad: Vec<f64>,
    row_azimuth_offsets_rad: Option<Vec<f64>>,
}

/// The model in the bytes of a JSON file.
pub(super) fn decode(bytes: &[u8]) -> Result<LidarModel, DecodeError> {
    let malformed = |reason: String| Err(DecodeError::Malformed(reason));
    let form: Form = serde_json::from_slice(bytes).map_err(|error| {
        DecodeError::Malformed(format!(
            "not the parameters of a LiDAR of NVIDIA NCore: {error}"
        ))
    })?;
    let (rows, columns) = (
        form.row_elevations_rad.len(),
        form.column_azimuths_rad.len(),
    );
    let offsets = form
        .row_azimuth_offsets_rad
        .unwrap_or_else(|| vec![0.0; rows]);
    if offsets.len() != rows || rows > ROWS_MAX || columns < 2 {
        return malformed(format!(
            "{rows} elevations, {} azimuth offsets and {columns} columns; expected as many offsets as elevations, at most {ROWS_MAX}, and 2 columns or more",
            offsets.len()
        ));
    }
    let (spin, sign) = match form.spinning_direction.as_str() {
        "cw" => (Spin::Clockwise, -1.0),
        "ccw" => (Spin::CounterClockwise, 1.0),
        other => {
            return malformed(format!(
                "spinning_direction is '{other}'; expected cw or ccw"
            ));
        }
    };
    // Azimuths swept since the first column; a step back of less than half a turn is one forward.
    let mut swept = vec![0.0];
    for pair in form.column_azimuths_rad.windows(2) {
        let step = (sign * (pair[1] - pair[0])).rem_euclid(TAU);
        swept.push(swept[swept.len() - 1] + if step > PI { step - TAU } else { step });
    }
    let step_rad = swept[columns - 1] / (columns - 1) as f64;
    let uneven =
        |(column, swept): (usize, &f64)| (swept - step_rad * column as f64).abs() > STEP_RAD_MAX;
    if let Some(column) = swept.iter().enumerate().position(uneven) {
        return malformed(format!(
            "column_azimuths_rad: column {column} is more than {STEP_RAD_MAX} rad from equal steps; list such a sensor as rays in a TOML file"
        ));
    }
    let row = |(index, elevation_rad): (usize, &f64)| LidarRow {
        elevation_rad: *elevation_rad,
        azimuth_offset_rad: offsets[index],
        laser: index as u16,
    };
    Ok(LidarModel {
        name: "ncore".to_owned(),
        pattern: LidarPattern::Spinning {
            rows: form
                .row_elevations_rad
                .iter()
                .enumerate()
                .map(row)
                .collect(),
            columns: columns as u32,
            first_azimuth_rad: form.column_azimuths_rad[0],
            field_rad: (step_rad * columns as f64).min(TAU),
            spin,
            firing_time: FiringTime::Ncore,
        },
        sweep_s: 1.0 / form.spinning_frequency_hz,
        range_m: RANGE_M,
        returns: ReturnMode::Median,
        range_noise_m: 0.0,
    })
}
