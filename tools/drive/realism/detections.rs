//! Detections in photographs and in rendered images.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

/// Overlap from which two boxes are of one object.
const SAME_IOU: f64 = 0.5;

/// A box that a detector found.
#[derive(Clone, Debug, PartialEq)]
struct Detection {
    /// Left, top, width, height, pixels.
    rectangle: [f64; 4],
    score: f64,
}

/// Detections by image and class.
type Detections = BTreeMap<(String, String), Vec<Detection>>;

/// Agreement of detections in rendered images with those in photographs.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreement {
    /// Detections in photographs.
    pub wanted: usize,
    /// Detections in rendered images.
    pub found: usize,
    /// Pairs of one class whose boxes overlap by half or more.
    pub matched: usize,
    /// Mean score of the rendered one of a pair less that of the other; 0 without pairs.
    pub score_shift: f64,
    /// Mean overlap of pairs; 0 without pairs.
    pub iou: f64,
}

impl Agreement {
    /// Agreement of two files of COCO results: a list of `image_id`, `category_id`, `bbox` and
    /// `score`.
    ///
    /// # Errors
    /// Returns an error if a file is no such list.
    pub fn between(photographs: &Path, rendered: &Path) -> Result<Self> {
        let (wanted, mut found) = (read(photographs)?, read(rendered)?);
        let count = |detections: &Detections| detections.values().map(Vec::len).sum();
        let mut agreement = Self {
            wanted: count(&wanted),
            found: count(&found),
            matched: 0,
            score_shift: 0.0,
            iou: 0.0,
        };
        for (of, wanted) in &wanted {
            let Some(found) = found.get_mut(of) else {
                continue;
            };
            for one in wanted {
                let overlaps = found
                    .iter()
                    .map(|other| iou(&one.rectangle, &other.rectangle));
                let best = overlaps.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
                if let Some((index, iou)) = best.filter(|(_, iou)| *iou >= SAME_IOU) {
                    let other = found.swap_remove(index);
                    agreement.matched += 1;
                    agreement.iou += iou;
                    agreement.score_shift += other.score - one.score;
                }
            }
        }
        if agreement.matched > 0 {
            agreement.iou /= agreement.matched as f64;
            agreement.score_shift /= agreement.matched as f64;
        }
        Ok(agreement)
    }

    /// Share of the detections in photographs that are found in rendered images too; `None` of
    /// none.
    pub fn recall(&self) -> Option<f64> {
        (self.wanted > 0).then(|| self.matched as f64 / self.wanted as f64)
    }

    pub fn to_json(&self) -> Value {
        json!({
            "in_photographs": self.wanted,
            "in_rendered": self.found,
            "matched": self.matched,
            "recall": self.recall(),
            "score_shift": self.score_shift,
            "mean_iou": self.iou,
        })
    }
}

/// Overlap of two rectangles: their intersection over their union.
fn iou(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    let along = |at: usize| (a[at] + a[at + 2]).min(b[at] + b[at + 2]) - a[at].max(b[at]);
    let both = along(0).max(0.0) * along(1).max(0.0);
    let either = a[2] * a[3] + b[2] * b[3] - both;
    if either > 0.0 { both / either } else { 0.0 }
}

/// The detections of `file`, those with the highest scores first.
fn read(file: &Path) -> Result<Detections> {
    let text =
        fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let list: Value =
        serde_json::from_str(&text).with_context(|| format!("{} is no JSON", file.display()))?;
    let expected = || {
        format!(
            "{}: expected COCO results, a list of image_id, category_id, bbox and score",
            file.display()
        )
    };
    let mut detections = Detections::new();
    for (index, one) in list.as_array().with_context(expected)?.iter().enumerate() {
        let detection = detection(one);
        let fault = || format!("{}; entry {index} is none", expected());
        let (of, detection) = detection.with_context(fault)?;
        ensure!(
            detection.rectangle.iter().all(|value| value.is_finite())
                && detection.score.is_finite(),
            "{}: entry {index} has a number that is not finite",
            file.display()
        );
        detections.entry(of).or_default().push(detection);
    }
    for list in detections.values_mut() {
        list.sort_by(|a, b| b.score.total_cmp(&a.score));
    }
    Ok(detections)
}

/// Image, class and box of an entry.
fn detection(entry: &Value) -> Option<((String, String), Detection)> {
    let name = |key: &str| match entry.get(key)? {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    };
    let bbox = entry.get("bbox")?.as_array()?;
    let numbers: Vec<f64> = bbox.iter().filter_map(Value::as_f64).collect();
    Some((
        (name("image_id")?, name("category_id")?),
        Detection {
            rectangle: numbers.try_into().ok()?,
            score: entry.get("score")?.as_f64()?,
        },
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(folder: &Path, name: &str, text: &str) -> std::path::PathBuf {
        let path = folder.join(name);
        fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn boxes_of_one_class_and_image_are_matched_once() {
        let folder = tempfile::tempdir().unwrap();
        let photographs = written(
            folder.path(),
            "a.json",
            r#"[{"image_id": 1, "category_id": 3, "bbox": [0, 0, 10, 10], "score": 0.9},
                {"image_id": 1, "category_id": 3, "bbox": [1, 0, 10, 10], "score": 0.8},
                {"image_id": 2, "category_id": 3, "bbox": [0, 0, 10, 10], "score": 0.7}]"#,
        );
        let rendered = written(
            folder.path(),
            "b.json",
            r#"[{"image_id": 1, "category_id": 3, "bbox": [0, 0, 10, 8], "score": 0.7},
                {"image_id": 2, "category_id": 4, "bbox": [0, 0, 10, 10], "score": 0.7}]"#,
        );
        let found = Agreement::between(&photographs, &rendered).unwrap();
        assert_eq!((found.wanted, found.found, found.matched), (3, 2, 1));
        assert!((found.iou - 0.8).abs() < 1e-12 && (found.score_shift + 0.2).abs() < 1e-12);
        assert_eq!(found.recall(), Some(1.0 / 3.0));
        let same = Agreement::between(&photographs, &photographs).unwrap();
        assert_eq!((same.matched, same.iou, same.score_shift), (3, 1.0, 0.0));
    }

    #[test]
    fn other_files_are_refused_with_what_is_expected() {
        let folder = tempfile::tempdir().unwrap();
        let good = written(folder.path(), "good.json", "[]");
        for text in [
            "{}",
            "[1]",
            "nonsense",
            r#"[{"image_id": 1, "bbox": [1, 2]}]"#,
        ] {
            let bad = written(folder.path(), "bad.json", text);
            let error = format!("{:#}", Agreement::between(&good, &bad).unwrap_err());
            assert!(error.contains("bad.json"), "{error}");
        }
        assert_eq!(Agreement::between(&good, &good).unwrap().recall(), None);
    }
}
