"""Checkpoints that PyTorch itself writes: read as they are, and drawn as HUGSIM's formulas say.

`write_checkpoints.py` writes them. It runs in this Python or the system's, whichever has torch; without one the tests are skipped.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from program import decouplegs, needs_program

pytestmark = needs_program


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory):
    pythons = [sys.executable, "/usr/bin/python3"]
    with_torch = [python for python in pythons if subprocess.run([python, "-c", "import torch, numpy"], capture_output=True).returncode == 0]
    if not with_torch:
        pytest.skip("neither this Python nor the system's has torch: checkpoints are not written")
    out = tmp_path_factory.mktemp("checkpoints")
    subprocess.run([with_torch[0], Path(__file__).with_name("write_checkpoints.py"), out], check=True)
    return out


def read_ply(path):
    """The columns of a binary PLY of floats."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in header.split(b"\n") if line.startswith(b"property float")]
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names))
    return dict(zip(names, rows.T))


def assert_same(path, group, folder):
    """The splats of a written PLY are the parameters that the checkpoint was made of."""
    found = read_ply(path)
    expected = {name: np.load(folder / f"{group}_{name}.npy") for name in ("means", "scales", "quats", "opacities", "sh0", "shN")}
    columns = lambda prefix, count: np.stack([found[f"{prefix}_{i}"] for i in range(count)], axis=1)
    np.testing.assert_array_equal(np.stack([found[axis] for axis in "xyz"], axis=1), expected["means"])
    np.testing.assert_array_equal(columns("f_dc", 3), expected["sh0"][:, 0])
    rest = columns("f_rest", 45).reshape(-1, 3, 15).transpose(0, 2, 1)
    np.testing.assert_array_equal(rest, expected["shN"])
    np.testing.assert_allclose(columns("scale", 3), expected["scales"], atol=2e-6)
    np.testing.assert_allclose(found["opacity"], expected["opacities"], atol=2e-5)
    quats = expected["quats"] / np.linalg.norm(expected["quats"], axis=1, keepdims=True)
    np.testing.assert_allclose(columns("rot", 4), quats, atol=1e-6)


@pytest.mark.parametrize("name", ["gsplat.pt", "splatfacto.ckpt"])
def test_splats_of_trainers_are_read_as_torch_saved_them(checkpoints, tmp_path, name):
    decouplegs("convert", checkpoints / name, tmp_path / "out.ply")
    assert_same(tmp_path / "out.ply", "scene", checkpoints)


@pytest.mark.parametrize(("name", "actor"), [("drivestudio.pth", "rigid_000"), ("street_gaussians.pth", "obj_003")])
def test_scenes_of_trainers_are_read_as_torch_saved_them(checkpoints, tmp_path, name, actor):
    decouplegs("convert", checkpoints / name, tmp_path / "scene")
    assert_same(tmp_path / "scene" / "background.ply", "scene", checkpoints)
    assert_same(tmp_path / "scene" / "assets" / f"{actor}.ply", "actor", checkpoints)


# HUGSIM's image, in the axes of its files, by the formulas of its renderer and not by ours.

SH = [0.28209479177387814, 0.4886025119029199]
SH2 = [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396]
SH3 = [-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658, 1.445305721320277, -0.5900435899266435]


def sh_basis(d):
    x, y, z = d.T
    one = np.ones_like(x)
    band1 = [-SH[1] * y, SH[1] * z, -SH[1] * x]
    band2 = [SH2[0] * x * y, SH2[1] * y * z, SH2[2] * (2 * z * z - x * x - y * y), SH2[3] * x * z, SH2[4] * (x * x - y * y)]
    band3 = [
        SH3[0] * y * (3 * x * x - y * y),
        SH3[1] * x * y * z,
        SH3[2] * y * (4 * z * z - x * x - y * y),
        SH3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y),
        SH3[4] * x * (4 * z * z - x * x - y * y),
        SH3[5] * z * (x * x - y * y),
        SH3[6] * x * (x * x - 3 * y * y),
    ]
    return np.stack([SH[0] * one, *band1, *band2, *band3], axis=1)


def rotations(quats):
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def hugsim_network(params, camera):
    """The matrix and the offset that HUGSIM's network makes of a pose; colors are rows."""
    position, direction = camera[:3, 3] / 60, camera[:3, 2] * 2 - 1
    waves = [wave(coordinate * 2**k * np.pi) for coordinate in position for k in range(4) for wave in (np.sin, np.cos)]
    x, y, z = direction
    bands = [SH[0], -SH[1] * y, SH[1] * z, -SH[1] * x, SH2[0] * x * y, SH2[1] * y * z, 0.9461746957575601 * z * z - SH2[2], SH2[3] * x * z, SH2[4] * (x * x - y * y)]
    values = np.array([*waves, *bands, *[1.0] * (48 - 33)])
    first, second, last = np.split(params.astype(float), [32 * 48, 32 * 48 + 32 * 32])
    values = np.maximum(first.reshape(32, 48) @ values, 0)
    values = np.maximum(second.reshape(32, 32) @ values, 0)
    out = 0.1 * (last.reshape(16, 32) @ values)[:12]
    return np.eye(3) + out[:9].reshape(3, 3), out[9:]


def hugsim_image(folder, step):
    load = lambda group: {p.stem.split("_", 1)[1]: np.load(p).astype(float) for p in folder.glob(f"{group}_*.npy")}
    scene, ground, actor = load("scene"), load("ground"), load("actor")
    two = ground["scales"]
    ground["scales"] = np.stack([two[:, 0], np.full(len(two), np.log(1e-3)), two[:, 1]], axis=1)
    box = np.array([[0, 1, 0, 1.0], [0, 0, 1, 0.4], [1, 0, 0, 7.0 + 2 * step]])
    parts = []
    for part, turn, shift in ((scene, np.eye(3), np.zeros(3)), (ground, np.eye(3), np.zeros(3)), (actor, box[:, :3], box[:, 3])):
        axes = turn @ rotations(part["quats"]) * np.exp(part["scales"])[:, None, :]
        means = part["means"] @ turn.T + shift
        # Colors of actors are evaluated in directions of the world.
        parts.append((means, axes @ axes.transpose(0, 2, 1), part["opacities"], np.concatenate([part["sh0"], part["shN"]], axis=1)))
    means, covariances, logits, harmonics = (np.concatenate(each) for each in zip(*parts))

    turn = 0.1 * step
    camera = np.eye(4)
    camera[:3] = [[np.cos(turn), 0, np.sin(turn), 0.2], [0, 1, 0, 0.1], [-np.sin(turn), 0, np.cos(turn), 0.5 * step]]
    seen = (means - camera[:3, 3]) @ camera[:3, :3]
    rays = means - camera[:3, 3]
    colors = np.einsum("nk,nkc->nc", sh_basis(rays / np.linalg.norm(rays, axis=1, keepdims=True)), harmonics)
    colors = np.maximum(colors + 0.5, 0)
    fx, fy, cx, cy, width, height = 150, 155, 82, 57, 160, 120
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    image, light, stopped = np.zeros((height, width, 3)), np.ones((height, width)), np.zeros((height, width), bool)
    for splat in np.argsort(seen[:, 2], kind="stable"):
        x, y, z = seen[splat]
        if z < 0.01:
            continue
        limit = lambda value, extent, center, focal: np.clip(value, -(center + 0.3 * extent / 2) / focal, (extent - center + 0.3 * extent / 2) / focal)
        u, v = limit(x / z, width, cx, fx), limit(y / z, height, cy, fy)
        jacobian = np.array([[fx / z, 0, -fx * u / z], [0, fy / z, -fy * v / z]]) @ camera[:3, :3].T
        spread = np.linalg.inv(jacobian @ covariances[splat] @ jacobian.T + 0.3 * np.eye(2))
        off = np.stack([columns - (fx * x / z + cx), rows - (fy * y / z + cy)], axis=-1)
        exponent = -0.5 * np.einsum("hwi,ij,hwj->hw", off, spread, off)
        alpha = np.minimum(0.99, np.exp(exponent) / (1 + np.exp(-logits[splat])))
        alpha[alpha < 1 / 255] = 0
        stopped |= (alpha > 0) & (light * (1 - alpha) <= 1e-4)
        alpha[stopped] = 0
        image += (light * alpha)[..., None] * colors[splat]
        light *= 1 - alpha
    matrix, offset = hugsim_network(np.load(folder / "network_params.npy"), camera)
    return np.clip(image @ matrix + offset, 0, 1)


@pytest.mark.parametrize("step", [0, 1])
def test_a_scene_of_hugsim_is_drawn_as_its_formulas_say(checkpoints, tmp_path, step):
    decouplegs("convert", checkpoints / "hugsim", tmp_path / "scene", "--image", step)
    decouplegs("render", tmp_path / "scene" / "scene.toml", "--time", 0.5 * step, "--format", "npy", "--out", tmp_path / "images")
    found = np.clip(np.load(tmp_path / "images" / "CAM_FRONT.npy")[..., :3], 0, 1)
    expected = hugsim_image(checkpoints, step)
    assert expected.std() > 0.1, "the image shows something"
    db = -10 * np.log10(np.mean((found - expected) ** 2))
    assert db >= 80, f"{db:.1f} dB from HUGSIM's formulas"
    # The comparison would notice another network, other axes or a missing actor.
    other = hugsim_image(checkpoints, 1 - step)
    assert -10 * np.log10(np.mean((found - other) ** 2)) < 40
