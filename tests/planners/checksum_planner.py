"""Tells what it got: a checksum of each image, and numbers of the header, as places of a plan."""

import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "../../tools/planner_client"))
import decouplegs_planner  # noqa: E402


def checksum(rgba):
    return sum((at % 251 + 1) * byte for at, byte in enumerate(rgba)) % 1_000_003


class Checksums(decouplegs_planner.Planner):
    name, cameras, privileged = "checksums", "all", True

    def begin(self, briefing):
        # What is printed must not get into the protocol.
        print("an episode begins")
        self.cameras_told = [(camera["name"], camera["fx_px"], camera["position_m"]) for camera in briefing.cameras]
        assert briefing.ego_size_m == [4.5, 1.8, 1.5], briefing.ego_size_m

    def plan(self, observation):
        if observation.step == 13:
            raise ValueError("thirteen")
        if observation.step == 14:
            return [(1.0, float("nan"), 0.0)]
        assert [name for name, _, _ in self.cameras_told] == list(observation.frames), self.cameras_told
        sums = [checksum(frame.rgba) for frame in observation.frames.values()]
        known = observation.privileged
        told = [observation.time_s, observation.ego.speed_mps, observation.guidance.angle_rad, known.ego.position_m[0],
                known.agents[0].yaw_rad, known.route_m[1][1], self.cameras_told[0][1], self.cameras_told[0][2][2]]
        return [(1.0 + i, value / 1000.0, 0.0) for i, value in enumerate(sums)] + [
            (20.0 + i, 0.0, value) for i, value in enumerate(told)]


if __name__ == "__main__":
    decouplegs_planner.run(Checksums)
