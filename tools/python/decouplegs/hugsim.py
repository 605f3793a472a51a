"""HUGSIM's interfaces over the closed loop, so that planners written for HUGSIM (Zhou et al., 2024) run unchanged.

- ``HUGSimEnv``, also ``gymnasium.make("decouplegs.gym:decouplegs/HUGSim-v0")``: its observations, info and actions;
- ``python -m decouplegs.hugsim pipes DIR -- COMMAND``: its closed loop, with a planner in a process of its own that reads and writes pickles
  through the FIFOs ``DIR/obs_pipe`` and ``DIR/plan_pipe``;
- ``python -m decouplegs.hugsim serve``: its HTTP interface, for the package ``hugsim-client``.

Frames, signs and layouts are those of HUGSIM's code (hyzhou404/HUGSIM at 62c690d of November 2025: ``sim/hugsim_env/envs/hug_sim.py``,
``sim/utils/sim_utils.py``, ``closed_loop.py``).

Observation, each by camera: ``rgb``, uint8 [H, W, 3]; ``depth``, float32 [H, W], meters along the camera's z, 0 where nothing was hit; ``semantic``,
uint8 [H, W], a class of Cityscapes: 10 the sky, 11 a pedestrian, 13 a vehicle, and 19, unlabeled, everything of the background. Cameras have their
nuScenes names (``CAM_FRONT``). A session that draws no such layers is refused: open it with ``depth=True, instance=True``.

Info:

- ``ego_pos`` [3]: the middle of the ego's box in a world of OpenCV's axes, x right, y down, z forward: (-y, -z, x) of the scene's;
- ``ego_rot`` [3]: its rotation in the same axes as intrinsic Euler angles XYZ, radians; the second is the heading, to the right where above zero;
- ``ego_box`` and ``obj_boxes``: [x, y, z, width, length, height, yaw], meters and radians, the scene's world (z up, yaw to the left), of the middle of the box;
- ``ego_velo`` m/s, ``accelerate`` m/s2; ``ego_steer`` rad and ``steer_rate`` rad/s, to the right where above zero;
- ``timestamp`` s, ``command`` (0 right, 1 left, 2 straight on), ``collision``, and ``rc``: the driven share of the first 90 % of the route; the episode
  ends at 1;
- ``cam_params`` by camera: ``intrinsic`` (``H``, ``W``, ``fx``, ``fy``, ``cx``, ``cy``, pixels, and ``fovx``, ``fovy``, radians), ``v2c``, float64 [4, 4],
  from the vehicle's frame (rear axle on the ground, x forward, y left, z up) to the camera's, and ``l2c``, from the LiDAR's, which is that of plans (x
  right, y forward, z up). The LiDAR is the scene's first, or where nuScenes has its LIDAR_TOP.

Action: ``acc`` m/s2 and ``steer_rate`` rad/s, to the right where above zero, for 0.25 s; the wheels turn at most 15 degrees, the acceleration is at most
2 m/s2 either way. A plan is [N, 2], meters, x to the right and y forward, 0.5 s apart; this program's own controller follows it, not HUGSIM's iLQR.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import io
import json
import os
import pickle
import select
import subprocess
import sys
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from . import _native
from .gym import LEVELS, _Course, _Drive

__all__ = ["HUGSimEnv", "main"]

STEP_S = 0.25
PLAN_STEP_S = 0.5
STEPS_MAX = 400
STEER_MAX_RAD = np.deg2rad(15.0)
ACCELERATION_MAX_MPS2 = 2.0
STEER_RATE_MAX_RADPS = 0.5
PLAN_POINTS_MAX = 200
PLAN_DISTANCE_MAX_M = 1_000.0
REQUEST_BYTES_MAX = 1 << 20
_COMMANDS = {"right": 0, "left": 1, "straight": 2}
_NUSCENES = {
    "front": "CAM_FRONT",
    "front_left": "CAM_FRONT_LEFT",
    "front_right": "CAM_FRONT_RIGHT",
    "back": "CAM_BACK",
    "back_left": "CAM_BACK_LEFT",
    "back_right": "CAM_BACK_RIGHT",
}
# From axes x forward, y left, z up to OpenCV's x right, y down, z forward.
_OPENCV_FROM_WORLD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
# From the axes of the LiDAR, x right, y forward, z up, to x forward, y left, z up.
_VEHICLE_FROM_LIDAR = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# The rear axle is so far behind the middle of the box, by its length: 1.35 m of 4.5 m, HUGSIM's Lr (configs/sim/kinematic.yaml).
REAR_AXLE_SHARE = 0.3
# LIDAR_TOP of nuScenes, from the rear axle on the ground, meters.
LIDAR_TOP_M = np.array([0.943713, 0.0, 1.84023])
# Share of the route at which it counts as completed (hug_sim.py, route_completion).
ROUTE_SHARE = 0.9
# Classes of Cityscapes, as HUGSIM's semantic images count them.
SKY, PEDESTRIAN, VEHICLE, UNLABELED = 10, 11, 13, 19
DEPTH_MAX_M = 1000.0
CLASSES_MAX = 50


class HUGSimEnv(gymnasium.Env):
    """One ego in traffic, as HUGSIM shows it; see the module for observations, info and actions."""

    metadata = {"render_modes": []}

    def __init__(
        self,
        *,
        scenario: str | None = None,
        level: str = "easy",
        size: tuple[int, int] = (800, 450),
        background: int = 200_000,
        agent_splats: int = 4_000,
        session: _native.Session | None = None,
        site: _native.Site | None = None,
        device: int | str | None = None,
    ) -> None:
        """An environment of one ``scenario`` file, or of scenarios of a ``level`` on the synthetic street. ``size`` is (width, height) of the images."""
        session = session or _native.Session(device, exported=False, depth=True, instance=True)
        missing = {"depth", "instance"} - set(session.layers)
        if missing:
            raise ValueError(f"session: HUGSIM shows depth and semantic too; open the session with {', '.join(f'{name}=True' for name in sorted(missing))}")
        self.course = _Course(
            session=session,
            site=site,
            device=device,
            level=level,
            size=size,
            cameras=None,
            lidars=(),
            action="controls",
            plan_points=1,
            plan_step_s=PLAN_STEP_S,
            step_s=STEP_S,
            duration_s=STEP_S * STEPS_MAX,
            weather="clear",
            background=background,
            agent_splats=agent_splats,
            place_seed=1,
            scenario=scenario,
        )
        self.drive = _Drive(self.course)
        width, height = size
        image = spaces.Box(0, 255, (height, width, 3), np.uint8)
        self.names = {name: _NUSCENES.get(name, name) for name in self.course.rig}
        layers = {
            "rgb": image,
            "semantic": spaces.Box(0, CLASSES_MAX, (height, width), np.uint8),
            "depth": spaces.Box(0.0, DEPTH_MAX_M, (height, width), np.float32),
        }
        self.observation_space = spaces.Dict({key: spaces.Dict({name: space for name in self.names.values()}) for key, space in layers.items()})
        self.action_space = spaces.Dict(
            {
                "acc": spaces.Box(-ACCELERATION_MAX_MPS2, ACCELERATION_MAX_MPS2, (), np.float64),
                "steer_rate": spaces.Box(-STEER_RATE_MAX_RADPS, STEER_RATE_MAX_RADPS, (), np.float64),
            }
        )
        self._controls = {"accelerate": 0.0, "steer_rate": 0.0}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Another episode."""
        super().reset(seed=seed)
        self.drive.begin(int(self.np_random.integers(2**31)), options)
        self._controls = {"accelerate": 0.0, "steer_rate": 0.0}
        return self._observed(False)

    def step(self, action: dict[str, Any]) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Drives on for 0.25 s with the given acceleration, while the wheels turn at the given rate, to the right where above zero."""
        acceleration = float(np.clip(action["acc"], -ACCELERATION_MAX_MPS2, ACCELERATION_MAX_MPS2))
        rate = float(np.clip(action["steer_rate"], -STEER_RATE_MAX_RADPS, STEER_RATE_MAX_RADPS))
        rollout = self._rollout()
        steer = float(np.clip(rollout.ego_state[2] - rate * STEP_S, -STEER_MAX_RAD, STEER_MAX_RAD))
        self._controls = {"accelerate": acceleration, "steer_rate": rate}
        return self._after(rollout.step_controls(steer, acceleration))

    def step_plan(self, plan: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Drives on for 0.25 s along a plan, [N, 2], meters, x to the right and y forward, 0.5 s apart.

        A plan of another shape, or with values that are not finite, is a ValueError.
        """
        plan = np.asarray(plan, np.float64)
        if plan.ndim != 2 or plan.shape[1] != 2 or not 1 <= len(plan) <= PLAN_POINTS_MAX:
            raise ValueError(f"plan: expected the shape [N, 2] with N from 1 to {PLAN_POINTS_MAX}, found {list(plan.shape)}")
        if not np.all(np.abs(plan) <= PLAN_DISTANCE_MAX_M):
            raise ValueError(f"plan: expected finite places within {PLAN_DISTANCE_MAX_M:.0f} m")
        times = PLAN_STEP_S * np.arange(1, len(plan) + 1)
        rollout = self._rollout()
        before = rollout.ego_state
        result = rollout.step_plan(np.column_stack([times, plan[:, 1], -plan[:, 0]]))
        after = rollout.ego_state
        self._controls = {"accelerate": float(after[1]), "steer_rate": float((before[2] - after[2]) / STEP_S)}
        return self._after(result)

    def _rollout(self) -> _native.Rollout:
        if self.drive.rollout is None:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        return self.drive.rollout

    def _after(self, result: _native.StepResult) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        rollout = self._rollout()
        collision = result["end"] in ("collision", "obstacle")
        terminated = result["end"] in ("route_done", "collision", "obstacle", "off_road", "off_route") or self._completion() >= 1.0
        truncated = result["end"] == "time" or (not terminated and rollout.steps >= STEPS_MAX)
        observation, info = self._observed(collision)
        return observation, 0.0, terminated, truncated, info

    def _completion(self) -> float:
        done, whole = self._rollout().progress_m
        return float(done / (ROUTE_SHARE * whole)) if whole > 0 else 1.0

    def _semantic(self, instance: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Classes of the pixels of one camera."""
        classes = np.full(2**16, UNLABELED, np.uint8)
        kinds = self._rollout().kinds
        # Instances beyond the kinds are lamps and signs.
        classes[1 : len(kinds)] = [PEDESTRIAN if kind == "pedestrian" else VEHICLE for kind in kinds[1:]]
        found = classes[instance]
        found[(instance == 0) & (depth <= 0.0)] = SKY
        return found

    def _observed(self, collision: bool) -> tuple[dict[str, Any], dict[str, Any]]:
        rollout = self._rollout()
        view = self.drive.view()
        layers = self.course.renderer.draw_layers([view])[0]
        names = list(self.names.values())
        observation = {
            "rgb": {name: np.ascontiguousarray(image[..., :3]) for name, image in zip(names, layers["color"])},
            "semantic": {name: self._semantic(*planes) for name, *planes in zip(names, layers["instance"], layers["depth"])},
            "depth": {name: np.minimum(depth, np.float32(DEPTH_MAX_M)) for name, depth in zip(names, layers["depth"])},
        }
        first = next(iter(self.course.rig.values()))
        world_from_rig = view[1][0].world_from_camera @ np.linalg.inv(first.rig_from_camera)
        speed, _, steer, _ = rollout.ego_state
        sizes = rollout.sizes
        lidars = self.course.site.scene.lidars
        # Instances beyond the sizes are lamps and signs.
        others = [agent for agent in view[0].agents if 0 < agent.instance < len(sizes)]
        info = {
            "ego_pos": (_OPENCV_FROM_WORLD @ world_from_rig[:3, 3]).tolist(),
            "ego_rot": _euler_xyz(_OPENCV_FROM_WORLD @ world_from_rig[:3, :3] @ _OPENCV_FROM_WORLD.T),
            "ego_velo": float(speed),
            "ego_steer": -float(steer),
            **self._controls,
            "timestamp": rollout.steps * rollout.step_s,
            "command": _COMMANDS[rollout.guidance["turn"]],
            "ego_box": _box(world_from_rig, sizes[0]),
            "obj_boxes": [_box(agent.pose, sizes[agent.instance]) for agent in others],
            "cam_params": {self.names[name]: _camera(camera, *_frames(sizes[0], lidars)) for name, camera in self.course.rig.items()},
            "rc": self._completion(),
            "collision": collision,
        }
        return observation, info


def _box(world_from_box: np.ndarray, size: np.ndarray) -> list[float]:
    """HUGSIM names the width before the length."""
    length, width, height = size.tolist()
    yaw = float(np.arctan2(world_from_box[1, 0], world_from_box[0, 0]))
    return [*world_from_box[:3, 3].tolist(), width, length, height, yaw]


def _euler_xyz(rotation: np.ndarray) -> list[float]:
    """The intrinsic Euler angles XYZ of a rotation, radians: of the two sets the one whose first angle is within 90 degrees, so that the second is the
    heading of an ego on a road all around."""
    first = np.arctan2(-rotation[1, 2], rotation[2, 2])
    if abs(first) > 0.5 * np.pi:
        first -= np.copysign(np.pi, first)
    sine, cosine = np.sin(first), np.cos(first)
    second = np.arctan2(rotation[0, 2], cosine * rotation[2, 2] - sine * rotation[1, 2])
    third = np.arctan2(cosine * rotation[1, 0] + sine * rotation[2, 0], cosine * rotation[1, 1] + sine * rotation[2, 1])
    return [float(angle) for angle in (first, second, third)]


def _frames(size: np.ndarray, lidars: list[_native.Lidar]) -> tuple[np.ndarray, np.ndarray]:
    """The frames of HUGSIM's vehicle and of its LiDAR in that of the rig, whose origin is the middle of the box of ``size``."""
    rig_from_vehicle, rig_from_lidar = np.eye(4), np.eye(4)
    rig_from_vehicle[:3, 3] = [-REAR_AXLE_SHARE * size[0], 0.0, -0.5 * size[2]]
    rig_from_lidar[:3, :3] = _VEHICLE_FROM_LIDAR
    rig_from_lidar[:3, 3] = lidars[0].rig_from_lidar[:3, 3] if lidars else rig_from_vehicle[:3, 3] + LIDAR_TOP_M
    return rig_from_vehicle, rig_from_lidar


def _camera(camera: _native.RigCamera, rig_from_vehicle: np.ndarray, rig_from_lidar: np.ndarray) -> dict[str, Any]:
    width, height, k = camera.width, camera.height, camera.K
    camera_from_rig = np.linalg.inv(camera.rig_from_camera)
    return {
        "intrinsic": {
            "H": height,
            "W": width,
            "fx": k[0, 0],
            "fy": k[1, 1],
            "cx": k[0, 2],
            "cy": k[1, 2],
            "fovx": 2 * np.arctan(width / (2 * k[0, 0])),
            "fovy": 2 * np.arctan(height / (2 * k[1, 1])),
        },
        "v2c": camera_from_rig @ rig_from_vehicle,
        "l2c": camera_from_rig @ rig_from_lidar,
    }


class _Plans(pickle.Unpickler):
    """Unpickles arrays and plain values; anything else is refused, because a pickle may run code."""

    ALLOWED = {
        ("numpy", "ndarray"),
        ("numpy", "dtype"),
        ("numpy.core.multiarray", "_reconstruct"),
        ("numpy._core.multiarray", "_reconstruct"),
        ("numpy.core.numeric", "_frombuffer"),
        ("numpy._core.numeric", "_frombuffer"),
        ("_codecs", "encode"),
    }

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self.ALLOWED:
            raise pickle.UnpicklingError(f"a plan is an array; found {module}.{name}, which is not loaded")
        return super().find_class(module, name)


def run_pipes(env: HUGSimEnv, folder: Path, command: list[str], seed: int) -> dict[str, Any]:
    """HUGSIM's closed loop with the planner ``command``, which is started with ``folder`` as its last argument; the last info.

    Each step, ``(observation, info)`` is pickled into ``folder/obs_pipe``, and the plan read from ``folder/plan_pipe``, ``None`` to end the episode.
    At the end the text "Done" is sent.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pipes = [folder / "obs_pipe", folder / "plan_pipe"]
    for pipe in pipes:
        if not pipe.is_fifo():
            os.mkfifo(pipe)
    planner = subprocess.Popen([*command, str(folder)])
    try:
        observation, info = env.reset(seed=seed)
        over = False
        while not over:
            _send(pipes[0], (observation, info), planner)
            plan = _receive(pipes[1], planner)
            if plan is None:
                # HUGSIM's own clients end by themselves after it, and read no "Done".
                with contextlib.suppress(RuntimeError):
                    _send(pipes[0], "Done", planner)
                planner.wait(timeout=30)
                return info
            observation, _, terminated, truncated, info = env.step_plan(plan)
            over = terminated or truncated
            print(f"\r{info['timestamp']:.2f} s, {100 * info['rc']:.0f} % of the route", end="", file=sys.stderr)
        _send(pipes[0], "Done", planner)
        planner.wait(timeout=30)
    finally:
        if planner.poll() is None:
            planner.kill()
        print(file=sys.stderr)
    return info


def _open(pipe: Path, flags: int, planner: subprocess.Popen) -> int:
    """Opens a FIFO when the planner does; a planner that has ended is an error."""
    while True:
        try:
            return os.open(pipe, flags | os.O_NONBLOCK)
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise
        if planner.poll() is not None:
            raise RuntimeError(f"the planner ended with {planner.returncode} before it opened {pipe.name}")
        time.sleep(0.002)


def _send(pipe: Path, message: Any, planner: subprocess.Popen) -> None:
    file = _open(pipe, os.O_WRONLY, planner)
    os.set_blocking(file, True)
    with os.fdopen(file, "wb") as out:
        out.write(pickle.dumps(message))


def _receive(pipe: Path, planner: subprocess.Popen) -> Any:
    file = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    content = b""
    with os.fdopen(file, "rb", buffering=0) as taken:
        while True:
            ready = select.select([taken], [], [], 0.2)[0]
            piece = taken.read(1 << 16) if ready else None
            if piece:
                content += piece
            elif content and piece == b"":
                return _Plans(io.BytesIO(content)).load()
            elif planner.poll() is not None:
                raise RuntimeError(f"the planner ended with {planner.returncode} before it gave a plan")
            elif piece == b"":
                time.sleep(0.002)


class _State:
    """One episode that HTTP requests drive."""

    def __init__(self, env: HUGSimEnv, seed: int) -> None:
        self.env, self.seed, self.lock = env, seed, Lock()
        self.answers: dict[str, bytes] = {}
        self.reset()

    def reset(self) -> None:
        self.observation, self.info = self.env.reset(seed=self.seed)
        self.over = False
        self.answers.clear()

    def pickled(self) -> bytes:
        state = {"obs": self.observation, "info": self.info}
        return pickle.dumps({"done": self.over, "cur_scene_done": self.over, "state": state})

    def execute(self, plan: np.ndarray, transaction: str) -> bytes:
        # A client that lost the answer asks again with the same transaction: it is not driven twice.
        if transaction in self.answers:
            return self.answers[transaction]
        if not self.over:
            self.observation, _, terminated, truncated, self.info = self.env.step_plan(plan)
            self.over = terminated or truncated
        self.answers = {transaction: self.pickled()}
        return self.answers[transaction]


def server(env: HUGSimEnv, address: tuple[str, int], *, seed: int = 0, token: str = "") -> ThreadingHTTPServer:
    """HUGSIM's HTTP interface: POST /reset, GET /get_current_state, POST /execute_action. Answers are pickles, as ``hugsim-client`` expects."""
    state = _State(env, seed)

    class Handler(BaseHTTPRequestHandler):
        def answer(self, code: int, content: bytes, kind: str = "application/octet-stream") -> None:
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def refused(self) -> bool:
            if token and self.headers.get("auth-token") != token:
                self.answer(401, b"the header auth-token is not the server's token", "text/plain")
                return True
            return False

        def do_GET(self) -> None:
            if self.refused():
                return
            if self.path != "/get_current_state":
                return self.answer(404, b"expected /get_current_state", "text/plain")
            with state.lock:
                content = state.pickled()
            self.answer(200, content)

        def do_POST(self) -> None:
            if self.refused():
                return
            length = self.headers.get("Content-Length", "0")
            if not length.isdigit() or int(length) > REQUEST_BYTES_MAX:
                return self.answer(413, f"expected at most {REQUEST_BYTES_MAX} bytes".encode(), "text/plain")
            body = self.rfile.read(int(length))
            if self.path == "/reset":
                with state.lock:
                    state.reset()
                return self.answer(200, b"ok", "text/plain")
            if self.path != "/execute_action":
                return self.answer(404, b"expected /reset or /execute_action", "text/plain")
            try:
                asked = json.loads(body)
                sent = json.loads(asked["plan_traj"])
                plan = np.array(sent["data"], np.float64).reshape(sent["shape"])
                with state.lock:
                    content = state.execute(plan, str(asked["transaction_id"]))
            except (ValueError, KeyError, TypeError) as error:
                return self.answer(400, f"this is no plan: {error}".encode(), "text/plain")
            self.answer(200, content)

        def log_message(self, *_: Any) -> None:
            """Requests are not logged."""

    return ThreadingHTTPServer(address, Handler)


def main(arguments: list[str] | None = None) -> int:
    """Runs the closed loop over FIFOs, or serves it over HTTP."""
    parser = argparse.ArgumentParser(prog="python -m decouplegs.hugsim", description="HUGSIM's closed loop for planners written for HUGSIM.")
    commands = parser.add_subparsers(dest="command", required=True)
    pipes = commands.add_parser("pipes", help="drive a planner in a process of its own, through obs_pipe and plan_pipe")
    pipes.add_argument("folder", type=Path, help="folder of the FIFOs, also the planner's last argument")
    pipes.add_argument("planner", nargs="+", help="command that starts the planner, after --")
    serve = commands.add_parser("serve", help="serve the HTTP interface of hugsim-client")
    serve.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    serve.add_argument("--port", type=int, default=8065, help="port; 0 takes a free one (default: %(default)s)")
    serve.add_argument("--token", default=os.environ.get("HUGSIM_API_TOKEN", ""), help="text that clients send as auth-token (default: $HUGSIM_API_TOKEN)")
    for command in (pipes, serve):
        command.add_argument("--scenario", help="scenario file (default: the synthetic street)")
        command.add_argument("--level", default="easy", choices=LEVELS, help="level on the synthetic street")
        command.add_argument("--seed", type=int, default=0, help="seed of the scenario (default: %(default)s)")
        command.add_argument("--size", type=_size, default=(800, 450), metavar="WxH", help="size of the images, pixels (default: 800x450)")
        command.add_argument("--background", type=int, default=200_000, help="splats of the synthetic street (default: %(default)s)")
    options = parser.parse_args(arguments)
    env = HUGSimEnv(scenario=options.scenario, level=options.level, size=options.size, background=options.background)
    if options.command == "pipes":
        try:
            info = run_pipes(env, options.folder, options.planner, options.seed)
        except (OSError, RuntimeError, ValueError, pickle.UnpicklingError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        print(json.dumps({"rc": info["rc"], "collision": info["collision"], "time_s": info["timestamp"], "score": env.drive.rollout.score()}, indent=2))
        return 0
    with server(env, (options.host, options.port), seed=options.seed, token=options.token) as serving:
        print(f"listening on http://{options.host}:{serving.server_address[1]}", flush=True)
        try:
            serving.serve_forever()
        except KeyboardInterrupt:
            pass
    return 0


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT in pixels, like 800x450, found {text!r}")
    return int(width), int(height)


if __name__ == "__main__":
    sys.exit(main())
