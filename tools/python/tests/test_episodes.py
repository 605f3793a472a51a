"""Episodes on a Ray cluster of this machine: an actor that dies costs one episode, which is driven again."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
TINY = ["--size", "48x27", "--background", "20000", "--duration", "3", "--episodes", "4"]


def run(script: str, *arguments: str, **environment: str) -> str:
    command = [sys.executable, str(EXAMPLES / script), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def results(folder: Path) -> dict[int, dict]:
    found = [json.loads(path.read_text()) for path in sorted(folder.glob("easy_*.json"))]
    return {result["seed"]: {key: result[key] for key in result if key not in ("seconds",)} for result in found}


def test_a_share_is_its_part_and_is_not_driven_twice(tmp_path):
    out = ["--out", str(tmp_path)]
    run("episodes.py", *TINY, *out, "--share", "1/2")
    assert sorted(results(tmp_path)) == [1, 3]
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.json")}
    assert run("episodes.py", *TINY, *out, "--share", "1/2") == ""
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.json")} == before


def test_a_device_that_dies_costs_no_episode(tmp_path):
    plain, two = tmp_path / "plain", tmp_path / "two"
    run("episodes.py", *TINY, "--out", str(plain))
    [device] = {result["device"] for result in results(plain).values()}
    said = run("episodes.py", *TINY, "--out", str(two), "--devices", f"{device},{device}", "--drill", "1")
    assert results(two) == results(plain) and sorted(results(two)) == [0, 1, 2, 3]
    assert said.count("is out") == 1 and f"1: {device} is out" in said, said


def test_a_campaign_without_devices_left_says_so_and_goes_on(tmp_path):
    [device] = {result["device"] for result in campaign_of_one(tmp_path / "one").values()}
    out = [*TINY, "--out", str(tmp_path / "runs")]
    command = [sys.executable, str(EXAMPLES / "episodes.py"), *out, "--devices", device, "--drill", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 1 and "no device is left, and 4 episodes are missing" in done.stderr, done.stdout + done.stderr
    run("episodes.py", *out, "--devices", "all")
    assert sorted(results(tmp_path / "runs")) == [0, 1, 2, 3]


def stand_in(folder: Path, name: str, text: str) -> None:
    """A program of a cluster that is not here."""
    path = folder / name
    path.write_text(f"#!/bin/bash\n{text}\n")
    path.chmod(0o755)


def test_devices_are_those_that_slurm_assigned(tmp_path):
    [device] = {result["device"] for result in campaign_of_one(tmp_path / "plain").values()}
    digits = device.removeprefix("uuid:")
    name = "GPU-" + "-".join(digits[start:end] for start, end in [(0, 8), (8, 12), (12, 16), (16, 20), (20, 32)])
    stand_in(tmp_path, "nvidia-smi", f'[[ "$*" == *--id=3* ]] && echo {name}')
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    arguments = [*TINY[:-1], "1", "--devices", "assigned"]
    for visible in ["3", name]:
        out = tmp_path / visible
        run("episodes.py", *arguments, "--out", str(out), PATH=path, CUDA_VISIBLE_DEVICES=visible)
        assert results(out) == results(tmp_path / "plain"), visible
    command = [sys.executable, str(EXAMPLES / "episodes.py"), *arguments, "--out", str(tmp_path / "none")]
    environment = {key: value for key, value in os.environ.items() if key != "CUDA_VISIBLE_DEVICES"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=600)
    assert done.returncode == 1 and "no GPU is assigned" in done.stderr
    done = subprocess.run(command, capture_output=True, text=True, env=environment | {"PATH": path, "CUDA_VISIBLE_DEVICES": "5"}, timeout=600)
    assert done.returncode == 1 and "does not say which GPUs 5 are" in done.stderr


def test_the_slurm_script_drives_the_share_of_its_task(tmp_path):
    stand_in(tmp_path, "srun", 'exec "$@"')
    stand_in(tmp_path, "python", 'printf "%s\\n" "$@"')
    environment = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "SLURM_SUBMIT_DIR": "/here", "SLURM_ARRAY_TASK_ID": "7", "SLURM_ARRAY_TASK_COUNT": "100"}
    done = subprocess.run(["bash", str(EXAMPLES / "episodes.slurm")], capture_output=True, text=True, env=os.environ | environment)
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert said[0] == "/here/tools/python/examples/episodes.py"
    after = dict(zip(said[1::2], said[2::2], strict=True))
    assert after["--share"] == "7/100" and after["--devices"] == "assigned" and after["--out"] == "/here/runs"


def campaign_of_one(out: Path) -> dict[int, dict]:
    run("episodes.py", *TINY[:-1], "1", "--out", str(out))
    return results(out)


def test_an_actor_that_dies_costs_one_episode(tmp_path):
    pytest.importorskip("ray")
    plain, cluster = tmp_path / "plain", tmp_path / "cluster"
    run("episodes.py", *TINY, "--out", str(plain))
    run("ray_episodes.py", *TINY, "--out", str(cluster), "--actors", "2", "--drill", "2")
    campaign = json.loads((cluster / "campaign.json").read_text())
    by_device = campaign.pop("by_device")
    assert campaign == {"episodes": 4, "there_before": 0, "lost": [2], "given_up": {}, "left_out": []}
    assert sum(by_device.values()) == 4 and set(by_device) == {result["device"] for result in results(plain).values()}
    # The same images and scores as in one process: who drives an episode, and after what, changes nothing.
    assert results(cluster) == results(plain) and sorted(results(plain)) == [0, 1, 2, 3]
    assert not list(cluster.glob(".easy*")), "nothing half written is left"
    # Once more: everything is there.
    run("ray_episodes.py", *TINY, "--out", str(cluster), "--actors", "2")
    assert json.loads((cluster / "campaign.json").read_text())["there_before"] == 4
