//! Detections in photographs and in rendered images.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use super::gap::{Gap, Statistic};

/// Overlap from which two boxes are of one object.
const SAME_IOU: f64 = 0.5;

/// A box that a detector found.
#[derive(Clone, Debug, PartialEq)]
struct Detection {
    /// Left, top, width, height, pixels.
    rectangle: [f64; 4],
    score: f64,
}

/// Detections by image and class, those with the highest scores first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Detections(BTreeMap<(String, String), Vec<Detection>>);

impl Detections {
    /// The detections of a file of COCO results: a list of `image_id`, `category_id`, `bbox` and
    /// `score`.
    ///
    /// # Errors
    /// Returns an error if the file is no such list.
    pub fn read(file: &Path) -> Result<Self> {
        let text =
            fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        let list: Value = serde_json::from_str(&text)
            .with_context(|| format!("{} is no JSON", file.display()))?;
        let mut detections = Self::default();
        detections
            .add(&list, |entry| name(entry, "image_id"))
            .with_context(|| format!("{} cannot be used", file.display()))?;
        Ok(detections)
    }

    /// Adds a list of entries with `category_id`, `bbox` and `score`, each of the image that
    /// `image_of` names.
    ///
    /// # Errors
    /// Returns an error if it is no such list.
    pub fn add(&mut self, list: &Value, image_of: impl Fn(&Value) -> Option<String>) -> Result<()> {
        let expected = "expected COCO results, a list of image_id, category_id, bbox and score";
        for (index, entry) in list.as_array().context(expected)?.iter().enumerate() {
            let parts = image_of(entry).zip(detection(entry));
            let (image, (class, one)) =
                parts.with_context(|| format!("{expected}; entry {index} is none"))?;
            ensure!(
                one.rectangle.iter().all(|value| value.is_finite()) && one.score.is_finite(),
                "entry {index} has a number that is not finite"
            );
            let of_class = self.0.entry((image, class)).or_default();
            let place = of_class.partition_point(|other| other.score >= one.score);
            of_class.insert(place, one);
        }
        Ok(())
    }

    /// Keeps those whose image and rectangle (left, top, width, height) `counts`.
    pub fn filtered(mut self, counts: impl Fn(&str, &[f64; 4]) -> bool) -> Self {
        for ((image, _), list) in &mut self.0 {
            list.retain(|one| counts(image, &one.rectangle));
        }
        self
    }

    /// Detections in an image `factor` times as large.
    pub fn enlarged(mut self, factor: f64) -> Self {
        for one in self.0.values_mut().flatten() {
            one.rectangle = one.rectangle.map(|value| factor * value);
        }
        self
    }

    /// Rectangles (left, top, width, height) in an image, pixels.
    pub fn in_image(&self, image: &str) -> impl Iterator<Item = [f64; 4]> {
        let own = self.0.iter().filter(move |((of, _), _)| of == image);
        own.flat_map(|(_, list)| list.iter().map(|one| one.rectangle))
    }

    fn count(&self) -> usize {
        self.0.values().map(Vec::len).sum()
    }
}

/// Agreement of detections in other images with those in photographs.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreement {
    /// Detections in photographs.
    pub wanted: usize,
    /// Detections in the other images.
    pub found: usize,
    /// Score of the other one of each pair less that of the first. A pair is of one class, and its
    /// boxes overlap by half or more.
    score_shifts: Vec<f64>,
    /// Overlap of each pair.
    ious: Vec<f64>,
}

impl Agreement {
    /// Agreement of the detections `found` in other images with those in `photographs`.
    pub fn between(photographs: &Detections, found: &Detections) -> Self {
        let mut agreement = Self {
            wanted: photographs.count(),
            found: found.count(),
            score_shifts: Vec::new(),
            ious: Vec::new(),
        };
        let mut found = found.clone();
        for (of, wanted) in &photographs.0 {
            let Some(found) = found.0.get_mut(of) else {
                continue;
            };
            for one in wanted {
                let overlaps = found
                    .iter()
                    .map(|other| iou(&one.rectangle, &other.rectangle));
                let best = overlaps.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
                if let Some((index, iou)) = best.filter(|(_, iou)| *iou >= SAME_IOU) {
                    let other = found.remove(index);
                    agreement.ious.push(iou);
                    agreement.score_shifts.push(other.score - one.score);
                }
            }
        }
        agreement
    }

    /// Number of pairs.
    pub fn matched(&self) -> usize {
        self.ious.len()
    }

    /// The gaps of detections in images called `images`.
    pub fn gaps(&self, images: &str) -> Vec<Gap> {
        let share = |name: String, of: usize| {
            let hits = (0..of).map(|at| f64::from(u8::from(at < self.matched())));
            Gap::new(name, Statistic::Share, &hits.collect::<Vec<_>>(), 3)
        };
        let mean = |name: String, values: &[f64]| Gap::new(name, Statistic::Mean, values, 3);
        vec![
            share(
                format!("detections in photographs found in {images}"),
                self.wanted,
            ),
            share(
                format!("detections in {images} that photographs have"),
                self.found,
            ),
            mean(
                format!("score of pairs, {images} less photograph"),
                &self.score_shifts,
            ),
            mean(format!("overlap of pairs (IoU), {images}"), &self.ious).within(0.0, 1.0),
        ]
    }

    pub fn to_json(&self) -> Value {
        json!({
            "in_photographs": self.wanted,
            "found": self.found,
            "matched": self.matched(),
            "score_shifts": self.score_shifts,
            "ious": self.ious,
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

/// The text or number `key` of an entry.
fn name(entry: &Value, key: &str) -> Option<String> {
    match entry.get(key)? {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    }
}

/// Class and box of an entry.
fn detection(entry: &Value) -> Option<(String, Detection)> {
    let bbox = entry.get("bbox")?.as_array()?;
    let numbers: Vec<f64> = bbox.iter().filter_map(Value::as_f64).collect();
    let detection = Detection {
        rectangle: numbers.try_into().ok()?,
        score: entry.get("score")?.as_f64()?,
    };
    Some((name(entry, "category_id")?, detection))
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
        let read = |file: &Path| Detections::read(file).unwrap();
        let (photographs, rendered) = (read(&photographs), read(&rendered));
        let found = Agreement::between(&photographs, &rendered);
        assert_eq!((found.wanted, found.found, found.matched()), (3, 2, 1));
        assert!((found.ious[0] - 0.8).abs() < 1e-12);
        assert!((found.score_shifts[0] + 0.2).abs() < 1e-12);
        let gaps = found.gaps("renders");
        assert!(gaps[0].text().starts_with("0.333 [0.06"), "{gaps:?}");
        let same = Agreement::between(&photographs, &photographs);
        assert_eq!((same.ious, same.score_shifts), (vec![1.0; 3], vec![0.0; 3]));

        // A mask that leaves the first image out, and images of half the size.
        let kept = photographs.clone().filtered(|image, _| image != "1");
        assert_eq!((kept.count(), photographs.count()), (1, 3));
        let large = kept.enlarged(2.0);
        let agreement = Agreement::between(&photographs, &large);
        assert_eq!((agreement.found, agreement.matched()), (1, 0));
    }

    #[test]
    fn other_files_are_refused_with_what_is_expected() {
        let folder = tempfile::tempdir().unwrap();
        for text in [
            "{}",
            "[1]",
            "nonsense",
            r#"[{"image_id": 1, "bbox": [1, 2]}]"#,
        ] {
            let bad = written(folder.path(), "bad.json", text);
            let error = format!("{:#}", Detections::read(&bad).unwrap_err());
            assert!(error.contains("bad.json"), "{error}");
        }
        let none = Detections::default();
        assert_eq!(
            Agreement::between(&none, &none).gaps("renders")[0].text(),
            "-"
        );
    }
}
