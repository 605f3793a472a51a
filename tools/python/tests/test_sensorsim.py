"""A rollout over the server with the classes that Python's own gRPC tools make of the contract's messages, as AlpaSim's runtime has them."""

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from program import PROGRAM, needs_program

PROTO = Path(__file__).parents[2] / "server/proto"
STEPS = 100

pytestmark = needs_program


@pytest.fixture(scope="module")
def classes(tmp_path_factory):
    protoc = pytest.importorskip("grpc_tools.protoc", reason="the package grpcio-tools is not installed")
    out = tmp_path_factory.mktemp("classes")
    files = [str(PROTO / name) for name in ("sensorsim.proto", "shared.proto")]
    assert protoc.main(["protoc", f"-I{PROTO}", f"--python_out={out}", f"--grpc_python_out={out}", *files]) == 0
    sys.path.insert(0, str(out))
    yield __import__("sensorsim_pb2"), __import__("sensorsim_pb2_grpc"), __import__("shared_pb2")
    sys.path.remove(str(out))


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    street = ["--background", "4000", "--agents", "3", "--agent-splats", "300", "--size", "160x90", "--movable", "--out", str(folder / "street")]
    subprocess.run([PROGRAM, "synth", "street", *street], check=True, capture_output=True)
    server = Path(PROGRAM).with_name("decouplegs-server")
    serving = subprocess.Popen([server, "serve-grpc", folder / "street/scene.toml", "--port", "0"], stdout=subprocess.PIPE, text=True)
    yield serving.stdout.readline().removeprefix("listening on ").strip()
    serving.terminate()
    assert serving.wait(timeout=30) == 0


def test_a_hundred_steps_of_six_cameras(address, classes):
    grpc = pytest.importorskip("grpc")
    image = pytest.importorskip("matplotlib.image")
    messages, services, common = classes
    limits = [("grpc.max_receive_message_length", 64 << 20)]
    with grpc.insecure_channel(address, options=limits) as channel:
        stub = services.SensorsimServiceStub(channel)
        assert stub.get_version(common.Empty()).grpc_api_version.minor == 54
        (scene,) = stub.get_available_scenes(common.Empty()).scene_ids
        cameras = stub.get_available_cameras(messages.AvailableCamerasRequest(scene_id=scene)).available_cameras
        trajectories = stub.get_available_trajectories(messages.AvailableTrajectoriesRequest(scene_id=scene)).available_trajectories
        poses = trajectories[0].trajectory.poses
        assert len(cameras) == 6 and len(poses) > 10
        seen = set()
        for step in range(STEPS):
            timed = poses[step * (len(poses) - 1) // (STEPS - 1)]
            car = common.Pose(vec=common.Vec3(x=timed.pose.vec.x + 8, y=timed.pose.vec.y, z=0.75), quat=common.Quat(w=1))
            items = [item(messages, scene, camera, timed, car) for camera in cameras]
            reply = stub.batch_render_rgb(messages.BatchRGBRenderRequest(items=items))
            assert [one.camera_name for one in reply.items] == [camera.logical_id for camera in cameras]
            for one in reply.items:
                assert one.success, one.error_message
                assert one.result.image_bytes.startswith(b"\x89PNG")
            seen.add(reply.items[0].result.image_bytes)
            assert image.imread(io.BytesIO(reply.items[-1].result.image_bytes)).shape == (90, 160, 3)
        assert len(seen) > STEPS // 2, "the ego drives"
        with pytest.raises(grpc.RpcError) as refused:
            stub.render_rgb(messages.RGBRenderRequest(scene_id="nowhere"))
        assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT


def item(messages, scene, camera, timed, car):
    sensor = combined(timed.pose, camera.rig_to_camera)
    pair = lambda pose: messages.PosePair(start_pose=pose, end_pose=pose)
    request = messages.RGBRenderRequest(
        scene_id=scene,
        resolution_w=160,
        resolution_h=90,
        camera_intrinsics=camera.intrinsics,
        frame_start_us=timed.timestamp_us,
        frame_end_us=timed.timestamp_us + 20_000,
        sensor_pose=pair(sensor),
        dynamic_objects=[messages.DynamicObject(track_id="car_000", pose_pair=pair(car))],
        image_format=messages.PNG,
    )
    return messages.BatchRGBRenderRequestItem(camera_name=camera.logical_id, request=request)


def combined(outer, inner):
    """The pose of ``inner``, which is in the frame of ``outer``, where ``outer`` is."""
    turn = quaternion(outer.quat)
    placed = type(outer)()
    moved = rotated(turn, np.array([inner.vec.x, inner.vec.y, inner.vec.z])) + [outer.vec.x, outer.vec.y, outer.vec.z]
    placed.vec.x, placed.vec.y, placed.vec.z = moved
    placed.quat.w, placed.quat.x, placed.quat.y, placed.quat.z = product(turn, quaternion(inner.quat))
    return placed


def quaternion(quat):
    return np.array([quat.w, quat.x, quat.y, quat.z])


def product(a, b):
    w, v = a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([w, *v])


def rotated(turn, vector):
    return product(product(turn, np.array([0, *vector])), turn * [1, -1, -1, -1])[1:]
