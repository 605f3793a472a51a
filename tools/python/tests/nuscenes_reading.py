"""Reads an exported episode with nuScenes' devkit. Arguments: the folder of the data set, and the image that a view with boxes is drawn into."""

import sys
from pathlib import Path

import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud
from nuscenes.utils.geometry_utils import BoxVisibility, points_in_box
from PIL import Image

root, drawn = sys.argv[1:]
data = NuScenes(version="v1.0-decouplegs", dataroot=root, verbose=False)
assert len(data.scene) == 1 and len(data.sample) > 4
cameras = [name for name in data.sample[0]["data"] if name.startswith("CAM")]
assert len(cameras) == 6 and "LIDAR_TOP" in data.sample[0]["data"]

inside, told, seen, speeds = 0, 0, 0, []
for sample in data.sample:
    for camera in cameras:
        path, boxes, intrinsic = data.get_sample_data(sample["data"][camera], box_vis_level=BoxVisibility.ANY)
        with Image.open(path) as image:
            assert image.size == (160, 90)
        # Boxes that a camera sees lie before it.
        assert intrinsic[0, 0] > 0 and all(box.center[2] + max(box.wlh) > 0 for box in boxes)
        seen += len(boxes)
    path, boxes, _ = data.get_sample_data(sample["data"]["LIDAR_TOP"])
    points = LidarPointCloud.from_file(path).points[:3]
    assert points.shape[1] > 1000 and np.isfinite(points).all()
    for box in boxes:
        count = data.get("sample_annotation", box.token)["num_lidar_pts"]
        told += count
        # Splats reach a little beyond the box of their car.
        inside += min(points_in_box(box, points, wlh_factor=1.1).sum(), count)
    speeds += [np.linalg.norm(data.box_velocity(token)[:2]) for token in sample["anns"]]
speeds = np.array(speeds)
assert told > 100 and inside > 0.9 * told, f"{inside} of {told} points of objects are in their boxes"
assert np.nanmax(speeds) > 1.0 and np.nanmax(speeds) < 40.0, speeds
assert seen > 10
front = data.sample[len(data.sample) // 2]["data"]["CAM_FRONT"]
data.render_sample_data(front, out_path=str(Path(drawn)), verbose=False)
print(f"{len(data.sample)} samples, {seen} boxes in images, {inside} of {told} points of objects in their boxes")
