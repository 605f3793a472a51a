//! COCO object detection and panoptic segmentation: <https://cocodataset.org/#format-data>.

use std::collections::HashSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use decouplegs::asset::write_atomically;
use decouplegs::scene::RoadUser;
use serde_json::{Value, json};

use super::sensed::{Labeled, LabeledAgent, LabeledImage, Sensed};
use super::{DataSet, category_number, write_png, write_rgba};

/// Images and annotations so far.
pub struct Annotations {
    folder: PathBuf,
    images: Vec<Value>,
    annotations: Vec<Value>,
    /// Annotations of panoptic segmentation, one per image.
    panoptic: Vec<Value>,
}

impl Annotations {
    pub fn new(folder: &Path) -> Result<Self> {
        for name in ["images", "panoptic"] {
            let part = folder.join(name);
            fs::create_dir(&part).with_context(|| format!("{} cannot be made", part.display()))?;
        }
        Ok(Self {
            folder: folder.to_owned(),
            images: Vec::new(),
            annotations: Vec::new(),
            panoptic: Vec::new(),
        })
    }

    /// Writes the panoptic image of `image`, which is called `name`: the id of each pixel's road
    /// user as R + 256 G + 65536 B, 0 where there is none.
    fn segment(&mut self, name: &str, image: &LabeledImage, agents: &[LabeledAgent]) -> Result<()> {
        let visible = agents
            .iter()
            .zip(&image.boxes)
            .filter_map(|(agent, labeled)| {
                let visible = labeled.as_ref()?.visible?;
                let size_px = visible.tight.max_px - visible.tight.min_px;
                let corner_px = visible.tight.min_px;
                let segment = json!({
                    "id": agent.instance,
                    "category_id": category_number(agent.kind),
                    "area": visible.pixels,
                    "bbox": [corner_px.x, corner_px.y, size_px.x, size_px.y],
                    "iscrowd": 0,
                });
                Some((agent.instance, segment))
            });
        let (ids, segments): (HashSet<u16>, Vec<Value>) = visible.unzip();
        let pixels = image.instances.iter().flat_map(|instance| {
            let id = if ids.contains(instance) { *instance } else { 0 };
            let [red, green] = id.to_le_bytes();
            [red, green, 0, 255]
        });
        let rgba: Vec<u8> = pixels.collect();
        write_rgba(
            &self.folder.join("panoptic").join(name),
            &rgba,
            &image.camera,
        )?;
        self.panoptic.push(json!({
            "image_id": self.images.len(),
            "file_name": name,
            "segments_info": segments,
        }));
        Ok(())
    }

    fn annotate(&mut self, image: &LabeledImage, agent: &LabeledAgent, labeled: &Labeled) {
        let Some(visible) = labeled.visible else {
            return;
        };
        let size_px = visible.tight.max_px - visible.tight.min_px;
        let corner_px = visible.tight.min_px;
        let k = &image.camera.intrinsics;
        self.annotations.push(json!({
            "id": self.annotations.len() + 1,
            "image_id": self.images.len(),
            "category_id": category_number(agent.kind),
            "bbox": [corner_px.x, corner_px.y, size_px.x, size_px.y],
            "area": visible.pixels,
            "iscrowd": 0,
            "segmentation": {
                "size": [k.height_px, k.width_px],
                "counts": runs(&image.instances, k.width_px as usize, agent.instance),
            },
            "track": agent.name,
            "visible_fraction": labeled.visible_fraction(),
        }));
    }
}

impl DataSet for Annotations {
    fn add(&mut self, sensed: &Sensed) -> Result<()> {
        for image in &sensed.images {
            let name = format!("{:04}_{}.png", sensed.step, image.camera.name);
            write_png(&self.folder.join("images").join(&name), image)?;
            let k = &image.camera.intrinsics;
            self.images.push(json!({
                "id": self.images.len() + 1,
                "file_name": name,
                "width": k.width_px,
                "height": k.height_px,
                "time_s": sensed.time_s,
                "camera": image.camera.name,
            }));
            for (agent, labeled) in sensed.agents.iter().zip(&image.boxes) {
                if let Some(labeled) = labeled {
                    self.annotate(image, agent, labeled);
                }
            }
            self.segment(&name, image, &sensed.agents)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<String> {
        let categories = RoadUser::ALL.map(|kind| {
            json!({
                "id": category_number(kind),
                "name": kind.name(),
                "supercategory": "road user",
                "isthing": 1,
            })
        });
        let (images, annotations) = (self.images.len(), self.annotations.len());
        for (name, annotations) in [
            ("annotations.json", &self.annotations),
            ("panoptic.json", &self.panoptic),
        ] {
            let text = serde_json::to_string(&json!({
                "info": {"description": "episode of DecoupleGS"},
                "licenses": [],
                "categories": categories,
                "images": self.images,
                "annotations": annotations,
            }))?;
            write_atomically(&self.folder.join(name), |file| {
                file.write_all(text.as_bytes())
            })?;
        }
        Ok(format!(
            "{images} images, {annotations} annotations with masks, panoptic images"
        ))
    }
}

/// Lengths of runs of pixels outside and inside the mask of `instance` by turns, column by column,
/// beginning outside: COCO's uncompressed run lengths.
fn runs(instances: &[u16], width: usize, instance: u16) -> Vec<u32> {
    let height = instances.len() / width.max(1);
    let mut runs = vec![0];
    let mut inside = false;
    for index in (0..width).flat_map(|x| (0..height).map(move |y| y * width + x)) {
        if (instances[index] == instance) != inside {
            inside = !inside;
            runs.push(0);
        }
        if let Some(last) = runs.last_mut() {
            *last += 1;
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_go_down_columns_and_begin_outside() {
        // 3 wide, 2 high.
        let instances = [7, 0, 7, 7, 7, 0];
        assert_eq!(runs(&instances, 3, 7), [0, 2, 1, 2, 1]);
        assert_eq!(runs(&instances, 3, 9), [6]);
        assert_eq!(runs(&[], 0, 1), [0]);
    }
}
