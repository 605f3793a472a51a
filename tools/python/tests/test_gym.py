"""Environments over the closed loop, small."""

import json

import numpy as np
import pytest

import decouplegs

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from decouplegs.gym import DriveEnv, DriveVectorEnv  # noqa: E402

from program import decouplegs as decouplegs_program, needs_program  # noqa: E402

SMALL = {"size": (48, 32), "cameras": ["front", "front_left"]}


@pytest.fixture(scope="module")
def place(session):
    site = decouplegs.Site(session, background=4_000, agent_splats=64)
    return {"session": session, "site": site}


def same(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return np.array_equal(a, b)


def driven(env, seed, steps=4):
    observation, info = env.reset(seed=seed)
    seen = [observation]
    for step in range(steps):
        observation, reward, terminated, truncated, info = env.step(np.array([0.02 * step, 1.0], np.float32))
        seen.append({"observation": observation, "reward": np.array(reward)})
        if terminated or truncated:
            break
    return seen


def test_gymnasium_finds_it_and_its_checker_passes(place):
    env = gymnasium.make("decouplegs/Drive-v0", **SMALL, **place)
    check_env(env.unwrapped, skip_render_check=True)


def test_the_same_seed_gives_the_same_bytes(place):
    env, other = DriveEnv(**SMALL, **place), DriveEnv(**SMALL, **place)
    first = driven(env, 5)
    assert all(same(a, b) for a, b in zip(first, driven(env, 5)))
    assert all(same(a, b) for a, b in zip(first, driven(other, 5)))
    assert not same(first[0], driven(env, 6)[0])


def test_driving_on_earns_and_standing_does_not(place):
    env = DriveEnv(**SMALL, **place)
    env.reset(seed=1)
    _, driving, *_ = env.step(np.array([0.0, 1.0], np.float32))
    for _ in range(12):
        _, standing, terminated, truncated, info = env.step(np.array([0.0, -8.0], np.float32))
        if terminated:
            break
    assert driving > 0.3 and abs(standing) < 0.05
    assert set(info["reward"]) == {"progress", "off_road", "collision"} and 0 < info["score"]["route_completion"] < 1


def test_controls_do_what_they_say(place):
    env = DriveEnv(**SMALL, step_s=0.1, **place)
    before, _ = env.reset(seed=1)
    speed = before["ego"][0]
    for _ in range(5):
        after, *_ = env.step(np.array([0.05, 1.5], np.float32))
    assert abs(after["ego"][0] - speed - 0.75) < 0.1, "half a second at 1.5 m/s2"
    assert abs(after["ego"][2] - 0.05) < 0.01, "the wheels are turned"


def test_plans_are_driven(place):
    env = DriveEnv(**SMALL, action="plan", **place)
    observation, _ = env.reset(seed=1)
    along_the_route = np.vstack([[0, 0], observation["route"]])
    speed = float(observation["guidance"][4])
    arcs = 5.0 * np.arange(len(along_the_route))
    wanted = speed * 0.5 * np.arange(1, 7)
    plan = np.stack([np.interp(wanted, arcs, along_the_route[:, axis]) for axis in range(2)], 1).astype(np.float32)
    _, reward, terminated, _, info = env.step(plan)
    assert reward > 0.3 and not terminated and info["reward"]["off_road"] == 0


def test_time_truncates_and_the_log_is_written(place, tmp_path):
    env = DriveEnv(**SMALL, duration_s=1.0, **place)
    env.reset(seed=3)
    ends = [env.step(np.array([0.0, 0.0], np.float32))[2:4] for _ in range(2)]
    assert ends == [(False, False), (False, True)]
    with pytest.raises(decouplegs.Error, match="over"):
        env.step(np.zeros(2, np.float32))
    env.drive.rollout.write_log(tmp_path / "episode.log")
    assert (tmp_path / "episode.log").stat().st_size > 100


@needs_program
def test_scores_so_far_are_those_of_the_log(place, tmp_path):
    env = DriveEnv(**SMALL, duration_s=4.0, **place)
    env.reset(seed=3)
    for step in range(8):
        _, _, terminated, truncated, _ = env.step(np.array([0.01 * step, 1.0], np.float32))
        if terminated or truncated:
            break
    rollout = env.drive.rollout
    found, log = rollout.sub_scores(), tmp_path / "episode.log"
    rollout.write_log(log)
    decouplegs_program("score", log, "--out", tmp_path / "scored")
    episode = json.loads((tmp_path / "scored/report.json").read_text())["episodes"][0]
    rules = episode["rules"]
    expected = {"all_rules_score": rules["all_rules_score"], "reference_progress": rules["reference_progress"]}
    expected |= {"pdm_score": episode["pdm_score"], "extended_pdm_score": episode["extended_pdm"]["score"], "speed_compliance": episode["speed_compliance"]}
    expected |= {"lane_kept_share": rules["lane_keeping"]["kept_share"], "over_edge_s": rules["lane_keeping"]["over_edge_s"]}
    kinds = [breach["kind"] for breach in rules["breaches"]]
    expected |= {key: kinds.count(kind) for key, kind in [("on_crossing", "on_crossing"), ("blocking", "blocking"), ("wrong_turns", "wrong_turn")]}
    assert found == pytest.approx(expected, abs=1e-12) and 0 < found["reference_progress"] <= 1


def test_many_worlds_are_drawn_in_one_call_and_are_those_of_single_ones(place):
    many = DriveVectorEnv(3, **SMALL, **place)
    observations, _ = many.reset(seed=5)
    assert len(many.course.renderer.statistics) == 1 and many.course.renderer.statistics[0].cameras == 6
    assert many.observation_space.contains(observations)
    action = np.array([[0.0, 1.0]] * 3, np.float32)
    stepped, rewards, *_ = many.step(action)
    for index in range(3):
        single = DriveEnv(**SMALL, **place)
        first, _ = single.reset(seed=5 + index)
        second, reward, *_ = single.step(action[index])
        for expected, batch in ((first, observations), (second, stepped)):
            for name, image in expected["cameras"].items():
                np.testing.assert_array_equal(image, batch["cameras"][name][index])
            np.testing.assert_array_equal(expected["ego"], batch["ego"][index])
        assert reward == rewards[index]


def test_worlds_that_are_over_begin_anew(place):
    many = gymnasium.make_vec("decouplegs/Drive-v0", num_envs=2, duration_s=1.0, **SMALL, **place)
    many.reset(seed=[1, 2])
    idle = np.zeros((2, 2), np.float32)
    ends = [many.step(idle)[3].tolist() for _ in range(4)]
    assert ends == [[False, False], [True, True], [False, False], [False, False]]


def test_what_is_wrong_is_said(place):
    with pytest.raises(ValueError, match="front_left"):
        DriveEnv(cameras=["nowhere"], **place)
    with pytest.raises(ValueError, match="action"):
        DriveEnv(action="thoughts", **place)
    with pytest.raises(ValueError, match="level: expected easy, medium, hard or extreme, found 'esy'"):
        DriveEnv(level="esy", **place)
    env = DriveEnv(**SMALL, **place)
    with pytest.raises(ValueError, match="level"):
        env.reset(options={"level": "impossible"})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="finite"):
        env.step(np.array([np.nan, 0.0]))
    with pytest.raises(ValueError, match=r"action: expected an array of shape \[2\], found \[3\]"):
        env.step(np.zeros(3))
