#!/usr/bin/env python3
"""Lets the server, the closed loop, the Python environment and the viewer work for a time, and tells whether their memory grows.

Needs a build (`cargo build --workspace`). The Python environment and the viewer also need the Python of the tests (`make python browser`),
and are left out, with a sentence, without it. Exit code 0: memory is flat and every program ended well. 1: it is not. 2: usage.
"""

import argparse
import json
import os
import pathlib
import signal
import statistics
import subprocess
import sys
import time

from abuse import ROOT, Street
from judge import kill, start

# Growth of memory from the second quarter of a run to its last that is taken for noise: of the whole, and bytes.
GROWTH = 0.05
GROWTH_BYTES = 16 << 20

# Seconds between two looks at memory.
EVERY_S = 0.5

# An environment of a street that is driven for a time, episode by episode. Words: seconds.
ENVIRONMENT = """
import sys, time
from decouplegs import gym
env = gym.DriveEnv(level="medium", size=(96, 54), background=20_000, agent_splats=500, duration_s=5.0)
end, episodes = time.monotonic() + float(sys.argv[1]), 0
while time.monotonic() < end:
    env.reset(seed=episodes)
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        over = terminated or truncated
    episodes += 1
env.close()
print(episodes, "episodes", file=sys.stderr)
"""


def memory_bytes(pid):
    """Resident memory of a process; None once it has ended."""
    try:
        pages = pathlib.Path(f"/proc/{pid}/statm").read_text().split()[1]
    except (FileNotFoundError, ProcessLookupError, IndexError):
        return None
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def growth_fault(samples):
    """The fault of samples of memory, bytes, taken at equal intervals; None where they are flat."""
    quarter = len(samples) // 4
    if quarter < 4:
        return f"{len(samples)} samples of memory are too few to judge"
    before, after = statistics.median(samples[quarter : 2 * quarter]), statistics.median(samples[-quarter:])
    if after - before > max(GROWTH * before, GROWTH_BYTES):
        return f"memory grew from {before / 2**20:.0f} to {after / 2**20:.0f} MiB"
    return None


def sampled(child, seconds, ends_itself):
    """Samples the memory of `child`, which is asked to end after `seconds` where it does not itself."""
    samples, end = [], time.monotonic() + seconds
    while child.poll() is None:
        used = memory_bytes(child.pid)
        if used:
            samples.append(used)
        now = time.monotonic()
        if now > end and not ends_itself:
            child.send_signal(signal.SIGINT)
        if now > end + 120:
            kill(child)
        time.sleep(EVERY_S)
    return samples


def programs(street, python, seconds):
    """The programs: name, command, the exit codes of a good end, whether it ends by itself, and more environment."""
    folder = street.out / "soak"
    drive = ["drive", "--level", "hard", "--episodes", "1000000", "--scene", street.scene, "--map", street.lanes, "--size", "96x54", "--images", "none", "--planner", "lane-follow"]
    # Ctrl-C ends a run of episodes with what is there, and with the code of that signal.
    yield "drive", [street.program, *drive, "--out", folder / "run", "--force"], (0, 1, 130), False, {}
    server = street.program.with_name("decouplegs-server")
    yield "server", [server, "bench", "--scene", street.scene, "--seconds", str(seconds), "--force", "--json", folder / "server.json"], (0,), True, {}
    if python is None:
        print("The Python environment and the viewer are left out: --python was not given.", flush=True)
        return
    paths = {"PYTHONPATH": str(ROOT / "tools/python"), "DECOUPLEGS_PROGRAM": str(street.program)}
    yield "Python environment", [python, "-c", ENVIRONMENT, str(seconds)], (0,), True, paths
    page = [python, "-m", "pytest", "-q", "-k", "memory_stays_flat", ROOT / "tools/view/tests"]
    yield "viewer", page, (0,), True, {**paths, "VIEW_SOAK_S": str(seconds)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--program", type=pathlib.Path, required=True, help="the program decouplegs, beside those that it runs")
    parser.add_argument("--seconds", type=int, default=7200, help="time for all programs together, a fourth each (default 7200)")
    parser.add_argument("--python", type=pathlib.Path, help="the Python of the tests, for the environment and the viewer")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "out/soak", help="folder for files (default out/soak)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    street = Street(options.program.resolve(), options.out.resolve())
    (street.out / "soak").mkdir(exist_ok=True)
    seconds = max(options.seconds // 4, 10)
    faults, figures = 0, {}
    for name, command, codes, ends_itself, environment in programs(street, options.python, seconds):
        print(f"{name}: {seconds} s", flush=True)
        log = street.out / "soak" / f"{name.replace(' ', '_')}.log"
        with log.open("w") as said:
            child = start(command, stdout=said, stderr=subprocess.STDOUT, env={**os.environ, **environment})
            samples = sampled(child, seconds, ends_itself)
        # The viewer is a child of its test, which judges its memory.
        fault = growth_fault(samples) if name != "viewer" else None
        fault = fault or (f"exit code {child.returncode}; {log} tells more" if child.returncode not in codes else None)
        faults += fault is not None
        figures[name] = {"seconds": seconds, "samples": len(samples), "first_bytes": samples[0] if samples else 0, "last_bytes": samples[-1] if samples else 0, "most_bytes": max(samples, default=0), "fault": fault}
        print(f"{name}: {fault or 'memory is flat'}, {figures[name]['last_bytes'] / 2**20:.0f} MiB", flush=True)
    (street.out / "soak.json").write_text(json.dumps(figures, indent=2) + "\n")
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
