"""Drivers of AlpaSim's contract in the closed loop: policies of the package `carla-driver-interface`, which serves them for AlpaSim and for CARLA."""

import json
import re
import subprocess

import numpy as np
import pytest

from program import PROGRAM, decouplegs, needs_program

pytestmark = needs_program

STREET = ["--background", "20000", "--agent-splats", "500"]


@pytest.fixture(scope="module")
def empty_street(tmp_path_factory):
    """A scenario of a left turn, with no other road users and with traffic lights off."""
    folder = tmp_path_factory.mktemp("scenario")
    decouplegs("drive", "--level", "easy", "--episodes", 1, "--planner", "constant-velocity", "--render", "off", *STREET, "--out", folder)
    text = (folder / "scenarios/easy_0000.toml").read_text()
    text = re.sub(r"\[\[(agent|light|sign|pedestrian)\]\].*", "", text, flags=re.DOTALL)
    path = folder / "empty.toml"
    path.write_text(text.replace('name = "easy_0000"', 'name = "empty"'))
    return path


@pytest.fixture
def serve():
    """Serves a policy on a free port; the address."""
    pytest.importorskip("carla_driver_interface", reason="the package carla-driver-interface is not installed")
    from carla_driver_interface.server import build_server

    servers = []

    def start(policy, mode):
        server, port = build_server(policy, port=0, host="127.0.0.1", mode=mode)
        server.start()
        servers.append(server)
        return f"egodriver://127.0.0.1:{port}"

    yield start
    for server in servers:
        server.stop(None)


def recording(base, **kwargs):
    """A policy of the class `base` that keeps what it is told."""

    class Recording(base):
        def __init__(self):
            super().__init__(**kwargs)
            self.frames, self.closed, self.sessions = [], 0, []

        def on_session_start(self, session):
            self.sessions.append(session)

        def on_session_close(self, session):
            self.closed += 1

        def on_frame(self, session, frame):
            self.frames.append(frame)

    return Recording()


def records(log):
    """Records of an episode's log: its head, its steps and its end."""
    lines = [json.loads(line[17:]) for line in log.read_text().splitlines()]
    return lines[0], lines[1:-1], lines[-1]


def test_a_route_follower_drives_to_its_goal(empty_street, serve, tmp_path):
    from carla_driver_interface.policies import RouteFollowerPolicy

    policy = recording(RouteFollowerPolicy)
    planner = ["--planner", serve(policy, "alpasim"), "--driver-padding", "none", "--driver-camera", "front=camera_front", "--tell-scene"]
    decouplegs("drive", empty_street, *planner, "--driver-images", "jpeg", "--size", "64x36", "--out", tmp_path / "run")
    head, steps, end = records(tmp_path / "run/logs/empty.log")
    assert end == {"end": "route_done"}
    assert head["planner"]["name"].startswith("egodriver:route_follower") and head["planner"]["localization"]
    assert not head["planner"]["privileged"] and not any("warm_up" in step for step in steps)
    route = np.array(head["route_m"])
    driven = np.array([moment[1][:2] for step in steps for moment in step["instants"]])
    apart = np.linalg.norm(driven[:, None] - route[None], axis=2).min(axis=1)
    assert apart.max() < 1.5, "it stays in its lane, through the turn"
    assert np.linalg.norm(driven[-1] - driven[0]) > 50 and all(moment[3] for step in steps for moment in step["instants"])

    # The policy saw what the log says: one image and one pose per decision, and poses whose differences are the way driven.
    (session,) = policy.sessions
    assert session.scene_id == "empty" and policy.closed == 1
    assert len(policy.frames) == len(steps) == session.drive_count
    assert policy.frames[-1].as_array().shape == (36, 64, 3) and policy.frames[-1].image_bytes.startswith(b"\xff\xd8")
    path = np.array([pose.position[:2] for pose in session.ego_trajectory.poses])
    assert len(path) == len(steps)
    rear = driven - 0.3 * 4.5 * np.array([[np.cos(m[1][2]), np.sin(m[1][2])] for s in steps for m in s["instants"]])
    assert np.abs((path[1:] - path[1]) - (rear[:-1] - rear[0])).max() < 1e-3
    assert abs(session.speed_mps() - steps[-2]["instants"][-1][1][3]) < 1e-4


@pytest.mark.parametrize("mode", ["alpasim", "carla"])
def test_cameras_look_where_the_contract_says(mode, serve, tmp_path):
    from carla_driver_interface.policies import ConstantSpeedPolicy

    policy = recording(ConstantSpeedPolicy, cruise_speed_mps=9.0)
    street = ["--level", "easy", "--episodes", "1", *STREET, "--size", "64x36", "--time-budget", "easy"]
    planner = ["--planner", serve(policy, mode), "--driver-camera", "front=camera_front", "--driver-lens", "f-theta", "--step", "0.5"]
    decouplegs("drive", *street, *planner, "--out", tmp_path / "run")
    session = policy.sessions[0]
    camera = session.cameras["camera_front"]
    assert camera.intrinsics.WhichOneof("camera_param") == "ftheta_param"
    assert (camera.intrinsics.resolution_w, camera.intrinsics.resolution_h) == (64, 36)
    from carla_driver_interface.geometry import Pose

    mount = Pose.from_proto(camera.rig_to_camera)
    right, down, forward = mount.rotation_matrix.T
    assert forward[0] > 0.99 and right[1] < -0.99 and down[2] < -0.99, "x right, y down, z forward, in a rig of x forward, y left"
    assert mount.position[2] > 0.5, "above the ground"
    # Without the driver, the episode is driven again from its log.
    said = decouplegs("replay", tmp_path / "run/logs/easy_0000.log")
    assert "to the last bit" in said or "same" in said, said


def test_a_driver_that_is_not_there_is_an_error(tmp_path):
    done = subprocess.run(
        [PROGRAM, "drive", "--level", "easy", "--planner", "egodriver://127.0.0.1:1", "--out", str(tmp_path / "run")], capture_output=True, text=True
    )
    assert done.returncode == 1 and "egodriver://127.0.0.1:1" in done.stderr and not (tmp_path / "run").exists()
    done = subprocess.run(
        [PROGRAM, "drive", "--level", "easy", "--planner", "egodriver://nowhere", "--out", str(tmp_path / "run")], capture_output=True, text=True
    )
    assert done.returncode == 2 and "expected egodriver://HOST:PORT" in done.stderr
