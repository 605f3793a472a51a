"""Images as tensors, on the host. With CUDA: gpu_check.py."""

import ctypes
import gc

import numpy as np
import pytest

import decouplegs

CPU = (1, 0)


@pytest.fixture(scope="module")
def drawn(session, scene):
    renderer, world = session.batch_renderer(), decouplegs.World(scene)
    cameras = scene.cameras(0.0)
    return renderer.draw([(world, cameras)])[0], renderer.draw_dlpack([(world, cameras)])


def capsule_name(capsule) -> str:
    get = ctypes.pythonapi.PyCapsule_GetName
    get.restype, get.argtypes = ctypes.c_char_p, [ctypes.py_object]
    return get(capsule).decode()


def test_the_bytes_are_those_of_draw(drawn):
    expected, images = drawn
    assert images.__dlpack_device__() == CPU
    tensor = np.from_dlpack(images)
    assert tensor.dtype == np.uint8 and tensor.shape == expected.shape
    np.testing.assert_array_equal(tensor, expected)
    np.testing.assert_array_equal(np.from_dlpack(images.view(0)), expected)
    np.testing.assert_array_equal(np.from_dlpack(images.camera(0, 1)), expected[1])
    assert (images.frames, images.views) == (1, 1)


def test_nothing_is_copied_and_memory_lives_as_long_as_somebody_reads(session, scene):
    images = session.batch_renderer().draw_dlpack([(decouplegs.World(scene), scene.cameras(0.0))])
    one, other = np.from_dlpack(images), np.from_dlpack(images.camera(0, 0))
    assert one.ctypes.data == other.ctypes.data
    before = other.copy()
    del images, one
    gc.collect()
    np.testing.assert_array_equal(other, before)


def test_capsules_are_of_the_version_that_is_asked_for(drawn):
    tensor = drawn[1].tensor()
    assert capsule_name(tensor.__dlpack__()) == "dltensor"
    assert capsule_name(tensor.__dlpack__(max_version=(0, 8))) == "dltensor"
    assert capsule_name(tensor.__dlpack__(max_version=(1, 0))) == "dltensor_versioned"
    if np.lib.NumpyVersion(np.__version__) >= "2.1.0":
        assert not np.from_dlpack(tensor).flags.writeable


def test_capsules_that_nobody_takes_are_freed(session, scene):
    images = session.batch_renderer().draw_dlpack([(decouplegs.World(scene), scene.cameras(0.0, size=(512, 384)))])
    for _ in range(10_000):
        images.__dlpack__(max_version=(1, 0))
        images.__dlpack__()


def test_what_cannot_be_had_is_a_buffer_error(drawn):
    tensor = drawn[1].tensor()
    with pytest.raises(BufferError, match="not on that device"):
        tensor.__dlpack__(dl_device=(2, 0))
    with pytest.raises(BufferError, match="copy them"):
        tensor.__dlpack__(copy=True)
    tensor.__dlpack__(dl_device=CPU, copy=False)
    with pytest.raises(ValueError, match="draws no depth"):
        drawn[1].view(0, "depth")
    with pytest.raises(ValueError, match="layer"):
        drawn[1].view(0, "normals")
    with pytest.raises(IndexError, match="1 views"):
        drawn[1].view(1)


def test_cameras_of_several_sizes_are_tensors_of_their_own(session, scene):
    world = decouplegs.World(scene)
    small, large = scene.cameras(0.0), scene.cameras(0.0, size=(96, 72))
    renderer = session.batch_renderer()
    images = renderer.draw_dlpack([(world, small), (world, large)])
    expected = renderer.draw([(world, small), (world, large)])
    with pytest.raises(BufferError, match="several sizes"):
        images.__dlpack__()
    for view in range(2):
        np.testing.assert_array_equal(np.from_dlpack(images.view(view)), expected[view])


def test_layers_come_as_tensors(session, scene_file):
    other = decouplegs.Session(session.device.uuid, color="f32", depth=True, instance=True, exported=False)
    scene = other.open_scene(scene_file)
    renderer, views = other.batch_renderer(), [(decouplegs.World(scene), scene.cameras(0.0))]
    images, layers = renderer.draw_dlpack(views), renderer.draw_layers(views)[0]
    for name in ("color", "depth", "instance"):
        tensor = np.from_dlpack(images.view(0, name))
        assert tensor.dtype == layers[name].dtype
        np.testing.assert_array_equal(tensor, layers[name])


def test_torch_reads_the_same_bytes(drawn):
    torch = pytest.importorskip("torch")
    np.testing.assert_array_equal(torch.from_dlpack(drawn[1]).numpy(), drawn[0])
