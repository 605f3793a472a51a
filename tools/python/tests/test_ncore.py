"""NVIDIA NCore: dots of light land where its own camera models put them, and sequences that its package writes are imported."""

import csv
import json
import os
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest

from program import PROGRAM, needs_program

pytestmark = needs_program

NCORE = os.environ.get("DECOUPLEGS_NCORE", "")
SIZE = [960, 600]
FORWARD = [0.0, 560.0, 4.0, -30.0, 6.0, 0.0]


def backward():
    """The inverse of FORWARD, by least squares."""
    angles = np.linspace(0, 0.75, 2000)
    distances = np.polyval(FORWARD[::-1], angles)
    powers = np.stack([(distances / distances.max()) ** k for k in range(1, 6)], axis=1)
    fitted = np.linalg.lstsq(powers, angles, rcond=None)[0]
    return [0.0, *(fitted / distances.max() ** np.arange(1, 6)).tolist()]


FTHETA = {"kind": "ftheta", "size": SIZE, "center": [470.3, 305.7], "forward": FORWARD, "backward": backward(), "max_angle": 1.2, "cde": [1.02, 0.003, -0.004]}
OPENCV = {"size": SIZE, "center": [481.2, 297.4], "focal": [540.0, 545.0]}
WINDSHIELD = {
    "reference": "FORWARD",
    "horizontal_poly": [0.002, 1.003, 0.004, 0.001, 0.002, -0.003],
    "vertical_poly": [-0.001, 0.002, 0.001, 0.998, 0.003, 0.002],
    "horizontal_poly_inverse": [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    "vertical_poly_inverse": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
}
CAMERAS = {
    "ftheta_forward": {**FTHETA, "reference": "ANGLE_TO_PIXELDIST"},
    "ftheta_backward": {**FTHETA, "reference": "PIXELDIST_TO_ANGLE"},
    "fisheye": {**OPENCV, "kind": "fisheye", "radial": [0.05, -0.02, 0.01, -0.004], "max_angle": 1.2},
    "pinhole": {
        **OPENCV,
        "kind": "pinhole",
        "radial": [0.1, -0.05, 0.01, 0.02, 0.01, -0.003],
        "tangential": [0.001, -0.002],
        "thin_prism": [0.001, -0.0005, 0.0007, 0.0003],
    },
    "behind_a_windshield": {**FTHETA, "reference": "ANGLE_TO_PIXELDIST", "windshield": WINDSHIELD},
}


def rays():
    away, around = np.linspace(0.03, 0.55, 16), 2.4 * np.arange(16)
    return np.stack([np.sin(away) * np.cos(around), np.sin(away) * np.sin(around), np.cos(away)], axis=1)


@pytest.fixture(scope="module")
def points():
    if not Path(NCORE).is_dir() or not NCORE:
        pytest.skip("DECOUPLEGS_NCORE names no folder with the package nvidia-ncore")
    asked = json.dumps({"rays": rays().tolist(), "cameras": CAMERAS})
    script = Path(__file__).with_name("ncore_points.py")
    environment = {**os.environ, "PYTHONPATH": NCORE}
    done = subprocess.run(["/usr/bin/python3", script], input=asked, env=environment, capture_output=True, text=True)
    if "No module named 'torch'" in done.stderr:
        pytest.skip("the system's Python has no torch")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def call(tmp_path_factory):
    grpc = pytest.importorskip("grpc")
    pytest.importorskip("carla_driver_interface", reason="the package carla-driver-interface, which has AlpaSim's classes, is not installed")
    from alpasim import calls

    folder = tmp_path_factory.mktemp("dots")
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    rows = np.zeros((16, len(names)), "<f4")
    rows[:, :3], rows[:, 3:6], rows[:, 6], rows[:, 7:10], rows[:, 10] = 20 * rays(), 1.77, 6.0, np.log(0.02), 1.0
    header = ["ply", "format binary_little_endian 1.0", "element vertex 16", *(f"property float {name}" for name in names), "end_header", ""]
    (folder / "dots.ply").write_bytes("\n".join(header).encode() + rows.tobytes())
    server = Path(PROGRAM).with_name("decouplegs-server")
    serving = subprocess.Popen([server, "serve-grpc", folder / "dots.ply", "--port", "0"], stdout=subprocess.PIPE, text=True)
    address = serving.stdout.readline().removeprefix("listening on ").strip()
    with grpc.insecure_channel(address) as channel:
        yield calls(channel)
    serving.terminate()
    assert serving.wait(timeout=30) == 0


def spec(messages, camera):
    asked = messages.CameraSpec(logical_id="dots", resolution_w=SIZE[0], resolution_h=SIZE[1], shutter_type=messages.GLOBAL)
    if camera["kind"] == "ftheta":
        lens = asked.ftheta_param
        lens.reference_poly = messages.FthetaCameraParam.PolynomialType.Value(camera["reference"])
        lens.pixeldist_to_angle_poly.extend(camera["backward"])
        lens.angle_to_pixeldist_poly.extend(camera["forward"])
        lens.linear_cde.linear_c, lens.linear_cde.linear_d, lens.linear_cde.linear_e = camera["cde"]
    else:
        lens = asked.opencv_fisheye_param if camera["kind"] == "fisheye" else asked.opencv_pinhole_param
        lens.focal_length_x, lens.focal_length_y = camera["focal"]
        lens.radial_coeffs.extend(camera["radial"])
    if camera["kind"] == "pinhole":
        lens.tangential_coeffs.extend(camera["tangential"])
        lens.thin_prism_coeffs.extend(camera["thin_prism"])
    else:
        lens.max_angle = camera["max_angle"]
    lens.principal_point_x, lens.principal_point_y = camera["center"]
    for name in (name for name in camera.get("windshield", {}) if name.endswith(("poly", "inverse"))):
        getattr(asked.bivariate_windshield_model_param, name).extend(camera["windshield"][name])
    return asked


@pytest.mark.parametrize("name", CAMERAS)
def test_dots_land_where_ncore_puts_them(points, call, name):
    from alpasim import common, messages

    (scene,) = call["get_available_scenes"](common.Empty()).scene_ids
    here = common.Pose(vec=common.Vec3(), quat=common.Quat(w=1))
    request = messages.RGBRenderRequest(
        scene_id=scene,
        resolution_w=SIZE[0],
        resolution_h=SIZE[1],
        camera_intrinsics=spec(messages, CAMERAS[name]),
        frame_start_us=0,
        frame_end_us=1,
        sensor_pose=messages.PosePair(start_pose=here, end_pose=here),
        image_format=messages.RGB_UINT8_PLANAR,
    )
    planes = np.frombuffer(call["render_rgb"](request).image_bytes, np.uint8).reshape(3, SIZE[1], SIZE[0])
    light = planes[0].astype(float)
    off = []
    for (x, y), valid in zip(points[name]["points"], points[name]["valid"]):
        if not valid or not (10 < x < SIZE[0] - 10 and 10 < y < SIZE[1] - 10):
            continue
        left, top = int(x) - 6, int(y) - 6
        window = light[top : top + 13, left : left + 13]
        rows, columns = np.mgrid[top : top + 13, left : left + 13] + 0.5
        off.append([np.sum(window * columns) / window.sum() - x, np.sum(window * rows) / window.sum() - y])
    off = np.array(off)
    assert len(off) >= 12
    # Eight bits tell the middle of a dot to some 0.006 px.
    assert np.abs(off).max() < 0.02 and np.abs(off.mean(axis=0)).max() < 0.01, off


def imported(folder, store, *more):
    if not Path(NCORE).is_dir() or not NCORE:
        pytest.skip("DECOUPLEGS_NCORE names no folder with the package nvidia-ncore")
    script = Path(__file__).with_name("ncore_sequence.py")
    environment = {**os.environ, "PYTHONPATH": NCORE}
    (folder / "sequence").mkdir()
    subprocess.run(["/usr/bin/python3", script, folder / "sequence", store], env=environment, check=True, timeout=120)
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    x, y = np.meshgrid(np.arange(-5, 50), np.arange(-8, 9))
    rows = np.zeros((x.size, len(names)), "<f4")
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 6] = x.ravel(), y.ravel(), 0.5, 6.0
    rows[:, 7:10], rows[:, 10] = np.log([0.6, 0.6, 0.01]), 1.0
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *(f"property float {name}" for name in names), "end_header", ""]
    (folder / "road.ply").write_bytes("\n".join(header).encode() + rows.tobytes())
    command = [PROGRAM, "import", "ncore", folder / "sequence", "--splats", folder / "road.ply", "--out", folder / "scene", *more]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("store", ["itar", "directory"])
def test_a_sequence_of_its_package_is_a_scene(tmp_path, store):
    done = imported(tmp_path, store, "--images", "--hold-out", "2")
    assert done.returncode == 0, done.stderr
    scene = tomllib.loads((tmp_path / "scene/scene.toml").read_text())
    tele, wide = scene["rig"]
    assert (tele["name"], wide["name"]) == ("camera_front_tele_30fov", "camera_front_wide_120fov")
    # The rig is on the ground below the rear axle, and a scene counts from the middle of the box.
    np.testing.assert_allclose(wide["position_m"], [0.35, 0.1, 0.65], atol=1e-9)
    np.testing.assert_allclose(np.abs(np.dot(wide["rotation_wxyz"], [0.5, -0.5, 0.5, -0.5])), 1.0, atol=1e-9)
    # NCore counts pixels of f-theta cameras from the middle of the first.
    assert [wide["cx_px"], wide["cy_px"]] == [470.75, 306.25]
    np.testing.assert_allclose(wide["lens"]["angle_to_pixel_distance"], FORWARD, rtol=1e-6)
    # Written as one of the fifth order: 1, the angles across and down.
    np.testing.assert_allclose(np.array(wide["windshield"]["horizontal"])[[0, 1, 6]], [0.002, 1.003, 0.004], rtol=1e-6)
    assert wide["shutter"] == {"direction": "top_to_bottom", "readout_s": 0.03}
    np.testing.assert_allclose(tele["lens"]["radial"][:2], [0.1, -0.05], rtol=1e-6)
    assert (tele["fx_px"], tele["fy_px"], tele["cx_px"]) == (900.0, 905.0, 320.5)
    ego = scene["ego"]
    assert len(ego) == 51 and ego[0]["time_s"] == 0.0 and ego[50]["time_s"] == 5.0
    np.testing.assert_allclose(ego[10]["position_m"], [8.0 + 1.35, 1.0, 0.5 + 0.75], atol=1e-9)
    (lidar,) = scene["lidar"]
    np.testing.assert_allclose(lidar["position_m"], [1.1 - 1.35, 0.0, 1.9 - 0.75], atol=1e-9)
    parameters = json.loads((tmp_path / "scene" / lidar["sensor"]).read_text())
    assert parameters["spinning_frequency_hz"] == 10.0
    with open(tmp_path / "scene/tracks.csv") as file:
        first, second = csv.DictReader(file)
    place = lambda row: [float(row[name]) for name in ("x_m", "y_m", "z_m")]
    assert (first["id"], first["class"], float(first["length_m"])) == ("7", "car", 4.5)
    np.testing.assert_allclose(place(first), [20.0, 3.0, 0.75], atol=1e-6)
    # In the frame of the LiDAR, when the rig was at (4, 0.25).
    np.testing.assert_allclose(place(second), [20.0 + 4.0 + 1.1, 3.25, 0.5 + 1.9 + 0.25], atol=1e-6)
    lines = (tmp_path / "scene/images.csv").read_text().splitlines()
    assert lines[0] == "camera,time_s,image" and len(lines) == 5
    camera, time_s, image = lines[-1].split(",")
    assert camera == "camera_front_wide_120fov" and abs(float(time_s) - 2.015) < 1e-6
    assert (tmp_path / f"scene/images/{image}.png").read_bytes().startswith(b"\x89PNG")
    # Each camera has two images, of which the second is held out.
    held_out = (tmp_path / "scene/held_out.txt").read_text().split()
    assert held_out == [line.split(",")[2] for line in (lines[2], lines[4])]


def test_broken_sequences_get_a_sentence(tmp_path):
    done = imported(tmp_path, "itar")
    assert done.returncode == 0, done.stderr
    sequence = tmp_path / "sequence/drive.json"
    store = tmp_path / "sequence/drive.ncore4.zarr.itar"
    command = [PROGRAM, "import", "ncore", sequence, "--splats", tmp_path / "road.ply", "--out", tmp_path / "other"]
    refused = lambda: subprocess.run(command, capture_output=True, text=True, timeout=120)
    whole = store.read_bytes()
    for content, part in [(whole[: len(whole) // 2], "cut short"), (b"x" * 4096, "no header of a tar"), (whole[:512] * 3, "entry at byte")]:
        store.write_bytes(content)
        done = refused()
        assert done.returncode == 1 and store.name in done.stderr, done.stderr
    store.unlink()
    assert refused().returncode == 1
    sequence.write_text('{"version": "3.0", "component_stores": []}')
    done = refused()
    assert done.returncode == 1 and "version 4 is read" in done.stderr, done.stderr
    assert not (tmp_path / "other").exists()
