//! Names under which images can be stored.

use std::collections::{HashMap, HashSet};

use decouplegs_scene::Camera;

/// Longer names are cut; file systems stop at 255 bytes, and an extension follows.
const NAME_CHARS_MAX: usize = 60;

/// The cameras with file-safe names of which no two are the same, even where case does not count.
pub(super) fn made_unique(mut cameras: Vec<Camera>) -> Vec<Camera> {
    let mut taken = HashSet::new();
    // The number that the next camera of the same name tries first, so that a million equal names
    // take linear time.
    let mut next_number: HashMap<String, usize> = HashMap::new();
    for camera in &mut cameras {
        let base = file_safe(&camera.name);
        let number = next_number.entry(base.to_lowercase()).or_insert(1);
        camera.name = loop {
            let name = if *number == 1 {
                base.clone()
            } else {
                format!("{base}_{number}")
            };
            *number += 1;
            if taken.insert(name.to_lowercase()) {
                break name;
            }
        };
    }
    cameras
}

/// Name of the camera of an image that a camera file calls `name`, unless others have it too:
/// without the extension of an image, its other characters letters, digits, `-`, `_` or an inner
/// `.`.
#[must_use]
pub fn file_safe(name: &str) -> String {
    let name = name.trim_start_matches(['.', '/', '\\']);
    let stem = match name.rsplit_once('.') {
        Some((stem, extension)) if is_image_extension(extension) => stem,
        _ => name,
    };
    let allowed = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.');
    let safe: String = stem
        .chars()
        .take(NAME_CHARS_MAX)
        .map(|c| if allowed(c) { c } else { '_' })
        .collect();
    match safe.trim_matches('.') {
        "" => "camera".to_owned(),
        safe => safe.to_owned(),
    }
}

fn is_image_extension(extension: &str) -> bool {
    ["png", "jpg", "jpeg", "webp", "tif", "tiff", "bmp", "exr"]
        .iter()
        .any(|known| extension.eq_ignore_ascii_case(known))
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::Motion;

    #[test]
    fn names_cannot_leave_their_directory() {
        for (name, expected) in [
            ("../../etc/passwd", "etc_passwd"),
            ("a/b\\c.png", "a_b_c"),
            ("frame.0001.JPG", "frame.0001"),
            ("", "camera"),
            ("...", "camera"),
            ("CON\0:x", "CON__x"),
            ("stra\u{df}e", "stra\u{df}e"),
        ] {
            assert_eq!(file_safe(name), expected);
        }
        assert_eq!(file_safe(&"x".repeat(500)).len(), NAME_CHARS_MAX);
    }

    #[test]
    fn equal_names_are_numbered_past_names_that_are_taken() {
        let camera = |name: &str| Camera {
            name: name.into(),
            intrinsics: decouplegs_scene::Intrinsics::from_horizontal_fov(4, 4, 1.0),
            world_from_camera: decouplegs_scene::Pose::IDENTITY,
            motion: Motion::REST,
        };
        let names: Vec<_> = made_unique(["a", "a_2", "A", "a"].map(camera).to_vec())
            .into_iter()
            .map(|c| c.name)
            .collect();
        assert_eq!(names, ["a", "a_2", "A_3", "a_4"]);
    }
}
