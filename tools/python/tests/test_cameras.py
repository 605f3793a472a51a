"""Cameras of every kind, framing, and images as files."""

import json
import runpy
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

import decouplegs
from poses import pose

FISHEYE = {"model": "opencv-fisheye", "radial": [0.2, -0.01]}
SHUTTER = {"direction": "top_to_bottom", "readout_s": 0.05}
K = [[60, 0, 32], [0, 60, 24], [0, 0, 1]]
FRONT = {"width_px": 64, "height_px": 48, "fx_px": 60, "position_m": [0, 0, 1], "look": [1, 0, 0]}


@pytest.fixture(scope="module")
def drawn(session, scene):
    renderer = session.batch_renderer()
    return lambda camera: renderer.draw([(decouplegs.World(scene, empty=True), [camera])])[0][0]


def pixels(path: Path) -> np.ndarray:
    """The pixels of a PNG of 8-bit RGB without filters beyond the five of the format."""
    from io import BytesIO

    stream = BytesIO(path.read_bytes())
    assert stream.read(8) == b"\x89PNG\r\n\x1a\n"
    data = b""
    while length := stream.read(4):
        kind = stream.read(4)
        chunk = stream.read(int.from_bytes(length, "big"))
        stream.read(4)
        if kind == b"IHDR":
            width, height = int.from_bytes(chunk[:4], "big"), int.from_bytes(chunk[4:8], "big")
            assert chunk[8:10] == b"\x08\x02"
        data += chunk if kind == b"IDAT" else b""
    rows = np.frombuffer(zlib.decompress(data), np.uint8).reshape(height, 1 + 3 * width)
    image = np.zeros((height, width, 3), np.uint8)
    for y, row in enumerate(rows):
        above = image[y - 1].astype(int) if y else np.zeros((width, 3), int)
        for x in range(width):
            left = image[y, x - 1].astype(int) if x else np.zeros(3, int)
            corner = above[x - 1] if x else np.zeros(3, int)
            guess = left + above[x] - corner
            near = [np.abs(guess - other) for other in (left, above[x], corner)]
            paeth = np.where((near[0] <= near[1]) & (near[0] <= near[2]), left, np.where(near[1] <= near[2], above[x], corner))
            predicted = [0, left, above[x], (left + above[x]) // 2, paeth][row[0]]
            image[y, x] = (row[1 + 3 * x : 4 + 3 * x] + predicted) % 256
    return image


def test_a_camera_is_described_by_words_dictionaries_and_text(scene, drawn):
    front = scene.rig[0]
    camera = decouplegs.Camera.from_description(FRONT)
    np.testing.assert_array_equal(camera.K, front.K)
    np.testing.assert_allclose(camera.world_from_camera, front.at(pose()).world_from_camera, atol=1e-12)
    same = decouplegs.Camera.from_description(json.dumps(FRONT))
    toml = decouplegs.Camera.from_description("[[rig]]\nwidth_px = 64\nheight_px = 48\nfx_px = 60.0\nposition_m = [0, 0, 1]\nlook = [1, 0, 0]\n")
    assert camera.description == same.description == toml.description
    np.testing.assert_array_equal(drawn(camera), drawn(front.at(pose())))
    # The scene's own cameras go there and back.
    for own in scene.rig:
        assert decouplegs.RigCamera.from_description(own.description).description == own.description


def test_lenses_and_shutters_are_drawn(drawn):
    plain = decouplegs.Camera.from_description(FRONT)
    bent = decouplegs.Camera.from_description({**FRONT, "lens": FISHEYE})
    by_words = decouplegs.Camera(64, 48, K, plain.world_from_camera, lens=FISHEYE)
    assert bent.description["lens"] == by_words.description["lens"]
    np.testing.assert_array_equal(drawn(bent), drawn(by_words))
    assert (drawn(bent) != drawn(plain)).any()
    dark = decouplegs.Camera(64, 48, K, plain.world_from_camera, photometry={"exposure_ev": -2.0})
    assert drawn(dark)[..., :3].mean() < 0.7 * drawn(plain)[..., :3].mean()
    np.testing.assert_array_equal(drawn(plain.with_photometry(exposure_ev=-2.0)), drawn(dark))
    rolling = decouplegs.RigCamera.from_description({**FRONT, "shutter": SHUTTER})
    standing, passing = rolling.at(pose()), rolling.at(pose(), velocity=(0.0, 20.0, 0.0))
    np.testing.assert_array_equal(drawn(standing), drawn(plain))
    assert (drawn(passing) != drawn(plain)).any()


@pytest.mark.parametrize(
    ("description", "error", "part"),
    [
        ({"width_px": 64}, ValueError, "height_px"),
        ({**FRONT, "lens": {"model": "wide"}}, ValueError, "f-theta"),
        ({**FRONT, "fx_px": float("nan")}, ValueError, "description"),
        ({**FRONT, "position_m": np.zeros(3)}, TypeError, "tolist"),
        ([FRONT], TypeError, "found list"),
        (json.dumps([FRONT, FRONT]), ValueError, "found 2"),
        ("hello", ValueError, "neither TOML nor JSON"),
    ],
)
def test_faults_of_descriptions_are_told(description, error, part):
    with pytest.raises(error, match=part):
        decouplegs.Camera.from_description(description)


def test_cameras_look_at_places():
    camera = decouplegs.Camera.look_at((0, 0, 2), (10, 0, 2), size=(64, 48), fov_deg=90)
    np.testing.assert_allclose(camera.world_from_camera[:3, :3], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
    np.testing.assert_allclose(camera.K, [[32, 0, 32], [0, 32, 24], [0, 0, 1]])
    for wrong in [{"up": (1, 0, 0)}, {"target": (0, 0, 2)}, {"fov_deg": 180}, {"fov_deg": float("nan")}, {"size": (0, 9)}, {"eye": (np.inf, 0, 0)}]:
        with pytest.raises(ValueError):
            decouplegs.Camera.look_at(**{"eye": (0, 0, 2), "target": (10, 0, 2), **wrong})


def test_a_splat_file_is_framed_and_its_image_saved(session, scene, scene_file, tmp_path):
    wall = session.open_scene(scene_file.with_name("wall.splat"))
    camera = wall.frame(size=(64, 40), direction=(-1, 0, 0), up=(0, 0, 1))
    image = session.batch_renderer().draw([(decouplegs.World(wall), [camera])])[0][0]
    assert (image[20, 24, 1] > image[20, 24, 0]) and (image[20, 40, 0] > image[20, 40, 1])
    assert image[0, 0, 3] == 0 and image[20, 32, 3] > 200, "the wall is in the middle, and all of it"
    out = tmp_path / "wall.png"
    for form in (image, image[..., :3], np.asfortranarray(image)):
        decouplegs.save_png(out, form)
        np.testing.assert_array_equal(pixels(out), image[..., :3])
    for wrong, error in [(image[None], ValueError), (image[..., 0], ValueError), (image / 255, TypeError), ("text", TypeError)]:
        with pytest.raises(error, match="image: expected"):
            decouplegs.save_png(out, wrong)
    with pytest.raises(decouplegs.FileError, match="absent"):
        decouplegs.save_png(tmp_path / "absent/wall.png", image)
    with pytest.raises(ValueError, match="2 cameras"):
        scene.frame()
    with pytest.raises(ValueError, match="nothing is framed"):
        wall.frame(direction=(0, 0, 1), up=(0, 0, 1))


def test_the_example_renders_a_splat_file(scene_file, tmp_path, monkeypatch, capsys):
    example = Path(__file__).parents[1] / "examples/render_ply.py"
    out = tmp_path / "wall.png"
    monkeypatch.setattr(sys, "argv", ["render_ply.py", str(scene_file.with_name("wall.splat")), str(out)])
    runpy.run_path(str(example), run_name="__main__")
    assert "1280x720" in capsys.readouterr().out and out.read_bytes().startswith(b"\x89PNG")
