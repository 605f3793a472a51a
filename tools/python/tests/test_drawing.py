"""Sessions, scenes, worlds and renderers."""

import os
import subprocess
import threading

import numpy as np
import pytest

import decouplegs
from poses import pose


def test_devices_are_those_that_sessions_open(session):
    devices = decouplegs.devices()
    assert [device.index for device in devices] == list(range(len(devices)))
    own = session.device
    assert own.uuid in [device.uuid for device in devices] and own.uuid.startswith("uuid:")
    assert decouplegs.Session(own.uuid, exported=False).device.name == own.name


def test_the_rig_is_that_of_the_file(scene):
    front, left = scene.rig
    assert (front.name, front.width, front.height) == ("front", 64, 48)
    np.testing.assert_array_equal(front.K, [[60, 0, 32], [0, 60, 24], [0, 0, 1]])
    # Looks along x: its z axis is the vehicle's x, its x the vehicle's -y.
    np.testing.assert_allclose(front.rig_from_camera[:3, :3], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
    np.testing.assert_allclose(scene.ego_pose(1.0), pose(2.0), atol=1e-12)
    assert scene.ego_span_s == (0.0, 2.0)
    camera = scene.cameras(1.0)[1]
    np.testing.assert_allclose(camera.world_from_camera, scene.ego_pose(1.0) @ left.rig_from_camera, atol=1e-12)
    np.testing.assert_allclose(left.at(scene.ego_pose(1.0)).world_from_camera, camera.world_from_camera)
    half = front.resized(32, 24)
    assert half.K[0, 0] == 30 and half.K[0, 2] == 16
    assert (scene.agents, scene.plain_agents) == (["standing", "moving"], ["plain"])
    assert scene.asset_count == 1 and len(scene.asset_size(0)) == 3
    np.testing.assert_allclose(scene.agent_pose("moving", 1.0), pose(6.0, 2.0, 1.0), atol=1e-12)


def test_images_show_what_there_is(session, scene):
    renderer = session.batch_renderer()
    world = decouplegs.World(scene, empty=True)
    images = renderer.draw([(world, scene.cameras(0.0))])
    assert len(images) == 1
    image = images[0]
    assert image.shape == (2, 48, 64, 4) and image.dtype == np.uint8 and image.flags.c_contiguous
    left, right = image[0, 20, 10].astype(int), image[0, 20, 54].astype(int)
    assert left[1] > left[0] + 80, "the wall is green on the left"
    assert right[0] > right[1] + 80, "and red on the right"
    statistics = renderer.statistics
    assert len(statistics) == 1 and statistics[0].gpu_ms > 0 and not statistics[0].stages_ms and statistics[0].cameras == 2


def test_floats_are_the_same_image_and_layers_come_along(session, scene_file, scene):
    floats = decouplegs.Session(session.device.uuid, color="f32", depth=True, instance=True, exported=False)
    own = floats.open_scene(scene_file)
    world = decouplegs.World(own)
    cameras = own.cameras(0.0)
    layers = floats.batch_renderer().draw_layers([(world, cameras)])[0]
    assert layers["color"].dtype == np.float32 and layers["color"].shape == (2, 48, 64, 4)
    assert layers["depth"].dtype == np.float32 and layers["depth"].shape == (2, 48, 64)
    assert layers["instance"].dtype == np.int32 and layers["instance"].shape == (2, 48, 64)
    seen = {agent.instance for agent in world.agents}
    assert set(np.unique(layers["instance"])) <= seen | {0, 3} and 0 in layers["instance"]
    wall = layers["depth"][0][layers["instance"][0] == 0]
    assert abs(np.median(wall[wall > 0]) - 12.0) < 0.5
    bytes_ = session.batch_renderer().draw([(decouplegs.World(scene), cameras)])[0]
    rounded = np.round(np.clip(layers["color"], 0, 1) * 255)
    assert np.abs(rounded - bytes_).max() <= 1
    both = decouplegs.Session(session.device.uuid, depth=True, exported=False, stage_times=True)
    renderer = both.batch_renderer()
    again = renderer.draw_layers([(decouplegs.World(both.open_scene(scene_file)), cameras)])[0]
    assert {"project", "blend"} <= renderer.statistics[0].stages_ms.keys()
    np.testing.assert_array_equal(again["color"], bytes_)
    assert "instance" not in again


def test_agents_move_and_worlds_share_a_scene(session, scene):
    renderer = session.batch_renderer()
    one, other = decouplegs.World(scene), decouplegs.World(scene)
    camera = scene.cameras(0.0)[:1]
    one.move_to("standing", pose(5.0, 0.0, 1.0, yaw=0.3))
    instance = other.place("another", 0, pose(5.0, 0.0, 1.2))
    assert len(other) == 3 and instance not in [agent.instance for agent in other.agents[:2]]
    empty = decouplegs.World(scene, empty=True)
    together = renderer.draw([(one, camera), (other, camera), (empty, camera)])
    assert len(renderer.statistics) == 1, "one submission"
    alone = [renderer.draw([(world, camera)])[0] for world in (one, other, empty)]
    for a, b in zip(together, alone):
        np.testing.assert_array_equal(a, b)
    assert (together[0] != together[1]).any() and (together[0] != together[2]).any()
    with pytest.raises(TypeError, match="views: expected a list of pairs, each of a World and a list of Cameras"):
        renderer.draw([one])
    copy = one.copy()
    one.remove("standing")
    assert (len(one), len(copy)) == (1, 2)
    assert (renderer.draw([(one, camera)])[0] != together[0]).any()
    np.testing.assert_array_equal(renderer.draw([(copy, camera)])[0], together[0])
    copy.set_time(1.0)
    np.testing.assert_allclose({agent.name: agent.pose for agent in copy.agents}["moving"], pose(6.0, 2.0, 1.0), atol=1e-12)


def test_cameras_have_a_photometric_calibration(session, scene_file):
    floats = decouplegs.Session(session.device.uuid, color="f32", exported=False)
    scene = floats.open_scene(scene_file)
    world = decouplegs.World(scene)
    camera = scene.cameras(0.0)[0]
    drawn = lambda camera: floats.batch_renderer().draw([(world, [camera])])[0][0]
    plain = drawn(camera)
    np.testing.assert_array_equal(drawn(camera.with_photometry()), plain)
    np.testing.assert_allclose(drawn(camera.with_photometry(exposure_ev=1.0, curve="linear"))[..., :3], 2 * plain[..., :3], rtol=1e-5)
    matrix = np.array([[0.5, 0.1, 0.0, 0.2], [0.0, 1.5, 0.0, 0.0], [0.2, 0.0, 1.0, -0.1]])
    found = drawn(camera.with_photometry(matrix=matrix, gamma=[1.0, 2.0, 1.0]))[..., :3]
    expected = plain[..., :3] @ matrix[:, :3].T + matrix[:, 3]
    expected[..., 1] = np.maximum(expected[..., 1], 0.0) ** 2
    np.testing.assert_allclose(found, expected, atol=1e-5)
    shade = ([32.0, 24.0], [40.0, 40.0], -0.5 * np.eye(3)[:, :1] @ np.ones((1, 3)) * [1, 0, 0])
    shaded = drawn(camera.with_photometry(vignetting=shade))
    np.testing.assert_array_equal(shaded[..., 1:], plain[..., 1:])
    assert (shaded[0, 0, 0] < 0.8 * plain[0, 0, 0]).all()
    with pytest.raises(ValueError, match="curve"):
        camera.with_photometry(curve="log")
    with pytest.raises(ValueError, match="stops"):
        camera.with_photometry(exposure_ev=99.0)
    moving = {agent.name: agent.moving for agent in world.agents}
    assert not moving["standing"] and moving["moving"]


def test_rolling_shutters_show_motion(session, scene):
    renderer = session.batch_renderer()
    world = decouplegs.World(scene)
    world.remove("moving")
    camera = scene.cameras(0.0)[0]
    start, end = camera.world_from_camera.copy(), camera.world_from_camera.copy()
    start[0, 3] -= 0.3
    end[0, 3] += 0.3
    drawn = lambda camera: renderer.draw([(world, [camera])])[0]
    still = drawn(camera)
    np.testing.assert_array_equal(drawn(camera.with_shutter("top_to_bottom", 0.03, *[camera.world_from_camera] * 2)), still)
    down, up = (drawn(camera.with_shutter(way, 0.03, start, end)) for way in ("top_to_bottom", "bottom_to_top"))
    assert (down != still).any() and (down != up).any()
    # An agent that moves before a camera at rest.
    rolled = camera.with_shutter("top_to_bottom", 0.03, *[camera.world_from_camera] * 2)
    world.move_to("standing", pose(5.0, 0.0, 1.0))
    before = drawn(rolled)
    world.set_motion("standing", [0.0, 20.0, 0.0])
    assert (drawn(rolled) != before).any()
    with pytest.raises(ValueError, match="one of"):
        camera.with_shutter("sideways", 0.03, start, end)
    with pytest.raises(ValueError, match="readout"):
        camera.with_shutter("top_to_bottom", 3.0, start, end)
    with pytest.raises(ValueError, match="finite"):
        world.set_motion("standing", [float("nan"), 0.0, 0.0])


def test_planes_of_geometry(session, scene_file):
    names = ["range", "normal", "flow_forward", "flow_backward", "scene_flow"]
    other = decouplegs.Session(session.device.uuid, depth=True, planes=names, flow_interval=0.05, exported=False)
    scene = other.open_scene(scene_file)
    world = decouplegs.World(scene)
    world.remove("moving")
    world.move_to("standing", pose(5.0, 0.0, 1.0))
    world.set_motion("standing", [2.0, 0.0, 0.0])
    camera = scene.cameras(0.0)[0]
    still = camera.with_shutter("global", 0.01, camera.world_from_camera, camera.world_from_camera)
    layers = other.batch_renderer().draw_layers([(world, [still])])[0]
    shape = layers["color"].shape[:3]
    assert [layers[name].shape[3:] for name in names] == [(), (3,), (2,), (2,), (3,)]
    assert all(layers[name].shape[:3] == shape and layers[name].dtype == np.float32 for name in names)
    solid = layers["color"][..., 3] > 250
    assert solid.any() and (layers["range"][solid] >= 0.999 * layers["depth"][solid]).all()
    assert (np.linalg.norm(layers["normal"], axis=-1) <= 1.001).all()
    moving = layers["scene_flow"][..., 0]
    assert moving.max() > 1.9 and abs(layers["scene_flow"][..., 1:]).max() < 1e-5
    # It moves away from the camera: what moves in one direction of time moves back in the other.
    forward, backward = layers["flow_forward"], layers["flow_backward"]
    assert abs(forward).max() > 0.1 and abs(forward[moving == 0]).max() < 1e-4
    assert (forward * backward).sum(axis=-1).max() < 1e-3
    with pytest.raises(ValueError, match="expected names among"):
        decouplegs.Session(session.device.uuid, planes=["speed"])
    with pytest.raises(ValueError, match="flow_interval"):
        decouplegs.Session(session.device.uuid, flow_interval=0.0)


def test_a_scene_is_loaded_once_and_goes_with_the_last_who_holds_it(session, scene_file, scene):
    before = sum(session.memory().values())
    assert session.open_scene(scene_file).background_splats == scene.background_splats
    assert sum(session.memory().values()) == before
    number = scene.add_asset(scene_file.parent / "cone.safetensors")
    assert number == 1 and scene.asset_count == 2


def test_threads_draw_side_by_side(session, scene):
    world = decouplegs.World(scene)
    expected = session.batch_renderer().draw([(world, scene.cameras(0.5))])[0]
    wrong, shared = [], session.batch_renderer()

    def work(renderer):
        for _ in range(4):
            if (renderer.draw([(world, scene.cameras(0.5))])[0] != expected).any():
                wrong.append(threading.get_ident())

    threads = [threading.Thread(target=work, args=(renderer,)) for renderer in (shared, shared, session.batch_renderer())]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert not wrong


def test_the_lock_of_the_interpreter_is_released_while_something_is_drawn(session, scene):
    world, renderer = decouplegs.World(scene), session.batch_renderer()
    large = scene.cameras(0.0, size=(1600, 1200))
    renderer.draw([(world, large)])
    counted, done = [0], threading.Event()

    def count():
        while not done.is_set():
            counted[0] += 1

    thread = threading.Thread(target=count)
    thread.start()
    before = counted[0]
    renderer.draw([(world, large)])
    during = counted[0] - before
    done.set()
    thread.join()
    # With the lock held the other thread would get at most a switch interval before the call and one after it.
    assert during > 20_000, during


def test_camera_sizes_of_a_view_are_equal_and_views_may_differ(session, scene):
    world, renderer = decouplegs.World(scene), session.batch_renderer()
    small, large = scene.cameras(0.0)[:1], scene.cameras(0.0, size=(96, 72))[:1]
    with pytest.raises(ValueError, match="64x48 and 96x72"):
        renderer.draw([(world, small + large)])
    a, b = renderer.draw([(world, small), (world, large)])
    assert a.shape == (1, 48, 64, 4) and b.shape == (1, 72, 96, 4)
    assert len(renderer.statistics) == 1


@pytest.mark.parametrize(
    "matrix, message",
    [
        (np.eye(3), r"shape \[4, 4\], found \[3, 3\]"),
        (np.full((4, 4), np.nan), "finite"),
        (np.diag([2.0, 1.0, 1.0, 1.0]), "no rotation"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "mirrors"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
        (np.eye(4) + 1e-5, "no rotation|last row"),
    ],
)
def test_poses_that_are_none_are_refused(scene, matrix, message):
    with pytest.raises(ValueError, match=message):
        decouplegs.World(scene).move_to("standing", matrix)
    with pytest.raises(ValueError, match="world_from_camera"):
        decouplegs.Camera(4, 4, np.diag([4.0, 4.0, 1.0]), matrix)


def test_poses_may_be_lists_and_floats_of_less(scene):
    world = decouplegs.World(scene)
    world.move_to("standing", pose(1.0, yaw=0.7).tolist())
    world.move_to("standing", pose(1.0, yaw=0.7).astype(np.float32))
    with pytest.raises(TypeError, match="array of numbers"):
        world.move_to("standing", "here")


def test_what_is_wrong_is_said(session, scene, tmp_path):
    world, renderer = decouplegs.World(scene), session.batch_renderer()
    with pytest.raises(KeyError, match="standing, moving"):
        world.move_to("nobody", np.eye(4))
    with pytest.raises(ValueError, match="plain splats"):
        world.remove("plain")
    with pytest.raises(IndexError, match="has no asset 9"):
        world.place("new", 9, np.eye(4))
    with pytest.raises(ValueError, match="at least one"):
        renderer.draw([])
    with pytest.raises(ValueError, match="at least one camera"):
        renderer.draw([(world, [])])
    with pytest.raises(decouplegs.FileError, match="missing.toml"):
        session.open_scene(tmp_path / "missing.toml")
    (tmp_path / "wrong.toml").write_text("version = 7")
    with pytest.raises(decouplegs.Error, match="wrong.toml"):
        session.open_scene(tmp_path / "wrong.toml")
    with pytest.raises(decouplegs.DeviceError, match="no device matches .* found 0 ="):
        decouplegs.Session("a device that nobody has")
    with pytest.raises(ValueError, match="color"):
        decouplegs.Session(color="u16")
    with pytest.raises(ValueError, match="skew"):
        decouplegs.Camera(4, 4, [[4, 1, 2], [0, 4, 2], [0, 0, 1]], np.eye(4))
    with pytest.raises(ValueError, match="focal"):
        decouplegs.Camera(4, 4, [[-4, 0, 2], [0, 4, 2], [0, 0, 1]], np.eye(4))
    with pytest.raises(ValueError, match="finite"):
        world.set_time(float("nan"))


def test_a_scene_is_drawn_by_its_own_rules(session, scene_file, tmp_path):
    def drawn(session, text):
        path = tmp_path / "scene.toml"
        path.write_text(text)
        own = session.open_scene(path)
        return session.batch_renderer().draw([(decouplegs.World(own), own.cameras(0.0))])[0]

    for name in ["wall.splat", "cone.safetensors"]:
        (tmp_path / name).write_bytes((scene_file.parent / name).read_bytes())
    plain = scene_file.read_text()
    antialiased = plain.replace("\n[[rig]]", "\n[rules]\nantialias = true\n\n[[rig]]", 1)
    own = drawn(session, antialiased)
    default = drawn(decouplegs.Session(session.device.uuid, exported=False), plain)
    assert (own != default).any(), "antialiasing shows"
    forced = decouplegs.Session(session.device.uuid, rules="default", exported=False)
    np.testing.assert_array_equal(drawn(forced, antialiased), default)
    with pytest.raises(ValueError, match="gsplat15"):
        decouplegs.Session(rules="mine")


def test_compact_storage_takes_less_memory_and_draws_the_same(session, scene_file):
    def drawn(storage):
        own = decouplegs.Session(session.device.uuid, color="f32", storage=storage, exported=False)
        scene = own.open_scene(scene_file)
        images = own.batch_renderer().draw([(decouplegs.World(scene), scene.cameras(0.0))])
        return images[0], own.memory()["scene"]

    exact, exact_bytes = drawn("exact")
    compact, compact_bytes = drawn("compact")
    assert compact_bytes < exact_bytes
    assert (exact != compact).any(), "nothing was rounded"
    np.testing.assert_allclose(exact, compact, atol=0.004)
    with pytest.raises(ValueError, match="compact"):
        decouplegs.Session(storage="half")


def test_backgrounds_have_levels_of_detail(session, scene_file):
    def drawn(pitch):
        own = decouplegs.Session(session.device.uuid, background_pitch=pitch, exported=False)
        scene = own.open_scene(scene_file)
        return own.batch_renderer().draw([(decouplegs.World(scene), scene.cameras(0.0))])[0]

    np.testing.assert_array_equal(drawn(None), drawn(0.0))
    assert drawn(1e6).shape == drawn(None).shape
    with pytest.raises(ValueError, match="background_pitch"):
        decouplegs.Session(background_pitch=-1.0)


def test_python_and_the_program_render_the_same_floats(session, scene_file, tmp_path):
    program = os.environ.get("DECOUPLEGS_PROGRAM")
    if program is None:
        pytest.skip("DECOUPLEGS_PROGRAM does not name the decouplegs program")
    subprocess.run([program, "render", scene_file, "--out", tmp_path, "--format", "npy"], check=True)
    floats = decouplegs.Session(session.device.uuid, color="f32", exported=False)
    own = floats.open_scene(scene_file)
    colors = floats.batch_renderer().draw_layers([(decouplegs.World(own), own.cameras(0.0))])[0]["color"]
    for camera, color in zip(own.rig, colors, strict=True):
        np.testing.assert_array_equal(color, np.load(tmp_path / f"{camera.name}.npy"))


def test_drawing_in_a_forked_child_is_an_error(session, scene):
    renderer, world, cameras = session.batch_renderer(), decouplegs.World(scene), scene.cameras(0.0)
    renderer.draw([(world, cameras)])
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            renderer.draw([(world, cameras)])
            said = "it drew"
        except decouplegs.DeviceError as error:
            said = str(error)
        os.write(write, said.encode())
        os._exit(0)
    os.close(write)
    assert b"fork" in os.read(read, 4096)
    os.waitpid(child, 0)
