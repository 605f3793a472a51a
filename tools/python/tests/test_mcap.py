"""MCAP files of episodes, opened by the readers of their own project."""

import json

import numpy as np
import pytest

from program import decouplegs, needs_program

pytestmark = needs_program


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mcap")
    place = ["--background", 30_000, "--agent-splats", 300]
    how = ["--level", "hard", "--episodes", 1, "--size", "96x54", "--seed", 3, "--planner", "constant-velocity", "--all-cameras"]
    decouplegs("drive", *place, *how, "--out", folder / "run")
    said = decouplegs("export", folder / "run/logs/hard_0000.log", "--as", "mcap", "--cameras", "front,back", "--lidar", "vlp32c", "--out", folder / "mcap")
    assert "images have the bits of the log" in said
    decouplegs("export", folder / "run/logs/hard_0000.log", "--as", "coco", "--cameras", "front,back", "--out", folder / "coco")
    return folder


def messages(path):
    reader = pytest.importorskip("mcap.reader", reason="the package mcap is not installed")
    ros2 = pytest.importorskip("mcap_ros2.decoder", reason="the package mcap-ros2-support is not installed")
    found = {}
    with path.open("rb") as file:
        for schema, channel, message, decoded in reader.make_reader(file, decoder_factories=[ros2.DecoderFactory()]).iter_decoded_messages():
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, decoded))
    return found


def test_an_episode_is_read_by_the_readers_of_mcap(exported):
    found = messages(exported / "mcap/episode.mcap")
    images = {name: sorted((exported / "coco/images").glob(f"*_{name}.png")) for name in ("front", "back")}
    steps = len(images["front"])
    assert steps > 4
    topics = {"/tf": steps, "/tf_static": 1, "/objects": steps, "/lidar/vlp32c/points": steps}
    for name in images:
        topics |= {f"/camera/{name}/image/compressed": steps, f"/camera/{name}/camera_info": steps}
    assert {topic: len(found[topic]) for topic in topics} == topics
    for name, files in images.items():
        for (kind, time, message), file in zip(found[f"/camera/{name}/image/compressed"], files):
            assert kind == "sensor_msgs/msg/CompressedImage" and message.format == "png"
            assert bytes(message.data) == file.read_bytes(), "the pixels are those of the other export"
            assert message.header.frame_id == f"camera/{name}"
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time >= 10**9
        info = found[f"/camera/{name}/camera_info"][0][2]
        assert (info.width, info.height) == (96, 54) and info.distortion_model == "plumb_bob" and len(info.d) == 5
        assert info.k[0] == info.p[0] > 20 and info.k[2] == pytest.approx(47.5) and info.p[6] == pytest.approx(26.5)


def test_motion_plans_and_score_are_topics_to_plot(exported):
    found = messages(exported / "mcap/episode.mcap")
    episode = json.loads(decouplegs("score", exported / "run/logs/hard_0000.log", "--out", exported / "score") and (exported / "score/report.json").read_text())["episodes"][0]
    plots = {topic.removeprefix("/episode/"): [(time, message.data) for _, time, message in of_topic] for topic, of_topic in found.items() if topic.startswith("/episode/")}
    assert {"speed_mps", "acceleration_mps2", "jerk_mps3", "steer_rad", "nearest_agent_m", "route_completion", "driving_score"} <= set(plots)
    assert plots["driving_score"][-1][1] == pytest.approx(episode["driving_score"], abs=1e-12)
    times = [time for time, _ in plots["speed_mps"]]
    assert times[0] == 10**9 and times == sorted(times) and len(times) > len(found["/tf"])
    # The odometry is that of the transforms, and its velocity that of the plot, in the axes of the ego.
    odometry = {time: message for _, time, message in found["/odom"]}
    assert list(odometry) == times
    for time, speed in plots["speed_mps"]:
        linear = odometry[time].twist.twist.linear
        assert linear.x == pytest.approx(speed, abs=0.02 * speed + 0.02) and abs(linear.y) < 0.3
    for _, time, message in found["/tf"]:
        at, shift = odometry[time].pose.pose.position, message.transforms[0].transform.translation
        assert (at.x, at.y, at.z) == (shift.x, shift.y, shift.z) and odometry[time].header.frame_id == "map"
    # A plan begins at the ego; this planner goes straight on.
    plans = [message for _, _, message in found["/plan"]]
    assert len(plans) == len(found["/tf"])
    for (_, time, _), plan in zip(found["/plan"], plans):
        begin, end = plan.poses[0].pose.position, plan.poses[-1].pose.position
        assert (begin.x, begin.y) == (odometry[time].pose.pose.position.x, odometry[time].pose.pose.position.y)
        seconds = plan.poses[-1].header.stamp.sec - plan.poses[0].header.stamp.sec
        way = np.hypot(end.x - begin.x, end.y - begin.y)
        assert way == pytest.approx(seconds * dict(plots["speed_mps"])[time], rel=0.1, abs=1.0)
    told = [(message.level, message.msg) for _, _, message in found.get("/infractions", [])]
    assert len(told) == len(episode["infractions"]) > 0
    for (level, text), infraction in zip(told, episode["infractions"]):
        assert level == 30 and infraction["kind"] == "collision" and infraction["agent"] in text


def test_frames_join_boxes_and_points(exported):
    found = messages(exported / "mcap/episode.mcap")
    fixed = {transform.child_frame_id: transform for transform in found["/tf_static"][0][2].transforms}
    assert set(fixed) == {"camera/front", "camera/back", "lidar/vlp32c"}
    assert all(transform.header.frame_id == "base_link" for transform in fixed.values())
    ego = [message.transforms[0] for _, _, message in found["/tf"]]
    assert all((t.header.frame_id, t.child_frame_id) == ("map", "base_link") for t in ego)
    moved = np.hypot(ego[-1].transform.translation.x - ego[0].transform.translation.x, ego[-1].transform.translation.y - ego[0].transform.translation.y)
    assert moved > 5.0
    markers = found["/objects"][0][2].markers
    assert markers[0].action == 3 and len(markers) > 3, "the first takes away those before"
    assert all(marker.type == 1 and marker.action == 0 and 1.0 < marker.scale.x < 20.0 for marker in markers[1:])
    assert len({(marker.ns, marker.id) for marker in markers[1:]}) == len(markers) - 1
    # Points of a sweep are on the road and on the boxes, not above the sensor.
    cloud = found["/lidar/vlp32c/points"][0][2]
    names = [field.name for field in cloud.fields]
    assert cloud.point_step == 32 and names[:4] == ["x", "y", "z", "intensity"]
    points = np.frombuffer(bytes(cloud.data), np.float32).reshape(cloud.width, 8)[:, :3]
    assert len(points) > 500 and np.isfinite(points).all()
    near = points[np.hypot(points[:, 0], points[:, 1]) < 10.0]
    height = fixed["lidar/vlp32c"].transform.translation.z + ego[0].transform.translation.z
    assert np.quantile(near[:, 2], 0.1) == pytest.approx(-height, abs=0.05), "the ground is at height 0"
