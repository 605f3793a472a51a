"""A rollout over the server with the classes that AlpaSim's runtime has, and the messages of both projects, field by field."""

import subprocess
import sys
from pathlib import Path

import pytest

from program import PROGRAM, needs_program

PROTO = Path(__file__).parents[2] / "alpasim/proto"

pytestmark = needs_program


@pytest.fixture
def address(tmp_path):
    street = ["--background", "4000", "--agents", "3", "--agent-splats", "300", "--size", "160x90", "--movable", "--out", str(tmp_path / "street")]
    subprocess.run([PROGRAM, "synth", "street", *street], check=True, capture_output=True)
    server = Path(PROGRAM).with_name("decouplegs-server")
    serving = subprocess.Popen([server, "serve-grpc", tmp_path / "street/scene.toml", "--port", "0"], stdout=subprocess.PIPE, text=True)
    yield serving.stdout.readline().removeprefix("listening on ").strip()
    serving.terminate()
    assert serving.wait(timeout=30) == 0


def test_messages_are_alpasims_and_its_classes_drive_a_rollout(address, tmp_path):
    pytest.importorskip("grpc")
    protoc = pytest.importorskip("grpc_tools.protoc", reason="the package grpcio-tools is not installed")
    out = tmp_path / "messages.pb"
    files = [str(PROTO / name) for name in ("sensorsim.proto", "egodriver.proto", "shared.proto")]
    assert protoc.main(["protoc", f"-I{PROTO}", f"--descriptor_set_out={out}", "--include_imports", *files]) == 0
    script = Path(__file__).with_name("alpasim_rollout.py")
    done = subprocess.run([sys.executable, script, out, address], capture_output=True, text=True)
    if "No module named 'carla_driver_interface'" in done.stderr:
        pytest.skip("the package carla-driver-interface, which has AlpaSim's classes, is not installed")
    assert done.returncode == 0, done.stderr
    compared, driven = done.stdout.splitlines()
    assert int(compared.split()[0]) > 200 and " 0 different: {}" in compared, compared
    # Rows of LiDARs are those of TIER IV's fork.
    rings = "nre.grpc.protos.sensorsim.LidarRenderReturn.point_ring_ids"
    assert compared.endswith(f"more here: {rings}, {rings}_buffer"), compared
    assert driven.startswith("100 steps of 6 cameras"), driven
