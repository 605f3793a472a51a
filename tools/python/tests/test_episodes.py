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


def test_an_actor_that_dies_costs_one_episode(tmp_path):
    pytest.importorskip("ray")
    plain, cluster = tmp_path / "plain", tmp_path / "cluster"
    run("episodes.py", *TINY, "--out", str(plain))
    run("ray_episodes.py", *TINY, "--out", str(cluster), "--actors", "2", "--drill", "2")
    campaign = json.loads((cluster / "campaign.json").read_text())
    assert campaign == {"episodes": 4, "there_before": 0, "lost": [2], "given_up": {}}
    # The same images and scores as in one process: who drives an episode, and after what, changes nothing.
    assert results(cluster) == results(plain) and sorted(results(plain)) == [0, 1, 2, 3]
    assert not list(cluster.glob(".easy*")), "nothing half written is left"
    # Once more: everything is there.
    run("ray_episodes.py", *TINY, "--out", str(cluster), "--actors", "2")
    assert json.loads((cluster / "campaign.json").read_text())["there_before"] == 4
