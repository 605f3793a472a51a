"""The example draws an image."""

import runpy
import sys
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

EXAMPLE = Path(__file__).parents[1] / "examples/plot_rig.py"


def test_the_rig_is_plotted(scene_file, tmp_path, monkeypatch):
    out = tmp_path / "rig.png"
    monkeypatch.setattr(sys, "argv", ["plot_rig.py", str(scene_file), "--out", str(out), "--size", "64x48"])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert out.read_bytes().startswith(b"\x89PNG")
