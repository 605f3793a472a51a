"""Calls a server by the public sensorsim and physics contract.

The contract is the table below, written from the public documents and not from the server's own messages: a wrong number or type on
either side shows as a field that does not arrive.
"""

import struct
import sys

import grpc
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

TYPES = {
    "double": 1, "float": 2, "uint64": 4, "int32": 5, "fixed64": 6, "bool": 8, "string": 9, "bytes": 12, "uint32": 13,
}

# message: fields as (name, number, type, is repeated); a type that is no scalar is a message, "enum" is read as int32.
CONTRACT = {
    "Empty": [],
    "Quat": [("w", 1, "float"), ("x", 2, "float"), ("y", 3, "float"), ("z", 4, "float")],
    "Vec3": [("x", 1, "float"), ("y", 2, "float"), ("z", 3, "float")],
    "Pose": [("vec", 1, "Vec3"), ("quat", 2, "Quat")],
    "AABB": [("size_x", 1, "float"), ("size_y", 2, "float"), ("size_z", 3, "float")],
    "PoseAtTime": [("pose", 1, "Pose"), ("timestamp_us", 2, "fixed64")],
    "Trajectory": [("poses", 1, "PoseAtTime", True)],
    "APIVersion": [("major", 1, "uint32"), ("minor", 2, "uint32"), ("patch", 3, "uint32")],
    "VersionId": [("version_id", 1, "string"), ("git_hash", 2, "string"), ("grpc_api_version", 3, "APIVersion")],
    "AvailableScenesReturn": [("scene_ids", 1, "string", True)],
    "LoadedSceneEntry": [("scene_id", 1, "string"), ("loaded_instance_count", 2, "uint64"), ("reusable_instance_count", 3, "uint64")],
    "LoadedScenesReturn": [("scenes", 1, "LoadedSceneEntry", True), ("loaded_instance_capacity", 2, "uint64")],
    "EgoMaskId": [("camera_logical_id", 1, "string"), ("rig_config_id", 2, "string")],
    "EgoMaskMetadata": [("ego_mask_id", 1, "EgoMaskId")],
    "AvailableEgoMasksReturn": [("ego_mask_metadata", 1, "EgoMaskMetadata", True)],
    "OpenCVPinholeCameraParam": [
        ("principal_point_x", 1, "double"), ("principal_point_y", 2, "double"), ("focal_length_x", 3, "double"),
        ("focal_length_y", 4, "double"), ("radial_coeffs", 5, "double", True), ("tangential_coeffs", 6, "double", True),
        ("thin_prism_coeffs", 7, "double", True),
    ],
    "CameraSpec": [
        ("opencv_pinhole_param", 3, "OpenCVPinholeCameraParam"), ("logical_id", 5, "string"), ("resolution_h", 7, "uint32"),
        ("resolution_w", 8, "uint32"), ("shutter_type", 9, "int32"),
    ],
    "PosePair": [("start_pose", 1, "Pose"), ("end_pose", 2, "Pose")],
    "DynamicObject": [("track_id", 1, "string"), ("pose_pair", 2, "PosePair")],
    "RGBRenderRequest": [
        ("scene_id", 1, "string"), ("resolution_h", 2, "uint32"), ("resolution_w", 3, "uint32"), ("camera_intrinsics", 4, "CameraSpec"),
        ("frame_start_us", 5, "fixed64"), ("frame_end_us", 6, "fixed64"), ("sensor_pose", 7, "PosePair"),
        ("dynamic_objects", 8, "DynamicObject", True), ("image_format", 9, "int32"), ("image_quality", 10, "float"),
        ("insert_ego_mask", 11, "bool"), ("ego_mask_id", 12, "EgoMaskId"),
    ],
    "AvailableCamerasRequest": [("scene_id", 1, "string")],
    "AvailableCamera": [("intrinsics", 1, "CameraSpec"), ("rig_to_camera", 2, "Pose"), ("logical_id", 3, "string")],
    "AvailableCamerasReturn": [("available_cameras", 1, "AvailableCamera", True)],
    "AvailableTrajectoriesRequest": [("scene_id", 1, "string")],
    "AvailableTrajectory": [("trajectory", 2, "Trajectory")],
    "AvailableTrajectoriesReturn": [("available_trajectories", 1, "AvailableTrajectory", True)],
    "RGBRenderReturn": [("image_bytes", 1, "bytes")],
    "BatchRGBRenderRequestItem": [("camera_name", 1, "string"), ("request", 2, "RGBRenderRequest")],
    "BatchRGBRenderRequest": [("items", 1, "BatchRGBRenderRequestItem", True)],
    "BatchRGBRenderReturnItem": [
        ("camera_name", 1, "string"), ("result", 2, "RGBRenderReturn"), ("success", 3, "bool"), ("error_message", 4, "string"),
    ],
    "BatchRGBRenderReturn": [("items", 1, "BatchRGBRenderReturnItem", True)],
    "LidarSpec": [("lidar_type", 2, "int32")],
    "LidarRenderRequest": [
        ("scene_id", 1, "string"), ("lidar_config", 2, "LidarSpec"), ("frame_start_us", 3, "fixed64"), ("frame_end_us", 4, "fixed64"),
        ("sensor_pose", 5, "PosePair"), ("dynamic_objects", 6, "DynamicObject", True),
    ],
    "LidarRenderReturn": [
        ("point_xyzs", 1, "float", True), ("point_intensities", 2, "float", True), ("num_points", 3, "uint32"),
        ("point_xyzs_buffer", 4, "bytes"), ("point_intensities_buffer", 5, "bytes"),
    ],
    # As TIER IV's fork has it.
    "RingedLidarRenderReturn": [
        ("num_points", 3, "uint32"), ("point_xyzs_buffer", 4, "bytes"), ("point_ring_ids", 6, "uint32", True),
        ("point_ring_ids_buffer", 7, "bytes"),
    ],
    "AggregatedRenderRequest": [("rgb_requests", 1, "RGBRenderRequest", True), ("lidar_requests", 2, "LidarRenderRequest", True)],
    "AggregatedRenderReturn": [
        ("rgb_returns", 1, "RGBRenderReturn", True), ("lidar_returns", 2, "LidarRenderReturn", True), ("driver_data", 3, "bytes"),
    ],
    "PhysicsPosePair": [("now_pose", 1, "Pose"), ("future_pose", 2, "Pose")],
    "EgoData": [("aabb", 1, "AABB"), ("ego_trajectory_aabb", 3, "Trajectory")],
    "OtherObject": [("aabb", 1, "AABB"), ("pose_pair", 2, "PhysicsPosePair")],
    "PhysicsGroundIntersectionRequest": [
        ("scene_id", 1, "string"), ("now_us", 2, "fixed64"), ("future_us", 3, "fixed64"), ("ego_data", 4, "EgoData"),
        ("other_objects", 5, "OtherObject", True),
    ],
    "ReturnPose": [("pose", 1, "Pose"), ("status", 2, "int32")],
    "PhysicsGroundIntersectionReturn": [
        ("other_poses", 2, "ReturnPose", True), ("ego_trajectory_aabb", 4, "Trajectory"), ("ego_status", 5, "int32", True),
    ],
}

CALLS = {
    "get_version": ("Empty", "VersionId"),
    "get_available_scenes": ("Empty", "AvailableScenesReturn"),
    "get_loaded_scenes": ("Empty", "LoadedScenesReturn"),
    "get_available_cameras": ("AvailableCamerasRequest", "AvailableCamerasReturn"),
    "get_available_trajectories": ("AvailableTrajectoriesRequest", "AvailableTrajectoriesReturn"),
    "get_available_ego_masks": ("Empty", "AvailableEgoMasksReturn"),
    "render_rgb": ("RGBRenderRequest", "RGBRenderReturn"),
    "batch_render_rgb": ("BatchRGBRenderRequest", "BatchRGBRenderReturn"),
    "render_lidar": ("LidarRenderRequest", "LidarRenderReturn"),
    "render_aggregated": ("AggregatedRenderRequest", "AggregatedRenderReturn"),
    "ground_intersection": ("PhysicsGroundIntersectionRequest", "PhysicsGroundIntersectionReturn"),
}

PNG, JPEG, PLANAR = 1, 2, 4


def messages():
    """Classes of all messages of the contract, by name."""
    file = descriptor_pb2.FileDescriptorProto(name="contract.proto", package="contract", syntax="proto3")
    for name, fields in CONTRACT.items():
        message = file.message_type.add(name=name)
        for field_name, number, kind, *repeated in fields:
            field = message.field.add(name=field_name, number=number, label=3 if repeated else 1)
            if kind in TYPES:
                field.type = TYPES[kind]
            else:
                field.type, field.type_name = 11, f".contract.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"contract.{name}")) for name in CONTRACT}


class Server:
    """A server, asked by the names of its calls."""

    def __init__(self, address):
        size = 64 * 1024 * 1024
        options = [("grpc.max_receive_message_length", size), ("grpc.max_send_message_length", size)]
        self.channel = grpc.insecure_channel(address, options=options)
        self.messages = messages()

    def call(self, service, method, returns=None, **fields):
        asked, answered = (self.messages[name] for name in CALLS[method])
        answered = self.messages[returns] if returns else answered
        stub = self.channel.unary_unary(f"/{service}/{method}", asked.SerializeToString, answered.FromString)
        return stub(asked(**fields), timeout=120, wait_for_ready=True)


def after(a, b):
    """The pose `b`, which is given in the frame of `a`, in the frame that `a` is given in."""
    aw, av = a.quat.w, (a.quat.x, a.quat.y, a.quat.z)
    bw, bv = b.quat.w, (b.quat.x, b.quat.y, b.quat.z)
    cross = lambda u, v: (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    dot = lambda u, v: sum(x * y for x, y in zip(u, v))
    turn = cross(av, bv)
    w = aw * bw - dot(av, bv)
    v = [aw * bv[i] + bw * av[i] + turn[i] for i in range(3)]
    p = (b.vec.x, b.vec.y, b.vec.z)
    t = [2 * x for x in cross(av, p)]
    u = cross(av, t)
    place = [p[i] + aw * t[i] + u[i] for i in range(3)]
    where = dict(x=place[0] + a.vec.x, y=place[1] + a.vec.y, z=place[2] + a.vec.z)
    return dict(vec=where, quat=dict(w=w, x=v[0], y=v[1], z=v[2]))


def main():
    server = Server(sys.argv[1])
    sensorsim = "nre.grpc.protos.sensorsim.SensorsimService"
    version = server.call(sensorsim, "get_version")
    assert version.version_id.startswith("decouplegs-server") and version.grpc_api_version.minor > 0, version
    assert list(server.call(sensorsim, "get_available_scenes").scene_ids) == ["street"]
    cameras = server.call(sensorsim, "get_available_cameras", scene_id="street").available_cameras
    assert len(cameras) == 6 and len({camera.logical_id for camera in cameras}) == 6
    for camera in cameras:
        pinhole = camera.intrinsics.opencv_pinhole_param
        assert (camera.intrinsics.resolution_w, camera.intrinsics.resolution_h) == (160, 90), camera
        assert pinhole.focal_length_x > 10 and pinhole.focal_length_y > 10 and 60 < pinhole.principal_point_x < 100, pinhole
        assert camera.intrinsics.shutter_type == 5 and camera.intrinsics.logical_id == camera.logical_id
        assert abs(camera.rig_to_camera.vec.z) > 0.1, camera.rig_to_camera
    way = server.call(sensorsim, "get_available_trajectories", scene_id="street").available_trajectories[0].trajectory.poses
    assert len(way) > 1 and way[-1].timestamp_us > 1_000_000 and way[-1].pose.vec.x > way[0].pose.vec.x
    assert len(server.call(sensorsim, "get_available_ego_masks").ego_mask_metadata) == 0

    def request(camera, image_format):
        sensor = after(way[0].pose, camera.rig_to_camera)
        return dict(
            scene_id="street", resolution_h=80, resolution_w=128, camera_intrinsics=camera.intrinsics, frame_start_us=0,
            frame_end_us=20_000, sensor_pose=dict(start_pose=sensor, end_pose=sensor), image_format=image_format, image_quality=95,
        )

    planar = server.call(sensorsim, "render_rgb", **request(cameras[0], PLANAR)).image_bytes
    assert len(planar) == 3 * 80 * 128 and len(set(planar)) > 20, len(planar)
    jpeg = server.call(sensorsim, "render_rgb", **request(cameras[0], JPEG)).image_bytes
    assert jpeg[:3] == b"\xff\xd8\xff", jpeg[:16]
    for service in [sensorsim, "sensorsim.SensorsimService", "nurec.grpc.protos.sensorsim.SensorsimService"]:
        items = [dict(camera_name=camera.logical_id, request=request(camera, PNG)) for camera in cameras]
        reply = server.call(service, "batch_render_rgb", items=items)
        assert [item.camera_name for item in reply.items] == [camera.logical_id for camera in cameras]
        for item in reply.items:
            assert item.success and item.error_message == "", item.error_message
            assert item.result.image_bytes[:8] == b"\x89PNG\r\n\x1a\n"
    aggregated = server.call(sensorsim, "render_aggregated", rgb_requests=[request(cameras[0], PLANAR), request(cameras[1], PLANAR)])
    assert aggregated.rgb_returns[0].image_bytes == planar and aggregated.rgb_returns[1].image_bytes != planar
    roof = dict(vec=dict(x=way[0].pose.vec.x, y=way[0].pose.vec.y, z=way[0].pose.vec.z + 1.1), quat=dict(w=1))
    sweep = dict(
        scene_id="street", lidar_config=dict(lidar_type=1), frame_start_us=0, frame_end_us=100_000,
        sensor_pose=dict(start_pose=roof, end_pose=roof),
    )
    points = server.call(sensorsim, "render_lidar", **sweep)
    count = points.num_points
    assert count > 1000 and len(points.point_xyzs_buffer) == 12 * count and len(points.point_intensities_buffer) == 4 * count, count
    # Sweeps of more points than this have buffers alone.
    listed = count if count <= 104_857 else 0
    assert list(points.point_xyzs) == list(struct.unpack(f"<{3 * count}f", points.point_xyzs_buffer))[: 3 * listed]
    assert list(points.point_intensities) == list(struct.unpack(f"<{count}f", points.point_intensities_buffer))[:listed]
    ringed = server.call(sensorsim, "render_lidar", returns="RingedLidarRenderReturn", **sweep)
    assert ringed.point_xyzs_buffer == points.point_xyzs_buffer and len(ringed.point_ring_ids) == listed, ringed.num_points
    rings = struct.unpack(f"<{count}H", ringed.point_ring_ids_buffer)
    assert max(rings) == 127 and list(ringed.point_ring_ids) == list(rings)[:listed]
    mixed = server.call(sensorsim, "render_aggregated", rgb_requests=[request(cameras[0], PLANAR)], lidar_requests=[sweep])
    assert mixed.rgb_returns[0].image_bytes == planar and mixed.lidar_returns[0] == points
    loaded = server.call(sensorsim, "get_loaded_scenes")
    assert [scene.scene_id for scene in loaded.scenes] == ["street"] and loaded.loaded_instance_capacity == 8, loaded

    # An object that is seen by its number and name, and one whose pose makes no sense.
    bad = dict(vec=dict(x=float("nan")), quat=dict(w=1))
    spoilt = request(cameras[0], PNG) | dict(dynamic_objects=[dict(track_id="car", pose_pair=dict(start_pose=bad, end_pose=bad))])
    try:
        server.call(sensorsim, "render_rgb", **spoilt)
        raise AssertionError("a pose that is not a number was drawn")
    except grpc.RpcError as error:
        assert error.code() == grpc.StatusCode.INVALID_ARGUMENT and "dynamic_objects[0]" in error.details(), error

    box = dict(size_x=4.5, size_y=1.8, size_z=1.5)
    level = dict(vec=dict(x=5.0, y=0.0, z=1.25), quat=dict(w=1))
    set_down = server.call(
        "physics.PhysicsService", "ground_intersection", scene_id="street", now_us=0, future_us=100_000,
        ego_data=dict(aabb=box, ego_trajectory_aabb=dict(poses=[dict(pose=level, timestamp_us=7)])),
        other_objects=[dict(aabb=box, pose_pair=dict(now_pose=level, future_pose=level))],
    )
    ego, other = set_down.ego_trajectory_aabb.poses[0], set_down.other_poses[0]
    assert list(set_down.ego_status) == [0] and other.status == 0 and ego.timestamp_us == 7, set_down
    assert abs(ego.pose.vec.z - 0.75) < 0.1 and ego.pose.vec == other.pose.vec, set_down
    print("all calls were answered")


if __name__ == "__main__":
    main()
