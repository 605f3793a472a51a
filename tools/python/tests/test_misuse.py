"""Calls with arguments that make no sense, from several threads: each is an exception that Python knows, and nothing else changes."""

import random
import threading

import numpy as np
import pytest

import decouplegs

# What the package and Python raise for wrong arguments. A panic is none of these: it is no Exception at all.
FAULTS = (TypeError, ValueError, LookupError, OverflowError, BufferError, OSError, AttributeError, decouplegs.Error)


class Hostile:
    """An object that fails wherever it is asked for a value."""

    def _fail(self, *_):
        raise ValueError("hostile")

    __index__ = __float__ = __len__ = __iter__ = __fspath__ = __str__ = __getitem__ = __array__ = _fail


def nested():
    """A list that holds itself."""
    values = []
    values.append(values)
    return values


def values(source):
    """A value of a kind that no method expects, or one that some do."""
    shape = source.choice([(), (0,), (3,), (4, 4), (3, 3), (4, 4, 4), (1, 0, 5)])
    dtype = source.choice([np.float64, np.float32, np.int8, np.uint64, np.complex128, bool, object, "S3"])
    array = np.zeros(shape, dtype)
    return source.choice(
        [
            lambda: None,
            lambda: source.choice(["", "front", "standing", "\0", "\ud800", "x" * 10_000]),
            lambda: source.choice([0, -1, 1, 2**31, 2**64, -(2**63)]),
            lambda: source.choice([0.0, -0.0, 1e308, float("nan"), float("inf"), 1e-320]),
            lambda: array,
            lambda: array.T[::-1] if array.ndim else array,
            lambda: np.full((4, 4), np.nan),
            lambda: np.eye(4) * 1e200,
            lambda: [[1.0, 2.0], [3.0]],
            nested,
            Hostile,
            lambda: [Hostile()],
            lambda: (Hostile(), [Hostile()]),
            lambda: {"pose": 1},
            lambda: b"\xff" * 9,
            lambda: decouplegs,
            lambda: np.eye(4),
        ]
    )()


def methods(session, scene):
    """Methods and constructors, but for those that end in a large allocation that was asked for."""
    camera = scene.cameras()[0]
    world = decouplegs.World(scene)
    renderer = session.batch_renderer()
    yield from (decouplegs.Camera, decouplegs.RigCamera, decouplegs.Lidar, decouplegs.World, session.open_scene)
    yield from (camera.with_shutter, camera.with_photometry, scene.rig[0].at, scene.cameras_at, scene.ego_motion, scene.ego_pose, scene.agent_pose, scene.asset_size, scene.add_asset)
    yield from (world.set_time, world.move_to, world.set_motion, world.place, world.remove)
    yield from (renderer.draw, renderer.draw_layers, renderer.draw_dlpack, renderer.sweep)


def misuse(calls, seed, count, faults):
    """Makes `count` calls; what is raised and is no fault goes to `faults`."""
    source = random.Random(seed)
    for _ in range(count):
        call = source.choice(calls)
        arguments = [values(source) for _ in range(source.randrange(6))]
        named = {source.choice(["name", "pose", "size", "opacity_min"]): values(source)} if source.random() < 0.2 else {}
        try:
            call(*arguments, **named)
        except FAULTS:
            pass
        except BaseException as fault:  # noqa: BLE001 - a panic derives from it
            faults.append(f"{call} {arguments!r:.300} {named!r:.100}: {type(fault).__name__}: {fault!s:.200}")


@pytest.mark.parametrize("seed", range(4))
def test_calls_without_sense_are_exceptions(session, scene, seed):
    faults = []
    misuse(list(methods(session, scene)), seed, 1500, faults)
    assert faults == []


def test_threads_that_misuse_it_change_no_image(session, scene):
    view = [(decouplegs.World(scene), scene.cameras())]
    renderer = session.batch_renderer()
    before = [images.copy() for images in renderer.draw(view)]
    faults = []
    threads = [threading.Thread(target=misuse, args=(list(methods(session, scene)), 10 + index, 400, faults)) for index in range(4)]
    for thread in threads:
        thread.start()
    during = [[images.copy() for images in renderer.draw(view)] for _ in range(5)]
    for thread in threads:
        thread.join()
    assert faults == []
    for images in [*during, renderer.draw(view)]:
        for one, other in zip(images, before, strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_panic_would_be_seen():
    class Panic(BaseException):
        pass

    def panics(*_, **__):
        raise Panic("at a line")

    faults = []
    misuse([panics], 1, 3, faults)
    assert len(faults) == 3 and "Panic: at a line" in faults[0]
