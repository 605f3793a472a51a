"""Drives episodes, one result file each: the part of a campaign that one process does, with or without a cluster.

    python episodes.py --out runs --episodes 20 --level medium            # all of them, here
    python episodes.py --out runs --episodes 1000 --share 3/100           # every hundredth, from the fourth on: a Slurm array task
    python episodes.py --out runs --episodes 200 --devices all            # a process for each device of this machine
    python episodes.py --out runs --episodes 200 --devices assigned       # for each that Slurm or Ray gave this process

An episode whose result is there is not driven again, so that any share may be started again after whatever stopped it. Results
are written under another name and renamed: a file that is there is whole. The seed of an episode is its number. The device that
drove an episode is in its result. With --devices, an episode whose device fails goes back to the queue, and another one drives it.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import queue
import subprocess
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import decouplegs
from decouplegs.gym import DriveEnv

WHEELBASE_M = 2.9
SPEED_GAIN_PER_S = 0.8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What an episode is."""
    parser.add_argument("--out", type=Path, required=True, help="folder of the results, one JSON file an episode")
    parser.add_argument("--episodes", type=int, default=4, help="how many there are in all, with seeds from 0 on (default 4)")
    parser.add_argument("--level", default="easy", choices=["easy", "medium", "hard", "extreme"])
    parser.add_argument("--size", default="160x90", help="images, WIDTHxHEIGHT (default 160x90)")
    parser.add_argument("--background", type=int, default=100_000, help="splats of the street (default 100000)")
    parser.add_argument("--duration", type=float, default=20.0, help="seconds that an episode lasts at most (default 20)")


def follow(observation: dict[str, Any]) -> np.ndarray:
    """A driver to have one: steers for the route ahead, keeps the route's speed, and does not look at the images."""
    speed_mps = float(observation["ego"][0])
    ahead = observation["route"][min(1 + int(speed_mps / 5.0), 9)]
    distance_m = max(float(np.hypot(*ahead)), 1.0)
    steer_rad = np.arctan2(2.0 * WHEELBASE_M * ahead[1] / distance_m, distance_m)
    return np.array([steer_rad, SPEED_GAIN_PER_S * (observation["guidance"][4] - speed_mps)], np.float32)


class Driver:
    """A device, and the street on it, for as many episodes as come."""

    def __init__(self, options: argparse.Namespace, device: str | None = None) -> None:
        self.options = options
        width, height = map(int, options.size.split("x"))
        self.env = DriveEnv(
            level=options.level,
            size=(width, height),
            cameras=["front"],
            background=options.background,
            duration_s=options.duration,
            device=device,
        )
        self.session = self.env.course.session

    def drive(self, seed: int, on_step=lambda step: None) -> dict[str, Any]:
        """What came of the episode: its score, and a hash of all its images, which tells whether two runs saw the same."""
        since = time.perf_counter()
        observation, info = self.env.reset(seed=seed)
        images, steps, reward, over = hashlib.sha256(), 0, 0.0, False
        while not over:
            images.update(observation["cameras"]["front"].tobytes())
            on_step(steps)
            action = np.clip(follow(observation), self.env.action_space.low, self.env.action_space.high)
            observation, step_reward, terminated, truncated, info = self.env.step(action)
            steps, reward, over = steps + 1, reward + step_reward, terminated or truncated
        return {
            "seed": seed,
            "level": self.options.level,
            "steps": steps,
            "end": info["end"],
            "reward": reward,
            "score": info["score"],
            "images_sha256": images.hexdigest(),
            "device": self.session.device.uuid,
            "seconds": time.perf_counter() - since,
            "version": decouplegs.__version__,
        }


def result_path(options: argparse.Namespace, seed: int) -> Path:
    """Where the result of an episode is: independent of the process that drives it."""
    return options.out / f"{options.level}_{seed:06}.json"


def write_result(path: Path, result: dict[str, Any]) -> None:
    """Writes it whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w") as file:
            json.dump(result, file, indent=1, default=float)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def devices_of(text: str) -> list[str]:
    """UUIDs of `all` devices of this machine but software ones (if there are others), of those that are `assigned` to this process, or as
    they are listed."""
    if text == "assigned":
        return assigned()
    if text != "all":
        return text.split(",")
    there = decouplegs.devices()
    return [device.uuid for device in [device for device in there if device.kind != "cpu"] or there]


def assigned() -> list[str]:
    """UUIDs of the GPUs that Slurm or Ray gave this process. They name them as CUDA does, and Vulkan sees them all: their UUIDs are equal."""
    visible = [name.strip() for name in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if name.strip()]
    if not visible:
        raise SystemExit("no GPU is assigned: CUDA_VISIBLE_DEVICES is not set; ask for some (--gres=gpu:2, num_gpus=1), or name devices")
    ask = ["nvidia-smi", "--query-gpu=uuid", "--format=csv,noheader"]
    try:
        names = [name if name.startswith("GPU-") else subprocess.check_output([*ask, f"--id={name}"], text=True).strip() for name in visible]
    except (OSError, subprocess.CalledProcessError) as error:
        raise SystemExit(f"nvidia-smi does not say which GPUs {','.join(visible)} are ({error}): name devices by their UUIDs") from error
    return ["uuid:" + name.removeprefix("GPU-").replace("-", "") for name in names]


_driver: Driver | None = None


def _drive_here(options: argparse.Namespace, device: str, seed: int) -> str:
    """Drives an episode in a process that has the device alone; a line about it."""
    global _driver
    if _driver is None:
        _driver = Driver(options, device)
    result = _driver.drive(seed, lambda step: drill(options, seed, step))
    write_result(result_path(options, seed), result)
    return report(result)


def drill(options: argparse.Namespace, seed: int, step: int) -> None:
    """Dies like a process whose device is gone, in the middle of the episode of --drill, once."""
    mark = options.out / ".drill"
    if seed == options.drill and step == 2 and not mark.exists():
        options.out.mkdir(parents=True, exist_ok=True)
        mark.touch()
        os._exit(1)


def report(result: dict[str, Any]) -> str:
    """A line about an episode."""
    return f"{result['seed']}: {result['end']} after {result['steps']} steps, {result['seconds']:.1f} s"


def drive_on(options: argparse.Namespace, devices: list[str], seeds: list[int]) -> None:
    """Drives the episodes by one process for each device, from one queue."""
    waiting: queue.Queue[int] = queue.Queue()
    for seed in seeds:
        waiting.put(seed)
    missing, changed = set(seeds), threading.Condition()

    def work(device: str) -> None:
        # A child of its own: a device that fails takes its process with it, and no other.
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
            while True:
                with changed:
                    changed.wait_for(lambda: not missing or not waiting.empty())
                    if not missing:
                        return
                    seed = waiting.get()
                try:
                    print(process.submit(_drive_here, options, device, seed).result(), flush=True)
                except Exception as error:  # whatever it was, another device may do better
                    print(f"{seed}: {device} is out: {type(error).__name__}: {error}", flush=True)
                    with changed:
                        waiting.put(seed)
                        changed.notify_all()
                    return
                with changed:
                    missing.discard(seed)
                    changed.notify_all()

    threads = [threading.Thread(target=work, args=[device]) for device in devices]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if missing:
        raise SystemExit(f"no device is left, and {len(missing)} episodes are missing: start the same command again to drive them")


def share(text: str) -> tuple[int, int]:
    index, _, count = text.partition("/")
    if not (index.isdigit() and count.isdigit() and int(index) < int(count)):
        raise argparse.ArgumentTypeError(f"expected INDEX/COUNT with the index counted from 0, as 3/100; found {text!r}")
    return int(index), int(count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--device", help="which Vulkan device: a number, a part of its name or uuid:... (default: the best)")
    which.add_argument("--devices", help="all, assigned (by Slurm or Ray), or a list such as uuid:...,uuid:...: a process for each of them")
    parser.add_argument("--drill", type=int, metavar="SEED", help="let the process of --devices that drives this episode die in the middle of it, once")
    parser.add_argument("--share", type=share, default=(0, 1), help="INDEX/COUNT: only every COUNTth episode, from INDEX on")
    options = parser.parse_args()
    index, count = options.share
    seeds = [seed for seed in range(index, options.episodes, count) if not result_path(options, seed).exists()]
    if options.devices and seeds:
        drive_on(options, devices_of(options.devices), seeds)
        return
    driver = Driver(options, options.device) if seeds else None
    for seed in seeds:
        result = driver.drive(seed)
        write_result(result_path(options, seed), result)
        print(report(result))


if __name__ == "__main__":
    main()
