"""A session on the machine's device, and a small scene: a wall of colored splats, a rig of two cameras and three agents."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import decouplegs

CONE = Path(__file__).parents[3] / "engine/asset/fuzz/seeds/coded_asset/cone.safetensors"

SCENE = """
version = 1
background = "wall.splat"
sky = [0.2, 0.4, 0.6]

[[rig]]
name = "front"
width_px = 64
height_px = 48
fx_px = 60.0
fy_px = 60.0
cx_px = 32.0
cy_px = 24.0
position_m = [0.0, 0.0, 1.0]
look = [1.0, 0.0, 0.0]

[[rig]]
name = "left"
width_px = 64
height_px = 48
fx_px = 60.0
fy_px = 60.0
cx_px = 32.0
cy_px = 24.0
position_m = [0.0, 0.5, 1.0]
look = [1.0, 0.4, 0.0]

[[ego]]
time_s = 0.0
position_m = [0.0, 0.0, 0.0]

[[ego]]
time_s = 2.0
position_m = [4.0, 0.0, 0.0]

[[agent]]
name = "standing"
asset = "cone.safetensors"
position_m = [6.0, -1.0, 1.0]

[[agent]]
name = "moving"
asset = "cone.safetensors"

[[agent.trajectory]]
time_s = 0.0
position_m = [6.0, 1.0, 1.0]

[[agent.trajectory]]
time_s = 2.0
position_m = [6.0, 3.0, 1.0]

[[agent]]
name = "plain"
asset = "wall.splat"
position_m = [0.0, 40.0, 0.0]
"""


def write_splats(path: Path) -> None:
    """A wall at x = 12 m, green on the left and red on the right, in the 32 bytes a splat of .splat files."""
    y, z = np.meshgrid(np.linspace(-8, 8, 60), np.linspace(-4, 6, 40))
    splats = np.zeros(y.size, np.dtype([("xyz", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)]))
    splats["xyz"] = np.stack([np.full(y.size, 12.0), y.ravel(), z.ravel()], 1)
    splats["scale"] = 0.2
    splats["rgba"] = np.where(y.ravel()[:, None] > 0, [30, 200, 30, 250], [200, 30, 30, 250])
    splats["rotation"] = [255, 128, 128, 128]
    splats.tofile(path)


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    write_splats(folder / "wall.splat")
    shutil.copy(CONE, folder)
    (folder / "scene.toml").write_text(SCENE)
    return folder / "scene.toml"


@pytest.fixture(scope="session")
def session() -> decouplegs.Session:
    return decouplegs.Session(exported=False)


@pytest.fixture(scope="session")
def scene(session: decouplegs.Session, scene_file: Path) -> decouplegs.Scene:
    return session.open_scene(scene_file)


@pytest.fixture(autouse=True)
def the_validation_layer_is_silent(session: decouplegs.Session):
    yield
    assert session.take_validation_messages() == []
