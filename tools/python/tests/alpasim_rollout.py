"""A rollout over a server with AlpaSim's own message classes, as the package `carla-driver-interface` ships them.

Arguments: a file descriptor set of this project's messages, which is compared with AlpaSim's, and the address of a server.
"""

import io
import sys

import grpc
from carla_driver_interface._proto import egodriver_pb2 as egodriver
from carla_driver_interface.geometry import Pose
from google.protobuf import descriptor_pb2
from PIL import Image

from alpasim import calls, common, messages

STEPS = 100


def table(files):
    """All names of `files`: fields with number, type and label, values of enums, and the types of calls."""
    names = {}

    def add(prefix, message):
        for field in message.field:
            names[f"{prefix}.{field.name}"] = (field.number, field.type, field.label, field.type_name)
        for inner in message.nested_type:
            add(f"{prefix}.{inner.name}", inner)
        add_enums(prefix, message.enum_type)

    def add_enums(prefix, enums):
        for enum in enums:
            for value in enum.value:
                names[f"{prefix}.{enum.name}.{value.name}"] = value.number

    for file in files:
        for message in file.message_type:
            names[f"{file.package}.{message.name}"] = "message"
            add(f"{file.package}.{message.name}", message)
        add_enums(file.package, file.enum_type)
        for service in file.service:
            for method in service.method:
                names[f"{file.package}.{service.name}.{method.name}"] = (method.input_type, method.output_type)
    return names


def proto(module):
    file = descriptor_pb2.FileDescriptorProto()
    module.DESCRIPTOR.CopyToProto(file)
    return file


def compare(path):
    with open(path, "rb") as file:
        ours = table(descriptor_pb2.FileDescriptorSet.FromString(file.read()).file)
    theirs = table(map(proto, (common, egodriver, messages)))
    different = {name: (value, ours.get(name)) for name, value in theirs.items() if ours.get(name) != value}
    packages = tuple(f"{module.DESCRIPTOR.package}." for module in (common, egodriver, messages))
    extra = sorted(name for name in ours if name.startswith(packages) and name not in theirs)
    print(f"{len(theirs)} names, {len(different)} different: {different}; more here: {', '.join(extra)}")


def rollout(address):
    with grpc.insecure_channel(address, options=[("grpc.max_receive_message_length", 64 << 20)]) as channel:
        call = calls(channel)
        call["get_version"](common.Empty())
        (scene,) = call["get_available_scenes"](common.Empty()).scene_ids
        cameras = call["get_available_cameras"](messages.AvailableCamerasRequest(scene_id=scene)).available_cameras
        (one,) = call["get_available_trajectories"](messages.AvailableTrajectoriesRequest(scene_id=scene)).available_trajectories
        call["get_available_ego_masks"](common.Empty())
        poses, seen = one.trajectory.poses, set()
        for step in range(STEPS):
            timed = poses[step * (len(poses) - 1) // (STEPS - 1)]
            car = Pose.from_proto(timed.pose) @ Pose.from_xyz_yaw(8.0, 0.0, 0.0, 0.0)
            items = [request(scene, camera, timed, car.to_proto()) for camera in cameras]
            reply = call["batch_render_rgb"](messages.BatchRGBRenderRequest(items=items))
            assert [item.camera_name for item in reply.items] == [camera.logical_id for camera in cameras]
            for item in reply.items:
                assert item.success and item.result.image_bytes.startswith(b"\xff\xd8"), item.error_message
            seen.add(reply.items[0].result.image_bytes)
            with Image.open(io.BytesIO(reply.items[-1].result.image_bytes)) as image:
                assert image.size == (160, 90)
        assert len(seen) > STEPS // 2, "the ego drives"
        try:
            call["render_rgb"](messages.RGBRenderRequest(scene_id="nowhere"))
        except grpc.RpcError as error:
            assert error.code() == grpc.StatusCode.INVALID_ARGUMENT
        else:
            raise AssertionError("a request without a camera is answered")
        print(f"{STEPS} steps of {len(cameras)} cameras, {len(seen)} different images")


def request(scene, camera, timed, car):
    sensor = (Pose.from_proto(timed.pose) @ Pose.from_proto(camera.rig_to_camera)).to_proto()
    pair = lambda pose: messages.PosePair(start_pose=pose, end_pose=pose)
    return messages.BatchRGBRenderRequestItem(
        camera_name=camera.logical_id,
        request=messages.RGBRenderRequest(
            scene_id=scene,
            resolution_w=160,
            resolution_h=90,
            camera_intrinsics=camera.intrinsics,
            frame_start_us=timed.timestamp_us,
            frame_end_us=timed.timestamp_us + 20_000,
            sensor_pose=pair(sensor),
            dynamic_objects=[messages.DynamicObject(track_id="car_000", pose_pair=pair(car))],
            image_format=messages.JPEG,
            image_quality=95,
        ),
    )


compare(sys.argv[1])
rollout(sys.argv[2])
