"""Sweeps of LiDARs, in worlds and in environments."""

import numpy as np
import pytest

import decouplegs

MODEL = """
name = "small"
row_elevations_deg = [10.0, 5.0, 0.0, -5.0]
columns = 360
rate_hz = 10.0
range_m = [0.5, 100.0]
"""

FIELDS = {
    "points": np.float32,
    "range": np.float32,
    "intensity": np.float32,
    "offset_ns": np.uint32,
    "column": np.uint32,
    "beam": np.uint32,
    "ring": np.uint16,
    "laser": np.uint16,
    "instance": np.uint16,
    "return_number": np.uint8,
    "return_count": np.uint8,
}


@pytest.fixture(scope="module")
def sensor(tmp_path_factory):
    path = tmp_path_factory.mktemp("sensors") / "small.toml"
    path.write_text(MODEL)
    return path


def test_a_sweep_meets_the_wall_where_it_is(session, scene, sensor):
    lidar = decouplegs.Lidar(sensor)
    assert (lidar.name, lidar.sensor, lidar.rings, lidar.columns, lidar.sweep_s) == ("small", "small", 4, 360, 0.1)
    assert np.array_equal(lidar.rig_from_lidar[:3, 3], [0.0, 0.0, 1.1])
    world, renderer = decouplegs.World(scene), session.batch_renderer()
    sweep = renderer.sweep(world, lidar, scene.ego_pose(0.0))
    assert {name: values.dtype.type for name, values in sweep.items()} == FIELDS
    count = len(sweep["range"])
    assert count > 100 and sweep["points"].shape == (count, 3)
    wall = sweep["points"][sweep["instance"] == 0]
    assert np.all(np.abs(wall[:, 0] - 12.0) < 0.5), wall[:, 0]
    # The third agent is another wall, 40 m to the left.
    beside = sweep["points"][sweep["instance"] == 3]
    assert len(beside) > 0 and np.all(np.abs(beside[:, 1] - 40.0) < 8.5), beside
    taken = np.from_dlpack(sweep["points"])
    assert np.array_equal(taken, sweep["points"])

    # Ego and agents are where they are at the end of the sweep; before that, where their motion had them.
    moving = renderer.sweep(world, lidar, scene.ego_pose(0.0), velocity=(20.0, 0.0, 0.0), frame="ego")
    raw = renderer.sweep(world, lidar, scene.ego_pose(0.0), velocity=(20.0, 0.0, 0.0), frame="raw")
    assert np.all(np.abs(moving["points"][moving["instance"] == 0][:, 0] - 12.0) < 0.5)
    ahead = (raw["column"] > 170) & (raw["column"] < 190) & (raw["instance"] == 0)
    assert np.all(np.abs(raw["points"][ahead][:, 0] - 13.0) < 0.5), "halfway through the sweep, 1 m less far on"
    velocity, turn = scene.ego_motion(1.0)
    assert velocity == pytest.approx([2.0, 0.0, 0.0]) and turn == [0.0, 0.0, 0.0]

    for wrong in ({"frame": "sky"}, {"returns": "first"}, {"opacity_min": 2.0}, {"velocity": (np.nan, 0.0, 0.0)}):
        with pytest.raises(ValueError, match=next(iter(wrong)) if "velocity" not in wrong else "finite"):
            renderer.sweep(world, lidar, scene.ego_pose(0.0), **wrong)
    with pytest.raises(decouplegs.FileError, match="no_such_sensor"):
        decouplegs.Lidar("no_such_sensor")
    assert scene.lidars == []


def test_an_environment_has_sweeps_of_one_shape(session, sensor):
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from decouplegs.gym import DriveEnv, DriveVectorEnv

    site = decouplegs.Site(session, background=4_000, agent_splats=64)
    options = {"size": (48, 32), "cameras": ["front"], "lidars": [str(sensor)], "session": session, "site": site}
    env = DriveEnv(**options)
    check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=3)
    sweep = observation["lidars"][str(sensor)]
    assert sweep.shape == (4, 360, 2) and np.count_nonzero(sweep[..., 0]) > 100
    many = DriveVectorEnv(2, **options)
    both, _ = many.reset(seed=3)
    assert np.array_equal(both["lidars"][str(sensor)][0], sweep)
    without = DriveEnv(**{**options, "lidars": []}).reset(seed=3)[0]
    assert "lidars" not in without and np.array_equal(without["cameras"]["front"], observation["cameras"]["front"])
