//! Sweeps of Argoverse 2: an Arrow table in a file of Feather version 2.

use std::sync::Arc;

use arrow_array::{ArrayRef, Float16Array, Int32Array, RecordBatch, UInt8Array};
use arrow_ipc::writer::FileWriter;
use decouplegs_asset::EncodeError;
use decouplegs_scene::lidar::LidarPoint;
use half::f16;

use super::intensity_byte;

/// The bytes of the file.
pub(super) fn encode(points: &[LidarPoint]) -> Result<Vec<u8>, EncodeError> {
    let axis = |axis: usize| -> ArrayRef {
        let value = |point: &LidarPoint| f16::from_f64(point.position_m[axis]);
        Arc::new(Float16Array::from_iter_values(points.iter().map(value)))
    };
    if let Some(point) = points
        .iter()
        .find(|point| point.beam.laser > u16::from(u8::MAX))
    {
        return Err(EncodeError(format!(
            "laser {} does not fit the 8 bits of laser_number; choose another format",
            point.beam.laser
        )));
    }
    let farthest_m = points
        .iter()
        .map(|point| point.position_m.abs().max_element());
    if farthest_m.fold(0.0, f64::max) > f16::MAX.to_f64() {
        return Err(EncodeError(
            "points are too far from the origin for 16-bit floats; choose the frame of the vehicle"
                .to_owned(),
        ));
    }
    let intensities = UInt8Array::from_iter_values(points.iter().map(intensity_byte));
    let lasers = UInt8Array::from_iter_values(points.iter().map(|point| point.beam.laser as u8));
    let offsets =
        Int32Array::from_iter_values(points.iter().map(|point| point.beam.offset_ns() as i32));
    let failed = |error: arrow_schema::ArrowError| EncodeError(error.to_string());
    let table = RecordBatch::try_from_iter([
        ("x", axis(0)),
        ("y", axis(1)),
        ("z", axis(2)),
        ("intensity", Arc::new(intensities) as ArrayRef),
        ("laser_number", Arc::new(lasers)),
        ("offset_ns", Arc::new(offsets)),
    ])
    .map_err(failed)?;
    let mut bytes = Vec::new();
    let mut writer = FileWriter::try_new(&mut bytes, &table.schema()).map_err(failed)?;
    writer.write(&table).map_err(failed)?;
    writer.finish().map_err(failed)?;
    drop(writer);
    Ok(bytes)
}
