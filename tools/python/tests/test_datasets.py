"""Exported episodes, opened by the readers of the data sets: nuScenes' devkit and COCO's."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from program import decouplegs, needs_program

pytestmark = needs_program

NUSCENES = os.environ.get("DECOUPLEGS_NUSCENES", "")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    place = ["--background", 20_000, "--agent-splats", 500]
    how = ["--level", "hard", "--episodes", 1, "--size", "160x90", "--seed", 3, "--planner", "constant-velocity", "--all-cameras"]
    decouplegs("drive", *place, *how, "--out", folder)
    return folder / "logs/hard_0000.log"


def test_nuscenes_devkit_reads_boxes_points_and_images(log, tmp_path):
    if not (Path(NUSCENES) / "nuscenes").is_dir():
        pytest.skip("DECOUPLEGS_NUSCENES names no folder with the package nuscenes-devkit")
    out = tmp_path / "nuscenes"
    decouplegs("export", log, "--as", "nuscenes", "--lidar", "vlp32c", "--out", out)
    script = Path(__file__).with_name("nuscenes_reading.py")
    done = subprocess.run(
        [sys.executable, script, out, tmp_path / "front.png"], env={**os.environ, "PYTHONPATH": NUSCENES, "MPLBACKEND": "Agg"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    image = pytest.importorskip("matplotlib.image").imread(tmp_path / "front.png")
    assert image.ndim == 3 and image.std() > 0.01, "a view with boxes was drawn"


def test_coco_api_reads_masks_and_scores_labels_against_themselves(log, tmp_path):
    pytest.importorskip("pycocotools", reason="the package pycocotools is not installed")
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    out = tmp_path / "coco"
    decouplegs("export", log, "--as", "coco", "--out", out)
    truth = COCO(str(out / "annotations.json"))
    annotations = truth.loadAnns(truth.getAnnIds())
    assert len(annotations) > 20
    for annotation in annotations:
        mask = truth.annToMask(annotation)
        rows, columns = np.nonzero(mask)
        left, top, width, height = annotation["bbox"]
        assert mask.sum() == annotation["area"] and mask.shape == (90, 160)
        assert (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) == (left, top, left + width, top + height)

    def precision(moved_px):
        """Mean average precision of the labels as detections, moved to the right."""
        boxes = [(a["image_id"], a["category_id"], [a["bbox"][0] + moved_px, *a["bbox"][1:]]) for a in annotations]
        found = truth.loadRes([{"image_id": image, "category_id": kind, "bbox": box, "score": 1.0} for image, kind, box in boxes])
        judged = COCOeval(truth, found, "bbox")
        judged.evaluate()
        judged.accumulate()
        judged.summarize()
        return judged.stats[0]

    assert precision(0) > 0.999
    assert precision(40) < 0.5, "labels beside the objects score less"
