"""HUGSIM's interfaces: the environment, the loop over FIFOs, and HTTP with HUGSIM's own client package."""

import io
import os
import pickle
import subprocess
import sys
import textwrap
import threading
import urllib.error
import urllib.request

import numpy as np
import pytest

import decouplegs

gymnasium = pytest.importorskip("gymnasium")

from decouplegs.hugsim import HUGSimEnv, _Plans, _euler_xyz, run_pipes, server  # noqa: E402

# Two seconds at 4 m/s, and more to look ahead: x to the right, y forward.
AHEAD = np.column_stack([np.zeros(6), 2.0 * np.arange(1, 7)])


# Value of HUGSIM's clients (UniAD_SIM at 5fb279e, tools/closeloop/dataparser.py:8; NAVSIM at ca0ca7e, hugsim/dataparser.py:8).
OPENCV2IMU = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


@pytest.fixture(scope="module")
def env():
    session = decouplegs.Session(exported=False, depth=True, instance=True)
    site = decouplegs.Site(session, background=4_000, agent_splats=64)
    return HUGSimEnv(session=session, site=site, size=(48, 32))


def test_observations_and_info_are_those_of_hugsim(env):
    observation, info = env.reset(seed=3)
    assert set(observation["rgb"]) == {f"CAM_{name}" for name in ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "BACK", "BACK_LEFT", "BACK_RIGHT")}
    assert all(image.shape == (32, 48, 3) and image.dtype == np.uint8 for image in observation["rgb"].values())
    assert env.observation_space.contains(observation)
    keys = "ego_pos ego_rot ego_velo ego_steer accelerate steer_rate timestamp command ego_box obj_boxes cam_params rc collision"
    assert set(info) == set(keys.split())
    assert info["timestamp"] == 0.0 and info["rc"] == 0.0 and info["command"] in (0, 1, 2)
    assert len(info["ego_box"]) == 7 and all(len(box) == 7 for box in info["obj_boxes"])
    width, length, height = info["ego_box"][3:6]
    assert length > width > 1.0 and height > 1.0
    assert len(info["ego_pos"]) == len(info["ego_rot"]) == 3
    np.testing.assert_allclose(OPENCV2IMU @ info["ego_pos"], info["ego_box"][:3], atol=1e-9)
    # imu_rot[2] = -ego_rot[1] is the heading (UniAD_SIM, dataparser.py:26).
    assert abs(-info["ego_rot"][1] - info["ego_box"][6]) < 1e-6
    for camera in observation["rgb"]:
        depth, semantic = observation["depth"][camera], observation["semantic"][camera]
        assert depth.shape == semantic.shape == (32, 48) and depth.dtype == np.float32 and semantic.dtype == np.uint8
        assert set(np.unique(semantic)) <= {10, 11, 13, 19}
    depth, semantic = observation["depth"]["CAM_FRONT"], observation["semantic"]["CAM_FRONT"]
    assert (semantic[-1] == 19).all() and (depth[-1] > 0.0).all(), "the road"
    assert np.array_equal(semantic == 10, (depth == 0.0) & (semantic != 13))


def test_others_are_vehicles_in_the_semantic_image(env):
    found = set()
    for seed in range(3, 9):
        observation, info = env.reset(seed=seed)
        for camera, semantic in observation["semantic"].items():
            if (semantic == 13).any():
                inside = observation["depth"][camera][semantic == 13]
                near = min(np.hypot(*(np.array(box[:2]) - info["ego_box"][:2])) for box in info["obj_boxes"])
                assert inside.max() > near - 6.0
                found.add(camera)
    assert found, "no other vehicle in any camera of six episodes"


def test_a_session_without_depth_is_refused(session):
    with pytest.raises(ValueError, match="depth=True, instance=True"):
        HUGSimEnv(session=session)


def test_frames_are_those_of_hugsim(env):
    """HUGSIM's configs/sim/nuscenes_camera.yaml: CAM_FRONT is 1.73 m before the rear axle and 1.48 m above the ground, 0.73 m before the LiDAR and 0.35 m below."""
    info = env.reset(seed=3)[1]
    size, rig = env.drive.rollout.sizes[0], env.course.rig
    lidars = env.course.site.scene.lidars
    for name, own in rig.items():
        params = info["cam_params"][env.names[name]]
        place = own.rig_from_camera[:3, 3]
        in_vehicle, in_lidar = (np.linalg.inv(params[key])[:3, 3] for key in ("v2c", "l2c"))
        # The rear axle of a car of 4.5 m is 1.35 m behind its middle (Lr of configs/sim/kinematic.yaml), on the ground.
        np.testing.assert_allclose(in_vehicle, place + [0.3 * size[0], 0.0, 0.5 * size[2]], atol=1e-6)
        right, ahead, up = in_lidar
        if not lidars:
            np.testing.assert_allclose([ahead, -right, up], in_vehicle - [0.943713, 0.0, 1.84023], atol=1e-6)
        # The vehicle's x is the LiDAR's y, its y the LiDAR's -x.
        np.testing.assert_allclose(params["v2c"][:3, 0], params["l2c"][:3, 1], atol=1e-9)
        np.testing.assert_allclose(params["v2c"][:3, 1], -params["l2c"][:3, 0], atol=1e-9)
    # A point 10 m ahead is in the middle of the front camera's image.
    front = info["cam_params"]["CAM_FRONT"]
    x, _, z = (front["l2c"] @ [0.0, 10.0, 0.0, 1.0])[:3]
    assert z > 7.0 and abs(x) < 0.5
    assert (front["l2c"] @ [2.0, 10.0, 0.0, 1.0])[0] > x + 1.9, "x is to the right"


def _rotation(first, second, third):
    """Rx Ry Rz, as SCR.from_euler("XYZ", ...) of HUGSIM's sim/utils/sim_utils.py:8 multiplies them."""

    def about(axis, angle):
        matrix, (i, j) = np.eye(3), [(1, 2), (2, 0), (0, 1)][axis]
        matrix[[i, j], [i, j]] = np.cos(angle)
        matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
        return matrix

    return about(0, first) @ about(1, second) @ about(2, third)


def test_angles_are_those_of_rotations():
    for angles in [(0, 0, 0), (0.1, -0.7, 0.05), (-0.2, 1.5, 0.3), (0.02, 2.5, -0.01), (0.0, -3.0, 0.0)]:
        np.testing.assert_allclose(_euler_xyz(_rotation(*angles)), angles, atol=1e-9)


def test_a_turn_to_the_right_has_the_signs_of_hugsim(env):
    """hug_sim.py:289-300: with a steer_rate above zero the second angle rises and x of ego_pos grows for an ego that looks along z."""
    _, before = env.reset(seed=3)
    for _ in range(3):
        _, _, over, _, info = env.step({"acc": 1.0, "steer_rate": 0.15})
        assert not over
    assert info["ego_steer"] > before["ego_steer"] + 0.1 and info["steer_rate"] == 0.15
    assert info["ego_rot"][1] > before["ego_rot"][1] + 0.01, "the heading is to the right where above zero"
    heading = before["ego_rot"][1]
    moved = np.array(info["ego_pos"]) - before["ego_pos"]
    right = moved @ [np.cos(heading), 0.0, -np.sin(heading)]
    assert right > 0.02, "and so is what was driven"


def test_actions_accelerate_and_turn_the_wheels(env):
    env.reset(seed=3)
    _, before = env.reset(seed=3)
    action = {"acc": 2.0, "steer_rate": 0.2}
    assert env.action_space.contains({"acc": np.array(2.0), "steer_rate": np.array(0.2)})
    _, _, terminated, truncated, info = env.step(action)
    assert not (terminated or truncated) and info["timestamp"] == 0.25
    assert 0.25 < info["ego_velo"] - before["ego_velo"] <= 0.51
    assert 0.0 < info["ego_steer"] - before["ego_steer"] <= 0.051, "to the right"
    assert info["accelerate"] == 2.0 and info["steer_rate"] == 0.2


def test_plans_turn_right_where_x_is_above_zero(env):
    def turned(side):
        env.reset(seed=3)
        for _ in range(4):
            _, _, over, _, info = env.step_plan(AHEAD + side * np.column_stack([np.arange(1, 7) ** 2 * 0.05, np.zeros(6)]))
            assert not over
        return info["ego_box"][6]

    assert turned(1.0) < turned(0.0) < turned(-1.0)
    for plan in (np.zeros((0, 2)), np.zeros((6, 3)), np.full((6, 2), np.nan)):
        with pytest.raises(ValueError, match="plan: expected"):
            env.step_plan(plan)


def test_a_pickle_that_is_no_array_is_not_loaded():
    for plan in (AHEAD, None):
        assert np.array_equal(_Plans(io.BytesIO(pickle.dumps(plan))).load(), plan)
    with pytest.raises(pickle.UnpicklingError, match="posix.system|nt.system"):
        _Plans(io.BytesIO(pickle.dumps(os.system))).load()


PLANNER = """
    import pickle, sys
    import numpy as np
    folder, steps = sys.argv[-1], 0
    while True:
        with open(f"{folder}/obs_pipe", "rb") as pipe:
            message = pickle.loads(pipe.read())
        if message == "Done":
            break
        observation, info = message
        assert observation["rgb"]["CAM_FRONT"].shape == (32, 48, 3)
        steps += 1
        plan = None if steps > 6 else np.column_stack([np.zeros(6), 2.0 * np.arange(1, 7)])
        with open(f"{folder}/plan_pipe", "wb") as pipe:
            pipe.write(pickle.dumps(plan))
        if plan is None and ENDS_BY_ITSELF:
            break
    open(f"{folder}/steps", "w").write(str(steps))
"""


# HUGSIM's own clients end by themselves after the plan None (VAD_SIM at 0c74967, tools/closeloop/e2e.py), others read "Done".
@pytest.mark.parametrize("ends_by_itself", [False, True])
def test_a_planner_drives_through_pipes(env, tmp_path, ends_by_itself):
    script = tmp_path / "planner.py"
    script.write_text(textwrap.dedent(PLANNER).replace("ENDS_BY_ITSELF", str(ends_by_itself)))
    info = run_pipes(env, tmp_path / "loop", [sys.executable, str(script)], seed=3)
    assert info["timestamp"] == 1.5 and info["rc"] > 0.0
    assert (tmp_path / "loop" / "steps").read_text() == "7"
    script.write_text("raise SystemExit(3)")
    with pytest.raises(RuntimeError, match="the planner ended with 3"):
        run_pipes(env, tmp_path / "loop", [sys.executable, str(script)], seed=3)


@pytest.fixture
def address(env):
    with server(env, ("127.0.0.1", 0), seed=3, token="secret") as serving:
        thread = threading.Thread(target=serving.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{serving.server_address[1]}"
        serving.shutdown()
        thread.join()


def test_hugsim_s_own_client_drives_over_http(address, monkeypatch):
    client_module = pytest.importorskip("hugsim_client", reason="the package hugsim-client is not installed")
    monkeypatch.setenv("IN_HF_SPACE", "false")
    client = client_module.HugsimClient(host=address, api_token="secret")
    client.reset_env()
    state = client.get_current_state()
    assert not state.done and state.state.info["timestamp"] == 0.0
    for step in range(1, 4):
        state = client.execute_action(AHEAD)
        assert state.state.info["timestamp"] == 0.25 * step
        assert state.state.obs["rgb"]["CAM_BACK"].shape == (32, 48, 3)
    assert state.state.info["rc"] > 0.0 and not state.cur_scene_done
    client.reset_env()
    assert client.get_current_state().state.info["timestamp"] == 0.0


def asked(address, path, body=None, token="secret"):
    request = urllib.request.Request(address + path, body, {"auth-token": token, "Content-Type": "application/json"})
    try:
        with urllib.request.urlopen(request) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def test_http_requests_that_make_no_sense_are_refused_and_repeats_are_driven_once(address):
    assert asked(address, "/reset", b"")[0] == 200
    assert asked(address, "/get_current_state", token="other")[0] == 401
    assert asked(address, "/elsewhere")[0] == 404
    for body in (b"", b"{", b"{}", b'{"plan_traj": "[]", "transaction_id": "1"}', b'{"plan_traj": "{\\"data\\": [1], \\"shape\\": [6, 2]}", "transaction_id": "1"}'):
        code, said = asked(address, "/execute_action", body)
        assert code == 400 and b"this is no plan" in said, body
    plan = b'{"plan_traj": "{\\"data\\": [[0, 2], [0, 4], [0, 6]], \\"shape\\": [3, 2], \\"dtype\\": \\"float64\\"}", "transaction_id": "a"}'
    first, again = asked(address, "/execute_action", plan), asked(address, "/execute_action", plan)
    assert first[0] == 200 and first == again
    later = asked(address, "/execute_action", plan.replace(b'"a"', b'"b"'))
    times = [pickle.loads(content)["state"]["info"]["timestamp"] for _, content in (first, later)]
    assert times == [0.25, 0.5]


def test_gymnasium_finds_the_environments_without_another_import():
    script = """
        import gymnasium
        env = gymnasium.make("decouplegs.gym:decouplegs/Drive-v0", size=(48, 32), cameras=["front"], background=4000, agent_splats=64)
        assert env.reset(seed=1)[0]["cameras"]["front"].shape == (32, 48, 3)
        hugsim = gymnasium.make("decouplegs.gym:decouplegs/HUGSim-v0", size=(48, 32), background=4000, agent_splats=64)
        assert hugsim.reset(seed=1)[0]["rgb"]["CAM_FRONT"].shape == (32, 48, 3)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
