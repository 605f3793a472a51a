"""The package under valgrind, or under AddressSanitizer (`make asan`): calls without sense, threads and images that outlive what drew them touch no memory that is not theirs."""

import os
import pathlib
import shutil
import subprocess
import sys

import pytest

SUPPRESSIONS = pathlib.Path(__file__).resolve().parents[2] / "c/tests/interface/valgrind.supp"
FOUND = 99

# Word: a scene file.
USE = """
import gc
import sys
import threading

import numpy as np

import decouplegs

session = decouplegs.Session()
scene = session.open_scene(sys.argv[1])
renderer = session.batch_renderer()
world = decouplegs.World(scene)
images = renderer.draw([(world, scene.cameras())])
copies = [image.copy() for image in images]
refused = 0
for wrong in [np.zeros((4, 4), np.float32)[::-1], np.zeros((3, 3)), np.full((4, 4), np.nan), np.zeros((4, 4), object), [1, [2]], "x" * 1000, b"\\xff", 2**70]:
    for call in (scene.ego_pose, scene.cameras_at, world.set_time, world.move_to, renderer.draw, decouplegs.Camera):
        try:
            call(wrong)
        except Exception:
            refused += 1
assert refused > 30
threads = [threading.Thread(target=lambda: [scene.ego_pose(0.1) for _ in range(20)]) for _ in range(3)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
shared = renderer.draw_dlpack([(world, scene.cameras())])
del shared, world, renderer, scene, session
gc.collect()
assert all((image == copy).all() for image, copy in zip(images, copies))
del images
gc.collect()
print("done")
"""

# Reads memory that was given back.
READS_FREED = """
import ctypes
c = ctypes.CDLL(None)
c.malloc.restype = ctypes.c_void_p
place = c.malloc(64)
c.free(ctypes.c_void_p(place))
print(ctypes.string_at(place, 64))
"""


ASAN = "asan" in os.environ.get("LD_PRELOAD", "")
WATCHED = pytest.mark.skipif(not ASAN and shutil.which("valgrind") is None, reason="valgrind is not installed")


def watched(script, *words):
    """The end of a script that is watched; Python's own allocator would hide what it does."""
    command = [sys.executable, "-c", script, *words]
    if not ASAN:
        command = ["valgrind", "--leak-check=no", "--undef-value-errors=no", f"--error-exitcode={FOUND}", f"--suppressions={SUPPRESSIONS}", *command]
    # The validation layer is watched elsewhere, and takes minutes here.
    environment = {**os.environ, "PYTHONMALLOC": "malloc", "DECOUPLEGS_VALIDATION": "0"}
    return subprocess.run(command, capture_output=True, text=True, env=environment)


@WATCHED
def test_the_package_touches_only_its_own_memory(scene_file):
    end = watched(USE, str(scene_file))
    assert end.returncode == 0, end.stderr[-4000:]
    assert end.stdout == "done\n"


@WATCHED
def test_memory_that_was_given_back_would_be_found():
    assert watched(READS_FREED).returncode == FOUND
