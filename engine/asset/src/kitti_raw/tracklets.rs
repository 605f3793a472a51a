//! KITTI's labeled boxes, `tracklet_labels.xml`.

use glam::DVec3;

use crate::DecodeError;
use crate::xml::{Element, parse};

/// Largest coordinate of a box in the frame of the LiDAR, meters.
const COORDINATE_MAX_M: f64 = 1e4;

/// A labeled road user.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracklet {
    /// Class in lower case: car, van, truck, pedestrian, cyclist, ...
    pub class: String,
    /// Length, width and height, meters.
    pub dims_m: [f64; 3],
    /// Index of the first frame.
    pub first_frame: usize,
    /// Middle of the bottom of the box and its heading, frame by frame, in the frame of the LiDAR;
    /// meters and radians.
    pub places: Vec<(DVec3, f64)>,
}

/// Reads labeled boxes.
///
/// # Errors
/// A [`DecodeError`] that names the line and element at fault.
pub fn decode_tracklets(bytes: &[u8]) -> Result<Vec<Tracklet>, DecodeError> {
    let bytes = without_doctype(bytes);
    let document = parse(&bytes)?;
    let root = Element::root(&document, "boost_serialization")?;
    let list = root.needed("tracklets")?;
    list.all("item").map(tracklet).collect()
}

/// `bytes` with blanks for a document type that declares nothing, as KITTI's files have one: others
/// stay, and are refused.
fn without_doctype(bytes: &[u8]) -> Vec<u8> {
    const OPEN: &[u8] = b"<!DOCTYPE";
    let mut bytes = bytes.to_vec();
    let head = bytes.len().min(1024);
    let Some(start) = bytes[..head]
        .windows(OPEN.len())
        .position(|part| part == OPEN)
    else {
        return bytes;
    };
    let end = bytes[start..head]
        .iter()
        .position(|&byte| byte == b'>' || byte == b'[');
    if let Some(end) = end.map(|end| start + end).filter(|&end| bytes[end] == b'>') {
        bytes[start..=end].fill(b' ');
    }
    bytes
}

fn tracklet(item: Element) -> Result<Tracklet, DecodeError> {
    let number = |name: &str| item.needed(name)?.text_number();
    let dims_m = [number("l")?, number("w")?, number("h")?];
    if !dims_m.iter().all(|side_m| (0.01..=100.0).contains(side_m)) {
        return Err(item.fault(format!(
            "a box of {dims_m:?} m; expected 0.01 to 100 m a side"
        )));
    }
    let first = number("first_frame")?;
    if !(first >= 0.0 && first < super::FRAMES_MAX as f64 && first.fract() == 0.0) {
        return Err(item.fault(format!(
            "first_frame is {first}; expected the number of a frame"
        )));
    }
    let place = |pose: Element| {
        let number = |name: &str| pose.needed(name)?.text_number();
        let at = DVec3::new(number("tx")?, number("ty")?, number("tz")?);
        let yaw_rad = number("rz")?;
        if at.abs().max_element() > COORDINATE_MAX_M || yaw_rad.abs() > 100.0 {
            return Err(pose.fault(format!("a box at {at} m, which no LiDAR sees")));
        }
        Ok((at, yaw_rad))
    };
    Ok(Tracklet {
        class: item.needed("objectType")?.text().to_lowercase(),
        dims_m,
        first_frame: first as usize,
        places: item
            .needed("poses")?
            .all("item")
            .map(place)
            .collect::<Result<_, _>>()?,
    })
}
