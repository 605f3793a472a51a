//! The stage of a volume: where a package without a rig puts its splats.

use decouplegs_scene::Pose;
use glam::{DMat3, DVec3};

use crate::DecodeError;
use crate::rigid::rigid_pose;
use crate::zip::Archive;

/// Attribute of the volume in a stage.
const VOLUME: &str = "isNuRecVolume";
/// Attribute of its transform: the rows of a matrix behind points, which are rows too.
const TRANSFORM: &str = "matrix4d xformOp:transform = ";
/// Most bytes of a stage.
const BYTES_MAX: u64 = 16 << 20;

/// Pose of the splats in the world of the stage: the identity where no text tells a volume's
/// transform. Notes say what was left out.
///
/// # Errors
/// [`DecodeError`] of an entry that is cut.
pub(super) fn world_from_volume(
    archive: &Archive<'_>,
    notes: &mut Vec<String>,
) -> Result<Pose, DecodeError> {
    for name in archive.names().filter(|name| name.ends_with(".usda")) {
        let text = archive.checked(name, BYTES_MAX)?;
        let text = String::from_utf8_lossy(&text);
        if !text.contains(VOLUME) {
            continue;
        }
        let Some((_, matrix)) = text.split_once(TRANSFORM) else {
            continue;
        };
        if let Some(pose) = pose_of(matrix) {
            return Ok(pose);
        }
        notes.push(format!(
            "{name}: the transform of the volume is no rotation and translation: splats stay in their own frame"
        ));
    }
    Ok(Pose::IDENTITY)
}

/// The pose in `( (a, b, c, 0), ... )`, four rows of four numbers, the last one the translation.
fn pose_of(matrix: &str) -> Option<Pose> {
    let mut numbers = matrix
        .split(|c: char| matches!(c, '(' | ')' | ',') || c.is_whitespace())
        .filter(|word| !word.is_empty())
        .map(str::parse::<f64>);
    let mut row = || -> Option<DVec3> {
        let mut next = || numbers.next()?.ok();
        let row = DVec3::new(next()?, next()?, next()?);
        next()?;
        Some(row)
    };
    let (x, y, z, translation) = (row()?, row()?, row()?, row()?);
    rigid_pose(DMat3::from_cols(x, y, z), translation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rows_of_a_matrix_are_the_images_of_the_axes() {
        let quarter = "( (0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (5, -6.5, 1e0, 1) )\n uniform";
        let pose = pose_of(quarter).unwrap();
        let moved = pose.transform(DVec3::new(2.0, 0.0, 0.0));
        assert!(
            (moved - DVec3::new(5.0, -4.5, 1.0)).length() < 1e-12,
            "{moved}"
        );
        for none in [
            "( (2, 0, 0, 0), (0, 2, 0, 0), (0, 0, 2, 0), (0, 0, 0, 1) )",
            "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, -1, 0), (0, 0, 0, 1) )",
            "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (nan, 0, 0, 1) )",
            "( (1, 0, 0, 0), (0, 1, 0",
            "",
        ] {
            assert_eq!(pose_of(none), None, "{none}");
        }
    }
}
