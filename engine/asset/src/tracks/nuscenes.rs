//! Tracks of a scene of nuScenes: the annotated boxes of a folder of tables (`v1.0-mini`,
//! `v1.0-trainval`), in its global coordinates.
//!
//! Read are `scene.json`, `sample.json`, `instance.json`, `category.json` and
//! `sample_annotation.json` (Caesar et al., "nuScenes: A multimodal dataset for autonomous
//! driving", 2020, and the schema of its development kit). Times are seconds after the scene's
//! first sample. A track is named by its instance token; its class is the second word of
//! its category's name: `car` of `vehicle.car`.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use decouplegs_scene::{Track, TrackPoint};
use glam::{DQuat, DVec2, DVec3};
use serde::Deserialize;

use super::finished;
use crate::error::read_bytes;
use crate::xml::excerpt;
use crate::{AssetError, DecodeError};

/// The table that tells a folder of nuScenes from others.
const ANNOTATIONS: &str = "sample_annotation.json";
/// Scenes that an error names.
const SHOWN_SCENES: usize = 8;

/// Row of `scene.json`.
#[derive(Deserialize)]
pub(crate) struct Scene<'a> {
    #[serde(borrow)]
    pub(crate) token: Cow<'a, str>,
    #[serde(borrow)]
    pub(crate) name: Cow<'a, str>,
}

/// Row of `sample.json`.
#[derive(Deserialize)]
pub(crate) struct Sample<'a> {
    #[serde(borrow)]
    pub(crate) token: Cow<'a, str>,
    #[serde(borrow)]
    pub(crate) scene_token: Cow<'a, str>,
    /// Time of the sample, microseconds.
    pub(crate) timestamp: i64,
}

#[derive(Deserialize)]
struct Instance<'a> {
    #[serde(borrow)]
    token: Cow<'a, str>,
    #[serde(borrow)]
    category_token: Cow<'a, str>,
}

#[derive(Deserialize)]
struct Category<'a> {
    #[serde(borrow)]
    token: Cow<'a, str>,
    #[serde(borrow)]
    name: Cow<'a, str>,
}

#[derive(Deserialize)]
struct Annotation<'a> {
    #[serde(borrow)]
    sample_token: Cow<'a, str>,
    #[serde(borrow)]
    instance_token: Cow<'a, str>,
    /// Center of the box, meters.
    translation: [f64; 3],
    /// Width, length and height, meters.
    size: [f64; 3],
    /// Quaternion w, x, y, z.
    rotation: [f64; 4],
}

/// Folder and scene that `path` names: a folder with the tables, or the name of a scene below it.
/// `None` if it is neither.
pub(super) fn located(path: &Path) -> Option<(&Path, Option<&str>)> {
    let is_folder = |folder: &Path| folder.join(ANNOTATIONS).is_file();
    if is_folder(path) {
        return Some((path, None));
    }
    let scene = path.file_name()?.to_str()?;
    let folder = path.parent().filter(|folder| is_folder(folder))?;
    (!path.exists()).then_some((folder, Some(scene)))
}

/// Reads the tracks of a scene; of the only one if `scene` is `None`.
///
/// # Errors
/// [`AssetError::Read`], or [`AssetError::Decode`] with the table at fault.
pub(super) fn read(folder: &Path, scene: Option<&str>) -> Result<Vec<Track>, AssetError> {
    let table = |name: &str| read_bytes(&folder.join(name));
    let tables = Tables {
        scenes: &table("scene.json")?,
        samples: &table("sample.json")?,
        instances: &table("instance.json")?,
        categories: &table("category.json")?,
        annotations: &table(ANNOTATIONS)?,
    };
    decode(&tables, scene).map_err(|source| AssetError::Decode {
        path: folder.to_owned(),
        format: "nuScenes",
        source,
    })
}

/// Bytes of the tables.
pub struct Tables<'a> {
    /// Content of `scene.json`.
    pub scenes: &'a [u8],
    /// Content of `sample.json`.
    pub samples: &'a [u8],
    /// Content of `instance.json`.
    pub instances: &'a [u8],
    /// Content of `category.json`.
    pub categories: &'a [u8],
    /// Content of `sample_annotation.json`.
    pub annotations: &'a [u8],
}

/// Reads the tracks of a scene from the bytes of the tables; of the only one if `scene` is `None`.
///
/// # Errors
/// A [`DecodeError`] that names the table and line, or the token, at fault.
pub fn decode(tables: &Tables, scene: Option<&str>) -> Result<Vec<Track>, DecodeError> {
    finished(boxes_of(tables, scene)?)
}

/// Tracks of a scene, as [`decode`] reads them; none where nothing is annotated.
///
/// # Errors
/// Errors of [`decode`].
pub(crate) fn decode_annotated(
    tables: &Tables,
    scene: Option<&str>,
) -> Result<Vec<Track>, DecodeError> {
    let tracks = boxes_of(tables, scene)?;
    match tracks.is_empty() {
        true => Ok(tracks),
        false => finished(tracks),
    }
}

fn boxes_of(tables: &Tables, scene: Option<&str>) -> Result<Vec<Track>, DecodeError> {
    let scenes: Vec<Scene> = rows(tables.scenes, "scene.json")?;
    let scene = chosen(&scenes, scene)?;
    let samples: Vec<Sample> = rows(tables.samples, "sample.json")?;
    let times: HashMap<&str, i64> = samples
        .iter()
        .filter(|sample| sample.scene_token == scene.token)
        .map(|sample| (sample.token.as_ref(), sample.timestamp))
        .collect();
    let start = times.values().copied().min().unwrap_or_default();
    let categories: Vec<Category> = rows(tables.categories, "category.json")?;
    let names: HashMap<&str, &str> = categories
        .iter()
        .map(|category| (category.token.as_ref(), category.name.as_ref()))
        .collect();
    let instances: Vec<Instance> = rows(tables.instances, "instance.json")?;
    let category_of: HashMap<&str, &str> = instances
        .iter()
        .map(|instance| (instance.token.as_ref(), instance.category_token.as_ref()))
        .collect();
    let annotations: Vec<Annotation> = rows(tables.annotations, ANNOTATIONS)?;
    let mut tracks: Vec<Track> = Vec::new();
    let mut by_instance: HashMap<&str, usize> = HashMap::new();
    for annotation in &annotations {
        let Some(&timestamp) = times.get(annotation.sample_token.as_ref()) else {
            continue;
        };
        let token = annotation.instance_token.as_ref();
        let index = *by_instance.entry(token).or_insert(tracks.len());
        if index == tracks.len() {
            let category = category_of.get(token).and_then(|token| names.get(token));
            let category = category.ok_or_else(|| {
                DecodeError::Malformed(format!(
                    "the instance {} has no category in instance.json and category.json",
                    excerpt(token)
                ))
            })?;
            let [width_m, length_m, height_m] = annotation.size;
            tracks.push(Track {
                id: token.to_owned(),
                class: class_of(category).to_owned(),
                dims_m: Some([length_m, width_m, height_m]),
                points: Vec::new(),
            });
        }
        let [w, x, y, z] = annotation.rotation;
        let ahead = DQuat::from_xyzw(x, y, z, w) * DVec3::X;
        let [x_m, y_m, z_m] = annotation.translation;
        tracks[index].points.push(TrackPoint {
            // Differences of integers: large timestamps lose no digit.
            time_s: (timestamp.saturating_sub(start)) as f64 * 1e-6,
            position_m: DVec2::new(x_m, y_m),
            z_m: Some(z_m),
            yaw_rad: Some(ahead.y.atan2(ahead.x)),
        });
    }
    for track in &mut tracks {
        track.points.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    }
    Ok(tracks)
}

/// The scene with a name or, counted from 0, at a place of the table; or the only one.
pub(crate) fn chosen<'a>(
    scenes: &'a [Scene<'a>],
    name: Option<&str>,
) -> Result<&'a Scene<'a>, DecodeError> {
    let found = match (name, scenes) {
        (Some(name), _) => {
            let named = scenes.iter().find(|scene| scene.name == name);
            let counted = || scenes.get(name.parse::<usize>().ok()?);
            named.or_else(counted)
        }
        (None, [only]) => Some(only),
        (None, _) => None,
    };
    found.ok_or_else(|| {
        let names: Vec<String> = scenes
            .iter()
            .take(SHOWN_SCENES)
            .map(|scene| excerpt(&scene.name))
            .collect();
        DecodeError::Malformed(format!(
            "{} scenes ({}{}); expected the name of one, or its place counted from 0",
            scenes.len(),
            names.join(", "),
            if scenes.len() > SHOWN_SCENES {
                ", ..."
            } else {
                ""
            }
        ))
    })
}

/// Rows of a table.
pub(crate) fn rows<'a, T: Deserialize<'a>>(
    bytes: &'a [u8],
    table: &str,
) -> Result<Vec<T>, DecodeError> {
    serde_json::from_slice(bytes)
        .map_err(|error| DecodeError::Malformed(format!("{table}: {error}")))
}

/// Class of a category: its second word (`vehicle.bus.bendy`, `human.pedestrian.adult`).
fn class_of(category: &str) -> &str {
    let mut words = category.split('.');
    let (first, second) = (words.next().unwrap_or_default(), words.next());
    second.unwrap_or(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENES: &str =
        r#"[{"token": "s1", "name": "scene-0001"}, {"token": "s2", "name": "scene-0002"}]"#;
    const SAMPLES: &str = r#"[{"token": "a", "scene_token": "s1", "timestamp": 1532402927647951},
        {"token": "b", "scene_token": "s1", "timestamp": 1532402928147847},
        {"token": "c", "scene_token": "s2", "timestamp": 1}]"#;
    const INSTANCES: &str =
        r#"[{"token": "i", "category_token": "car"}, {"token": "j", "category_token": "adult"}]"#;
    const CATEGORIES: &str = r#"[{"token": "car", "name": "vehicle.car", "description": ""},
        {"token": "adult", "name": "human.pedestrian.adult"}]"#;
    const BOXES: &str = r#"[
        {"token": "2", "sample_token": "b", "instance_token": "i", "translation": [11, 2, 1], "size": [1.9, 4.6, 1.7],
         "rotation": [0.7071067811865476, 0, 0, 0.7071067811865476], "prev": "1", "next": ""},
        {"token": "1", "sample_token": "a", "instance_token": "i", "translation": [10, 2, 1], "size": [1.9, 4.6, 1.7],
         "rotation": [1, 0, 0, 0]},
        {"token": "3", "sample_token": "a", "instance_token": "j", "translation": [0, 0, 1], "size": [0.6, 0.7, 1.8],
         "rotation": [1, 0, 0, 0]},
        {"token": "4", "sample_token": "c", "instance_token": "j", "translation": [0, 0, 1], "size": [0.6, 0.7, 1.8],
         "rotation": [1, 0, 0, 0]}]"#;

    fn tables(boxes: &str) -> Tables<'_> {
        Tables {
            scenes: SCENES.as_bytes(),
            samples: SAMPLES.as_bytes(),
            instances: INSTANCES.as_bytes(),
            categories: CATEGORIES.as_bytes(),
            annotations: boxes.as_bytes(),
        }
    }

    #[test]
    fn boxes_of_a_scene_are_tracks() {
        let tracks = decode(&tables(BOXES), Some("scene-0001")).unwrap();
        let [car, walker] = tracks.as_slice() else {
            panic!("{tracks:?}");
        };
        assert_eq!((car.id.as_str(), car.class.as_str()), ("i", "car"));
        assert_eq!(car.dims_m, Some([4.6, 1.9, 1.7]));
        assert_eq!(car.points.len(), 2);
        assert_eq!(
            (car.points[0].time_s, car.points[0].yaw_rad),
            (0.0, Some(0.0))
        );
        assert!((car.points[1].time_s - 0.499_896).abs() < 1e-9);
        let yaw_rad = car.points[1].yaw_rad.unwrap();
        assert!((yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(
            (walker.class.as_str(), walker.points.len()),
            ("pedestrian", 1)
        );
    }

    #[test]
    fn faults_name_the_table_or_the_scenes() {
        let fault = |boxes: &str, scene| decode(&tables(boxes), scene).unwrap_err().to_string();
        for (boxes, scene, part) in [
            (BOXES, None, "2 scenes (scene-0001, scene-0002)"),
            (BOXES, Some("scene-0009"), "expected the name of one"),
            (
                "[{}]",
                Some("scene-0001"),
                "sample_annotation.json: missing field",
            ),
            ("[]", Some("scene-0001"), "no track"),
        ] {
            let message = fault(boxes, scene);
            assert!(message.contains(part), "{part}: {message}");
        }
        let unknown = BOXES.replace("\"instance_token\": \"j\"", "\"instance_token\": \"k\"");
        assert!(fault(&unknown, Some("scene-0001")).contains("instance k has no category"));
        let infinite = BOXES.replace("[10, 2, 1]", "[1e999, 2, 1]");
        assert!(!fault(&infinite, Some("scene-0001")).is_empty());
    }
}
