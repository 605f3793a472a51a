"""Gymnasium environments over the closed loop: cameras are drawn, the ego does as it is told, traffic answers.

>>> import gymnasium
>>> env = gymnasium.make("decouplegs.gym:decouplegs/Drive-v0", level="medium", size=(320, 180))
>>> observation, info = env.reset(seed=7)
>>> observation["cameras"]["front"].shape
(180, 320, 3)
>>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

``DriveVectorEnv`` (``gymnasium.make_vec``) drives many worlds over one resident street and draws all of them in one call.

Observation, a dict:

- ``cameras``: the rig's images by name, uint8 [H, W, 3];
- ``lidars``, where some are asked for: sweeps that end at the step by name, float32 [rings, columns, 2]: range in meters, 0 without a
  return, and intensity from 0 to 1;
- ``ego``: speed m/s, acceleration m/s2, angle of the wheels rad, yaw rate rad/s, float32 [4];
- ``guidance``: turn (1 left, -1 right, 0 straight on), meters until it, radians it turns by, its length in meters, speed the route is to be
  driven at in m/s, float32 [5];
- ``route``: places on the route ahead, 5 m apart, x forward and y left of the ego, meters, float32 [10, 2].

Action, by ``action``:

- ``controls``: angle of the wheels in rad (left above zero) and acceleration in m/s2, float32 [2];
- ``plan``: places in the ego's frame for the times ``plan_step_s``, 2 ``plan_step_s``, ..., meters, float32 [``plan_points``, 2].

Reward of a step, its parts in ``info["reward"]``: ``progress``, meters driven along the route over what the route's speed makes of a step;
``off_road``, -0.5 times the share of the step with a wheel off the road; ``collision``, -10 where the ego touches a vehicle or an obstacle.
An episode terminates with the route done, a collision, or when the ego has left the road or its route, and is truncated when its time is over. ``info["score"]`` has what a log of the
episode so far scores.

The same seed gives the same bytes, on the same device.
"""

from __future__ import annotations

from typing import Any, Literal, Sequence

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from . import _native

__all__ = ["DriveEnv", "DriveVectorEnv", "register_envs"]

OFF_ROAD_REWARD = -0.5
COLLISION_REWARD = -10.0
LEVELS = ("easy", "medium", "hard", "extreme")
ROUTE_POINTS = 10
ROUTE_SPACING_M = 5.0
# What the ego can do; more is clamped by it.
STEER_MAX_RAD = 0.6
BRAKING_MAX_MPS2 = 8.0
ACCELERATION_MAX_MPS2 = 3.0
PLAN_DISTANCE_MAX_M = 200.0
FAR_M = 10_000.0
_TURNS = {"left": 1.0, "straight": 0.0, "right": -1.0}


def register_envs() -> None:
    """Registers ``decouplegs/Drive-v0`` and ``decouplegs/HUGSim-v0``; done when this module is imported."""
    if "decouplegs/Drive-v0" not in gymnasium.registry:
        gymnasium.register(
            id="decouplegs/Drive-v0",
            entry_point="decouplegs.gym:DriveEnv",
            vector_entry_point="decouplegs.gym:DriveVectorEnv",
        )
        gymnasium.register(id="decouplegs/HUGSim-v0", entry_point="decouplegs.hugsim:HUGSimEnv")


class _Course:
    """What environments of one place share: the street on the device, the spaces, who looks."""

    def __init__(
        self,
        *,
        session: _native.Session | None,
        site: _native.Site | None,
        device: int | str | None,
        level: str,
        size: tuple[int, int],
        cameras: Sequence[str] | None,
        lidars: Sequence[str],
        action: Literal["controls", "plan"],
        plan_points: int,
        plan_step_s: float,
        step_s: float,
        duration_s: float,
        weather: str,
        background: int,
        agent_splats: int,
        place_seed: int,
        scenario: str | None,
    ) -> None:
        if level not in LEVELS:
            raise ValueError(f"level: expected {', '.join(LEVELS[:-1])} or {LEVELS[-1]}, found {level!r}")
        if site is not None and session is None:
            raise ValueError("site: give the session that it was opened in, too")
        self.session = session or _native.Session(device, exported=False)
        if self.session.color != "u8":
            raise ValueError('session: the environment shows bytes; open the session with color="u8"')
        self.site = site or _native.Site(
            self.session,
            weather=weather,
            background=background,
            agent_splats=agent_splats,
            seed=place_seed,
            scenario=scenario,
        )
        self.level, self.size, self.step_s, self.duration_s = level, tuple(size), step_s, duration_s
        rig = {camera.name: camera.resized(*self.size) for camera in self.site.rig}
        names = list(rig) if cameras is None else list(cameras)
        unknown = [name for name in names if name not in rig]
        if unknown or not names:
            raise ValueError(f"cameras: expected some of {', '.join(rig)}, found {', '.join(unknown) or 'none'}")
        self.rig = {name: rig[name] for name in names}
        of_scene = {lidar.name: lidar for lidar in self.site.scene.lidars}
        self.lidars = {name: of_scene.get(name) or _native.Lidar(name) for name in lidars}
        self.renderer = self.session.batch_renderer()
        self.plan_times = None
        if action == "controls":
            low, high = [-STEER_MAX_RAD, -BRAKING_MAX_MPS2], [STEER_MAX_RAD, ACCELERATION_MAX_MPS2]
            self.action_space = spaces.Box(np.array(low, np.float32), np.array(high, np.float32))
        elif action == "plan":
            self.plan_times = plan_step_s * np.arange(1, plan_points + 1)
            self.action_space = spaces.Box(-PLAN_DISTANCE_MAX_M, PLAN_DISTANCE_MAX_M, (plan_points, 2), np.float32)
        else:
            raise ValueError(f'action: expected "controls" or "plan", found {action!r}')
        self.observation_space = self._observation_space()

    def _observation_space(self) -> spaces.Dict:
        width, height = self.size
        image = spaces.Box(0, 255, (height, width, 3), np.uint8)
        ego = np.array([100.0, 50.0, 1.0, 10.0], np.float32)
        far = np.array([1.0, FAR_M, 2 * np.pi, FAR_M, 100.0], np.float32)
        sweeps = {
            name: spaces.Box(0.0, max(lidar.range_m[1], 1.0), (lidar.rings, lidar.columns, 2), np.float32)
            for name, lidar in self.lidars.items()
        }
        return spaces.Dict(
            {
                **({"lidars": spaces.Dict(sweeps)} if sweeps else {}),
                "cameras": spaces.Dict({name: image for name in self.rig}),
                "ego": spaces.Box(-ego, ego, dtype=np.float32),
                "guidance": spaces.Box(-far, far, dtype=np.float32),
                "route": spaces.Box(-FAR_M, FAR_M, (ROUTE_POINTS, 2), np.float32),
            }
        )


class _Drive:
    """One world of a course."""

    def __init__(self, course: _Course) -> None:
        self.course = course
        self.world = _native.World(course.site.scene, empty=True)
        self.rollout: _native.Rollout | None = None
        self.sweeps: dict[str, np.ndarray] = {}

    def begin(self, seed: int, options: dict[str, Any] | None) -> dict[str, Any]:
        level = (options or {}).get("level", self.course.level)
        self.rollout = _native.Rollout(
            self.course.site,
            level,
            seed,
            step_s=self.course.step_s,
            duration_s=self.course.duration_s,
            name="gymnasium",
        )
        return {"scenario": self.rollout.scenario, "scenario_seed": seed, "score": self.rollout.score()}

    def step(self, action: np.ndarray) -> tuple[float, bool, bool, dict[str, Any]]:
        if self.rollout is None:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        action = np.asarray(action, np.float64)
        expected = self.course.action_space.shape
        if action.shape != expected:
            raise ValueError(f"action: expected an array of shape {list(expected)}, found {list(action.shape)}")
        if self.course.plan_times is None:
            steer_rad, acceleration_mps2 = action
            result = self.rollout.step_controls(float(steer_rad), float(acceleration_mps2))
        else:
            result = self.rollout.step_plan(np.column_stack([self.course.plan_times, action]))
        cruise_mps = self.rollout.guidance["cruise_mps"]
        parts = {
            "progress": result["progress_m"] / (max(cruise_mps, 1.0) * self.rollout.step_s),
            "off_road": OFF_ROAD_REWARD * result["off_road_share"],
            "collision": COLLISION_REWARD * (result["end"] in ("collision", "obstacle")),
        }
        terminated = result["end"] in ("route_done", "collision", "obstacle", "off_road", "off_route", "story")
        truncated = result["end"] == "time"
        info = {"reward": parts, "end": result["end"], "time_s": result["time_s"], "score": self.rollout.score()}
        return float(sum(parts.values())), terminated, truncated, info

    def view(self) -> tuple[_native.World, list[_native.Camera]]:
        """What is to be drawn: the world as it is now, and the cameras on the ego."""
        assert self.rollout is not None
        world_from_rig = self.rollout.show(self.world)
        self.sweeps = {name: self.sweep(lidar, world_from_rig) for name, lidar in self.course.lidars.items()}
        return self.world, [camera.at(world_from_rig) for camera in self.course.rig.values()]

    def sweep(self, lidar: _native.Lidar, world_from_rig: np.ndarray) -> np.ndarray:
        """Range and intensity by ring and column, float32 [rings, columns, 2]."""
        assert self.rollout is not None
        velocity, turn = self.rollout.ego_motion
        found = self.course.renderer.sweep(self.world, lidar, world_from_rig, velocity=velocity, turn=turn, seed=self.rollout.steps)
        image = np.zeros((lidar.rings, lidar.columns, 2), np.float32)
        image[found["ring"], found["column"]] = np.column_stack([np.clip(found["range"], 0.0, lidar.range_m[1]), found["intensity"]])
        return image

    def observe(self, images: np.ndarray) -> dict[str, Any]:
        """The observation, with images uint8 [C, H, W, 4]."""
        assert self.rollout is not None
        guidance = self.rollout.guidance
        names = ("distance_m", "angle_rad", "length_m", "cruise_mps")
        told = [_TURNS[guidance["turn"]], *(guidance[name] for name in names)]
        space = self.course.observation_space
        return {
            **({"lidars": self.sweeps} if self.sweeps else {}),
            "cameras": {name: np.ascontiguousarray(image[..., :3]) for name, image in zip(self.course.rig, images)},
            "ego": _within(space["ego"], self.rollout.ego_state),
            "guidance": _within(space["guidance"], np.array(told)),
            "route": _within(space["route"], self.rollout.route_ahead(ROUTE_POINTS, ROUTE_SPACING_M)),
        }


def _within(space: spaces.Box, values: np.ndarray) -> np.ndarray:
    return np.clip(values.astype(np.float32), space.low, space.high)


def _scenario_seed(random: np.random.Generator) -> int:
    return int(random.integers(2**31))


class DriveEnv(gymnasium.Env):
    """One ego in traffic; see the module for observations, actions and rewards."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}

    def __init__(
        self,
        *,
        level: str = "easy",
        size: tuple[int, int] = (320, 180),
        cameras: Sequence[str] | None = None,
        lidars: Sequence[str] = (),
        action: Literal["controls", "plan"] = "controls",
        plan_points: int = 6,
        plan_step_s: float = 0.5,
        step_s: float = 0.5,
        duration_s: float = 20.0,
        weather: str = "clear",
        background: int = 200_000,
        agent_splats: int = 4_000,
        place_seed: int = 1,
        scenario: str | None = None,
        session: _native.Session | None = None,
        site: _native.Site | None = None,
        device: int | str | None = None,
        render_mode: str | None = None,
    ) -> None:
        """An environment on the synthetic street (``weather``, ``background`` and ``agent_splats`` splats, houses by ``place_seed``), or of
        one ``scenario`` file.

        ``size`` is (width, height) of the images, ``cameras`` names some of the rig's. ``lidars`` are LiDARs of the scene, or models on the
        roof of the ego, such as ``xt32``. Give ``session`` and ``site`` to share a
        place that is on the device already.
        """
        self.render_mode = render_mode
        self.course = _Course(
            session=session,
            site=site,
            device=device,
            level=level,
            size=size,
            cameras=cameras,
            lidars=lidars,
            action=action,
            plan_points=plan_points,
            plan_step_s=plan_step_s,
            step_s=step_s,
            duration_s=duration_s,
            weather=weather,
            background=background,
            agent_splats=agent_splats,
            place_seed=place_seed,
            scenario=scenario,
        )
        self.observation_space, self.action_space = self.course.observation_space, self.course.action_space
        self.drive = _Drive(self.course)
        self._last: np.ndarray | None = None

    def _observation(self) -> dict[str, Any]:
        images = self.course.renderer.draw([self.drive.view()])[0]
        self._last = images[0, ..., :3]
        return self.drive.observe(images)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Another episode, of ``options["level"]`` where it is given."""
        super().reset(seed=seed)
        info = self.drive.begin(_scenario_seed(self.np_random), options)
        return self._observation(), info

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Drives on for ``step_s`` seconds."""
        reward, terminated, truncated, info = self.drive.step(action)
        return self._observation(), reward, terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """What the first camera saw last, uint8 [H, W, 3]."""
        return self._last.copy() if self.render_mode == "rgb_array" and self._last is not None else None


class DriveVectorEnv(VectorEnv):
    """Many egos, each in a world of its own over one street, drawn in one call.

    Episodes that are over begin anew with the next step (``AutoresetMode.NEXT_STEP``), whose action is not examined for them.
    """

    metadata = {"render_modes": [], "render_fps": 2, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 2,
        *,
        level: str = "easy",
        size: tuple[int, int] = (320, 180),
        cameras: Sequence[str] | None = None,
        lidars: Sequence[str] = (),
        action: Literal["controls", "plan"] = "controls",
        plan_points: int = 6,
        plan_step_s: float = 0.5,
        step_s: float = 0.5,
        duration_s: float = 20.0,
        weather: str = "clear",
        background: int = 200_000,
        agent_splats: int = 4_000,
        place_seed: int = 1,
        scenario: str | None = None,
        session: _native.Session | None = None,
        site: _native.Site | None = None,
        device: int | str | None = None,
        render_mode: str | None = None,
    ) -> None:
        """As DriveEnv, ``num_envs`` times."""
        if num_envs < 1:
            raise ValueError(f"num_envs: expected at least 1, found {num_envs}")
        if render_mode is not None:
            raise ValueError("render_mode: a vector environment renders nothing; its observations are the images")
        self.num_envs, self.render_mode = num_envs, render_mode
        self.course = _Course(
            session=session,
            site=site,
            device=device,
            level=level,
            size=size,
            cameras=cameras,
            lidars=lidars,
            action=action,
            plan_points=plan_points,
            plan_step_s=plan_step_s,
            step_s=step_s,
            duration_s=duration_s,
            weather=weather,
            background=background,
            agent_splats=agent_splats,
            place_seed=place_seed,
            scenario=scenario,
        )
        self.single_observation_space, self.single_action_space = self.course.observation_space, self.course.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.drives = [_Drive(self.course) for _ in range(num_envs)]
        self._random = [np.random.default_rng() for _ in range(num_envs)]
        self._over = np.zeros(num_envs, bool)

    def _observation(self) -> dict[str, Any]:
        drawn = self.course.renderer.draw([drive.view() for drive in self.drives])
        each = [drive.observe(images) for drive, images in zip(self.drives, drawn)]
        observation: dict[str, Any] = {key: np.stack([one[key] for one in each]) for key in ("ego", "guidance", "route")}
        for kind, names in (("cameras", self.course.rig), ("lidars", self.course.lidars)):
            if names:
                observation[kind] = {name: np.stack([one[kind][name] for one in each]) for name in names}
        return observation

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Other episodes everywhere. Of one ``seed``, environment ``i`` gets ``seed + i``, as DriveEnv would."""
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + index for index in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed: expected {self.num_envs} seeds, found {len(seeds)}")
        infos: dict[str, Any] = {}
        for index, own in enumerate(seeds):
            if own is not None:
                self._random[index] = gymnasium.utils.seeding.np_random(own)[0]
            info = self.drives[index].begin(_scenario_seed(self._random[index]), options)
            infos = self._add_info(infos, info, index)
        self._over[:] = False
        return self._observation(), infos

    def step(self, actions: np.ndarray) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drives all on for ``step_s`` seconds."""
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool)
        infos: dict[str, Any] = {}
        for index, drive in enumerate(self.drives):
            if self._over[index]:
                info = drive.begin(_scenario_seed(self._random[index]), None)
            else:
                rewards[index], terminated[index], truncated[index], info = drive.step(actions[index])
            infos = self._add_info(infos, info, index)
        self._over = terminated | truncated
        return self._observation(), rewards, terminated, truncated, infos


register_envs()
