"""Planners for DecoupleGS in Python, as engine/sim/planner-protocol.md has it. The standard library is enough; 3.9 or later.

    import decouplegs_planner

    class Mine(decouplegs_planner.Planner):
        name, cameras = "mine", "front"

        def plan(self, observation):
            speed_mps = observation.ego.speed_mps
            return [(0.25 * i, 0.25 * i * speed_mps, 0.0) for i in range(1, 17)]

    if __name__ == "__main__":
        decouplegs_planner.run(Mine)

and then `--planner "exec:python3 mine.py"`, or `python3 mine.py --socket PATH` in one terminal and `--planner unix:PATH` in
another. A driver of agents, for `--agents`, is an AgentDriver with `drive` in place of `plan`. What is printed goes to stderr, as
stdout belongs to the protocol. An exception in `begin` or `plan` ends the episode with its text as the reason; the planner goes on
with the next one.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import sys
import threading
import traceback
from types import SimpleNamespace
from typing import BinaryIO, Callable, Dict, Iterable, List, Tuple

PROTOCOL = 1


class ProtocolError(Exception):
    """The other side does not keep to the protocol."""


class Frame:
    """An image: `rgba` holds `height_px` rows from the top, each of `width_px` pixels of four bytes."""

    def __init__(self, camera: str, width_px: int, height_px: int, rgba: bytes):
        self.camera, self.width_px, self.height_px, self.rgba = camera, width_px, height_px, rgba

    def array(self):
        """The image as a numpy array of shape (height_px, width_px, 4), uint8, read-only. Needs numpy."""
        import numpy

        return numpy.frombuffer(self.rgba, numpy.uint8).reshape(self.height_px, self.width_px, 4)


class Sweep:
    """A sweep of a LiDAR that ends at the step: `points` holds `count` points of `POINT_BYTES` bytes, in the ego's frame."""

    POINT_BYTES = 24

    def __init__(self, lidar: str, count: int, points: bytes):
        self.lidar, self.count, self.points = lidar, count, points

    def array(self):
        """The points as a structured numpy array, read-only: x, y, z (meters), intensity (0 to 1), offset_ns since the start
        of the sweep, ring (from the highest row), laser. Needs numpy."""
        import numpy

        fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("offset_ns", "<u4"), ("ring", "<u2"),
                  ("laser", "<u2")]
        return numpy.frombuffer(self.points, numpy.dtype(fields))


class Observation:
    """What is known at a step.

    `step` counts from 0, `time_s` is since the episode's start. `ego` has speed_mps, acceleration_mps2, steer_rad and
    yaw_rate_radps; `guidance` has turn (straight, left, right), distance_m, angle_rad, length_m and cruise_mps. `frames` are the
    images by camera, `sweeps` the sweeps by LiDAR. `localization` is None or has path, each with time_s, position_m,
    rotation_wxyz, yaw_rad, speed_mps, acceleration_mps2 and yaw_rate_radps, and route_m. `privileged` is None or has ego, route_m, agents, stop_lines and signs.
    """

    def __init__(self, header: dict, frames: Dict[str, Frame], sweeps: Dict[str, Sweep]):
        self.step: int = header["step"]
        self.time_s: float = header["time_s"]
        self.ego = SimpleNamespace(**header["ego"])
        self.guidance = SimpleNamespace(**header["guidance"])
        self.frames, self.sweeps = frames, sweeps
        located = header.get("localization")
        self.localization = None if located is None else SimpleNamespace(
            path=[SimpleNamespace(**pose) for pose in located["path"]], route_m=located["route_m"])
        known = header.get("privileged")
        self.privileged = None if known is None else SimpleNamespace(
            ego=SimpleNamespace(**known["ego"]),
            route_m=known["route_m"],
            agents=[SimpleNamespace(**agent) for agent in known["agents"]],
            stop_lines=[SimpleNamespace(**line) for line in known["stop_lines"]],
            signs=[SimpleNamespace(**sign) for sign in known["signs"]],
        )


class Planner:
    """Base class of planners: set the requests below and override `plan`."""

    name = "unnamed"
    #: Images it wants: "none", "front" or "all".
    cameras = "none"
    #: Sweeps it wants: "none" or "all" LiDARs of the ego.
    lidars = "none"
    #: Whether it wants to be told its pose and the points of its route, as its own localization and navigation know them.
    localization = False
    #: Whether it wants to be told the states of others and its route, which no camera shows.
    privileged = False

    def begin(self, briefing: SimpleNamespace) -> None:
        """Before each episode: forget the one before.

        `briefing` has scenario, step_s, ego_size_m (length, width, height) and cameras, each a dictionary of name, width_px,
        height_px, fx_px, fy_px, cx_px, cy_px, and where it sits on the ego: position_m and rotation_wxyz. With LiDARs it has
        lidars too, each a dictionary of name, sensor, rings, columns, sweep_s, range_m, position_m and rotation_wxyz.
        """

    def plan(self, observation: Observation) -> Iterable[Tuple[float, float, float]]:
        """The way on: (seconds from now, meters ahead, meters to the left), times rising, at most 256 points."""
        raise NotImplementedError(f"{type(self).__name__} has no plan")


class AgentsObservation:
    """The traffic at a step, as a driver of agents sees it.

    `step` counts from 0, `time_s` is since the episode's start. `ego` is None or has position_m, yaw_rad, speed_mps,
    acceleration_mps2 and size_m. `agents` are the vehicles that take commands: each has the same and agent (its number),
    driven_by (model, track, commands), way_m (points of its way, 5 m apart, from beside it to 100 m ahead), offset_m and turn_rad
    from its way, limit_mps, stop_m (from its front to a line that is not green) and leader: None, or agent (None: the ego),
    gap_m and speed_mps. `others` are pedestrians and actors, `stop_lines` those of lights with their colors.
    """

    def __init__(self, header: dict):
        def known(value):
            return None if value is None else SimpleNamespace(**value)

        self.step: int = header["step"]
        self.time_s: float = header["time_s"]
        self.ego = known(header["ego"])
        self.agents = [SimpleNamespace(**{**agent, "leader": known(agent["leader"])}) for agent in header["agents"]]
        self.others = [SimpleNamespace(**other) for other in header["others"]]
        self.stop_lines = [SimpleNamespace(**line) for line in header["stop_lines"]]


class AgentDriver:
    """Base class of drivers of agents, for `--agents`: set the name and override `drive`."""

    name = "unnamed"

    def begin(self, briefing: SimpleNamespace) -> None:
        """Before each episode: forget the one before.

        `briefing` has scenario, seed, step_s, limits, lanes and agents, as engine/sim/planner-protocol.md has them.
        """

    def drive(self, observation: AgentsObservation) -> Iterable[tuple]:
        """Commands until the next step: (agent, m/s^2), which keeps to its way, or (agent, m/s^2, curvature in 1/m, positive to
        the left). Those without one are driven by the model."""
        raise NotImplementedError(f"{type(self).__name__} drives nobody")


def read_exactly(stream: BinaryIO, count: int) -> bytes:
    """`count` bytes of `stream`. Raises ProtocolError where it ends before."""
    parts: List[bytes] = []
    while count > 0:
        part = stream.read(min(count, 1 << 20))
        if not part:
            raise ProtocolError(f"the connection ended {count} bytes before the end of a message")
        parts.append(part)
        count -= len(part)
    return b"".join(parts)


def read_readings(stream: BinaryIO, header: dict) -> Tuple[Dict[str, Frame], Dict[str, Sweep]]:
    """The images and sweeps that follow the header of an observation."""
    images, clouds = header["frames"], header.get("sweeps", [])
    if sum(size["bytes"] for size in images + clouds) != header["bytes"]:
        raise ProtocolError(f"{header['bytes']} bytes follow; expected as many as frames and sweeps have together")
    frames, sweeps = {}, {}
    for size in images:
        rgba = read_exactly(stream, size["bytes"])
        frames[size["camera"]] = Frame(size["camera"], size["width_px"], size["height_px"], rgba)
    for size in clouds:
        sweeps[size["lidar"]] = Sweep(size["lidar"], size["points"], read_exactly(stream, size["bytes"]))
    return frames, sweeps


def answer_of_driver(driver: AgentDriver, header: dict) -> dict:
    """Answer of a driver of agents to a message other than `end`."""
    asked = header.get("type")
    if asked == "hello":
        if header.get("protocol") != PROTOCOL:
            raise ProtocolError(f"protocol {header.get('protocol')}; expected {PROTOCOL}")
        return {"type": "hello", "protocol": PROTOCOL, "drives": "agents", "name": driver.name}
    if asked not in ("begin", "observe"):
        raise ProtocolError(f"a message of type {asked!r}; expected hello, begin, observe or end")
    try:
        if asked == "begin":
            driver.begin(SimpleNamespace(**{key: value for key, value in header.items() if key not in ("type", "bytes")}))
            return {"type": "ready"}
        commands = [[int(agent), *map(float, numbers)] for agent, *numbers in driver.drive(AgentsObservation(header))]
        answer = {"type": "commands", "step": header["step"], "commands": commands}
        json.dumps(answer, allow_nan=False)
        return answer
    except Exception as error:  # pylint: disable=broad-except  # It is told why, whatever it is.
        traceback.print_exc(file=sys.stderr)
        return {"type": "fail", "reason": f"{type(error).__name__}: {error}"}


def answer_to(planner: Planner, header: dict, frames: Dict[str, Frame], sweeps: Dict[str, Sweep]) -> dict:
    """What `planner` answers to a message other than `end`."""
    asked = header.get("type")
    if asked == "hello":
        if header.get("protocol") != PROTOCOL:
            raise ProtocolError(f"protocol {header.get('protocol')}; expected {PROTOCOL}")
        wishes = {"name": planner.name, "cameras": planner.cameras, "privileged": planner.privileged}
        if planner.lidars != "none":
            wishes["lidars"] = planner.lidars
        if planner.localization:
            wishes["localization"] = True
        return {"type": "hello", "protocol": PROTOCOL, **wishes}
    if asked not in ("begin", "observe"):
        raise ProtocolError(f"a message of type {asked!r}; expected hello, begin, observe or end")
    try:
        if asked == "begin":
            planner.begin(SimpleNamespace(**{key: value for key, value in header.items() if key not in ("type", "bytes")}))
            return {"type": "ready"}
        points = [[float(number) for number in point] for point in planner.plan(Observation(header, frames, sweeps))]
        answer = {"type": "plan", "step": header["step"], "points": points}
        json.dumps(answer, allow_nan=False)
        return answer
    except Exception as error:  # pylint: disable=broad-except  # Whatever a planner raises ends its episode and nothing else.
        traceback.print_exc(file=sys.stderr)
        return {"type": "fail", "reason": f"{type(error).__name__}: {error}"}


def converse(planner: Planner | AgentDriver, reading: BinaryIO, writing: BinaryIO) -> None:
    """Answers messages until the other side ends. Raises ProtocolError where it does not keep to the protocol."""
    while True:
        line = reading.readline()
        if not line:
            return
        try:
            header = json.loads(line)
        except ValueError as error:
            raise ProtocolError(f"a line that is not JSON: {error}") from error
        frames, sweeps = {}, {}
        if header.get("type") == "end":
            return
        if isinstance(planner, AgentDriver):
            writing.write(json.dumps(answer_of_driver(planner, header)).encode() + b"\n")
            writing.flush()
            continue
        if header.get("type") == "observe":
            frames, sweeps = read_readings(reading, header)
        elif header.get("bytes"):
            read_exactly(reading, header["bytes"])
        writing.write(json.dumps(answer_to(planner, header, frames, sweeps)).encode() + b"\n")
        writing.flush()


def _over_stdio(make_planner: Callable[[], Planner]) -> None:
    """Speaks through stdin and stdout; whatever is printed from here on goes to stderr."""
    writing = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    converse(make_planner(), sys.stdin.buffer, writing)


def _over_connection(make_planner: Callable[[], Planner], connection: socket.socket) -> None:
    try:
        with connection, connection.makefile("rb") as reading, connection.makefile("wb") as writing:
            converse(make_planner(), reading, writing)
    except (ProtocolError, OSError) as error:
        print(f"a connection ended: {error}", file=sys.stderr)


def _over_socket(make_planner: Callable[[], Planner], path: str) -> None:
    """Listens at `path`; each connection has a planner and a thread of its own."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listening:
        listening.bind(path)
        try:
            listening.listen()
            while True:
                connection, _ = listening.accept()
                threading.Thread(target=_over_connection, args=(make_planner, connection), daemon=True).start()
        finally:
            os.unlink(path)


def run(make_planner: Callable[[], Planner]) -> None:
    """Answers through stdin and stdout, or, after `--socket PATH`, on a Unix socket until it is interrupted.

    `make_planner` is a class or a function without arguments: each connection has a planner of its own.
    """
    parser = argparse.ArgumentParser(description="A planner for DecoupleGS.")
    parser.add_argument("--socket", metavar="PATH", help="listen on a Unix socket rather than speak through stdin and stdout")
    path = parser.parse_args().socket
    try:
        if path is None:
            _over_stdio(make_planner)
        else:
            _over_socket(make_planner, path)
    except KeyboardInterrupt:
        pass
    except (ProtocolError, OSError) as error:
        sys.exit(f"the planner ended: {error}")
