//! Tracks of road users: tables as CSV or JSON, CommonRoad scenarios, and scenes of nuScenes; and
//! poses, which are written as such tables.
//!
//! Positions are centers of boxes, world coordinates in meters. Where a file tells length and width
//! but no height, the height is [`nominal_height_m`]'s: no measurement, but a box needs one.

pub mod commonroad;
pub mod nuscenes;
mod poses;
pub mod table;

use std::path::Path;

use decouplegs_scene::{Invalid, Track};

use crate::error::read_bytes;
use crate::{AssetError, DecodeError};

pub use poses::{PoseRow, encode_poses, write_poses};

/// The forms of files with tracks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackFormat {
    /// A row for each road user and moment, see [`table`].
    Csv,
    /// Array of objects with the fields of those rows.
    Json,
    /// CommonRoad scenario.
    CommonRoad,
}

impl TrackFormat {
    /// Name of the format for users.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "CSV table of tracks",
            Self::Json => "JSON table of tracks",
            Self::CommonRoad => "CommonRoad",
        }
    }

    /// The form of `bytes`, told by their first character; whatever is neither XML nor JSON is CSV.
    ///
    /// # Errors
    /// A sentence on what was found.
    pub fn detect(bytes: &[u8]) -> Result<Self, Invalid> {
        let text = bytes
            .strip_prefix(b"\xef\xbb\xbf")
            .unwrap_or(bytes)
            .trim_ascii_start();
        match text.first() {
            None => Err("the file is empty".into()),
            Some(b'<') => Ok(Self::CommonRoad),
            Some(b'[') => Ok(Self::Json),
            Some(b'{') => Err("a JSON object".into()),
            Some(_) => Ok(Self::Csv),
        }
    }
}

/// Reads the tracks of a file, whose format is detected from its content, or of a nuScenes scene
/// (`FOLDER/SCENE`, or the folder if it has one scene).
///
/// # Errors
/// [`AssetError::Read`], [`AssetError::Unrecognized`] or [`AssetError::Decode`].
pub fn read_tracks(path: &Path) -> Result<Vec<Track>, AssetError> {
    if let Some((folder, scene)) = nuscenes::located(path) {
        return nuscenes::read(folder, scene);
    }
    let bytes = read_bytes(path)?;
    let format = TrackFormat::detect(&bytes).map_err(|found| AssetError::Unrecognized {
        path: path.to_owned(),
        found: found.into(),
        expected: "tracks: a CSV table with a line of names, a JSON array of rows, a CommonRoad scenario, or FOLDER/SCENE of nuScenes",
    })?;
    decode(&bytes, format).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: format.name(),
        source,
    })
}

/// Reads tracks from the bytes of a file.
///
/// # Errors
/// A [`DecodeError`] that names the line, row or element at fault.
pub fn decode(bytes: &[u8], format: TrackFormat) -> Result<Vec<Track>, DecodeError> {
    match format {
        TrackFormat::Csv => table::decode_csv(bytes),
        TrackFormat::Json => table::decode_json(bytes),
        TrackFormat::CommonRoad => commonroad::decode(bytes),
    }
}

/// The height taken for a road user of `class` of which none is known, meters: that of a usual one
/// of its kind.
#[must_use]
pub fn nominal_height_m(class: &str) -> f64 {
    match class {
        "truck" | "bus" | "tram" | "train" => 3.2,
        "van" => 2.2,
        "pedestrian" | "person" | "bicycle" | "cyclist" => 1.75,
        _ => 1.5,
    }
}

/// `tracks` as they are, if there are any and each is one.
fn finished(tracks: Vec<Track>) -> Result<Vec<Track>, DecodeError> {
    if tracks.is_empty() {
        return Err(DecodeError::Malformed(
            "the file holds no track; expected at least one".into(),
        ));
    }
    tracks
        .iter()
        .try_for_each(Track::check)
        .map_err(|error| DecodeError::Malformed(error.into()))?;
    Ok(tracks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_are_told_by_content_and_errors_name_the_file() {
        assert_eq!(TrackFormat::detect(b"t,id,x,y"), Ok(TrackFormat::Csv));
        assert_eq!(
            TrackFormat::detect("\u{feff} [".as_bytes()),
            Ok(TrackFormat::Json)
        );
        assert_eq!(
            TrackFormat::detect(b"<commonRoad>"),
            Ok(TrackFormat::CommonRoad)
        );
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.csv");
        assert!(
            read_tracks(&path)
                .unwrap_err()
                .to_string()
                .contains("a.csv")
        );
        for (text, part) in [
            ("", "is empty"),
            ("{}", "JSON array of rows"),
            ("[]", "no track"),
            ("t,id,x\n", "'y'"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = read_tracks(&path).unwrap_err().to_string();
            assert!(
                error.contains("a.csv") && error.contains(part),
                "{text}: {error}"
            );
        }
    }
}
