"""Several egos of one world, each with plans of its own."""

import json

import numpy as np
import pytest

import decouplegs

from program import decouplegs as decouplegs_program, needs_program


@pytest.fixture(scope="module")
def site(session):
    return decouplegs.Site(session, background=4_000, agent_splats=64)


def three(site):
    return decouplegs.Rollout(site, "medium", seed=5, duration_s=4.0, egos=3)


def plans_of(rollout, accelerations):
    """Straight on, each ego with its own acceleration, of those that have not ended."""
    egos = zip(rollout.egos, accelerations)
    return {ego.name: ego.plan_under(0.0, acceleration) for ego, acceleration in egos if ego.end is None}


def drive_to_the_end(rollout, accelerations):
    outcomes = []
    while plans := plans_of(rollout, accelerations):
        outcomes.append(rollout.step(plans))
        assert outcomes[-1].keys() == plans.keys()
    return outcomes


def test_three_egos_drive_as_each_is_told(site):
    rollout = three(site)
    names = [ego.name for ego in rollout.egos]
    assert names[0] == "ego" and len(set(names)) == 3
    before = {ego.name: ego.state[0] for ego in rollout.egos}
    outcomes = drive_to_the_end(rollout, [1.0, -3.0, 0.0])
    assert all(ego.end is not None for ego in rollout.egos)
    assert rollout.egos[0].state[0] > before["ego"] and rollout.egos[1].state[0] < before[names[1]]
    for ego in rollout.egos:
        driven_m = sum(outcome[ego.name]["progress_m"] for outcome in outcomes if ego.name in outcome)
        assert ego.progress_m[0] == pytest.approx(driven_m, abs=1e-9)
        assert 0 <= ego.score()["driving_score"] <= 1 and "pdm_score" in ego.sub_scores()
    # What is asked of the rollout is that of the first ego.
    assert rollout.score() == rollout.egos[0].score() and rollout.progress_m == rollout.egos[0].progress_m
    assert np.array_equal(rollout.ego_state, rollout.egos[0].state)
    with pytest.raises(decouplegs.Error, match="the episode is over"):
        rollout.step({})


def test_each_ego_sees_the_others_and_all_images_are_drawn_in_one_call(session, site):
    rollout = three(site)
    jobs, poses = [], []
    cameras = [decouplegs.Camera.look_at([-30.0, 0.0, 40.0], [20.0, 0.0, 0.0], up=[0.0, 0.0, 1.0], size=(64, 48))]
    for ego in rollout.egos:
        world = decouplegs.World(site.scene)
        poses.append(ego.show(world))
        jobs.append((world, cameras))
    assert len({tuple(pose.ravel()) for pose in poses}) == 3 and np.array_equal(rollout.show(jobs[0][0]), poses[0])
    counts = {len(world) for world, _ in jobs}
    assert len(counts) == 1 and counts.pop() >= 2, "the two other egos at least"
    images = session.batch_renderer().draw(jobs)
    assert [image.shape for image in images] == [(1, 48, 64, 4)] * 3
    assert not np.array_equal(images[0], images[1]), "what an ego does not see of itself, the others see"


@needs_program
def test_the_log_has_all_egos_and_replays(site, tmp_path):
    rollout = three(site)
    drive_to_the_end(rollout, [1.0, -3.0, 0.0])
    log = tmp_path / "three.log"
    rollout.write_log(log)
    decouplegs_program("score", log, "--out", tmp_path / "scored")
    episodes = json.loads((tmp_path / "scored/report.json").read_text())["episodes"]
    found = sorted(episode["driving_score"] for episode in episodes)
    assert found == pytest.approx(sorted(ego.score()["driving_score"] for ego in rollout.egos), abs=1e-12)
    assert "all vehicles move as in the log, to the last bit" in decouplegs_program("replay", log)


def test_with_one_ego_both_ways_to_step_write_the_same_log(site, tmp_path):
    one, other = (decouplegs.Rollout(site, "easy", seed=2, duration_s=2.0) for _ in range(2))
    assert [ego.name for ego in one.egos] == ["ego"]
    while one.end is None:
        plan = one.egos[0].plan_under(0.01, 0.5)
        assert one.step({"ego": plan})["ego"] == other.step_plan(plan)
    one.write_log(tmp_path / "one.log")
    other.write_log(tmp_path / "other.log")
    assert (tmp_path / "one.log").read_bytes() == (tmp_path / "other.log").read_bytes()


def test_plans_that_do_not_fit_the_egos_are_refused_and_nothing_moves(site):
    rollout = three(site)
    plans = plans_of(rollout, [0.0, 0.0, 0.0])
    names = list(plans)
    for wrong in [{}, {"ego": plans["ego"]}, plans | {"nobody": plans["ego"]}]:
        with pytest.raises(ValueError, match="expected one for each ego that has not ended"):
            rollout.step(wrong)
    with pytest.raises(ValueError, match=r"shape \[N, 3\]"):
        rollout.step(plans | {names[1]: [[0.0, 1.0]]})
    for alone in [lambda: rollout.step_plan(plans["ego"]), lambda: rollout.step_controls(0.0, 0.0)]:
        with pytest.raises(ValueError, match="the rollout has 3 egos"):
            alone()
    assert rollout.steps == 0
    for egos in [0, 9]:
        with pytest.raises(ValueError, match="egos: expected 1 to 8"):
            decouplegs.Rollout(site, egos=egos)
