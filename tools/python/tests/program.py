"""The program `decouplegs`, for tests that run it."""

import os
import subprocess

import pytest

PROGRAM = os.environ.get("DECOUPLEGS_PROGRAM")
needs_program = pytest.mark.skipif(PROGRAM is None, reason="DECOUPLEGS_PROGRAM names no program")


def decouplegs(*arguments):
    """Runs the program, which must succeed; its standard output."""
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout
