"""The commands of the guides run, on small files under the names that the pages use."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import decouplegs
from program import PROGRAM, needs_program

ROOT = Path(__file__).parents[3]
SEEDS = ROOT / "engine/asset/fuzz/seeds"
PAGES = sorted((ROOT / "engine/guides").glob("*.md"))

pytestmark = needs_program


def commands(page: Path) -> str:
    return "\n".join(re.findall(r"^```sh\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL))


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(page, tmp_path):
    pytest.importorskip("gymnasium")
    if "carla_driver_interface" in commands(page):
        pytest.importorskip("carla_driver_interface", reason="the package carla-driver-interface is not installed")
    for pair in re.search(r"<!-- files: (.*?) -->", page.read_text())[1].split():
        name, source = pair.split("=")
        source = (SEEDS / source).resolve()
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / name)
    # The pages run elsewhere than this test: a relative PYTHONPATH would not lead to the package there.
    package = str(Path(decouplegs.__file__).resolve().parents[1])
    path = [str(Path(PROGRAM).parent), str(Path(sys.executable).parent), os.environ["PATH"]]
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", commands(page)],
        cwd=tmp_path,
        env={**os.environ, "PATH": os.pathsep.join(path), "PYTHONPATH": package},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_page_is_listed_and_every_link_leads_somewhere():
    index = (ROOT / "engine/guides/README.md").read_text()
    for page in PAGES:
        if page.name != "README.md":
            assert f"({page.name})" in index, page.name
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
