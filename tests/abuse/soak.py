#!/usr/bin/env python3
"""Lets the server, the closed loop, the Python environment and the viewer work for a time, and tells whether their memory grows.

They run with the Vulkan validation layers, whose own log tells what each program left undestroyed and what it did wrong.
Needs a build (`cargo build --workspace`). The Python environment and the viewer also need the Python of the tests (`make python browser`),
and are left out, with a sentence, without it. Exit code 0: memory is flat, nothing is left, and every program ended well. 1: it is not. 2: usage.
"""

import argparse
import json
import os
import pathlib
import shutil
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

# Episodes that are driven to tell how long one takes.
PACE_EPISODES = 20

# What the loader says when an instance is destroyed. A program that keeps an object alive for ever also keeps its device and instance.
DESTROYED = "Unloading layer library libVkLayer_khronos_validation.so"

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


def validated(folder):
    """Environment of a program under validation, and the file in `folder` that the layers write their messages to."""
    messages = folder / "validation.log"
    messages.write_text("")
    settings = {"debug_action": "VK_DBG_LAYER_ACTION_LOG_MSG", "report_flags": "error,warn", "log_filename": messages}
    (folder / "vk_layer_settings.txt").write_text("".join(f"khronos_validation.{key} = {value}\n" for key, value in settings.items()))
    return {"DECOUPLEGS_VALIDATION": "1", "VK_LAYER_SETTINGS_PATH": str(folder), "VK_LOADER_DEBUG": "layer,debug"}, messages


def leak_fault(messages, said):
    """The fault in the messages of the layers and in what a program and its loader said; None where nothing is left."""
    found = [line for line in messages.splitlines() if "VUID-" in line or "Validation" in line]
    if found:
        return f"{len(found)} messages of the validation layers, the first: {found[0][:400]}"
    if said is not None and DESTROYED not in said:
        return "its Vulkan instance was not destroyed"
    return None


def sampled(child, seconds):
    """Samples the memory of `child`, which ends by itself after about `seconds`, and is killed after twice that time."""
    samples, end = [], time.monotonic() + 2 * seconds + 120
    while child.poll() is None:
        used = memory_bytes(child.pid)
        if used:
            samples.append(used)
        if time.monotonic() > end:
            kill(child)
        time.sleep(EVERY_S)
    return samples


def check_judges():
    """Fails if memory that grows or an object that is left would not be found."""
    assert growth_fault([1 << 30] * 40 + [1 << 31] * 10) and not growth_fault([1 << 30] * 50)
    left = "VUID-vkDestroyDevice-device-00378(ERROR / SPEC): msgNum: 1901072314 - Validation Error: a buffer"
    assert leak_fault(left, DESTROYED) and leak_fault("", "") and not leak_fault("", DESTROYED)


def programs(street, python, seconds):
    """The programs, which end by themselves after about `seconds`: name, command, and more environment."""
    folder = street.out / "soak"
    # Scenarios are made before the first is driven. A run that Ctrl-C ends destroys nothing, so the number of episodes sets its time.
    drive = [street.program, "drive", "--level", "hard", "--scene", street.scene, "--map", street.lanes, "--size", "96x54", "--images", "none", "--planner", "lane-follow"]
    began = time.monotonic()
    subprocess.run([*drive, "--episodes", str(PACE_EPISODES), "--out", folder / "pace"], check=True, capture_output=True, env={**os.environ, "DECOUPLEGS_VALIDATION": "1"})
    episodes = max(int(PACE_EPISODES * seconds / (time.monotonic() - began)), 1)
    yield "drive", [*drive, "--episodes", str(episodes), "--out", folder / "run"], {}
    server = street.program.with_name("decouplegs-server")
    yield "server", [server, "bench", "--scene", street.scene, "--seconds", str(seconds), "--force", "--json", folder / "server.json"], {}
    if python is None:
        print("The Python environment and the viewer are left out: --python was not given.", flush=True)
        return
    paths = {"PYTHONPATH": str(ROOT / "tools/python"), "DECOUPLEGS_PROGRAM": str(street.program)}
    yield "Python environment", [python, "-c", ENVIRONMENT, str(seconds)], paths
    page = [python, "-m", "pytest", "-q", "-k", "memory_stays_flat", ROOT / "tools/view/tests"]
    yield "viewer", page, {**paths, "VIEW_SOAK_S": str(seconds)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--program", type=pathlib.Path, required=True, help="the program decouplegs, beside those that it runs")
    parser.add_argument("--seconds", type=int, default=7200, help="time for all programs together, a fourth each (default 7200)")
    parser.add_argument("--python", type=pathlib.Path, help="the Python of the tests, for the environment and the viewer")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "out/soak", help="folder for files (default out/soak)")
    options = parser.parse_args()
    check_judges()
    options.out.mkdir(parents=True, exist_ok=True)
    street = Street(options.program.resolve(), options.out.resolve())
    shutil.rmtree(street.out / "soak", ignore_errors=True)
    (street.out / "soak").mkdir()
    seconds = max(options.seconds // 4, 10)
    faults, figures = 0, {}
    for name, command, environment in programs(street, options.python, seconds):
        print(f"{name}: {seconds} s", flush=True)
        log = street.out / "soak" / f"{name.replace(' ', '_')}.log"
        with log.open("w") as said:
            layers, messages = validated(log.parent)
            child = start(command, stdout=said, stderr=subprocess.STDOUT, env={**os.environ, **layers, **environment})
            samples = sampled(child, seconds)
        # The viewer is a child of its test, which judges its memory and does not keep what its loader says.
        is_own = name != "viewer"
        fault = growth_fault(samples) if is_own else None
        fault = fault or leak_fault(messages.read_text(), log.read_text(errors="replace") if is_own else None)
        fault = fault or (f"exit code {child.returncode}; {log} tells more" if child.returncode else None)
        faults += fault is not None
        figures[name] = {"seconds": seconds, "samples": len(samples), "first_bytes": samples[0] if samples else 0, "last_bytes": samples[-1] if samples else 0, "most_bytes": max(samples, default=0), "fault": fault}
        print(f"{name}: {fault or 'memory is flat, nothing is left'}, {figures[name]['last_bytes'] / 2**20:.0f} MiB", flush=True)
    (street.out / "soak.json").write_text(json.dumps(figures, indent=2) + "\n")
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
