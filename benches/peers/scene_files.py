"""Reads the files that both renderers are given: an INRIA PLY of splats, and cameras.

Needs numpy alone. Poses are returned as OpenCV cameras (x right, y down, z forward), meters.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2",
    "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip

HEADER_BYTES_MAX = 1 << 20

# nerfstudio's cameras look along -z with y up (OpenGL).
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


class SceneFileError(Exception):
    """A file that does not say what it should: the message names the file, what was expected and what was found."""


@dataclass
class Splats:
    """Activated attributes: what a renderer takes, not what the file stores."""

    means: np.ndarray  # [N, 3] meters
    quaternions: np.ndarray  # [N, 4] w, x, y, z
    scales: np.ndarray  # [N, 3] meters
    opacities: np.ndarray  # [N] 0 to 1
    sh: np.ndarray  # [N, (degree + 1)^2, 3]

    @property
    def sh_degree(self):
        return int(round(self.sh.shape[1] ** 0.5)) - 1


@dataclass
class Camera:
    name: str
    width_px: int
    height_px: int
    intrinsics: np.ndarray  # [3, 3] pixels
    camera_from_world: np.ndarray  # [4, 4]


def _vertex_layout(path, file):
    """The dtype and count of the vertices, the file left standing at the first of them."""
    lines, names = [], []
    while not lines or lines[-1] != "end_header":
        line = file.readline(HEADER_BYTES_MAX)
        if not line or file.tell() > HEADER_BYTES_MAX:
            raise SceneFileError(f"{path}: expected a PLY header that ends with end_header, found none in {file.tell()} bytes")
        lines.append(line.decode("ascii", "replace").strip())
    if lines[0] != "ply" or "format binary_little_endian 1.0" not in lines:
        raise SceneFileError(f"{path}: expected a binary little-endian PLY, found {lines[:2]}")
    elements = [line.split() for line in lines if line.startswith("element")]
    if len(elements) != 1 or elements[0][1] != "vertex":
        raise SceneFileError(f"{path}: expected the one element vertex, found {[e[1] for e in elements]}")
    for line in lines:
        if line.startswith("property"):
            kind, name = line.split()[1:3]
            if kind not in PLY_TYPES:
                raise SceneFileError(f"{path}: property {name} has the type {kind}, expected one of {sorted(PLY_TYPES)}")
            names.append((name, PLY_TYPES[kind]))
    return np.dtype(names), int(elements[0][2])


def read_ply(path):
    """Splats from an INRIA PLY: logarithmic scales, logit opacities, SH coefficients by channel."""
    path = Path(path)
    with path.open("rb") as file:
        layout, count = _vertex_layout(path, file)
        left = path.stat().st_size - file.tell()
        if left < count * layout.itemsize:
            raise SceneFileError(f"{path}: {count} splats need {count * layout.itemsize} bytes, found {left}")
        vertices = np.fromfile(file, layout, count)

    def columns(*names):
        missing = [name for name in names if name not in layout.names]
        if missing:
            raise SceneFileError(f"{path}: expected the properties {missing}, found {list(layout.names)}")
        return np.stack([vertices[name].astype(np.float32) for name in names], axis=1)

    rest_count = sum(name.startswith("f_rest_") for name in layout.names)
    if rest_count not in (0, 9, 24, 45):
        raise SceneFileError(f"{path}: expected 0, 9, 24 or 45 f_rest properties, found {rest_count}")
    sh = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None, :]
    if rest_count:
        by_channel = columns(*(f"f_rest_{i}" for i in range(rest_count))).reshape(count, 3, rest_count // 3)
        sh = np.concatenate([sh, by_channel.transpose(0, 2, 1)], axis=1)
    quaternions = columns("rot_0", "rot_1", "rot_2", "rot_3")
    return Splats(
        means=columns("x", "y", "z"),
        quaternions=quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        scales=np.exp(columns("scale_0", "scale_1", "scale_2")),
        opacities=1.0 / (1.0 + np.exp(-columns("opacity")[:, 0])),
        sh=np.ascontiguousarray(sh),
    )


def _intrinsics(fx, fy, cx, cy):
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _from_nerfstudio(document):
    for frame in document["frames"]:
        value = {**document, **frame}
        world_from_camera = np.array(value["transform_matrix"], dtype=np.float64) @ OPENCV_FROM_OPENGL
        yield Camera(
            name=Path(value["file_path"]).stem,
            width_px=int(value["w"]),
            height_px=int(value["h"]),
            intrinsics=_intrinsics(value["fl_x"], value["fl_y"], value["cx"], value["cy"]),
            camera_from_world=np.linalg.inv(world_from_camera),
        )


def _from_inria(document):
    for camera in document:
        world_from_camera = np.eye(4)
        world_from_camera[:3, :3] = camera["rotation"]
        world_from_camera[:3, 3] = camera["position"]
        width, height = int(camera["width"]), int(camera["height"])
        yield Camera(
            name=Path(camera["img_name"]).stem,
            width_px=width,
            height_px=height,
            intrinsics=_intrinsics(camera["fx"], camera["fy"], width / 2, height / 2),
            camera_from_world=np.linalg.inv(world_from_camera),
        )


def read_cameras(path):
    """Cameras from nerfstudio's transforms.json or INRIA's cameras.json, told apart by their outermost type."""
    document = json.loads(Path(path).read_text())
    try:
        cameras = list(_from_nerfstudio(document) if isinstance(document, dict) else _from_inria(document))
    except KeyError as missing:
        raise SceneFileError(f"{path}: expected a camera file of nerfstudio or INRIA, found no {missing}") from missing
    if not cameras:
        raise SceneFileError(f"{path}: expected at least one camera, found none")
    return cameras
