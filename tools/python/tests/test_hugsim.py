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

from decouplegs.hugsim import HUGSimEnv, _Plans, _quaternion, run_pipes, server  # noqa: E402

# Two seconds at 4 m/s, and more to look ahead: x to the right, y forward.
AHEAD = np.column_stack([np.zeros(6), 2.0 * np.arange(1, 7)])


@pytest.fixture(scope="module")
def env(session):
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
    assert np.allclose(info["ego_box"][:2], info["ego_pos"][:2], atol=1e-6)
    # A point 10 m ahead in the plan's frame is in the middle of the front camera's image, left of it in a camera that looks right.
    front = info["cam_params"]["CAM_FRONT"]
    x, y, z = (front["l2c"] @ [0.0, 10.0, 0.0, 1.0])[:3]
    assert z > 7.0 and abs(x) < 0.5
    assert (front["l2c"] @ [2.0, 10.0, 0.0, 1.0])[0] > x + 1.9, "x is to the right"
    assert np.allclose(front["v2c"] @ [10.0, 0.0, 0.0, 1.0], front["l2c"] @ [0.0, 10.0, 0.0, 1.0])


def test_quaternions_are_those_of_rotations():
    turn = 0.7
    level = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    np.testing.assert_allclose(_quaternion(level), [np.cos(turn / 2), 0, 0, np.sin(turn / 2)], atol=1e-12)
    np.testing.assert_allclose(_quaternion(np.eye(3)), [1, 0, 0, 0], atol=1e-12)


def test_actions_accelerate_and_turn_the_wheels(env):
    env.reset(seed=3)
    _, before = env.reset(seed=3)
    action = {"acc": 2.0, "steer_rate": 0.2}
    assert env.action_space.contains({"acc": np.array(2.0), "steer_rate": np.array(0.2)})
    _, _, terminated, truncated, info = env.step(action)
    assert not (terminated or truncated) and info["timestamp"] == 0.25
    assert 0.25 < info["ego_velo"] - before["ego_velo"] <= 0.51
    assert 0.0 < info["ego_steer"] - before["ego_steer"] <= 0.051
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
    open(f"{folder}/steps", "w").write(str(steps))
"""


def test_a_planner_drives_through_pipes(env, tmp_path):
    script = tmp_path / "planner.py"
    script.write_text(textwrap.dedent(PLANNER))
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
